"""Stepwise search over hypotheses by log evidence: add, delete, re-estimate, exchange; it decides nothing."""

import itertools
from collections.abc import Callable, Iterator

import numpy as np

from jax_inertia.diagnosis.effects.base import Effect
from jax_inertia.diagnosis.effects.dry_friction import DryFriction
from jax_inertia.diagnosis.hypothesis import Hypothesis, excluded, one_place
from jax_inertia.diagnosis.residual import Residual
from jax_inertia.diagnosis.search import sensor_noise
from jax_inertia.diagnosis.search.bank import Bank
from jax_inertia.diagnosis.search.candidates import candidates, pushes
from jax_inertia.diagnosis.search.evidence import Evidence, Posterior
from jax_inertia.diagnosis.search.one_more import (
    COARSE,
    better_at_best,
    pruned,
    settled,
    turned,
    with_one_more,
)
from jax_inertia.diagnosis.search.ordinary import (
    bounded,
    in_time,
    learned,
    ordinary_of,
    ordinary_physics,
    presliding_of,
    reconsidered,
    relearned_evidence,
)
from jax_inertia.diagnosis.search.selection import Selection
from jax_inertia.diagnosis.settings import CalibrationState, Settings


def started(
    residual: Residual, library: tuple[Effect, ...], settings: Settings, state: CalibrationState
) -> Selection:
    """What is there before anything is searched: tolerances and, where the model lacks it, ordinary physics."""
    evidence, now, tried = ordinary_physics(residual, library, settings, state)
    return Selection(residual, evidence, now, (), tried)


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
        bank = Bank(every)
        now = _stepwise(residual, evidence, now, bank, settings)
        now = _refined(residual, evidence, now, bank)
        now = in_time(residual, evidence, reconsidered(residual, evidence, now, tried, settings))
        if _numbers_of(now.chosen) == _numbers_of(before):
            break
        every = (
            *(h for h in every if not isinstance(h.effect, DryFriction)),
            *candidates(residual, dry_forms, presliding_of(now.chosen), settings, state),
        )
    return Selection(residual, evidence, now, every, tried)


def _numbers_of(chosen: tuple[Hypothesis, ...]) -> set[tuple]:
    """What is chosen, each with its nonlinear numbers: friction that turns round otherwise leaves another residual."""
    return {(h.key, h.shape) for h in chosen}


def _refined(residual, evidence: Evidence, now: Posterior, bank: Bank) -> Posterior:
    """Nonlinear numbers of each odd effect between its grid's points, and by which law of its place, all else given.

    Once more, by the noise that is left then, of those that gained: the ends of a push were sought by the noise of a
    push with other ends.
    """
    # A secant at its value has nothing to search; laid once more, it drifts along what no log tells.
    sought = (h for h in now.chosen if not h.effect.secant or h.effect.law)
    moving = {h.key for h in sought if h.is_odd}
    for _ in range(MOST_ROUNDS):
        for key in sorted(moving):
            before = now.log_evidence
            for _ in [c for c in now.chosen if c.key == key]:
                # What was looked at goes to the end, so that the first is one that was not.
                h = next((c for c in now.chosen if c.key == key), None)
                if h is None:
                    break
                rest = turned(residual, evidence, now.without(h))
                again = with_one_more(residual, evidence, rest, h, bank)
                if again is None:
                    again = turned(residual, evidence, evidence.posterior((*rest.chosen, h)))
                now = again
            if now.log_evidence < before + STAYS:
                moving.discard(key)
        now = learned(evidence, now.chosen, 1)
        if not moving:
            break
    return now


def _stepwise(
    residual, evidence: Evidence, now: Posterior, bank: Bank, settings: Settings
) -> Posterior:
    """Add what gains most, delete what has lost its evidence, exchange what another explains better."""
    # What is not added to some may do better in the place of one of them.
    barred: set[int] = set()
    gone: set[int] = set()
    vain: set[tuple] = set()
    seen = {_odd_of(now)}
    most = np.inf if settings.most_effects is None else settings.most_effects
    ways = [
        lambda now: (
            _added(residual, evidence, now, bank, barred, seen)
            if sum(h.is_odd for h in now.chosen) < most
            else None
        ),
        # One for one, and for good: that may be back to what was driven out by the way.
        lambda now: _exchanged(residual, evidence, now, bank, gone, vain, seen),
        lambda now: _merged(residual, evidence, now, bank, seen),
    ]
    if evidence.exact:
        # Where equations are right, first: what two say worse than one leaves something for a third to say.
        ways = [ways[-1], *ways[:-1]]
    for _ in range(settings.most_steps):
        moved = next((m for m in (way(now) for way in ways) if m is not None), None)
        if moved is None:
            break
        barred |= gone
        now = moved
    now = learned(evidence, now.chosen, 2)
    return pruned(residual, evidence, bounded(residual, evidence, now))


def _raised(
    residual, evidence: Evidence, now: Posterior, after: Posterior, seen: set[frozenset[tuple]]
) -> Posterior | None:
    """What comes of a move once it is settled, if it leads on; None where it does not, the noise as before.

    Where equations are taken to be right the log has to be likelier by it, prior odds counted: with one more, others
    may be driven out. How much likelier depends on how slow the discrepancy is, which is learned with each of the two,
    so the mean of both counts. Of a robot as bought variances follow the misfit of equations, and a gain by one's own
    says little: there a move leads to what was not there before.
    """
    before = evidence.noise
    after = settled(residual, evidence, after)
    learned_with_it = evidence.noise
    evidence.noise = before
    if evidence.exact:
        gained = _gained(residual, evidence, now, after)
        evidence.noise = learned_with_it
        leads = gained + _gained(residual, evidence, now, after) > 0.0
    else:
        leads = _odd_of(after) not in seen
    evidence.noise = learned_with_it if leads else before
    if not leads:
        return None
    seen.add(_odd_of(after))
    return after


def _odd_of(now: Posterior) -> frozenset[tuple]:
    """Families and places of the odd effects, and which of a grid's numbers."""
    return frozenset((h.key, () if h.effect.secant else h.shape) for h in now.chosen if h.is_odd)


def _gained(residual, evidence: Evidence, now: Posterior, after: Posterior) -> float:
    """By how much a log is likelier by other hypotheses, what they owe to prior odds and to noise taken off, nats.

    Variances and tolerances are learned with each; the discrepancy is as slow as the present noise has it.
    """
    odds = sum(h.odds for h in after.chosen) - sum(h.odds for h in now.chosen)
    noise = sum(_owed(residual, evidence, p) * sign for p, sign in ((after, 1), (now, -1)))
    gained = relearned_evidence(evidence, after) - relearned_evidence(evidence, now)
    return gained - odds - noise


def _owed(residual, evidence: Evidence, now: Posterior) -> float:
    """What the odd effects owe to noise, each given the others, nats."""
    odd = (h for h in now.chosen if h.is_odd)
    return float(sum(sensor_noise.owed_in(residual, evidence, now, h) for h in odd))


MOST_ROUNDS, STAYS = 5, 1.0
"""Rounds in which nonlinear numbers are looked at once more, and nats that are worth another one."""
EXCHANGE = 2.0
"""Nats by which another must do better than one that was chosen before: less is a tie."""


def _best(
    residual,
    evidence: Evidence,
    now: Posterior,
    bank: Bank,
    barred: set[int],
    without: tuple[Hypothesis, ...] = (),
) -> Iterator[tuple[Hypothesis, float]]:
    """Candidates that are neither barred nor chosen, and their gains with prior odds taken off; the best first.

    Had some of the chosen not been chosen: `without` them.
    """
    gains = evidence.gains(now, bank, without) - bank.odds
    chosen = [h for h in now.chosen if h not in without]
    for k in np.argsort(-gains):
        h = bank.candidates[k]
        if np.isfinite(gains[k]) and id(h) not in barred and not excluded(residual, h, chosen):
            yield h, float(gains[k])


def _added(residual, evidence, now, bank: Bank, barred, seen) -> Posterior | None:
    """One more, the best there is; None where nothing gains."""
    asked: set[tuple[str, str, str]] = set()
    failed: set[tuple[str, str, str]] = set()
    alone: float | None = None
    for added, gain in _best(residual, evidence, now, bank, barred):
        if gain <= -FAINT or len(asked) == MOST_FAINT:
            return None
        # Its nonlinear numbers were looked at from each of its starts.
        if added.key in failed:
            continue
        if gain <= 0:
            # By variances that are there it does not pay: it may explain most of what they were learned from.
            if added.key in asked:
                continue
            asked.add(added.key)
            after = evidence.posterior((*now.chosen, added))
            alone = relearned_evidence(evidence, now) if alone is None else alone
            gain = relearned_evidence(evidence, after) - alone - added.odds
        by_noise = sensor_noise.share(residual, evidence, now, added) if gain > 0 else 0.0
        after = with_one_more(residual, evidence, now, added, bank) if gain > by_noise else None
        if after is not None:
            raised = _raised(residual, evidence, now, after, seen)
            if raised is not None:
                return raised
            failed |= {h.key for h in after.chosen} - {h.key for h in now.chosen} | {added.key}
        barred.add(id(added))
    return None


def _merged(residual, evidence, now, bank: Bank, seen) -> Posterior | None:
    """One odd effect for several that together say the same; None where none does it as well.

    A friction that differs by direction is a friction and a constant torque, say; a delay of all joints is one of each.
    """
    for several in _alike(residual, now):
        rest = now
        for h in several:
            rest = rest.without(h)
        together = now.log_evidence - rest.log_evidence
        together -= sum(h.odds + evidence.unsaid(h) for h in several)
        # One of them with other nonlinear numbers, too: a load of another mass.
        better = next(_best(residual, evidence, now, bank, set(), several), None)
        if better is None or better[1] <= together:
            continue
        after = with_one_more(residual, evidence, rest, better[0], bank)
        raised = None if after is None else _raised(residual, evidence, now, after, seen)
        if raised is not None:
            return raised
    return None


def _alike(residual, now: Posterior) -> Iterator[tuple[Hypothesis, ...]]:
    """Odd effects that may be one: two of a place, all of a family."""
    odd = [h for h in now.chosen if h.is_odd]
    pairs = (x for x in itertools.combinations(odd, 2) if one_place(residual, *x))
    families = [
        tuple(h for h in odd if h.family == f) for f in dict.fromkeys(h.family for h in odd)
    ]
    # Two of a family at one place are both.
    yield from dict.fromkeys((*pairs, *(x for x in families if len(x) > 1)))


def _exchanged(
    residual, evidence, now, bank: Bank, gone: set[int], vain: set[tuple], seen
) -> Posterior | None:
    """One odd effect for a better one that is not `gone`, everything else given; None where none is better.

    `vain`: which exchanges came to nothing, to be tried once.
    """
    worths = evidence.worths(now)
    for h, worth in zip(now.chosen, worths, strict=True):
        if not h.is_odd:
            continue
        rest = now.without(h)
        own = {id(c) for c in bank.candidates if c.key == h.key}
        better = next(_best(residual, evidence, now, bank, gone | own, (h,)), None)
        if better is None or (h.key, better[0].key) in vain:
            continue
        exchange, own_gain = (h.key, better[0].key), worth - h.odds
        if better[1] <= (1.0 - COARSE) * own_gain:
            continue
        by_noise = [sensor_noise.owed(residual, evidence, rest, c) for c in (better[0], h)]
        ahead = better[1] - by_noise[0] - max(0.0, own_gain - by_noise[1] + EXCHANGE)
        other: Hypothesis | None = better[0]
        if ahead <= 0.0 or better[1] <= own_gain + EXCHANGE:
            other = better_at_best(residual, evidence, now, h, better[0], bank, EXCHANGE)
        if other is None:
            continue
        after = with_one_more(residual, evidence, rest, other, bank)
        if after is None or _odd_of(after) == _odd_of(now):
            continue
        if evidence.exact:
            after = _raised(residual, evidence, now, after, seen)
        else:
            after = _settled_with(residual, evidence, rest, after, seen)
        if after is None:
            vain.add(exchange)
        else:
            # Once exchanged, it does not come back: no two take turns.
            gone.update(id(c) for c in bank.candidates if c.key == h.key and c.shape == h.shape)
            return after
    return None


def _settled_with(
    residual, evidence: Evidence, rest: Posterior, after: Posterior, seen: set[frozenset[tuple]]
) -> Posterior | None:
    """What comes of an exchange once it is settled; None, the noise as before, where what came in went out again."""
    came = {h.key for h in after.chosen} - {h.key for h in rest.chosen}
    before = evidence.noise
    after = settled(residual, evidence, after)
    if came.isdisjoint(h.key for h in after.chosen):
        evidence.noise = before
        return None
    seen.add(_odd_of(after))
    return after


FAINT, MOST_FAINT = 8.0, 5
"""Nats below its prior odds from which, and how many, candidates are asked by variances learned with them."""
