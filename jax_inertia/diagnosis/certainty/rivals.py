"""What would explain a log as well in the place of an effect that was chosen: ties, and what comes next."""

import dataclasses
from collections.abc import Iterator

import numpy as np

from jax_inertia.diagnosis.checks import PASSING, OtherRun
from jax_inertia.diagnosis.hypothesis import Hypothesis, excluded, hypothesis
from jax_inertia.diagnosis.residual import Residual
from jax_inertia.diagnosis.search import sensor_noise
from jax_inertia.diagnosis.search.bank import Bank
from jax_inertia.diagnosis.search.best_numbers import at_best, relinearised
from jax_inertia.diagnosis.search.evidence import Posterior
from jax_inertia.diagnosis.search.one_more import one_law
from jax_inertia.diagnosis.search.selection import Selection
from jax_inertia.diagnosis.settings import Settings

MOST_RIVALS = 8
"""Ties that are looked for: a longer list tells a reader nothing."""
NEAR = 10.0
"""Nats beyond a tie up to which another hypothesis counts against a probability."""
BEYOND_SECANT = 0.3
"""Share of the evidence that a secant at the wrong value may miss."""


@dataclasses.dataclass(frozen=True)
class Rival:
    """Another hypothesis that explains about as much in the place of one that was chosen."""

    hypothesis: Hypothesis
    behind: float
    """By how much its log evidence is lower, odds counted, nats."""


def _at_other_places(residual: Residual, h: Hypothesis) -> tuple[Hypothesis, ...]:
    """What happens once, at the moments found, to each other body."""
    if h.family not in PASSING:
        return ()
    places = (p for p in h.effect.places(residual.context) if p != h.place)
    return tuple(hypothesis(residual, h.effect, p, h.shape, h.odds) for p in places)


def _other_laws(selection: Selection, rest: Posterior, h: Hypothesis) -> Iterator[Hypothesis]:
    """Each other law of what the place of one that was chosen has but one of, at its best nonlinear numbers."""
    alike: dict[str, list[Hypothesis]] = {}
    for c in selection.named.candidates:
        if c.place == h.place and c.family != h.family and one_law(c, h):
            alike.setdefault(c.family, []).append(c)
    residual, evidence = selection.residual, selection.evidence
    for every in alike.values():
        start = every[int(np.argmax(evidence.gains(rest, every)))]
        yield at_best(residual, evidence, rest, start, every)


def is_law_of(other: Hypothesis, h: Hypothesis) -> bool:
    """Whether one is the other with more numbers, as a Stribeck friction is a level friction with more at low speed."""
    return other.level is not None and other.level.name == h.family and other.place == h.place


def _no_more(now: Posterior, law: Hypothesis, settings: Settings) -> bool:
    """Whether what a law adds to its level is nowhere in the log more than next to nothing: it is no other friction."""
    mean, covariance = now.of(law)
    most = np.abs(mean) + 2.0 * np.sqrt(np.diag(covariance))
    size = np.max(np.abs(law.own_columns), axis=0) * most
    return bool(np.sum(size[1:]) < settings.ordinary_tolerance * size[0])


def rivals(selection: Selection, h: Hypothesis, settings: Settings) -> tuple[Rival, ...]:
    """Best shape of each other family and place, in the place of `h`, those within reach first.

    What is no likelier than nothing in its place is none: nothing is asked about by itself. Of laws of which a place
    has but one, each at its best numbers, as they were chosen.
    """
    now, evidence = selection.posterior, selection.evidence
    rest = now.without(h)
    laws = Bank(tuple(_other_laws(selection, rest, h)))
    banks = selection.named, Bank(_at_other_places(selection.residual, h)), laws
    others, taken = [c for bank in banks for c in bank.candidates], {c.key for c in now.chosen}
    # What makes one likelier beforehand than its kind makes the others so: that something is there is known.
    usual = max((c.odds for c in selection.candidates if c.key == h.key), default=h.odds)
    own = float(evidence.gains(rest, (h,))[0]) - usual
    own -= sensor_noise.owed(selection.residual, evidence, rest, h)
    gains = np.concatenate([evidence.gains(now, bank, (h,)) - bank.odds for bank in banks])
    reach = min(settings.reach(own) + NEAR, own)
    best: dict[tuple[str, str, str], Rival] = {}
    for k in np.argsort(-gains):
        c, behind = others[k], own - float(gains[k])
        if behind > reach + (BEYOND_SECANT * abs(own) if c.effect.secant else 0.0):
            continue
        if c.key in best or c.key in taken or excluded(selection.residual, c, rest.chosen):
            continue
        if len(best) == MOST_RIVALS:
            break
        with_it = relinearised(selection.residual, evidence, (*rest.chosen, c))
        c = with_it.chosen[-1]
        if c.effect.secant:
            behind = own - float(evidence.gains(rest, (c,))[0]) + c.odds
        if behind <= reach and c.possible(selection.residual, with_it.of(c)[0]):
            if is_law_of(c, h) and _no_more(with_it, c, settings):
                continue
            behind += sensor_noise.owed(selection.residual, evidence, rest, c)
            best[c.key] = Rival(c, behind)
    out = sorted(best.values(), key=lambda r: r.behind)
    return tuple(out)


def told_apart(selection: Selection, judge: OtherRun, settings: Settings) -> Selection:
    """The selection with each odd effect that another motion speaks against the one of its ties that it speaks for.

    Two that one motion makes alike another may not: a friction and a constant torque, where a joint moved one way. One
    gives way to another that leaves less of the other run by `gate`.
    """
    for h in selection.odd:
        if not h.named or h.family in PASSING:
            continue
        now, rest = selection.posterior, selection.posterior.without(h)
        error = judge.error(now)
        if judge.error(rest) > error:
            continue
        own = selection.evidence.worths(now)[now.chosen.index(h)] - h.odds
        least, reach = (1.0 - settings.gate) * error, settings.reach(own)
        for rival in (r.hypothesis for r in rivals(selection, h, settings) if r.behind < reach):
            after = selection.evidence.posterior((*rest.chosen, rival))
            if (error := judge.error(after)) < least:
                least, selection = error, dataclasses.replace(selection, posterior=after)
    return selection
