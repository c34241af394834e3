"""The unit of stamps: s, ms, µs, ns, given or where it is unmistakable guessed."""

from collections.abc import Mapping

import numpy as np

from jax_inertia.logs.npz import LogError

UNITS: Mapping[str, float] = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9}
"""Seconds in each unit of time."""
GUESSED = ("ms", "us", "ns")

# Seconds since 1970 from 2001 to 2096; the same in other units are apart from these by more than the range.
_UNIX = 1e9, 4e9
# Rates that robots are logged at [Hz], and what no joint's speed exceeds [rad/s, m/s].
_SLOWEST, _FASTEST, _SPEED = 2.0, 2e4, 50.0
# As seconds, a log this slow is none of a robot's motion [Hz].
_NO_LOG = 0.5
# How near qvel and dqpos/dt must be, where both are there, for the unit to be theirs.
_AGREE = 1.5


def in_seconds(
    time: np.ndarray,
    unit: str | None,
    qpos: np.ndarray | None = None,
    qvel: np.ndarray | None = None,
) -> tuple[np.ndarray, str]:
    """Stamps [s], and a note on what was done to them (empty: nothing).

    Without a unit they are taken as they are, unless `guess` knows better. Raises `LogError` for a unit that is none.
    """
    guessed = guess(time, qpos, qvel) if unit is None else ""
    if (unit := unit or guessed) is None:
        return time, ""
    if unit not in UNITS:
        raise LogError(f"the unit of time is {unit[:20]!r}; expected {', '.join(UNITS)}")
    if UNITS[unit] == 1.0:
        return time, ""
    note = f"stamps in {unit} were turned into seconds"
    return time * UNITS[unit], note + " (a guess; --time-unit sets another)" * bool(guessed)


def guess(
    time: np.ndarray, qpos: np.ndarray | None = None, qvel: np.ndarray | None = None
) -> str | None:
    """ms, us or ns where nothing else fits; None for seconds, and where it is not sure.

    Sure are stamps that are a time since 1970 in that unit; a period that velocities confirm, as dqpos/dt; and,
    without those, a log that would be too slow in seconds, of a rate that robots are logged at in one unit only, in
    which no joint is impossibly fast.
    """
    if time.ndim != 1 or time.size < 3 or not np.isfinite(time).all():
        return None
    # Whether channels are numbers of the right shape is checked later, for all of them at once.
    qpos, qvel = (x if _is_channel(x, time) else None for x in (qpos, qvel))
    period = float(np.median(np.diff(time)))
    if not period > 0:
        return None
    for unit in GUESSED:
        low, high = (bound / UNITS[unit] for bound in _UNIX)
        if low <= time[0] <= high and _rate_fits(period, unit):
            return unit
    if 1.0 / period >= _NO_LOG:
        # From here on only velocities can tell: a log of one sample a second is slow in any unit.
        return next((u for u in GUESSED if _confirmed(time, qpos, qvel, u)), None)
    fits = [unit for unit in GUESSED if _rate_fits(period, unit)]
    if qvel is not None:
        fits = [unit for unit in fits if _confirmed(time, qpos, qvel, unit)]
    elif qpos is not None:
        fits = [unit for unit in fits if _fastest(time * UNITS[unit], qpos) < _SPEED]
    return fits[0] if len(fits) == 1 else None


def _is_channel(x: np.ndarray | None, time: np.ndarray) -> bool:
    return x is not None and x.dtype.kind == "f" and x.ndim == 2 and len(x) == len(time)


def _rate_fits(period: float, unit: str) -> bool:
    return _SLOWEST <= 1.0 / (period * UNITS[unit]) <= _FASTEST


def _fastest(time: np.ndarray, qpos: np.ndarray) -> float:
    """What 99 in 100 samples of every joint are slower than [rad/s]; NaN where nothing is known."""
    with np.errstate(all="ignore"):
        speed = np.abs(np.diff(qpos, axis=0)) / np.diff(time)[:, None]
    speed = speed[np.isfinite(speed)]
    return float(np.percentile(speed, 99)) if speed.size else np.nan


def _confirmed(
    time: np.ndarray, qpos: np.ndarray | None, qvel: np.ndarray | None, unit: str
) -> bool:
    """Whether velocities are the positions' differences where the stamps are in this unit, of joints that move."""
    if qpos is None or qvel is None or np.shape(qpos) != np.shape(qvel):
        return False
    with np.errstate(all="ignore"):
        step = np.diff(qpos, axis=0)
        moved = 0.5 * (qvel[1:] + qvel[:-1]) * np.diff(time)[:, None] * UNITS[unit]
        good = np.isfinite(step) & np.isfinite(moved)
        # A jump of an angle that wraps, or of one bad sample, must not decide.
        ratio = np.median(np.abs(moved[good])) / np.median(np.abs(step[good])) if good.any() else 0
    return bool(1.0 / _AGREE < ratio < _AGREE)
