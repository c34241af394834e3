"""Small convex quadratic programs in a fixed number of interior-point iterations.

    min ½ xᵀ P x + qᵀ x + ½ Σ e_i² / δ_i     over x and e     subject to     l ≤ C x − e ≤ u

Mehrotra's predictor-corrector method (1992) on the primal-dual conditions. Rows with softness δ_i = 0 are hard; others
may be exceeded at a quadratic price, which costs nothing here: stationarity in e gives e = δ y, so that softness only
joins the diagonal of the dual block. Bounds are rows of C; a side that is not there is ±∞.

Branch-free, of fixed cost, so that it can be jitted, vmapped and scanned. In float32 some seven digits of scale are
all there is: state x in units in which the solution is of order one.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.scipy.linalg import cho_solve
from jaxtyping import Array, Bool, Float

_TO_BOUNDARY = 0.995


class Program(eqx.Module):
    """min ½ xᵀ P x + qᵀ x subject to l ≤ C x ≤ u, rows softened by `softness`; P positive semidefinite."""

    p: Float[Array, "*b n n"]
    q: Float[Array, "*b n"]
    c: Float[Array, "*b m n"]
    lower: Float[Array, "*b m"]
    upper: Float[Array, "*b m"]
    softness: Float[Array, "*b m"]
    """δ: what a row gives way per unit of its multiplier; 0 is hard."""


class Solution(eqx.Module):
    """x, the rows' multipliers y (positive where `upper` holds it back), and how well the conditions are met."""

    x: Float[Array, " n"]
    y: Float[Array, " m"]
    residual: Float[Array, ""]
    """Largest of the relative errors of stationarity, feasibility and complementarity; NaN never, ∞ on failure."""
    converged: Bool[Array, ""]


class _Iterate(eqx.Module):
    x: Float[Array, " n"]
    s: Float[Array, "2 m"]  # distance to the lower and the upper side
    z: Float[Array, "2 m"]  # their multipliers


def solve(program: Program, *, iterations: int = 10, tolerance: float | None = None) -> Solution:
    """The minimiser after `iterations` of Mehrotra's method, and whether its residual is below `tolerance`.

    The tolerance is relative (default: 1e-6 in float64, 1e-3 in float32). An infeasible or unbounded program comes
    back as not converged, with the best iterate found.
    """
    dtype = program.p.dtype
    if tolerance is None:
        tolerance = 1e-6 if jnp.finfo(dtype).bits >= 64 else 1e-3
    scaled, row, size = _scaled(program)
    present = jnp.isfinite(jnp.stack([scaled.lower, scaled.upper]))
    start = _start(scaled, present)
    error = _relative_error(scaled, present, start)

    def step(carry: tuple[_Iterate, _Iterate, Array], _) -> tuple[tuple, None]:
        state, best, least = carry
        new = _iterate(scaled, present, state)
        finite = jnp.array([jnp.all(jnp.isfinite(leaf)) for leaf in jax.tree.leaves(new)]).all()
        new = jax.tree.map(lambda a, b: jnp.where(finite, a, b), new, state)
        error = _relative_error(scaled, present, new)
        # Past what rounding allows, further steps only lose digits.
        better = error < least
        best = jax.tree.map(lambda a, b: jnp.where(better, a, b), new, best)
        return (new, best, jnp.minimum(error, least)), None

    first = jnp.where(jnp.isfinite(error), error, jnp.inf)
    (_, best, residual), _ = jax.lax.scan(step, (start, start, first), None, length=iterations)
    y = (best.z[1] - best.z[0]) * row * size
    return Solution(best.x, y, residual, residual <= tolerance)


def _scaled(program: Program) -> tuple[Program, Float[Array, " m"], Float[Array, ""]]:
    """Rows of C of unit length and a cost of order one, so that 1 is a fair first guess of every multiplier."""
    tiny = jnp.finfo(program.p.dtype).tiny ** 0.5
    norm = jnp.sqrt(jnp.sum(program.c**2, axis=1))
    row = 1.0 / jnp.where(norm > tiny, norm, 1.0)
    largest = jnp.maximum(jnp.max(jnp.abs(program.p)), jnp.max(jnp.abs(program.q)))
    size = jnp.where(largest > tiny, largest, 1.0)
    scaled = Program(
        program.p / size,
        program.q / size,
        program.c * row[:, None],
        program.lower * row,
        program.upper * row,
        program.softness * row**2 * size,
    )
    return scaled, row, size


def _start(p: Program, present: Bool[Array, "2 m"]) -> _Iterate:
    """The minimiser with a unit spring to each row's middle (or to its only side), then sides made positive."""
    low = jnp.where(present[0], p.lower, p.upper)
    high = jnp.where(present[1], p.upper, p.lower)
    some = present.any(axis=0)
    middle = jnp.where(some, 0.5 * (low + high), 0.0)
    weight = some.astype(p.p.dtype) / (1.0 + p.softness)
    k = p.p + (p.c.T * weight) @ p.c
    factor, scale = _factor(k)
    x = _back(factor, scale, (p.c.T * weight) @ middle - p.q)
    reach = p.c @ x
    y = weight * (reach - middle)
    s = jnp.stack([reach - p.lower, p.upper - reach])
    z = jnp.stack([-y, y])
    s, z = (jnp.where(present, value, 1.0) for value in (s, z))
    s = s + jnp.maximum(-1.5 * jnp.min(s), 0.0)
    z = z + jnp.maximum(-1.5 * jnp.min(z), 0.0)
    dot = jnp.sum(jnp.where(present, s * z, 0.0))
    count = jnp.maximum(present.sum(), 1)
    floor = 1e-3
    s_shift = 0.5 * dot / jnp.maximum(jnp.sum(jnp.where(present, z, 0.0)), floor * count)
    z_shift = 0.5 * dot / jnp.maximum(jnp.sum(jnp.where(present, s, 0.0)), floor * count)
    s = jnp.maximum(s + s_shift, floor)
    z = jnp.maximum(z + z_shift, floor)
    return _Iterate(x, jnp.where(present, s, 1.0), jnp.where(present, z, 0.0))


def _iterate(p: Program, present: Bool[Array, "2 m"], state: _Iterate) -> _Iterate:
    """One predictor-corrector step; both solves share one factorisation of P + Cᵀ W C."""
    s, z = state.s, state.z
    sign = jnp.array([[1.0], [-1.0]], p.p.dtype)
    dual, primal = _residuals(p, present, state)
    ratio = z / s
    d = ratio.sum(axis=0)
    give = 1.0 + d * p.softness
    factor, scale = _factor(p.p + (p.c.T * (d / give)) @ p.c)
    count = jnp.maximum(present.sum(), 1)

    def direction(complement: Float[Array, "2 m"]) -> _Iterate:
        # Δz = (r − z Δs)/s and Δs = ±(C Δx − δ Δy) + r_p, solved for Δy = Δz_u − Δz_l.
        pull = (complement - z * primal) / s
        k = (pull[1] - pull[0]) / give
        dx = _back(factor, scale, -dual - p.c.T @ k)
        moved = p.c @ dx
        dy = k + d / give * moved
        ds = jnp.where(present, sign * (moved - p.softness * dy) + primal, 0.0)
        dz = jnp.where(present, (complement - z * ds) / s, 0.0)
        return _Iterate(dx, ds, dz)

    mu = jnp.sum(s * z) / count
    affine = direction(-s * z)
    alpha = _longest(state, affine)
    after = jnp.sum((s + alpha * affine.s) * (z + alpha * affine.z)) / count
    centre = (jnp.maximum(after, 0.0) / jnp.maximum(mu, jnp.finfo(mu.dtype).tiny)) ** 3 * mu
    step = direction(jnp.where(present, centre - s * z - affine.s * affine.z, 0.0))
    alpha = jnp.minimum(_TO_BOUNDARY * _longest(state, step), 1.0)
    # Rounding must not put a side on its boundary, from where no step leads away.
    smallest = jnp.finfo(mu.dtype).eps ** 2
    return _Iterate(
        state.x + alpha * step.x,
        jnp.maximum(s + alpha * step.s, smallest),
        jnp.where(present, jnp.maximum(z + alpha * step.z, smallest), 0.0),
    )


def _residuals(
    p: Program, present: Bool[Array, "2 m"], state: _Iterate
) -> tuple[Float[Array, " n"], Float[Array, "2 m"]]:
    y = state.z[1] - state.z[0]
    dual = p.p @ state.x + p.q + p.c.T @ y
    reach = p.c @ state.x - p.softness * y
    primal = jnp.stack([reach - p.lower, p.upper - reach]) - state.s
    return dual, jnp.where(present, primal, 0.0)


def _relative_error(p: Program, present: Bool[Array, "2 m"], state: _Iterate) -> Float[Array, ""]:
    dual, primal = _residuals(p, present, state)
    # A side that rounding keeps apart from `s` by less than its size is met.
    gap = jnp.max(jnp.where(present, state.s * state.z, 0.0), initial=0.0)
    scale = 1.0 + jnp.max(jnp.abs(state.x))
    cost = 1.0 + jnp.max(jnp.abs(p.p @ state.x))
    errors = [jnp.max(jnp.abs(dual)) / cost, jnp.max(jnp.abs(primal), initial=0.0) / scale]
    return jnp.max(jnp.stack([*errors, gap / (scale * cost)]))


def _longest(state: _Iterate, step: _Iterate) -> Float[Array, ""]:
    """The largest step, at most 1/0.995, that keeps sides and multipliers positive."""
    value = jnp.concatenate([state.s.ravel(), state.z.ravel()])
    change = jnp.concatenate([step.s.ravel(), step.z.ravel()])
    limit = jnp.where(change < 0, -value / jnp.where(change < 0, change, 1.0), jnp.inf)
    return jnp.minimum(jnp.min(limit), 1.0 / _TO_BOUNDARY)


def _factor(k: Float[Array, "n n"]) -> tuple[Float[Array, "n n"], Float[Array, " n"]]:
    """Cholesky factor after scaling the diagonal to one: entries of P + Cᵀ W C spread over ten decades."""
    diagonal: Array = jnp.diagonal(k)
    scale = jax.lax.rsqrt(jnp.maximum(diagonal, jnp.finfo(k.dtype).tiny ** 0.5))
    unit = k * scale[:, None] * scale[None, :]
    jitter = 4.0 * jnp.finfo(k.dtype).eps
    return jnp.linalg.cholesky(unit + jitter * jnp.eye(len(k), dtype=k.dtype)), scale


def _back(
    factor: Float[Array, "n n"], scale: Float[Array, " n"], b: Float[Array, " n"]
) -> Float[Array, " n"]:
    return scale * cho_solve((factor, True), scale * b)
