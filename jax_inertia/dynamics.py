"""Rigid-body dynamics in world coordinates: inverse dynamics, torque regressor, mass matrix, contact torques.

Every function takes one sample and is differentiable, `jit`- and `vmap`-friendly. The paper's condensed form
(eq. decomp-tau) is `condensed_dynamics`: one forward pass shared by the regressor of the chosen bodies and the
torque of all the others.
"""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jax_inertia import spatial
from jax_inertia.inertia import rotational_inertia
from jax_inertia.robot import (
    Kinematics,
    Robot,
    accumulate_inward,
    accumulate_outward,
    forward_kinematics,
    tree_origin,
)


class BodyMotion(eqx.Module):
    """Angular velocity, angular acceleration and proper acceleration of bodies, in their own frames."""

    angular_velocity: Float[Array, "nb 3"]
    angular_acceleration: Float[Array, "nb 3"]
    proper_acceleration: Float[Array, "nb 3"]
    """Acceleration of the frame origin minus gravity [m/s²]."""


def inverse_dynamics(
    robot: Robot, q: Float[Array, " nq"], v: Float[Array, " nv"], a: Float[Array, " nv"]
) -> Float[Array, " nv"]:
    """Generalised force M(q) a + c(q, v) (Foster et al., eq. 1), armature included, passive forces apart."""
    kin = forward_kinematics(robot, q)
    motion = _body_motion(robot, kin, v, a)
    return _torque(robot, kin, motion, robot.pi) + robot.armature * a


def torque_regressor(
    robot: Robot,
    q: Float[Array, " nq"],
    v: Float[Array, " nv"],
    a: Float[Array, " nv"],
    bodies: Sequence[int | str] | None = None,
) -> Float[Array, "nv nb 10"]:
    """Regressor Y with Y π = `inverse_dynamics` − armature · a (Foster et al., eq. invdyn-regressor).

    `bodies` asks for the chosen ones only, by name or index (nv, len(bodies), 10); None means all of them.
    Raises ValueError for a body that the robot does not have.
    """
    chosen = resolve_bodies(robot, bodies)
    kin = forward_kinematics(robot, q)
    return _regressor(robot, kin, _body_motion(robot, kin, v, a), chosen)


def condensed_dynamics(
    robot: Robot,
    q: Float[Array, " nq"],
    v: Float[Array, " nv"],
    a: Float[Array, " nv"],
    bodies: Sequence[int | str],
) -> tuple[Float[Array, "nv n 10"], Float[Array, " nv"]]:
    """Y^est of the chosen bodies and τ^nom of all the rest, from one forward pass (Foster et al., eq. decomp-tau).

    Y^est π^est + τ^nom = `inverse_dynamics`; armature is part of τ^nom.
    """
    chosen = resolve_bodies(robot, bodies)
    kin = forward_kinematics(robot, q)
    motion = _body_motion(robot, kin, v, a)
    keep = np.ones((robot.nb, 1))
    keep[list(chosen)] = 0.0
    nominal = _torque(robot, kin, motion, robot.pi * jnp.asarray(keep, robot.pi.dtype))
    return _regressor(robot, kin, motion, chosen), nominal + robot.armature * a


def mass_matrix(robot: Robot, q: Float[Array, " nq"]) -> Float[Array, "nv nv"]:
    """Joint-space inertia M(q), armature included, by composite rigid bodies in world coordinates."""
    kin = forward_kinematics(robot, q)
    composite = accumulate_inward(robot, _world_pi(robot, kin))
    w, u = kin.axes[:, :3], kin.axes[:, 3:]
    h, inertia = composite[:, 1:4], rotational_inertia(composite)
    moment = spatial.matvec(inertia, w) + spatial.cross(h, u)
    force = composite[:, :1] * u - spatial.cross(h, w)
    coupling = kin.axes @ jnp.concatenate([moment, force], -1).T
    # Entry [j, k] holds where joint j carries joint k; the other half follows by symmetry.
    top = robot.topology
    carries = np.triu(top.node_dof[top.dof_node].T)
    upper = jnp.where(carries > 0, coupling, 0.0)
    strict = jnp.where(np.tri(robot.nv, k=0) > 0, 0.0, upper)
    return upper + strict.T + jnp.diag(robot.armature)


def passive_torque(
    robot: Robot,
    q: Float[Array, " nq"],
    v: Float[Array, " nv"],
    *,
    friction_velocity: float = 1e-3,
) -> Float[Array, " nv"]:
    """Torque of the model's own joint damping, springs and dry friction: −d v − k (q − q₀) − F tanh(v/v_f).

    MuJoCo treats `frictionloss` as a constraint; away from rest it is F sign(v), which tanh with
    `friction_velocity` [rad/s] smooths. Springs act on hinge and slide joints.
    """
    top = robot.topology
    adr = np.array(top.qpos_adr)[top.dof_node]
    spring = robot.stiffness * (q[adr] - robot.spring_reference)
    friction = robot.frictionloss * jnp.tanh(v / friction_velocity)
    return -robot.damping * v - spring - friction


def body_poses(
    robot: Robot, q: Float[Array, " nq"]
) -> tuple[Float[Array, "nb 3 3"], Float[Array, "nb 3"]]:
    """World rotation and frame-origin position [m] of every body."""
    kin = forward_kinematics(robot, q)
    nodes = np.array(robot.topology.body_node, int)
    return kin.rotation[nodes], kin.position[nodes] + tree_origin(robot, q)[nodes]


def body_jacobian(robot: Robot, q: Float[Array, " nq"], body: int | str) -> Float[Array, "6 nv"]:
    """Jacobian [linear; angular] of a body's frame origin, world axes: J v is its velocity, Jᵀ its wrench's torque."""
    (index,) = resolve_bodies(robot, [body])
    kin = forward_kinematics(robot, q)
    return _body_jacobian(robot, kin, index)


def contact_torque(
    robot: Robot,
    q: Float[Array, " nq"],
    wrenches: Float[Array, "contacts 6"],
    bodies: Sequence[int | str],
) -> Float[Array, " nv"]:
    """Σ Jᵀ λ of wrenches [force; moment] on `bodies`: world axes, N and N m, moments about their frame origins."""
    kin = forward_kinematics(robot, q)
    chosen = resolve_bodies(robot, bodies)
    torques = [w @ _body_jacobian(robot, kin, i) for i, w in zip(chosen, wrenches, strict=True)]
    return sum(torques, jnp.zeros(robot.nv, q.dtype))


def resolve_bodies(robot: Robot, bodies: Sequence[int | str] | None) -> tuple[int, ...]:
    """Body indices of names or indices, None meaning all; ValueError says which is wrong and lists the names."""
    if bodies is None:
        return tuple(range(robot.nb))
    if isinstance(bodies, str):
        bodies = [bodies]
    out = tuple(robot.body_index(b) if isinstance(b, str) else int(b) for b in bodies)
    for i in out:
        if not 0 <= i < robot.nb:
            raise ValueError(f"body index {i} is out of range: the model has {robot.nb} bodies")
    if len(set(out)) != len(out):
        raise ValueError(f"a body is named twice in {list(bodies)}")
    return out


# --- the passes --------------------------------------------------------------------------------------------------


def _body_motion(
    robot: Robot, kin: Kinematics, v: Float[Array, " nv"], a: Float[Array, " nv"]
) -> BodyMotion:
    """Outward pass: spatial velocity and acceleration in world coordinates, then in each body's frame."""
    top = robot.topology
    velocity = accumulate_outward(robot, kin.axes * v[:, None])
    # World-fixed axes (translations of a free joint) do not turn with the body.
    turning = jnp.where(top.dof_in_world[:, None], 0.0, v[:, None])
    rate = spatial.motion_cross(velocity[top.dof_node], kin.axes) * turning
    acceleration = accumulate_outward(robot, kin.axes * a[:, None] + rate)

    nodes = np.array(top.body_node, int)
    rotation, position = kin.rotation[nodes], kin.position[nodes]
    w, u = velocity[nodes, :3], velocity[nodes, 3:]
    dw, du = acceleration[nodes, :3], acceleration[nodes, 3:] - robot.gravity
    # Spatial to classical: the origin of the body moves at u + ω × p and accelerates ω × that more.
    origin = u + spatial.cross(w, position)
    proper = du + spatial.cross(dw, position) + spatial.cross(w, origin)
    return BodyMotion(
        spatial.matvec_t(rotation, w),
        spatial.matvec_t(rotation, dw),
        spatial.matvec_t(rotation, proper),
    )


def _torque(
    robot: Robot, kin: Kinematics, motion: BodyMotion, pi: Float[Array, "nb 10"]
) -> Float[Array, " nv"]:
    """Inward pass: the wrench that each body needs, summed over the bodies that each joint moves."""
    m, h, inertia = pi[:, :1], pi[:, 1:4], rotational_inertia(pi)
    w, dw, d = (
        motion.angular_velocity,
        motion.angular_acceleration,
        motion.proper_acceleration,
    )
    force = m * d + spatial.cross(dw, h) + spatial.cross(w, spatial.cross(w, h))
    moment = (
        spatial.matvec(inertia, dw)
        + spatial.cross(w, spatial.matvec(inertia, w))
        + spatial.cross(h, d)
    )
    nodes = np.array(robot.topology.body_node, int)
    force = spatial.matvec(kin.rotation[nodes], force)
    moment = spatial.matvec(kin.rotation[nodes], moment) + spatial.cross(kin.position[nodes], force)
    total = accumulate_inward(robot, jnp.concatenate([moment, force], -1))
    return jnp.sum(kin.axes * total, -1)


def _regressor(
    robot: Robot, kin: Kinematics, motion: BodyMotion, chosen: tuple[int, ...]
) -> Float[Array, "nv n 10"]:
    """Inward pass, linear in π: each joint's axis, seen from the body, times the body's own 6×10 regressor."""
    pick = np.array(chosen, int)
    own = jax.vmap(_body_regressor)(jax.tree.map(lambda x: x[pick], motion))
    nodes = np.array(robot.topology.body_node, int)[pick]
    rotation, position = kin.rotation[nodes], kin.position[nodes]
    w, u = kin.axes[None, :, :3], kin.axes[None, :, 3:]
    u = u + spatial.cross(w, position[:, None])
    seen = jnp.concatenate([w @ rotation, u @ rotation], -1)
    seen = seen * jnp.asarray(robot.topology.body_dof[pick], seen.dtype)[:, :, None]
    return jnp.swapaxes(seen @ own, 0, 1)


def _body_regressor(motion: BodyMotion) -> Float[Array, "6 10"]:
    """[moment; force] = A π about the body's own origin (Atkeson, An and Hollerbach 1986, in this order of π)."""
    w, dw, d = (
        motion.angular_velocity,
        motion.angular_acceleration,
        motion.proper_acceleration,
    )
    sw = spatial.skew(w)
    zero = jnp.zeros((3, 1), w.dtype)
    moment = jnp.concatenate([zero, -spatial.skew(d), _lever(dw) + sw @ _lever(w)], -1)
    force = jnp.concatenate(
        [d[:, None], spatial.skew(dw) + sw @ sw, jnp.zeros((3, 6), w.dtype)], -1
    )
    return jnp.concatenate([moment, force])


def _lever(w: Float[Array, "3"]) -> Float[Array, "3 6"]:
    """L(ω) with L(ω) [Ixx, Ixy, Ixz, Iyy, Iyz, Izz] = I ω."""
    x, y, z = w
    o = jnp.zeros_like(x)
    return jnp.stack(
        [
            jnp.stack([x, y, z, o, o, o]),
            jnp.stack([o, x, o, y, z, o]),
            jnp.stack([o, o, x, o, y, z]),
        ]
    )


def _world_pi(robot: Robot, kin: Kinematics) -> Float[Array, "nb 10"]:
    """π of every body about the tree's origin, in world axes."""
    nodes = np.array(robot.topology.body_node, int)
    rotation, p = kin.rotation[nodes], kin.position[nodes]
    m = robot.pi[:, 0]
    h = spatial.matvec(rotation, robot.pi[:, 1:4])
    inertia = rotational_inertia(robot.pi)
    inertia = spatial.matmul(spatial.matmul(rotation, inertia), jnp.swapaxes(rotation, -1, -2))
    # I about the tree's origin: I + [p]×ᵀ-terms of h, and of the mass at p.
    hp = h[:, :, None] * p[:, None, :]
    pp = m[:, None, None] * p[:, :, None] * p[:, None, :]
    moved = hp + jnp.swapaxes(hp, -1, -2) + pp
    trace = jnp.trace(moved, axis1=-2, axis2=-1)[:, None, None]
    inertia = inertia + trace * jnp.eye(3, dtype=p.dtype) - moved
    first = h + m[:, None] * p
    return jnp.stack(
        [
            m,
            *(first[:, i] for i in range(3)),
            inertia[:, 0, 0],
            inertia[:, 0, 1],
            inertia[:, 0, 2],
            inertia[:, 1, 1],
            inertia[:, 1, 2],
            inertia[:, 2, 2],
        ],
        axis=-1,
    )


def _body_jacobian(robot: Robot, kin: Kinematics, index: int) -> Float[Array, "6 nv"]:
    top = robot.topology
    axes = kin.axes * jnp.asarray(top.body_dof[index], kin.axes.dtype)[:, None]
    w, u = axes[:, :3], axes[:, 3:]
    linear = u + spatial.cross(w, jnp.broadcast_to(kin.position[top.body_node[index]], w.shape))
    return jnp.concatenate([linear, w], -1).T
