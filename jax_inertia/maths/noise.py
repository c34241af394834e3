"""Laws of a measurement's noise, as the filter needs them: whitened, row by row left out, and by their determinant."""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.scipy.linalg import solve_triangular
from jaxtyping import Array, Float


class Noise(eqx.Module):
    """Measurement noise R of m rows; a row where `used` is 0 is left out of everything."""

    @abc.abstractmethod
    def whiten(self, rows: Float[Array, "m k"], used: Float[Array, " m"]) -> Float[Array, "m k"]:
        """R^{-1/2} rows: unit noise, zero where not used."""

    @abc.abstractmethod
    def colour(self, rows: Float[Array, "m k"], used: Float[Array, " m"]) -> Float[Array, "m k"]:
        """R^{1/2} rows: back from `whiten`, for the rows used."""

    @abc.abstractmethod
    def variances(self) -> Float[Array, " m"]:
        """diag R."""

    @abc.abstractmethod
    def log_det(self, used: Float[Array, " m"]) -> Float[Array, ""]:
        """log det of the used block of R."""

    @abc.abstractmethod
    def plus(self, covariance: Float[Array, "m m"]) -> "CorrelatedNoise":
        """With independent noise of this covariance added."""

    @abc.abstractmethod
    def scaled(self, factor: Float[Array, ""]) -> "Noise":
        """The same with all variances larger by this factor."""


class IndependentNoise(Noise):
    """Rows with independent noise of the given variance."""

    variance: Float[Array, " m"]

    def whiten(self, rows: Float[Array, "m k"], used: Float[Array, " m"]) -> Float[Array, "m k"]:
        return rows * (used * jax.lax.rsqrt(self.variance))[:, None]

    def colour(self, rows: Float[Array, "m k"], used: Float[Array, " m"]) -> Float[Array, "m k"]:
        return rows * jnp.sqrt(self.variance)[:, None]

    def variances(self) -> Float[Array, " m"]:
        return self.variance

    def log_det(self, used: Float[Array, " m"]) -> Float[Array, ""]:
        return used @ jnp.log(self.variance)

    def plus(self, covariance: Float[Array, "m m"]) -> "CorrelatedNoise":
        return CorrelatedNoise(jnp.diag(self.variance) + covariance)

    def scaled(self, factor: Float[Array, ""]) -> "IndependentNoise":
        return IndependentNoise(self.variance * factor)


class CorrelatedNoise(Noise):
    """Rows with a full noise covariance R, such as contact-wrench noise seen through Jᵀ."""

    covariance: Float[Array, "m m"]

    def whiten(self, rows: Float[Array, "m k"], used: Float[Array, " m"]) -> Float[Array, "m k"]:
        return solve_triangular(self._factor(used), rows * used[:, None], lower=True)

    def colour(self, rows: Float[Array, "m k"], used: Float[Array, " m"]) -> Float[Array, "m k"]:
        return self._factor(used) @ rows

    def variances(self) -> Float[Array, " m"]:
        return jnp.diagonal(self.covariance)

    def log_det(self, used: Float[Array, " m"]) -> Float[Array, ""]:
        return 2.0 * jnp.sum(jnp.log(jnp.diagonal(self._factor(used))))

    def plus(self, covariance: Float[Array, "m m"]) -> "CorrelatedNoise":
        return CorrelatedNoise(self.covariance + covariance)

    def scaled(self, factor: Float[Array, ""]) -> "CorrelatedNoise":
        return CorrelatedNoise(self.covariance * factor)

    def _factor(self, used: Float[Array, " m"]) -> Float[Array, "m m"]:
        # A row left out gets unit noise apart from the others: what remains is the marginal of the rest.
        keep = used[:, None] * used[None, :]
        return jnp.linalg.cholesky(jnp.where(keep > 0, self.covariance, jnp.diag(1.0 - used)))
