"""How much a sample counts that may be noise or a shock: a mixture of scales instead of a gate."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

_GARBAGE, _SCALES = 0.01, (10.0, 100.0, 1000.0)
"""Share of samples that are shocks, and how much larger than noise those are: one decade is as likely as another."""


def mixture(
    square: Float[Array, ""], rows: Float[Array, ""]
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """(log-likelihood, weight) of whitened rows of this squared length that may be noise or a shock.

    log Σ_j p_j κ_j^−m exp(−|ν|² / 2κ_j²), constants apart; the weight is the mean of 1/κ², what a Gaussian with as much
    information would have.

    >>> import jax.numpy as jnp
    >>> from jax_inertia.maths.sample_weight import mixture
    >>> [round(float(mixture(jnp.asarray(x), jnp.asarray(3.0))[1]), 2) for x in (3.0, 300.0)]
    [1.0, 0.01]
    """
    scales = jnp.asarray([1.0, *_SCALES], square.dtype)
    share = np.array([1.0 - _GARBAGE] + [_GARBAGE / len(_SCALES)] * len(_SCALES))
    each = jnp.log(jnp.asarray(share, square.dtype)) - rows * jnp.log(scales)
    each = each - 0.5 * square / scales**2
    weight = jax.nn.softmax(each) @ scales**-2
    return jax.scipy.special.logsumexp(each), weight
