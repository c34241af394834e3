"""A compiled function over the samples of a log of any length."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import numpy as np

SIZE = 128


def over_samples(one: Callable[..., Any]) -> Callable[..., Any]:
    """`one(shared, sample)` over the leading axis of `samples`, in chunks of one size; results are NumPy's.

    One size means one compilation whatever the log's length, and memory that does not grow with it. The last chunk is
    filled up with its last sample.
    """

    @eqx.filter_jit
    def chunk(shared, samples):
        return jax.vmap(lambda sample: one(shared, sample))(samples)

    def mapped(shared, samples):
        leaves, shape = jax.tree.flatten(samples)
        leaves = [np.asarray(x) for x in leaves]
        count = len(leaves[0])
        parts = []
        for start in range(0, count, SIZE):
            at = np.minimum(np.arange(start, start + SIZE), count - 1)
            out = chunk(shared, jax.tree.unflatten(shape, [x[at] for x in leaves]))
            parts.append(jax.tree.map(np.asarray, out))
        return jax.tree.map(lambda *x: np.concatenate(x)[:count], *parts)

    return mapped
