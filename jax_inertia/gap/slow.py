"""What is missing at the motion's own few frequencies, row by row: summed over all, noise hides it.

Whitened noise has one unit in each of the d numbers that a row has there. That a row with r times as much is noise has
odds of which d (r − 1 − ln r) is twice the logarithm.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from jax_inertia.gap.evidence import Evidence
from jax_inertia.gap.noise import NOISE_ERROR, known_to
from jax_inertia.text.words import percent

Rows = Float[np.ndarray, " nv"]

# Twice the log of the odds that a row is louder than noise, as an effect must bring them.
LOUDER = 30.0


@dataclasses.dataclass(frozen=True)
class Missed:
    """What effects leave there that is no noise."""

    share: float
    """Of what there was without them."""
    row: int
    """Where the most of it is."""
    hertz: float
    """The band's end."""

    def at(self, label: str) -> str:
        """In words, with the row's name."""
        return (
            f"of what is missing {percent(self.share)} is left below {self.hertz:.1f} Hz, most of it at {label}: "
            "more than noise leaves where the motion is, though no more than it leaves in all"
        )


@dataclasses.dataclass(frozen=True)
class Slow:
    """The noise in the motion's own band."""

    evidence: Evidence
    noise: Rows
    """Energy of the sensors' noise."""
    slack: float
    """By how much more may be noise, where that is not well known."""

    @classmethod
    def of(cls, evidence: Evidence, replicas: Float[np.ndarray, "K R nv"], known: bool) -> "Slow":
        """By draws of the sensors' noise in the finished missing torque; `known` as of `known_to`."""
        draws = [_energies(evidence, evidence.charged(x)) for x in replicas]
        return cls(evidence, np.mean(draws, axis=0), known_to(known) / NOISE_ERROR)

    @property
    def bare(self) -> float:
        """How far the missing torque stands out, effects or not: above one, it is no noise."""
        return self._stands_out(_energies(self.evidence, self.evidence.y))

    def missed(
        self, left: Float[np.ndarray, " n"], errors: Sequence[Float[np.ndarray, " n"]]
    ) -> Missed | None:
        """What effects leave beyond the noise and the `errors` of their own equations; None where no row stands out."""
        allowed = [_energies(self.evidence, error) for error in errors]
        after = _energies(self.evidence, left) - np.sum(allowed, axis=0)
        if self._stands_out(after) <= 1.0:
            return None
        before = self._excess(_energies(self.evidence, self.evidence.y))
        excess = self._excess(after)
        share = float(excess.sum() / max(before.sum(), 1e-300))
        return Missed(min(share, 1.0), int(np.argmax(excess)), self.evidence.slow_band)

    def _excess(self, energies: Rows) -> Rows:
        """Of each row, beyond its noise."""
        return np.where(self.noise > 0, np.maximum(energies - self.slack * self.noise, 0.0), 0.0)

    def _stands_out(self, energies: Rows) -> float:
        """Of the loudest row, against the border above which it is no noise."""
        seen = self.noise > 0
        noise = self.noise[seen]
        louder = np.maximum(energies[seen] / (self.slack * noise), 1.0)
        odds = float(np.max(noise * (louder - 1 - np.log(louder)), initial=0.0))
        return odds / (LOUDER + 2 * np.log(len(self.noise)))


def _energies(evidence: Evidence, x: Float[np.ndarray, " n"]) -> Rows:
    """Of whitened samples, row by row."""
    slow = evidence.slow(x[:, None]).reshape(evidence.slow_modes, -1)
    return np.sum(slow**2, axis=0)
