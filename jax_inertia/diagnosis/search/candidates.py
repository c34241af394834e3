"""Candidates for the search, each with its prior odds: effects at every place and number, pushes where they gain."""

from collections.abc import Sequence

import numpy as np

from jax_inertia.diagnosis.effects.base import Effect, Place
from jax_inertia.diagnosis.effects.dry_friction import DryFriction
from jax_inertia.diagnosis.effects.inertial import Payload
from jax_inertia.diagnosis.hypothesis import Hypothesis, foreseen, hypothesis
from jax_inertia.diagnosis.search.evidence import Evidence, Posterior
from jax_inertia.diagnosis.search.pushes import FLANK, windows
from jax_inertia.diagnosis.settings import CalibrationState, Settings
from jax_inertia.signals.ground.support import BASE


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
    Where forces of the ground are not measured, all but ordinary physics and what the base itself carries is rarer.
    """
    bought = state is CalibrationState.AS_BOUGHT
    assumed = bought and assumes(residual, effect, place)
    if effect.ordinary:
        odds = settings.ordinary_odds if assumed else settings.odd_odds
    elif effect.refines:
        odds = settings.refinement_odds
        if not bought:
            odds += settings.odd_odds - (settings.ordinary_odds if effect.level else odds)
    else:
        odds = settings.odd_odds if effect.named else settings.generic_odds
    if not assumed and not _weighs(residual, effect, place):
        odds = max(odds, _unmeasured(residual, settings))
    level = _level(effect, state, library)
    return hypothesis(residual, effect, place, shape, odds, level, assumed=assumed)


def assumes(residual, effect: Effect, place: Place) -> bool:
    """Whether every robot as it is bought has an effect at a place, and every hypothesis about such a one with it.

    The torques of a leg that stands say what the robot weighs: what is constant there passes for weight, and is no more
    assumed than another weight is.
    """
    weighs = effect.constant and residual.prepared.spreads(place.index)
    return effect.ordinary and not weighs


def _weighs(residual, effect: Effect, place: Place) -> bool:
    """Whether an effect is a load of the base itself: its feet bear it in the mean, whatever they do."""
    return isinstance(effect, Payload) and not np.any(
        residual.robot.topology.body_dof[place.index][BASE:] > 0
    )


def _stands(residual, place: Place) -> bool:
    """Whether a body is of a leg by whose torques the ground's force is taken."""
    rows = np.flatnonzero(residual.robot.topology.body_dof[place.index])
    return any(residual.prepared.spreads(int(row)) for row in rows if row >= BASE)


def _unmeasured(residual, settings: Settings) -> float:
    """Least prior log odds against what is odd of a robot on forces that are not measured, nats; 0 of others."""
    return settings.unmeasured_odds if residual.prepared.support is not None else 0.0


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
        context = residual.context_of(effect)
        for place in effect.places(context):
            if bought and assumes(residual, effect, place):
                continue
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
    """Pushes on every body in the windows that gain most, their ends tried apart.

    But on none of a leg that stands on forces that are not measured: what slips or gives there pushes it as well.
    """
    places = [p for p in push.places(residual.context) if not _stands(residual, p)]
    if not places:
        return
    scale = float(push.scale(residual.context, places[0], ())[0])
    odds = max(settings.odd_odds, _unmeasured(residual, settings))
    found, odds = windows(residual, evidence, now, scale, odds, [p.index for p in places])
    for start, end in found:
        length = end - start
        for early in (-0.3, 0.0, 0.3):
            for late in (-0.3, 0.0, 0.3):
                shape = (start + early * length, end + late * length, FLANK, 0.0)
                for place in places:
                    yield hypothesis(residual, push, place, shape, odds)
