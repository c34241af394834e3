"""A compiled function over the samples of a log of any length."""

from collections.abc import Callable
from concurrent import futures
from typing import Any

import equinox as eqx
import jax
import numpy as np

SIZE = 128
_BESIDE = futures.ThreadPoolExecutor(max_workers=1, thread_name_prefix="compiling")


class OverSamples:
    """`one(shared, sample)` over the leading axis of `samples`, in chunks of one size; results are NumPy's.

    One size means one compilation whatever the log's length, and memory that does not grow with it. The last chunk is
    filled up with its last sample.
    """

    def __init__(self, one: Callable[..., Any]):
        self._chunk = eqx.filter_jit(jax.vmap(one, in_axes=(None, 0)))
        self._compiling: list[futures.Future] = []

    def ahead(self, shared: Any, sample: Any) -> None:
        """Begin to compile for samples like this one, while something else is done; a call that comes before waits."""
        exact = bool(jax.config.read("jax_enable_x64"))
        samples = jax.tree.map(lambda x: np.repeat(np.asarray(x)[None], SIZE, axis=0), sample)

        def compile_it():
            # What is compiled depends on the precision, which belongs to a thread.
            with jax.enable_x64(exact):
                self._chunk(shared, samples)

        self._compiling.append(_BESIDE.submit(compile_it))

    def __call__(self, shared: Any, samples: Any) -> Any:
        futures.wait(self._compiling)
        self._compiling.clear()
        leaves, shape = jax.tree.flatten(samples)
        leaves = [np.asarray(x) for x in leaves]
        count = len(leaves[0])
        parts = []
        for start in range(0, count, SIZE):
            at = np.minimum(np.arange(start, start + SIZE), count - 1)
            out = self._chunk(shared, jax.tree.unflatten(shape, [x[at] for x in leaves]))
            parts.append(jax.tree.map(np.asarray, out))
        return jax.tree.map(lambda *x: np.concatenate(x)[:count], *parts)
