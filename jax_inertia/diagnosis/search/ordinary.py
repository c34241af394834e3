"""Ordinary physics of every joint at once, with the tolerances of the model: posterior and calibrated model."""

import dataclasses
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from jax_inertia.diagnosis.effects.base import Effect, Place
from jax_inertia.diagnosis.effects.dry_friction import (
    CoulombFriction,
    FrictionForms,
    StatedFriction,
)
from jax_inertia.diagnosis.effects.tolerances import InertialTolerances, StatedNumbers
from jax_inertia.diagnosis.hypothesis import Hypothesis, hypothesis
from jax_inertia.diagnosis.residual import Ordinary, Residual
from jax_inertia.diagnosis.search.candidates import make
from jax_inertia.diagnosis.search.evidence import Evidence, Posterior
from jax_inertia.diagnosis.settings import CalibrationState, Settings
from jax_inertia.signals.held import timing_of


class OrdinaryPhysics(NamedTuple):
    """Posterior of every joint's ordinary numbers, nothing odd in it."""

    evidence: Evidence
    posterior: Posterior
    tried: tuple[Hypothesis, ...]
    """Those included that no robot can have at their best values."""


def ordinary_physics(
    residual: Residual, library: tuple[Effect, ...], settings: Settings, state: CalibrationState
) -> OrdinaryPhysics:
    """Fit every joint's friction, rotor inertia and offset at once, with tolerances and mild forms of friction.

    Of a calibrated model the tolerances alone: of inertials, of joints' numbers and of how friction turns round.
    """
    gap = np.sqrt(
        np.mean(residual.weight * residual.y**2, axis=0)
        / np.maximum(residual.weight.mean(axis=0), 1e-9)
    )
    least = np.maximum(residual.sensors, settings.least_variance * gap) + 1e-9
    evidence = Evidence(residual.y, residual.weight, least)
    dry = next((e for e in library if isinstance(e, CoulombFriction)), None)
    if state is CalibrationState.CALIBRATED:
        return _calibrated(residual, evidence, settings)
    chosen = [tolerances(residual, settings)]
    for effect in library:
        if effect.ordinary and effect is not dry:
            chosen += [
                make(residual, effect, place, (), settings)
                for place in effect.places(residual.context)
            ]
    if dry is not None:
        for place in dry.places(residual.context):
            before = evidence.posterior(tuple(chosen))
            chosen += _turning(residual, evidence, before, dry, place, settings)
    now = learned(evidence, tuple(chosen), 4)
    now = bounded(residual, evidence, now)
    forms = _forms(residual, now, presliding_of(chosen), settings)
    now = learned(evidence, (*now.chosen, *forms), 2)
    return OrdinaryPhysics(evidence, now, tuple(chosen[1:]))


def _calibrated(residual: Residual, evidence: Evidence, settings: Settings) -> OrdinaryPhysics:
    numbers, stated = StatedNumbers(), StatedFriction()
    chosen = [tolerances(residual, settings, CalibrationState.CALIBRATED)]
    chosen += [
        hypothesis(residual, numbers, place, (settings.calibrated_number,), 0.0)
        for place in numbers.places(residual.context)
    ]
    for place in stated.places(residual.context):
        before = evidence.posterior(tuple(chosen))
        chosen += _turning(residual, evidence, before, stated, place, settings)
    return OrdinaryPhysics(evidence, learned(evidence, tuple(chosen), 4), ())


def presliding_of(chosen: Iterable[Hypothesis]) -> dict[int, float]:
    """Displacement over which each row's dry friction turns round [rad]."""
    return {h.place.index: h.shape[0] for h in chosen if isinstance(h.effect, CoulombFriction)}


def tolerances(
    residual: Residual,
    settings: Settings,
    state: CalibrationState = CalibrationState.AS_BOUGHT,
) -> Hypothesis:
    """Errors of the nominal inertials, marginalised in every hypothesis."""
    place = Place("global", "global", -1)
    com = settings.com_tolerance * residual.context.scale
    com = com if settings.com_stated is None else settings.com_stated
    own = settings.mass_tolerance, com, settings.inertia_tolerance
    if state is CalibrationState.CALIBRATED and settings.com_stated is None:
        own = settings.calibrated_mass, com, settings.calibrated_inertia
    log = residual.log
    shape = (*own, timing_of(log).error, settings.tolerance_numbers, 1.0 / log.rate)
    return hypothesis(residual, InertialTolerances(), place, shape, 0.0)


def _turning(residual, evidence, now: Posterior, dry, place, settings) -> tuple[Hypothesis, ...]:
    """The joint's dry friction with the presliding displacement of most evidence, with the model's own."""
    shapes = list(dry.shapes(residual.context, place))
    tried = [_alike(residual, dry, place, shape, settings) for shape in shapes]
    gains = evidence.gains(now, [joined(both) for both in tried])
    return tried[int(np.argmax(gains))]


def _alike(residual, dry: Effect, place: Place, shape, settings) -> tuple[Hypothesis, ...]:
    """Dry friction beyond the model's own and, where the model states some, how that turns round: over one way."""
    stated = StatedFriction()
    there = not isinstance(dry, StatedFriction) and place in stated.places(residual.context)
    beside = [stated] if there else []
    return tuple(make(residual, effect, place, shape, settings) for effect in (dry, *beside))


def joined(group: tuple[Hypothesis, ...]) -> Hypothesis:
    """Hypotheses of one row as one, to be compared with another such group: named as the first of them."""
    columns = np.concatenate([h.columns for h in group], axis=1)
    scale = np.concatenate([h.scale for h in group])
    return dataclasses.replace(group[0], columns=columns, scale=scale)


def bounded(residual: Residual, evidence: Evidence, now: Posterior) -> Posterior:
    """Without effects that would be less than nothing: a friction that drives, a load that lifts."""
    while True:
        wrong = [h for h in now.chosen if not h.possible(residual, now.of(h)[0])]
        if not wrong:
            return now
        # One at a time: what drives at one joint may stand in for what does at another.
        sure = [abs(float(now.of(h)[0][0] / np.sqrt(now.of(h)[1][0, 0]))) for h in wrong]
        worst = wrong[int(np.argmax(sure))]
        now = now.without(worst)


def learned(evidence: Evidence, chosen: tuple[Hypothesis, ...], rounds: int) -> Posterior:
    """Posterior, noise of the rows and scale of the model's tolerances in turn."""
    now = evidence.posterior(chosen)
    for _ in range(rounds):
        evidence.learn(now)
        now = evidence.posterior(_rescaled(now))
    return now


FAR_OFF = 2.0
"""Tolerances from which a number's error says nothing of the others': a drawing that is further off is another one."""


def _rescaled(now: Posterior) -> tuple[Hypothesis, ...]:
    """The chosen, with the model's tolerances as large as its numbers are off, kind by kind: masses, centres, inertias.

    λ² = (ν + Σ min(z², (c λ)²)) / (ν + Σ γ): MacKay's update (Neural Computation 4(3), 1992) with Huber's bound, so
    that one number far off is an effect's and no tolerance. z: errors in units of the stated tolerance, γ: how much of
    each the log determines, ν: `Settings.tolerance_numbers`.
    """
    out = []
    for h, part in zip(now.chosen, now.slices, strict=True):
        if isinstance(h.effect, InertialTolerances):
            error = now.mean[part] * h.scale
            learned = 1.0 - np.diag(now.covariance)[part]
            kinds, stated = h.effect.kinds(h.count), h.shape[4]
            scale = h.scale.copy()
            for kind in range(3):
                of = kinds == kind
                within = np.minimum(error[of] ** 2, (FAR_OFF * scale[of]) ** 2)
                scale[of] = np.sqrt((stated + within.sum()) / (stated + learned[of].sum()))
            h = dataclasses.replace(h, scale=scale)
        out.append(h)
    return tuple(out)


def reconsidered(
    residual: Residual, evidence: Evidence, now: Posterior, tried: tuple[Hypothesis, ...], settings
) -> Posterior:
    """Given what was found: ordinary effects that no robot could have had before, and each presliding again."""
    missing = tuple(h for h in tried if h.key not in {c.key for c in now.chosen})
    now = bounded(residual, evidence, evidence.posterior((*now.chosen, *missing)))
    for h in now.chosen:
        if not isinstance(h.effect, CoulombFriction | StatedFriction) or not _leads(now, h):
            continue
        own = tuple(c for c in now.chosen if _one_joints_dry(c, h))
        rest = evidence.posterior(tuple(c for c in now.chosen if c not in own))
        best = _turning(residual, evidence, rest, h.effect, h.place, settings)
        gains = evidence.gains(rest, (joined(own), joined(best)))
        if best[0].shape != h.shape and bool(np.diff(gains)[0] > ANOTHER):
            now = evidence.posterior((*rest.chosen, *best))
    return learned(evidence, now.chosen, 1)


ANOTHER = 2.0
"""Nats by which another presliding displacement must do better: less is a tie."""


def ordinary_of(residual: Residual, now: Posterior) -> Ordinary:
    """Ordinary numbers at the posterior mean, by row."""
    values = {family: np.zeros(residual.robot.nv) for family in (*FRICTION, "armature")}
    for h in now.chosen:
        if h.family in values:
            values[h.family][h.place.index] = now.of(h)[0][0]
    return Ordinary(*(np.maximum(x, 0.0) for x in values.values()))


FRICTION = ("viscous_friction", "coulomb_friction")


def _leads(now: Posterior, h: Hypothesis) -> bool:
    """Whether a joint's presliding is that of `h`: of its dry friction, of the model's own where that is calibrated."""
    bought = any(c.ordinary for c in now.chosen)
    return h.ordinary if bought else isinstance(h.effect, StatedFriction)


def _one_joints_dry(c: Hypothesis, dry: Hypothesis) -> bool:
    """Whether `c` is a joint's dry friction, beyond the model's own or that."""
    return c is dry or (isinstance(c.effect, StatedFriction) and c.place == dry.place)


def _forms(residual, now: Posterior, presliding: dict[int, float], settings) -> list[Hypothesis]:
    """Mild forms of each joint's friction, in proportion to its ordinary friction."""
    out = []
    effect = FrictionForms()
    for name, row in residual.context.joint_dofs.items():
        own = [
            now.torque(h)[:, row]
            for h in now.chosen
            if h.family in FRICTION and h.place.index == row and h.place.kind == "joint"
        ]
        # A joint at rest for good has none.
        if np.any(own):
            level = float(np.sqrt(np.mean(sum(own) ** 2)))
            place = Place("joint", name, row)
            out.append(make(residual, effect, place, (presliding.get(row, 0.0), level), settings))
    return out
