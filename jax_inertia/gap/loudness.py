"""How much louder than noise, or quieter, what effects leave is, row by row.

A model may miss one joint by hundreds of times its sensors' noise and another by none. A number fitted by least
squares to residuals of unlike variance s² has the variance Σ x² s² / (Σ x²)² (White 1980, "A heteroskedasticity-
consistent covariance matrix estimator"), so what counts as noise beside an effect is s² of the rows on which it acts,
each by the effect's energy there.
"""

import dataclasses

import numpy as np
from jaxtyping import Float

from jax_inertia.gap.evidence import Evidence

# Misfit per sample from which what is left is more than noise, and has a memory of its own.
MORE = 1.2
# Sensors are often better than they are taken for; beyond this share of their noise no log is believed to be as quiet.
QUIETEST = 0.5
# Correlation from one sample to the next, at most: what is slower than that says so by its size.
REDDEST = 0.9


@dataclasses.dataclass(frozen=True)
class Loudness:
    """Variance of a sample of what is left against the noise's, memory included."""

    rows: Float[np.ndarray, " nv"]
    whole: float
    """Of all rows as one."""

    @classmethod
    def of(
        cls,
        evidence: Evidence,
        left: Float[np.ndarray, " n"],
        floor: Float[np.ndarray, " nv"],
    ) -> "Loudness":
        """Of what effects leave, against the misfit that noise leaves on each row."""
        rows = evidence.unflatten(left)
        before = np.sum(rows[1:] * rows[:-1], axis=0)
        energy = np.sum(rows**2, axis=0)
        whole = _louder(energy.sum(), before.sum(), floor.sum(), QUIETEST)
        # A row is told by fewer samples than all: none is taken for quieter than they are.
        least = min(whole, 1.0)
        own = [_louder(*x, least) for x in zip(energy, before, floor, strict=True)]
        return cls(np.array(own), whole)

    @property
    def evenly(self) -> "Loudness":
        """With no row louder than another."""
        return Loudness(np.full_like(self.rows, self.whole), self.whole)

    @property
    def even(self) -> bool:
        """Whether no row is louder than another."""
        return bool(np.ptp(self.rows) == 0.0)

    @property
    def quiet(self) -> bool:
        """Whether no row is louder than noise."""
        return bool(self.rows.max() <= MORE)

    def beside(self, energy: Float[np.ndarray, " nv"]) -> float:
        """What counts as noise beside a torque with this energy on each row."""
        return float(energy @ self.rows / max(float(energy.sum()), 1e-300))

    def counted(self, energy: Float[np.ndarray, " nv"]) -> float:
        """Energies of rows in units of what counts as noise there."""
        return float(np.sum(energy / self.rows))


def _louder(energy: float, before: float, floor: float, least: float) -> float:
    """s² (1 + ρ)/(1 − ρ): how many samples count as one where each remembers ρ of the one before."""
    noise = max(least, energy / max(floor, 1.0))
    if noise <= MORE:
        return noise
    rho = min(max(before / max(energy, 1e-300), 0.0), REDDEST)
    return noise * (1 + rho) / (1 - rho)
