"""Stepwise search over hypotheses by log evidence: add, delete, re-estimate, exchange; it decides nothing."""

import dataclasses
import functools
import itertools
from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from jax_inertia.diagnosis.bank import Bank
from jax_inertia.diagnosis.effects.base import Effect, Place
from jax_inertia.diagnosis.effects.dry_friction import (
    CoulombFriction,
    DryFriction,
    FrictionForms,
)
from jax_inertia.diagnosis.effects.tolerances import InertialTolerances
from jax_inertia.diagnosis.evidence import Evidence, Posterior
from jax_inertia.diagnosis.hypothesis import Hypothesis, hypothesis
from jax_inertia.diagnosis.pushes import FLANK, windows
from jax_inertia.diagnosis.residual import Ordinary, Residual
from jax_inertia.diagnosis.settings import Settings

GROUPS = 10
"""Parts of a log for the jackknife."""


@dataclasses.dataclass(frozen=True, eq=False)
class Selection:
    """The hypotheses that the log's evidence keeps, and the candidates they were kept among."""

    residual: Residual
    evidence: Evidence
    posterior: Posterior
    candidates: tuple[Hypothesis, ...]

    @functools.cached_property
    def named(self) -> Bank:
        """Candidates that name a cause."""
        return Bank(tuple(c for c in self.candidates if c.named))

    @functools.cached_property
    def _spread(self) -> Float[np.ndarray, "p p"]:
        """Covariance of the numbers over fits with a tenth of the log left out in turn, scaled units.

        The delete-a-group jackknife (Kott 2001): what the equations miss goes together over time.
        """
        group = np.arange(len(self.residual.y)) * GROUPS // len(self.residual.y)
        fits = [
            self.evidence.without(group == g).posterior(self.posterior.chosen).mean
            for g in range(GROUPS)
        ]
        away = np.array(fits) - np.mean(fits, axis=0)
        return (GROUPS - 1) / GROUPS * away.T @ away

    def jackknife(self, h: Hypothesis) -> Float[np.ndarray, "k k"]:
        """Covariance of one hypothesis' numbers over parts of the log, in their own units."""
        part = self.posterior.slices[self.posterior.chosen.index(h)]
        return self._spread[part, part] * np.outer(h.scale, h.scale)

    @property
    def ordinary(self) -> tuple[Hypothesis, ...]:
        """Of every joint."""
        return tuple(h for h in self.posterior.chosen if h.ordinary)

    @property
    def odd(self) -> tuple[Hypothesis, ...]:
        """Beyond the ordinary, generic alternatives included."""
        return tuple(h for h in self.posterior.chosen if h.is_odd)


def tolerances(residual: Residual, settings: Settings) -> Hypothesis:
    """Errors of the nominal inertials, marginalised in every hypothesis."""
    place = Place("global", "global", -1)
    own = settings.mass_tolerance, settings.com_tolerance, settings.inertia_tolerance
    shape = (*own, 1.0 / residual.log.rate)
    return hypothesis(residual, InertialTolerances(), place, shape, 0.0)


def select(
    residual: Residual,
    library: tuple[Effect, ...],
    settings: Settings,
    progress: Callable[[str], None] = lambda stage: None,
) -> Selection:
    """Ordinary physics at every joint first, then whatever raises the evidence by more than its prior odds."""
    gap = np.sqrt(
        np.mean(residual.weight * residual.y**2, axis=0)
        / np.maximum(residual.weight.mean(axis=0), 1e-9)
    )
    least = np.maximum(residual.sensors, settings.least_variance * gap) + 1e-9
    evidence = Evidence(residual.y, residual.weight, least)
    base = tolerances(residual, settings)
    dry = next((e for e in library if isinstance(e, CoulombFriction)), None)
    ordinary = [e for e in library if e.ordinary and e is not dry]
    chosen = [base]
    for effect in ordinary:
        for place in effect.places(residual.context):
            chosen.append(_make(residual, effect, place, (), settings))
    progress("ordinary physics of every joint")
    turning: dict[int, float] = {}
    if dry is not None:
        for place in dry.places(residual.context):
            best = _turning(residual, evidence, tuple(chosen), dry, place, settings)
            turning[place.index] = best.shape[0]
            chosen.append(best)
    now = _learned(evidence, tuple(chosen), 4)
    now = _bounded(residual, evidence, now)
    forms = _forms(residual, now, turning, settings)
    now = _learned(evidence, (*now.chosen, *forms), 2)
    residual = residual.calibrated(ordinary_of(residual, now))
    progress("columns of every other effect at every place")
    candidates = tuple(_candidates(residual, library, turning, settings))
    progress("odd effects by their evidence")
    push = next((e for e in library if e.name == "push"), None)
    for _ in range(2):
        # What happens once hides behind nothing at first, and may hide behind what is found.
        if push is not None:
            candidates = (*candidates, *_pushes(residual, evidence, now, push, settings))
        before = now.chosen
        now = _stepwise(residual, evidence, now, Bank(candidates), settings.most_steps)
        now = _refined(residual, evidence, now)
        if len(now.chosen) == len(before):
            break
    return Selection(residual, evidence, now, candidates)


def _make(residual, effect: Effect, place: Place, shape, settings: Settings) -> Hypothesis:
    odds = (
        settings.ordinary_odds
        if effect.ordinary
        else settings.refinement_odds
        if effect.refines
        else settings.odd_odds
        if effect.named
        else settings.generic_odds
    )
    return hypothesis(residual, effect, place, shape, odds)


def _turning(residual, evidence, chosen, dry, place, settings) -> Hypothesis:
    """The joint's dry friction with the presliding displacement of most evidence."""
    tried = tuple(
        _make(residual, dry, place, shape, settings)
        for shape in dry.shapes(residual.context, place)
    )
    gains = evidence.gains(evidence.posterior(chosen), tried)
    return tried[int(np.argmax(gains))]


def _pushes(residual, evidence: Evidence, now: Posterior, push: Effect, settings: Settings):
    """Pushes on every body in the windows that gain most, their ends tried apart."""
    place = Place("body", residual.robot.body_names[0], 0)
    scale = float(push.scale(residual.context, place, ())[0])
    for start, end in windows(residual, evidence, now, scale, settings.odd_odds):
        length = end - start
        for early in (-0.3, 0.0, 0.3):
            for late in (-0.3, 0.0, 0.3):
                shape = (start + early * length, end + late * length, FLANK, 0.0)
                for place in push.places(residual.context):
                    yield _make(residual, push, place, shape, settings)


def _refined(residual, evidence: Evidence, now: Posterior) -> Posterior:
    """Nonlinear numbers of each odd effect between its grid's points: a pattern search, all else marginalised."""
    for h in now.chosen:
        if not h.is_odd or h.effect.secant:
            continue
        steps = h.effect.steps(residual.context, h.place, h.shape)
        if not steps:
            continue
        rest = evidence.posterior(tuple(c for c in now.chosen if c is not h))
        best, gain = h, float(evidence.gains(rest, (h,))[0])
        for step in (np.asarray(steps) * 0.5**k for k in range(HALVINGS)):
            for k, sign in itertools.product(np.flatnonzero(step), (-1.0, 1.0)):
                shape = list(best.shape)
                shape[k] += float(sign * step[k])
                if shape[k] * best.shape[k] <= 0:
                    continue
                trial = hypothesis(residual, h.effect, h.place, tuple(shape), h.odds)
                got = float(evidence.gains(rest, (trial,))[0])
                if np.isfinite(got) and got > gain:
                    best, gain = trial, got
        if best is not h:
            now = evidence.posterior((*rest.chosen, best))
    return _learned(evidence, now.chosen, 1)


def ordinary_of(residual: Residual, now: Posterior) -> Ordinary:
    """Ordinary numbers at the posterior mean, by row."""
    values = {family: np.zeros(residual.robot.nv) for family in (*FRICTION, "armature")}
    for h in now.chosen:
        if h.family in values:
            values[h.family][h.place.index] = now.of(h)[0][0]
    return Ordinary(*(np.maximum(x, 0.0) for x in values.values()))


def _forms(residual, now: Posterior, turning: dict[int, float], settings) -> list[Hypothesis]:
    """Mild forms of each joint's friction, in proportion to its ordinary friction."""
    out = []
    effect = FrictionForms()
    for name, row in residual.context.joint_dofs.items():
        own = [
            now.torque(h)[:, row]
            for h in now.chosen
            if h.family in FRICTION and h.place.index == row and h.place.kind == "joint"
        ]
        if own:
            level = float(np.sqrt(np.mean(sum(own) ** 2)))
            place = Place("joint", name, row)
            out.append(_make(residual, effect, place, (turning.get(row, 0.0), level), settings))
    return out


FRICTION = ("viscous_friction", "coulomb_friction")


def _candidates(residual, library, turning: dict[int, float], settings):
    for effect in library:
        if effect.ordinary:
            continue
        for place in effect.places(residual.context):
            for shape in effect.shapes(residual.context, place):
                # All forms of a joint's dry friction turn round alike.
                if isinstance(effect, DryFriction) and shape[0] != turning.get(
                    place.index, shape[0]
                ):
                    continue
                h = _make(residual, effect, place, shape, settings)
                # What this motion does not show is no candidate.
                if np.any(np.abs(h.scaled) > 1e-9):
                    yield h


def _learned(evidence: Evidence, chosen: tuple[Hypothesis, ...], rounds: int) -> Posterior:
    now = evidence.posterior(chosen)
    for _ in range(rounds):
        evidence.learn(now)
        now = evidence.posterior(chosen)
    return now


def _bounded(residual: Residual, evidence: Evidence, now: Posterior) -> Posterior:
    """Without effects that would be less than nothing: a friction that drives, a load that lifts."""
    while True:
        wrong = [
            h for h in now.chosen if not h.effect.possible(residual.context, h.place, now.of(h)[0])
        ]
        if not wrong:
            return now
        now = evidence.posterior(tuple(h for h in now.chosen if h not in wrong))


def _stepwise(residual: Residual, evidence: Evidence, now: Posterior, bank: Bank, most: int):
    """Add what gains most, delete what has lost its evidence, exchange what another explains better."""
    barred: set[int] = set()
    for _ in range(most):
        moved = _added(residual, evidence, now, bank, barred)
        if moved is None:
            moved = _exchanged(residual, evidence, now, bank, barred)
        if moved is None:
            break
        now = moved
    now = _learned(evidence, now.chosen, 2)
    return _pruned(evidence, _bounded(residual, evidence, now))


EXCHANGE = 2.0
"""Nats by which another must do better than one that was chosen before: less is a tie."""


def _gains(evidence: Evidence, now: Posterior, bank: Bank, barred: set[int]):
    """Of each candidate, prior odds taken off; minus infinity for what is barred or chosen already."""
    out = evidence.gains(now, bank) - np.array([h.odds for h in bank.candidates])
    shut = [id(h) in barred or _excluded(h, now.chosen) for h in bank.candidates]
    return np.where(shut, -np.inf, out)


def _added(residual, evidence, now, bank: Bank, barred) -> Posterior | None:
    """One more, the best there is; None where nothing gains."""
    gains = _gains(evidence, now, bank, barred)
    for best in np.argsort(-gains):
        if gains[best] <= 0:
            return None
        added = bank.candidates[best]
        after = _with(residual, evidence, now, added)
        if after is not None:
            return _settled(residual, evidence, after)
        barred.add(id(added))
    return None


def _exchanged(residual, evidence, now, bank: Bank, barred) -> Posterior | None:
    """One odd effect for a better one, everything else given; None where none is better."""
    worths = evidence.worths(now)
    for h, worth in zip(now.chosen, worths, strict=True):
        if not h.is_odd:
            continue
        rest = evidence.posterior(tuple(c for c in now.chosen if c is not h))
        own = {id(c) for c in bank.candidates if c.key == h.key}
        gains = _gains(evidence, rest, bank, barred | own)
        best = int(np.argmax(gains))
        if gains[best] > worth - h.odds + EXCHANGE:
            # Once exchanged, it does not come back: no two take turns.
            barred.update(id(c) for c in bank.candidates if c.key == h.key and c.shape == h.shape)
            after = _with(residual, evidence, rest, bank.candidates[best])
            if after is not None:
                return _settled(residual, evidence, after)
    return None


def _excluded(h: Hypothesis, chosen: tuple[Hypothesis, ...]) -> bool:
    """Whether it is chosen already, or another law of what its place has but one of."""
    for c in chosen:
        if c.key == h.key and h.family not in MANY:
            return True
        if not h.effect.law:
            continue
        together = c.place == h.place or "global" in (c.place.kind, h.place.kind)
        if c.effect.law == h.effect.law and together:
            return True
    return False


HALVINGS = 6
"""Of a pattern search's steps: to a sixtieth of the grid's spacing, less than what the log tells."""
MANY = frozenset({"push", "cogging"})
"""Effects that may be at a place more than once."""


def _with(residual, evidence, now: Posterior, h: Hypothesis) -> Posterior | None:
    """One more, its secant where it belongs; None where its numbers are no robot's."""
    after = relinearised(residual, evidence, now, h)
    added = after.chosen[-1]
    possible = added.effect.possible(residual.context, added.place, after.of(added)[0])
    return after if possible else None


def _settled(residual, evidence, now: Posterior) -> Posterior:
    """Variance learned again, and without what can no longer be or has lost its evidence."""
    evidence.learn(now)
    now = evidence.posterior(now.chosen)
    return _pruned(evidence, _bounded(residual, evidence, now))


def relinearised(residual, evidence: Evidence, now: Posterior, h: Hypothesis) -> Posterior:
    """The posterior with one more, its secant at the value found: exact for an offset of degrees, a long delay."""
    now = evidence.posterior((*now.chosen, h))
    if not h.effect.secant:
        return now
    for _ in range(4):
        theta = now.of(now.chosen[-1])[0]
        if np.all(np.abs(theta - np.asarray(h.shape)) < 0.01 * h.scale):
            break
        h = hypothesis(residual, h.effect, h.place, tuple(float(x) for x in theta), h.odds)
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
        out = min(loss)[1]
        now = evidence.posterior(tuple(h for k, h in enumerate(now.chosen) if k != out))
