"""A recorded run of a position-controlled robot, and its motion on an even grid at which torques are evaluated.

Torques act over the steps of the grid, so the motion is that at the middle of each step and targets are means over it.
Samples of the log lie at every `every`-th edge of the grid.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy import interpolate, signal

from jax_inertia.logs.log import AnyArray
from jax_inertia.model.robot import Robot

LONGEST_STEP = 4e-3
"""Longest step of the grid [s]."""
STEPS_PER_RADIAN = 4.0
"""Steps in 1/ω of the stiffest loop: the trapezoidal rule is then right to (ω h)²/12 = 0.5 % in frequency."""
BAND = 25.0
"""Band of the measured motion [Hz]: above it, differences of encoders' positions are noise more than motion."""
STILL = 0.012
"""Slower than this [rad/s] a measured velocity tells no direction (as in `signals.dry_friction`)."""
STILL_REPLAYED = 1e-3
"""The same of a replay, whose velocities have no noise [rad/s]."""
SIGN_VELOCITY = 3e-3
"""Velocity over which friction's direction turns [rad/s]."""


class Run(NamedTuple):
    """One log of targets and encoder positions, in the log's order of joints; time starts at 0 s."""

    time: Float[np.ndarray, " T"]
    """Even stamps [s]."""
    q: Float[np.ndarray, "T n"]
    commanded_time: Float[np.ndarray, " S"]
    """Stamps of the targets; each holds from its stamp to the next [s]."""
    target: Float[np.ndarray, "S n"]
    kp: Float[np.ndarray, " n"]
    kd: Float[np.ndarray, " n"]
    limit: Float[np.ndarray, " n"]
    """Torque limit of the loop as the model states it, infinite where it states none [N m]."""
    counts: Float[np.ndarray, "T n"]
    """1 where a sample counts, 0 where not (the start of a replay, contacts)."""
    fed: Float[np.ndarray, "S n"] | None = None
    """Torque fed forward within the limit, kd q̇* + τ_ff, held like the targets; none where there is none [N m]."""
    of_steps: float = 1.0
    """What a simulation's own steps do to inertia, of kd times their half: 1, or −1 where kd is taken explicitly."""

    @property
    def period(self) -> float:
        """Of the log [s]."""
        return float(np.median(np.diff(self.time)))


class Grid(NamedTuple):
    """Even steps of a run: `every` of them from one sample of the log to the next."""

    step: float
    every: int
    steps: int

    @property
    def edges(self) -> Float[np.ndarray, " K1"]:
        """Times of the steps' edges [s]."""
        return self.step * np.arange(self.steps + 1)

    @property
    def middles(self) -> Float[np.ndarray, " K"]:
        """Times of the steps' middles [s]."""
        return self.step * (np.arange(self.steps) + 0.5)


def grid_of(run: Run, stiffest: float) -> Grid:
    """The grid for a run whose loop has a largest natural frequency `stiffest` [rad/s]."""
    return steps_of(run.period, len(run.time), stiffest)


def steps_of(period: float, samples: int, stiffest: float) -> Grid:
    """The grid for some samples of a log."""
    longest = min(LONGEST_STEP, 1.0 / (STEPS_PER_RADIAN * max(stiffest, 1e-9)))
    every = max(int(np.ceil(period / longest - 1e-9)), 1)
    return Grid(period / every, every, every * (samples - 1))


class Moments(NamedTuple):
    """A motion at the steps' middles: positions, velocities, accelerations and direction of dry friction (K, n)."""

    q: Float[AnyArray, "K n"]
    v: Float[AnyArray, "K n"]
    a: Float[AnyArray, "K n"]
    side: Float[AnyArray, "K n"]
    """Sign of the velocity; at rest the sign that the last motion had."""
    still: Float[AnyArray, "K n"]
    """1 where dry friction may hold the joint, else 0."""


def measured(run: Run, grid: Grid) -> Moments:
    """The motion of the encoders, below `BAND`, by cubic splines through the low-passed positions."""
    rate = 1.0 / run.period
    q = run.q
    if 0.4 * rate > BAND and len(q) > 30:
        sos = signal.butter(2, BAND, fs=rate, output="sos")
        q = np.asarray(signal.sosfiltfilt(sos, q, axis=0))
    noise = np.std(run.q - q, axis=0)
    # Noise that is left in the band has this velocity, rms.
    rough = 2.0 * np.pi * BAND / np.sqrt(3.0) * noise * np.sqrt(min(2.0 * BAND / rate, 1.0))
    return _moments(run.time, q, grid.middles, np.maximum(STILL, 2.0 * rough))


def replayed(path: Float[np.ndarray, "K1 n"], grid: Grid) -> Moments:
    """The motion of a replay, given at the grid's edges."""
    still = np.full(path.shape[1], STILL_REPLAYED)
    return _moments(grid.edges, path, grid.middles, still)


def _moments(time, q, at, still: Float[np.ndarray, " n"]) -> Moments:
    path = interpolate.make_interp_spline(time, q, k=min(3, len(time) - 1))
    q, v, a = (np.asarray(path(at, nu=k)) for k in range(3))
    return Moments(q, v, a, side_of(v, still), (np.abs(v) < still).astype(float))


def balanced(
    moments: Moments, rub: Float[AnyArray, "K n"], level: Float[AnyArray, "... n"]
) -> Moments:
    """A motion with what friction does at rest, where its torque is whatever balances.

    `rub`: what friction has to take for the joint to move as it does [N m]; `level`: what the model's friction can
    take [N m]. The model holds the joint where that is enough. Where it is not, the robot's friction F takes all of
    `rub` and the model's its `level`: of their difference F − level, in proportion, (|rub| − level)/(F − level). F is
    no less than what is seen at rest (95th percentile).
    """
    xp = _xp(rub, moments.still)
    still, size = moments.still > 0, abs(rub)
    lacking = xp.maximum(size - level, 0.0)
    # Of those at rest; where none is, nothing is read of it.
    some = still | ~xp.any(still, axis=0)
    seen = xp.nan_to_num(xp.nanpercentile(xp.where(some, lacking, xp.nan), 95.0, axis=0))
    share = xp.sign(rub) * xp.minimum(lacking / xp.maximum(seen, 1e-9), 1.0)
    held = still & (size < level)
    return moments._replace(side=xp.where(still, share, moments.side), still=held.astype(rub.dtype))


def side_of(v: Float[AnyArray, "K n"], still: Float[AnyArray, " n"]) -> Float[AnyArray, "K n"]:
    """Direction of dry friction: sign of the velocity, which a joint that comes to rest keeps.

    A joint that stops is held by the friction that stopped it, so its torque does not vanish at rest.
    """
    xp = _xp(v, still)
    steps = xp.where(abs(v) >= still, xp.arange(v.shape[0])[:, None], 0)
    last = np.maximum.accumulate(steps) if xp is np else jax.lax.cummax(steps, axis=0)
    return xp.tanh(xp.take_along_axis(v, last, axis=0) / SIGN_VELOCITY)


def _xp(*arrays: AnyArray) -> Any:
    """NumPy of a log's arrays, JAX where any is traced or on a device."""
    return np if all(isinstance(x, np.ndarray) for x in arrays) else jnp


class Targets(eqx.Module):
    """∫ q* dt of targets that are held from stamp to stamp: means over any stretch are its differences."""

    edges: Float[AnyArray, " S1"]
    area: Float[AnyArray, "S1 n"]

    @staticmethod
    def of(stamps: Float[np.ndarray, " S"], held: Float[np.ndarray, "S n"]) -> "Targets":
        """Of values that are held from their stamps to the next."""
        last = float(np.median(np.diff(stamps))) if len(stamps) > 1 else 1.0
        edges = np.append(stamps, stamps[-1] + last)
        area = np.cumsum(held * np.diff(edges)[:, None], axis=0)
        return Targets(edges, np.concatenate([np.zeros((1, area.shape[1])), area]))

    def mean(
        self, start: Float[AnyArray, " K"], step: float | Array, delay: Float[AnyArray, " n"]
    ) -> Float[AnyArray, "K n"]:
        """Mean of what arrives in each of the steps from `start`, each joint's targets late by `delay`."""
        xp = _xp(self.area, delay)
        at = xp.append(start, start[-1] + step)
        slopes = [(x[1] - x[0]) / (e[1] - e[0]) for x, e in (
            (self.area[:2], self.edges[:2]), (self.area[-2:], self.edges[-2:])
        )]  # fmt: skip

        def one(j: int) -> AnyArray:
            t = at - delay[j]
            inside = xp.interp(t, self.edges, self.area[:, j])
            inside = inside + xp.minimum(t - self.edges[0], 0.0) * slopes[0][j]
            inside = inside + xp.maximum(t - self.edges[-1], 0.0) * slopes[1][j]
            return xp.diff(inside) / step

        return xp.stack([one(j) for j in range(self.area.shape[1])], axis=1)


class Along(eqx.Module):
    """What columns of ordinary effects read of a motion, as JAX arrays, for batches: see `linearised.context` else.

    It has the names of `diagnosis.features.context.Context`, so that one library of effects serves both.
    """

    robot: Robot
    time: Float[AnyArray, " K"]
    v: Float[AnyArray, "K nv"]
    a: Float[AnyArray, "K nv"]
    side: Float[AnyArray, "K nv"]
    regressor: Float[AnyArray, "K nv nb 10"]
    """Torque regressor of all bodies."""
