"""What a whole-body controller needs to know of the robot at one instant, from one forward pass.

The six rows of a floating base hold the whole robot's momentum: with the base's linear velocity in world axes they are
Newton's and Euler's equations of all bodies together, so that centre of mass and centroidal momentum cost nothing
beyond M and c.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jax_inertia.dynamics.kinematics import accumulate_outward, forward_kinematics, tree_origin
from jax_inertia.dynamics.rigid_body import inverse_dynamics, mass_matrix
from jax_inertia.maths import spatial
from jax_inertia.model.robot import Robot


class Terms(eqx.Module):
    """Equation of motion M v̇ + c = τ + Jᵀλ and the tasks' kinematics: each task moves with A v̇ + b."""

    mass: Float[Array, "nv nv"]
    bias: Float[Array, " nv"]
    """c(q, v), gravity and joint damping included [N m, N]."""
    weight: Float[Array, ""]
    """The robot's mass [kg]."""
    com: Float[Array, "3"]
    com_velocity: Float[Array, "3"]
    com_jacobian: Float[Array, "3 nv"]
    com_bias: Float[Array, "3"]
    momentum: Float[Array, "3"]
    """Angular momentum about the centre of mass, world axes [kg m²/s]."""
    momentum_jacobian: Float[Array, "3 nv"]
    momentum_bias: Float[Array, "3"]
    rotation: Float[Array, "k 3 3"]
    position: Float[Array, "k 3"]
    velocity: Float[Array, "k 6"]
    """[linear; angular] of each body's frame origin, world axes."""
    jacobian: Float[Array, "k 6 nv"]
    jacobian_bias: Float[Array, "k 6"]


def terms(
    robot: Robot, q: Float[Array, " nq"], v: Float[Array, " nv"], bodies: tuple[int, ...]
) -> Terms:
    """`Terms` at (q, v), with the kinematics of the chosen bodies (by index); the base is a free joint."""
    top = robot.topology
    kin = forward_kinematics(robot, q)
    origin = tree_origin(robot, q)
    mass = mass_matrix(robot, q)
    dynamic = inverse_dynamics(robot, q, v, jnp.zeros_like(v))

    every = np.array(top.body_node, int)
    base = kin.rotation[every[0]]
    total = jnp.sum(robot.pi[:, 0])
    moment = robot.pi[:, :1] * kin.position[every]
    moment = moment + spatial.matvec(kin.rotation[every], robot.pi[:, 1:4])
    com = jnp.sum(moment, axis=0) / total
    lever = spatial.skew(com)
    momentum_jacobian = base @ mass[3:6] - lever @ mass[:3]
    momentum_bias = base @ dynamic[3:6] - lever @ dynamic[:3]

    nodes = every[list(bodies)]
    speed = accumulate_outward(robot, kin.axes * v[:, None])
    # World-fixed axes (translations of a free joint) do not turn with the body.
    turning = jnp.where(top.dof_in_world[:, None], 0.0, v[:, None])
    rate = spatial.motion_cross(speed[top.dof_node], kin.axes) * turning
    w, u = speed[nodes, :3], speed[nodes, 3:]
    drift = accumulate_outward(robot, rate)[nodes]
    position = kin.position[nodes]
    linear = u + spatial.cross(w, position)
    bias = drift[:, 3:] + spatial.cross(drift[:, :3], position) + spatial.cross(w, linear)
    axes = kin.axes[None] * jnp.asarray(top.body_dof[list(bodies)], v.dtype)[:, :, None]
    jacobian = jnp.concatenate(
        [axes[..., 3:] + spatial.cross(axes[..., :3], position[:, None]), axes[..., :3]], -1
    )
    return Terms(
        mass=mass,
        bias=dynamic + robot.damping * v,
        weight=total,
        com=com + origin[every[0]],
        com_velocity=mass[:3] @ v / total,
        com_jacobian=mass[:3] / total,
        com_bias=dynamic[:3] / total + robot.gravity,
        momentum=momentum_jacobian @ v,
        momentum_jacobian=momentum_jacobian,
        momentum_bias=momentum_bias,
        rotation=kin.rotation[nodes],
        position=position + origin[nodes],
        velocity=jnp.concatenate([linear, w], -1),
        jacobian=jnp.swapaxes(jacobian, 1, 2),
        jacobian_bias=jnp.concatenate([bias, drift[:, :3]], -1),
    )
