"""How much a sample counts: one that may be noise or a shock (a mixture of scales), and one among others like it."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.stats import t as student

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


def autocorrelation_time(x: Float[np.ndarray, " N"]) -> float:
    """1 + 2 Σ ρ_k up to the first k where ρ is not positive, as in Geyer 1992, of x about its mean [samples]."""
    n, x = len(x), x - np.mean(x)
    power = np.abs(np.fft.rfft(x, 2 * n)) ** 2
    rho = np.fft.irfft(power)[: n // 2]
    if not rho[0] > 0:
        return 1.0
    rho = rho / rho[0]
    last = int(np.argmax(rho <= 0)) if np.any(rho <= 0) else len(rho)
    return float(1.0 + 2.0 * np.sum(rho[1:last]))


def odds_within(
    errors: Float[np.ndarray, "N m"], limit: Float[np.ndarray, " m"]
) -> Float[np.ndarray, " m"]:
    """Log odds that the rms error of each output is within a limit [nats], given N samples of it.

    ln P(T < t) / P(T > t),   t = (limit² − mean(e²)) / s,   s² = var(e²) / (N/τ − 1)

    T is Student's of N/τ − 1 degrees of freedom, τ the autocorrelation time of e². NaN is left out.

    >>> import numpy as np
    >>> from jax_inertia.maths.sample_weight import odds_within
    >>> e = np.random.default_rng(0).normal(size=(400, 1))
    >>> [float(np.sign(odds_within(e, np.array([x]))[0])) for x in (0.8, 1.3)]
    [-1.0, 1.0]
    """
    out = np.zeros(errors.shape[1])
    for j, e in enumerate(errors.T):
        square = e[np.isfinite(e)] ** 2
        count = max(len(square) / autocorrelation_time(square), 2.0)
        deviation = float(np.std(square)) / np.sqrt(count - 1.0)
        t = (limit[j] ** 2 - float(np.mean(square))) / max(deviation, 1e-300)
        out[j] = student.logcdf(t, count - 1.0) - student.logsf(t, count - 1.0)
    return out
