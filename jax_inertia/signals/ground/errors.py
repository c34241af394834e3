"""What forces of the ground that are not measured take for exact, as torques of one standard deviation of each number.

The legs' torques give the forces, so what is wrong of a leg is seen on the base: its joints' friction, of which a level
is known to some percent and how it turns round after a reversal is not; and how high above the ground a foot touches.
An estimate that takes these for exact counts them in its intervals (the consider covariance of Schmidt, 1966).
"""

import numpy as np
from jaxtyping import Float

from jax_inertia.model.robot import Robot
from jax_inertia.signals.dry_friction import bristle
from jax_inertia.signals.generalised_motion import Motion
from jax_inertia.signals.ground.support import Support

LEVEL = 0.1
"""Friction of a joint, relative: dampings and levels of good models are 5 to 10 % off."""
TURNS_OVER = 1e-3
"""Displacement over which dry friction turns round [rad]: that of real joints lies within 1e-4 and 1e-3."""
HEIGHT = 0.003
"""Of the point at which a foot touches [m]: rubber gives and wears by millimetres."""


def unsure(
    robot: Robot, motion: Motion, support: Support, friction_velocity: float
) -> Float[np.ndarray, "T nv k"]:
    """Columns: two of each joint of a leg that stands, F tanh(v / `friction_velocity`) its dry friction, one of height.

    On rows that the ground's forces leave; feet sink by the model's law at most.
    """
    q, v = np.asarray(motion.q), np.asarray(motion.v)
    dry, damping = np.asarray(robot.frictionloss), np.asarray(robot.damping)
    out = [support.of_height(robot, q, float(np.hypot(HEIGHT, support.depth)))]
    for row, at in zip(robot.joint_dofadr, robot.joint_qposadr, strict=True):
        if not robot.topology.dof_scalar[row] or not support.used_up[:, row].any():
            continue
        side = np.tanh(v[:, row] / friction_velocity)
        turning = bristle(q[:, at], float(side[0]), TURNS_OVER)
        level = LEVEL * (dry[row] * side + damping[row] * v[:, row])
        out += [support.left_of(x, row) for x in (level, dry[row] * (turning - side))]
    return np.stack(out, axis=-1)
