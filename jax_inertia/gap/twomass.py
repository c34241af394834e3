"""A link behind a spring or behind play, moved by a motor whose path is known: how far the two are apart.

The encoder sits on the motor, so its path θ(t) is what the log holds; the link is at q = θ − δ. With n(t) the torque
that the link alone would need to follow θ, and the model linearised about the logged motion,

    M_jj δ̈ + (∂ID/∂v)_jj δ̇ + (∂ID/∂q)_jj δ + f(δ, δ̇) = n(t),

where f is the torque through the coupling: K δ + D δ̇, for teeth with a dead zone b nothing between ±b/2. Solving
this forward needs two derivatives of the encoder; going from motor torque to δ and back to torque would take four.

A link on a spring rings, teeth rattle, and the smallest error of n, of M or of the spring's law grows at its resonance.
What the coupling carried is known from the motor's side as well, s = n − y = τ − J θ̈ − friction, and where it touches
δ̇ ≈ ṡ/K. So the computed path is drawn to that rate (an observer: Luenberger 1964),

    M_jj δ̈ + ... + f(δ, δ̇) + D₀ (δ̇ − ṡ/K) = n(t),    D₀ = 2 ζ₀ √(K mean M_jj)

which the true path obeys as well, but for the coupling's own loss, and in which errors decay.
"""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jax_inertia.slopes import derivative

# A tooth's contact lasts some milliseconds.
STEP = 5e-4
# Damping ratio ζ₀ of the path's errors.
OBSERVED = 0.3


def separation(
    time: Float[np.ndarray, " T"],
    needed: Float[np.ndarray, " T"],
    carried: Float[np.ndarray, " T"],
    inertia: Float[np.ndarray, " T"],
    damping: Float[np.ndarray, " T"],
    stiffness: Float[np.ndarray, " T"],
    coupling: Float[np.ndarray, "L 4"],
) -> Float[np.ndarray, "L T"]:
    """δ(t) for each coupling (K [N m/rad], damping ratio ζ, dead zone b [rad], s); D = 2 ζ √(K mean M_jj).

    It begins at s b/2, s from −1 to 1, and what the spring is wound up.

    `needed` is n, `carried` s. Trapezoidal rule with the branch (touching or not) fixed at each step's start; teeth
    never pull.
    """
    substeps = max(1, math.ceil((time[1] - time[0]) / STEP))
    rate = derivative(time, carried)
    signals = jnp.asarray(np.stack([needed, rate, inertia, damping, stiffness]))
    period = float(time[1] - time[0])
    # As an array: a number would be compiled in, and every log has another.
    first = jnp.asarray(carried[0])
    return np.asarray(_separation(signals, jnp.asarray(coupling), first, period, substeps))


@eqx.filter_jit
def _separation(
    signals: Array, coupling: Array, first: Array, period: float, substeps: int
) -> Array:
    k, ratio, gap, side = coupling.T
    critical = 2.0 * jnp.sqrt(k * jnp.mean(signals[2]))
    d, drawn = ratio * critical, OBSERVED * critical
    half, h = 0.5 * gap, period / substeps

    def substep(state, x):
        delta, rate = state
        n, ds, m, c, kq = x
        tooth = jnp.sign(delta)
        force = k * (delta - tooth * half) + d * rate
        touching = (half == 0.0) | ((jnp.abs(delta) > half) & (force * tooth >= 0.0))
        kt, ct = jnp.where(touching, k, 0.0) + kq, jnp.where(touching, d + drawn, 0.0) + c
        push = n + jnp.where(touching, k * tooth * half + drawn * ds / k, 0.0)
        left = m / h + 0.5 * ct + 0.25 * kt * h
        new = (push + rate * (m / h - 0.5 * ct - 0.25 * kt * h) - kt * delta) / left
        return (delta + 0.5 * h * (rate + new), new), None

    def sample(state, x):
        before, after = x
        weights = (jnp.arange(substeps) + 0.5) / substeps
        inner = before + weights[:, None] * (after - before)
        state, _ = jax.lax.scan(substep, state, inner)
        return state, state[0]

    # A log may begin in the middle of a motion.
    start = first / k + side * half
    pairs = (signals.T[:-1], signals.T[1:])
    _, path = jax.lax.scan(sample, (start, signals[1, 0] / k), pairs)
    return jnp.concatenate([start[None], path]).T
