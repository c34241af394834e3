"""Handing estimates to a controller without steps, and without leaving the physical set on the way.

The paper caps the rate "taking mass as an example" at 3 kg/s. A cap on each component of π by itself leaves the
physical set (components arrive at different times, and a body with its new mass and its old inertia may be none).
Physical bodies form a convex cone, so a common step along the segment from one to the other stays inside.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from jax_inertia.maths.argument_checks import is_positive, require


class Slew(eqx.Module):
    """Rate limit on inertial parameters: `rate` [kg/s], with first and second moments weighed by `reach` [m].

    The distance between two bodies is max(|Δm|, |Δh| / reach, |ΔI| / reach²), in kg: a load that only shifts is
    limited too. Raises ValueError for a rate or reach that is not positive and finite.
    """

    rate: Float[Array, ""]
    reach: Float[Array, ""]

    def __init__(self, rate: ArrayLike = 3.0, reach: ArrayLike = 0.2) -> None:
        self.rate, self.reach = jnp.asarray(rate), jnp.asarray(reach)

    def __check_init__(self) -> None:
        for name, value in vars(self).items():
            require(name, value, is_positive, "positive and finite")

    def step(
        self,
        handed: Float[Array, "*b 10"],
        estimate: Float[Array, "*b 10"],
        dt: Float[Array, ""] | float,
    ) -> Float[Array, "*b 10"]:
        """What to hand over after `dt` [s], given what was handed over last and the estimate.

        π ← π + min(1, rate · dt / distance) (π̂ − π): physical whenever both are; the mass never moves faster than
        `rate`. A body whose estimate is not finite keeps what it was handed, and all bodies do where `dt` is not
        positive and finite.
        """
        going = jnp.isfinite(dt) & (jnp.asarray(dt) > 0)
        sound = going & jnp.all(jnp.isfinite(estimate), axis=-1, keepdims=True)
        change = jnp.where(sound, estimate - handed, 0.0)
        weight = self.reach ** -jnp.array([0.0] + [1.0] * 3 + [2.0] * 6, change.dtype)
        distance = jnp.max(jnp.abs(change) * weight, axis=-1, keepdims=True)
        allowed = self.rate * jnp.where(going, dt, 0.0)
        share = jnp.where(distance > allowed, allowed / jnp.maximum(distance, 1e-30), 1.0)
        return handed + share * change
