"""Channels that drives and loggers spoil, where what was meant is unmistakable: registers, rounded stamps."""

import numpy as np

from jax_inertia.logs.npz import LogError
from jax_inertia.logs.schema import SHAPES

_WHOLE = 1 << 16
# Signed, the values lie so much closer together, in steps from one sample to the next.
_CLOSER = 10.0
# Seconds since 1970, and the step of float32 there.
_EPOCH, _FLOAT32 = 1e8, 1.0
# Samples with repeated stamps are spread evenly where no stamp moves by more than this many of the stamps' steps.
_MOVES = 1.5


def signed(arrays: dict[str, np.ndarray]) -> list[str]:
    """Read registers of 16 bits as signed where they jump by 65536 about 0, in place; a note for each channel."""
    notes = []
    for name, x in _channels(arrays):
        whole = np.isfinite(x).all() and np.all(x == np.round(x)) and x.min() >= 0
        if not whole or not _WHOLE // 2 <= x.max() < _WHOLE:
            continue
        turned = np.where(x >= _WHOLE // 2, x - _WHOLE, x)
        rough, smooth = (np.abs(np.diff(y, axis=0)).sum(axis=0) for y in (x, turned))
        # One column that jumps shows what all of the channel's are.
        if np.any(rough > _CLOSER * smooth):
            arrays[name] = turned
            notes.append(
                f"{name} jumps by {_WHOLE} about 0: a register of 16 bits without its sign (two's complement), and was "
                "read as signed"
            )
    return notes


def spread(time: np.ndarray) -> tuple[np.ndarray, str]:
    """Stamps with those that repeat spread evenly, and a note; as they are where none does, or where that is no rate.

    Raises LogError for seconds since 1970 in single precision, which hold no time of day.
    """
    if time.dtype.kind != "f" or time.ndim != 1 or time.size < 10 or not np.isfinite(time).all():
        return time, ""
    step = np.diff(time)
    if np.any(step < 0) or np.all(step > 0):
        return time, ""
    coarse = float(np.spacing(np.float32(np.abs(time[-1]))))
    if time[0] > _EPOCH and coarse > _FLOAT32 and np.all(time == time.astype(np.float32)):
        raise LogError(
            f"stamps are float32: steps of {coarse:g} s at {time[0]:.2g} s; log them as float64, or from the start"
        )
    values = np.unique(time)
    if values.size < 3:
        return time, ""
    rounding = float(np.median(np.diff(values)))
    index = np.arange(time.size)
    period, start = np.polyfit(index, time - time[0], 1)
    even = time[0] + start + period * index
    if period <= 0 or np.abs(even - time).max() > _MOVES * rounding:
        return time, ""
    note = (
        f"stamps have a step of {1e3 * rounding:.3g} ms and samples come at {1 / period:.4g} Hz on average: they were "
        "spread evenly"
    )
    return even, note


def _channels(arrays: dict[str, np.ndarray]) -> list[tuple[str, np.ndarray]]:
    """The joints' channels over time that are numbers of the right form."""
    count = len(arrays.get("time", ()))
    return [
        (name, arrays[name])
        for name, shape in SHAPES.items()
        if shape == ("T", "n")
        and name in arrays
        and arrays[name].dtype.kind == "f"
        and arrays[name].ndim == 2
        and len(arrays[name]) == count
        and arrays[name].size
    ]
