"""The batch fit as one small nonlinear least-squares problem, and its Gaussian posterior.

Unknowns are z, standard normal a priori: the bodies' chart coordinates x = x₀ + L z, the load's π, the model's errors,
the joint terms and the log gains, each in units of their prior. Levenberg–Marquardt damps by a multiple of the
identity, so this scaling is what makes its steps few: in the chart's own units, the directions that the data do not see
crawl.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int

from jax_inertia.estimation.batch_rows import TERMS
from jax_inertia.maths.charts import Chart
from jax_inertia.maths.kalman import Belief

_MOST_STEPS = 300
# Where the data push a body towards the edge of the physical set, Gauss–Newton creeps along directions that hardly
# change the cost. What counts is the cost: ½ is one standard deviation. So the solver sees the unknowns in units of
# 10 σ, and one tolerance of 1e-4 means 1e-4 of cost but 0.001 prior σ.
_UNIT, _TOLERANCE = 0.1, 1e-4


class Problem(eqx.Module):
    """Compressed rows and priors: in units of the log, joint j's residual is triangle_j @ [w/gain, 1/gain, −1]."""

    triangles: Float[Array, "nv k k"]
    chart: Chart
    bodies: Float[Array, " n"]
    """Chart coordinates of the nominal bodies, and the Cholesky factor of their prior covariance."""
    bodies_root: Float[Array, "n n"]
    linear_sigma: Float[Array, " l"]
    """Prior σ about zero of the carried load's π, where a log carries one, then of the model's errors."""
    terms_start: Float[Array, "nv terms"]
    """What is added to the model's joint terms, prior mean and σ; σ = 0 for what is not fitted."""
    terms_sigma: Float[Array, "nv terms"]
    gain_start: Float[Array, " nv"]
    gain_sigma: Float[Array, " nv"]
    noise: Float[Array, " nv"]
    """Standard deviation of each joint's rows, in the log's own unit."""

    @property
    def sizes(self) -> tuple[int, int, int, int]:
        """Numbers of unknowns: bodies, load and errors, joint terms, gains."""
        nv = len(self.noise)
        return len(self.bodies), len(self.linear_sigma), TERMS * nv, nv


class Unknowns(eqx.Module):
    """One z in physical units; `x` are the bodies' chart coordinates."""

    x: Float[Array, " n"]
    linear: Float[Array, " l"]
    """The carried load's π, then the model's errors."""
    terms: Float[Array, "nv terms"]
    gains: Float[Array, " nv"]

    def weights(self, chart: Chart) -> Float[Array, "nv c"]:
        """w of every row: what the columns are multiplied by."""
        pi = jnp.concatenate([chart.to_pi(self.x.reshape(-1, 10)).ravel(), self.linear])
        return jnp.concatenate(
            [jnp.broadcast_to(pi, (len(self.gains), len(pi))), self.terms], axis=1
        )


def unpack(problem: Problem, z: Float[Array, " z"]) -> Unknowns:
    """What z stands for."""
    n, linear, terms, _ = problem.sizes
    z_body, z_linear, z_terms, z_gain = jnp.split(z, [n, n + linear, n + linear + terms])
    return Unknowns(
        x=problem.bodies + problem.bodies_root @ z_body,
        linear=problem.linear_sigma * z_linear,
        terms=problem.terms_start + problem.terms_sigma * z_terms.reshape(-1, TERMS),
        gains=problem.gain_start * jnp.exp(problem.gain_sigma * z_gain),
    )


class Solution(eqx.Module):
    """Maximum of the posterior, its Gaussian approximation there, and how it was reached."""

    z: Belief
    cost: Float[Array, ""]
    """½ of the sum of squares, priors included."""
    steps: Int[Array, ""]
    successful: Bool[Array, ""]


@eqx.filter_jit
def solve(problem: Problem, z: Float[Array, " z"]) -> Solution:
    """Levenberg–Marquardt (optimistix) from z."""
    # The prior's rows keep the normal equations well posed; a QR of the Jacobian is ten times slower here.
    solver = optx.LevenbergMarquardt(
        rtol=1e-8, atol=_TOLERANCE, linear_solver=lx.Normal(lx.Cholesky())
    )
    found = optx.least_squares(
        lambda y, _: _residual(y / _UNIT, problem),
        solver,
        z * _UNIT,
        max_steps=_MOST_STEPS,
        throw=False,
    )
    z = found.value / _UNIT
    residual, slope = _residual(z, problem), jax.jacfwd(_residual)(z, problem)
    triangle = jnp.asarray(jnp.linalg.qr(slope, mode="r"))
    inverse = jax.scipy.linalg.solve_triangular(triangle, jnp.eye(len(z)))
    return Solution(
        z=Belief(z, inverse @ inverse.T),
        cost=0.5 * jnp.sum(residual**2),
        steps=jnp.asarray(found.stats["num_steps"]),
        successful=found.result == optx.RESULTS.successful,
    )


def _residual(z: Float[Array, " z"], problem: Problem) -> Float[Array, " m"]:
    unknowns = unpack(problem, z)
    one = jnp.ones_like(unknowns.gains)[:, None]
    gain = unknowns.gains[:, None]
    vector = jnp.concatenate([unknowns.weights(problem.chart) / gain, one / gain, -one], axis=1)
    data = jnp.einsum("jrc,jc->jr", problem.triangles, vector)
    # Noise in the log's own unit: in torque units, shrinking the gain and the model together would shrink it too.
    return jnp.concatenate([(data / problem.noise[:, None]).ravel(), z])
