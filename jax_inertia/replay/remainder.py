"""What a replay's remaining error is like: at each joint the generic shape that goes with it best, and its frequency.

Shapes are of the measured motion and of the targets. A torque that the model lacks moves a position loop by that
torque over kp where the motion is slow, so that the error has the shape of what causes it; each shape's share is R²
of the error regressed on it and a constant, at its best lag of up to `_LAGS`.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from jax_inertia.replay.record import Record
from jax_inertia.replay.result import Resemblance

_LEAST = 0.1
"""Of the error's variance, what a shape that is named goes with."""
_LAGS = 0.1
"""[s]"""
_SLOW = 0.02
"""Speed at which the direction of a motion has turned half [rad/s]."""


def resemblances(
    names: Sequence[str],
    joints: Sequence[str],
    paths: Sequence[Float[np.ndarray, "T n"]],
    records: Sequence[Record],
) -> tuple[Resemblance, ...]:
    """Of the joints that are asked about; `paths`: positions of each record, replayed."""
    out = []
    for name in joints:
        j = list(names).index(name)
        errors = [(p[:, j] - r.q[:, j])[r.settled] for p, r in zip(paths, records, strict=True)]
        every = [shapes(names, j, r) for r in records]
        best = ("", 0.0)
        for shape in every[0]:
            share = _share(
                errors, [s[shape][r.settled] for s, r in zip(every, records, strict=True)], records
            )
            best = max(best, (shape, share), key=lambda x: x[1])
        longest = int(np.argmax([len(e) for e in errors]))
        at = _frequency(errors[longest], records[longest].period)
        shape, share = best if best[1] >= _LEAST else ("", best[1])
        out.append(Resemblance(name, shape, share, at))
    return tuple(out)


def shapes(names: Sequence[str], j: int, r: Record) -> Mapping[str, Float[np.ndarray, " T"]]:
    """By name, along a record: of joint j's own motion, of its target, of other joints, and of time."""
    q, target, t = r.q[:, j], r.target[:, j], r.time
    wide = max(round(0.02 / r.period), 1)
    v, a = _slopes(q, wide, r.period)
    out = {
        "position": q,
        "speed": v,
        "direction of motion": np.tanh(v / _SLOW),
        "speed squared": np.abs(v) * v,
        "acceleration": a,
        "distance from the target": target - q,
        "integral of the distance from the target": np.cumsum(target - q) * r.period,
        "size of the distance from the target": np.abs(target - q),
        "time": t,
    }
    for k, name in enumerate(names):
        if k != j:
            other, bend = _slopes(r.q[:, k], wide, r.period)
            out[f"position of {name}"] = r.q[:, k]
            out[f"speed of {name}"] = other
            out[f"acceleration of {name}"] = bend
    return out


def _slopes(q: np.ndarray, wide: int, period: float) -> tuple[np.ndarray, np.ndarray]:
    """Speed and acceleration over ± `wide` samples."""
    padded = np.pad(q, wide, mode="edge")
    after, before = padded[2 * wide :], padded[: -2 * wide]
    v = (after - before) / (2 * wide * period)
    return v, (after - 2 * q + before) / (wide * period) ** 2


def _share(errors, columns, records: Sequence[Record]) -> float:
    """The largest R² over lags of the shape behind itself."""
    best = 0.0
    step = max(round(0.02 / records[0].period), 1)
    for late in range(0, round(_LAGS / records[0].period) + 1, step):
        e = np.concatenate([x[late:] - x[late:].mean() for x in errors if len(x) > late + 2])
        c = np.concatenate(
            [x[: len(x) - late] - x[: len(x) - late].mean() for x in columns if len(x) > late + 2]
        )
        power = float(e @ e) * float(c @ c)
        best = max(best, float(e @ c) ** 2 / power if power > 0 else 0.0)
    return best


def _frequency(e: Float[np.ndarray, " T"], period: float) -> float:
    """Where the periodogram of an error is largest [Hz]."""
    power = np.abs(np.fft.rfft((e - e.mean()) * np.hanning(len(e)))) ** 2
    at = np.fft.rfftfreq(len(e), period)
    return float(at[1 + int(np.argmax(power[1:]))]) if len(power) > 1 else 0.0
