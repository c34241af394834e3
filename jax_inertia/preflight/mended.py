"""A log without what it says that cannot be: samples that nobody measured, and velocities that contradict positions.

Each is left out by name, for every way from a log to a number: torques while drives are off and brakes hold, values
that no drive makes or that were never written, and an optional velocity channel that is not dqpos/dt.
"""

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType

import numpy as np
from jaxtyping import Bool, Float

from jax_inertia.logs.findings import Finding, Severity, run_bounds, spans
from jax_inertia.logs.log import Log, LogError
from jax_inertia.preflight import cross_channel
from jax_inertia.signals.filtering import mask
from jax_inertia.text.closest_names import listed

OPTIONAL = ("qvel",)
"""Channels that `mended` may be asked to ignore."""
# Drives are off where a torque is exactly zero for so long [s] while its joint does not move by so much [rad, m].
_OFF, _STILL = 0.1, 1e-3
_FEW = 10
"""Rows of a log, at least."""
# No drive makes more [N m, or any unit]; and what is smaller than this and not zero is no number that was written.
_MOST, _LEAST = 1e9, 1e-290
# Of the velocity's findings those that say it is another quantity than dqpos/dt; a sign or an order is the reader's to
# mend, since either channel may be the wrong one.
_DROPS = ("velocity", "scale", "delay")


def mended(
    log: Log, ignore: Sequence[str] = (), kinds: Mapping[str, str] = MappingProxyType({})
) -> tuple[Log, tuple[Finding, ...]]:
    """The log without what is no measurement, and what was left out, one line each.

    `ignore` names optional channels that are left out whatever they hold; `kinds` says of joints whether they are
    hinges or slides. Raises LogError for a channel that is not optional.

    >>> import dataclasses
    >>> from jax_inertia.preflight.mended import mended
    >>> from jax_inertia.robots.pendulum import swing
    >>> log, found = mended(dataclasses.replace(swing(), qvel=57.29578 * swing().qvel))
    >>> log.qvel is None, found[0].check
    (True, 'qvel')
    """
    if unknown := [name for name in ignore if name not in OPTIONAL]:
        raise LogError(f"{listed(unknown)} cannot be ignored; only {', '.join(OPTIONAL)} can")
    log, found = unmeasured(log)
    findings = [*found]
    if log.qvel is not None:
        if "qvel" in ignore:
            log = dataclasses.replace(log, qvel=None)
            findings.append(Finding(Severity.NOTE, "qvel", "qvel is ignored, as requested"))
        elif why := _contradiction(log, kinds):
            message = f"{why}; qvel is left out, and velocities are differences of positions"
            log = dataclasses.replace(log, qvel=None)
            findings.append(Finding(Severity.WARNING, "qvel", message))
    return log, tuple(findings)


def while_targeted(log: Log) -> tuple[Log, tuple[Finding, ...]]:
    """The log from the first moment to the last at which all joints have targets, and what was left out.

    Before, something else held the robot, which no replay of targets does.

    >>> import dataclasses
    >>> import numpy as np
    >>> from jax_inertia.preflight.mended import while_targeted
    >>> from jax_inertia.robots.pendulum import swing
    >>> target = np.array(swing().qpos)
    >>> target[:80] = np.nan
    >>> log, found = while_targeted(dataclasses.replace(swing(), qpos_target=target))
    >>> float(log.time[0]), found[0].check
    (0.8, 'targets')
    """
    if log.qpos_target is None:
        return log, ()
    good = np.isfinite(np.asarray(log.qpos_target, float))
    if not good.any(axis=0).all():
        return log, ()
    first = int(np.argmax(good, axis=0).max())
    last = len(good) - int(np.argmax(good[::-1], axis=0).max())
    if last - first in (len(good), 0) or last - first < _FEW:
        return log, ()
    time = np.asarray(log.time, float)
    message = (
        f"targets are there from {time[first]:.4g} to {time[last - 1]:.4g} s; the rest of the log is left out, since "
        "something else held the robot"
    )
    kept = log.map_channels(lambda x: np.asarray(x)[first:last], time=time[first:last])
    return kept, (Finding(Severity.WARNING, "targets", message),)


def unmeasured(log: Log) -> tuple[Log, tuple[Finding, ...]]:
    """The log, or a chunk of it, with torques that nobody measured masked, and which they were.

    >>> import dataclasses
    >>> import numpy as np
    >>> from jax_inertia.preflight.mended import unmeasured
    >>> from jax_inertia.robots.pendulum import swing
    >>> tau = np.array(swing().tau)
    >>> tau[3, 1] = 1e224
    >>> log, found = unmeasured(dataclasses.replace(swing(), tau=tau))
    >>> bool(np.isnan(log.tau[3, 1])), found[0].message
    (True, "tau of 'elbow' has 1 value that no drive makes (1e+224): masked")
    """
    if log.tau is None:
        return log, ()
    log, absurd = _without_absurd(log)
    log, brakes = _without_brakes(log)
    return log, (*absurd, *brakes)


def _without_absurd(log: Log) -> tuple[Log, list[Finding]]:
    tau = np.asarray(log.tau)
    size = np.abs(tau)
    huge, never = size > _MOST, (size > 0) & (size < _LEAST)
    if not (bad := (huge | never) & np.isfinite(tau)).any():
        return log, []
    findings = []
    for where, what in ((huge, "that no drive makes"), (never, "that nobody wrote")):
        for j in np.flatnonzero((where & bad).any(axis=0)):
            values = tau[where[:, j] & bad[:, j], j]
            worst = values[np.argmax(np.abs(values))]
            message = (
                f"tau of {log.joint_names[j]!r} has {len(values)} value{'s' * (len(values) > 1)} {what} "
                f"({worst:.3g}): masked"
            )
            findings.append(Finding(Severity.WARNING, "absurd", message))
    return dataclasses.replace(log, tau=np.where(bad, np.nan, tau)), findings


def _without_brakes(log: Log) -> tuple[Log, list[Finding]]:
    """Torques exactly zero while their joint stands still, in a log whose torque is not zero elsewhere."""
    time, tau, q = (np.asarray(x, float) for x in (log.time, log.tau, log.qpos))
    off = np.zeros(tau.shape, bool)
    for j in range(tau.shape[1]):
        for a, b in _runs(time, tau[:, j]):
            off[a:b, j] = np.ptp(np.nan_to_num(q[a:b, j], nan=np.inf)) < _STILL
        # A joint that nothing loads or drives has no torque, and says so.
        elsewhere = np.abs(tau[~off[:, j] & np.isfinite(tau[:, j]), j])
        if not (elsewhere.size and np.median(elsewhere) > 0):
            off[:, j] = False
    if not off.any():
        return log, []
    joints = [log.joint_names[j] for j in np.flatnonzero(np.any(off, axis=0))]
    when = spans(time, np.asarray(np.any(off, axis=1)))
    message = (
        f"tau of {listed(joints)} is exactly 0 while standing still ({when}): drives are off and brakes hold, which no "
        "torque tells; left out"
    )
    log = dataclasses.replace(log, tau=np.where(off, np.nan, tau))
    # Where nothing at all was driven, at either end, there is no log.
    driven = np.flatnonzero(np.any(np.isfinite(tau) & (tau != 0) & ~off, axis=1))
    rows = slice(int(driven[0]), int(driven[-1]) + 1)
    log = log.map_channels(lambda x: np.asarray(x)[rows], time=time[rows])
    return log, [Finding(Severity.WARNING, "brakes", message)]


def _runs(time: Float[np.ndarray, " T"], tau: Float[np.ndarray, " T"]) -> Iterator[tuple[int, int]]:
    zero: Bool[np.ndarray, " T"] = tau == 0
    for a, b in run_bounds(zero):
        if time[b - 1] - time[a] >= _OFF:
            yield int(a), int(b)


def _contradiction(log: Log, kinds: Mapping[str, str]) -> str:
    """Why qvel is no dqpos/dt; empty where it is, or a sign or an order would make it so."""
    time = np.asarray(log.time, float)
    if len(time) < 10 or not np.all(np.diff(time) > 0):
        return ""
    whole = mask(log).log
    with np.errstate(all="ignore"):
        speed = np.abs(np.asarray(whole.qvel))
        for j, name in enumerate(log.joint_names):
            # A tenth of a radian in all is motion.
            if np.ptp(np.asarray(whole.qpos)[:, j]) > 0.1 and not np.any(speed[:, j] > 0):
                return f"qvel of {name!r} is zero while qpos moves"
        found = list(cross_channel.velocity(whole, time, kinds))
    if any(one.check in ("sign", "swapped") for one in found):
        return ""
    return next((one.message for one in found if one.check in _DROPS), "")
