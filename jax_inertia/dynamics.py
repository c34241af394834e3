"""Rigid-body dynamics in world coordinates: inverse dynamics, torque regressor, mass matrix, contact torques.

Every function takes one sample and is differentiable, `jit`- and `vmap`-friendly; `vmap` of many samples runs with the
batch as the last axis (see `_batch_last`), for which the private functions below are written: their arrays are
(list, components, *batch). The paper's condensed form (eq. decomp-tau) is `condensed_dynamics`: one forward pass
shared by the regressor of the chosen bodies and the torque of all the others.
"""

from collections.abc import Sequence
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jax_inertia import spatial
from jax_inertia._batch_last import batch_last
from jax_inertia._rows import moved_rows, spread_rows, take_rows
from jax_inertia._vectors import compose, cross, lever, skew, symmetric, turn, turn_back
from jax_inertia.robot import (
    Kinematics,
    Robot,
    accumulate_inward,
    accumulate_outward,
    forward_kinematics,
    tree_origin,
)


def inverse_dynamics(
    robot: Robot, q: Float[Array, " nq"], v: Float[Array, " nv"], a: Float[Array, " nv"]
) -> Float[Array, " nv"]:
    """Generalised force M(q) a + c(q, v) (Foster et al., eq. 1), armature included, passive forces apart.

    >>> import jax, jax.numpy as jnp
    >>> from jax_inertia import load_model, inverse_dynamics
    >>> from jax_inertia.robots.pendulum import double_pendulum
    >>> robot = load_model(double_pendulum())
    >>> level, still = jnp.array([jnp.pi / 2, 0.0]), jnp.zeros(2)
    >>> jax.jit(inverse_dynamics)(robot, level, still, still)  # 2 kg at 0.5 m and 1 kg at 1.5 m, held level
    Array([24.525,  4.905], dtype=float64)
    """
    return batch_last(_inverse_dynamics, robot, q, v, a)


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

    >>> import jax, jax.numpy as jnp
    >>> from jax_inertia import load_model, torque_regressor
    >>> from jax_inertia.robots.pendulum import double_pendulum
    >>> robot = load_model(double_pendulum())
    >>> level, still = jnp.array([jnp.pi / 2, 0.0]), jnp.zeros(2)
    >>> y = jax.jit(torque_regressor)(robot, level, still, still)
    >>> y.shape
    (2, 2, 10)
    >>> jnp.einsum("jbk,bk->j", y, robot.pi)
    Array([24.525,  4.905], dtype=float64)
    """
    chosen = resolve_bodies(robot, bodies)
    return batch_last(partial(_torque_regressor, chosen), robot, q, v, a)


def condensed_dynamics(
    robot: Robot,
    q: Float[Array, " nq"],
    v: Float[Array, " nv"],
    a: Float[Array, " nv"],
    bodies: Sequence[int | str],
) -> tuple[Float[Array, "nv n 10"], Float[Array, " nv"]]:
    """Y^est of the chosen bodies and τ^nom of all the rest, from one forward pass (Foster et al., eq. decomp-tau).

    Y^est π^est + τ^nom = `inverse_dynamics`; armature is part of τ^nom.

    >>> import jax, jax.numpy as jnp
    >>> from jax_inertia import load_model, condensed_dynamics
    >>> from jax_inertia.robots.pendulum import double_pendulum
    >>> robot = load_model(double_pendulum())
    >>> level, still = jnp.array([jnp.pi / 2, 0.0]), jnp.zeros(2)
    >>> y, nominal = jax.jit(condensed_dynamics, static_argnums=4)(robot, level, still, still, ("lower",))
    >>> nominal  # what the upper link needs alone
    Array([9.81, 0.  ], dtype=float64)
    >>> nominal + y[:, 0] @ robot.pi[1]
    Array([24.525,  4.905], dtype=float64)
    """
    chosen = resolve_bodies(robot, bodies)
    return batch_last(partial(_condensed_dynamics, chosen), robot, q, v, a)


def mass_matrix(robot: Robot, q: Float[Array, " nq"]) -> Float[Array, "nv nv"]:
    """Joint-space inertia M(q), armature included, by composite rigid bodies in world coordinates.

    >>> import jax, jax.numpy as jnp
    >>> from jax_inertia import load_model, mass_matrix
    >>> from jax_inertia.robots.pendulum import double_pendulum
    >>> robot = load_model(double_pendulum())
    >>> jax.jit(mass_matrix)(robot, jnp.zeros(2)).round(3)  # stretched: 0.52 + 1 · 1.5² + 0.02 at the shoulder
    Array([[2.79, 0.77],
           [0.77, 0.27]], dtype=float64)
    """
    return batch_last(_mass_matrix, robot, q)


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

    >>> import equinox as eqx
    >>> import jax.numpy as jnp
    >>> from jax_inertia import load_model, passive_torque
    >>> from jax_inertia.robots.pendulum import double_pendulum
    >>> robot = load_model(double_pendulum())
    >>> robot = eqx.tree_at(lambda r: r.damping, robot, jnp.array([0.3, 0.1]))
    >>> passive_torque(robot, jnp.zeros(2), jnp.array([2.0, -1.0]))
    Array([-0.6,  0.1], dtype=float64)
    """
    top = robot.topology
    adr = np.array(top.qpos_adr)[top.dof_node]
    spring = robot.stiffness * (q[adr] - robot.spring_reference)
    friction = robot.frictionloss * jnp.tanh(v / friction_velocity)
    return -robot.damping * v - spring - friction


def body_poses(
    robot: Robot, q: Float[Array, " nq"]
) -> tuple[Float[Array, "nb 3 3"], Float[Array, "nb 3"]]:
    """World rotation and frame-origin position [m] of every body.

    >>> import jax, jax.numpy as jnp
    >>> from jax_inertia import load_model, body_poses
    >>> from jax_inertia.robots.pendulum import double_pendulum
    >>> robot = load_model(double_pendulum())
    >>> rotation, position = jax.jit(body_poses)(robot, jnp.array([jnp.pi / 2, 0.0]))
    >>> position.round(3) + 0.0  # turned about y, the pendulum points along −x
    Array([[ 0.,  0.,  0.],
           [-1.,  0.,  0.]], dtype=float64)
    """
    kin = forward_kinematics(robot, q)
    nodes = np.array(robot.topology.body_node, int)
    return kin.rotation[nodes], kin.position[nodes] + tree_origin(robot, q)[nodes]


def body_jacobian(robot: Robot, q: Float[Array, " nq"], body: int | str) -> Float[Array, "6 nv"]:
    """Jacobian [linear; angular] of a body's frame origin, world axes: J v is its velocity, Jᵀ its wrench's torque.

    >>> import jax, jax.numpy as jnp
    >>> from jax_inertia import load_model, body_jacobian
    >>> from jax_inertia.robots.pendulum import double_pendulum
    >>> robot = load_model(double_pendulum())
    >>> body_jacobian(robot, jnp.zeros(2), "lower")[:3].round(3) + 0.0  # hung 1 m below the shoulder
    Array([[-1.,  0.],
           [ 0.,  0.],
           [ 0.,  0.]], dtype=float64)
    """
    (index,) = resolve_bodies(robot, [body])
    kin = forward_kinematics(robot, q)
    return _body_jacobian(robot, kin, index)


def contact_torque(
    robot: Robot,
    q: Float[Array, " nq"],
    wrenches: Float[Array, "contacts 6"],
    bodies: Sequence[int | str],
) -> Float[Array, " nv"]:
    """Σ Jᵀ λ of wrenches [force; moment] on `bodies`: world axes, N and N m, moments about their frame origins.

    >>> import jax, jax.numpy as jnp
    >>> from jax_inertia import load_model, contact_torque
    >>> from jax_inertia.robots.pendulum import double_pendulum
    >>> robot = load_model(double_pendulum())
    >>> push = jnp.array([[10.0, 0.0, 0.0, 0.0, 0.0, 0.0]])  # 10 N along x at the elbow
    >>> contact_torque(robot, jnp.zeros(2), push, ["lower"]).round(3) + 0.0
    Array([-10.,   0.], dtype=float64)
    """
    kin = forward_kinematics(robot, q)
    chosen = resolve_bodies(robot, bodies)
    torques = [w @ _body_jacobian(robot, kin, i) for i, w in zip(chosen, wrenches, strict=True)]
    return sum(torques, jnp.zeros(robot.nv, q.dtype))


def resolve_bodies(robot: Robot, bodies: Sequence[int | str] | None) -> tuple[int, ...]:
    """Body indices of names or indices, None meaning all; ValueError says which is wrong and lists the names.

    >>> from jax_inertia import load_model
    >>> from jax_inertia.dynamics import resolve_bodies
    >>> from jax_inertia.robots.pendulum import double_pendulum
    >>> resolve_bodies(load_model(double_pendulum()), ["lower", 0])
    (1, 0)
    """
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


# --- the passes, batch axes last ---------------------------------------------------------------------------------


def _inverse_dynamics(robot: Robot, q: Array, v: Array, a: Array) -> Float[Array, "nv ..."]:
    kin = forward_kinematics(robot, q)
    motion = _body_motion(robot, kin, v, a, range(robot.nb))
    return _torque(robot, kin, motion, robot.pi) + robot.armature * a


def _torque_regressor(
    chosen: tuple[int, ...], robot: Robot, q: Array, v: Array, a: Array
) -> Float[Array, "nv n 10 ..."]:
    kin = forward_kinematics(robot, q)
    return _regressor(robot, kin, _body_motion(robot, kin, v, a, chosen), chosen)


def _condensed_dynamics(
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
    total = accumulate_inward(robot, jnp.concatenate([moment, force], 1))
    return jnp.sum(kin.axes * total, 1)


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


def _mass_matrix(robot: Robot, q: Array) -> Float[Array, "nv nv ..."]:
    top = robot.topology
    kin = forward_kinematics(robot, q)
    composite = accumulate_inward(robot, _world_pi(robot, kin))
    w, u = kin.axes[:, :3], kin.axes[:, 3:]
    h = composite[:, 1:4]
    moment = turn(symmetric(composite[:, 4:]), w) + cross(h, u)
    force = composite[:, :1] * u - cross(h, w)
    coupling = jnp.sum(kin.axes[:, None] * jnp.concatenate([moment, force], 1)[None], 2)
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


def _body_jacobian(robot: Robot, kin: Kinematics, index: int) -> Float[Array, "6 nv"]:
    top = robot.topology
    axes = kin.axes * jnp.asarray(top.body_dof[index], kin.axes.dtype)[:, None]
    w, u = axes[:, :3], axes[:, 3:]
    linear = u + spatial.cross(w, jnp.broadcast_to(kin.position[top.body_node[index]], w.shape))
    return jnp.concatenate([linear, w], -1).T
