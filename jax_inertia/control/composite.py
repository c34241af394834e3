"""Composite adaptation: parameters moved by the task's error and by the torque that the model predicts wrongly.

Slotine and Li (1989, "Composite adaptive control of robot manipulators") with the natural metric of inertial parameters
(Lee, Kwon and Park 2018). With s = v − v_r the distance from the reference velocity v_r = q̇* − Λ (q − q*), torques

    τ = Y(q, v, v_r, v̇_r) π̂ − K s + passive torques,

and the pseudo-inertia P̂ of each body moved along its geodesic,

    dP̂/dt = −γ P̂ L P̂,   tr(L δP) = δπᵀ (Y^T s + Wᵀ R⁻¹ (W π̂ − Δτ)),

V = ½ sᵀ M s + D(P ‖ P̂) / γ with the Bregman divergence D = log det P̂ / det P + tr P̂⁻¹ P − 4 falls:

    dV/dt = −sᵀ K s − (W π̃)ᵀ R⁻¹ W π̃ ≤ 0,   π̃ = π̂ − π.

(dD/dt = tr((P̂⁻¹ − P̂⁻¹ P P̂⁻¹) dP̂/dt) = −γ tr(L (P̂ − P)), which cancels sᵀ Y π̃ of the robot's own energy.) So s tends to
zero, and π̂ to the truth as far as W sees it. A step along a geodesic is P̂ ← U exp(−γ dt Uᵀ L U) Uᵀ with P̂ = U Uᵀ: a
physical body for a step of any length, and γ has no unit of its own, since the metric scales with the body.
"""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jax_inertia.dynamics.rigid_body import torque_regressor
from jax_inertia.maths import inertial_parameters, spatial
from jax_inertia.maths.precision import in_full_precision
from jax_inertia.model.robot import Robot


def reference_regressor(
    robot: Robot,
    q: Float[Array, " nq"],
    v: Float[Array, " nv"],
    reference_v: Float[Array, " nv"],
    reference_a: Float[Array, " nv"],
    bodies: Sequence[int | str] | None = None,
) -> Float[Array, "nv n 10"]:
    """Y with Y π = M v̇_r + C(q, v) v_r + g, for C of Christoffel's symbols, which makes Ṁ − 2 C skew.

    C(q, v) v_r is the symmetric form whose square is c(q, v): ½ (c(v + v_r) − c(v) − c(v_r)). Joints of one coordinate
    each, whose velocities are the derivatives of their positions (hinges and slides).
    """
    still = jnp.zeros_like(v)

    def at(velocity: Float[Array, " nv"]) -> Float[Array, "nv n 10"]:
        return torque_regressor(robot, q, velocity, still, bodies)

    own = torque_regressor(robot, q, still, reference_a, bodies)
    return own + 0.5 * (at(v + reference_v) - at(v) - at(reference_v) + at(still))


@in_full_precision
def composite_step(
    pi: Float[Array, "n 10"],
    regressor: Float[Array, "nv n 10"],
    s: Float[Array, " nv"],
    gain: Float[Array, ""] | float,
    dt: Float[Array, ""] | float,
    prediction: Float[Array, "n 10"] | None = None,
) -> Float[Array, "n 10"]:
    """π̂ after `dt` [s], moved by the task's error s (through the regressor of the law) and by `prediction`.

    `prediction` is Wᵀ R⁻¹ (W π̂ − Δτ), the slope of the prediction's error; None: the task's error alone. Physical
    whenever `pi` is.

    >>> import jax.numpy as jnp
    >>> from jax_inertia.control.composite import composite_step
    >>> from jax_inertia.maths.inertial_parameters import from_com, is_physical
    >>> pi = from_com(jnp.array([2.0]), jnp.array([[0.0, 0.0, 0.1]]), 0.02 * jnp.eye(3)[None])
    >>> held = jnp.zeros((1, 1, 10)).at[0, 0, 0].set(9.81)  # a slide that lifts it, and lags: more mass
    >>> after = composite_step(pi, held, jnp.array([-50.0]), gain=1.0, dt=0.002)
    >>> bool(after[0, 0] > pi[0, 0]), bool(is_physical(after)[0])
    (True, True)
    """
    slope = jnp.einsum("vbp,v->bp", regressor, s)
    if prediction is not None:
        slope = slope + prediction
    pull = jnp.einsum("pij,bp->bij", _dual(pi.dtype), slope)
    root = spatial.cholesky(inertial_parameters.pseudo_inertia(pi))
    along = jnp.swapaxes(root, -1, -2) @ pull @ root
    values, axes = jnp.linalg.eigh(0.5 * (along + jnp.swapaxes(along, -1, -2)))
    # e^±3 in one step is as good as any number, and stays finite.
    half = jnp.exp(-0.5 * jnp.clip(gain * dt * values, -3.0, 3.0))
    moved = root @ (axes * half[:, None, :])
    return inertial_parameters.from_pseudo_inertia(moved @ jnp.swapaxes(moved, -1, -2))


@in_full_precision
def damping_step(
    pi: Float[Array, "n 10"],
    regressor: Float[Array, "nv n 10"],
    s: Float[Array, " nv"],
    mass: Float[Array, "nv nv"],
    rate: Float[Array, ""] | float,
) -> Float[Array, "n 10"]:
    """π̂ moved in proportion to the task's error, by the γ at which s decays at `rate` [1/s] along Y Γ Yᵀ s.

    Proportional adaptation (Landau 1979, Adaptive Control) of a π̂ that something else estimates: torques gain
    −γ Y Γ Yᵀ s, which takes energy from s whatever π̂ is off by. With y = Y Γ Yᵀ s, Γ the natural metric and M the
    `mass` matrix, γ = rate · sᵀ y / yᵀ M⁻¹ y has the part of s along M⁻¹ y decay at that rate. Physical whenever `pi`
    is.

    >>> import jax.numpy as jnp
    >>> from jax_inertia.control.composite import damping_step
    >>> from jax_inertia.maths.inertial_parameters import from_com
    >>> pi = from_com(jnp.array([2.0]), jnp.array([[0.0, 0.0, 0.1]]), 0.02 * jnp.eye(3)[None])
    >>> held = jnp.zeros((1, 1, 10)).at[0, 0, 0].set(9.81)  # a slide of 2 kg that lags by 1 mm/s
    >>> after = damping_step(pi, held, jnp.array([-1e-3]), 2.0 * jnp.eye(1), rate=10.0)
    >>> round(float(9.81 * (after - pi)[0, 0]), 4)
    0.02
    """
    metric = inertial_parameters.pseudo_inertia(pi)
    slope = jnp.einsum("vbp,v->bp", regressor, s)
    pull = jnp.einsum("pij,bp->bij", _dual(pi.dtype), slope)
    y = jnp.einsum(
        "vbp,bp->v", regressor, inertial_parameters.from_pseudo_inertia(metric @ pull @ metric)
    )
    mobility = y @ jnp.linalg.solve(mass, y)
    # No error, no movement: s @ y is zero with it.
    gain = rate * (s @ y) / jnp.maximum(mobility, jnp.finfo(pi.dtype).tiny)
    return composite_step(pi, regressor, s, gain, 1.0)


def divergence(pi: Float[Array, "*b 10"], estimate: Float[Array, "*b 10"]) -> Float[Array, "*b"]:
    """Bregman's D(P ‖ P̂) of two bodies [nats]: log det P̂ / det P + tr P̂⁻¹ P − 4.

    >>> import jax.numpy as jnp
    >>> from jax_inertia.control.composite import divergence
    >>> from jax_inertia.maths.inertial_parameters import from_com
    >>> pi = from_com(jnp.array(2.0), jnp.zeros(3), 0.02 * jnp.eye(3))
    >>> float(divergence(pi, pi).round(9)), round(float(divergence(pi, 2.0 * pi)), 4)
    (0.0, 0.7726)
    """
    own, other = (inertial_parameters.pseudo_inertia(x) for x in (pi, estimate))
    ratio = jnp.linalg.solve(other, own)
    _, log_det = jnp.linalg.slogdet(ratio)
    return jnp.trace(ratio, axis1=-2, axis2=-1) - log_det - 4.0


def _dual(dtype: jnp.dtype) -> Float[Array, "10 4 4"]:
    """C_k symmetric with π_k = tr(C_k P); π is linear in P."""
    with jax.ensure_compile_time_eval():
        units = jnp.eye(16, dtype=dtype).reshape(16, 4, 4)
        rows = inertial_parameters.from_pseudo_inertia(units).T.reshape(10, 4, 4)
    return 0.5 * (rows + jnp.swapaxes(rows, -1, -2))
