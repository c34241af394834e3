"""The charged least-squares problem that every candidate is judged in.

All columns are finished, whitened and flattened to n rows. With the nuisances' prior charged, sums of squares are
taken in the metric M = (1 + N Nᵀ)⁻¹: J(θ) = (y − A θ)ᵀ M (y − A θ). `Evidence` applies M^{1/2} once to everything,
so that from then on it is ordinary least squares.
"""

import numpy as np
import scipy.linalg
from jaxtyping import Float

from jax_inertia.gap.chain import Prepared
from jax_inertia.gap.families.base import Columns
from jax_inertia.gap.noise import ORDER, Whitener


class Evidence:
    """Whitened missing torque of one log, with the nuisances integrated out."""

    def __init__(self, prepared: Prepared, whitener: Whitener, nuisance: list[Columns]):
        self.prepared = prepared
        self.whitener = whitener
        self.used = prepared.valid.copy()
        self.used[:ORDER] = False
        self.raw = self._whiten(Columns(prepared.missing[:, :, None]))
        n = np.concatenate([self._whiten(block) for block in nuisance], axis=1)
        # 1 + N Nᵀ = (in the span of N) 1 + s²: M^{1/2} scales each left singular vector by (1 + s²)^{-1/2}.
        gram = n.T @ n
        values, vectors = scipy.linalg.eigh(gram)
        kept = values > 1e-12 * max(values[-1], 1e-300)
        values, vectors = values[kept], vectors[:, kept]
        self._left = n @ (vectors / np.sqrt(values))
        self._shrink = 1.0 - 1.0 / np.sqrt(1.0 + values)
        self.y = self.charge(self.raw)[:, 0]

    @property
    def rows(self) -> int:
        """Number of whitened samples used."""
        return int(self.used.sum())

    def charge(self, x: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "n k"]:
        """M^{1/2} x."""
        return x - self._left @ (self._shrink[:, None] * (self._left.T @ x))

    def column(self, columns: Columns) -> Float[np.ndarray, "n k"]:
        """A candidate's columns in the charged metric."""
        return self.charge(self._whiten(columns))

    def noise_energy(self, noise: Float[np.ndarray, "R nv"]) -> float:
        """Charged misfit of a replica of the noise, finished but not whitened."""
        white = (self.whitener(noise) * self.used).reshape(-1, 1)
        return float(np.sum(self.charge(white) ** 2))

    def unflatten(self, x: Float[np.ndarray, " n"]) -> Float[np.ndarray, "R nv"]:
        """Whitened samples back on their rows; zero where not used."""
        return x.reshape(self.used.shape)

    def _whiten(self, columns: Columns) -> Float[np.ndarray, "n k"]:
        row = columns.row
        finished = self.prepared.finish_torque(columns.values, row)
        white = self.whitener(finished) if row is None else self.whitener.one_row(finished, row)
        white = white * self.used[:, :, None]
        return white.reshape(-1, white.shape[-1])
