"""Checks of channels against each other: velocity against position, base frames, quaternion order.

Measured rates and difference quotients are compared over the same windows of time (both are then
the mean rate over the window), so that neither differencing noise nor its delay is taken for a
fault of the log.
"""

from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType

import numpy as np
from scipy import signal

from jax_inertia.logs.findings import Finding, Severity
from jax_inertia.logs.log import Log
from jax_inertia.model.robot import HINGE
from jax_inertia.preflight.units import SI, Unit, conversion, of_ratio
from jax_inertia.signals.generalised_motion import body_rates

_WINDOW = 0.03
_MAX_LAG = 0.1
_MOVED = 1e-2
_ABOVE = 3.0
_DEGREE = np.pi / 180


def velocity(
    log: Log, time: np.ndarray, kinds: Mapping[str, str] = MappingProxyType({})
) -> Iterator[Finding]:
    """`qvel` against dqpos/dt, joint by joint: sign, unit, delay, swapped columns; `kinds`: slide or hinge, by name.

    Joints that hardly move show their encoder's noise, and how others shake them: they are not judged. Nor is the size
    of velocities, within half and twice, in a slow log whose targets change from stamp to stamp (`_jolted`).
    """
    if log.qvel is None:
        return
    window = _window(time)
    slope = _mean_slope(np.asarray(log.qpos), time, window)
    rate = _mean(np.asarray(log.qvel), time, window)
    period = float(np.median(np.diff(time)))
    spread = np.std(slope, axis=0)
    noise = np.sqrt(2.0) * _encoder_noise(np.asarray(log.qpos)) / (window * period)
    moving = [
        j
        for j in range(slope.shape[1])
        if np.ptp(log.qpos[:, j]) > _MOVED
        and spread[j] > _ABOVE * noise[j]
        and np.std(rate[:, j]) > 0
    ]
    in_units: dict[tuple[Unit, Unit], list[tuple[str, float]]] = {}
    for j in moving:
        name = log.joint_names[j]
        here = _correlation(slope[:, j], rate[:, j])
        lag, best = lag_of(slope[:, j], rate[:, j], int(_MAX_LAG / period))
        gain = np.std(rate[:, j]) / spread[j]
        twin = max(moving, key=lambda i: _correlation(slope[:, i], rate[:, j]))
        if here < -0.7:
            yield _error(
                "sign", f"qvel of {name!r} is minus dqpos/dt (correlation {here:.2f}); flip one"
            )
        elif best < 0.7 and twin != j and _correlation(slope[:, twin], rate[:, j]) > 0.9:
            other = log.joint_names[twin]
            yield _error(
                "swapped",
                f"qvel of {name!r} follows qpos of {other!r}; both go in the order of joint_names",
            )
        elif best < 0.7:
            yield _warning(
                "velocity",
                f"qvel of {name!r} does not follow dqpos/dt (correlation {best:.2f}); check the "
                "signal, or leave qvel out",
            )
        elif (units := of_ratio(gain, kinds.get(name, HINGE) == HINGE)) is not None:
            in_units.setdefault(units, []).append((name, gain))
        elif not (0.5 < gain < 2.0 if _jolted(log, j, period) else 0.9 < gain < 1.1):
            yield _warning(
                "scale",
                f"qvel of {name!r} is {gain:.3g} times dqpos/dt; expected 1 (units, gear ratio, or "
                "a velocity filtered hard)",
            )
        elif abs(lag) > 1 and abs(lag) * period > 2e-3 and 1 - best < 0.5 * (1 - here):
            side = "behind" if lag > 0 else "ahead of"
            yield _warning(
                "delay",
                f"qvel of {name!r} runs {1e3 * abs(lag) * period:.1f} ms {side} dqpos/dt; give "
                "both one filter, or leave qvel out",
            )
    for units, joints in in_units.items():
        yield _in_units(log, joints, *units, kinds)


_SLOW, _JOLTS = 0.01, 0.5


def _jolted(log: Log, j: int, period: float) -> bool:
    """Whether velocities at the stamps are no mean ones: each target jolts the joint at a stamp, and it settles after.

    The log sees every jolt at the same moment, the last of the settling: velocities that are right, and smaller than
    the motion's mean, or larger where the loop is read after it has acted.
    """
    if log.qpos_target is None or period < _SLOW:
        return False
    return bool(np.mean(np.diff(np.asarray(log.qpos_target)[:, j]) != 0) > _JOLTS)


def quaternion(log: Log) -> Iterator[Finding]:
    """Length and order of `base_quat`."""
    if log.base_quat is None:
        return
    quat = np.asarray(log.base_quat)
    off = float(np.max(np.abs(np.linalg.norm(quat, axis=1) - 1)))
    if off > 1e-3:
        finding = _error if off > 0.1 else _warning
        yield finding(
            "quaternion", f"base_quat is off unit length by up to {off:.2g}; normalise it"
        )
    size = np.abs(quat).mean(axis=0)
    if log.base_angvel is None and size[3] > 0.9 and size[0] < 0.3:
        yield _warning(
            "quaternion",
            "base_quat looks like xyzw (its last entry is near 1 throughout: in wxyz, a base "
            "turned by 180 degrees about z); expected wxyz",
        )


def base_frames(log: Log, time: np.ndarray) -> Iterator[Finding]:
    """`base_angvel` and `base_linvel` against the base's own pose: which frame are they in?"""
    if log.base_quat is None or not np.all(np.linalg.norm(np.asarray(log.base_quat), axis=1) > 0.5):
        return
    window = _window(time)
    quat = np.asarray(log.base_quat)
    if log.base_angvel is not None:
        rolled = quat[:, [3, 0, 1, 2]]
        body, swapped = body_rates(time, quat), body_rates(time, rolled)
        yield from _frame(
            "base_angvel",
            "rad/s in the body frame, base_quat wxyz",
            _mean(np.asarray(log.base_angvel), time, window),
            _mean(body, time, window),
            {
                "is in the world frame": _mean(_rotate(quat, body), time, window),
                "fits base_quat only if that is xyzw": _mean(swapped, time, window),
                "fits base_quat only in the world frame and as xyzw": _mean(
                    _rotate(rolled, swapped), time, window
                ),
                "is in degrees per second": _mean(body, time, window) / _DEGREE,
            },
        )
    if log.base_linvel is not None and log.base_pos is not None:
        world = np.gradient(np.asarray(log.base_pos), time, axis=0)
        inverse = quat * np.array([1, -1, -1, -1])
        yield from _frame(
            "base_linvel",
            "m/s in the world frame",
            _mean(np.asarray(log.base_linvel), time, window),
            _mean(world, time, window),
            {"is in the body frame": _mean(_rotate(inverse, world), time, window)},
        )


_STANDARD = 9.80665
"""Standard gravity [m/s²]."""


def accelerometer(log: Log) -> Iterator[Finding]:
    """`base_linacc` against the attitude: what carries a robot points up, and is as large as gravity, in the mean."""
    if log.base_linacc is None or log.base_quat is None or log.imu_body:
        return
    quat, felt = np.asarray(log.base_quat), np.asarray(log.base_linacc)
    if not np.all(np.linalg.norm(quat, axis=1) > 0.5):
        return
    world, gravity = np.nanmean(_rotate(quat, felt), axis=0), np.array([0.0, 0.0, _STANDARD])

    def misfit(mean: np.ndarray) -> float:
        return float(np.linalg.norm(mean - gravity)) / _STANDARD

    readings = {
        "is minus the specific force (at rest it points up)": -world,
        "is in g": _STANDARD * world,
        "is minus the specific force, and in g": -_STANDARD * world,
        "has gravity taken out (a linear acceleration)": world + gravity,
        "is in the world's axes": np.nanmean(felt, axis=0),
    }
    here = misfit(world)
    reading, best = min(((k, misfit(x)) for k, x in readings.items()), key=lambda pair: pair[1])
    if here > 0.5 and best < 0.2 * here:
        yield _error(
            "accelerometer",
            f"base_linacc {reading}: its mean, turned by base_quat, is {np.round(world, 2).tolist()} m/s²; expected "
            "the specific force in the body's axes, near [0, 0, 9.81] then",
        )
    elif here > 0.1:
        yield _warning(
            "accelerometer",
            f"the mean of base_linacc, turned by base_quat, is {np.round(world, 2).tolist()} m/s²; expected [0, 0, "
            "9.81] of a robot that ends as fast as it began: check axes, unit and base_quat, or leave base_linacc out",
        )


def _frame(
    array: str,
    right: str,
    measured: np.ndarray,
    expected: np.ndarray,
    others: dict[str, np.ndarray],
) -> Iterator[Finding]:
    size = np.sqrt(np.mean(measured**2))
    if size < 1e-2:
        return

    def misfit(candidate: np.ndarray) -> float:
        return float(np.sqrt(np.mean((measured - candidate) ** 2)) / size)

    here = misfit(expected)
    reading, best = min(((k, misfit(c)) for k, c in others.items()), key=lambda pair: pair[1])
    if here > 0.3 and best < 0.5 * here:
        yield _error(
            "frame",
            f"{array} {reading} (misfit {best:.2f}, as declared {here:.2f}); expected {right}",
        )
    elif here > 0.5:
        yield _warning(
            "frame",
            f"{array} does not follow the base's own pose (misfit {here:.2f} of its size); "
            f"expected {right}",
        )


def _error(check: str, message: str) -> Finding:
    return Finding(Severity.ERROR, check, message)


def _warning(check: str, message: str) -> Finding:
    return Finding(Severity.WARNING, check, message)


def _window(time: np.ndarray) -> int:
    return int(np.clip(round(_WINDOW / float(np.median(np.diff(time)))), 1, time.size - 1))


def _mean_slope(x: np.ndarray, time: np.ndarray, window: int) -> np.ndarray:
    return (x[window:] - x[:-window]) / (time[window:] - time[:-window])[:, None]


def _mean(x: np.ndarray, time: np.ndarray, window: int) -> np.ndarray:
    steps = 0.5 * (x[1:] + x[:-1]) * np.diff(time)[:, None]
    return _mean_slope(
        np.concatenate([np.zeros((1, x.shape[1])), np.cumsum(steps, axis=0)]), time, window
    )


def _encoder_noise(qpos: np.ndarray) -> np.ndarray:
    """Standard deviation of white noise in each column, by third differences: a motion has next to none."""
    return np.std(np.diff(qpos, 3, axis=0), axis=0) / np.sqrt(20.0)


def _correlation(x: np.ndarray, y: np.ndarray) -> float:
    x, y = x - x.mean(), y - y.mean()
    return float(x @ y / np.sqrt((x @ x) * (y @ y)))


def lag_of(x: np.ndarray, y: np.ndarray, most: int) -> tuple[float, float]:
    """By how many samples, at most, y is behind x, and the correlation there; a parabola refines the peak.

    >>> import numpy as np
    >>> from jax_inertia.preflight.cross_channel import lag_of
    >>> x = np.random.default_rng(0).normal(size=200).cumsum()
    >>> round(lag_of(x[5:], x[:-5], 20)[0])
    5
    """
    most = min(most, x.size // 4)
    core = x[most : x.size - most]
    # Each lag correlates the same stretch of x with as long a stretch of y: no lag is favoured.
    core, y = core - core.mean(), y - y.mean()
    total = np.cumsum(np.concatenate([[0.0], y]))
    square = np.cumsum(np.concatenate([[0.0], y**2]))
    mean = (total[core.size :] - total[: -core.size]) / core.size
    energy = square[core.size :] - square[: -core.size] - core.size * mean**2
    curve = signal.correlate(y, core, mode="valid", method="fft")
    curve = curve / np.sqrt((core @ core) * np.maximum(energy, 1e-300))
    k = int(np.argmax(curve))
    if not 0 < k < curve.size - 1:
        return float(k - most), float(curve[k])
    below, peak, above = curve[k - 1 : k + 2]
    bend = below - 2 * peak + above
    shift = 0.5 * (below - above) / bend if bend < 0 else 0.0
    return float(k - most + shift), float(peak)


def _in_units(
    log: Log,
    joints: Sequence[tuple[str, float]],
    position: Unit,
    rate: Unit,
    kinds: Mapping[str, str],
) -> Finding:
    """Velocities that are dqpos/dt in another unit; or positions are, which is then what is to be mended."""
    names = [name for name, _ in joints]
    text = f"qvel of {', '.join(map(repr, names))} is {joints[0][1]:.4g} times dqpos/dt"
    if position == SI:
        return _error("scale", f"{text}: it is in {rate.name}; expected rad/s (m/s)")
    also = (
        ""
        if rate == SI
        else f" and qvel in {rate.name}, or qvel is of a motor before its gear: leave it out"
    )
    of = [kinds.get(name, HINGE) for name in log.joint_names]
    return _error(
        "unit",
        f"{text}: qpos is in {position.name}{also}; expected qpos in rad (m): "
        f"{conversion(position, names, log.joint_names, of)}",
    )


def _rotate(quat: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Rotate vectors by unit quaternions wxyz, body to world."""
    quat = quat / np.linalg.norm(quat, axis=1, keepdims=True)
    w, u = quat[:, :1], quat[:, 1:]
    return x + 2 * np.cross(u, np.cross(u, x) + w * x)
