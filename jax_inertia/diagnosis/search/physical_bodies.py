"""The posterior mode among bodies that can exist: what a log leaves open about a body must not make it impossible."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy import linalg, optimize

from jax_inertia.diagnosis.effects.tolerances import InertialTolerances, inertial_changes
from jax_inertia.diagnosis.hypothesis import Hypothesis
from jax_inertia.diagnosis.residual import Residual
from jax_inertia.diagnosis.search.evidence import Posterior
from jax_inertia.maths.inertial_parameters import from_pseudo_inertia, is_physical, pseudo_inertia

LEAST = 0.02
"""Share of the nominal pseudo-inertia that every body keeps: the optimum lies on the edge, where a body is flat."""
_LOWER = np.tril_indices(4)


def bodies_of(
    residual: Residual, now: Posterior
) -> tuple[Float[np.ndarray, "b 10"], dict[str, int]]:
    """π of each body with mass, without the errors that the log says it has, and the rows by the bodies' names."""
    base = _tolerances(now)
    if base is None:
        return np.zeros((0, 10)), {}
    changes = inertial_changes(residual.context, base.shape)
    errors = now.of(base)[0][: 10 * len(changes)].reshape(-1, 10)
    # The tolerances' torque is what the model needs too much: the body is lighter by it.
    pi = [pi - change @ e for (change, _, pi), e in zip(changes, errors, strict=True)]
    return np.array(pi).reshape(-1, 10), {name: k for k, (_, name, _) in enumerate(changes)}


def with_physical_bodies(residual: Residual, now: Posterior) -> Posterior:
    """The posterior with its mean where it is likeliest among bodies that can exist.

        min (z − z̄)ᵀ S⁻¹ (z − z̄)   over   P(z) = ε P₀ + L Lᵀ of every body

    z: errors of the bodies' numbers, z̄ and S their mean and covariance given the log; P: pseudo-inertia, positive
    definite where a body can exist (Wensing, Kim and Slotine, IEEE RA-L 3(1), 2018), P₀ the nominal one, ε = `LEAST`.
    All other numbers follow by their covariance with z, so that the torque stays what the log says. A body that is none
    in the model as given stays as it is there.
    """
    base = _tolerances(now)
    bodies, _ = bodies_of(residual, now)
    if base is None or bool(np.all(is_physical(jnp.asarray(bodies)))):
        return now
    changes = inertial_changes(residual.context, base.shape)
    at = np.arange(now.slices[now.chosen.index(base)].start, len(now.mean))[: 10 * len(changes)]
    factor = linalg.cholesky(now.covariance[np.ix_(at, at)], lower=True)
    found = now.mean[at]
    scale = base.scale[: len(at)].reshape(-1, 10)
    nominal = np.array([pi for _, _, pi in changes])
    bends = np.asarray(is_physical(jnp.asarray(nominal)))
    # z of π, body by body: π = π₀ − C s z.
    inverse = [-np.linalg.inv(change * s) for (change, _, _), s in zip(changes, scale, strict=True)]
    spread = np.asarray(pseudo_inertia(jnp.asarray(nominal)))
    start = np.array([np.linalg.cholesky((1.0 - LEAST) * p)[_LOWER] for p in spread[bends]])

    def numbers(u):
        lower = np.zeros((len(start), 4, 4))
        lower[:, *_LOWER] = u.reshape(-1, 10)
        pi = np.asarray(from_pseudo_inertia(lower @ np.swapaxes(lower, 1, 2)))
        z = np.zeros((len(changes), 10))
        for k, own in zip(np.flatnonzero(bends), pi, strict=True):
            z[k] = inverse[k] @ (own - (1.0 - LEAST) * nominal[k])
        return z.ravel()

    def misfit(u):
        return linalg.solve_triangular(factor, numbers(u) - found, lower=True)

    def slope(u):
        lower = np.zeros((len(start), 4, 4))
        lower[:, *_LOWER] = u.reshape(-1, 10)
        out = np.zeros((10 * len(changes), u.size))
        for j, k in enumerate(np.flatnonzero(bends)):
            turned = np.zeros((10, 4, 4))
            turned[np.arange(10), *_LOWER] = 1.0
            half = turned @ lower[j].T
            change = np.asarray(from_pseudo_inertia(half + np.swapaxes(half, 1, 2)))
            out[10 * k : 10 * k + 10, 10 * j : 10 * j + 10] = inverse[k] @ change.T
        return linalg.solve_triangular(factor, out, lower=True)

    solved = optimize.least_squares(misfit, start.ravel(), slope, x_scale="jac", max_nfev=200)
    return now.given(at, numbers(solved.x))


def _tolerances(now: Posterior) -> Hypothesis | None:
    return next((h for h in now.chosen if isinstance(h.effect, InertialTolerances)), None)
