"""Over which displacement a joint's dry friction turns round after a reversal, by what the log shows.

Bristles bend before they slip (presliding; Dahl 1968): a friction F that turns over 0.3 mrad instead of at once lets a
wrist go some milliradians further within a quarter of a second. No model states that displacement, and no effect stands
for it; rollouts that are to show what a model lacks must not stumble over it.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from jax_inertia.gap.candidate import Candidate, effect_torque
from jax_inertia.gap.families.joint import DryFriction
from jax_inertia.gap.pool import Pool

REACHES = (0.0, *np.geomspace(4e-5, 3e-3, 10).tolist())
"""[rad]; zero: at once."""


def turning(
    pool: Pool, chosen: Sequence[Candidate]
) -> tuple[Float[np.ndarray, " nv"], Float[np.ndarray, "R nv"]]:
    """(displacement of each row [rad], missing torque once the model's own friction turns over it).

    The second is of the finished missing torque beside the effects, friction among them turning alike.
    """
    context, prepared, used = pool.context, pool.context.prepared, pool.evidence.used
    left = prepared.finish_torque(prepared.missing)
    rubbing: dict[int, list[Candidate]] = {}
    for c in chosen:
        if isinstance(c.family, DryFriction):
            rubbing.setdefault(c.place.index, []).append(c)
        else:
            left = left - prepared.finish_torque(effect_torque(context, c))
    reaches = np.zeros(context.robot.nv)
    for row in context.joint_dofs.values():
        own = float(context.frictionloss[row])
        found = rubbing.get(row, [])
        if own <= 0 and not found:
            continue
        tried = []
        for reach in REACHES:
            z = context.bristle(row, reach) if reach else context.side[:, row]
            rubbed = own * (context.side[:, row] - z)
            for c in found:
                rubbed = rubbed + _torque(pool, c, reach)
            tried.append(left[:, row] - prepared.finish_torque(rubbed, row))
        best = int(np.argmin([np.sum(x[used[:, row]] ** 2) for x in tried]))
        reaches[row], left[:, row] = REACHES[best], tried[best]
    return reaches, left


def _torque(pool: Pool, c: Candidate, reach: float) -> Float[np.ndarray, " T"]:
    """A found friction's torque on its row where it turns over `reach`."""
    columns = c.family.columns(pool.context, c.place, (*c.shape[:-1], reach))
    return columns.values @ c.family.weights(pool.context, c.place, c.theta)
