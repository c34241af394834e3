"""Stepwise search over hypotheses by log evidence: add, delete, re-estimate, exchange; returns what is chosen, decides nothing."""

import dataclasses
from collections.abc import Callable

import numpy as np

from jax_inertia.diagnosis.effects.base import Effect
from jax_inertia.diagnosis.effects.dry_friction import CoulombFriction
from jax_inertia.diagnosis.evidence import Evidence, Posterior
from jax_inertia.diagnosis.hypothesis import Hypothesis, hypothesis
from jax_inertia.diagnosis.residual import Residual
from jax_inertia.diagnosis.settings import Settings
from jax_inertia.gap.families.base import Place


@dataclasses.dataclass(frozen=True, eq=False)
class Selection:
    """The hypotheses that the log's evidence keeps, and the candidates they were kept among."""

    residual: Residual
    evidence: Evidence
    posterior: Posterior
    candidates: tuple[Hypothesis, ...]

    @property
    def ordinary(self) -> tuple[Hypothesis, ...]:
        """Of every joint."""
        return tuple(h for h in self.posterior.chosen if h.ordinary)

    @property
    def odd(self) -> tuple[Hypothesis, ...]:
        """Beyond the ordinary, generic alternatives included."""
        return tuple(h for h in self.posterior.chosen if h.effect is not None and not h.ordinary)


def tolerances(residual: Residual) -> Hypothesis:
    """Errors of the nominal inertials, marginalised in every hypothesis."""
    columns = residual.tolerances
    place = Place("global", "global", -1)
    return Hypothesis(None, place, (), columns, None, np.ones(columns.shape[-1]), 0.0)


def select(
    residual: Residual,
    library: tuple[Effect, ...],
    settings: Settings,
    progress: Callable[[str], None] = lambda stage: None,
) -> Selection:
    """Ordinary physics at every joint first, then whatever raises the evidence by more than its prior odds."""
    gap = np.sqrt(np.mean(residual.weight * residual.y**2, axis=0) / np.maximum(residual.weight.mean(axis=0), 1e-9))
    least = np.maximum(residual.sensors, settings.least_variance * gap) + 1e-9
    evidence = Evidence(residual.y, residual.weight, least)
    base = tolerances(residual)
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
    progress("columns of every other effect at every place")
    candidates = tuple(_candidates(residual, library, turning, settings))
    progress("odd effects by their evidence")
    now = _stepwise(residual, evidence, now, candidates, settings)
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
        _make(residual, dry, place, shape, settings) for shape in dry.shapes(residual.context, place)
    )
    gains = evidence.gains(evidence.posterior(chosen), tried)
    return tried[int(np.argmax(gains))]


def _candidates(residual, library, turning: dict[int, float], settings):
    for effect in library:
        if effect.ordinary:
            continue
        for place in effect.places(residual.context):
            for shape in effect.shapes(residual.context, place):
                # All forms of a joint's dry friction turn round alike.
                if effect.refines and place.index in turning and len(shape) and _is_dry(effect):
                    if shape[0] != turning[place.index]:
                        continue
                h = _make(residual, effect, place, shape, settings)
                # What this motion does not show is no candidate.
                if np.any(np.abs(h.scaled) > 1e-9):
                    yield h


def _is_dry(effect: Effect) -> bool:
    from jax_inertia.diagnosis.effects.dry_friction import _Dry

    return isinstance(effect, _Dry)


def _learned(evidence: Evidence, chosen: tuple[Hypothesis, ...], rounds: int) -> Posterior:
    now = evidence.posterior(chosen)
    for _ in range(rounds):
        evidence.learn(now)
        now = evidence.posterior(chosen)
    return now


def _bounded(residual: Residual, evidence: Evidence, now: Posterior) -> Posterior:
    """Without ordinary effects that would be less than nothing: a friction that drives, a rotor without inertia."""
    while True:
        wrong = [
            h
            for h in now.chosen
            if h.ordinary and not h.effect.possible(residual.context, h.place, now.of(h)[0])
        ]
        if not wrong:
            return now
        now = evidence.posterior(tuple(h for h in now.chosen if h not in wrong))


def _stepwise(
    residual: Residual,
    evidence: Evidence,
    now: Posterior,
    candidates: tuple[Hypothesis, ...],
    settings: Settings,
) -> Posterior:
    barred: set[int] = set()
    for step in range(settings.most_steps):
        open_ = tuple(
            h
            for h in candidates
            if id(h) not in barred and not any(h.key == c.key for c in now.chosen)
        )
        if not open_:
            break
        gains = evidence.gains(now, open_) - np.array([h.odds for h in open_])
        best = int(np.argmax(gains))
        if gains[best] <= 0:
            break
        added = open_[best]
        after = evidence.posterior((*now.chosen, added))
        refined = _relinearised(residual, evidence, after, added)
        theta = refined.of(refined.chosen[-1])[0]
        if not added.effect.possible(residual.context, added.place, theta):
            barred.add(id(added))
            continue
        evidence.learn(refined)
        now = evidence.posterior(refined.chosen)
        now = _bounded(residual, evidence, now)
        now = _pruned(evidence, now)
    return _pruned(evidence, _learned(evidence, now.chosen, 2))


def _relinearised(residual, evidence, now: Posterior, h: Hypothesis) -> Posterior:
    """Secant columns at the value found: exact for an offset of degrees, a delay of many samples."""
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
            if h.effect is not None and not h.ordinary
        ]
        if not loss or min(loss)[0] >= -1.0:
            return now
        out = min(loss)[1]
        now = evidence.posterior(tuple(h for k, h in enumerate(now.chosen) if k != out))
