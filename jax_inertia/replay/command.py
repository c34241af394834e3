"""Command → torque: what a loop that is known makes of its targets, where torque is logged too.

Joint by joint, over delays of the targets on a grid and then between its points, the least squares

    τ = kp dz(q*(t − d) − q; w) + kd (q̇*(t − d) − q̇) + τ_ff(t − d) + b

of the rows whose torque is not cut off. q̇ is as logged, or the slope of q; dz is 0 within the dead band ± w. Rows are
cut off where the torque falls short of what the loop asks for; the remainder there, L − s |q̇|, is the limit. A row of a
log at stamp t is taken before the loop acts on it, or after, or the loop is slower: d is known to about a period of
the loop.
"""

import dataclasses
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool

from jax_inertia.logs.log import Log, TorqueKind, TorqueUnit
from jax_inertia.maths.finite_difference import derivative
from jax_inertia.maths.sample_weight import autocorrelation_time
from jax_inertia.replay.loop import Loop
from jax_inertia.replay.record import feeds_forward

_LONGEST = 0.1
_CLEAR, _MOSTLY = 0.9, 0.5
_CUT, _SHORT, _LOW = 0.01, 0.03, 0.6
"""Of rows, cut-off ones at least; of the largest torque, what those lack at least, and below what none is."""
_FALLS, _STRAIGHT = 0.1, 0.1
_WINDOW = 0.01
"""Half of what is averaged over where velocities were not logged [s]."""
_SAME = 1e-5
"""Of the torque's variance, by how much squares may differ that are the same."""
_COARSE, _ROWS = 5e-3, 20
"""Steps of delays [s] by which it is seen whether there is a loop at all, and rows that a fit takes at least."""
_SURE = 3.0
"""Of a number, standard deviations from none."""
_LOOP_PERIOD, _HOLD = 2e-3, 1e-3
_GAIN_TOLERANCE = 0.03
_WIDTHS = np.linspace(0.05, 0.8, 16)
"""Dead bands tried, of the 90th percentile of the joint's error."""
_ODDS = float(np.log(20.0))


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
    dead_band: float
    """Half its width [rad]; 0 where there is none."""
    limit: float | None
    """At which the torque stays, or which it has at rest where it falls [N m]; None where it does not."""
    falls: float
    """By what the limit falls with speed [N m s/rad]; 0 where it does not."""
    explained: float
    """Of the torque's variance."""


def command_half(log: Log, loop: Loop | None = None) -> tuple[Half, ...]:
    """The loops that a log with targets and torque shows; joints without a clear one are left out.

    A joint has a clear loop where nine tenths of its torque's variance are of this form. `loop`: what is said of it,
    which tells whether `tau_command` is fed forward.
    """
    if log.tau is None or log.qpos_target is None:
        return ()
    found = [_joint(n, r) for n, r in zip(log.joint_names, rows_of(log, loop), strict=True)]
    return tuple(h for h in found if h is not None and h.explained >= _CLEAR and h.kp > 0)


def of_the_loop(log: Log, loop: Loop | None) -> bool:
    """Whether a log's torques are those of its position loop, in N m, at most joints that give any.

    They are where the law accounts for more of their variance than it leaves: a limit or a lag, which it does not have
    here, takes a third. What a sensor behind a gear measures is less the gear's friction, and not the loop's.
    """
    if log.tau is None or log.qpos_target is None:
        return False
    if log.tau_unit is not TorqueUnit.NEWTON_METRE or log.tau_kind is TorqueKind.SENSOR:
        return False
    active = int(np.sum(np.nanvar(np.asarray(log.tau, float), axis=0) > 0))
    return 2 * sum(_shows_a_loop(rows) for rows in rows_of(log, loop)) > active


def _shows_a_loop(rows: "Rows") -> bool:
    """Whether kp (q*(t − d) − q) − kd q̇ is more of a joint's torque than not, at one of a few delays."""
    good = np.all(np.isfinite(np.stack(rows[:-1])), axis=0)
    good &= rows.time >= rows.time[0] + _LONGEST
    if good.sum() < _ROWS or np.var(rows.tau[good]) == 0:
        return False
    fits = [rows.fit(d, good) for d in np.arange(0.0, _LONGEST, _COARSE)]
    (kp, *_), square = min(fits, key=lambda x: x[1])
    return bool(kp > 0 and square < (1.0 - _MOSTLY) * np.var(rows.tau[good]))


def with_damping(loop: Loop, log: Log) -> Loop:
    """The loop with the kd that the log's torques show, where nobody says one at any joint."""
    if loop.source == "model" or loop.kd.any():
        return loop
    kd = np.zeros_like(loop.kd)
    for half in command_half(log, loop):
        kd[log.joint_names.index(half.joint)] = half.kd * (half.kd > _SURE * half.kd_sd)
    return loop._replace(kd=kd)


def rows_of(log: Log, loop: Loop | None) -> list["Rows"]:
    """The channels of each joint of a log with targets and torque."""
    time = np.asarray(log.time, float)
    q, target, tau = (np.asarray(x, float) for x in (log.qpos, log.qpos_target, log.tau))
    v = derivative(time, q) if log.qvel is None else np.asarray(log.qvel, float)
    speed = np.zeros_like(q) if log.qvel_target is None else np.asarray(log.qvel_target, float)
    wide = max(round(_WINDOW / float(np.median(np.diff(time)))), 1) if log.qvel is None else 0
    fed = np.zeros_like(q)
    if feeds_forward(log, loop):
        fed = np.asarray(log.tau_command, float)
    return [
        Rows(time, q[:, j], v[:, j], target[:, j], speed[:, j], fed[:, j], tau[:, j], wide)
        for j in range(q.shape[1])
    ]


class Rows(NamedTuple):
    """One joint's channels; `wide` samples on either side are averaged over where velocities were not logged.

    Their mean over a window is (q_k+wide − q_k−wide) / its length, whatever happens inside; all else is averaged alike.
    """

    time: np.ndarray
    q: np.ndarray
    v: np.ndarray
    target: np.ndarray
    speed: np.ndarray
    fed: np.ndarray
    tau: np.ndarray
    wide: int

    @property
    def period(self) -> float:
        return float(np.median(np.diff(self.time)))

    def late(self, hold: float) -> "Rows":
        """The same where the loop saw positions and velocities so much earlier."""
        v = self.v - hold * np.gradient(self.v, self.time)
        return self._replace(q=self.q - hold * self.v, v=v)

    def at(self, delay: float, width: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """Columns of kp, kd and bias (T, 3), and the torque without what is fed forward."""
        # A stamp at which a target is commanded is one at which it is in force.
        when = self.time - delay + 0.5 * self.period
        aim, speed, fed = (_held(self.time, x, when) for x in (self.target, self.speed, self.fed))
        miss = aim - self.q
        miss = miss - np.clip(miss, -width, width)
        return np.stack([miss, speed - self.v, np.ones(len(self.q))], 1), self.tau - fed

    def averaged(self, delay: float, good, width: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """The same averaged, where all of a window is good."""
        columns, tau = self.at(delay, width)
        m = self.wide
        if m == 0:
            return columns[good], tau[good]
        window = np.concatenate([[0.5], np.ones(2 * m - 1), [0.5]]) / (2 * m)
        parts = [np.convolve(x, window, mode="valid") for x in (*columns.T, tau)]
        mean_v = (self.q[2 * m :] - self.q[: -2 * m]) / (self.time[2 * m :] - self.time[: -2 * m])
        aim = parts[1] + np.convolve(self.v, window, mode="valid")
        whole = np.convolve(good, np.ones(2 * m + 1), mode="valid") > 2 * m + 0.5
        return np.stack([parts[0], aim - mean_v, parts[2]], 1)[whole], parts[3][whole]

    def fit(self, delay: float, good, width: float = 0.0) -> tuple[np.ndarray, float]:
        """Coefficients and mean square that they leave."""
        columns, tau = self.averaged(delay, good, width)
        x = np.linalg.lstsq(columns, tau, rcond=None)[0]
        return x, float(np.mean((tau - columns @ x) ** 2))

    def delay(self, good) -> float:
        grid = np.arange(-2 * self.period, _LONGEST, min(self.period, 1e-3))
        squares = np.array([self.fit(d, good)[1] for d in grid])
        # Where rows do not tell, there is none.
        as_good = squares <= squares.min() + _SAME * np.var(self.tau[good])
        best = int(np.argmin(np.where(as_good, np.abs(grid), np.inf)))
        lo, hi = grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)]
        return float(_golden(lambda d: self.fit(d, good)[1], lo, hi))


def _joint(name: str, rows: Rows) -> Half | None:
    # What a late robot was commanded before the log began is not in it.
    known = rows.time >= rows.time[0] + min(_LONGEST, 0.1 * (rows.time[-1] - rows.time[0]))
    known &= np.all(np.isfinite(np.stack(rows[:-1])), axis=0)
    top = float(np.percentile(np.abs(rows.tau[known]), 99.8)) if known.any() else 0.0
    low = known & (np.abs(rows.tau) < _LOW * top)
    if len(rows.averaged(0.0, low)[1]) < _ROWS or np.var(rows.tau[low]) == 0:
        return None
    good, limit, falls = _without_cut(rows, rows.delay(low), known, low, top)
    delay = rows.delay(good)
    (kp, kd, bias), square = rows.fit(delay, good)
    columns, tau = rows.averaged(delay, good)
    correlated = autocorrelation_time(tau - columns @ np.array([kp, kd, bias]))
    width, narrower = _dead_band(rows, delay, good, square, correlated)
    if width > 0:
        (kp, kd, bias), square = narrower
        columns, tau = rows.averaged(delay, good, width)
    step = max(rows.period, 1e-4)
    early, late = (rows.averaged(delay + s, good)[0][:, 0] for s in (-step, step))
    whole = np.column_stack([columns, (late - early) * kp / (2 * step)])
    covariance = max(square, 1e-300) * correlated * np.linalg.pinv(whole.T @ whole)
    sd = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
    # When between two stamps a loop heard of a target is in no log: up to a period before its torque shows it.
    when = float(np.hypot(sd[3], rows.period / np.sqrt(3.0)))
    explained = float(1.0 - square / np.var(tau))
    # Nor how long before it looked at positions.
    held = rows.late(_HOLD).fit(delay, good, width)[0]
    wide = np.hypot(sd[:2], np.abs(held[:2] - (kp, kd)) / np.sqrt(3.0))
    gains = float(kp), float(wide[0]), float(kd), float(wide[1])
    return Half(name, *gains, delay, when, float(bias), width, limit, falls, explained)


def _without_cut(
    rows: Rows,
    delay: float,
    known: Bool[np.ndarray, " T"],
    low: Bool[np.ndarray, " T"],
    top: float,
) -> tuple[np.ndarray, float | None, float]:
    """(rows that are not cut off, limit, by what it falls with speed), by what the loop asks for at low torque."""
    x, square = rows.fit(delay, low)
    columns, tau = rows.at(delay)
    asked = columns @ x
    way = np.sign(asked)
    short = way * (asked - tau) > max(4.0 * np.sqrt(square), _SHORT * top)
    cut = known & short & (np.abs(tau) > 0.2 * top)
    if cut.sum() < max(_CUT * known.sum(), 10):
        return known, None, 0.0
    line = np.stack([np.ones(cut.sum()), -(way * rows.v)[cut]], 1)
    size = (way * tau)[cut]
    (limit, falls), *_ = np.linalg.lstsq(line, size, rcond=None)
    rest = size - line @ np.array([limit, falls])
    good = known & ~short
    if limit <= 0 or np.std(rest) > _STRAIGHT * limit or len(rows.averaged(0.0, good)[1]) < _ROWS:
        # Not a limit: a torque that is noisy, or another law.
        return known, None, 0.0
    beyond = known & (way * tau > (1.0 + 3.0 * _STRAIGHT) * (limit - falls * way * rows.v))
    if beyond.sum() > cut.sum():
        # Nor is one that the joint passes more often than it is held by it.
        return known, None, 0.0
    spread = falls * np.ptp(np.percentile(line[:, 1], [5.0, 95.0]))
    if spread > max(_FALLS * limit, 3.0 * np.std(rest)):
        return good, float(limit), float(falls)
    return good, float(np.median(size)), 0.0


def _dead_band(
    rows: Rows, delay: float, good: np.ndarray, square: float, correlated: float
) -> tuple[float, tuple[np.ndarray, float]]:
    """(half width of the dead band, the fit with it); 0 where the torque does not ask for one (BIC, one in twenty)."""
    columns, tau = rows.averaged(delay, good)
    miss = float(np.percentile(np.abs(columns[:, 0]), 90.0))
    widths = miss * _WIDTHS
    squares = [rows.fit(delay, good, w)[1] for w in widths]
    best = int(np.argmin(squares))
    lo, hi = widths[max(best - 1, 0)], widths[min(best + 1, len(widths) - 1)]
    width = _golden(lambda w: rows.fit(delay, good, w)[1], lo, hi)
    fit = rows.fit(delay, good, width)
    samples = len(tau) / correlated
    gain = samples * np.log(square / max(fit[1], 1e-300))
    if gain < np.log(max(samples, 2.0)) + 2.0 * _ODDS or fit[1] > 0.8 * square:
        return 0.0, fit
    return float(width), fit


def _held(time: np.ndarray, x: np.ndarray, at: np.ndarray) -> np.ndarray:
    """The last target at or before each moment, and between stamps the mean over one of the log's periods."""
    if not x.any():
        return np.zeros_like(at)
    period = float(np.median(np.diff(time)))
    edges = np.append(time, time[-1] + period)
    whole = np.concatenate([[0.0], np.cumsum(x * np.diff(edges))])
    out = []
    for t in (at - period / 2, at + period / 2):
        beyond = np.minimum(t - edges[0], 0.0) * x[0] + np.maximum(t - edges[-1], 0.0) * x[-1]
        out.append(np.interp(t, edges, whole) + beyond)
    return (out[1] - out[0]) / period


def _golden(cost, low: float, high: float) -> float:
    ratio = 0.5 * (np.sqrt(5.0) - 1.0)
    for _ in range(20):
        a, b = high - ratio * (high - low), low + ratio * (high - low)
        low, high = (low, b) if cost(a) < cost(b) else (a, high)
    return 0.5 * (low + high)


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
        if half.limit is not None and half.falls > 0:
            effect = _effect("torque_speed", place, "stall", half.limit, 0.03 * half.limit, "N m")
            free = half.limit / half.falls
            more = _effect("", place, "no_load_speed", free, 0.1 * free, "rad/s")
            effect["parameters"] |= more["parameters"]
            out.append(effect)
        elif half.limit is not None:
            out.append(
                _effect("torque_saturation", place, "limit", half.limit, 0.005 * half.limit, "N m")
            )
        if half.dead_band > 0:
            wide = half.dead_band
            out.append(_effect("dead_band", place, "half_width", wide, 0.05 * wide, "rad"))
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
                "dead_band": {"value": h.dead_band, "unit": "rad"},
                "limit": h.limit,
                "limit_falls": h.falls,
                "explained": h.explained,
            }
            for h in halves
        },
        "effects": findings(halves, kp, kd, names),
    }
