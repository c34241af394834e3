"""Stepwise search over hypotheses by log evidence: add, delete, re-estimate, exchange; it decides nothing."""

import copy
import itertools
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from jax_inertia.diagnosis.effects.base import Effect, Shape
from jax_inertia.diagnosis.effects.dry_friction import DryFriction
from jax_inertia.diagnosis.hypothesis import Hypothesis, excluded, one_place, reshaped
from jax_inertia.diagnosis.residual import Residual
from jax_inertia.diagnosis.search import sensor_noise
from jax_inertia.diagnosis.search.bank import Bank
from jax_inertia.diagnosis.search.candidates import candidates, pushes
from jax_inertia.diagnosis.search.evidence import Evidence, Posterior
from jax_inertia.diagnosis.search.ordinary import (
    bounded,
    learned,
    ordinary_of,
    ordinary_physics,
    presliding_of,
    reconsidered,
)
from jax_inertia.diagnosis.search.selection import Selection
from jax_inertia.diagnosis.settings import CalibrationState, Settings


def started(
    residual: Residual, library: tuple[Effect, ...], settings: Settings, state: CalibrationState
) -> Selection:
    """What is there before anything is searched: tolerances and, where the model lacks it, ordinary physics."""
    evidence, now, tried = ordinary_physics(residual, library, settings, state)
    return Selection(residual, evidence, now, (), tried, state)


def searched(
    start: Selection,
    library: tuple[Effect, ...],
    settings: Settings,
    progress: Callable[[str], None] = lambda stage: None,
) -> Selection:
    """Then whatever raises the evidence by more than its prior odds."""
    evidence, now, tried, state = start.evidence, start.posterior, start.tried, start.state
    residual = start.residual.calibrated(ordinary_of(start.residual, now))
    progress("columns of every other effect at every place")
    every = tuple(candidates(residual, library, presliding_of(tried), settings, state))
    dry_forms = tuple(e for e in library if isinstance(e, DryFriction))
    progress("odd effects by their evidence")
    push = next((e for e in library if e.name == "push"), None)
    for _ in range(2):
        # What happens once hides behind nothing at first, and may hide behind what is found.
        if push is not None:
            every = (*every, *pushes(residual, evidence, now, push, settings))
        before = now.chosen
        now = _stepwise(residual, evidence, now, Bank(every), settings.most_steps)
        now = _refined(residual, evidence, now, every)
        now = reconsidered(residual, evidence, now, tried, settings)
        if _numbers_of(now.chosen) == _numbers_of(before):
            break
        every = (
            *(h for h in every if not isinstance(h.effect, DryFriction)),
            *candidates(residual, dry_forms, presliding_of(now.chosen), settings, state),
        )
    return Selection(residual, evidence, now, every, tried, state)


def _numbers_of(chosen: tuple[Hypothesis, ...]) -> set[tuple]:
    """What is chosen, each with its nonlinear numbers: friction that turns round otherwise leaves another residual."""
    return {(h.key, h.shape) for h in chosen}


def _refined(
    residual, evidence: Evidence, now: Posterior, every: Sequence[Hypothesis]
) -> Posterior:
    """Nonlinear numbers of each odd effect between its grid's points, all else marginalised."""
    for h in now.chosen:
        if h.is_odd:
            rest = now.without(h)
            best = _at_best(residual, evidence, rest, h, every)
            if best is not h:
                now = evidence.posterior((*rest.chosen, best))
    return learned(evidence, now.chosen, 1)


def _at_best(
    residual, evidence: Evidence, rest: Posterior, h: Hypothesis, every: Sequence[Hypothesis]
) -> Hypothesis:
    """The hypothesis at the nonlinear numbers of most evidence: uphill from its own and from other starts.

    `every` candidate of its family and place is a start, the best for each value of what no search moves: whether
    friction is the motor's or the link's, say, has its own optimum.
    """
    if h.effect.secant:
        return h
    steps = h.effect.steps(residual.context, h.place, h.shape)
    others = [c for c in every if c.key == h.key and not h.effect.many]
    gains = evidence.gains(rest, others) if others else np.zeros(0)
    if not np.any(steps):
        alone = float(evidence.gains(rest, (h,))[0])
        return others[int(np.argmax(gains))] if np.max(gains, initial=-np.inf) > alone else h
    starts = {_unmoved(h, steps): h}
    for k in np.argsort(gains)[::-1]:
        starts.setdefault(_unmoved(others[k], steps), others[k])
    climbed = [_between_points(residual, evidence, rest, start, steps) for start in starts.values()]
    return max(climbed, key=lambda found: found[1])[0]


def _unmoved(h: Hypothesis, steps: Shape) -> Shape:
    """What of its nonlinear numbers no search between the grid's points moves."""
    return tuple(x for x, step in zip(h.shape, steps, strict=True) if not step)


def _between_points(
    residual, evidence: Evidence, rest: Posterior, h: Hypothesis, steps: Shape
) -> tuple[Hypothesis, float]:
    """The hypothesis at the nonlinear numbers of most evidence near its own, and that: a pattern search."""
    best, gain = h, float(evidence.gains(rest, (h,))[0])
    for step in (np.asarray(steps) * 0.5**k for k in range(HALVINGS)):
        for k, sign in itertools.product(np.flatnonzero(step), (-1.0, 1.0)):
            # On while it leads up: an optimum may be several steps from the grid's point.
            for _ in range(MOST_MOVES):
                shape = list(best.shape)
                shape[k] += float(sign * step[k])
                if shape[k] * best.shape[k] < 0 or not h.effect.within(tuple(shape)):
                    break
                trial = reshaped(h, residual, tuple(shape))
                got = float(evidence.gains(rest, (trial,))[0])
                if not np.isfinite(got) or got <= gain:
                    break
                best, gain = trial, got
    return best, gain


def _stepwise(residual: Residual, evidence: Evidence, now: Posterior, bank: Bank, most: int):
    """Add what gains most, delete what has lost its evidence, exchange what another explains better."""
    # What is not added to some may do better in the place of one of them.
    barred, gone = set(), set()
    seen = {_odd_of(now)}
    for _ in range(most):
        moved = _added(residual, evidence, now, bank, barred)
        if moved is not None and _odd_of(moved[0]) in seen:
            # What drives out what it was driven out by is not tried again: no two take turns.
            barred.add(id(moved[1]))
            continue
        if moved is None:
            # One for one, and for good: that may be back to what was driven out by the way.
            moved = _exchanged(residual, evidence, now, bank, gone)
            barred |= gone
        if moved is None:
            moved = _merged(residual, evidence, now, bank)
        if moved is None:
            break
        now = moved[0]
        seen.add(_odd_of(now))
    now = learned(evidence, now.chosen, 2)
    return _pruned(evidence, bounded(residual, evidence, now))


def _odd_of(now: Posterior) -> frozenset[tuple]:
    """Families and places of the odd effects, and which of a grid's numbers."""
    return frozenset((h.key, () if h.effect.secant else h.shape) for h in now.chosen if h.is_odd)


EXCHANGE = 2.0
"""Nats by which another must do better than one that was chosen before: less is a tie."""


def _best(
    residual, evidence: Evidence, now: Posterior, bank: Bank, barred: set[int]
) -> Iterator[tuple[Hypothesis, float]]:
    """Candidates that are neither barred nor chosen, and their gains with prior odds taken off; the best first."""
    gains = evidence.gains(now, bank) - np.array([h.odds for h in bank.candidates])
    for k in np.argsort(-gains):
        h = bank.candidates[k]
        if np.isfinite(gains[k]) and id(h) not in barred and not excluded(residual, h, now.chosen):
            yield h, float(gains[k])


def _added(residual, evidence, now, bank: Bank, barred) -> tuple[Posterior, Hypothesis] | None:
    """One more, the best there is, and which; None where nothing gains.

    Those that pay compete at their best numbers, each by variances learned with it: what explains most of a row was
    taken for noise before.
    """
    asked: set[tuple[str, str, str]] = set()
    rivals: list[tuple[float, Posterior, Hypothesis]] = []
    for c, gain in _best(residual, evidence, now, bank, barred):
        if len(asked) >= MOST_RIVALS or gain <= (0.0 if rivals else -FAINT):
            break
        if c.key in asked:
            continue
        asked.add(c.key)
        if gain <= 0:
            # By variances that are there it does not pay: it may explain most of what they were learned from.
            with_it = evidence.posterior((*now.chosen, c))
            gain = evidence.gain_learned(now, *_learned(residual, evidence, with_it, 2)) - c.odds
        entered = None
        if gain > 0 and gain > sensor_noise.share(residual, evidence, now, c):
            entered = _with(residual, evidence, now, c, bank)
        if entered is None:
            barred.add(id(c))
            asked.discard(c.key)
            continue
        beside, after = entered
        rivals.append((evidence.gain_learned(now, beside, after) - c.odds, after, c))
    if not rivals:
        return None
    _, after, added = max(rivals, key=lambda r: r[0])
    return _settled(residual, evidence, after), added


def _merged(residual, evidence, now, bank: Bank) -> tuple[Posterior, Hypothesis] | None:
    """One odd effect for two of a place that together say the same; None where none does it as well.

    A friction that differs by direction is a friction and a constant torque, say.
    """
    for a, b in itertools.combinations([h for h in now.chosen if h.is_odd], 2):
        if not one_place(residual, a, b):
            continue
        rest = now.without(a)
        first, second = (
            float(evidence.worths(p)[p.chosen.index(h)]) - h.odds for p, h in ((now, a), (rest, b))
        )
        rest, both = rest.without(b), first + second
        own = {id(c) for c in bank.candidates if c.key in (a.key, b.key)}
        better = next(_best(residual, evidence, rest, bank, own), None)
        if better is None or better[1] <= both:
            continue
        entered = _with(residual, evidence, rest, better[0], bank)
        if entered is not None and _pays(evidence, now, entered, a.odds + b.odds):
            return _settled(residual, evidence, entered[1]), better[0]
    return None


def _pays(
    evidence: Evidence, now: Posterior, entered: tuple[Evidence, Posterior], spared: float
) -> bool:
    """Whether what entered is likelier than what is there, each by its own variances; `spared`: odds of what left."""
    beside, after = entered
    return evidence.gain_learned(now, beside, after) > after.chosen[-1].odds - spared


def _exchanged(
    residual, evidence, now, bank: Bank, gone: set[int]
) -> tuple[Posterior, Hypothesis] | None:
    """One odd effect for a better one that is not `gone`, everything else given; None where none is better."""
    worths = evidence.worths(now)
    for h, worth in zip(now.chosen, worths, strict=True):
        if not h.is_odd:
            continue
        rest = now.without(h)
        own = {id(c) for c in bank.candidates if c.key == h.key}
        better = next(_best(residual, evidence, rest, bank, gone | own), None)
        if (
            better is not None
            and better[1] > worth - h.odds + EXCHANGE
            and better[1] > sensor_noise.share(residual, evidence, rest, better[0])
        ):
            # Once exchanged, it does not come back: no two take turns.
            gone.update(id(c) for c in bank.candidates if c.key == h.key and c.shape == h.shape)
            entered = _with(residual, evidence, rest, better[0], bank)
            if entered is not None and _pays(evidence, now, entered, h.odds - EXCHANGE):
                return _settled(residual, evidence, entered[1]), better[0]
    return None


MOST_MOVES = 4
"""Steps of one length that lead up: as far as the grid's next point."""
FAINT, MOST_RIVALS = 8.0, 6
"""Nats below its prior odds from which a candidate is not asked, and how many compete."""
HALVINGS = 6
"""Of a pattern search's steps: to a sixtieth of the grid's spacing, less than what the log tells."""


def _with(
    residual, evidence, now: Posterior, h: Hypothesis, bank: Bank
) -> tuple[Evidence, Posterior] | None:
    """One more at its best numbers, and the evidence by variances learned with it; None where they are no robot's."""
    best = [
        _at_best(residual, evidence, now, c, bank.candidates)
        for c in (h, *_other_laws(evidence, now, h, bank))
    ]
    worths = evidence.gains(now, best) - np.array([c.odds for c in best])
    after = relinearised(residual, evidence, now.chosen, best[int(np.argmax(worths))])
    beside, after = _learned_with(residual, evidence, after)
    # By variances that hold the gap no better numbers lead up; by its own they may.
    added, rest = after.chosen[-1], after.without(after.chosen[-1])
    better = _at_best(residual, beside, rest, added, bank.candidates)
    if better is not added:
        beside, after = _learned_with(
            residual, beside, relinearised(residual, beside, rest.chosen, better)
        )
        added = after.chosen[-1]
    return (beside, after) if added.possible(residual, after.of(added)[0]) else None


def _other_laws(evidence, now: Posterior, h: Hypothesis, bank: Bank) -> list[Hypothesis]:
    """Of each other family of which its place has but one with it, the best candidate: they compete at their best."""
    alike = [
        c
        for c in bank.candidates
        if h.effect.law and c.effect.law == h.effect.law and c.place == h.place
    ]
    best = {h.family: h}
    for k in np.argsort(evidence.gains(now, alike))[::-1] if alike else ():
        best.setdefault(alike[k].family, alike[k])
    return [c for c in best.values() if c is not h]


ROUNDS, CONVERGED = 6, 0.5
"""Of variances and numbers in turn at most, and the change of log evidence [nats] from which there are no more."""


def _learned_with(residual, evidence: Evidence, now: Posterior) -> tuple[Evidence, Posterior]:
    """The evidence by variances learned with what is chosen, and the posterior: they are found in turn, best of two.

    From the variances that are there, and from the sensors' alone: by those that hold a whole gap, a prior outweighs
    what the log says of its cause; by those of the sensors, a cause that is not all of it is bent to be.
    """
    sharp = evidence.by_sensors_alone()
    bent = relinearised(residual, sharp, now.chosen[:-1], now.chosen[-1])
    starts = (evidence, now), (sharp, bent)
    found = (_learned(residual, start, after, ROUNDS) for start, after in starts)
    return max(found, key=lambda one: one[1].log_evidence)


def _learned(
    residual, evidence: Evidence, now: Posterior, rounds: int
) -> tuple[Evidence, Posterior]:
    """Variances and numbers in turn, until they stand."""
    before = -np.inf
    for _ in range(rounds):
        evidence = copy.copy(evidence)
        evidence.learn(now, memory=False)
        now = relinearised(residual, evidence, now.chosen[:-1], now.chosen[-1])
        if abs(now.log_evidence - before) < CONVERGED:
            break
        before = now.log_evidence
    return evidence, now


def _settled(residual, evidence, now: Posterior) -> Posterior:
    """Variance learned again, and without what can no longer be or has lost its evidence."""
    evidence.learn(now)
    now = evidence.posterior(now.chosen)
    return _pruned(evidence, bounded(residual, evidence, now))


SECANTS = 30
"""Moves of a secant at most: they end where it stands at the value found."""


def relinearised(
    residual, evidence: Evidence, rest: tuple[Hypothesis, ...], h: Hypothesis
) -> Posterior:
    """The posterior with one more, its secant at the value found: exact for an offset of degrees, a long delay."""
    now = evidence.posterior((*rest, h))
    if not h.effect.secant:
        return now
    for _ in range(SECANTS):
        theta = now.of(now.chosen[-1])[0]
        if np.all(np.abs(theta - np.asarray(h.shape)) < 0.01 * h.scale):
            break
        h = reshaped(h, residual, tuple(float(x) for x in theta))
        now = evidence.posterior((*now.chosen[:-1], h))
    return now


def _pruned(evidence: Evidence, now: Posterior) -> Posterior:
    """Without effects, ordinary ones apart, that have lost their evidence to others."""
    while True:
        worths = evidence.worths(now)
        loss = [
            (w - h.odds, k)
            for k, (h, w) in enumerate(zip(now.chosen, worths, strict=True))
            if h.is_odd
        ]
        if not loss or min(loss)[0] >= -1.0:
            return now
        now = now.without(now.chosen[min(loss)[1]])
