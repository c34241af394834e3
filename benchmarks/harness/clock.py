"""Compile and run apart, medians after a warm-up, and races whose runners take turns."""

import time
from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np


def compiled(function: Callable, *args: Any) -> tuple[Callable, float]:
    """The compiled program and the seconds that tracing and compiling took."""
    start = time.perf_counter()
    program = jax.jit(function).lower(*args).compile()
    return program, time.perf_counter() - start


class Overwriting:
    """`function` over a batch, in chunks, every result stored, over those of the call before.

    So do libraries that compute into their own memory. Fresh pages for every call would be most of what is timed.
    """

    def __init__(self, function: Callable, chunk: int, *args: Any) -> None:
        """Compile for these arguments, batched along their first axis, a multiple of `chunk`."""
        shapes = jax.eval_shape(function, *(x[:chunk] for x in args))
        count = len(args[0])

        def over(kept: Any, *args: Any) -> Any:
            def one(i: Any, kept: Any) -> Any:
                here = [jax.lax.dynamic_slice_in_dim(x, i * chunk, chunk) for x in args]
                put = jax.lax.dynamic_update_slice_in_dim
                return jax.tree.map(lambda k, x: put(k, x, i * chunk, 0), kept, function(*here))

            return jax.lax.fori_loop(0, count // chunk, one, kept)

        self._kept = jax.tree.map(lambda x: jnp.zeros((count, *x.shape[1:]), x.dtype), shapes)
        self._args = args
        start = time.perf_counter()
        lowered = jax.jit(over, donate_argnums=0).lower(self._kept, *args)
        self._program = lowered.compile()
        self.compile_s = time.perf_counter() - start

    def __call__(self) -> Any:
        self._kept = self._program(self._kept, *self._args)
        return self._kept


def seconds(run: Callable[[], Any], *, budget: float = 1.0, most: int = 1000) -> float:
    """Median time of one call after a warm-up: at least 3 calls, at most `most`, or what `budget` [s] allows."""
    jax.block_until_ready(run())
    times: list[float] = []
    begin = time.perf_counter()
    while len(times) < 3 or (len(times) < most and time.perf_counter() - begin < budget):
        start = time.perf_counter()
        jax.block_until_ready(run())
        times.append(time.perf_counter() - start)
    return float(np.median(times))


def race(runners: Mapping[str, Callable[[], Any]], rounds: int = 15) -> dict[str, np.ndarray]:
    """Times [s] of every runner, one a round, taking turns: what slows the machine down slows all of them.

    Compare two of them by the median of their ratio, round by round.
    """
    for run in runners.values():
        jax.block_until_ready(run())
    times: dict[str, list[float]] = {name: [] for name in runners}
    for _ in range(rounds):
        for name, run in runners.items():
            start = time.perf_counter()
            jax.block_until_ready(run())
            times[name].append(time.perf_counter() - start)
    return {name: np.array(found) for name, found in times.items()}


def times_faster(found: Mapping[str, np.ndarray], ours: str, *theirs: str) -> float:
    """How many times faster `ours` was than `theirs` together: the median over the rounds of a race."""
    return float(np.median(sum(found[name] for name in theirs) / found[ours]))
