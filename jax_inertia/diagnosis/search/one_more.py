"""One hypothesis more: by which law, at which numbers, and all that follows from it."""

import numpy as np

from jax_inertia.diagnosis.hypothesis import Hypothesis
from jax_inertia.diagnosis.search import sensor_noise
from jax_inertia.diagnosis.search.bank import Bank
from jax_inertia.diagnosis.search.best_numbers import at_best, relinearised, steps_of
from jax_inertia.diagnosis.search.evidence import Evidence, Posterior
from jax_inertia.diagnosis.search.ordinary import (
    bounded,
    learned,
    relearned_evidence,
    with_turning,
)

OPEN = float(np.log(20.0))
"""Nats that leave it open which of two it is."""
COARSE, MOST_STARTS = 0.1, 3
"""Share of its evidence that a hypothesis may lose between its grid's points, and from how many it is searched."""
SETTLING = 3
"""Rounds in which variances and tolerances follow what was added."""


def with_one_more(
    residual, evidence, now: Posterior, h: Hypothesis, bank: Bank
) -> Posterior | None:
    """One more, its secant where it belongs; None where its numbers are no robot's.

    Of laws of one place, the one that searches the fewest nonlinear numbers of those that the log leaves open: evidence
    integrates over what is linear, and a number at its best brings something by chance.
    """
    tried = []
    for c in (h, *_other_laws(evidence, now, h, bank)):
        best = at_best(residual, evidence, now, c, bank.candidates)
        after = relinearised(residual, evidence, (*now.chosen, best))
        added = after.chosen[-1]
        if added.possible(residual, after.of(added)[0]):
            tried.append((turned(residual, evidence, after), added))
    if len(tried) < 2:
        return tried[0][0] if tried else None
    # By variances learned with each: those that are there take most of what is to be explained for noise.
    gains = np.array([relearned_evidence(evidence, after) - added.odds for after, added in tried])
    searched = np.array([np.count_nonzero(steps_of(residual, added)) for _, added in tried])
    near = gains > gains.max() - OPEN
    fewest = near & (searched == searched[near].min())
    return tried[int(np.argmax(np.where(fewest, gains, -np.inf)))][0]


def better_at_best(
    residual,
    evidence: Evidence,
    now: Posterior,
    h: Hypothesis,
    other: Hypothesis,
    bank: Bank,
    by: float,
) -> Hypothesis | None:
    """Another hypothesis that does better in the place of one whose nonlinear numbers were searched already, if it can.

    Better `by` so many nats, each at its best numbers, by variances learned with it: on its grid the other is behind
    by as much as that is coarse, and by variances learned with `h` what `h` does not explain is noise.
    """
    if not np.any(steps_of(residual, other)):
        return None
    rest = now.without(h)
    alike = [c for c in bank.candidates if c.key == other.key]
    gains = evidence.gains(rest, alike)
    least = relearned_evidence(evidence, now) - h.odds + by
    least -= sensor_noise.owed(residual, evidence, rest, h)
    for k in np.argsort(-gains)[:MOST_STARTS]:
        best = at_best(residual, evidence, rest, alike[k], ())
        with_it = evidence.posterior((*rest.chosen, best))
        if best.possible(residual, with_it.of(best)[0]):
            owed = sensor_noise.owed(residual, evidence, rest, best)
            if relearned_evidence(evidence, with_it) - best.odds - owed > least:
                return best
    return None


def turned(residual, evidence, now: Posterior) -> Posterior:
    """The posterior with how friction that was found turns round, and without that of a friction that is gone."""
    chosen = with_turning(residual, now)
    return now if chosen == now.chosen else evidence.posterior(chosen)


def _other_laws(evidence, now: Posterior, h: Hypothesis, bank: Bank) -> list[Hypothesis]:
    """Of each other family of which its place has but one with it, the best candidate: they compete at their best."""
    alike = [c for c in bank.candidates if c.place == h.place and one_law(c, h)]
    best = {h.family: h}
    for k in np.argsort(evidence.gains(now, alike))[::-1] if alike else ():
        best.setdefault(alike[k].family, alike[k])
    return [c for c in best.values() if c is not h]


def one_law(a: Hypothesis, b: Hypothesis) -> bool:
    """Whether a place has but one of two: both make a torque late, or are the friction that a model lacks."""
    return (bool(a.effect.law) and a.effect.law == b.effect.law) or (
        bool(a.fills) and a.fills == b.fills
    )


def settled(residual, evidence, now: Posterior) -> Posterior:
    """Variances and tolerances learned again, and without what can no longer be or has lost its evidence.

    Where equations are taken to be right, until they stay, and what was added last has its nonlinear numbers looked at
    once more: by variances that took it for noise, they matter less. Of a robot as bought both follow the misfit.
    """
    if evidence.exact:
        now = learned(evidence, with_turning(residual, now), SETTLING)
        added = next(h for h in reversed(now.chosen) if h.is_odd)
        rest = now.without(added)
        best = at_best(residual, evidence, rest, added, ())
        if best is not added:
            now = evidence.posterior((*rest.chosen, best))
    else:
        now = learned(evidence, now.chosen, 1)
    now = relinearised(residual, evidence, now.chosen)
    return pruned(residual, evidence, bounded(residual, evidence, now))


def pruned(residual, evidence: Evidence, now: Posterior) -> Posterior:
    """Without effects, ordinary ones apart, that have lost their evidence to others, or owe it to noise.

    To noise where equations are taken to be right. Of a robot as bought variances are those of its misfit, and asked so
    a UR10e lost its motors' gains and a double pendulum its teeth: 3.28 N m for 1.35 on the other run, 0.21 for 0.15.
    """
    while True:
        worths = enumerate(zip(now.chosen, evidence.worths(now), strict=True))
        left = [(worth - h.odds, k) for k, (h, worth) in worths if h.is_odd]
        if evidence.exact:
            owed = [sensor_noise.owed_in(residual, evidence, now, now.chosen[k]) for _, k in left]
            left = [(kept - by_noise, k) for (kept, k), by_noise in zip(left, owed, strict=True)]
        if not left or min(left)[0] >= -1.0:
            return now
        now = now.without(now.chosen[min(left)[1]])
