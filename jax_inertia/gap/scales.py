"""How far off the nominal model's numbers are, kind by kind, learned from the log.

A tolerance of 5 % on every damping says that a joint which is 14 % off is not very remarkable. Where the other joints
turn out to be right to a thousandth it is, and where all of them are off by as much it is not. So each kind's scale λ
maximises the marginal likelihood beside the effects under test (empirical Bayes, MacKay 1992),

    −2 ln p(y | λ) = min over θ of (y − A θ)ᵀ (1 + N Λ² Nᵀ)⁻¹ (y − A θ) + ln det(1 + N Λ² Nᵀ)

and an effect that competes with a tolerance is judged by how much more likely it makes the log, each with the scales
that suit it best.
"""

import dataclasses

import numpy as np
import scipy.linalg
from jaxtyping import Float

from jax_inertia.gap.evidence import Evidence

# Beyond twice what it states, a model is not "slightly off"; below a thirtieth, other errors than its numbers show.
GRID = (2.0, 1.4, 1.0, 0.7, 0.5, 0.35, 0.25, 0.12, 0.06, 0.03)


@dataclasses.dataclass(frozen=True)
class Learned:
    """The scales that make a log likeliest, and −2 ln p(y) with them."""

    scales: dict[str, float]
    cost: float


class Learner:
    """The tolerances of one log, their products taken once."""

    def __init__(self, evidence: Evidence, noise: float, most: float = GRID[0]):
        """`most`: the largest scale there may be."""
        self._evidence, self._noise = evidence, noise
        self._grid = [x for x in GRID if x <= most]
        self._gram = evidence.gram / noise

    def beside(self, columns: Float[np.ndarray, "n s"], target: Float[np.ndarray, " n"]) -> Learned:
        """Scales where effects with these columns are free to explain the target, both as `Evidence` charged them."""
        back = self._evidence.without_tolerances
        a, t = back(columns), back(target[:, None])
        at = np.concatenate([a, t], axis=1)
        products, across = at.T @ at / self._noise, self._evidence.tolerances.T @ at / self._noise

        def cost(scales: np.ndarray) -> float:
            s = scales[self._evidence.kind_of]
            k = np.eye(len(s)) + s[:, None] * self._gram * s
            factor = scipy.linalg.cholesky(k, lower=True)
            half = scipy.linalg.solve_triangular(factor, s[:, None] * across, lower=True)
            left = products - half.T @ half
            own, with_y = left[:-1, :-1], left[:-1, -1]
            fitted = with_y @ np.linalg.lstsq(own, with_y, rcond=None)[0] if len(own) else 0.0
            return float(left[-1, -1] - fitted + 2 * np.sum(np.log(np.diagonal(factor))))

        scales = np.array([self._evidence.scales[k] for k in self._evidence.kinds])
        best = cost(scales)
        for _ in range(4):
            before = best
            for i in range(len(scales)):
                for x in self._grid:
                    trial = scales.copy()
                    trial[i] = x
                    if (value := cost(trial)) < best:
                        scales, best = trial, value
            if before - best < 0.1:
                break
        return Learned(dict(zip(self._evidence.kinds, scales.tolist(), strict=True)), best)
