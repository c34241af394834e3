"""Whether log and model mean the same, and how far off replays may be for no reason."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from jax_inertia.replay.loop import Loop, Parameter
from jax_inertia.replay.record import Record
from jax_inertia.replay.simulate import WINDOW, Windows

LOOSE_TIME = 1e-3
"""How well log and loop agree about the time [s]: half the hold of a loop of 500 Hz, which a model does not know."""
_REPEATS = 0.05
_AGAINST = -0.5
_MOVES = 0.02
_FAR = 0.3


def objections(record: Record, names: Sequence[str]) -> tuple[str, ...]:
    """What looks wrong about signs and zeros, one line a joint."""
    out = []
    for j, name in enumerate(names):
        q, target = record.q[:, j], record.target[:, j]
        if min(np.ptp(q), np.ptp(target)) > _MOVES and np.corrcoef(q, target)[0, 1] < _AGAINST:
            out.append(
                f"{name!r} moves against its targets: is the sign of qpos or of qpos_target turned?"
            )
        far = float(np.median(q - target))
        if abs(far) > _FAR:
            out.append(
                f"{name!r} stays {far:.2f} rad from its targets: do both have the same zero?"
            )
        if np.ptp(target) == 0 and np.ptp(q) > 0.1:
            out.append(
                f"qpos_target of {name!r} never changes, and it moves by {np.ptp(q):.2f} rad"
            )
    return tuple(out)


def encoder_noise(q: Float[np.ndarray, "T n"]) -> Float[np.ndarray, " n"]:
    """Standard deviation of one sample of each encoder [rad]: of its counts, or of what is no smooth motion."""
    out = np.zeros(q.shape[1])
    for j, x in enumerate(q.T):
        values = np.unique(x)
        steps = np.diff(values)
        steps = steps[steps > 1e-9]
        counted = len(values) < (1.0 - _REPEATS) * len(x) and steps.size > 0
        # Third differences of white noise have √20 of its deviation; the median leaves jolts out.
        rough = 1.4826 * float(np.median(np.abs(np.diff(x, 3)))) / np.sqrt(20.0)
        out[j] = float(np.median(steps)) / np.sqrt(12.0) if counted else rough
    return out


def floor(records: Sequence[Record]) -> Float[np.ndarray, " n"]:
    """What replays err by though nothing is wrong, rms [rad]: by encoders, and `LOOSE_TIME` at a joint's speed."""
    square = 0.0
    for r in records:
        speed = np.mean(np.gradient(r.q, r.time, axis=0) ** 2, axis=0)
        square = square + len(r.q) * (encoder_noise(r.q) ** 2 + LOOSE_TIME**2 * speed)
    return np.sqrt(square / sum(len(r.q) for r in records))


def torque_floor(
    records: Sequence[Record], loop: Loop, clock: float = LOOSE_TIME
) -> Float[np.ndarray, " n"]:
    """What the loop's torque errs by though nothing is wrong, rms [N m]: by encoders, and `clock` at its speed."""
    square, count = np.zeros(len(loop.kp)), 0
    for r in records:
        windows = Windows(r.time)
        counts = encoder_noise(r.q)
        speed = np.stack([windows.slope(x) for x in r.tau.T])
        own = (loop.kp * counts) ** 2 + (loop.kd * counts / WINDOW) ** 2 / 2.0
        own = own + encoder_noise(r.tau) ** 2 + clock**2 * np.mean(speed**2, axis=1)
        square, count = square + len(r.q) * own, count + len(r.q)
    return np.sqrt(square / count)


def least(records: Sequence[Record], loop: Loop) -> Float[np.ndarray, " m"]:
    """What remains of each output's error at least: what encoders leave.

    What the clocks leave is no noise of a sample: a fit may take it up in its delay.
    """
    encoders = np.sqrt(np.mean([np.mean(encoder_noise(r.q) ** 2) for r in records]))
    positions = np.full(len(loop.kp), encoders)
    if records[0].torque is None:
        return positions
    return np.concatenate([positions, torque_floor(records, loop, 0.0)])


def loose(table: Sequence[Parameter], loop: Loop) -> Float[np.ndarray, " P"]:
    """What `LOOSE_TIME` adds to each number's deviation: kp · δ is a damping or so much of kd, kd · δ an inertia."""
    sd = LOOSE_TIME / np.sqrt(3.0)
    out = np.zeros(len(table))
    for k, p in enumerate(table):
        if p.family in ("target_delay", "target_lag"):
            out[k] = sd
        elif p.family == "viscous_friction":
            out[k] = loop.kp[p.joint] * sd
        elif p.family == "armature":
            out[k] = loop.kd[p.joint] * sd
        elif p.family == "kd_scale":
            out[k] = loop.kp[p.joint] * sd / loop.kd[p.joint]
    return out
