"""The torque residual with accelerations that are noisy too: linearised where sensors and forces agree.

Noise w of v̇, of standard deviation σ_a, is in Y as well as, as M w, in the residual y + Y π of bodies π, and what is in
both draws inertias towards zero (errors in variables: Fuller, Measurement Error Models, 1987, sec. 1.1). So w is a
second state, which lasts one sample. Linearised at its most probable value under the belief in π (w eliminated: Bell
and Cathey 1993), the update has, with Σ = diag σ_a²,

    e = −(y + Y(v̇) π),    R = noise + M Σ Mᵀ,    v̂ = v̇ + Σ Mᵀ (R + Y P Yᵀ)⁻¹ e,    H = Y(v̂):

e is the innovation as before, but H is of an acceleration that it does not correlate with, cov(v̂, e) = 0.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jax_inertia.dynamics import rigid_body
from jax_inertia.maths.noise import CorrelatedNoise, Noise
from jax_inertia.maths.precision import in_full_precision
from jax_inertia.model.robot import Robot
from jax_inertia.signals.differences import Observation
from jax_inertia.signals.torque_residual import torque_residual


@in_full_precision
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
    """(Y^est, y, R) of one observation at v̂, so that −(y + Y^est π) is still e.

    The belief is `pi` [kg, kg m, kg m²] and its `covariance` P; `noise` [N m, N] is all that does not come from v̇,
    whose own noise is `sigma_a` [m/s², rad/s²].
    """
    measured, residual = torque_residual(robot, observation, bodies, bias)
    inertia = rigid_body.mass_matrix(robot.believed(bodies, pi), jnp.asarray(observation.motion.q))
    spread = inertia * sigma_a**2
    of_all = noise.plus(spread @ inertia.T)
    flat = measured.reshape(len(residual), -1)
    error = -(residual + flat @ pi.ravel())
    known = jnp.asarray(observation.motion.valid) & jnp.isfinite(error)
    error = jnp.where(known, error, 0.0)[:, None]
    innovation = of_all.plus(flat @ covariance @ flat.T)
    white = innovation.whiten(jnp.append(spread, error, axis=1), known.astype(error.dtype))
    shift = white[:, :-1].T @ white[:, -1]
    agreed = eqx.tree_at(lambda o: o.a, observation, observation.a + shift)
    regressor, residual = torque_residual(robot, agreed, bodies, bias)
    # y + Y π at v̂ has M (v̂ − v̇) more than at v̇.
    return regressor, residual - inertia @ shift, of_all
