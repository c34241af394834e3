"""What is believed of some bodies in physical units: mass, centre of mass and π, each with its standard deviation."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.linalg import solve_triangular
from jaxtyping import Array, Float

from jax_inertia.maths import charts, inertial_parameters
from jax_inertia.maths.kalman_forms import cholesky
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


_STEPS = 30
"""Of Levenberg and Marquardt's method: a decision, each sample's costs the same."""
ANY_SHAPE = 3.0
"""How far a load may change the radii of gyration, log. A filter needs 1 (`Load.of_a_body`), lest its first samples
leave a body of no size. A fit of the whole log does not, and where inertias are not determined, they would tilt the
mass by it: by 0.3 % of a tool on a slender wrist."""


@eqx.filter_jit
def as_bodies(
    found: Estimate, covariance: Float[Array, "T bodies 10 10"], usual: Float[Array, "bodies 10"]
) -> Estimate:
    """The most probable bodies for each mean and covariance of a filter over π; `usual`: π of bodies with a load.

    Torque is linear in π, so a Kalman filter over π has no linearisation that could grow old, but its mean may be no
    body at all. What it knows is |L⁻¹ (π − m)|² with covariance L Lᵀ. Over the bodies π(x) of a physical chart the most
    probable one is the least of

        |L⁻¹ (π(x) − m)|² + |(x − x₁) / w|²,

    found by Levenberg and Marquardt's method; its covariance is that of the curvature there. The second term says how
    far radii of gyration may be from those of the usual body x₁: where no torque tells an inertia, it is what keeps a
    body from becoming a point.

    >>> import jax.numpy as jnp
    >>> from jax_inertia.estimation.physical_estimate import as_bodies, physical_units
    >>> from jax_inertia.maths.charts import Linear
    >>> usual = jnp.array([[1.0, 0, 0, 0, 0.01, 0, 0, 0.01, 0, 0.01]])
    >>> p = jnp.diag(jnp.full(10, 0.1).at[4:].set(1e-6))[None]
    >>> found = physical_units(Linear(), usual[0].at[0].set(-0.2), p)
    >>> one = as_bodies(jax.tree.map(lambda x: x[None], found), p[None], usual)
    >>> bool(one.pi[0, 0, 0] > 0)
    True
    """
    chart = charts.LogCholeskyUUt()
    anchor = chart.from_pi(usual)

    def one(args):
        mean, p = args
        x = jax.vmap(_most_probable)(mean, p, anchor)
        root = jax.vmap(_root)(x, mean, p, anchor)
        return physical_units(chart, x.ravel(), root @ jnp.swapaxes(root, 1, 2))

    return jax.lax.map(one, (found.pi, covariance), batch_size=64)


def _rows(
    x: Float[Array, "10"],
    mean: Float[Array, "10"],
    p: Float[Array, "10 10"],
    anchor: Float[Array, "10"],
) -> tuple[Array, Array]:
    """(J, r) of the cost |r|² and its slope −2 Jᵀ r."""
    chart, lower = charts.LogCholeskyUUt(), cholesky(p)
    six = jnp.eye(10, dtype=x.dtype)[1:7] / (ANY_SHAPE * _units(anchor))[:, None]
    j = solve_triangular(lower, chart.jacobian(x[None])[0], lower=True)
    left = solve_triangular(lower, mean - chart.to_pi(x[None])[0], lower=True)
    return jnp.concatenate([j, six]), jnp.concatenate([left, six @ (anchor - x)])


def _units(x: Float[Array, "10"]) -> Float[Array, "6"]:
    """What d and s of `LogCholeskyUUt` are measured in: logs, and the two lengths that an entry couples [m]."""
    length = jnp.exp(x[1:4])
    pairs = jnp.sqrt(length[jnp.array([0, 0, 1])] * length[jnp.array([1, 2, 2])])
    return jnp.concatenate([jnp.ones(3, x.dtype), pairs])


def _root(x: Array, mean: Array, p: Array, anchor: Array) -> Float[Array, "10 10"]:
    """A root of the covariance of x by the curvature there."""
    r = jnp.asarray(jnp.linalg.qr(_rows(x, mean, p, anchor)[0], mode="r"))
    return solve_triangular(r, jnp.eye(10, dtype=x.dtype), lower=False)


def _most_probable(mean: Array, p: Array, anchor: Array) -> Float[Array, "10"]:
    """From the mean made a body, and from the usual body: the lower end counts."""
    chart = charts.LogCholeskyUUt()

    def cost(x):
        left = _rows(x, mean, p, anchor)[1]
        value = left @ left
        return jnp.where(jnp.isfinite(value), value, jnp.inf)

    def again(_, state):
        x, best, damping = state
        j, left = _rows(x, mean, p, anchor)
        inner = j.T @ j
        inner = inner + damping * jnp.diag(jnp.diagonal(inner))
        trial = chart.project((x + jnp.linalg.solve(inner, j.T @ left))[None])[0]
        value = cost(trial)
        good = value <= best
        damping = jnp.where(good, 0.1 * damping, 10.0 * damping).clip(1e-9, 1e9)
        return jnp.where(good, trial, x), jnp.where(good, value, best), damping

    def down(x):
        start = (x, cost(x), jnp.asarray(1e-3, x.dtype))
        return jax.lax.fori_loop(0, _STEPS, again, start)[:2]

    near = chart.from_pi(inertial_parameters.as_bodies(mean[None]))[0]
    near = jnp.where(jnp.all(jnp.isfinite(near)), near, anchor)
    ends, costs = jax.vmap(down)(jnp.stack([near, anchor]))
    return ends[jnp.argmin(costs)]
