"""The passes of rigid-body dynamics, batch axes last: arrays are (list, components, *batch); see `batch_last`."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jax_inertia.dynamics.kinematics import (
    Kinematics,
    accumulate_inward,
    accumulate_outward,
    forward_kinematics,
)
from jax_inertia.dynamics.sparse_rows import moved_rows
from jax_inertia.maths import spatial
from jax_inertia.maths.batch_last import (
    compose,
    cross,
    lever,
    skew,
    symmetric,
    total,
    turn,
    turn_back,
)
from jax_inertia.maths.row_runs import spread_rows, take_rows
from jax_inertia.model.robot import Robot


def inverse_dynamics(robot: Robot, q: Array, v: Array, a: Array) -> Float[Array, "nv ..."]:
    kin = forward_kinematics(robot, q)
    motion = _body_motion(robot, kin, v, a, range(robot.nb))
    return _torque(robot, kin, motion, robot.pi) + robot.armature * a


def torque_regressor(
    chosen: tuple[int, ...], robot: Robot, q: Array, v: Array, a: Array
) -> Float[Array, "nv n 10 ..."]:
    kin = forward_kinematics(robot, q)
    return _regressor(robot, kin, _body_motion(robot, kin, v, a, chosen), chosen)


def condensed_dynamics(
    chosen: tuple[int, ...], robot: Robot, q: Array, v: Array, a: Array
) -> tuple[Float[Array, "nv n 10 ..."], Float[Array, "nv ..."]]:
    kin = forward_kinematics(robot, q)
    motion = _body_motion(robot, kin, v, a, range(robot.nb))
    known = np.ones((robot.nb, *(1 for _ in robot.pi.shape[1:])))
    known[list(chosen)] = 0.0
    nominal = _torque(robot, kin, motion, robot.pi * jnp.asarray(known, robot.pi.dtype))
    own = jax.tree.map(lambda x: x[np.array(chosen, int)], motion)
    return _regressor(robot, kin, own, chosen), nominal + robot.armature * a


class _BodyMotion(eqx.Module):
    """Angular velocity, angular acceleration and proper acceleration of some bodies, in their own frames."""

    angular_velocity: Float[Array, "n 3 ..."]
    angular_acceleration: Float[Array, "n 3 ..."]
    proper_acceleration: Float[Array, "n 3 ..."]
    """Acceleration of the frame origin minus gravity [m/s²]."""


def _body_motion(
    robot: Robot, kin: Kinematics, v: Array, a: Array, bodies: Sequence[int]
) -> _BodyMotion:
    """Outward pass: spatial velocity and acceleration in world coordinates, then in the frames of these bodies."""
    top = robot.topology
    velocity = accumulate_outward(robot, kin.axes * v[:, None])
    # World-fixed axes (translations of a free joint) do not turn with the body.
    fixed = top.dof_in_world.reshape(-1, *(1 for _ in v.shape[1:]))
    turning = jnp.where(fixed, 0.0, v)[:, None]
    now, axis, arm = velocity[top.dof_node], kin.axes[:, :3], kin.axes[:, 3:]
    w, u = now[:, :3], now[:, 3:]
    # v × S (Featherstone 2008, eq. 2.31).
    rate = jnp.concatenate([cross(w, axis), cross(w, arm) + cross(u, axis)], 1) * turning
    acceleration = accumulate_outward(robot, kin.axes * a[:, None] + rate)

    nodes = np.array(top.body_node, int)[list(bodies)]
    rotation, position = kin.rotation[nodes], kin.position[nodes]
    w, u = velocity[nodes, :3], velocity[nodes, 3:]
    dw, du = acceleration[nodes, :3], acceleration[nodes, 3:] - robot.gravity
    # Spatial to classical: the origin of the body moves at u + ω × p and accelerates ω × that more.
    proper = du + cross(dw, position) + cross(w, u + cross(w, position))
    own = [turn_back(rotation, x) for x in (w, dw, proper)]
    return _BodyMotion(*jnp.broadcast_arrays(*own))


def _torque(
    robot: Robot, kin: Kinematics, motion: _BodyMotion, pi: Float[Array, "nb 10 ..."]
) -> Float[Array, "nv ..."]:
    """Inward pass: the wrench that each body needs, summed over the bodies that each joint moves."""
    w, dw, d = motion.angular_velocity, motion.angular_acceleration, motion.proper_acceleration
    pi = pi.reshape(*pi.shape, *(1 for _ in range(w.ndim - pi.ndim)))
    m, h, inertia = pi[:, :1], skew(pi[:, 1:4]), symmetric(pi[:, 4:])
    # h × x = [h]× x: with constants in the matrix, this is cheaper than cross products.
    force = m * d - turn(h, dw) - cross(w, turn(h, w))
    moment = turn(inertia, dw) + cross(w, turn(inertia, w)) + turn(h, d)
    nodes = np.array(robot.topology.body_node, int)
    force = turn(kin.rotation[nodes], force)
    moment = turn(kin.rotation[nodes], moment) + cross(kin.position[nodes], force)
    wrench = accumulate_inward(robot, jnp.concatenate([moment, force], 1))
    return total(kin.axes * wrench, 1)


def _regressor(
    robot: Robot, kin: Kinematics, motion: _BodyMotion, chosen: tuple[int, ...]
) -> Float[Array, "nv n 10 ..."]:
    """Inward pass, linear in π: each joint's axis times each body's own 6×10 regressor, both in world coordinates.

    The body's own is [moment; force] = A π about its origin (Atkeson, An and Hollerbach 1986, in this order of π).
    """
    pick = np.array(chosen, int)
    w, dw, d = motion.angular_velocity, motion.angular_acceleration, motion.proper_acceleration
    spin = skew(w)
    # The force does not depend on I, nor the moment about the body's origin on m.
    force = jnp.concatenate([d[:, :, None], skew(dw) + compose(spin, spin)], 2)
    moment = jnp.concatenate([-skew(d), lever(dw) + compose(spin, lever(w))], 2)
    nodes = np.array(robot.topology.body_node, int)[pick]
    force, moment = compose(kin.rotation[nodes], force), compose(kin.rotation[nodes], moment)
    shifted = compose(skew(kin.position[nodes]), force)
    moment = [shifted[:, :, :1], shifted[:, :, 1:] + moment[:, :, :3], moment[:, :, 3:]]
    force = jnp.concatenate([force, jnp.zeros_like(moment[2])], 2)
    own = jnp.concatenate([jnp.concatenate(moment, 2), force], 1)
    batch = jnp.broadcast_shapes(own.shape[3:], kin.axes.shape[2:])
    # As a product of matrices per sample, for its order is that of the result: to turn S and A round is little work.
    own = jnp.swapaxes(own, 0, 1).reshape(6, 10 * len(pick), *own.shape[3:])
    moved = moved_rows(robot, chosen)
    rows = jnp.matmul(
        _first(take_rows(kin.axes, moved)), _first(own), precision=jax.lax.Precision.HIGHEST
    )
    rows = rows.reshape(*batch, len(moved), len(pick), 10)
    rows = jnp.where(robot.topology.body_dof[pick][:, moved].T[:, :, None] > 0, rows, 0.0)
    rows = jnp.moveaxis(rows, range(len(batch)), range(-len(batch), 0))
    return spread_rows(rows, moved, robot.nv)


def _first(x: Float[Array, "i j ..."]) -> Float[Array, "... i j"]:
    """The batch axes first."""
    return jnp.moveaxis(x, (0, 1), (-2, -1))


def mass_matrix(robot: Robot, q: Array) -> Float[Array, "nv nv ..."]:
    top = robot.topology
    kin = forward_kinematics(robot, q)
    composite = accumulate_inward(robot, _world_pi(robot, kin))
    w, u = kin.axes[:, :3], kin.axes[:, 3:]
    h = composite[:, 1:4]
    moment = turn(symmetric(composite[:, 4:]), w) + cross(h, u)
    force = composite[:, :1] * u - cross(h, w)
    coupling = total(kin.axes[:, None] * jnp.concatenate([moment, force], 1)[None], 2)
    # Entry [j, k] holds where joint j carries joint k; the other half follows by symmetry.
    batch = [1 for _ in coupling.shape[2:]]
    carries = np.triu(top.node_dof[top.dof_node].T).reshape(robot.nv, robot.nv, *batch)
    upper = jnp.where(carries > 0, coupling, 0.0)
    eye = np.eye(robot.nv).reshape(robot.nv, robot.nv, *batch)
    strict = jnp.where(eye > 0, 0.0, upper)
    rotor = jnp.where(eye > 0, robot.armature[:, None], 0.0)
    return upper + jnp.swapaxes(strict, 0, 1) + rotor


def _world_pi(robot: Robot, kin: Kinematics) -> Float[Array, "nb 10 ..."]:
    """π of every body about the tree's origin, in world axes."""
    nodes = np.array(robot.topology.body_node, int)
    rotation, p = kin.rotation[nodes], kin.position[nodes]
    pi = robot.pi.reshape(*robot.pi.shape, *(1 for _ in range(p.ndim - robot.pi.ndim)))
    m, h = pi[:, :1], turn(rotation, pi[:, 1:4])
    inertia = compose(compose(rotation, symmetric(pi[:, 4:])), jnp.swapaxes(rotation, 1, 2))
    # I about the tree's origin: I + [p]×ᵀ-terms of h, and of the mass at p.
    hp = h[:, :, None] * p[:, None]
    moved = hp + jnp.swapaxes(hp, 1, 2) + m[:, :, None] * p[:, :, None] * p[:, None]
    trace = moved[:, 0, 0] + moved[:, 1, 1] + moved[:, 2, 2]
    rows, columns = np.triu_indices(3)
    on = (rows == columns).reshape(-1, *(1 for _ in trace.shape[1:]))
    inertia = (inertia - moved)[:, rows, columns] + jnp.where(on, trace[:, None], 0.0)
    mass = jnp.broadcast_to(m, (*m.shape[:2], *inertia.shape[2:]))
    return jnp.concatenate([mass, h + m * p, inertia], 1)


def body_jacobian(robot: Robot, kin: Kinematics, index: int) -> Float[Array, "6 nv"]:
    top = robot.topology
    axes = kin.axes * jnp.asarray(top.body_dof[index], kin.axes.dtype)[:, None]
    w, u = axes[:, :3], axes[:, 3:]
    linear = u + spatial.cross(w, jnp.broadcast_to(kin.position[top.body_node[index]], w.shape))
    return jnp.concatenate([linear, w], -1).T
