"""Numbers of a model that a log says are further off than their tolerance, and the effects that they are then."""

import dataclasses
from collections.abc import Iterator

import numpy as np
from scipy.stats import norm

from jax_inertia.diagnosis.effects.tolerances import (
    STATED,
    InertialTolerances,
    StatedNumbers,
    inertial_changes,
)
from jax_inertia.diagnosis.hypothesis import Hypothesis, excluded
from jax_inertia.diagnosis.search.bank import Bank
from jax_inertia.diagnosis.search.one_more import one_law, settled, with_one_more
from jax_inertia.diagnosis.search.selection import Selection
from jax_inertia.diagnosis.settings import Settings
from jax_inertia.text.words import number

OF_BODY = (
    ("payload", "mass"),
    *(("com_shift", f"centre of mass along {k}") for k in "xyz"),
    *[("link_inertia", "inertia")] * 6,
)
"""Of each of a body's ten numbers the effect that it is where it is no tolerance, and what it is called."""


@dataclasses.dataclass(frozen=True)
class Refuted:
    """A number of the model that is no more within its tolerance."""

    z: float
    """Its error in units of the stated standard deviation."""
    name: str
    key: tuple[str, str, str]
    """Family and place of the effect that it is."""

    @property
    def line(self) -> str:
        """As a note says it."""
        return f"{self.name} is off by {number(abs(self.z))} times its tolerance"


def refuted(selection: Selection, settings: Settings) -> list[Refuted]:
    """The numbers so far off that in a model within its tolerances hardly one would be, the worst first.

    By z in units of what is stated, Φ(−|z|) < p / 2n of n numbers that the log determines (Bonferroni's bound).
    """
    off = [x for h in selection.posterior.chosen for x in _numbers(selection, h)]
    limit = norm.isf(settings.refuted / (2.0 * max(len(off), 1)))
    return sorted((x for x in off if abs(x.z) > limit), key=lambda x: -abs(x.z))


def named_where_refuted(selection: Selection, settings: Settings) -> Selection:
    """With the effect that each refuted number is, where the log is likelier with it, by its own prior and no odds.

    Odds against an effect say how rare it is. That this number is another than the model's is known by then: what is
    asked is whether its tolerance says how far.
    """
    asked: set[tuple[str, str, str]] = set()
    while True:
        every = [x.key for x in refuted(selection, settings) if x.key not in asked]
        if not every:
            return selection
        asked.add(every[0])
        selection = _with_effect(selection, every[0])


def _with_effect(selection: Selection, key: tuple[str, str, str]) -> Selection:
    """The selection with one effect more; as it is where that cannot be or does not pay.

    Other laws of the same number compete at what they are rarer than it: the log refutes the number, not its law.
    """
    residual, evidence, now = selection.residual, selection.evidence, selection.posterior
    own = [c for c in selection.candidates if c.key == key]
    if not own or excluded(residual, own[0], now.chosen):
        return selection
    known = own[0].odds
    laws = [c for c in selection.candidates if c.place == own[0].place and one_law(c, own[0])]
    bank = Bank(tuple(dataclasses.replace(c, odds=c.odds - known) for c in laws or own))
    own = [c for c in bank.candidates if c.key == key]
    likeliest = own[int(np.argmax(evidence.gains(now, own)))]
    before = evidence.noise
    after = with_one_more(residual, evidence, now, likeliest, bank)
    if after is not None:
        after = settled(residual, evidence, after)
        keys = {c.key for c in bank.candidates} - {h.key for h in now.chosen}
        worths = zip(after.chosen, evidence.worths(after), strict=True)
        if any(h.key in keys and worth > h.odds for h, worth in worths):
            return dataclasses.replace(selection, posterior=after)
    evidence.noise = before
    return selection


def _numbers(selection: Selection, h: Hypothesis) -> Iterator[Refuted]:
    """Each of a tolerance's numbers that the log determines."""
    if not isinstance(h.effect, InertialTolerances | StatedNumbers):
        return
    now, part = selection.posterior, selection.posterior.part(h)
    told = 1.0 - np.diag(now.covariance)[part] > 0.5
    z = now.mean[part] * h.scale
    for k, (name, key) in enumerate(_names(selection, h)):
        if told[k]:
            yield Refuted(float(z[k]), name, key)


def _names(selection: Selection, h: Hypothesis) -> Iterator[tuple[str, tuple[str, str, str]]]:
    """What each of a tolerance's numbers is called, and the effect that it is where it is none."""
    if isinstance(h.effect, StatedNumbers):
        for family in STATED:
            name = f"{family.replace('_', ' ')} of {h.place.name}"
            yield name, (family, h.place.kind, h.place.name)
        return
    for _, body, _ in inertial_changes(selection.residual.context, h.shape):
        for family, what in OF_BODY:
            yield f"{what} of {body}", (family, "body", body)
