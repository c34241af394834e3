"""Rigid-body dynamics in world coordinates: inverse dynamics, torque regressor, mass matrix, contact torques.

Every function takes one sample (q, v, a in m, rad and seconds; torques in N m, forces in N), is differentiable, `jit`-
and `vmap`-friendly, and raises ValueError for a q, v or a of another length than the robot's; `vmap` of many samples
runs with the batch as the last axis (see `batch_last`). The paper's condensed form (eq. decomp-tau) is
`condensed_dynamics`: one forward pass shared by the regressor of the chosen bodies and the torque of all the others.
"""

from collections.abc import Sequence
from functools import partial
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jax_inertia.dynamics import recursions
from jax_inertia.dynamics.kinematics import forward_kinematics, tree_origin
from jax_inertia.maths.argument_checks import last_axes
from jax_inertia.maths.batch_last import batch_last
from jax_inertia.maths.precision import in_full_precision
from jax_inertia.model.robot import Robot


def inverse_dynamics(
    robot: Robot, q: Float[Array, " nq"], v: Float[Array, " nv"], a: Float[Array, " nv"]
) -> Float[Array, " nv"]:
    """Generalised force M(q) a + c(q, v) (Foster et al., eq. 1), armature included, passive forces apart.

    >>> import jax, jax.numpy as jnp
    >>> from jax_inertia import inverse_dynamics, load_model
    >>> from jax_inertia.robots.pendulum import double_pendulum
    >>> robot = load_model(double_pendulum())
    >>> level, still = jnp.array([jnp.pi / 2, 0.0]), jnp.zeros(2)
    >>> jax.jit(inverse_dynamics)(robot, level, still, still)  # 2 kg at 0.5 m and 1 kg at 1.5 m, held level
    Array([24.525,  4.905], dtype=float64)
    """
    return batch_last(recursions.inverse_dynamics, robot, *_sample(robot, q=q, v=v, a=a))


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
    kernel = partial(recursions.torque_regressor, chosen)
    return batch_last(kernel, robot, *_sample(robot, q=q, v=v, a=a))


def condensed_dynamics(
    robot: Robot,
    q: Float[Array, " nq"],
    v: Float[Array, " nv"],
    a: Float[Array, " nv"],
    bodies: Sequence[int | str],
) -> tuple[Float[Array, "nv n 10"], Float[Array, " nv"]]:
    """Y^est of the chosen bodies and τ^nom of all the rest, from one forward pass (Foster et al., eq. decomp-tau).

    Y^est π^est + τ^nom = `inverse_dynamics`; armature is part of τ^nom. Raises ValueError for an unknown body, or one
    named twice.

    >>> import jax, jax.numpy as jnp
    >>> from jax_inertia import condensed_dynamics, load_model
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
    kernel = partial(recursions.condensed_dynamics, chosen)
    return batch_last(kernel, robot, *_sample(robot, q=q, v=v, a=a))


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
    return batch_last(recursions.mass_matrix, robot, *_sample(robot, q=q))


def passive_torque(
    robot: Robot,
    q: Float[Array, " nq"],
    v: Float[Array, " nv"],
    *,
    friction_velocity: float = 1e-3,
) -> Float[Array, " nv"]:
    """Torque of the model's own damping, springs, dry friction and gravity compensation.

    −d v − k (q − q₀) − F tanh(v/v_f) − Σ Jᵀ γ m g, γ being a body's `gravcomp` (MuJoCo, *Computation*, passive forces).
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
    q, v = _sample(robot, q=q, v=v)
    top = robot.topology
    adr = np.array(top.qpos_adr)[top.dof_node]
    spring = robot.stiffness * (q[adr] - robot.spring_reference)
    friction = robot.frictionloss * jnp.tanh(v / friction_velocity)
    out = -robot.damping * v - spring - friction
    if robot.compensated is None:
        return out
    still = jnp.zeros_like(v)
    lifted = jnp.zeros_like(robot.pi).at[:, :4].set(robot.compensated)
    held = eqx.tree_at(lambda r: r.pi, robot, lifted)
    return out + inverse_dynamics(held, q, still, still)


def body_poses(
    robot: Robot, q: Float[Array, " nq"]
) -> tuple[Float[Array, "nb 3 3"], Float[Array, "nb 3"]]:
    """World rotation and frame-origin position [m] of every body.

    >>> import jax, jax.numpy as jnp
    >>> from jax_inertia import body_poses, load_model
    >>> from jax_inertia.robots.pendulum import double_pendulum
    >>> robot = load_model(double_pendulum())
    >>> rotation, position = jax.jit(body_poses)(robot, jnp.array([jnp.pi / 2, 0.0]))
    >>> position.round(3) + 0.0  # turned about y, the pendulum points along −x
    Array([[ 0.,  0.,  0.],
           [-1.,  0.,  0.]], dtype=float64)
    """
    (q,) = _sample(robot, q=q)
    kin = forward_kinematics(robot, q)
    nodes = np.array(robot.topology.body_node, int)
    return kin.rotation[nodes], kin.position[nodes] + tree_origin(robot, q)[nodes]


def body_jacobian(robot: Robot, q: Float[Array, " nq"], body: int | str) -> Float[Array, "6 nv"]:
    """Jacobian [linear; angular] of a body's frame origin, world axes: J v is its velocity, Jᵀ its wrench's torque.

    Raises ValueError for a body that the robot does not have.

    >>> import jax, jax.numpy as jnp
    >>> from jax_inertia import body_jacobian, load_model
    >>> from jax_inertia.robots.pendulum import double_pendulum
    >>> robot = load_model(double_pendulum())
    >>> body_jacobian(robot, jnp.zeros(2), "lower")[:3].round(3) + 0.0  # hung 1 m below the shoulder
    Array([[-1.,  0.],
           [ 0.,  0.],
           [ 0.,  0.]], dtype=float64)
    """
    (index,) = resolve_bodies(robot, [body])
    (q,) = _sample(robot, q=q)
    kin = forward_kinematics(robot, q)
    return recursions.body_jacobian(robot, kin, index)


@in_full_precision
def contact_torque(
    robot: Robot,
    q: Float[Array, " nq"],
    wrenches: Float[Array, "contacts 6"],
    bodies: Sequence[int | str],
) -> Float[Array, " nv"]:
    """Σ Jᵀ λ of wrenches [force; moment] on `bodies`: world axes, N and N m, moments about their frame origins.

    A body may be named more than once. Raises ValueError for an unknown body or another number of wrenches.

    >>> import jax, jax.numpy as jnp
    >>> from jax_inertia import contact_torque, load_model
    >>> from jax_inertia.robots.pendulum import double_pendulum
    >>> robot = load_model(double_pendulum())
    >>> push = jnp.array([[10.0, 0.0, 0.0, 0.0, 0.0, 0.0]])  # 10 N along x at the elbow
    >>> contact_torque(robot, jnp.zeros(2), push, ["lower"]).round(3) + 0.0
    Array([-10.,   0.], dtype=float64)
    """
    (q,) = _sample(robot, q=q)
    chosen = robot.body_indices(bodies, distinct=False)
    wrenches = last_axes("wrenches", wrenches, (len(chosen), 6), f"one for each of {list(bodies)}")
    kin = forward_kinematics(robot, q)
    torques = [
        w @ recursions.body_jacobian(robot, kin, i) for i, w in zip(chosen, wrenches, strict=True)
    ]
    return sum(torques, jnp.zeros(robot.nv, q.dtype))


def resolve_bodies(robot: Robot, bodies: Sequence[int | str] | None) -> tuple[int, ...]:
    """Body indices of names or indices, None meaning all; ValueError says which is wrong and lists the names.

    >>> from jax_inertia import load_model
    >>> from jax_inertia.dynamics.rigid_body import resolve_bodies
    >>> from jax_inertia.robots.pendulum import double_pendulum
    >>> resolve_bodies(load_model(double_pendulum()), ["lower", 0])
    (1, 0)
    """
    if bodies is None:
        return tuple(range(robot.nb))
    return robot.body_indices(bodies)


def _sample(robot: Robot, **channels: Any) -> tuple[Array, ...]:
    """One sample's channels as arrays, q of nq numbers and every other of nv.

    JAX clamps an index that is out of range, so that a q that is too short gives torques too. Raises ValueError for
    another shape.
    """
    out = []
    for name, value in channels.items():
        array = jnp.asarray(value)
        size, what = (robot.nq, "nq") if name == "q" else (robot.nv, "nv")
        if array.shape != (size,):
            raise ValueError(
                f"{name} has shape {array.shape}; of this robot it has ({size},), its {what}, and many samples go "
                "through jax.vmap"
            )
        out.append(array)
    return tuple(out)
