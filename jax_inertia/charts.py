"""Charts: coordinates x (10 per body) in which a filter or a fit moves the inertial parameters π.

One filter serves both of the paper's estimators: the Kalman filter is the filter on the `Linear` chart, the extended
Kalman filter the same on `LogCholesky`. Every chart but `Linear` gives a physical body for every finite x.
"""

import abc

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jax_inertia import inertia


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
        """Nearest x whose π survives rounding; the identity for every body a robot could carry."""
        return x


class Linear(Chart):
    """π itself: the paper's baseline Kalman filter (eq. process, eq. measurement); may leave the physical set."""

    def to_pi(self, x: Float[Array, "*b 10"]) -> Float[Array, "*b 10"]:
        return x

    def from_pi(self, pi: Float[Array, "*b 10"]) -> Float[Array, "*b 10"]:
        return pi

    def jacobian(self, x: Float[Array, "*b 10"]) -> Float[Array, "*b 10 10"]:
        return jnp.broadcast_to(jnp.eye(10, dtype=x.dtype), (*x.shape, 10))


class LogCholesky(Chart):
    """The paper's chart θ, pseudo-inertia UᵀU (Foster et al., eq. log-cholesky)."""

    def to_pi(self, x: Float[Array, "*b 10"]) -> Float[Array, "*b 10"]:
        return inertia.from_log_cholesky(x)

    def from_pi(self, pi: Float[Array, "*b 10"]) -> Float[Array, "*b 10"]:
        return inertia.to_log_cholesky(pi)

    def jacobian(self, x: Float[Array, "*b 10"]) -> Float[Array, "*b 10 10"]:
        return inertia.log_cholesky_jacobian(x)

    def project(self, x: Float[Array, "*b 10"]) -> Float[Array, "*b 10"]:
        return _well_conditioned(x, rows=False)


class LogCholeskyUUt(Chart):
    """The other factor, pseudo-inertia U Uᵀ, as in Pinocchio: m = e^{2α}, t the centre of mass."""

    def to_pi(self, x: Float[Array, "*b 10"]) -> Float[Array, "*b 10"]:
        return inertia.from_log_cholesky_uut(x)

    def from_pi(self, pi: Float[Array, "*b 10"]) -> Float[Array, "*b 10"]:
        return inertia.to_log_cholesky_uut(pi)

    def jacobian(self, x: Float[Array, "*b 10"]) -> Float[Array, "*b 10 10"]:
        return inertia.log_cholesky_uut_jacobian(x)

    def project(self, x: Float[Array, "*b 10"]) -> Float[Array, "*b 10"]:
        return _well_conditioned(x, rows=True)


class Relative(Chart):
    """Log-Cholesky relative to a nominal body: P = L U Uᵀ Lᵀ with nominal P₀ = L Lᵀ, so that x = 0 is the nominal.

    U is the factor of `LogCholeskyUUt`; x is dimensionless and every component is of the order of the relative
    change of the body, whatever its size and shape.
    """

    factor: Float[Array, "*b 4 4"]

    @classmethod
    def to(cls, nominal: Float[Array, "*b 10"]) -> "Relative":
        """The chart about nominal bodies, which must be physical (NaN otherwise)."""
        return cls(jnp.linalg.cholesky(inertia.pseudo_inertia(nominal)))

    def to_pi(self, x: Float[Array, "*b 10"]) -> Float[Array, "*b 10"]:
        p = inertia.pseudo_inertia(inertia.from_log_cholesky_uut(x))
        return inertia.from_pseudo_inertia(self.factor @ p @ jnp.swapaxes(self.factor, -1, -2))

    def from_pi(self, pi: Float[Array, "*b 10"]) -> Float[Array, "*b 10"]:
        inverse = jnp.linalg.inv(self.factor)
        p = inverse @ inertia.pseudo_inertia(pi) @ jnp.swapaxes(inverse, -1, -2)
        return inertia.to_log_cholesky_uut(inertia.from_pseudo_inertia(p))

    def jacobian(self, x: Float[Array, "*b 10"]) -> Float[Array, "*b 10 10"]:
        inner = inertia.log_cholesky_uut_jacobian(x)
        # The congruence P ↦ L P Lᵀ is linear in π: its matrix, column by column.
        columns = inertia.pseudo_inertia(jnp.eye(10, dtype=x.dtype))
        factor = self.factor[..., None, :, :]
        moved = factor @ columns @ jnp.swapaxes(factor, -1, -2)
        return jnp.swapaxes(inertia.from_pseudo_inertia(moved), -1, -2) @ inner

    def project(self, x: Float[Array, "*b 10"]) -> Float[Array, "*b 10"]:
        return _well_conditioned(x, rows=True)


def _well_conditioned(x: Float[Array, "*b 10"], *, rows: bool) -> Float[Array, "*b 10"]:
    """Keep exp finite, and the off-diagonal of U within 0.1/√ε of its diagonal.

    A wild outlier can throw x anywhere. Beyond these bounds π would still be physical in exact arithmetic, but
    rounding to ten numbers would lose it. The bounds hold masses of 1e-9 to 1e9 kg and lengths of 10 µm to 100 m.
    """
    # What follows a row of U for UUᵀ, and a column of it for UᵀU, decides how close P is to singular.
    ratio = 0.1 / jnp.sqrt(jnp.finfo(x.dtype).eps)
    a = jnp.clip(x[..., :1], -10.0, 10.0)
    d = jnp.clip(x[..., 1:4], -11.5, 4.6)
    s, t = x[..., 4:7], x[..., 7:]
    e = jnp.exp(d)
    if rows:
        s_bound = ratio * jnp.stack([e[..., 1], e[..., 2], e[..., 2]], -1)
        t_bound = jnp.minimum(ratio * jnp.ones_like(e), 1e2)
        # A long lever with little spread is what a far-away point mass is: the spread gives way.
        d = jnp.maximum(d, jnp.log(jnp.abs(jnp.clip(t, -t_bound, t_bound)) / ratio + 1e-12))
    else:
        s_bound = ratio * jnp.stack([e[..., 1], e[..., 2], e[..., 2]], -1)
        t_bound = ratio * jnp.ones_like(e)
    return jnp.concatenate(
        [a, d, jnp.clip(s, -s_bound, s_bound), jnp.clip(t, -t_bound, t_bound)], -1
    )
