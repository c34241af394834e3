"""How far bodies may be from the model: stated once in physical terms, for every chart alike."""

import abc

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from jax_inertia.maths import charts, inertial_parameters, spatial
from jax_inertia.maths.precision import in_full_precision


class Uncertainty(eqx.Module):
    """How far bodies may be from the model, in terms that mean the same in every chart."""

    @abc.abstractmethod
    def covariance(
        self, chart: charts.Chart, nominal: Float[Array, "bodies 10"]
    ) -> Float[Array, "bodies 10 10"]:
        """Covariance of each body's coordinates in the chart."""

    def anchor(self, nominal: Float[Array, "bodies 10"]) -> Float[Array, "bodies 10"]:
        """π of the bodies at whose slope the statement is made: the bodies themselves, unless they carry more."""
        return nominal

    def of_bodies(self) -> "Uncertainty":
        """The same where loads have the shape of one that a robot can carry (`Load.of_a_body`)."""
        return self


class Load(Uncertainty):
    """A load that a body may carry: `mass` [kg] anywhere within `reach` [m].

    The standard deviations of π that it stands for: m by `mass`, h by mass · reach, I by mass · reach². Besides, the
    radii of gyration of body and load together are known to e^±`shape` (None: only as the moments say, which call radii
    that are e^5 times larger or smaller as likely as not).
    """

    mass: Float[Array, ""]
    reach: Float[Array, ""]
    shape: Float[Array, ""] | None

    # Not by field converters, which mypy does not know.
    def __init__(
        self, mass: ArrayLike, reach: ArrayLike = 0.2, shape: ArrayLike | None = None
    ) -> None:
        self.mass, self.reach = jnp.asarray(mass), jnp.asarray(reach)
        self.shape = None if shape is None else jnp.asarray(shape)

    def sigma_pi(self) -> Float[Array, "10"]:
        """Standard deviation of each component of π."""
        powers = jnp.array([0.0] + [1.0] * 3 + [2.0] * 6, self.mass.dtype)
        return self.mass * self.reach**powers

    @in_full_precision
    def covariance(
        self, chart: charts.Chart, nominal: Float[Array, "bodies 10"]
    ) -> Float[Array, "bodies 10 10"]:
        """G⁻¹ Σ G⁻ᵀ, with G at the body carrying the load as a ball around its centre of mass, not at the bare body:
        a load that dwarfs the body is a moderate change of the two together, while the bare body's tangent would call
        it e^17.

        With a `shape` the covariance is a whole statement about a load, and G⁻¹ its mean on the way from the bare body
        to the loaded one, along which it is the chart's exact difference of the two: the load is one σ away. By the
        loaded body's tangent, one of the body's own weight would be 1.4 σ away, and one of twice that 2.2.
        """
        loaded = self.anchor(nominal)
        if self.shape is None:
            return _pulled_back(chart.jacobian(chart.from_pi(loaded)), jnp.diag(self.sigma_pi()))
        x = inertial_parameters.to_log_cholesky_uut(loaded)
        g = inertial_parameters.log_cholesky_uut_jacobian(x)
        root = _mean_inverse_slope(nominal, loaded) * self.sigma_pi().astype(nominal.dtype)
        own = root @ jnp.swapaxes(root, -1, -2)
        # Both statements hold at once: the shape's information is added to the six numbers that say it.
        six = slice(1, 7)
        weight = (self.shape * _shape_units(x)) ** -2
        inner = jnp.eye(6, dtype=own.dtype) + own[:, six, six] * weight[:, None, :]
        told = jnp.linalg.solve(inner, own[:, six, :])
        narrow = own - (own[:, :, six] * weight[:, None, :]) @ told
        narrow = 0.5 * (narrow + jnp.swapaxes(narrow, -1, -2))
        return _pulled_back(chart.jacobian(chart.from_pi(loaded)), g @ spatial.cholesky(narrow))

    @in_full_precision
    def anchor(self, nominal: Float[Array, "bodies 10"]) -> Float[Array, "bodies 10"]:
        """The bodies with the load as a ball around their centres of mass."""
        ball = inertial_parameters.from_com(
            jnp.broadcast_to(self.mass, nominal.shape[:-1]),
            inertial_parameters.centre_of_mass(nominal),
            jnp.broadcast_to(
                0.1 * self.mass * self.reach**2 * jnp.eye(3), (*nominal.shape[:-1], 3, 3)
            ),
        )
        return nominal + ball.astype(nominal.dtype)

    def of_bodies(self) -> "Load":
        return self.of_a_body()

    def of_a_body(self) -> "Load":
        """The same with a `shape`, one where none is given: loads that a robot can carry.

        A radius of gyration that has fallen to nothing has no slope any more in log-Cholesky coordinates, and a filter
        that its first samples lead there stays.
        """
        one = jnp.ones_like(self.mass)
        return Load(self.mass, self.reach, one if self.shape is None else self.shape)


class Tolerance(Uncertainty):
    """How well a model's own figures are known: `mass` in parts (0.1: to 10 %), the centre of mass to `com` [m], and
    the spread of mass about it (the radii of gyration) to `spread` in parts.

    Independent of one another, unlike the moments about the frame origin, which a change of mass moves all.
    """

    mass: Float[Array, ""]
    com: Float[Array, ""]
    spread: Float[Array, ""]

    def __init__(self, mass: ArrayLike, com: ArrayLike, spread: ArrayLike = 0.3) -> None:
        self.mass, self.com, self.spread = (jnp.asarray(x) for x in (mass, com, spread))

    @in_full_precision
    def covariance(
        self, chart: charts.Chart, nominal: Float[Array, "bodies 10"]
    ) -> Float[Array, "bodies 10 10"]:
        """Through `LogCholeskyUUt`, whose α, t and d are half the log of the mass, the centre of mass and the logs of
        the spread.
        """
        x = inertial_parameters.to_log_cholesky_uut(nominal)
        one = jnp.ones_like(x[:, 1:4])
        sigma = [0.5 * self.mass * one[:, :1], self.spread * _shape_units(x)]
        sigma = jnp.concatenate([*sigma, self.com * one], axis=-1).astype(nominal.dtype)
        spread = inertial_parameters.log_cholesky_uut_jacobian(x) * sigma[:, None, :]
        return _pulled_back(chart.jacobian(chart.from_pi(nominal)), spread)


class Each(Uncertainty):
    """One statement for the first bodies, another for those that come after them."""

    first: Uncertainty
    others: Uncertainty
    count: int = eqx.field(static=True)
    """How many the first one is about."""

    def covariance(
        self, chart: charts.Chart, nominal: Float[Array, "bodies 10"]
    ) -> Float[Array, "bodies 10 10"]:
        """Of each body by its own statement."""
        own, rest = nominal[: self.count], nominal[self.count :]
        both = self.first.covariance(chart, own), self.others.covariance(chart, rest)
        return jnp.concatenate(both)

    def anchor(self, nominal: Float[Array, "bodies 10"]) -> Float[Array, "bodies 10"]:
        own, rest = nominal[: self.count], nominal[self.count :]
        return jnp.concatenate([self.first.anchor(own), self.others.anchor(rest)])

    def of_bodies(self) -> "Each":
        return Each(self.first.of_bodies(), self.others.of_bodies(), self.count)


def _mean_inverse_slope(
    first: Float[Array, "bodies 10"], last: Float[Array, "bodies 10"]
) -> Float[Array, "bodies 10 10"]:
    """Mean of ∂x/∂π of `LogCholeskyUUt` on the straight way between bodies, by Gauss and Legendre's rule: times their
    difference it is the difference of their coordinates.
    """
    at, weight = np.polynomial.legendre.leggauss(16)
    way = jnp.asarray(0.5 * (1.0 + at), first.dtype)[:, None, None]
    x = inertial_parameters.to_log_cholesky_uut(first + way * (last - first))
    inverse = jnp.linalg.inv(inertial_parameters.log_cholesky_uut_jacobian(x))
    return jnp.einsum("k,kbij->bij", jnp.asarray(0.5 * weight, first.dtype), inverse)


def _shape_units(x: Float[Array, "bodies 10"]) -> Float[Array, "bodies 6"]:
    """What `LogCholeskyUUt`'s d and s are measured in: logs, and off-diagonal entries in units of the two lengths that
    each couples [m].
    """
    length = jnp.exp(x[:, 1:4])
    pairs = jnp.sqrt(length[:, [0, 0, 1]] * length[:, [1, 2, 2]])
    return jnp.concatenate([jnp.ones_like(length), pairs], axis=-1)


def _pulled_back(
    g: Float[Array, "bodies 10 10"], root: Float[Array, "*b 10 10"]
) -> Float[Array, "bodies 10 10"]:
    """G⁻¹ Σ G⁻ᵀ for Σ = root rootᵀ."""
    root = jnp.linalg.solve(g, jnp.broadcast_to(root, g.shape).astype(g.dtype))
    out = root @ jnp.swapaxes(root, -1, -2)
    # On one thread the two sums of a pair are rounded apart.
    return 0.5 * (out + jnp.swapaxes(out, -1, -2))
