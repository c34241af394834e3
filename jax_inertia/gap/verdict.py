"""From misfits to words: explained, partly, unknown or no gap; how sure; what ties.

`floor` is the misfit that noise alone would leave. The excess above it is the gap as far as this log can see.
"""

import dataclasses
import enum

import numpy as np
import scipy.special

from jax_inertia.gap.candidate import Candidate
from jax_inertia.gap.noise import NOISE_ERROR


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
# Where the log does not state its noise, a command may have missed its motor by more than the log can show.
NOISE_UNSTATED = 4.0
# A cause that leaves more than this (rms) of what it should explain is not the cause.
DOUBT = 0.2


def judge(misfits: list[float], floor: float, allowed: float, stated: bool) -> Verdict:
    """The verdict for misfits after 0, 1, 2 ... effects.

    Explained: what is left is within the noise and the errors of the found effects' own equations. Partly: a fifth
    of the gap, at most, is left (rms). Unknown: more; then what was found is what fits best, not the cause.
    `allowed`: misfit that the found equations' own errors may leave. `stated`: whether the log states its noise.
    """
    error = NOISE_ERROR if stated else NOISE_UNSTATED
    if len(misfits) == 1:
        return (
            Verdict.UNKNOWN
            if misfits[0] > NOISE_ONLY * error / NOISE_ERROR * floor
            else Verdict.NO_GAP
        )
    left = misfits[-1] - error * floor
    if left <= max(allowed, 0.2 * floor):
        return Verdict.EXPLAINED
    excess = max(misfits[0] - floor, 1e-300)
    return Verdict.PARTLY if left < DOUBT**2 * excess else Verdict.UNKNOWN


@dataclasses.dataclass(frozen=True)
class Tried:
    """Charged misfits J of another motion."""

    before: float
    """Of the model alone."""
    after: float
    """With the effects as they are."""
    floor: float
    """What the sensors' noise alone would leave."""
    allowed: float
    """What the equations' own errors may leave."""
    stated: bool
    """Whether that log states its sensors' noise."""


def second_look(verdict: Verdict, tried: Tried) -> Verdict:
    """The verdict after the same effects were tried on another motion.

    What fits there is left as it is; what leaves twice what the first log may leave is doubted.
    """
    error = NOISE_ERROR if tried.stated else NOISE_UNSTATED
    excess, left = tried.before - tried.floor, tried.after - error * tried.floor
    if verdict not in (Verdict.EXPLAINED, Verdict.PARTLY) or excess < error * tried.floor:
        return verdict
    if left > max(4.0 * tried.allowed, (2 * DOUBT) ** 2 * excess):
        return Verdict.UNKNOWN
    return Verdict.PARTLY if left > max(2.0 * tried.allowed, DOUBT**2 * excess) else verdict


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
