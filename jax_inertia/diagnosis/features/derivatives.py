"""The model's derivatives along a motion, compiled once per robot: by parameters, by state, by contact forces."""

import jax
import jax.numpy as jnp
import numpy as np

from jax_inertia.dynamics import rigid_body
from jax_inertia.maths.over_samples import OverSamples
from jax_inertia.model.robot import HINGE, SLIDE
from jax_inertia.signals.torque_residual import needed_torque


@OverSamples
def regressor(robot, x):
    """Torque regressor of all bodies at (q, q̇, q̈) (T, nv, nb, 10)."""
    return rigid_body.torque_regressor(robot, *x)


@OverSamples
def sensitivity(robot, o):
    """∂/∂q, ∂/∂q̇, ∂/∂q̈ of the torque that an observation needs, along hinge and slide rows (T, nv, nv) each."""
    rows = np.array(
        [
            [d, k]
            for kind, d, k in zip(
                robot.joint_type, robot.joint_dofadr, robot.joint_qposadr, strict=True
            )
            if kind in (HINGE, SLIDE)
        ]
    ).reshape(-1, 2)
    dofs, adrs = rows[:, 0], rows[:, 1]

    def needed(dq, v, a):
        return needed_torque(robot, o.motion.q.at[adrs].add(dq), v, a, o)

    wide, dv, da = jax.jacfwd(needed, argnums=(0, 1, 2))(
        jnp.zeros(len(adrs), o.motion.q.dtype), o.motion.v, o.a
    )
    return jnp.zeros_like(da).at[:, dofs].set(wide), dv, da


@OverSamples
def contact_rows(shared, x):
    """Torque of each contact's wrench w (C, 6) at q (T, C, nv); `shared`: the robot and the contacts' bodies."""
    robot, bodies = shared
    q, w = x
    alone = jnp.eye(len(bodies))[:, :, None] * w
    return jax.vmap(lambda x: rigid_body.contact_torque(robot, q, x, bodies))(alone)
