"""Whether a function of the state that no family has does better than what was found.

A mechanical stop is no push, though it happens in passing, and oil that drags as the square of speed is no spring. So
each found effect is tried against free functions of one joint's position or speed, piecewise linear over its range:
where one fits better by more than its numbers cost and than the found equation's own error may leave, the cause is not
in the library, and the log itself says what it depends on.
"""

import dataclasses

import numpy as np

from jax_inertia.gap.candidate import Beside, Candidate
from jax_inertia.gap.families.base import Columns
from jax_inertia.gap.pool import Pool
from jax_inertia.gap.select import STOP, remaining, stacked

KNOTS = 24


@dataclasses.dataclass(frozen=True)
class Hidden:
    """A free function of one joint's state."""

    joint: str
    of: str
    """'position' or 'speed'."""
    columns: np.ndarray
    """An orthonormal basis of its torques, in the charged metric."""


def hidden_functions(pool: Pool) -> list[Hidden]:
    """All free functions of one joint's position or speed."""
    context, out = pool.context, []
    for joint, row in context.joint_dofs.items():
        for of, x in (("position", context.joint_position[:, row]), ("speed", context.v[:, row])):
            columns = pool.evidence.column(Columns(_hats(x), row))
            left, size, _ = np.linalg.svd(columns, full_matrices=False)
            out.append(Hidden(joint, of, left[:, size > 1e-3 * max(float(size[0]), 1e-300)]))
    return out


def better_than(
    pool: Pool, chosen: list[Candidate], noise: float
) -> tuple[Candidate, Hidden] | None:
    """A found effect and the free function that should be in its place; None where all stand."""
    if not chosen:
        return None
    hidden = hidden_functions(pool)
    now = float(np.sum(remaining(pool, chosen) ** 2))
    unit = max(1.0, now / max(noise, 1.0))
    best, most = None, 0.0
    for i, c in enumerate(chosen):
        # What happens in passing may have been needed several times for one cause.
        others = [
            x
            for k, x in enumerate(chosen)
            if k != i and not (c.family.passing and x.family.passing)
        ]
        rest = Beside.of(pool.evidence, *stacked(pool, others))
        size = c.size * (len(chosen) - len(others))
        allowed = c.excuses(c.effect)
        if c.family.passing:
            # Any bump may be drawn by enough pushes: what they miss is excused as far as it is there.
            allowed = min(allowed, max(now - noise, 0.0))
        for h in hidden:
            free = rest.free(h.columns)
            left = np.linalg.lstsq(free, rest.target, rcond=None)
            after = float(np.sum((rest.target - free @ left[0]) ** 2))
            price = (h.columns.shape[1] - size) * np.log(pool.evidence.rows)
            won = (now - after - allowed) / unit - price - STOP
            if won > most:
                best, most = (c, h), won
    return best


def leans_on(pool: Pool, chosen: list[Candidate]) -> tuple[Hidden, float]:
    """The free function that fits best what the effects leave, and its share of that."""
    left = remaining(pool, chosen)
    total = max(float(left @ left), 1e-300)
    shares = [(h, float(np.sum((h.columns.T @ left) ** 2)) / total) for h in hidden_functions(pool)]
    return max(shares, key=lambda x: x[1])


def _hats(x: np.ndarray) -> np.ndarray:
    """Hat functions over the range of x, (T, KNOTS)."""
    place = (x - x.min()) / max(float(np.ptp(x)), 1e-12) * (KNOTS - 1)
    return np.maximum(0.0, 1.0 - np.abs(place[:, None] - np.arange(KNOTS)))
