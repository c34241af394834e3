"""Runs of many seeds, shared out over processes: PAPER_PROCESSES of them, one controller and two seeds to a task.

Each process keeps to one of the cores that this one may use: XLA starts as many threads as it sees cores, which on a
large machine cost more than what they work on.
"""

import os
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, fields
from multiprocessing import get_context
from typing import Any

import jax
import numpy as np

from benchmarks.paper.loop import Run

PROCESSES = int(os.environ.get("PAPER_PROCESSES", "1"))
SEEDS = 2  # of one task; tasks of as many robots share what was compiled


@dataclass(frozen=True)
class Wanted:
    """`run(seeds, modes, **options)`; every option can be pickled."""

    run: Callable[..., Run]
    seeds: np.ndarray
    modes: tuple[int, ...]
    options: dict[str, Any] = field(default_factory=dict)


def every(wanted: list[Wanted], processes: int = PROCESSES) -> list[Run]:
    """What each is wanted for, in their order; robots of one run in any order."""
    if processes == 1:
        return [w.run(w.seeds, w.modes, **w.options) for w in wanted]
    context = get_context("spawn")
    cores = context.SimpleQueue()
    for core in (_cores() * processes)[:processes]:
        cores.put(core)
    with ProcessPoolExecutor(processes, context, _begin, (cores,)) as pool:
        jobs = [
            [
                pool.submit(w.run, w.seeds[k : k + SEEDS], (mode,), **w.options)
                for mode in w.modes
                for k in range(0, len(w.seeds), SEEDS)
            ]
            for w in wanted
        ]
        return [merged([job.result() for job in own]) for own in jobs]


def _cores() -> list[int | None]:
    """Those that this process may use, where the system tells."""
    return [*sorted(os.sched_getaffinity(0))] if hasattr(os, "sched_getaffinity") else [None]


def merged(runs: list[Run]) -> Run:
    """The robots of all runs, which have the same ticks, as one."""
    out: dict[str, Any] = {f.name: [getattr(run, f.name) for run in runs] for f in fields(Run)}
    series = {n: np.concatenate([s[n] for s in out["series"]], axis=1) for n in out["series"][0]}
    inputs = [
        jax.tree.map(lambda *x: np.concatenate(x), *tick)
        for tick in zip(*out["inputs"], strict=True)
    ]
    robots = {n: np.concatenate(out[n]) for n in ("mode", "seed", "fell", "unsolved", "unphysical")}
    return Run(time=runs[0].time, series=series, inputs=inputs, wall=sum(out["wall"]), **robots)


def _begin(cores) -> None:
    core = cores.get()
    if core is not None:
        os.sched_setaffinity(0, {core})
    jax.config.update("jax_enable_x64", True)
