"""From misfits to words: explained, partly, unknown or no gap; how sure; what ties.

`floor` is the misfit that noise alone would leave. The excess above it is the gap as far as this log can see.
"""

import enum

import numpy as np
import scipy.special

from jax_inertia.gap.select import Candidate


class Verdict(enum.StrEnum):
    """What can be said of the gap."""

    EXPLAINED = "explained"
    PARTLY = "partly"
    UNKNOWN = "unknown"
    NO_GAP = "no_gap"

    def confidence(self, misfits: list[float], floor: float) -> float:
        """How sure a verdict without effects is: by how far the misfit is from the border between the two."""
        ratio = misfits[0] / max(floor, 1.0)
        distance = np.log(ratio / NOISE_ONLY)
        side = 1.0 if self is Verdict.UNKNOWN else -1.0
        return float(1.0 / (1.0 + np.exp(-4.0 * side * distance)))


# Above this multiple of the noise's own misfit, something is there even where nothing in the library fits it.
NOISE_ONLY = 2.0
TEMPER = 0.003
EXPLAINS = 0.90
LEAVES = 3.0


def judge(misfits: list[float], floor: float, rows: int) -> Verdict:
    """The verdict for misfits after 0, 1, 2 ... effects.

    Explained: nine tenths of the excess are gone, and what is left is below three times the noise or a twentieth.
    """
    if len(misfits) == 1:
        return Verdict.UNKNOWN if misfits[0] > NOISE_ONLY * floor else Verdict.NO_GAP
    excess = max(misfits[0] - floor, 1e-300)
    left = max(misfits[-1] - floor, 0.0) / excess
    small = misfits[-1] < 1.5 * floor
    if small or (left < 1 - EXPLAINS and (misfits[-1] < LEAVES * floor or left < 0.05)):
        return Verdict.EXPLAINED
    return Verdict.PARTLY if left < 0.35 else Verdict.UNKNOWN


def ties(
    best: Candidate, ranking: list[Candidate], misfits: list[float], floor: float
) -> list[Candidate]:
    """Candidates that explain nearly as much as the best: within 15 nats of noise or 1 % of its gain."""
    noise = max(1.0, misfits[-1] / max(floor, 1.0))
    margin = max(15.0 * noise, 0.01 * best.gain)
    return [c for c in ranking if c.key != best.key and c.gain > best.gain - margin]


def probabilities(
    ranking: list[Candidate], misfits: list[float], floor: float
) -> dict[tuple[str, str, str], float]:
    """Posterior odds among all candidates at the first step.

    Tempered by a share of the best gain: a model's equations are never exact, and a likelihood that takes them
    for exact is sure of whatever comes first.
    """
    if not ranking:
        return {}
    first = ranking[0]
    # A richer family that contains the best at its place is no rival of it.
    rivals = [
        c for c in ranking if c.place != first.place or first.family.name not in c.family.simpler
    ]
    noise = max(1.0, misfits[-1] / max(floor, 1.0))
    temper = max(1.0, TEMPER * first.gain / noise)
    scores = np.array([c.score for c in rivals])
    weights = scipy.special.softmax(0.5 * (scores - scores.max()) / temper)
    return {c.key: float(w) for c, w in zip(rivals, weights, strict=True)}
