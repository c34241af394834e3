"""Stretches of a log in which the robot rests, and what dry friction does to torques there.

At rest dry friction is whatever balances, up to its level F: one unknown for each joint and hold, with as many rows as
the hold has samples. Such a constant f ~ N(0, F²) in noise σ is integrated out exactly by taking a share of the
mean off every column of a hold of n rows,

    x ← x − (1 − √(σ² / (σ² + n F²))) x̄,

which makes N(0, σ² 1 + F² 11ᵀ) white. While a joint moves, its friction is F tanh(v / 0.01 rad/s).
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from jax_inertia.logs.findings import run_bounds
from jax_inertia.signals.differences import Observation
from jax_inertia.signals.torque_residual import FRICTION_VELOCITY

# Slower than this in every joint [rad/s, m/s], for at least so long [s], is a hold.
_STILL, _LONG = 0.02, 0.4
# A log that rests for less of its time is one of motion.
_SHARE = 0.2


@dataclasses.dataclass(frozen=True)
class Holds:
    """Where a log rests."""

    runs: Int[np.ndarray, "holds 2"]
    """First row and one past the last of each."""
    at_rest: Bool[np.ndarray, " T"]
    direction: Float[np.ndarray, "T nv"]
    """tanh(v / 0.01): the sign of each joint's speed while the robot moves, zero in a hold."""

    @property
    def share(self) -> float:
        """Of the rows that lie in holds."""
        return float(np.mean(self.at_rest))

    def __getitem__(self, rows: slice) -> "Holds":
        at_rest = self.at_rest[rows]
        return Holds(run_bounds(at_rest), at_rest, self.direction[rows])


def holds_of(observation: Observation) -> Holds | None:
    """The holds of a log that rests in several poses for a good part of its time; None for a log of motion."""
    v, time = np.asarray(observation.motion.v), np.asarray(observation.motion.time)
    runs = run_bounds(np.all(np.abs(np.nan_to_num(v)) < _STILL, axis=1))
    runs = runs[time[runs[:, 1] - 1] - time[runs[:, 0]] >= _LONG]
    at_rest = np.zeros(len(time), bool)
    for a, b in runs:
        at_rest[a:b] = True
    if len(runs) < 2 or at_rest.mean() < _SHARE:
        return None
    moving = np.where(at_rest[:, None], 0.0, np.tanh(np.nan_to_num(v) / FRICTION_VELOCITY))
    return Holds(runs, at_rest, moving)


def holds_note(holds: Holds, residual: Float[np.ndarray, " nv"], names: Sequence[str]) -> str:
    """What is to be said of a log that rests, with what a fit leaves of each row [N m] and the rows' names."""
    most = int(np.argmax(residual))
    return (
        f"the robot rests in {len(holds.runs)} poses for {100 * holds.share:.0f} % of the log: rows at rest carry dry "
        f"friction, an unknown of its own in each pose, which counts as noise of the residual ({names[most]}: "
        f"{residual[most]:.2g} N m rms); read the batch fit"
    )


def without_friction(
    x: Float[np.ndarray, "T nv *c"],
    valid: Bool[np.ndarray, "T nv"],
    holds: Holds,
    noise: Float[np.ndarray, " nv"],
    level: Float[np.ndarray, " nv"],
) -> Float[np.ndarray, "T nv *c"]:
    """Rows, zero where not valid, from which each hold's constant is integrated out.

    `noise` is σ and `level` F of each joint [N m].
    """
    out = np.array(x)
    spread = (..., *[None] * (x.ndim - 2))
    for a, b in holds.runs:
        count = valid[a:b].sum(axis=0)
        share = 1.0 - noise / np.sqrt(noise**2 + count * level**2)
        mean = x[a:b].sum(axis=0) / np.maximum(count, 1)[spread]
        out[a:b] -= np.where(valid[a:b][spread], (share[spread] * mean)[None], 0.0)
    return out
