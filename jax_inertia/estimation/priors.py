"""How far bodies may be from the model: stated once in physical terms, for every chart alike."""

import abc

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jax_inertia.maths import charts, inertial_parameters


class Uncertainty(eqx.Module):
    """How far bodies may be from the model, in terms that mean the same in every chart."""

    @abc.abstractmethod
    def covariance(
        self, chart: charts.Chart, nominal: Float[Array, "bodies 10"]
    ) -> Float[Array, "bodies 10 10"]:
        """Covariance of each body's coordinates in the chart."""


class Load(Uncertainty):
    """A load that a body may carry: `mass` [kg] anywhere within `reach` [m].

    The standard deviations of π that it stands for: m by `mass`, h by mass · reach, I by mass · reach².
    """

    mass: Float[Array, ""] = eqx.field(converter=jnp.asarray)
    reach: Float[Array, ""] = eqx.field(converter=jnp.asarray, default=0.2)

    def sigma_pi(self) -> Float[Array, "10"]:
        """Standard deviation of each component of π."""
        powers = jnp.array([0.0] + [1.0] * 3 + [2.0] * 6, self.mass.dtype)
        return self.mass * self.reach**powers

    def covariance(
        self, chart: charts.Chart, nominal: Float[Array, "bodies 10"]
    ) -> Float[Array, "bodies 10 10"]:
        """G⁻¹ Σ G⁻ᵀ, with G at the body carrying the load as a ball around its centre of mass, not at the bare body:
        a load that dwarfs the body is a moderate change of the two together, while the bare body's tangent would call
        it e^17.
        """
        ball = inertial_parameters.from_com(
            jnp.broadcast_to(self.mass, nominal.shape[:-1]),
            inertial_parameters.centre_of_mass(nominal),
            jnp.broadcast_to(
                0.1 * self.mass * self.reach**2 * jnp.eye(3), (*nominal.shape[:-1], 3, 3)
            ),
        )
        g = chart.jacobian(chart.from_pi(nominal + ball.astype(nominal.dtype)))
        return _pulled_back(g, jnp.diag(self.sigma_pi()))


class Tolerance(Uncertainty):
    """How well a model's own figures are known: `mass` in parts (0.1: to 10 %), the centre of mass to `com` [m], and
    the spread of mass about it (the radii of gyration) to `spread` in parts.

    Independent of one another, unlike the moments about the frame origin, which a change of mass moves all.
    """

    mass: Float[Array, ""] = eqx.field(converter=jnp.asarray)
    com: Float[Array, ""] = eqx.field(converter=jnp.asarray)
    spread: Float[Array, ""] = eqx.field(converter=jnp.asarray, default=0.3)

    def covariance(
        self, chart: charts.Chart, nominal: Float[Array, "bodies 10"]
    ) -> Float[Array, "bodies 10 10"]:
        """Through `LogCholeskyUUt`, whose α, t and d are half the log of the mass, the centre of mass and the logs of
        the spread.
        """
        x = inertial_parameters.to_log_cholesky_uut(nominal)
        length = jnp.exp(x[:, 1:4])
        # The spread's off-diagonal entries, each in units of the two lengths that it couples.
        pairs = jnp.sqrt(length[:, [0, 0, 1]] * length[:, [1, 2, 2]])
        one = jnp.ones_like(length)
        sigma = [0.5 * self.mass * one[:, :1], self.spread * one, self.spread * pairs]
        sigma = jnp.concatenate([*sigma, self.com * one], axis=-1).astype(nominal.dtype)
        spread = inertial_parameters.log_cholesky_uut_jacobian(x) * sigma[:, None, :]
        return _pulled_back(chart.jacobian(chart.from_pi(nominal)), spread)


def _pulled_back(
    g: Float[Array, "bodies 10 10"], root: Float[Array, "*b 10 10"]
) -> Float[Array, "bodies 10 10"]:
    """G⁻¹ Σ G⁻ᵀ for Σ = root rootᵀ."""
    root = jnp.linalg.solve(g, jnp.broadcast_to(root, g.shape).astype(g.dtype))
    return root @ jnp.swapaxes(root, -1, -2)
