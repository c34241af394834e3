"""Charts: coordinates x (10 per body) in which a filter or a fit moves the inertial parameters π.

One filter serves both of the paper's estimators: the Kalman filter is the filter on the `Linear` chart, the extended
Kalman filter the same on `LogCholesky`. Every chart but `Linear` gives a physical body for every finite x.
"""

import abc
import math

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.scipy.linalg import solve_triangular
from jaxtyping import Array, Float

from jax_inertia.maths import inertial_parameters, spatial
from jax_inertia.maths.precision import in_full_precision


class Chart(eqx.Module):
    """Coordinates of one body's inertial parameters; all methods broadcast over leading axes."""

    @abc.abstractmethod
    def to_pi(self, x: Float[Array, "*b 10"]) -> Float[Array, "*b 10"]:
        """π = g(x)."""

    @abc.abstractmethod
    def from_pi(self, pi: Float[Array, "*b 10"]) -> Float[Array, "*b 10"]:
        """x = g⁻¹(π); NaN where the chart does not reach π."""

    @abc.abstractmethod
    def jacobian(self, x: Float[Array, "*b 10"]) -> Float[Array, "*b 10 10"]:
        """∂g/∂x in closed form; equals `jax.jacfwd(self.to_pi)(x)` for one x."""

    def project(self, x: Float[Array, "*b 10"]) -> Float[Array, "*b 10"]:
        """An x whose π survives rounding; the identity for every body a robot could carry."""
        return x


class Linear(Chart):
    """π itself: the paper's baseline Kalman filter (eq. process, eq. measurement); may leave the physical set."""

    def to_pi(self, x: Float[Array, "*b 10"]) -> Float[Array, "*b 10"]:
        return x

    def from_pi(self, pi: Float[Array, "*b 10"]) -> Float[Array, "*b 10"]:
        return pi

    def jacobian(self, x: Float[Array, "*b 10"]) -> Float[Array, "*b 10 10"]:
        return jnp.broadcast_to(jnp.eye(10, dtype=x.dtype), (*x.shape, 10))


class Physical(Chart):
    """A chart that gives a physical body for every finite x, in rounded arithmetic after `project`."""

    @abc.abstractmethod
    def inverse_root(self, x: Float[Array, "*b 10"]) -> Float[Array, "*b 3 4"]:
        """W with W Wᵀ = Σ_c⁻¹, the inverse spread of mass about the centre of mass [1/(kg m²)]."""

    def project(self, x: Float[Array, "*b 10"]) -> Float[Array, "*b 10"]:
        """x where π = g(x) survives rounding to ten numbers; otherwise that of π with inertia added.

        A wild outlier can throw x anywhere. Every x is a physical body in exact arithmetic, but π holds
        the spread of its mass only as differences of moments about the frame's origin, so that a body
        whose spread Σ_c about the centre of mass is, in some direction, below some ε of tr Σ is lost to
        rounding. With 1/tr Σ_c⁻¹ ≤ λ_min(Σ_c) as the measure, what is lacking is added in all
        directions: λ_min(Σ_c) ≥ 32 ε tr Σ. In float32 this is a rod some 400 times as long as thick,
        in float64 of 1e7.
        """
        limit = 32.0 * float(jnp.finfo(x.dtype).eps)
        # Masses to 5e8 kg, lengths of 6 µm to 100 m, and room for what UᵀU shifts from α to d and s
        # when t is large: exp and its squares stay finite in float32.
        far = limit**-0.5
        low = [-10.0 - math.log(far)] + [-12.0] * 3 + [-100.0 * far] * 3 + [-far] * 3
        high = [10.0] + [4.6 + math.log(far)] * 3 + [100.0 * far] * 3 + [far] * 3
        inside = jnp.clip(x, jnp.array(low, x.dtype), jnp.array(high, x.dtype))

        pi, root = self.to_pi(inside), self.inverse_root(inside)
        trace = 0.5 * (pi[..., 4] + pi[..., 7] + pi[..., 9])
        lack = jnp.maximum(limit * trace - 1.0 / jnp.sum(root * root, axis=(-2, -1)), 0.0)[
            ..., None
        ]
        # Σ + lack 1 is I + 2 lack 1.
        diagonal = jnp.array([0, 0, 0, 0, 2, 0, 0, 2, 0, 2], x.dtype)
        return jax.lax.cond(
            jnp.any(lack > 0),
            lambda: jnp.where(lack > 0, self.from_pi(pi + lack * diagonal), inside),
            lambda: inside,
        )


class LogCholesky(Physical):
    """The paper's chart θ, pseudo-inertia UᵀU (Foster et al., eq. log-cholesky)."""

    def to_pi(self, x: Float[Array, "*b 10"]) -> Float[Array, "*b 10"]:
        return inertial_parameters.from_log_cholesky(x)

    def from_pi(self, pi: Float[Array, "*b 10"]) -> Float[Array, "*b 10"]:
        return inertial_parameters.to_log_cholesky(pi)

    def jacobian(self, x: Float[Array, "*b 10"]) -> Float[Array, "*b 10 10"]:
        return inertial_parameters.log_cholesky_jacobian(x)

    def inverse_root(self, x: Float[Array, "*b 10"]) -> Float[Array, "*b 3 4"]:
        return _inverse_factor(x)[..., :3, :]


class LogCholeskyUUt(Physical):
    """The other factor, pseudo-inertia U Uᵀ, as in Pinocchio: m = e^{2α}, t the centre of mass."""

    def to_pi(self, x: Float[Array, "*b 10"]) -> Float[Array, "*b 10"]:
        return inertial_parameters.from_log_cholesky_uut(x)

    def from_pi(self, pi: Float[Array, "*b 10"]) -> Float[Array, "*b 10"]:
        return inertial_parameters.to_log_cholesky_uut(pi)

    def jacobian(self, x: Float[Array, "*b 10"]) -> Float[Array, "*b 10 10"]:
        return inertial_parameters.log_cholesky_uut_jacobian(x)

    def inverse_root(self, x: Float[Array, "*b 10"]) -> Float[Array, "*b 3 4"]:
        return jnp.swapaxes(_inverse_factor(x)[..., :3], -1, -2)


class Relative(Physical):
    """Log-Cholesky relative to a nominal body: P = L U Uᵀ Lᵀ with nominal P₀ = L Lᵀ, so that x = 0 is the nominal.

    U is the factor of `LogCholeskyUUt`; x is dimensionless and every component is of the order of the relative
    change of the body, whatever its size and shape.
    """

    factor: Float[Array, "*b 4 4"]

    @classmethod
    def to(cls, nominal: Float[Array, "*b 10"]) -> "Relative":
        """The chart about nominal bodies, which must be physical (NaN otherwise)."""
        return cls(spatial.cholesky(inertial_parameters.pseudo_inertia(nominal)))

    @in_full_precision
    def to_pi(self, x: Float[Array, "*b 10"]) -> Float[Array, "*b 10"]:
        # (L U)(L U)ᵀ rather than L (U Uᵀ) Lᵀ, here and back: in float32 thin bodies would be lost in the latter.
        root = self.factor @ inertial_parameters.factor(x)
        return inertial_parameters.from_pseudo_inertia(root @ jnp.swapaxes(root, -1, -2))

    def from_pi(self, pi: Float[Array, "*b 10"]) -> Float[Array, "*b 10"]:
        root = spatial.cholesky(inertial_parameters.pseudo_inertia(pi))
        root = solve_triangular(jnp.broadcast_to(self.factor, root.shape), root, lower=True)
        # root rootᵀ = U Uᵀ with U upper: the R of a QR factorisation, with both axes reversed.
        reverse = jnp.swapaxes(root[..., ::-1, :], -1, -2)
        upper = jnp.swapaxes(jnp.linalg.qr(reverse, mode="r"), -1, -2)[..., ::-1, ::-1]
        signs = jnp.sign(jnp.diagonal(upper, axis1=-2, axis2=-1))
        return inertial_parameters.read_factor(upper * signs[..., None, :])

    @in_full_precision
    def jacobian(self, x: Float[Array, "*b 10"]) -> Float[Array, "*b 10 10"]:
        inner = inertial_parameters.log_cholesky_uut_jacobian(x)
        # The congruence P ↦ L P Lᵀ is linear in π: its matrix, column by column.
        columns = inertial_parameters.pseudo_inertia(jnp.eye(10, dtype=x.dtype))
        factor = self.factor[..., None, :, :]
        moved = factor @ columns @ jnp.swapaxes(factor, -1, -2)
        return jnp.swapaxes(inertial_parameters.from_pseudo_inertia(moved), -1, -2) @ inner

    @in_full_precision
    def inverse_root(self, x: Float[Array, "*b 10"]) -> Float[Array, "*b 3 4"]:
        root = _inverse_factor(x) @ jnp.linalg.inv(self.factor)
        return jnp.swapaxes(root[..., :3], -1, -2)


def _inverse_factor(x: Float[Array, "*b 10"]) -> Float[Array, "*b 4 4"]:
    """U⁻¹, written out so that XLA fuses it: a filter step can afford it."""
    a, d1, d2, d3, s12, s13, s23, t1, t2, t3 = (x[..., i] for i in range(10))
    i11, i22, i33 = jnp.exp(-d1), jnp.exp(-d2), jnp.exp(-d3)
    i12, i23 = -s12 * i11 * i22, -s23 * i22 * i33
    i13 = -(s13 * i11 + s23 * i12) * i33
    o = jnp.zeros_like(a)
    rows = [
        [i11, i12, i13, -(i11 * t1 + i12 * t2 + i13 * t3)],
        [o, i22, i23, -(i22 * t2 + i23 * t3)],
        [o, o, i33, -i33 * t3],
        [o, o, o, jnp.ones_like(a)],
    ]
    inverse = jnp.stack([jnp.stack(row, axis=-1) for row in rows], axis=-2)
    return jnp.exp(-a)[..., None, None] * inverse
