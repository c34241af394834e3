"""From misfits to words: explained, partly, unknown or no gap; how sure; what ties.

`floor` is the misfit that noise alone would leave. The excess above it is the gap as far as this log can see.
"""

import dataclasses
import enum

import numpy as np
import scipy.special

from jax_inertia.gap.candidate import Candidate
from jax_inertia.gap.noise import known_to
from jax_inertia.gap.strain import Strained, Strangeness


class Verdict(enum.StrEnum):
    """What can be said of the gap."""

    EXPLAINED = "explained"
    PARTLY = "partly"
    UNKNOWN = "unknown"
    NO_GAP = "no_gap"

    @classmethod
    def of_nothing(cls, bare: Strangeness, stands_out: bool) -> "Verdict":
        """The verdict where no effect was found; `stands_out`: whether something that is no family does explain it."""
        return cls.UNKNOWN if bare.most > 1.0 or stands_out else cls.NO_GAP

    def confidence(self, bare: Strangeness) -> float:
        """How sure a verdict without effects is: by how far the log is from the border between the two."""
        side = 1.0 if self is Verdict.UNKNOWN else -1.0
        return float(scipy.special.expit(4.0 * side * np.log(max(bare.most, 1e-9))))


TEMPER = 0.003
# A cause that leaves more than this (rms) of what it should explain is not the cause.
DOUBT = 0.2


def judge(misfits: list[float], floor: float, allowed: float, known: bool) -> Verdict:
    """The verdict for misfits after 0, 1, 2 ... effects, one at least.

    Explained: what is left is within the noise and the errors of the found effects' own equations. Partly: a fifth
    of the gap, at most, is left (rms). Unknown: more; then what was found is what fits best, not the cause.
    `allowed`: misfit that the found equations' own errors may leave. `known`: whether the noise is (`known_to`).
    """
    error = known_to(known)
    left = misfits[-1] - error * floor
    if left <= max(allowed, 0.2 * floor):
        return Verdict.EXPLAINED
    excess = max(misfits[0] - floor, 1e-300)
    return Verdict.PARTLY if left < DOUBT**2 * excess else Verdict.UNKNOWN


def doubted(verdict: Verdict, share: float) -> Verdict:
    """The verdict where a share of the explained misfit is in doubt: as much of it as `judge` may leave, or more."""
    if share <= 0.0 or verdict not in (Verdict.EXPLAINED, Verdict.PARTLY):
        return verdict
    return Verdict.UNKNOWN if share > DOUBT**2 else Verdict.PARTLY


def with_strain(
    verdict: Verdict, strains: list[Strained], explained: float, allowed: float
) -> Verdict:
    """The verdict where numbers of the model have to be further off than their tolerances for the effects to do.

    `explained`: the misfit that the effects took. `allowed`: what errors of their equations may leave, and numbers of
    the model take instead.
    """
    granted = sum(x.energy for x in strains)
    if granted <= allowed:
        return verdict
    return doubted(verdict, granted / max(granted + explained, 1e-300))


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
    known: bool
    """Whether that log's noise is."""


def second_look(verdict: Verdict, tried: Tried) -> Verdict:
    """The verdict after the same effects were tried on another motion.

    What fits there is left as it is; what leaves twice what the first log may leave is doubted.
    """
    error = known_to(tried.known)
    excess, left = tried.before - tried.floor, tried.after - error * tried.floor
    if verdict not in (Verdict.EXPLAINED, Verdict.PARTLY) or excess < error * tried.floor:
        return verdict
    if left > max(4.0 * tried.allowed, (2 * DOUBT) ** 2 * excess):
        return Verdict.UNKNOWN
    return Verdict.PARTLY if left > max(2.0 * tried.allowed, DOUBT**2 * excess) else verdict


def ties(
    best: Candidate, ranking: list[Candidate], misfits: list[float], floor: float
) -> list[Candidate]:
    """Candidates that explain nearly as much as the best: within 15 nats of noise or 1 % of its gain.

    Of two that are judged in the motion's own band, what they explain there counts.
    """
    noise = max(1.0, misfits[-1] / max(floor, 1.0))
    margin = max(15.0 * noise, 0.01 * best.gain)

    def behind(c: Candidate) -> float:
        return best.aim - c.aim if best.family.slow and c.family.slow else best.gain - c.gain

    return [c for c in ranking if c.key != best.key and behind(c) < margin]


def probabilities(ranking: list[Candidate]) -> dict[tuple[str, str, str], float]:
    """Posterior odds among all candidates at the first step.

    Tempered by a share of the best gain: a model's equations are never exact, and a likelihood that takes them
    for exact is sure of whatever comes first.
    """
    if not ranking:
        return {}
    first = ranking[0]
    # A richer family that contains the best at its place is no rival of it, nor is the same with fewer numbers.
    rivals = [
        c
        for c in ranking
        if c is first
        or (
            c.key != first.key
            and not (c.place == first.place and first.family.name in c.family.simpler)
        )
    ]
    # Scores are against the noise already.
    temper = max(1.0, TEMPER * first.score)
    scores = np.array([c.score for c in rivals])
    weights = scipy.special.softmax(0.5 * (scores - scores.max()) / temper)
    return {c.key: float(w) for c, w in zip(rivals, weights, strict=True)}
