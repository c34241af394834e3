"""The linear response of a closed loop along a motion: what torque columns do to positions.

    M δq̈ + (Kd + H_v + D) δq̇ + (Kp + H_q) δq = e(t)

A torque e along the measured motion parts the robot from a replay of its model by δq. At gains θ of the model the
relation e = E (θ_real − θ) is exact in every number that the torque is linear in, however large the gap, where E is
along the measured motion and the loop's gains are the model's (for bilinear terms (θ_real − θ) q_measured both sides
are the same sum): a start whose kp is many times too large converges.

The trapezoidal rule is stable for every step; joints that dry friction holds decay by MuJoCo's own rate, implicitly.
"""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jax_inertia.logs.log import AnyArray
from jax_inertia.maths.precision import in_full_precision
from jax_inertia.signals.creep import DAMPING


class Loop(eqx.Module):
    """A closed loop along a motion: matrices at each step, and where dry friction holds a joint."""

    mass: Float[AnyArray, "K n n"]
    damping: Float[AnyArray, "K n n"]
    stiffness: Float[AnyArray, "K n n"]
    held: Float[AnyArray, "K n"]
    """1 where dry friction holds the joint."""


@in_full_precision
def steps_of(loop: Loop, h: float | Array) -> Float[Array, "K n 3*n"]:
    """S with δq̈ = S [δq; δq̇; e] over each step h, by the trapezoidal rule.

    A = M + h/2 C + h²/4 K of damping C and stiffness K is inverted in units of its diagonal: inertias of a robot's
    joints differ by 10⁴, and float32 then loses nothing to that.
    """
    own = jnp.diagonal(loop.mass, axis1=1, axis2=2)
    # A constraint of friction loss: δq̈ = −b δq̇, of the whole step (implicit Euler).
    stuck = jax.vmap(jnp.diag)(DAMPING * own * loop.held)
    left = loop.mass + 0.5 * h * loop.damping + h * stuck + 0.25 * h * h * loop.stiffness
    scale = 1.0 / jnp.sqrt(jnp.maximum(jnp.abs(jnp.diagonal(left, axis1=1, axis2=2)), 1e-30))
    inverse = scale[:, :, None] * jnp.linalg.inv(left * scale[:, :, None] * scale[:, None, :])
    inverse = inverse * scale[:, None, :]
    of_q = -inverse @ loop.stiffness
    of_v = -inverse @ (loop.damping + stuck + 0.5 * h * loop.stiffness)
    return jnp.concatenate([of_q, of_v, inverse], axis=2)


@partial(jax.jit, static_argnames=("every",))
@in_full_precision
def response(
    loop: Loop, columns: Float[AnyArray, "K n c"], h: float | Array, every: int
) -> Float[Array, "T n c"]:
    """Positions [rad per unit of each column] at every `every`-th edge of the steps, the first one left out."""
    steps = steps_of(loop, h)
    n, c = columns.shape[1:]
    # A row of the result is `every` steps long: the scan writes no more than is asked for.
    wide = [x.reshape(-1, every, *x.shape[1:]) for x in (steps, columns)]

    def sample(state, x):
        def step(state, x):
            (q, v), (s, e) = state, x
            a = s @ jnp.concatenate([q, v, e])
            return (q + h * v + 0.5 * h * h * a, v + h * a), None

        state, _ = jax.lax.scan(step, state, x)
        return state, state[0]

    start = jnp.zeros((n, c), columns.dtype)
    return jax.lax.scan(sample, (start, start), (wide[0], wide[1]))[1]
