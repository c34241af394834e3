"""Slow discrepancy: what no equation says exactly errs alike for a while, so its rows are not independent samples.

One row's residual, in units of its own standard deviation, is white noise beside an Ornstein–Uhlenbeck process
(Rasmussen and Williams, Gaussian Processes for Machine Learning, 2006, sec. B.2):

    C_ts = (1 − s) δ_ts / w_t + s φ^|t − s|,    φ = exp(−1/ℓ)

s: share of the variance that is slow; ℓ: rows over which it is forgotten; w: weight of a row. Both are learned by
marginal likelihood. The slow part's precision is BᵀB, B bidiagonal, so that whitening R rows costs O(R).
"""

import dataclasses
import functools
import itertools

import numpy as np
from jaxtyping import Float
from scipy.linalg import lapack

SHARES = (0.0, 0.1, 0.2, 0.35, 0.5, 0.65, 0.8, 0.9, 0.96, 0.99)
"""Grid of s."""
LENGTHS = (2.0, 5.0, 12.0, 30.0, 75.0, 190.0, 500.0)
"""Grid of ℓ [rows]: from a tenth of a second to a whole log."""
UNMEASURED = 1e-3
"""Weight below which a row tells nothing."""
UNKNOWN = 1e6
"""Variance of such a row."""


@dataclasses.dataclass(frozen=True, eq=False)
class Whitener:
    """W with W C Wᵀ = 1, of one row of the residual; `at` is a point of the grid (SHARES, LENGTHS)."""

    weight: Float[np.ndarray, " R"]
    at: tuple[int, int] = (0, 0)

    @property
    def share(self) -> float:
        """s."""
        return SHARES[self.at[0]]

    @property
    def lagged(self) -> float:
        """Correlation of two rows beside each other."""
        return self.share * float(np.exp(-1.0 / LENGTHS[self.at[1]]))

    @functools.cached_property
    def _live(self) -> Float[np.ndarray, " R"]:
        return 1.0 * (self.weight > UNMEASURED)

    @functools.cached_property
    def _white(self) -> Float[np.ndarray, " R"]:
        """Variance of each row's white part."""
        own = (1.0 - self.share) / np.maximum(self.weight, UNMEASURED)
        return np.where(self._live > 0, own, UNKNOWN)

    @functools.cached_property
    def _factor(self):
        """φ, diagonal of B (R,), and Cholesky's factor of B C Bᵀ = B (white) Bᵀ + 1 as LAPACK's band (2, R)."""
        phi = float(np.exp(-1.0 / LENGTHS[self.at[1]]))
        scale = np.full(len(self.weight), 1.0 / np.sqrt(self.share * (1.0 - phi**2)))
        scale[0] = 1.0 / np.sqrt(self.share)
        main = scale**2 * self._white + 1.0
        main[1:] += (scale[1:] * phi) ** 2 * self._white[:-1]
        below = -phi * scale[1:] * scale[:-1] * self._white[:-1]
        d, e, _ = lapack.dpttrf(main, below)
        band = np.zeros((2, len(d)), order="F")
        band[0] = np.sqrt(d)
        band[1, :-1] = e * band[0, :-1]
        return phi, scale, band

    @property
    def log_determinant(self) -> float:
        """ln |C|."""
        if not self.share:
            return float(np.log(self._white).sum())
        _, scale, band = self._factor
        return float(2.0 * np.sum(np.log(band[0]) - np.log(scale)))

    def __call__(self, values: Float[np.ndarray, "R *k"]) -> Float[np.ndarray, "R *k"]:
        """W times columns."""
        flat = values.reshape(len(values), -1)
        if not self.share:
            return (flat * (self._live / np.sqrt(self._white))[:, None]).reshape(values.shape)
        phi, scale, band = self._factor
        moved = np.array(flat * self._live[:, None], order="F")
        moved[1:] -= phi * moved[:-1].copy()
        moved *= scale[:, None]
        out, _ = lapack.dtbtrs(band, moved, uplo="L", overwrite_b=1)
        return out.reshape(values.shape)

    def fit(self, values: Float[np.ndarray, " R"]) -> tuple[float, float]:
        """(log likelihood of residuals, their scale that is the likeliest) with C known up to that scale's square."""
        count = max(float(self._live.sum()), 1.0)
        white = self(values)
        scale = max(float(white @ white) / count, 1e-300)
        return -0.5 * (self.log_determinant + count * float(np.log(scale))), float(np.sqrt(scale))

    def likeliest(self, values: Float[np.ndarray, " R"]) -> "Whitener":
        """The one on the grid under which these residuals are the likeliest, uphill from this one."""
        best, known = self, {self.at: self.fit(values)[0]}
        while True:
            for di, dj in itertools.product((-1, 0, 1), repeat=2):
                at = best.at[0] + di, best.at[1] + dj
                inside = 0 <= at[0] < len(SHARES) and 0 <= at[1] < len(LENGTHS)
                if inside and at not in known:
                    known[at] = Whitener(self.weight, at).fit(values)[0]
            top = max(known, key=known.__getitem__)
            if top == best.at:
                return best
            best = Whitener(self.weight, top)
