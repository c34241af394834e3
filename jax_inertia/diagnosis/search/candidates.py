"""Candidates for the search, each with its prior odds: effects at every place and number, pushes where they gain."""

import numpy as np

from jax_inertia.diagnosis.effects.base import Effect, Place
from jax_inertia.diagnosis.effects.dry_friction import DryFriction
from jax_inertia.diagnosis.hypothesis import Hypothesis, hypothesis
from jax_inertia.diagnosis.search.evidence import Evidence, Posterior
from jax_inertia.diagnosis.search.pushes import FLANK, windows
from jax_inertia.diagnosis.settings import Settings


def make(residual, effect: Effect, place: Place, shape, settings: Settings) -> Hypothesis:
    """An effect at a place, with the prior odds of its kind."""
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


def candidates(residual, library, presliding: dict[int, float], settings):
    """Every effect that is not ordinary, everywhere and on the whole grid; `presliding` of each row [rad]."""
    for effect in library:
        if effect.ordinary:
            continue
        for place in effect.places(residual.context):
            for shape in effect.shapes(residual.context, place):
                # All forms of a joint's dry friction turn round alike.
                if isinstance(effect, DryFriction) and shape[0] != presliding.get(
                    place.index, shape[0]
                ):
                    continue
                h = make(residual, effect, place, shape, settings)
                # What this motion does not show is no candidate.
                if np.any(np.abs(h.scaled) > 1e-9):
                    yield h


def pushes(residual, evidence: Evidence, now: Posterior, push: Effect, settings: Settings):
    """Pushes on every body in the windows that gain most, their ends tried apart."""
    place = Place("body", residual.robot.body_names[0], 0)
    scale = float(push.scale(residual.context, place, ())[0])
    for start, end in windows(residual, evidence, now, scale, settings.odd_odds):
        length = end - start
        for early in (-0.3, 0.0, 0.3):
            for late in (-0.3, 0.0, 0.3):
                shape = (start + early * length, end + late * length, FLANK, 0.0)
                for place in push.places(residual.context):
                    yield make(residual, push, place, shape, settings)
