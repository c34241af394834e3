"""A candidate's nonlinear numbers between the points of its grid.

Where the torque bends with them (a dead zone, a presliding displacement) one number after the other is searched; where
it is smooth, all together by least squares with θ solved for at each step (variable projection; Golub and Pereyra
1973), which takes a quarter of the columns.
"""

from collections.abc import Callable

import numpy as np
import scipy.optimize
from jaxtyping import Float

from jax_inertia.diagnosis.effects.base import Shape
from jax_inertia.diagnosis.features.context import Context
from jax_inertia.gap.block import Beside, Block
from jax_inertia.gap.candidate import Candidate, fit

# How often the numbers are searched again from where they came to, at most.
TURNS = 6
# They have settled when a turn brings less than this share of what the effect explains.
SETTLED = 1e-4


def refine(
    context: Context,
    block_of: Callable[[Shape], Block],
    candidate: Candidate,
    left: Beside,
) -> Candidate:
    """The same candidate with its shape where it explains most."""
    best = candidate
    family, place = candidate.family, candidate.place

    def tried(shape: Shape) -> Candidate | None:
        nonlocal best
        fitted = fit(context, family, place, block_of(shape), left)
        if fitted is not None and fitted.aim > best.aim:
            fitted.grid = best.grid
            best = fitted
        return fitted

    for _ in range(TURNS):
        before = best.aim
        if family.smooth:
            _together(tried, best, left, family.around(context, place, best.shape))
        else:
            for axis in range(len(best.shape)):
                _along(tried, axis, best.shape, family.around(context, place, best.shape))
        if best.aim - before < max(best.noise(left.loudness), SETTLED * best.aim):
            break
    return best


def _along(
    tried: Callable[[Shape], Candidate | None],
    axis: int,
    shape: Shape,
    bounds: list[tuple[float, float]],
) -> None:
    """Search one number within its bounds."""

    def cost(x: float) -> float:
        fitted = tried((*shape[:axis], float(x), *shape[axis + 1 :]))
        return 0.0 if fitted is None else -fitted.aim

    low, high = bounds[axis]
    if low < high:
        scipy.optimize.minimize_scalar(
            cost, bounds=(low, high), method="bounded", options={"maxiter": 10}
        )


def _together(
    tried: Callable[[Shape], Candidate | None],
    candidate: Candidate,
    left: Beside,
    bounds: list[tuple[float, float]],
) -> None:
    """Search all numbers within their bounds, from where they are."""
    low, high = np.array(bounds).T
    known = candidate.tightness
    nothing = np.concatenate([left.target, np.zeros(0 if known is None else len(known))])

    def missing(x: Float[np.ndarray, " s"]) -> Float[np.ndarray, " n"]:
        fitted = tried(tuple((low + (x - 1.0) * (high - low)).tolist()))
        if fitted is None:
            return nothing
        rest = left.target - left.free(fitted.effect[:, None])[:, 0]
        if known is None:
            return rest
        prior = np.sqrt(fitted.noise(left.loudness)) * known
        return np.concatenate([rest, prior * fitted.theta])

    # Numbers from one to two: the step of a difference is relative.
    start = np.clip(1.0 + (np.array(candidate.shape) - low) / (high - low), 1.0, 2.0)
    scipy.optimize.least_squares(
        missing, start, bounds=(1.0, 2.0), diff_step=1e-3, ftol=SETTLED, xtol=1e-3, max_nfev=8
    )
