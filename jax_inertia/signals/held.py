"""What a torque in a log stands for, moment by moment, where a drive holds something from one sample to the next.

A value that is held over a period acts half a period late, as seen from its stamp. No drive is as slow as a log of
50 Hz, whose torques may be of the moment or means over the period: `Timing`. In a log slower than its drive it is the
targets q* of a position loop that are held, not its torque: τ = kp (q* − q) − kd q̇ follows the joint many times
a sample. Put off as a whole, by 10 ms at 50 Hz, kp q would pass for a damping of kp · 10 ms. And each new target jolts
the joint; the log, which sees every jolt at the same moment, takes the jolt's torque for a part of the mean.

So near a target that moves at a steady V, with the joints' inertia M between jolts and r the part of q that repeats
with the period h,

    M r̈ + kd ṙ + kp r = kp V (h/2 − t),  0 ≤ t < h,        τ(0) − τ̄ = M r̈(0) = kp V h/2 − kp r(0) − kd ṙ(0)

is by how much the sampled torque exceeds the mean one. A loop much slower than h leaves kp V h/2, half a period; one
that settles within it leaves more. The loop itself holds its torque for some δ, and so is late by d = δ/2: its mean is
kp V d more, and the jolts are those of kd − kp d and M − kd d.

A log of 100 Hz and more sees the jolts as they go. There the law itself gives the mean over a sample's hold, from the
mean of q over it and from (q₊ − q)/T, which is the mean velocity whatever jolts there were.
"""

import dataclasses
from typing import NamedTuple

import equinox as eqx
import numpy as np
import scipy.linalg
import scipy.optimize
from jaxtyping import Bool, Float
from scipy import interpolate, ndimage

from jax_inertia.logs.log import AnyArray, Log, LogError, TorqueKind
from jax_inertia.maths.finite_difference import derivative

FASTER = 100.0
"""Logs of this rate [Hz] and more see what a new target does to a joint before the next sample."""
LOOP_LATE, LOOP_LATE_ERROR = 1e-3, 0.7
"""How late the loop itself is [s], and how well that is known, relative: half the hold of loops of 250 Hz to 1 kHz and
more."""
# Of a torque's variance that targets, positions and velocities must explain for it to be a position loop's.
_LOOP = 0.9


SLOWEST_DRIVE = 200.0
"""Rate [Hz] of the slowest drives: a log below it keeps some of their torques only."""


HOLD_ERROR = 0.08
"""Standard deviation of when within its period a torque acts, of the period, where its law tells, as a position loop's
does; and of either end of what stamps may mean (`Timing`)."""


class Timing(NamedTuple):
    """When a logged torque acts after its stamp, shares of the log's period."""

    late: float
    error: float
    """Standard deviation."""
    most: float
    """By which it can be off."""


def timing_of(log: Log) -> Timing:
    """When a log's torques act after their stamps.

    A commanded torque or a current is held over its drive's period, half of which it is late: of the log's, if the
    drive is as slow, next to nothing if it is many times as fast. A sensor's sample may be of the moment or of the
    period that follows, and so may any where nobody says what it is, and every sample of a log that is slower than its
    drive: a quarter of it.
    """
    if log.rate < SLOWEST_DRIVE or log.tau_kind in (TorqueKind.UNKNOWN, TorqueKind.SENSOR):
        return Timing(0.25, 0.25, 0.25)
    return Timing(0.5, 0.25, 0.5)


class PositionLoop(eqx.Module):
    """τ = kp (q* − q) − kd q̇ of each joint of a log; zero where none shows [N m/rad, N m s/rad]."""

    kp: Float[np.ndarray, " n"]
    kd: Float[np.ndarray, " n"]


def later(x: AnyArray, share: float) -> Float[np.ndarray, "T *c"]:
    """Samples put off by a share of their period, along the cubic through four of them.

    Along straight lines a half would lose (ω h)² / 8 of a torque of angular rate ω, as a slow drive does.
    """
    x, s = np.asarray(x, float), share
    # Lagrange's weights of the sample after, its own, the one before and the one before that.
    after, own = -s * (s - 1) * (s - 2) / 6, (s + 1) * (s - 1) * (s - 2) / 2
    before, long_before = -(s + 1) * s * (s - 2) / 2, (s + 1) * s * (s - 1) / 6
    far = np.concatenate([x[:1], x[:1], x, x[-1:]])
    return after * far[3:] + own * far[2:-1] + before * far[1:-2] + long_before * far[:-3]


def put_off(x: Float[np.ndarray, "T c"], samples: float) -> Float[np.ndarray, "T c"]:
    """Signals put off by any number of samples, of either sign; before the first and after the last they are mirrored.

    A turn of each frequency's phase: exact below half the rate, where differences of neighbours lose (ω h)² / 6 of a
    slope.

    >>> t = np.arange(64.0)
    >>> np.round(put_off(np.cos(np.pi * (t + 0.5) / 16)[:, None], 0.25)[:3, 0], 6)
    array([0.998795, 0.970031, 0.903989])
    """
    padded = np.concatenate([x, x[::-1]])
    frequency = np.fft.rfftfreq(len(padded))[:, None]
    turned = np.fft.rfft(padded, axis=0) * np.exp(-2j * np.pi * frequency * samples)
    return np.fft.irfft(turned, len(padded), axis=0)[: len(x)]


def with_loop_torque(
    log: Log,
    kp: AnyArray | None,
    kd: AnyArray | None = None,
    limit: AnyArray | float = np.inf,
    source: str = "log",
) -> Log:
    """The log with the torque [N m] that its position loop gives, τ = kp (q* − q) − kd q̇ within ± `limit`.

    The gains [N m/rad, N m s/rad] are of each joint, and said in the log's notes with their `source`. Raises LogError
    where nobody says kp, or the log has no targets.
    """
    if log.qpos_target is None or kp is None:
        lacks = "position targets (qpos_target)" if log.qpos_target is None else "gain (kp)"
        raise LogError(
            f"the log has no torque (tau), and what its position loop gives is not known without its {lacks}; log it, "
            "or give --kp and --kd"
        )
    q = np.asarray(log.qpos, float)
    v = derivative(np.asarray(log.time, float), q) if log.qvel is None else np.asarray(log.qvel)
    damping = np.zeros(q.shape[1]) if kd is None else np.asarray(kd, float)
    pull = np.asarray(kp, float) * (np.asarray(log.qpos_target, float) - q)
    said = [
        f"{name} {' to '.join(f'{x:.4g}' for x in sorted({float(gains.min()), float(gains.max())}))}"
        for name, gains in (("kp", np.asarray(kp, float)), ("kd", damping))
    ]
    note = (
        "no torque in the log: it is computed from the position loop, kp (q* − q) − kd q̇, with "
        f"{said[0]} N m/rad and {said[1]} N m s/rad of the {source}; where kp is off by 1 %, so is "
        "all that legs are found to carry"
    )
    # A loop is many times as fast as its log: its torque is that of the moment, and hardly late.
    return dataclasses.replace(
        log,
        tau=np.clip(pull - damping * v, -limit, limit),
        tau_kind=TorqueKind.SENSOR,
        notes=(*log.notes, note),
    )


def position_loop(log: Log) -> PositionLoop | None:
    """The position loop behind a log's torques, by least squares; None where the log shows none.

    A joint has one where nine tenths of its torque's variance are kp (q* − q) − kd q̇, kd not below zero: what feeds the
    motion forward errs as the motion goes, and may seem to be pushed along it. Every value must be finite.
    """
    if log.qpos_target is None:
        return None
    target, q, tau = (np.asarray(x, float) for x in (log.qpos_target, log.qpos, log.tau))
    v = derivative(np.asarray(log.time), q) if log.qvel is None else np.asarray(log.qvel, float)
    gains = np.zeros((tau.shape[1], 2))
    for j, torque in enumerate(tau.T):
        rows = _between_targets(target[:, j]) if log.rate >= FASTER else slice(None)
        columns = np.stack([target[:, j] - q[:, j], -v[:, j], np.ones(len(q))], axis=1)[rows]
        fit = scipy.optimize.lsq_linear(columns, torque[rows], ([0.0, 0.0, -np.inf], np.inf)).x
        left = torque[rows] - columns @ fit
        if fit[0] > 0 and np.var(left) <= (1.0 - _LOOP) * np.var(torque[rows]):
            gains[j] = fit[:2]
    return PositionLoop(*gains.T) if gains.any() else None


def _between_targets(target: Float[np.ndarray, " T"]) -> slice | Bool[np.ndarray, " T"]:
    """Samples at which no new target jolts the joint, where differences give its velocity; all, where most have one."""
    same = np.diff(target, prepend=np.nan) == 0.0
    return same if same.mean() > 0.5 else slice(None)


def of_loop(
    log: Log,
    loop: PositionLoop,
    at: Float[np.ndarray, " m"],
    inertia: Float[np.ndarray, "m n n"],
) -> Float[np.ndarray, "T n"]:
    """Mean torque about each stamp of the joints that have a loop, the others' as logged [N m].

    `inertia`: of the log's joints, rotors included, at the times `at`; between them jolts are interpolated.
    """
    target, q = np.asarray(log.qpos_target, float), np.asarray(log.qpos, float)
    time = np.asarray(log.time)
    late = _late(loop, inertia, log.rate)
    v = derivative(time, q)
    follows = late * (loop.kp * v + loop.kd * derivative(time, v)) * (loop.kp > 0)
    if log.rate >= FASTER:
        return later(_over_holds(log, loop, v), 0.5) + follows
    jolts = np.stack([_jolt(loop, x, 1.0 / log.rate, late) for x in inertia])
    jolt = interpolate.make_interp_spline(at, jolts, k=1)(time) if len(at) > 1 else jolts
    # −V h/2, also where V changes.
    held = later(target, 0.5) - target
    return np.asarray(log.tau) + np.einsum("tij,tj->ti", jolt, held) + follows


def _over_holds(
    log: Log, loop: PositionLoop, v: Float[np.ndarray, "T n"]
) -> Float[np.ndarray, "T n"]:
    """Mean torque from each stamp to the next [N m], by a loop that is many times as fast.

        τ̄ = kp (q* − q̄) − kd (q₊ − q) / T + r

    q̄: mean of the cubic through four positions. r is what the law leaves of the logged torque (offsets, what is fed
    forward): of three samples the median, since differences of positions miss a loop's velocity at a new target.
    """
    target, q = np.asarray(log.qpos_target, float), np.asarray(log.qpos, float)
    far = np.concatenate([q[:1], q, q[-1:], q[-1:]])
    before, own, after, beyond = far[:-3], far[1:-2], far[2:-1], far[3:]
    mean = (13.0 * (own + after) - before - beyond) / 24.0
    step = np.diff(np.asarray(log.time), append=np.nan)
    step[-1] = step[-2]
    left = np.asarray(log.tau) - loop.kp * (target - q) + loop.kd * v
    fed = ndimage.median_filter(left, (3, 1), mode="nearest")
    return loop.kp * (target - mean) - loop.kd * (after - own) / step[:, None] + fed


def loop_late(rate: float) -> float:
    """How late a position loop is [s] that a log of some rate [Hz] samples: it is no slower than its log."""
    return min(LOOP_LATE, 0.5 / rate)


def lateness(
    loop: PositionLoop, rate: float, v: Float[np.ndarray, "T n"], a: Float[np.ndarray, "T n"]
) -> Float[np.ndarray, "T n"]:
    """Torque of one standard deviation of how late a loop is, seen by a log of some rate [Hz]: σ_d (kp q̇ + kd q̈) [N m].

    The loop's period is in no log: this passes for friction and rotor inertia of all its joints at once.
    """
    return LOOP_LATE_ERROR * loop_late(rate) * (loop.kp * v + loop.kd * a)


def _late(loop: PositionLoop, inertia: Float[np.ndarray, "m n n"], rate: float) -> float:
    """How late the loop is [s]; a loop of d > M / kd would not be stable, and one of half that hardly is."""
    own = np.diagonal(inertia, axis1=1, axis2=2).min(axis=0)
    return float(np.min(0.5 * own / np.maximum(loop.kd, 1e-9), initial=loop_late(rate)))


def _jolt(
    loop: PositionLoop, inertia: Float[np.ndarray, "n n"], period: float, late: float
) -> Float[np.ndarray, "n n"]:
    """By how much the torque at a new target exceeds the mean one, for each V h/2 of the targets [N m/rad]."""
    kp, kd, h = np.diag(loop.kp), np.diag(loop.kd), period
    one, none, n = np.eye(len(kp)), np.zeros_like(kp), len(kp)
    inverse = np.linalg.inv(inertia - late * kd)
    # d/dt of r, ṙ, the torque kp V (h/2 − t), and V.
    rates = [
        [none, one, none, none],
        [-inverse @ kp, -inverse @ (kd - late * kp), inverse, none],
        [none, none, none, -kp],
        [none, none, none, none],
    ]
    after = scipy.linalg.expm(h * np.block(rates))[: 2 * n]
    forced = after[:, 2 * n : 3 * n] @ kp * (h / 2) + after[:, 3 * n :]
    # Joints without a loop have nothing that makes them return.
    start = np.linalg.lstsq(np.eye(2 * n) - after[:, : 2 * n], forced, rcond=None)[0]
    return kp - (kp @ start[:n] + kd @ start[n:]) * (2 / h)
