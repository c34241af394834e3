"""Means over a window of what is not linear in the motion: an observation's torque is one, its regressor was not.

`differences.aligned_differences` gives the means q̄, v̄, v̇ of a window, and that of the torque. A function f of the
motion has another mean than f(q̄, v̄, v̇): with δ² = T²/12 the variance of time in a window of length T,

    mean f(q, v, v̇) = f(q̄, v̄, v̇) + ½ δ² f''[q̇, v̇, v̈]² + O(T⁴) = ½ Σ± f(q̄ ± δ q̇, v̄ ± δ v̇, v̇ ± δ v̈) + O(T⁴),

Gauss and Legendre's rule of two points (Abramowitz and Stegun 1964, 25.4.29) along the motion's tangent. An arm that
turns by 0.06 rad in a window of 16 ms has a ten-thousandth of its torque in it: more than the mean of its noise is off.
"""

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jax_inertia.model.robot import BALL, FREE, Robot
from jax_inertia.signals.differences import Observation
from jax_inertia.signals.torque_residual import torque_residual


def mean_residual(
    robot: Robot,
    observation: Observation,
    bodies: tuple[int, ...],
    bias: Float[Array, " nv"],
    jerk: Float[Array, " nv"],
    window: Float[Array, ""] | float,
) -> tuple[Float[Array, "nv n 10"], Float[Array, " nv"]]:
    """(Y^est, y) of `torque_residual`, as their means over the `window` [s] that the observation is the mean of.

    `jerk` is v̈ [m/s³, rad/s³]; where it is not known, zero leaves out what M changes by while v̇ does.
    """
    moments = within_window(robot, observation, jerk, window)
    rows = jax.vmap(lambda one: torque_residual(robot, one, bodies, bias))(moments)
    regressor, residual = jax.tree.map(lambda x: jnp.mean(x, axis=0), rows)
    return regressor, residual


def jerk_since(
    before: Float[Array, " nv"], now: Float[Array, " nv"], dt: Float[Array, ""] | float
) -> Float[Array, " nv"]:
    """v̈ from the acceleration one window before (not finite: none was), zero where that cannot be."""
    return jnp.nan_to_num((now - before) / dt, posinf=0.0, neginf=0.0)


def within_window(
    robot: Robot,
    observation: Observation,
    jerk: Float[Array, " nv"],
    window: Float[Array, ""] | float,
) -> Observation:
    """The two moments of the rule (leading axis) of one observation, whose window is so long [s].

    `jerk` is v̈ [m/s³, rad/s³]; torques, wrenches and stamps are the window's means at both. A function's mean over the
    window is half the sum of what it is at the two.
    """
    motion = observation.motion
    q, v, a = (jnp.asarray(x) for x in (motion.q, motion.v, observation.a))
    sides = jnp.asarray([-1.0, 1.0], q.dtype)[:, None] * jnp.asarray(window, q.dtype) / 12**0.5
    rates = {"q": _position_rate(robot, q, v), "v": a}
    moved = {name: getattr(motion, name) + sides * rate for name, rate in rates.items()}
    for name in ("time", "tau", "valid", "wrench"):
        mean = getattr(motion, name)
        moved[name] = None if mean is None else jnp.stack([jnp.asarray(mean)] * 2)
    return Observation(dataclasses.replace(motion, **moved), a + sides * jerk)


def _position_rate(
    robot: Robot, q: Float[Array, " nq"], v: Float[Array, " nv"]
) -> Float[Array, " nq"]:
    """q̇: velocities, and ½ q ∘ (0, ω) for a quaternion whose angular velocity ω is in the body's axes."""
    rate = jnp.zeros_like(q)
    places = zip(robot.joint_type, robot.joint_qposadr, robot.joint_dofadr, strict=True)
    for kind, at, row in places:
        if kind == FREE:
            rate = rate.at[at : at + 3].set(v[row : row + 3])
        if kind in (FREE, BALL):
            shift = 3 if kind == FREE else 0
            at, row = at + shift, row + shift
            rate = rate.at[at : at + 4].set(_quaternion_rate(q[at : at + 4], v[row : row + 3]))
        else:
            rate = rate.at[at].set(v[row])
    return rate


def _quaternion_rate(quat: Float[Array, "4"], omega: Float[Array, "3"]) -> Float[Array, "4"]:
    w, u = quat[0], quat[1:]
    return 0.5 * jnp.concatenate([-(u @ omega)[None], w * omega + jnp.cross(u, omega)])
