"""How deep feet sink into the ground under load, by the law of the model's own contacts.

MuJoCo's contact (its documentation, *Computation*: constraint model, solver parameters) gives way: with a load f on a
depth p, and the impedance d(p) of `solimp`, stiffness k and damping b of `solref`,

    p̈ + b ṗ + d(p) k p = (1 − d(p)) / d(p) · A f,

A the inverse mass of what touches. A foot of Menagerie's Go1 goes 15 mm into its floor, and rises and falls there by as
much as its trunk does: what encoders say of the base's height lacks it.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

_STEPS = 8
"""Of the integration in a sample of the grid."""
_BEFORE = 0.2
"""A foot has borne its first load for this long [s]."""


def sunk(
    soft: Float[np.ndarray, "C 9"], load: Float[np.ndarray, "T C"], rate: float
) -> tuple[Float[np.ndarray, "T C"], Float[np.ndarray, "T C"]]:
    """Depth [m] of feet under their loads [N] at `rate` [Hz], and how fast it grows [m/s].

    `soft` as `Surface.soft` has it. Where nothing is known of a contact (A = 0) nothing sinks.
    """
    if not len(load) or not np.any(soft[:, 7]):
        return np.zeros_like(load), np.zeros_like(load)
    first = np.repeat(load[:1], round(_BEFORE * rate), axis=0)
    whole = np.maximum(np.concatenate([first, load]), 0.0)
    depth, speed = _integrated(jnp.asarray(soft), jnp.asarray(whole), 1.0 / (_STEPS * rate))
    known = soft[:, 7] > 0
    start = len(first)
    return np.asarray(depth)[start:] * known, np.asarray(speed)[start:] * known


@jax.jit
def _integrated(soft, load, h):
    k, b, _, _, _, _, _, inverse, margin = soft.T

    def within(state, f):
        p, v = state
        d = impedance(soft, p)
        push = (1.0 - d) / d * inverse * f - d * k * p
        v = (v + h * push) / (1.0 + h * b)
        p = p + h * v
        return (jnp.maximum(p, 0.0), jnp.where(p > 0.0, v, 0.0)), None

    def sample(state, f):
        state, _ = jax.lax.scan(within, state, jnp.repeat(f[None], _STEPS, axis=0))
        return state, state

    none = jnp.zeros_like(load[0])
    _, (depth, speed) = jax.lax.scan(sample, (none, none), load)
    return jnp.maximum(depth - margin, 0.0), speed


def impedance(soft: Float[Array, "C 9"], depth: Float[Array, " C"]) -> Float[Array, " C"]:
    """MuJoCo's d of a depth beyond the margin."""
    _, _, low, high, width, middle, power, _, _ = soft.T
    x = jnp.clip(depth / width, 0.0, 1.0)
    rising = x**power / middle ** (power - 1.0)
    falling = 1.0 - (1.0 - x) ** power / (1.0 - middle) ** (power - 1.0)
    return low + jnp.where(x <= middle, rising, falling) * (high - low)
