"""From a log as it was recorded to channels that a filter may use: masks, one time grid, one
low-pass.

Every step acts on all channels alike, so that positions, velocities, torques and contact forces
stay aligned in time and in bandwidth; and each is linear with weights that depend on the stamps
alone, so that it does to sensor noise what its weights say. What was not measured (NaN, gaps) is
bridged, to keep arrays finite, and marked: `Masked` carries the marks through every step. NumPy and
SciPy, for whole logs.
"""

import dataclasses
from collections.abc import Callable
from functools import partial

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import interpolate, ndimage, signal

from jax_inertia.logs.findings import run_bounds
from jax_inertia.logs.log import AnyArray, Log
from jax_inertia.maths.finite_difference import continuous_signs

_GAP_PERIODS, _GAP_SECONDS = 3.0, 0.01
_MEASURED_SHARE = 0.9
_HALF_WIDTH_IN_PERIODS = 2.5
_HALF_WIDTH_IN_STEPS = 2.0
_MOST_STRETCH = 100
_MOST_WEIGHTS = 50_000_000


class Masked(eqx.Module):
    """A log whose every value is finite, and what in it was measured.

    `motion_valid` (T,): positions, velocities, base and contact forces of a sample, which every row
    of the equations of motion needs; `torque_valid` (T, n): the torque of one joint.
    """

    log: Log
    motion_valid: Bool[np.ndarray, "T"]
    torque_valid: Bool[np.ndarray, "T n"]

    @property
    def rows(self) -> Bool[np.ndarray, "T n"]:
        """Whether the equation of one joint at one sample stands on measurements alone, (T, n)."""
        return self.motion_valid[:, None] & self.torque_valid


def mask(log: Log) -> Masked:
    """Bridge what is not finite by straight lines in time and mark it, and mark the sample after
    each gap.

    A gap is a period above `gap_limit`. Its later edge carries the mark, so that whatever spans the
    gap (a difference, an interpolation) touches a marked sample.
    """
    time = np.asarray(log.time)
    after_gap = np.concatenate([[False], np.diff(time) > gap_limit(time)])
    measured = {
        name: np.isfinite(value).reshape(time.size, -1).all(axis=1)
        for name, value in _motion_channels(log).items()
    }
    motion_valid = np.logical_and.reduce([*measured.values(), ~after_gap])
    return Masked(
        _continuous(log).map_channels(partial(_bridged, time)),
        motion_valid,
        # Without torque no equation of a joint stands on measurements.
        (np.zeros(np.shape(log.qpos), bool) if log.tau is None else np.isfinite(log.tau))
        & ~after_gap[:, None],
    )


def gap_limit(time: Float[np.ndarray, "T"]) -> float:
    """The period above which samples do not speak for what lies between them, s.

    Three times the median, and at least 10 ms: half a period of 50 Hz, which no joint follows.
    """
    return max(_GAP_PERIODS * float(np.median(np.diff(time))), _GAP_SECONDS)


def resample(log: Log | Masked, rate: float | int) -> Masked:
    """Put every channel on the uniform grid t₀ + k / rate by local quadratic regression.

    Each grid value is the weighted least-squares parabola through the samples within a half-width
    H, read at the grid time, with tricube weights (Cleveland 1979, doi
    10.1080/01621459.1979.10481038) and H the larger of 2.5 periods of the log and 2 of the grid. It
    takes jittered stamps as they are, and going down in rate it is its own anti-alias filter: a
    tenth of the lower rate passes within 1 %, a fifth at 0.87 to 0.96, and what would alias from
    0.75 of the grid's rate on falls to 0.12 (1 kHz to 250 Hz). Linear interpolation is neither: on
    a sample it keeps the noise, halfway between two it halves the variance, so that noise comes out
    periodic in the beat of the two clocks. Here the noise gain √Σw² varies little (0.72 to 0.79
    from 100 to 250 Hz), and `sigma_qpos`, `sigma_tau` are scaled by its root mean square.

    rate: Hz. A grid value is valid where every sample that it weighs is, and where samples lie on
    both sides. Raises `ValueError` for a rate that leaves fewer than two grid times, or far more
    than the log holds.
    """
    source = _masked(log)
    time = np.asarray(source.log.time)
    if not (np.isfinite(rate) and rate * (time[-1] - time[0]) >= 1):
        raise ValueError(
            f"rate {rate} Hz leaves fewer than two samples of {source.log.duration:.4g} s of log"
        )
    if rate * (time[-1] - time[0]) > _MOST_STRETCH * time.size:
        raise ValueError(
            f"rate {rate} Hz over {source.log.duration:.4g} s makes over {_MOST_STRETCH} times the "
            f"log's {time.size} samples; cut the log at its gaps or lower the rate"
        )
    grid = time[0] + np.arange(int(rate * (time[-1] - time[0]) + 1e-6) + 1) / rate
    half_width = max(_HALF_WIDTH_IN_PERIODS / source.log.rate, _HALF_WIDTH_IN_STEPS / rate)
    index, weight, supported = _local_quadratic(time, grid, half_width)
    gain = float(np.sqrt(np.mean(np.sum(weight**2, axis=1))))

    def kept(valid: np.ndarray) -> np.ndarray:
        used = np.abs(weight) > 1e-9
        return ~np.any(~valid[index] & used.reshape(used.shape + (1,) * (valid.ndim - 1)), axis=1)

    resampled = _filtered(
        source.log, lambda x: np.einsum("tk,tk...->t...", weight, x[index]), gain, time=grid
    )
    return Masked(
        resampled,
        kept(source.motion_valid) & supported,
        kept(source.torque_valid) & supported[:, None],
    )


def bridged_smoothly(source: Masked, ends: float | int = 0.02) -> Masked:
    """Cubics over the stretches of a uniform grid where motion was not measured, in place of straight lines.

    A straight line has a corner at either edge, and a corner in a position is a blow in its acceleration. The cubic
    meets the level and slope of the `ends` seconds before and after (least squares). Torques stay as they are.
    """
    if source.motion_valid.all():
        return source
    time, valid = np.asarray(source.log.time), source.motion_valid
    reach = max(2, round(ends / (time[1] - time[0])))
    changes = {}
    for name in ("qpos", "base_pos", "base_quat"):
        if (value := getattr(source.log, name)) is None:
            continue
        x = np.array(value, dtype=float)
        for start, stop in run_bounds(~valid):
            before = _line(time, x, valid, np.arange(max(start - reach, 0), start))
            after = _line(time, x, valid, np.arange(stop, min(stop + reach, time.size)))
            if before is None or after is None:
                continue
            t0, t1 = float(time[start - 1]), float(time[stop])
            ends_at = [line(t) for line, t in ((before, t0), (after, t1))]
            slopes = [before.slope, after.slope]
            cubic = interpolate.CubicHermiteSpline([t0, t1], ends_at, slopes)
            x[start:stop] = cubic(time[start:stop])
        if name == "base_quat":
            x /= np.linalg.norm(x, axis=1, keepdims=True)
        changes[name] = x
    return dataclasses.replace(source, log=dataclasses.replace(source.log, **changes))


@dataclasses.dataclass(frozen=True)
class _Line:
    at: float
    level: np.ndarray
    slope: np.ndarray

    def __call__(self, t: float) -> np.ndarray:
        return self.level + (t - self.at) * self.slope


def _line(time: np.ndarray, x: np.ndarray, valid: np.ndarray, index: np.ndarray) -> _Line | None:
    """The straight line through valid samples of all columns; None for fewer than two."""
    index = index[valid[index]]
    if index.size < 2:
        return None
    slope, level = np.polynomial.polynomial.polyfit(time[index] - time[index[0]], x[index], 1)[::-1]
    return _Line(float(time[index[0]]), level, slope)


def low_pass(log: Log | Masked, cutoff: float | int, order: int = 4) -> Masked:
    """Filter every channel forwards and backwards by one Butterworth low-pass: no phase, |H|² = ½
    at the cutoff.

    cutoff: Hz, where the two passes together halve the amplitude. `sigma_*` are scaled by the
    filter's noise gain (one sample's; neighbours are then correlated). A value is valid where 90 %
    of the filter's weight lies on valid samples; the rest was bridged. Raises `ValueError` where
    the grid is not uniform or the cutoff not below half the rate.
    """
    source = _masked(log)
    period = np.diff(np.asarray(source.log.time))
    rate = 1.0 / period.mean()
    if np.ptp(period) > 1e-3 * period.mean():
        raise ValueError(
            f"periods differ, from {period.min():.3g} to {period.max():.3g} s; resample first"
        )
    if not 0 < cutoff < rate / 2:
        raise ValueError(
            f"cutoff {cutoff} Hz must lie between 0 and {rate / 2:.4g} Hz, half the rate"
        )
    sections = np.asarray(signal.butter(order, cutoff, fs=rate, output="sos"))
    response = _impulse_response(sections, rate / cutoff)
    share = np.abs(response) / np.sum(np.abs(response))
    pad = min(response.size // 2, period.size)

    def enough(valid: np.ndarray) -> np.ndarray:
        measured = ndimage.convolve1d(valid.astype(float), share, axis=0, mode="nearest")
        return measured >= _MEASURED_SHARE

    filtered = _filtered(
        source.log,
        lambda x: signal.sosfiltfilt(sections, x, axis=0, padlen=pad),
        float(np.sqrt(np.sum(response**2))),
    )
    return Masked(filtered, enough(source.motion_valid), enough(source.torque_valid))


def _masked(log: Log | Masked) -> Masked:
    return log if isinstance(log, Masked) else mask(log)


def _motion_channels(log: Log) -> dict[str, np.ndarray]:
    names = (
        "qpos",
        "qvel",
        "base_pos",
        "base_quat",
        "base_linvel",
        "base_angvel",
        "base_linacc",
        "contact_wrench",
    )
    values = {name: getattr(log, name) for name in names}
    return {name: np.asarray(value) for name, value in values.items() if value is not None}


def _bridged(time: np.ndarray, x: AnyArray) -> np.ndarray:
    """Replace what is not finite, column by column; a column without any sample becomes zero."""
    columns = np.array(x, dtype=float).reshape(time.size, -1)
    for column in columns.T:
        good = np.isfinite(column)
        if not good.all():
            column[~good] = np.interp(time[~good], time[good], column[good]) if good.any() else 0.0
    return columns.reshape(np.shape(x))


def _continuous(log: Log) -> Log:
    if log.base_quat is None:
        return log
    return dataclasses.replace(log, base_quat=continuous_signs(np.asarray(log.base_quat)))


def _filtered(
    log: Log, function: Callable[[np.ndarray], np.ndarray], gain: float, **changes
) -> Log:
    """Apply one linear filter to every channel, and keep noise and quaternions true to what they
    mean.
    """
    log = log.map_channels(function, **changes)
    for name in ("sigma_qpos", "sigma_tau"):
        if (sigma := getattr(log, name)) is not None:
            log = dataclasses.replace(log, **{name: sigma * gain})
    if log.base_quat is not None:
        quat = np.asarray(log.base_quat)
        log = dataclasses.replace(log, base_quat=quat / np.linalg.norm(quat, axis=1, keepdims=True))
    return log


def _local_quadratic(
    time: np.ndarray, grid: np.ndarray, half_width: float
) -> tuple[Int[np.ndarray, "M K"], Float[np.ndarray, "M K"], Bool[np.ndarray, "M"]]:
    """Samples and weights that give each grid value, and whether samples enough lie around it.

    Where they do not (inside a gap) the weights are those of the straight line between the gap's
    edges.
    """
    # A stamp that rounding puts a hair beyond the window's edge has no weight there anyway.
    low = np.searchsorted(time, grid - half_width)
    high = np.searchsorted(time, grid + half_width)
    left = np.clip(np.searchsorted(time, grid, side="right") - 1, 0, time.size - 2)
    low, high = np.minimum(low, left), np.maximum(high, left + 2)
    most = int((high - low).max())
    if most * grid.size > _MOST_WEIGHTS:
        raise ValueError(
            f"up to {most} samples fall within {half_width:.3g} s of one of {grid.size} times, "
            "too many to weigh; raise the rate, or cut the log into pieces"
        )
    index = low[:, None] + np.arange(most)
    inside = index < high[:, None]
    index = np.minimum(index, time.size - 1)
    u = (time[index] - grid[:, None]) / half_width
    tricube = np.where(inside, np.clip(1 - np.abs(u) ** 3, 0, None) ** 3, 0.0)
    around = tricube > 1e-6
    enough = np.sum(around, axis=1) >= 4
    both_sides = np.any(around & (u <= 1e-9), axis=1) & np.any(around & (u >= -1e-9), axis=1)
    supported = enough & both_sides
    basis = np.stack([np.ones_like(u), u, u**2], axis=-1)
    normal = np.einsum("tk,tki,tkj->tij", tricube, basis, basis)
    normal[~supported] = np.eye(3)
    # The value at u = 0 is the first coefficient: e₀ᵀ (Φᵀ W Φ)⁻¹ Φᵀ W.
    first = np.linalg.solve(normal, np.broadcast_to(np.eye(3)[:, :1], (grid.size, 3, 1)))[..., 0]
    weight = tricube * np.einsum("tki,ti->tk", basis, first)
    share = np.clip((grid - time[left]) / (time[left + 1] - time[left]), 0, 1)[:, None]
    line = (index == left[:, None]) * (1 - share) + ((index == left[:, None] + 1) & inside) * share
    return index, np.where(supported[:, None], weight, line), supported


def _impulse_response(sections: np.ndarray, samples_per_cycle: float) -> np.ndarray:
    """The two-pass impulse response, its centre in the middle, to eight cycles of the cutoff."""
    half = int(np.ceil(8 * samples_per_cycle))
    impulse = np.zeros(2 * half + 1)
    impulse[half] = 1.0
    once = np.asarray(signal.sosfilt(sections, impulse))
    return np.asarray(signal.sosfilt(sections, once[::-1]))[::-1]
