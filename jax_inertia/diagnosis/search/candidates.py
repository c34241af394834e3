"""Candidates for the search, each with its prior odds: effects at every place and number, pushes where they gain."""

from collections.abc import Sequence

import numpy as np

from jax_inertia.diagnosis.effects.base import Effect, Place
from jax_inertia.diagnosis.effects.dry_friction import DryFriction
from jax_inertia.diagnosis.hypothesis import Hypothesis, foreseen, hypothesis
from jax_inertia.diagnosis.search.evidence import Evidence, Posterior
from jax_inertia.diagnosis.search.pushes import FLANK, windows
from jax_inertia.diagnosis.settings import CalibrationState, Settings


def make(
    residual,
    effect: Effect,
    place: Place,
    shape,
    settings: Settings,
    state: CalibrationState = CalibrationState.AS_BOUGHT,
    library: Sequence[Effect] = (),
) -> Hypothesis:
    """An effect at a place, with the prior odds of its kind.

    Of a calibrated model an ordinary effect is as rare as any other, and so is another form of one; what is a law with
    it comes with it from `library`, and is as much rarer as it is than the ordinary effect of a robot as it is bought.
    Where forces of the ground are not measured, all but ordinary physics is rarer.
    """
    bought = state is CalibrationState.AS_BOUGHT
    if effect.ordinary:
        odds = settings.ordinary_odds if bought else settings.odd_odds
    elif effect.refines:
        odds = settings.refinement_odds
        if not bought:
            odds += settings.odd_odds - (settings.ordinary_odds if effect.level else odds)
    else:
        odds = settings.odd_odds if effect.named else settings.generic_odds
    if residual.prepared.support is not None and not (bought and effect.ordinary):
        odds = max(odds, settings.unmeasured_odds)
    level = _level(effect, state, library)
    assumed = bought and effect.ordinary
    return hypothesis(residual, effect, place, shape, odds, level, assumed=assumed)


def _level(effect: Effect, state: CalibrationState, library: Sequence[Effect]) -> Effect | None:
    """The ordinary effect that is fitted as one law with it."""
    if state is CalibrationState.AS_BOUGHT:
        return None
    return next((e for e in library if e.name == effect.level), None)


def candidates(
    residual,
    library,
    presliding: dict[int, float],
    settings,
    state: CalibrationState = CalibrationState.AS_BOUGHT,
):
    """Every effect that is not assumed, everywhere and on the whole grid; `presliding` of each row [rad].

    Of a calibrated model, whatever dry friction is beyond its own may turn round in its own way.
    """
    bought = state is CalibrationState.AS_BOUGHT
    for effect in library:
        if effect.ordinary and bought:
            continue
        context = residual.context_of(effect)
        for place in effect.places(context):
            shapes = effect.shapes(context, place)
            if isinstance(effect, DryFriction) and place.index in presliding:
                # All forms of a joint's dry friction turn round alike, between a grid's points too.
                shapes = dict.fromkeys((presliding[place.index], *rest) for _, *rest in shapes)
            shapes = tuple(shapes)
            foreseen(residual, effect, place, shapes, _level(effect, state, library))
            for shape in shapes:
                h = make(residual, effect, place, shape, settings, state, library)
                # A torque that gives the ground's force and is cut off: how likely what is missing is, no row says.
                if h.cut is not None and h.row is None:
                    continue
                # What this motion does not show is no candidate.
                if np.any(np.abs(h.scaled) > 1e-9):
                    yield h


def pushes(residual, evidence: Evidence, now: Posterior, push: Effect, settings: Settings):
    """Pushes on every body in the windows that gain most, their ends tried apart."""
    place = Place("body", residual.robot.body_names[0], 0)
    scale = float(push.scale(residual.context, place, ())[0])
    found, odds = windows(residual, evidence, now, scale, settings.odd_odds)
    for start, end in found:
        length = end - start
        for early in (-0.3, 0.0, 0.3):
            for late in (-0.3, 0.0, 0.3):
                shape = (start + early * length, end + late * length, FLANK, 0.0)
                for place in push.places(residual.context):
                    yield hypothesis(residual, push, place, shape, odds)
