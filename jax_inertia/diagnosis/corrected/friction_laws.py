"""Friction laws of every joint from a posterior, and the numbers of a MuJoCo joint that come nearest to each."""

import dataclasses

import numpy as np
from jaxtyping import Float
from scipy.optimize import lsq_linear

from jax_inertia.diagnosis.corrected.motor_gains import after_gain
from jax_inertia.diagnosis.effects.base import OF_SLIDE, Interval, Term, Terms
from jax_inertia.diagnosis.effects.dry_friction import DryFriction, bristle_of
from jax_inertia.diagnosis.effects.friction_forms import StatedFriction
from jax_inertia.diagnosis.features.context import Context
from jax_inertia.diagnosis.friction_curve import UNITS, FrictionCurve, Moving, curve_forms
from jax_inertia.diagnosis.hypothesis import Hypothesis
from jax_inertia.diagnosis.search.selection import Selection

NEVER_NEGATIVE = frozenset({"viscous_friction", "coulomb_friction", "quadratic_viscous"})
NEAREST = ("viscous_friction", "coulomb_friction", "torque_bias", "quadratic_viscous")
"""What attributes of a MuJoCo joint hold of a friction law."""


def _portable(term: Term, context: Context, row: int) -> Term:
    """A bristle that stands for MuJoCo's creep, by the speed at which it creeps: its softness is one model's."""
    if term.form == "bristle" and term.scale < 0.0:
        return Term("creep", context.creep_speed(row, -term.scale))
    return term


@dataclasses.dataclass(frozen=True)
class _Linear:
    """Terms of a joint's friction law as a linear function of the posterior's numbers."""

    main: Term
    terms: tuple[Term, ...]
    own: Float[np.ndarray, " k"]
    """What the model states of each."""
    mean: Float[np.ndarray, " k"]
    """What was found beyond it."""
    slopes: Float[np.ndarray, "k p"]
    effects: dict[Term, str]


def _law(selection: Selection, name: str, row: int, *, laws: bool) -> _Linear:
    """A joint's law; `laws`: with what listed effects other than a level and a slope add to it."""
    now, context = selection.posterior, selection.residual.context
    parts: list[tuple[Terms, np.ndarray]] = []
    effects: dict[Term, str] = {}
    main, some = None, None
    for h, part in zip(now.chosen, now.slices, strict=True):
        if h.place.kind != "joint" or h.place.name != name:
            continue
        every = _terms_of(h, context)
        if not any(every):
            continue
        some = some or h
        if isinstance(h.effect, DryFriction | StatedFriction) and (h.ordinary or main is None):
            main = _portable(bristle_of(*h.shape[:2]), context, row)
        other = h.is_odd and not h.effect.ordinary
        if other and not laws:
            continue
        for k, terms in enumerate(every):
            slope = np.zeros(len(now.mean))
            slope[part.start + k] = h.scale[k]
            parts.append((terms, slope))
            if other and h.named:
                effects |= dict.fromkeys(terms, h.family)
    main = main or bristle_of(0.0)
    stated = {
        bristle_of(0.0): float(context.frictionloss[row]),
        Term("viscous"): float(context.damping[row]),
    }
    named = [main, *stated, *(term for terms, _ in parts for term in terms)]
    terms = tuple(dict.fromkeys(named))
    at = {term: k for k, term in enumerate(terms)}
    slopes = np.zeros((len(terms), len(now.mean)))
    for changed, slope in parts:
        for term, share in changed.items():
            slopes[at[term]] += share * slope
    own = np.array([stated.get(term, 0.0) for term in terms])
    mean = slopes @ now.mean
    if some is not None:
        mean, slopes = after_gain(selection, some, slopes)
    return _Linear(main, terms, own, mean, slopes, effects)


def _terms_of(h: Hypothesis, context: Context) -> tuple[Terms, ...]:
    every = h.effect.friction_terms(context, h.place, h.shape)
    if h.level is not None and every:
        every = (*h.level.friction_terms(context, h.place, h.shape), *every)
    row = h.place.index
    return tuple({_portable(term, context, row): x for term, x in one.items()} for one in every)


def friction_curves(selection: Selection) -> dict[str, FrictionCurve]:
    """The friction law of every joint, the model's own part included."""
    covariance = selection.posterior.covariance + selection.spread
    context, out = selection.residual.context, {}
    for name, row in context.joint_dofs.items():
        law = _law(selection, name, row, laws=True)
        half = 1.96 * np.sqrt(np.einsum("kp,pq,kq->k", law.slopes, covariance, law.slopes))
        terms = {}
        for term, value, width in zip(law.terms, law.own + law.mean, half, strict=True):
            unit = UNITS[term.form]
            unit = unit if selection.residual.rotates(row) else OF_SLIDE.get(unit, unit)
            if value or width or term == law.main:
                terms[term] = Interval(
                    float(value), float(value - width), float(value + width), unit
                )
        near = nearest_numbers(selection, name, row)
        taken = near["torque_bias"][1]
        if taken:
            unit = "N m" if selection.residual.rotates(row) else "N"
            terms[Term("constant")] = Interval(taken, taken, taken, unit)
        quadratic = near["quadratic_viscous"][1]
        out[name] = FrictionCurve(law.main, terms, law.effects, quadratic)
    return out


def nearest_numbers(
    selection: Selection, name: str, row: int
) -> dict[str, tuple[float, float, Float[np.ndarray, " p"]]]:
    """What MuJoCo's own attributes should hold of a joint's law: (the model's, what is beyond it, its slopes).

    Level, slope, constant torque and quadratic slope, by family: those that come nearest over the rows in which the
    joint moves, least squares with no number of friction below zero. A constant torque's is that of the law alone.
    """
    law = _law(selection, name, row, laws=False)
    context, residual = selection.residual.context, selection.residual
    moving = Moving.along(residual.beside if residual.loaded else context, row)
    fast = curve_forms(law.main, law.terms, moving)
    target = np.stack(
        [
            context.v[:, row],
            moving.direction(law.main),
            -np.ones(len(fast)),
            np.abs(context.v[:, row]) * context.v[:, row],
        ],
        axis=1,
    )
    root = np.sqrt(residual.shown(row))[:, None]
    both = residual.prepared.finish(np.concatenate([fast, target], axis=1)) * root
    forms, columns = both[:, : fast.shape[1]], both[:, fast.shape[1] :]
    size = np.maximum(np.sqrt(np.mean(columns**2, axis=0)), 1e-12)
    # A joint that hardly moves shows next to nothing of a law.
    seen = [k for k in range(len(NEAREST)) if size[k] > 1e-9]
    if any(h.family == "quadratic_viscous" and h.place.name == name for h in selection.odd):
        seen = [k for k in seen if NEAREST[k] != "quadratic_viscous"]
    whole = forms @ (law.own + law.mean)
    least = [0.0 if NEAREST[k] in NEVER_NEGATIVE else -np.inf for k in seen]
    # By active sets: those that end at their bound are zero, and the others their own least squares.
    found = lsq_linear(columns[:, seen] / size[seen], whole, (least, np.inf), method="bvls")
    free = [k for k, bound in zip(seen, found.active_mask, strict=True) if bound == 0]
    own = (float(context.damping[row]), float(context.frictionloss[row]), 0.0, 0.0)
    share, every = np.zeros((2, len(NEAREST), len(law.terms)))
    for part, asked in ((share, free), (every, seen)):
        part[asked] = np.linalg.lstsq(columns[:, asked] / size[asked], forms, rcond=1e-9)[0]
    share, every = share / size[:, None], every / size[:, None]
    numbers = share @ (law.own + law.mean)
    # How uncertain a number at its bound is, says the fit without bounds.
    every[free] = share[free]
    return {
        family: (own[k], float(numbers[k]) - own[k], every[k] @ law.slopes)
        for k, family in enumerate(NEAREST)
    }
