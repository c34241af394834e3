"""Ordinary physics of every joint at once, with the tolerances of the model: posterior and calibrated model."""

import copy
import dataclasses
from collections import defaultdict
from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool
from scipy.optimize import minimize_scalar

from jax_inertia.diagnosis.effects.actuator import Late
from jax_inertia.diagnosis.effects.base import Effect, Place
from jax_inertia.diagnosis.effects.dry_friction import CoulombFriction
from jax_inertia.diagnosis.effects.encoder import TwoMass
from jax_inertia.diagnosis.effects.friction_forms import (
    FrictionForms,
    FrictionTurning,
    StatedFriction,
)
from jax_inertia.diagnosis.effects.ground import places_of_ground
from jax_inertia.diagnosis.effects.tolerances import TIMING, InertialTolerances, StatedNumbers
from jax_inertia.diagnosis.hypothesis import Hypothesis, hypothesis, reshaped
from jax_inertia.diagnosis.residual import Ordinary, Residual
from jax_inertia.diagnosis.search.candidates import assumes, make
from jax_inertia.diagnosis.search.evidence import Evidence, Posterior
from jax_inertia.diagnosis.settings import CalibrationState, Settings
from jax_inertia.logs.schema import TorqueKind
from jax_inertia.signals.held import HOLD_ERROR, timing_of


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
    exact = state is CalibrationState.CALIBRATED
    noise, least = residual.sensors + 1e-9, settings.least_variance
    evidence = Evidence(residual.y, residual.weight, noise, least=least, exact=exact)
    dry = next((e for e in library if isinstance(e, CoulombFriction)), None)
    if exact:
        return _calibrated(residual, evidence, settings)
    never_exact = [tolerances(residual, settings), *_ground(residual)]
    chosen = list(never_exact)
    for effect in library:
        if effect.ordinary and effect is not dry:
            chosen += [
                make(residual, effect, place, (), settings)
                for place in effect.places(residual.context)
                if assumes(residual, effect, place)
            ]
    if dry is not None:
        for place in dry.places(residual.context):
            before = evidence.posterior(tuple(chosen))
            chosen += _turning(residual, evidence, before, dry, place, settings)
    now = learned(evidence, tuple(chosen), 4)
    now = bounded(residual, evidence, now)
    plain = now.chosen
    for _ in range(2):
        # What is mild is so in proportion to a friction that is itself known with its forms alone.
        forms = _forms(residual, now, presliding_of(chosen), settings)
        now = learned(evidence, (*plain, *forms), 2)
    tried = tuple(chosen[len(never_exact) :])
    return OrdinaryPhysics(evidence, reconsidered(residual, evidence, now, tried, settings), tried)


def _calibrated(residual: Residual, evidence: Evidence, settings: Settings) -> OrdinaryPhysics:
    numbers, stated = StatedNumbers(), StatedFriction()
    own = settings.calibrated_number, settings.calibrated_inertia, settings.calibrated_numbers
    chosen = [tolerances(residual, settings, CalibrationState.CALIBRATED), *_ground(residual)]
    chosen += [
        hypothesis(residual, numbers, place, own, 0.0) for place in numbers.places(residual.context)
    ]
    for place in stated.places(residual.context):
        before = evidence.posterior(tuple(chosen))
        chosen += _turning(residual, evidence, before, stated, place, settings)
    return OrdinaryPhysics(evidence, learned(evidence, tuple(chosen), 4), ())


def in_time(residual: Residual, evidence: Evidence, now: Posterior) -> Posterior:
    """Without a tolerance of when torques act where, but for a delay, they did so at no moment that stamps may mean.

    A normal prior lets a delay of a sample and a half pass for stamps that are six standard deviations off. Such a one
    is the robot's: what judges whether it is a cause must not have them to fall back on, nor what is stated.
    """
    base = next(h for h in now.chosen if isinstance(h.effect, InertialTolerances))
    error, most, rest = base.shape[3], base.shape[7], now
    for h in now.chosen:
        if isinstance(h.effect, Late):
            rest = rest.without(h)
    # Each end of what stamps may mean is itself known to `HOLD_ERROR` of a period.
    if abs(error * rest.mean[rest.part(base)][TIMING]) <= most + 2.0 * HOLD_ERROR:
        return now
    stamped = reshaped(base, residual, (*base.shape[:3], 0.0, *base.shape[4:]))
    return learned(evidence, tuple(stamped if h is base else h for h in now.chosen), 1)


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
    counts_for, most = settings.tolerance_numbers, np.inf
    if state is CalibrationState.CALIBRATED and settings.com_stated is None:
        # What is further off is no calibrated model.
        own = settings.calibrated_mass, com, settings.calibrated_inertia
        counts_for, most = settings.calibrated_numbers, 1.0
    log, timing = residual.log, timing_of(residual.log)
    shape = (*own, timing.error, counts_for, 1.0 / log.rate, most, timing.most)
    return hypothesis(residual, InertialTolerances(), place, shape, 0.0)


def _ground(residual: Residual) -> list[Hypothesis]:
    """What is never exact of forces of the ground."""
    every = places_of_ground(residual.context, 1.0 / residual.log.rate)
    return [hypothesis(residual, *one, 0.0) for one in every]


def _turning(
    residual, evidence, now: Posterior, dry, place, settings, forms: tuple[Hypothesis, ...] = ()
) -> tuple[Hypothesis, ...]:
    """The joint's dry friction with the presliding displacement of most evidence, with the model's own and `forms`."""

    def of(shape) -> tuple[Hypothesis, ...]:
        alike = _alike(residual, dry, place, shape, settings)
        return *alike, *(reshaped(f, residual, (shape[0], *f.shape[1:])) for f in forms)

    tried = [of(shape) for shape in dry.shapes(residual.context, place)]
    gains = evidence.gains(now, [joined(each) for each in tried])
    best = tried[int(np.argmax(gains))]
    creeps = isinstance(dry, CoulombFriction) and best[0].shape[0] < 0.0
    return _creeping(evidence, now, best, of) if creeps else best


def _creeping(evidence, now: Posterior, dry: tuple[Hypothesis, ...], of) -> tuple[Hypothesis, ...]:
    """Dry friction that creeps, by the level of most evidence between its grid's points; `of` lays one by its shape."""
    level, *way = dry[0].shape

    def at(share: float) -> tuple[Hypothesis, ...]:
        return of((level * float(np.exp(share)), *way))

    def loss(share: float) -> float:
        return -float(evidence.gains(now, (joined(at(share)),))[0])

    best = minimize_scalar(loss, bounds=LEVELS, method="bounded", options={"maxiter": 12})
    return at(float(best.x)) if best.fun < loss(0.0) else dry


LEVELS = -1.2, 1.2
"""ln of how far from its grid's point the level of a friction that creeps is sought: to the next points."""


def _alike(residual, dry: Effect, place: Place, shape, settings) -> tuple[Hypothesis, ...]:
    """Dry friction beyond the model's own and, where the model states some, how that turns round: over one way."""
    stated = StatedFriction()
    there = not isinstance(dry, StatedFriction) and place in stated.places(residual.context)
    beside = [stated] if there else []
    return tuple(make(residual, effect, place, shape, settings) for effect in (dry, *beside))


def joined(group: tuple[Hypothesis, ...]) -> Hypothesis:
    """Hypotheses of one row as one, to be compared with another such group: named as the first of them."""
    columns = np.concatenate([h.columns for h in group], axis=-1)
    scale, mean = (np.concatenate(x) for x in zip(*((h.scale, h.mean) for h in group), strict=True))
    return dataclasses.replace(group[0], columns=columns, scale=scale, mean=mean)


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


def relearned_evidence(evidence: Evidence, now: Posterior) -> float:
    """Log evidence of some hypotheses with variances and tolerances learned with them, their prior in it, nats.

    `Evidence.gains` asks by those that are there: what explains most of a row, they take for as large as noise.
    """
    evidence = copy.copy(evidence)
    for _ in range(RELEARNING):
        evidence.learn(now, memory=False)
        now = evidence.posterior(_rescaled(now))
    of_sizes = sum(
        -0.5 * numbers * (np.log(size**2) + size**-2.0) for size, numbers, _ in _sizes(now).values()
    )
    return now.log_evidence + of_sizes - sum(map(evidence.unsaid, now.chosen))


RELEARNING = 4
"""Rounds of it."""


def _rescaled(now: Posterior) -> tuple[Hypothesis, ...]:
    """The chosen, with the model's tolerances as large as its numbers are off, kind by kind: masses, centres, inertias.

    λ² = (ν + Σ min(z², (c λ)²)) / (ν + Σ γ): MacKay's update (Neural Computation 4(3), 1992) with Huber's bound, so
    that one number far off is an effect's and no tolerance. z: errors in units of the stated tolerance, γ: how much of
    each the log determines, ν: how many measured numbers the stated tolerance counts for (`Settings`), which makes
    λ's prior ∝ λ^−ν exp(−ν / 2 λ²).
    """
    off, told = defaultdict(float), defaultdict(float)
    for h, part in zip(now.chosen, now.slices, strict=True):
        error, learned = now.mean[part] * h.scale, 1.0 - np.diag(now.covariance)[part]
        within = np.minimum(error**2, (FAR_OFF * h.scale) ** 2)
        for key, of in _kinds(h):
            off[key] += float(within[of].sum())
            told[key] += float(learned[of].sum())
    sizes = {
        key: min(float(np.sqrt((numbers + off[key]) / (numbers + told[key]))), most)
        for key, (_, numbers, most) in _sizes(now).items()
    }
    return tuple(_of_size(h, sizes) for h in now.chosen)


Kind = tuple[type[Effect], int]


def _kinds(h: Hypothesis) -> list[tuple[Kind, Bool[np.ndarray, " k"]]]:
    """Kinds of a tolerance's numbers of which the log says how large they are, and which are of each."""
    kinds = h.effect.kinds(h.count)
    return [((type(h.effect), int(k)), kinds == k) for k in np.unique(kinds[kinds >= 0])]


def _sizes(now: Posterior) -> dict[Kind, tuple[float, float, float]]:
    """Of each kind of tolerance its size, of what is stated, for how many numbers that counts, and the largest."""
    return {
        key: (float(h.scale[of][0]), *h.effect.size_prior(h.shape))
        for h in now.chosen
        for key, of in _kinds(h)
    }


def _of_size(h: Hypothesis, sizes: dict[Kind, float]) -> Hypothesis:
    scale = h.scale.copy()
    for key, of in _kinds(h):
        scale[of] = sizes[key]
    return dataclasses.replace(h, scale=scale) if _kinds(h) else h


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
        # Mild forms turn round as the joint's dry friction does: laid over another way, they would turn it back.
        forms = tuple(
            c for c in now.chosen if isinstance(c.effect, FrictionForms) and c.place == h.place
        )
        rest = evidence.posterior(tuple(c for c in now.chosen if c not in (*own, *forms)))
        best = _turning(residual, evidence, rest, h.effect, h.place, settings, forms)
        gains = evidence.gains(rest, (joined((*own, *forms)), joined(best)))
        if best[0].shape != h.shape and bool(np.diff(gains)[0] > ANOTHER):
            now = evidence.posterior((*rest.chosen, *best))
    return learned(evidence, now.chosen, 1)


ANOTHER = 2.0
"""Nats by which another presliding displacement must do better: less is a tie."""


def ordinary_of(residual: Residual, now: Posterior) -> Ordinary:
    """Ordinary numbers at the posterior mean, by row."""
    values = {family: np.zeros(residual.robot.nv) for family in (*FRICTION, "armature")}
    offset = np.zeros(residual.robot.nv)
    for h in now.chosen:
        if h.family in values:
            values[h.family][h.place.index] = now.of(h)[0][0]
        # Of a sensor behind the gear it is the sensor's zero, and moves nothing.
        elif h.family == "torque_bias" and residual.log.tau_kind is not TorqueKind.SENSOR:
            offset[h.place.index] = now.of(h)[0][0]
    viscous, coulomb, armature = (np.maximum(x, 0.0) for x in values.values())
    return Ordinary(viscous, coulomb, armature, offset)


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
        place = Place("joint", name, row)
        own = [h for h in now.chosen if h.family in FRICTION and h.place == place]
        level = float(np.sqrt(np.mean(sum((now.torque(h)[:, row] for h in own), start=0.0) ** 2)))
        # A joint at rest for good has none.
        if level > 0:
            dry = [h for h in own if isinstance(h.effect, CoulombFriction)]
            coulomb = sum((float(now.of(h)[0][0]) for h in dry), start=0.0)
            shape = (presliding.get(row, 0.0), level, coulomb)
            out.append(make(residual, effect, place, shape, settings))
    return out


def _stated(residual: Residual, now: Posterior) -> Iterator[Hypothesis]:
    """The form of each joint's stated friction, where that is not its link's."""
    effect = StatedFriction()
    there = {h.place: h for h in now.chosen if isinstance(h.effect, StatedFriction)}
    of_links = {
        h.place for h in now.chosen if isinstance(h.effect, TwoMass) and h.effect.rubs_link(h.shape)
    }
    for place in effect.places(residual.context):
        if place not in of_links:
            shape = next(iter(effect.shapes(residual.context, place)))
            yield there.get(place) or hypothesis(residual, effect, place, shape, 0.0)


def with_turning(residual: Residual, now: Posterior) -> tuple[Hypothesis, ...]:
    """The chosen; with dry friction that was found beyond a calibrated model's comes how it turns round.

    How a stated one does is of the joint's motion: a friction that is a link's holds that along its own path.
    """
    kept = [h for h in now.chosen if not isinstance(h.effect, FrictionTurning | StatedFriction)]
    kept += _stated(residual, now)
    there = {(h.place, h.shape[:2]): h for h in now.chosen if isinstance(h.effect, FrictionTurning)}
    for h in now.chosen:
        if h.fills == CoulombFriction.name:
            way = h.shape[:2]
            # Rms over rows, since forces of the ground may take it from the joint's own.
            level = float(np.sqrt(np.mean(np.sum(now.torque(h) ** 2, axis=1))))
            own = there.get((h.place, way))
            kept.append(own or hypothesis(residual, FrictionTurning(), h.place, (*way, level), 0.0))
    return tuple(kept)
