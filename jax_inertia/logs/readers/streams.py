"""Streams of messages with stamps of their own, brought onto one set of stamps."""

import dataclasses

import numpy as np

from jax_inertia.logs.npz import LogError

_CHUNK = 4096
_GAP_PERIODS = 5.0


@dataclasses.dataclass(frozen=True)
class Stream:
    """Rows at increasing stamps: whole nanoseconds, since seconds since 1970 have no room for them."""

    time_ns: np.ndarray
    values: np.ndarray
    notes: tuple[str, ...] = ()


class Rows:
    """Rows as they come, kept in few large arrays."""

    def __init__(self) -> None:
        self._done: list[np.ndarray] = []
        self._rows: list[np.ndarray] = []
        self._stamps: list[int] = []

    def __len__(self) -> int:
        return len(self._stamps)

    @property
    def width(self) -> int:
        """Numbers in a row; 0 while there is none."""
        last = self._rows or self._done
        return int(last[-1].shape[-1]) if last else 0

    def add(self, stamp_ns: int, row: np.ndarray) -> None:
        """One row; all are of one length."""
        self._stamps.append(stamp_ns)
        self._rows.append(row)
        if len(self._rows) == _CHUNK:
            self._done.append(np.stack(self._rows))
            self._rows = []

    def stream(self, name: str) -> Stream:
        """The rows in the order of their stamps, of those with one stamp the last."""
        values = np.concatenate([*self._done, np.stack(self._rows)] if self._rows else self._done)
        if any(abs(stamp) >= 1 << 62 for stamp in self._stamps):
            raise LogError(f"{name} have stamps that are no time")
        time = np.array(self._stamps, dtype=np.int64)
        order = np.argsort(time, kind="stable")
        notes = []
        if (np.diff(time) < 0).any():
            notes.append(f"{name} did not come in the order of their stamps and were sorted")
        time, values = time[order], values[order]
        keep = np.append(np.diff(time) > 0, True)
        if not keep.all():
            notes.append(f"{int((~keep).sum())} {name} repeat a stamp and were dropped")
        return Stream(time[keep], values[keep], tuple(notes))


def onto(time_ns: np.ndarray, stream: Stream, name: str) -> tuple[Stream, str]:
    """Interpolate a stream linearly onto other stamps, and say so.

    Rows before its start, after its end, or in a gap of more than five of its periods are NaN.
    """
    own = stream.time_ns
    # Differences of whole numbers first: as they stand, stamps do not fit a double to the nanosecond.
    at, known = (time_ns - own[0]) * 1e-9, (own - own[0]) * 1e-9
    values = np.stack([np.interp(at, known, column) for column in stream.values.T], axis=-1)
    period = float(np.median(np.diff(known))) if len(known) > 1 else 0.0
    after = np.clip(np.searchsorted(known, at, side="left"), 1, max(len(known) - 1, 1))
    bare = (at < known[0]) | (at > known[-1])
    if len(known) > 1:
        between = ~np.isin(at, known)
        bare |= between & (known[after] - known[after - 1] > _GAP_PERIODS * period)
    values[bare] = np.nan
    rate = f"{1 / period:.4g} Hz" if period > 0 else "one message"
    note = f"{name} ({rate}) were interpolated linearly onto the stamps of the joint states"
    if bare.any():
        note += f"; {int(bare.sum())} of {len(at)} rows lie outside or in a gap and are NaN"
    if bare.all():
        raise LogError(f"{name} do not overlap in time with the joint states")
    return Stream(time_ns, values, stream.notes), note + "".join(f"; {n}" for n in stream.notes)
