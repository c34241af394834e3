"""MuJoCo's friction loss: a soft constraint, by which a joint never stands still but creeps.

With impedance d at rest and damping b the constraint's force is −(b q̇ + q̈)/R, R = A (1 − d)/d and A = [M⁻¹]ⱼⱼ,
until it comes to the level of the friction (MuJoCo, Computation: friction loss). So with little inertia a joint
that a simulator holds goes on for centiradians a second.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jax_inertia.dynamics import rigid_body
from jax_inertia.model.robot import BALL, FREE, HINGE, SLIDE, Robot

# MuJoCo's defaults: impedance of a constraint that is not violated, and the damping 2/(0.95 · 0.02 s) [1/s].
IMPEDANCE, DAMPING = 0.9, 2.0 / (0.95 * 0.02)


def softness(robot: Robot) -> Float[np.ndarray, " nv"]:
    """Speed of creeping per unit of torque held, R/b of each row, every joint at its reference as MuJoCo takes it."""
    q = np.zeros(robot.nq)
    nodes = robot.topology
    for kind, at, reference in zip(
        nodes.kind, nodes.qpos_adr, np.asarray(robot.joint_reference), strict=True
    ):
        if kind in (HINGE, SLIDE):
            q[at] = reference
        elif kind in (FREE, BALL):
            q[at + 3 * (kind == FREE)] = 1.0
    return np.asarray(_mobility(robot, jnp.asarray(q))) * (1.0 - IMPEDANCE) / IMPEDANCE / DAMPING


@eqx.filter_jit
def _mobility(robot: Robot, q: Float[Array, " nq"]) -> Float[Array, " nv"]:
    """[M⁻¹]ⱼⱼ."""
    return jnp.diagonal(jnp.linalg.inv(rigid_body.mass_matrix(robot, q)))
