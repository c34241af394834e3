"""The closed loop of a fleet, and what is made of its runs: medians over seeds with the range of nine seeds in ten."""

import dataclasses
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.paper.brain import MODES, Brain, Inputs, Memory, Output, inputs, spread
from benchmarks.paper.plant import TICK, Fleet
from jax_inertia.estimation.inertial_filter import State
from jax_inertia.maths.inertial_parameters import is_physical

FALLEN = 0.6  # m, pelvis over the ground


@eqx.filter_jit
def _tick(brain: Brain, memory: Memory, x: Inputs) -> tuple[Memory, Output]:
    return jax.vmap(lambda m, i: brain.tick(m, i))(memory, x)


@dataclass
class Run:
    """Series (ticks, robots, …) of a fleet, and when each robot fell (∞: never)."""

    time: np.ndarray
    mode: np.ndarray
    seed: np.ndarray
    series: dict[str, np.ndarray]
    fell: np.ndarray
    unsolved: np.ndarray
    """Share of ticks in which the controller's program did not converge."""
    unphysical: np.ndarray
    """Number of estimates that are no physical body."""
    wall: float
    inputs: list[Inputs]
    """Of every tick, where they were to be kept: for `replay`."""


def drive(
    brain: Brain,
    fleet: Fleet,
    mode: np.ndarray,
    seed: np.ndarray,
    duration: float,
    watch: Callable[[Fleet, Output], dict[str, np.ndarray]],
    *,
    truth: Callable[[float], np.ndarray],
    plan: Any = None,
    on: Callable[[float], bool] = lambda t: True,
    calibrate: tuple[tuple[float, float], np.ndarray] | None = None,
    keep_inputs: bool = False,
    label: str = "",
) -> Run:
    """Run the loop for `duration` [s]. `truth(t)` sets the plant's masses and returns π that `ORACLE` is told.

    `plan` has a leading robot axis. `calibrate` is a window of time and which robots take their mean residual over it
    for a constant bias. What `watch` returns is recorded every tick. A robot that has fallen gets no torque.
    """
    started = last = time.monotonic()
    memory = spread(brain.start(None), fleet.size)
    memory = eqx.tree_at(lambda m: m.plan, memory, plan, is_leaf=lambda x: x is None)
    fell = np.full(fleet.size, np.inf)
    unsolved, unphysical = np.zeros(fleet.size), np.zeros(fleet.size)
    rows, times = [], []
    kept: list[Inputs] = []
    every: list[Inputs] = []
    ticks = round(duration / TICK)
    for k in range(ticks):
        t = k * TICK
        x = inputs(fleet.sense(), mode, truth(t), on(t) and fleet.seen)
        if calibrate is not None:
            (begin, end), chosen = calibrate
            if begin <= t < end:
                kept.append(x)
            elif t >= end and kept:
                memory = _calibrated(brain, memory, kept, chosen)
                kept = []
        if keep_inputs:
            every.append(x)
        memory, out = _tick(brain, memory, x)
        out = jax.tree.map(np.asarray, out)
        up = np.isinf(fell)
        fleet.step(np.where(up[:, None], out.torque, 0.0))
        ground = 0.0 if fleet.height is None else fleet.corners[..., 2].mean(axis=1)
        down = ~(fleet.q[:, 2] - ground > FALLEN)
        fell = np.where(up & down, t, fell)
        unsolved += up & ~out.converged
        unphysical += (up[:, None] & ~out.physical).any(axis=1)
        rows.append({name: np.array(v, np.float32) for name, v in watch(fleet, out).items()})
        times.append(t)
        if label and time.monotonic() - last > 5.0:
            last = time.monotonic()
            done = f"{t:5.1f} of {duration:.0f} s, {int(np.isinf(fell).sum())} of {fleet.size} up"
            print(f"  {label}: {done}, {last - started:.0f} s of work", file=sys.stderr, flush=True)
    series = {name: np.stack([row[name] for row in rows]) for name in rows[0]}
    return Run(
        np.array(times),
        mode,
        seed,
        series,
        fell,
        unsolved / ticks,
        unphysical,
        time.monotonic() - started,
        every,
    )


@eqx.filter_jit
def _follow(brain: Brain, state: State, x: Inputs) -> tuple:
    def one(state, x):
        state, step, pi = brain.follow(state, x)
        return state, (pi[0], is_physical(pi)[0], step.innovation.accepted, step.innovation.nis)

    return jax.vmap(one)(state, x)


def replay(brain: Brain, found: Run) -> Run:
    """The same run as another filter saw it; only for runs that no filter steered, and that kept their inputs."""
    state = spread(brain.estimator.initial(), len(found.seed))
    rows = []
    for x in found.inputs:
        state, row = _follow(brain, state, x)
        rows.append([np.asarray(part) for part in row])
    pi, physical, accepted, nis = (np.stack(part) for part in zip(*rows, strict=True))
    up = found.time[:, None] <= found.fell
    changed = {
        "mass": pi[..., 0],
        "inertia": pi[..., (4, 7, 9)],
        "physical": physical,
        "accepted": accepted,
        "nis": nis,
    }
    unphysical = (up & ~physical).sum(axis=0)
    return dataclasses.replace(found, series={**found.series, **changed}, unphysical=unphysical)


def _calibrated(brain: Brain, memory: Memory, kept: list[Inputs], chosen: np.ndarray) -> Memory:
    """Memory with the start-up bias of the chosen robots (Foster et al., sec. IV-B)."""
    window = jax.tree.map(lambda *x: np.stack(x, axis=1), *kept)

    def one(state, inputs):
        return brain.estimator.calibrate_bias(state, jax.vmap(brain.observation)(inputs))

    new = jax.jit(jax.vmap(one))(memory.filter, window)
    bias = jnp.where(jnp.asarray(chosen)[:, None], new.bias, memory.filter.bias)
    return eqx.tree_at(lambda m: m.filter.bias, memory, bias)


def crew(seeds: np.ndarray, modes: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """(mode, seed) of every robot: each seed with each mode, the same noise for all of its modes."""
    return np.repeat(modes, len(seeds)), np.tile(seeds, len(modes))


def rms(x: np.ndarray) -> np.ndarray:
    """Root mean square over time (axis 0)."""
    return np.sqrt(np.mean(np.asarray(x, float) ** 2, axis=0))


def summary(x: np.ndarray) -> dict[str, float]:
    """Median over seeds and the range of nine in ten; raises ValueError for numbers that are not finite."""
    x = np.asarray(x, float)
    if not np.isfinite(x).all():
        raise ValueError(f"{int((~np.isfinite(x)).sum())} of {x.size} numbers are not finite")
    return {
        "median": float(np.median(x)),
        "low": float(np.quantile(x, 0.05)),
        "high": float(np.quantile(x, 0.95)),
        "seeds": len(x),
    }


def by_controller(mode: np.ndarray, error: np.ndarray) -> dict[str, Any]:
    """Median of each controller by its name, and under `intervals` their `summary`."""
    rows = {name: summary(error[mode == i]) for i, name in enumerate(MODES) if np.any(mode == i)}
    return {**{name: row["median"] for name, row in rows.items()}, "intervals": rows}
