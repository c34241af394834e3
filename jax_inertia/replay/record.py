"""What a replay needs of a log: positions, and commands of the joints as means over the steps of a simulation."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.signal import lfilter

from jax_inertia.logs.log import Log
from jax_inertia.replay.joint_numbers import Numbers
from jax_inertia.replay.loop import Loop

SETTLING = 0.2
"""Of a replay's start, what does not count at least [s]."""
_LATE_AT_MOST = 1e-6
_IS_THE_LOOPS = 0.2


class Commanded(NamedTuple):
    """All that the joints were commanded, before a stretch too: who is late still follows it."""

    time: Float[np.ndarray, " S"]
    position: Float[np.ndarray, "S n"]
    velocity: Float[np.ndarray, "S n"] | None = None
    """Targets of velocity, in kd (q̇* − q̇); none where they are 0."""
    torque: Float[np.ndarray, "S n"] | None = None
    """Fed forward, within the torque limit."""

    @property
    def of_positions(self) -> "Commanded":
        """The targets of position alone."""
        return Commanded(self.time, self.position)

    def upto(self, last: int, zero: float) -> "Commanded":
        """The first rows, their clock's zero moved."""
        velocity, torque = (None if x is None else x[:last] for x in self[2:])
        return Commanded(self.time[:last] - zero, self.position[:last], velocity, torque)


class Record(NamedTuple):
    """A log, or a stretch of it: from 0 s, in the log's order of joints."""

    time: Float[np.ndarray, " T"]
    q: Float[np.ndarray, "T n"]
    start: Float[np.ndarray, " n"]
    """Velocities at the first stamp."""
    commanded: Commanded
    loop: Loop | None = None
    """Gains while this was recorded; none where they are those of the plant."""
    torque: Float[np.ndarray, "T n"] | None = None
    """What the loop gave, where it was logged [N m]."""
    velocity: Float[np.ndarray, "T n"] | None = None
    """As the drive measured it, where it did and torque is logged."""
    touched: Bool[np.ndarray, " T"] | None = None
    """Samples in which the robot touches something, so that they do not count."""
    settles: float = SETTLING
    """Of its start, what does not count [s], and no more than a tenth of it."""

    @property
    def period(self) -> float:
        """Median, s."""
        return float(np.median(np.diff(self.time)))

    @property
    def tau(self) -> Float[np.ndarray, "T n"]:
        """The torque that was logged; ValueError where none was."""
        if self.torque is None:
            raise ValueError("the record holds no torque")
        return self.torque

    @property
    def head(self) -> slice:
        """Samples that tell the integral of a drive at the first stamp: at the end of what does not count."""
        end = min(SETTLING, 0.1 * self.time[-1])
        first, last = np.searchsorted(self.time, [0.5 * end, end], side="right").tolist()
        return slice(first, max(last, first + 1))

    def upto(self, last: int) -> "Record":
        """The first samples alone."""
        tau, velocity, touched = (None if x is None else x[:last] for x in self[5:8])
        return self._replace(
            time=self.time[:last], q=self.q[:last], torque=tau, velocity=velocity, touched=touched
        )

    @property
    def target(self) -> Float[np.ndarray, "T n"]:
        """Positions commanded at the stamps of the stretch."""
        first = len(self.commanded.time) - len(self.time)
        return self.commanded.position[first:]

    @property
    def settled(self) -> Bool[np.ndarray, " T"]:
        """Samples that count: what was commanded before the log began, and how fast joints were, is soon forgotten."""
        settled = self.time >= min(self.settles, 0.1 * self.time[-1])
        return settled if self.touched is None else settled & ~self.touched

    def between(self, first: int, last: int) -> "Record":
        """The samples of a range of rows, as a record of its own."""
        q, time = self.q[first:last], self.time[first:last]
        before = len(self.commanded.time) - len(self.time)
        commanded = self.commanded.upto(before + first + len(time), time[0])
        every = self.torque, self.velocity, self.touched
        tau, velocity, touched = (None if x is None else x[first:last] for x in every)
        seen = tau, velocity, touched, SETTLING if first else self.settles
        start = speed_at(self.time, self.q, first) if first else self.start
        return Record(time - time[0], q, start, commanded, self.loop, *seen)


def record_of(log: Log, loop: Loop | None = None, *, torque: bool = False) -> Record:
    """The record of a log with targets, what is not finite bridged; with its torques where asked for."""
    time = np.asarray(log.time, float)
    time = time - time[0]
    q, target = (_bridged(time, np.asarray(x, float)) for x in (log.qpos, log.qpos_target))
    speed = None if log.qvel_target is None else np.nan_to_num(np.asarray(log.qvel_target, float))
    fed = None
    if feeds_forward(log, loop):
        fed = np.nan_to_num(np.asarray(log.tau_command, float))
    logged = log.tau if torque else None, log.qvel if torque else None
    tau, velocity = (None if x is None else _bridged(time, np.asarray(x, float)) for x in logged)
    commanded = Commanded(time, target, speed, fed)
    return Record(time, q, slope(time, q), commanded, loop, tau, velocity)


def feeds_forward(log: Log, loop: Loop | None) -> bool:
    """Whether `tau_command` is a torque added to the loop's, and not what the loop made of its targets.

    It is the loop's where four fifths of its variance are kp (q* − q) at all joints that have any.
    """
    if log.tau_command is None or loop is None:
        return False
    tau = np.nan_to_num(np.asarray(log.tau_command, float))
    spring = loop.kp * (np.asarray(log.qpos_target, float) - np.asarray(log.qpos, float))
    rest = np.nanvar(tau - spring, axis=0)
    moves = np.var(tau, axis=0) > 0
    return bool(moves.any() and not np.all((rest < _IS_THE_LOOPS * np.var(tau, axis=0))[moves]))


def _bridged(time: np.ndarray, x: np.ndarray) -> np.ndarray:
    out = x.copy()
    for column in out.T:
        good = np.isfinite(column)
        if good.any() and not good.all():
            column[~good] = np.interp(time[~good], time[good], column[good])
    return out


def slope(time: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Velocity at the start, by a parabola through the first 50 ms or five samples."""
    k = max(5, int(np.searchsorted(time - time[0], 0.05)))
    k = min(k, len(time))
    t = time[:k] - time[0]
    return _tangent(t, q[:k], 2)


def speed_at(time: np.ndarray, q: np.ndarray, row: int) -> np.ndarray:
    """Velocity at a row, by a cubic through 50 ms or three samples to either side: a robot in motion jerks, too."""
    wide = max(3, int(np.searchsorted(time - time[0], 0.05)))
    near = slice(max(row - wide, 0), row + wide + 1)
    t = time[near] - time[row]
    return _tangent(t, q[near], min(3, len(t) - 1))


def _tangent(t: np.ndarray, q: np.ndarray, degree: int) -> np.ndarray:
    """Slope at t = 0 of a polynomial through samples."""
    return np.linalg.lstsq(np.stack([t**k for k in range(degree + 1)], 1), q, rcond=None)[0][1]


def step_means(
    time: Float[np.ndarray, " S"],
    held: Float[np.ndarray, "S n"],
    h: float,
    steps: int,
    delay: Float[np.ndarray, " n"],
    lag: Float[np.ndarray, " n"],
) -> Float[np.ndarray, "K n"]:
    """The mean over each step of what is held from stamp to stamp, delayed and behind a first-order lag.

    Means, not samples: a delay of a part of a step counts, and replays are smooth in it.
    """
    edges = np.append(time, time[-1] + float(np.median(np.diff(time))))
    area_of = held * np.diff(edges)[:, None]
    whole = np.concatenate([np.zeros((1, held.shape[1])), np.cumsum(area_of, axis=0)])
    at = np.arange(steps + 1) * h
    out = np.empty((steps, held.shape[1]))
    for j, (d, late) in enumerate(zip(delay, lag, strict=True)):
        t = at - d
        area = np.interp(t, edges, whole[:, j])
        # Before the first target and after the last it is held.
        area += np.minimum(t - edges[0], 0.0) * held[0, j]
        area += np.maximum(t - edges[-1], 0.0) * held[-1, j]
        out[:, j] = np.diff(area) / h
        if late > _LATE_AT_MOST:
            keep = np.exp(-h / late)
            out[:, j] = lfilter([1 - keep], [1, -keep], out[:, j], zi=[keep * out[0, j]])[0]
    return out


def low_passed(
    time: Float[np.ndarray, " S"],
    held: Float[np.ndarray, "S n"],
    period: float,
    constant: Float[np.ndarray, " n"],
) -> Float[np.ndarray, "S n"]:
    """What is held from stamp to stamp, y ← y + (1 − exp(−T/τ)) (x − y) once a `period` T from the first stamp on."""
    if not constant.any():
        return held
    due = np.floor((time - time[0]) / period + 1e-6)
    updates = np.diff(due, prepend=-1.0) > 0
    out, which = np.array(held, float), np.cumsum(updates) - 1
    for j in np.flatnonzero(constant):
        keep = np.exp(-period / constant[j])
        x = held[updates, j]
        out[:, j] = lfilter([1 - keep], [1, -keep], x, zi=[keep * x[0]])[0][which]
    return out


def target_period(records: Sequence["Record"]) -> float:
    """How often targets change [s]: the median time between two changes of any; the log's period at least."""
    gaps = []
    for r in records:
        changed = np.any(np.diff(r.commanded.position, axis=0) != 0, axis=1)
        gaps.append(np.diff(r.commanded.time[1:][changed]))
    every = np.concatenate(gaps)
    return max(float(np.median(every)), records[0].period) if len(every) else records[0].period


def filtered_parts(
    delay: Float[np.ndarray, " n"], lag: Float[np.ndarray, " n"], whole: float, h: float
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """(delay, lag) in steps h of what has a delay and a lag in steps `whole` H, whose parts no buffer can hold.

    A filter that acts at once, y ← y + (1 − a)(x − y), is late by h a / (1 − a); with a = exp(−H/T) by H / (exp(H/T)
    − 1). A delay below H is a filter's.
    """
    part = delay < whole
    lagged = np.where(lag > 0, whole / np.expm1(whole / np.maximum(lag, 0.01 * whole)), 0.0)
    late = np.maximum(delay + lagged, 1e-12)
    return np.where(part, 0.0, delay), np.where(part, h / np.log1p(h / late), lag)


def controls(
    record: Record, h: float, steps: int, x: Numbers, late: float = 0.0, whole: float = 0.0
) -> Float[np.ndarray, "K n"]:
    """What a position loop is commanded at each step: q* + (kd q̇* + τ_ff)/kp, each as late as the targets and `late`.

    `whole`: the steps that delays are of (`filtered_parts`); 0 where a delay of any length is one.
    """
    commanded = record.commanded
    targets = low_passed(
        commanded.time, commanded.position, float(x.low_pass_period[0]), x.low_pass
    )
    delay, lag = x.delay, x.lag
    if whole:
        delay, lag = filtered_parts(delay, lag, whole, h)
    delay = delay + late
    out = step_means(commanded.time, targets, h, steps, delay, lag)
    for more, gain in ((commanded.velocity, x.kd / x.kp), (commanded.torque, 1.0 / x.kp)):
        if more is not None:
            out += gain * step_means(commanded.time, more, h, steps, delay, lag)
    return out
