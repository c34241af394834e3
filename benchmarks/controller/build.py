"""The loop of `loop.cpp` with an estimator's step in it: written, compiled, run."""

import shutil
import subprocess
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np

from jax_inertia.estimation.inertial_filter import Estimator
from jax_inertia.estimation.online.exported_step import Found, Sample, write_c_step
from jax_inertia.signals.differences import Observation

LOOP = Path(__file__).with_name("loop.cpp")


class Run(NamedTuple):
    """What a run of the loop found of each sample, and how long its steps took."""

    found: Found
    clock_us: tuple[float, float, float]
    """Median, 99th percentile and maximum by the clock."""
    core_us: tuple[float, float, float]
    """The same by what the core spent on the loop."""


def compilers() -> tuple[str, str] | None:
    """Of C and of C++; None where one is missing."""
    found = shutil.which("cc"), shutil.which("c++")
    return (found[0], found[1]) if found[0] and found[1] else None


def build(folder: Path, estimator: Estimator, observation: Observation, level: str = "-O1") -> Path:
    """The loop as a program in `folder`."""
    known = compilers()
    if known is None:
        raise RuntimeError("no compiler of C and C++ (cc, c++); install gcc and g++, or clang")
    write_c_step(folder / "load_filter.c", estimator, observation)
    for command in (
        [known[0], level, "-c", "load_filter.c"],
        [known[1], "-O2", "-I.", str(LOOP), "load_filter.o", "-lm", "-o", "loop"],
    ):
        subprocess.run(command, cwd=folder, check=True)
    return folder / "loop"


def run(program: Path, samples: Sample, like: Found, *, period_us: float, steps: int) -> Run:
    """Run the loop over samples (leading axis: time); `like` has the shapes of one sample's result."""
    count = len(np.asarray(samples.dt))
    rows = [np.asarray(x, float).reshape(count, -1) for x in jax.tree.leaves(samples)]
    given, taken = (program.with_name(x) for x in ("samples.bin", "found.bin"))
    given.write_bytes(np.ascontiguousarray(np.concatenate(rows, axis=1)).tobytes())
    command = [str(program), str(given), str(taken), str(period_us), str(steps)]
    printed = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    clock, core = (_quantiles(line) for line in printed.splitlines())
    leaves, structure = jax.tree.flatten(like)
    numbers = np.frombuffer(taken.read_bytes()).reshape(min(count, steps), -1)
    ends = np.cumsum([int(np.prod(x.shape)) for x in leaves])
    parts = np.split(numbers, ends[:-1], axis=1)
    shaped = [
        part.reshape(len(part), *x.shape).astype(x.dtype)
        for part, x in zip(parts, leaves, strict=True)
    ]
    return Run(jax.tree.unflatten(structure, shaped), clock, core)


def _quantiles(line: str) -> tuple[float, float, float]:
    _, half, most, all_ = line.split()
    return float(half), float(most), float(all_)
