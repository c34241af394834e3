"""How probable an effect is, and a verdict, given this log: the search's posterior, calibrated on opened sets.

    L = −ln(e^−E + Σₐ e^−cₐ)

L are log odds, in nats, that an effect, or one that is tied with it, is there. E: its log evidence against nothing in
its place, prior odds taken off, the less of what the fitted rows say and of what rows do that no number was fitted to
(`evidence_of_causes`). cₐ: by how much alternative a is behind it, on the fitted rows or on those others, whichever is
less. Alternatives that are tied are counted with it: what predicts those others no worse may be there instead.

Equations are not exact, and what they miss grows with an effect's size, so L is too sure of itself in proportion. The
probability is p = 1 / (1 + exp(−a asinh L − b)) (after Platt, Advances in Large Margin Classifiers, 1999), a > 0
fitted on opened sets, of effects and of verdicts apart, and kept in `calibration.json` with where it is from
(`benchmarks/exam/calibrate.py`). Of an effect b = 0: even odds stay even. What stands against a verdict is summed as if
each of it came alone, which counts some of it twice: b > 0 is fitted with a.
"""

import functools
import json
from collections.abc import Sequence
from importlib import resources
from typing import Any

import numpy as np

from jax_inertia.diagnosis.certainty.causes import Judges, evidence_of_causes
from jax_inertia.diagnosis.certainty.rivals import Rival
from jax_inertia.diagnosis.hypothesis import Hypothesis
from jax_inertia.diagnosis.search.selection import Selection


def log_odds(against: Sequence[float]) -> float:
    """−ln Σ e^−x of what stands against something, x its log odds against each [nats]."""
    return -float(np.logaddexp.reduce(-np.asarray(against)))


def odds_of_effect(
    selection: Selection, h: Hypothesis, apart: Sequence[float], judges: Judges
) -> float:
    """Log odds that one of the chosen, or one tied with it, is there [nats].

    `apart`: how far alternatives that are not tied with it are behind (`behind_it`).
    """
    now = selection.posterior
    (cause,) = evidence_of_causes(selection, (h,), judges)
    (own,) = (w for c, w in zip(now.chosen, selection.evidence.worths(now), strict=True) if c is h)
    return log_odds((min(float(own), cause) - h.odds, *apart))


def behind_it(selection: Selection, h: Hypothesis, rival: Rival, judges: Judges) -> float:
    """By how much an alternative is behind one of the chosen, cₐ [nats]; 0 where it predicts unseen rows no worse."""
    now = selection.posterior
    instead = selection.evidence.posterior((*now.without(h).chosen, rival.hypothesis))
    ahead = sum(judge.ahead(now, instead) for judge in judges)
    return min(rival.behind, max(ahead, 0.0))


def probability(odds: float) -> float:
    """Calibrated probability of an effect of log odds L.

    >>> from jax_inertia.diagnosis.certainty.probability import probability
    >>> probability(-20.0) < 0.5 < probability(20.0) < 1.0
    True
    """
    return _mapped(odds, calibration()["slope"])


def confidence(odds: float) -> float:
    """Calibrated probability that a verdict of log odds L is right; the map is one of its own.

    >>> from jax_inertia.diagnosis.certainty.probability import confidence
    >>> confidence(-20.0) < confidence(20.0) < 1.0
    True
    """
    return _mapped(odds, calibration()["slope_of_verdicts"], calibration()["offset_of_verdicts"])


def _mapped(odds: float, slope: float, offset: float = 0.0) -> float:
    return float(1.0 / (1.0 + np.exp(-slope * np.arcsinh(odds) - offset)))


@functools.cache
def calibration() -> dict[str, Any]:
    """`calibration.json`."""
    file = resources.files("jax_inertia.diagnosis.certainty") / "calibration.json"
    return json.loads(file.read_text(encoding="utf-8"))
