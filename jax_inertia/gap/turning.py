"""How a joint's dry friction turns round after a reversal, by what the log shows: over a displacement, or creeping.

Bristles bend before they slip (presliding; Dahl 1968): a friction F that turns over 0.3 mrad instead of at once lets a
wrist go some milliradians further within a quarter of a second. No model states that displacement, and no effect stands
for it; rollouts that are to show what a model lacks must not stumble over it.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from jax_inertia.diagnosis.effects.dry_friction import direction
from jax_inertia.diagnosis.features.context import Context
from jax_inertia.diagnosis.simulate.plant import CREEPS
from jax_inertia.gap.candidate import Candidate, effect_torque
from jax_inertia.gap.families.friction import DryFriction
from jax_inertia.gap.pool import Pool

REACHES = (0.0, *np.geomspace(4e-5, 3e-3, 10).tolist())
"""[rad]; zero: at once."""


def turning(
    pool: Pool, chosen: Sequence[Candidate]
) -> tuple[Float[np.ndarray, " nv"], Float[np.ndarray, "R nv"]]:
    """(displacement of each row [rad] or `CREEPS`, missing torque once the model's own friction turns over it).

    The second is of the finished missing torque beside the effects, friction among them turning alike.
    """
    context, prepared, used = pool.context, pool.context.prepared, pool.evidence.used
    left = prepared.finish_torque(prepared.missing)
    rubbing: dict[int, list[Candidate]] = {}
    level = context.frictionloss.copy()
    for c in chosen:
        if isinstance(c.family, DryFriction):
            rubbing.setdefault(c.place.index, []).append(c)
            level[c.place.index] += c.family.level(c.theta)
        else:
            left = left - prepared.finish_torque(effect_torque(context, c))
    reaches = np.zeros(context.robot.nv)
    for row in context.joint_dofs.values():
        own = float(context.frictionloss[row])
        found = rubbing.get(row, [])
        if own <= 0 and not found:
            continue
        ways = (*REACHES, -max(float(level[row]), 1e-9))
        tried = []
        seen = slice(None) if prepared.spreads(row) else row
        for reach in ways:
            z = direction(context, row, reach)
            rubbed = own * (context.side[:, row] - z)
            for c in found:
                rubbed = rubbed + turning_over(context, c, reach)[:, row]
            tried.append(left[:, seen] - prepared.finish_torque(rubbed, row))
        best = int(np.argmin([np.sum(x[used[:, seen]] ** 2) for x in tried]))
        reaches[row], left[:, seen] = ways[best] if ways[best] >= 0 else CREEPS, tried[best]
    return reaches, left


def turning_over(context: Context, c: Candidate, reach: float) -> Float[np.ndarray, "T nv"]:
    """A found friction's torque on the fast grid of any log, where it turns round over `reach`."""
    assert isinstance(c.family, DryFriction)
    return effect_torque(context, c, c.family.turning_over(c.shape, reach))
