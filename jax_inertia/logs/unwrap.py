"""Angles that are logged in one turn only, laid end to end again.

A hinge does not know how many turns it has made, so an angle that jumps by a whole turn where it leaves (−π, π] is the
same motion, with a difference quotient that is wrong by 2π / period at every jump.
"""

import numpy as np
from jaxtyping import Float

_TURN = 2.0 * np.pi
# The rest of a jump without its turn must be the joint's own motion, to so much [rad].
_OFF = 0.02
# Between samples a joint turns by less than this [rad]; else turns cannot be distinguished from motion.
_FAR = 1.0


def unwrapped(
    time: Float[np.ndarray, " T"],
    qpos: Float[np.ndarray, " T"],
    qvel: Float[np.ndarray, " T"] | None,
    before: float | None = None,
) -> tuple[Float[np.ndarray, " T"], int]:
    """A hinge's positions without jumps by whole turns [rad], and how many jumps there were.

    A jump is one where the rest of it is what the velocities say, or without them what the joint did just before
    and after, to 0.02 rad; where other steps are as large as a radian nothing is done. NaN is passed over. `before` is
    the last position of what came before, where these samples go on from there.
    """
    known = np.flatnonzero(np.isfinite(qpos))
    if known.size < 3:
        return qpos, 0
    x, t = qpos[known], time[known]
    step = np.diff(x)
    turns = np.round(step / _TURN)
    whole, rest = turns != 0, step - _TURN * turns
    if np.any(np.abs(np.where(whole, rest, step)) > _FAR):
        return qpos, 0
    if whole.any() and not _is_motion(t, rest, whole, None if qvel is None else qvel[known]):
        return qpos, 0
    out = np.array(qpos)
    start = 0.0 if before is None or not np.isfinite(before) else np.round((x[0] - before) / _TURN)
    out[known] = x - _TURN * (start + np.concatenate([[0.0], np.cumsum(turns)]))
    return out, int(whole.sum())


def _is_motion(time: np.ndarray, rest: np.ndarray, at: np.ndarray, qvel: np.ndarray | None) -> bool:
    """Whether every jump without its turn is the joint's motion."""
    period = np.diff(time)
    if qvel is not None and np.isfinite(qvel[:-1][at] + qvel[1:][at]).all():
        moved = 0.5 * (qvel[1:] + qvel[:-1])[at] * period[at]
    else:
        # As fast as the steps around it that are no jumps, on average.
        speed = np.where(at, np.nan, rest / period)
        beside = np.concatenate([[np.nan], speed, [np.nan]])
        beside = np.stack([beside[:-2], beside[2:]])[:, at]
        moved = np.where(np.isnan(beside).all(axis=0), 0.0, _mean(beside)) * period[at]
    return bool(np.all(np.abs(rest[at] - moved) < _OFF + 0.5 * np.abs(moved)))


def _mean(pair: np.ndarray) -> np.ndarray:
    known = np.isfinite(pair)
    return np.where(known, pair, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)


def beside(x: Float[np.ndarray, " T"], qpos: Float[np.ndarray, " T"]) -> Float[np.ndarray, " T"]:
    """Another angle of the same joint, such as its target, moved by whole turns to within half a turn of it [rad]."""
    turns = np.round((qpos - x) / _TURN)
    return x + _TURN * np.where(np.isfinite(turns), turns, 0.0)
