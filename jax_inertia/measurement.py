"""The one definition of what the model leaves unexplained, for filter, batch fit and diagnosis alike.

    Δτ = τ_obs − τ_nom + Σ Jᵀλ − b        (Foster et al., eq. delta-tau, with the calibration's bias b)

τ_nom holds all that the model knows: the bodies that are not estimated, armature, joint damping, springs and dry
friction. What is left is Y^est π^est + noise (eq. measurement).
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jax_inertia import dynamics
from jax_inertia.differences import Observation
from jax_inertia.robot import Robot

FRICTION_VELOCITY = 0.01
"""Dry friction is F tanh(v / this) [rad/s]: soft enough to bear velocity noise, far below working speeds."""


def torque_residual(
    robot: Robot, observation: Observation, bodies: tuple[int, ...], bias: Float[Array, " nv"]
) -> tuple[Float[Array, "nv n 10"], Float[Array, " nv"]]:
    """(Y^est, Δτ) of one observation: what the chosen bodies must explain.

    Every channel must belong to the same moment (Foster et al., sec. III-D); `jax_inertia.differences` sees to it.
    """
    motion = observation.motion
    q, v, a = (jnp.asarray(x) for x in (motion.q, motion.v, observation.a))
    regressor, nominal = dynamics.condensed_dynamics(robot, q, v, a, bodies)
    passive = dynamics.passive_torque(robot, q, v, friction_velocity=FRICTION_VELOCITY)
    delta = jnp.asarray(motion.tau) - nominal + passive - bias
    if motion.wrench is not None:
        wrench = jnp.asarray(motion.wrench)
        delta = delta + dynamics.contact_torque(robot, q, wrench, motion.contact_bodies)
    return regressor, delta


def torque_residuals(
    robot: Robot, observations: Observation, bodies: tuple[int, ...], bias: Float[Array, " nv"]
) -> tuple[Float[Array, "T nv n 10"], Float[Array, "T nv"]]:
    """`torque_residual` of every moment of a log, in chunks that stay in cache."""
    return jax.lax.map(
        lambda one: torque_residual(robot, one, bodies, bias),
        jax.tree.map(jnp.asarray, observations),
        batch_size=64,
    )
