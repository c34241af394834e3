"""The one definition of what the model leaves unexplained, for filter, batch fit and diagnosis alike.

    Δτ = τ_obs − τ_nom + Σ Jᵀλ − b        (Foster et al., eq. delta-tau, with the calibration's bias b)

τ_nom holds all that the model knows: the bodies that are not estimated, armature, joint damping, springs and dry
friction. What is left is Y^est π^est + noise (eq. measurement).
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jax_inertia.dynamics import rigid_body
from jax_inertia.maths.noise import CorrelatedNoise, Noise
from jax_inertia.model.robot import Robot
from jax_inertia.signals.differences import Observation

FRICTION_VELOCITY = 0.01
"""Dry friction is F tanh(v / this) [rad/s]: soft enough to bear velocity noise, far below working speeds."""


def torque_residual(
    robot: Robot, observation: Observation, bodies: tuple[int, ...], bias: Float[Array, " nv"]
) -> tuple[Float[Array, "nv n 10"], Float[Array, " nv"]]:
    """(Y^est, Δτ) of one observation: what the chosen bodies must explain.

    Every channel must belong to the same moment (Foster et al., sec. III-D); `jax_inertia.signals.differences` sees
    to it.
    """
    motion = observation.motion
    q, v, a = (jnp.asarray(x) for x in (motion.q, motion.v, observation.a))
    regressor, nominal = rigid_body.condensed_dynamics(robot, q, v, a, bodies)
    passive = rigid_body.passive_torque(robot, q, v, friction_velocity=FRICTION_VELOCITY)
    delta = jnp.asarray(motion.tau) - nominal + passive - bias
    if motion.wrench is not None:
        wrench = jnp.asarray(motion.wrench)
        delta = delta + rigid_body.contact_torque(robot, q, wrench, motion.contact_bodies)
    return regressor, delta


def agreed_residual(
    robot: Robot,
    observation: Observation,
    bodies: tuple[int, ...],
    bias: Float[Array, " nv"],
    pi: Float[Array, "n 10"],
    covariance: Float[Array, "p p"],
    noise: Noise,
    sigma_a: Float[Array, " nv"],
) -> tuple[Float[Array, "nv n 10"], Float[Array, " nv"], CorrelatedNoise]:
    """(Y^est, Δτ, R), linearised at the acceleration that sensors and forces agree on.

    Noise w of v̇, of standard deviation `sigma_a` [m/s², rad/s²], is in Y as well as, as −M w, in Δτ − Y π, and what is
    in both draws inertias towards zero (errors in variables: Fuller, Measurement Error Models, 1987, sec. 1.1). So w is
    a second state, which lasts one sample. Linearised at its most probable value under the belief in π (`pi` [kg, kg m,
    kg m²], its `covariance` P; Bell and Cathey 1993, w eliminated), the update has

        e = Δτ − Y(v̇) π,    R = `noise` + M Σ Mᵀ,    v̂ = v̇ + Σ Mᵀ (R + Y P Yᵀ)⁻¹ e,    H = Y(v̂):

    e is the innovation as before, but H is of an acceleration that it does not correlate with, cov(v̂, e) = 0. `noise`
    [N m, N] is all that does not come from v̇.
    """
    measured, delta = torque_residual(robot, observation, bodies, bias)
    inertia = rigid_body.mass_matrix(robot.believed(bodies, pi), jnp.asarray(observation.motion.q))
    spread = inertia * sigma_a**2
    of_all = noise.plus(spread @ inertia.T)
    flat = measured.reshape(len(delta), -1)
    error = delta - flat @ pi.ravel()
    known = jnp.asarray(observation.motion.valid) & jnp.isfinite(error)
    error = jnp.where(known, error, 0.0)[:, None]
    innovation = of_all.plus(flat @ covariance @ flat.T)
    white = innovation.whiten(jnp.append(spread, error, axis=1), known.astype(error.dtype))
    shift = white[:, :-1].T @ white[:, -1]
    agreed = eqx.tree_at(lambda o: o.a, observation, observation.a + shift)
    regressor, delta = torque_residual(robot, agreed, bodies, bias)
    # Δτ − Y π at v̂ lacks M (v̂ − v̇) of e.
    return regressor, delta + inertia @ shift, of_all


def torque_residuals(
    robot: Robot, observations: Observation, bodies: tuple[int, ...], bias: Float[Array, " nv"]
) -> tuple[Float[Array, "T nv n 10"], Float[Array, "T nv"]]:
    """`torque_residual` of every moment of a log, in chunks that stay in cache."""
    return jax.lax.map(
        lambda one: torque_residual(robot, one, bodies, bias),
        jax.tree.map(jnp.asarray, observations),
        batch_size=64,
    )
