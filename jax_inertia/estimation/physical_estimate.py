"""What is believed of some bodies in physical units: mass, centre of mass and π, each with its standard deviation."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jax_inertia.maths import charts, inertial_parameters
from jax_inertia.maths.spatial import matmul
from jax_inertia.text.notebook_page import has_numbers, line, table


class Estimate(eqx.Module):
    """A belief in physical units, one row for each estimated body; σ to first order."""

    pi: Float[Array, "*t bodies 10"]
    sigma_pi: Float[Array, "*t bodies 10"]
    com: Float[Array, "*t bodies 3"]
    sigma_com: Float[Array, "*t bodies 3"]

    def __repr__(self) -> str:
        lines = [f"Estimate({self._count()}; ± 95 %)"]
        lines += [f"  {mass} kg at {com} mm" for mass, com in self.rows()]
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        """For notebooks: mass and centre of mass of each body with 95 % intervals."""
        head = ("", "mass [kg]", "centre of mass [mm]")
        rows = ((f"body {k}", *row) for k, row in enumerate(self.rows()))
        return line(f"Estimate ({self._count()}; ± 95 %)") + table(head, rows)

    def _count(self) -> str:
        *batch, bodies, _ = self.pi.shape
        what = f"{bodies} bodies" if bodies > 1 else "one body"
        if not has_numbers(self.pi):
            return f"{what}, traced"
        return f"{what}, {' × '.join(map(str, batch))} samples, the last" if batch else what

    def rows(self) -> list[tuple[str, str]]:
        """Mass and centre of mass of each body, of the last sample where there are more."""
        if not has_numbers(self.pi) or 0 in self.pi.shape:
            return []
        pi, sigma, com, wide = (
            np.asarray(x).reshape(-1, *x.shape[-2:])[-1]
            for x in (self.pi, self.sigma_pi, self.com, self.sigma_com)
        )
        return [
            (
                f"{pi[k, 0]:.4g} ± {1.96 * sigma[k, 0]:.2g}",
                f"({_in_mm(com[k])}) ± ({_in_mm(1.96 * wide[k])})",
            )
            for k in range(len(pi))
        ]


def _in_mm(x: np.ndarray) -> str:
    return ", ".join(f"{1e3 * v:.1f}" for v in x)


def physical_units(
    chart: charts.Chart, mean: Float[Array, " n"], covariance: Float[Array, "..."]
) -> Estimate:
    """A Gaussian in a chart's coordinates (10 for each body) in physical units.

    `covariance` is (n, n), or (bodies, 10, 10) where only `own_blocks` were kept.

    >>> import jax.numpy as jnp
    >>> from jax_inertia.maths.charts import Linear
    >>> from jax_inertia.estimation.physical_estimate import physical_units
    >>> body = jnp.array([2.0, 0, 0, 0.2, 0.04, 0, 0, 0.04, 0, 0.01])
    >>> physical_units(Linear(), body, 0.01 * jnp.eye(10)).sigma_pi[0, :2]
    Array([0.1, 0.1], dtype=float64)
    """
    blocks = own_blocks(covariance) if covariance.ndim == 2 else covariance
    x = mean.reshape(-1, 10)
    pi, g = chart.to_pi(x), chart.jacobian(x)
    covariance = matmul(matmul(g, blocks), jnp.swapaxes(g, -1, -2))
    com = inertial_parameters.centre_of_mass(pi)
    # c = h/m: ∂c/∂m = −c/m, ∂c/∂h = 1/m.
    eye = jnp.broadcast_to(jnp.eye(3, dtype=pi.dtype), (len(x), 3, 3))
    slope = jnp.concatenate([-com[:, :, None], eye], -1) / pi[:, :1, None]
    com_covariance = matmul(matmul(slope, covariance[:, :4, :4]), jnp.swapaxes(slope, -1, -2))
    return Estimate(pi, _root_diagonal(covariance), com, _root_diagonal(com_covariance))


def own_blocks(covariance: Float[Array, "n n"]) -> Float[Array, "bodies 10 10"]:
    """Each body's own covariance, without what ties it to the others.

    >>> import jax.numpy as jnp
    >>> from jax_inertia.estimation.physical_estimate import own_blocks
    >>> own_blocks(jnp.eye(20)).shape
    (2, 10, 10)
    """
    n = len(covariance) // 10
    return covariance.reshape(n, 10, n, 10)[np.arange(n), :, np.arange(n), :]


def _root_diagonal(covariance: Float[Array, "b k k"]) -> Float[Array, "b k"]:
    return jnp.sqrt(jnp.maximum(jnp.diagonal(covariance, axis1=-2, axis2=-1), 0.0))
