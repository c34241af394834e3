"""95 % intervals of what was found: the noise's own, widened by what the effects leave unexplained.

All numbers of all effects, nonlinear ones included, are linearised together about the fit. The noise alone gives
Σ = (AᵀA)⁻¹. An equation that errs by a share f of its effect e does so in the motion's few modes m, and adds
(AᵀA)⁻¹ f² ‖e‖² / m. What is left is correlated over time, so the spread of the fit over the log with one stretch after
the other left out (the delete-a-group jackknife of Kott 2001) is taken where it is wider.
"""

import numpy as np
import scipy.stats
from jaxtyping import Float

from jax_inertia.diagnosis.effects.base import Interval, Parameter
from jax_inertia.gap.candidate import Candidate
from jax_inertia.gap.pool import Pool

GROUPS = 10


def intervals(pool: Pool, chosen: list[Candidate], inflation: float) -> list[dict[str, Interval]]:
    """Of each chosen effect, in order; `inflation` is what is left of the misfit over what noise would leave."""
    blocks = [
        np.concatenate([c.columns, *(_shape_slope(pool, c, k) for k in range(len(c.shape)))], 1)
        for c in chosen
    ]
    if not blocks:
        return []
    a = np.concatenate(blocks, axis=1)
    residual = pool.evidence.y - sum(c.effect for c in chosen)
    # An effect that stands for a number of the model is as uncertain as that number.
    inexact = pool.evidence.unpinned().recharging(pool.evidence)
    noise = max(1.0, inflation)
    before = np.sqrt(noise) * _before_data(chosen, blocks)
    covariance = _noise(np.concatenate([inexact(a), before]))
    spread = _jackknife(pool, a, residual, before)
    out, start = [], 0
    for c, block in zip(chosen, blocks, strict=True):
        part = slice(start, start + block.shape[1])
        start = part.stop
        erring = c.excuses(c.effect) / pool.evidence.slow_modes
        own = covariance[part, part] * (noise + erring)
        out.append(_reported(pool, c, own, spread[part, part]))
    return out


def _noise(a: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "k k"]:
    """(AᵀA)⁻¹; zero for numbers that are details of the fit (a presliding length) and have no column."""
    scale = np.linalg.norm(a, axis=0)
    inverse = np.divide(1.0, scale, out=np.zeros_like(scale), where=scale > 0)
    unit = (a * inverse).T @ (a * inverse)
    return np.linalg.pinv(unit, rcond=1e-10) * inverse[:, None] * inverse[None, :]


def _before_data(chosen: list[Candidate], blocks: list[np.ndarray]) -> Float[np.ndarray, "s k"]:
    """What is known of the numbers without any log, as rows of observations."""
    rows = [np.zeros(b.shape[1]) for b in blocks]
    for row, c in zip(rows, chosen, strict=True):
        if c.tightness is not None:
            row[: len(c.theta)] = c.tightness
    return np.diag(np.concatenate(rows))


def _jackknife(
    pool: Pool,
    a: Float[np.ndarray, "n k"],
    residual: Float[np.ndarray, " n"],
    before: Float[np.ndarray, "s k"],
) -> Float[np.ndarray, "k k"]:
    """Covariance of the fit from its values with each tenth of the log left out in turn."""
    group = pool.evidence.part(GROUPS)
    fits = []
    for g in range(GROUPS):
        kept = group != g
        inverse = _noise(np.concatenate([a[kept], before]))
        fits.append(inverse @ (a[kept].T @ residual[kept]))
    away = np.array(fits) - np.mean(fits, axis=0)
    return (GROUPS - 1) / GROUPS * away.T @ away


def _reported(
    pool: Pool, c: Candidate, noise: np.ndarray, spread: np.ndarray
) -> dict[str, Interval]:
    """From θ and shape to the numbers reported, by the delta method."""
    point, n = np.concatenate([c.theta, c.shape]), len(c.theta)

    def values(x: np.ndarray) -> dict[str, Parameter]:
        return c.family.reported(pool.context, c.place, tuple(x[n:]), x[:n])

    base = values(point)
    jacobian = {name: np.zeros(len(point)) for name in base}
    for k in range(len(point)):
        h = np.zeros(len(point))
        h[k] = 1e-4 * max(abs(point[k]), np.sqrt(noise[k, k]), 1e-9)
        up, down = values(point + h), values(point - h)
        for name in base:
            jacobian[name][k] = (up[name].value - down[name].value) / (2 * h[k])
    wide = float(scipy.stats.t.ppf(0.975, GROUPS - 1))
    out = {}
    for name, parameter in base.items():
        slope = jacobian[name]
        sizes = [np.sqrt(max(slope @ s @ slope, 0.0)) for s in (noise, spread)]
        half = float(max(1.96 * sizes[0], wide * sizes[1]))
        value = float(parameter.value)
        low = max(value - half, min(float(parameter.least), value))
        out[name] = Interval(value, low, value + half, parameter.unit, parameter.factor)
    return out


def _shape_slope(pool: Pool, c: Candidate, axis: int) -> Float[np.ndarray, "n 1"]:
    """∂e/∂shape in the charged metric; zero for details of the fit."""
    free = c.family.free_shape
    counts = axis < (len(c.shape) if free is None else free)
    if not counts:
        return np.zeros((len(pool.evidence.y), 1))
    h = 1e-3 * max(abs(c.shape[axis]), 1e-6)

    def effect(x: float) -> np.ndarray:
        shape = (*c.shape[:axis], x, *c.shape[axis + 1 :])
        weights = c.family.weights(pool.context, c.place, c.theta)
        return pool.evidence.column(c.family.columns(pool.context, c.place, shape)) @ weights

    slope = (effect(c.shape[axis] + h) - effect(c.shape[axis] - h)) / (2 * h)
    return slope[:, None]
