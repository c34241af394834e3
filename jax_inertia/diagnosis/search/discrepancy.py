"""Slow discrepancy: what no equation says exactly errs alike for a while, so its rows are not independent samples.

One row's residual, in units of its own standard deviation, is white noise and an Ornstein–Uhlenbeck process
(Rasmussen and Williams, Gaussian Processes for Machine Learning, 2006, sec. B.2):

    C_ts = (1 − s) δ_ts / w_t + s φ^|t − s|,    φ = exp(−1/ℓ)

s: share of the variance that is slow; ℓ: rows over which it is forgotten; w: weight of a row. Both are learned by
marginal likelihood. The slow part's precision is BᵀB, B bidiagonal, so that R rows cost O(R).
"""

import dataclasses
import functools
import itertools

import numpy as np
from jaxtyping import Float
from scipy.linalg import get_lapack_funcs

SHARES = (0.0, 0.1, 0.2, 0.35, 0.5, 0.65, 0.8, 0.9, 0.96, 0.99)
"""Grid of s."""
LENGTHS = (2.0, 5.0, 12.0, 30.0, 75.0, 190.0, 500.0)
"""Grid of ℓ [rows]: from a tenth of a second to a whole log."""
UNMEASURED = 1e-3
"""Weight below which a row tells nothing."""
UNKNOWN = 1e6
"""Variance of such a row."""


@dataclasses.dataclass(frozen=True, eq=False)
class SlowNoise:
    """C of one row of the residual; `at` is a point of the grid (SHARES, LENGTHS)."""

    weight: Float[np.ndarray, " R"]
    at: tuple[int, int] = (0, 0)

    @property
    def share(self) -> float:
        """s."""
        return SHARES[self.at[0]]

    @property
    def lasting(self) -> float:
        """Share of the variance that is not forgotten within the shortest ℓ."""
        return self.share if self.at[1] else 0.0

    @property
    def forgotten(self) -> float:
        """φ."""
        return float(np.exp(-1.0 / LENGTHS[self.at[1]]))

    @property
    def repeated(self) -> float:
        """How many rows tell as much as one that is independent, of a torque that varies as the residual does.

        Σₖ c(k)² = 1 + 2 s² φ² / (1 − φ²), c the autocorrelation (Bartlett, J. R. Stat. Soc. 98(3), 1935).
        """
        square = self.forgotten**2
        return 1.0 + 2.0 * self.share**2 * square / (1.0 - square)

    @functools.cached_property
    def _live(self) -> Float[np.ndarray, " R"]:
        return 1.0 * (self.weight > UNMEASURED)

    def log_likelihood(self, values: Float[np.ndarray, " R"]) -> float:
        """Of residuals in units of their standard deviation, up to one scale of them all, nats."""
        count = max(float(self._live.sum()), 1.0)
        white = (1.0 - self.share) / np.maximum(self.weight, UNMEASURED)
        white = np.where(self._live > 0, white, UNKNOWN)
        values = values * self._live
        if not self.share:
            logdet, energy = float(np.log(white).sum()), float(np.sum(values**2 / white))
        else:
            logdet, energy = self._correlated(white, values)
        return -0.5 * (logdet + count * float(np.log(max(energy, 1e-300) / count)))

    def _correlated(self, white, values) -> tuple[float, float]:
        """ln |C| and rᵀ C⁻¹ r: of B C Bᵀ = B (white) Bᵀ + 1, which is tridiagonal."""
        phi = self.forgotten
        scale = np.full(len(white), 1.0 / np.sqrt(self.share * (1.0 - phi**2)))
        scale[0] = 1.0 / np.sqrt(self.share)
        main = scale**2 * white + 1.0
        main[1:] += (scale[1:] * phi) ** 2 * white[:-1]
        below = -phi * scale[1:] * scale[:-1] * white[:-1]
        moved = scale * values
        moved[1:] -= scale[1:] * phi * values[:-1]
        (tridiagonal,) = get_lapack_funcs(("ptsv",), (main, below, moved))
        d, _, solved, _ = tridiagonal(main, below, moved)
        return float(np.log(d).sum() - 2.0 * np.log(scale).sum()), float(moved @ solved)

    def likeliest(self, values: Float[np.ndarray, " R"]) -> "SlowNoise":
        """The one on the grid under which these residuals are the likeliest, uphill from this one."""
        best, known = self, {self.at: self.log_likelihood(values)}
        while True:
            for di, dj in itertools.product((-1, 0, 1), repeat=2):
                at = best.at[0] + di, best.at[1] + dj
                inside = 0 <= at[0] < len(SHARES) and 0 <= at[1] < len(LENGTHS)
                if inside and at not in known:
                    known[at] = SlowNoise(self.weight, at).log_likelihood(values)
            top = max(known, key=known.__getitem__)
            if top == best.at:
                return best
            best = SlowNoise(self.weight, top)

    def likelihood_at_best(self, values: Float[np.ndarray, " R"]) -> float:
        """Log likelihood of residuals under the `likeliest` of the grid, up to a constant of their number, nats."""
        size = max(float(np.sqrt(np.mean(values**2))), 1e-300)
        count = float(self._live.sum())
        unit = values / size
        return self.likeliest(unit).log_likelihood(unit) - count * float(np.log(size))
