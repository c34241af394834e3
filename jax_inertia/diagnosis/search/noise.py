"""Noise of the torque residual: a variance of every row, and how much of it is slow."""

import dataclasses

import numpy as np
from jaxtyping import Float

from jax_inertia.diagnosis.search.discrepancy import UNMEASURED, Whitener


@dataclasses.dataclass(frozen=True, eq=False)
class Noise:
    """V: variance of every row of the residual, and what is slow of it."""

    variance: Float[np.ndarray, "R n"]
    whiteners: tuple[Whitener, ...]

    def whitened(
        self, values: Float[np.ndarray, "R *n k"], row: int | None
    ) -> Float[np.ndarray, "R *n k"]:
        """V^(−1/2) times columns of one row (R, k), or of all (R, n, k)."""
        if row is not None:
            return self.whiteners[row](values / np.sqrt(self.variance[:, row, None]))
        out = np.empty_like(values)
        for j, whiten in enumerate(self.whiteners):
            out[:, j] = whiten(values[:, j] / np.sqrt(self.variance[:, j, None]))
        return out

    def residual(self, y: Float[np.ndarray, "R n"]) -> Float[np.ndarray, "R n"]:
        """V^(−1/2) y."""
        return self.whitened(y[:, :, None], None)[:, :, 0]

    @property
    def log_determinant(self) -> float:
        """ln |V| over rows that are measured."""
        return sum(
            w.log_determinant + float(np.log(v[w.weight > UNMEASURED]).sum())
            for w, v in zip(self.whiteners, self.variance.T, strict=True)
        )
