"""Command → torque: what a loop that is known makes of its targets, where torque is logged too.

Joint by joint, over delays of the targets on a grid and then between its points, the least squares

    τ = kp (q*(t − d) − q) − kd q̇ + b

of the rows whose torque is not at its extreme. q̇ is as logged, or the slope of q. A sample of a log at stamp t is
taken before the loop acts on it, or after, or the loop is slower: d is known to about a period of the loop.
"""

import dataclasses

import numpy as np
from jaxtyping import Float

from jax_inertia.logs.log import Log
from jax_inertia.maths.finite_difference import derivative
from jax_inertia.replay.fit import autocorrelation_time

_LONGEST = 0.1
_CLEAR = 0.9
_PLATEAU = 0.01
_LOOP_PERIOD = 2e-3
_GAIN_TOLERANCE = 0.03


@dataclasses.dataclass(frozen=True)
class Half:
    """One joint's loop as its torque shows it; `*_sd` are standard deviations."""

    joint: str
    kp: float
    kp_sd: float
    kd: float
    kd_sd: float
    delay: float
    delay_sd: float
    bias: float
    limit: float | None
    """At which the torque stays [N m]; None where it does not."""
    explained: float
    """Of the torque's variance."""


def command_half(log: Log) -> tuple[Half, ...]:
    """The loops that a log with targets and torque shows; joints without a clear one are left out.

    A joint has a clear loop where nine tenths of its torque's variance are of this form.
    """
    if log.tau is None or log.qpos_target is None:
        return ()
    time = np.asarray(log.time, float)
    q, target, tau = (np.asarray(x, float) for x in (log.qpos, log.qpos_target, log.tau))
    v = derivative(time, q) if log.qvel is None else np.asarray(log.qvel, float)
    out = []
    for j, name in enumerate(log.joint_names):
        found = _joint(name, time, q[:, j], v[:, j], target[:, j], tau[:, j])
        if found is not None and found.explained >= _CLEAR and found.kp > 0:
            out.append(found)
    return tuple(out)


def _joint(name, time, q, v, target, tau) -> Half | None:
    limit = _plateau(tau)
    # What a late robot was commanded before the log began is not in it.
    known = time >= time[0] + min(_LONGEST, 0.1 * (time[-1] - time[0]))
    good = known & np.isfinite(q) & np.isfinite(v) & np.isfinite(target) & np.isfinite(tau)
    if limit is not None:
        good &= np.abs(tau) < 0.98 * limit
    if good.sum() < 20 or np.var(tau[good]) == 0:
        return None
    period = float(np.median(np.diff(time)))
    grid = np.arange(-2 * period, _LONGEST, min(period, 1e-3))
    fits = [_at(d, time, q, v, target, tau, good) for d in grid]
    best = int(np.argmin([f[1] for f in fits]))
    lo, hi = grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)]
    delay = _golden(lambda d: _at(d, time, q, v, target, tau, good)[1], lo, hi)
    (kp, kd, bias), square, columns = _at(delay, time, q, v, target, tau, good)
    rest = tau[good] - columns @ np.array([kp, kd, bias])
    correlated = autocorrelation_time(rest)
    step = max(period, 1e-4)
    slope = (
        (_held(time, target, time - delay - step) - _held(time, target, time - delay + step))[good]
        * kp
        / (2 * step)
    )
    whole = np.column_stack([columns, slope])
    variance = max(square, 1e-300) * correlated
    covariance = variance * np.linalg.pinv(whole.T @ whole)
    sd = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
    return Half(
        name,
        kp,
        float(sd[0]),
        kd,
        float(sd[1]),
        delay,
        # A loop acts somewhere within its own period.
        float(np.hypot(sd[3], min(period, _LOOP_PERIOD) / np.sqrt(12.0))),
        bias,
        limit,
        float(1.0 - square / np.var(tau[good])),
    )


def _held(time: np.ndarray, x: np.ndarray, at: np.ndarray) -> np.ndarray:
    """The last target at or before each moment, and between stamps the mean over one of the log's periods."""
    period = float(np.median(np.diff(time)))
    edges = np.append(time, time[-1] + period)
    whole = np.concatenate([[0.0], np.cumsum(x * np.diff(edges))])
    late, early = np.interp(at + period / 2, edges, whole), np.interp(at - period / 2, edges, whole)
    late += (
        np.minimum(at + period / 2 - edges[0], 0.0) * x[0]
        + np.maximum(at + period / 2 - edges[-1], 0) * x[-1]
    )
    early += (
        np.minimum(at - period / 2 - edges[0], 0.0) * x[0]
        + np.maximum(at - period / 2 - edges[-1], 0) * x[-1]
    )
    return (late - early) / period


def _at(delay, time, q, v, target, tau, good) -> tuple[np.ndarray, float, np.ndarray]:
    """Coefficients, mean square that they leave, and columns, at one delay."""
    # A stamp at which a target is sent is one at which it is in force.
    told = _held(time, target, time - delay + 0.5 * float(np.median(np.diff(time))))
    columns = np.stack([told - q, -v, np.ones(len(q))], 1)[good]
    fit = np.linalg.lstsq(columns, tau[good], rcond=None)[0]
    return fit, float(np.mean((tau[good] - columns @ fit) ** 2)), columns


def _golden(cost, low: float, high: float) -> float:
    ratio = 0.5 * (np.sqrt(5.0) - 1.0)
    for _ in range(20):
        a, b = high - ratio * (high - low), low + ratio * (high - low)
        low, high = (low, b) if cost(a) < cost(b) else (a, high)
    return 0.5 * (low + high)


def _plateau(tau: Float[np.ndarray, " T"]) -> float | None:
    """The torque that is never exceeded and often met; None where extremes are those of a motion."""
    size = np.abs(tau[np.isfinite(tau)])
    if not size.size:
        return None
    top = float(size.max())
    at, below = np.sum(size >= 0.995 * top), np.sum((size < 0.995 * top) & (size >= 0.985 * top))
    return top if at > _PLATEAU * size.size and at > 5 * below else None


def findings(halves: tuple[Half, ...], kp, kd, names) -> list[dict]:
    """Effects of this half as report.json has them: what differs from the loop that is said."""
    out = []
    for half in halves:
        j = list(names).index(half.joint)
        place = {"kind": "joint", "name": half.joint}
        for family, value, sd, said in (
            ("kp_scale", half.kp, half.kp_sd, kp[j]),
            ("kd_scale", half.kd, half.kd_sd, kd[j]),
        ):
            if not said > 0:
                continue
            off, wide = value / said - 1.0, sd / said
            if abs(off) > max(3.0 * wide, _GAIN_TOLERANCE if family == "kp_scale" else 0.1):
                out.append(_effect(family, place, "scale", value / said, wide, "1"))
        if half.limit is not None:
            out.append(
                _effect("torque_saturation", place, "limit", half.limit, 0.005 * half.limit, "N m")
            )
    late = [h for h in halves if abs(h.delay) > max(3.0 * h.delay_sd, _LOOP_PERIOD)]
    if late and len(late) == len(halves) and np.ptp([h.delay for h in late]) < 2 * _LOOP_PERIOD:
        weight = np.array([h.delay_sd**-2 for h in late])
        mean = float(np.sum(weight * [h.delay for h in late]) / weight.sum())
        # What one joint's loop does not tell of its own period, those of the others do not either.
        sd = float(np.min([h.delay_sd for h in late]))
        out.append(
            _effect("target_delay", {"kind": "global", "name": "global"}, "delay", mean, sd, "s")
        )
    else:
        for h in late:
            place = {"kind": "joint", "name": h.joint}
            out.append(_effect("target_delay", place, "delay", h.delay, h.delay_sd, "s"))
    return out


def _effect(family, place, parameter, value, sd, unit) -> dict:
    number = {"value": value, "ci95": [value - 1.96 * sd, value + 1.96 * sd], "unit": unit}
    return {"family": family, "location": place, "parameters": {parameter: number}}


def sentence(effect: dict) -> str:
    """An effect of this half in words."""
    (name, number), where = next(iter(effect["parameters"].items())), effect["location"]
    place = "" if where["kind"] == "global" else f" at {where['name']}"
    unit = "" if number["unit"] == "1" else f" {number['unit']}"
    low, high = number["ci95"]
    family = effect["family"].replace("_", " ")
    return f"{family}{place}: {name} {number['value']:.3g}{unit} [{low:.3g}, {high:.3g}]"


def to_report(halves: tuple[Half, ...], kp, kd, names) -> dict | None:
    """The `command` key of report.json; None where no loop shows."""
    if not halves:
        return None
    return {
        "joints": {
            h.joint: {
                "kp": {
                    "value": h.kp,
                    "ci95": [h.kp - 1.96 * h.kp_sd, h.kp + 1.96 * h.kp_sd],
                    "unit": "N m/rad",
                },
                "kd": {
                    "value": h.kd,
                    "ci95": [h.kd - 1.96 * h.kd_sd, h.kd + 1.96 * h.kd_sd],
                    "unit": "N m s/rad",
                },
                "delay": {
                    "value": h.delay,
                    "ci95": [h.delay - 1.96 * h.delay_sd, h.delay + 1.96 * h.delay_sd],
                    "unit": "s",
                },
                "bias": {"value": h.bias, "unit": "N m"},
                "limit": h.limit,
                "explained": h.explained,
            }
            for h in halves
        },
        "effects": findings(halves, kp, kd, names),
    }
