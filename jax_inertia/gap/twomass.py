"""A link behind a spring or behind play, moved by a motor whose path is known: how far the two are apart.

The encoder sits on the motor, so its path θ(t) is what the log holds; the link is at q = θ − δ. With n(t) the torque
that the link alone would need to follow θ, and the model linearised about the logged motion,

    M_jj δ̈ + (∂ID/∂v)_jj δ̇ + (∂ID/∂q)_jj δ + f(δ, δ̇) = n(t),

where f is the torque through the coupling: K δ + D δ̇, for teeth with a dead zone b nothing between ±b/2. Solving
this forward needs two derivatives of the encoder; going from motor torque to δ and back to torque would take four.
"""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

# A tooth's contact lasts some milliseconds.
STEP = 5e-4


def separation(
    time: Float[np.ndarray, " T"],
    needed: Float[np.ndarray, " T"],
    inertia: Float[np.ndarray, " T"],
    damping: Float[np.ndarray, " T"],
    stiffness: Float[np.ndarray, " T"],
    coupling: Float[np.ndarray, "L 3"],
) -> Float[np.ndarray, "L T"]:
    """δ(t) for each coupling (K [N m/rad], damping ratio ζ, dead zone b [rad]); D = 2 ζ √(K mean M_jj).

    Trapezoidal rule with the branch (touching or not) fixed at each step's start; teeth never pull.
    """
    substeps = max(1, math.ceil((time[1] - time[0]) / STEP))
    signals = jnp.asarray(np.stack([needed, inertia, damping, stiffness]))
    period = float(time[1] - time[0])
    return np.asarray(_separation(signals, jnp.asarray(coupling), period, substeps))


@eqx.filter_jit
def _separation(signals: Array, coupling: Array, period: float, substeps: int) -> Array:
    k, ratio, gap = coupling.T
    d = 2.0 * ratio * jnp.sqrt(k * jnp.mean(signals[1]))
    half, h = 0.5 * gap, period / substeps

    def substep(state, x):
        delta, rate = state
        n, m, c, kq = x
        side = jnp.sign(delta)
        force = k * (delta - side * half) + d * rate
        touching = (jnp.abs(delta) > half) & (force * side >= 0.0)
        kt, ct = jnp.where(touching, k, 0.0) + kq, jnp.where(touching, d, 0.0) + c
        push = n + jnp.where(touching, k * side * half, 0.0)
        left = m / h + 0.5 * ct + 0.25 * kt * h
        new = (push + rate * (m / h - 0.5 * ct - 0.25 * kt * h) - kt * delta) / left
        return (delta + 0.5 * h * (rate + new), new), None

    def sample(state, x):
        before, after = x
        weights = (jnp.arange(substeps) + 0.5) / substeps
        inner = before + weights[:, None] * (after - before)
        state, _ = jax.lax.scan(substep, state, inner)
        return state, state[0]

    n0 = signals[0, 0]
    start = n0 / k + jnp.sign(n0) * half
    pairs = (signals.T[:-1], signals.T[1:])
    _, path = jax.lax.scan(sample, (start, jnp.zeros_like(start)), pairs)
    return jnp.concatenate([start[None], path]).T
