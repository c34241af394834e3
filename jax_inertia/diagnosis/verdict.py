"""The verdict, one table: about the remainder, not about the robot.

| residual before, against the sensors | unexplained share u | after, against the sensors | verdict |
|---|---|---|---|
| no effect is named, all runs and joints are quiet, every number of the model within its tolerance | – | – | no_gap |
| else | below `explained`, or | within `noise_ratio` | explained |
| else | below `partly` | | partly |
| else | | | unknown |

All of what the named effects leave: a generic alternative explains nothing. A run is quiet within `noise_ratio`, a
joint within `excess` of what its sensors, the equations' own errors and unknown numbers leave. `explained` becomes
`partly` where a joint is not quiet in every run, where it is not `likely` that no further effect is there, and where
one without a name is: small as it may be next to the gap, it is distinct, and its cause is not known.
"""

from typing import NamedTuple

import numpy as np

from jax_inertia.diagnosis.checks import Check
from jax_inertia.diagnosis.result import Verdict
from jax_inertia.diagnosis.settings import Settings

SURE = 0.95
"""Probability of a verdict that no border is near to."""


class Doubts(NamedTuple):
    """What else there may be."""

    another: float = 0.0
    """Odds that one more effect is there."""
    refuted: bool = False
    """Numbers of the model are further off than their tolerance."""
    unnamed: bool = False
    """An effect is there that no name is known for."""


def verdict(
    own: Check,
    other: Check | None,
    listed: bool,
    doubts: Doubts,
    settings: Settings,
) -> Verdict:
    """Of the log itself, its stretches held out, and of another run; `listed`: any effect is."""
    runs = [own] if other is None else [own, other]
    if not listed:
        quiet = all(_quiet(c, settings) for c in runs) and not doubts.refuted
        return Verdict.NO_GAP if quiet else Verdict.UNKNOWN
    check = runs[-1]
    limit = settings.noise_ratio * check.noise
    small = check.unexplained < settings.explained or check.after <= limit
    if small and check.after < check.before:
        loud = any(np.any(c.excess > settings.excess) for c in runs)
        doubted = loud or doubts.unnamed or 1.0 / (1.0 + doubts.another) < settings.likely
        return Verdict.PARTLY if doubted else Verdict.EXPLAINED
    return Verdict.PARTLY if check.unexplained < settings.partly else Verdict.UNKNOWN


def _quiet(check: Check, settings: Settings) -> bool:
    """Whether a run shows nothing that the model's tolerances and its sensors' noise do not leave."""
    small = check.after_excess <= settings.noise_ratio
    return bool(small and np.all(check.excess <= settings.excess))


def confidence(
    check: Check,
    given: Verdict,
    probabilities: list[float],
    doubts: Doubts,
    settings: Settings,
) -> float:
    """Probability that the verdict is right: of the least sure odd effect, and of the border between two verdicts.

    What is explained needs that no other effect is there; what is there without a name remains, however little is left.
    """
    sure = min(probabilities, default=0.99)
    ratio = max(check.unexplained, 1e-6) / settings.explained
    if given is Verdict.EXPLAINED:
        border = 1.0 / (1.0 + ratio**2)
        sure /= 1.0 + doubts.another
    elif given is Verdict.PARTLY:
        border = SURE if doubts.unnamed else ratio**2 / (1.0 + ratio**2)
        sure = max(sure, 0.5)
    else:
        border = SURE
    return float(np.clip(sure * max(border, 0.5), 0.05, 0.99))
