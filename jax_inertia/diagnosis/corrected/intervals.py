"""Numbers of effects with 95 % intervals: of each that is listed, and of every joint's ordinary physics."""

import dataclasses
from collections.abc import Iterator

import numpy as np

from jax_inertia.diagnosis.checks import rms
from jax_inertia.diagnosis.corrected.friction_laws import NEAREST, nearest_numbers
from jax_inertia.diagnosis.corrected.motor_gains import after_gain
from jax_inertia.diagnosis.effects.base import Interval
from jax_inertia.diagnosis.effects.friction_forms import FORM_TOLERANCE
from jax_inertia.diagnosis.effects.tolerances import STATED, StatedNumbers
from jax_inertia.diagnosis.features.context import Context
from jax_inertia.diagnosis.hypothesis import Hypothesis, reshaped
from jax_inertia.diagnosis.search.ordinary import FRICTION
from jax_inertia.diagnosis.search.selection import Selection

ORDINARY_NUMBERS = {
    "viscous_friction": ("damping", "N m s/rad"),
    "coulomb_friction": ("frictionloss", "N m"),
    "armature": ("armature", "kg m²"),
    "torque_bias": (None, "N m"),
}
"""Family, the robot's own number of it, and its unit."""


def nominal_number(context: Context, family: str, row: int) -> float:
    """The model's own number that a family's is added to; 0 where it has none."""
    attribute, _ = ORDINARY_NUMBERS.get(family, (None, ""))
    return 0.0 if attribute is None else float(getattr(context, attribute)[row])


def intervals(
    selection: Selection, h: Hypothesis, mean: np.ndarray, covariance: np.ndarray
) -> dict[str, Interval]:
    """95 % intervals of what is reported, by the delta method; of nonlinear numbers by how the evidence falls."""
    residual = selection.residual
    base = h.numbers(residual, mean)
    slopes = {name: np.zeros(len(mean)) for name in base}
    for k in range(len(mean)):
        step = np.zeros(len(mean))
        step[k] = 1e-3 * max(float(np.sqrt(covariance[k, k])), 1e-12)
        up, down = h.numbers(residual, mean + step), h.numbers(residual, mean - step)
        for name in base:
            slopes[name][k] = (up[name].value - down[name].value) / (2 * step[k])
    model = nominal_number(residual.context, h.family, h.place.index)
    own = {name: slopes[name] @ covariance @ slopes[name] for name in base}
    for k, spread in nonlinear_spread(selection, h):
        up, down = (moved(h, k, x).numbers(residual, mean) for x in (spread, -spread))
        for name in base:
            own[name] += (0.5 * (up[name].value - down[name].value)) ** 2
    out = {}
    for name, p in base.items():
        half = 1.96 * float(np.sqrt(max(own[name], 0.0)))
        low = max(p.value - half, min(p.least, p.value))
        out[name] = Interval(p.value, low, p.value + half, p.unit, p.factor, model)
    return out


def moved(h: Hypothesis, k: int, by: float) -> Hypothesis:
    """The same with its `k`-th nonlinear number moved, columns as they were."""
    shape = (*h.shape[:k], h.shape[k] + by, *h.shape[k + 1 :])
    return dataclasses.replace(h, shape=shape)


FALL = 0.5
"""Nats that the evidence falls at one standard deviation."""
FIRST = 1.0 / 64.0
"""Of a search's step, at which a fall is first asked for: to there the search goes."""


def nonlinear_spread(selection: Selection, h: Hypothesis) -> Iterator[tuple[int, float]]:
    """Each nonlinear number that is searched between the grid's points, and its standard deviation, in its unit.

    How far the evidence lets it go, and how far parts of the log disagree, as of linear numbers: its column's slope is
    one more column (`Selection.spread_with`). Of what is there whole or not at all, also how far the number would have
    to move to make θ one: by as much the size that it says is off.
    """
    if not h.is_odd or h.effect.secant or h not in selection.posterior.chosen:
        return
    now, steps = selection.posterior, h.effect.steps(selection.residual.context, h.place, h.shape)
    moves = [k for k, step in enumerate(steps) if step]
    if not moves:
        return
    own = [_by_evidence(selection, h, k, steps[k]) for k in moves]
    slopes = [_slope(selection, h, k, by) * steps[k] for k, by in zip(moves, own, strict=True)]
    spread = selection.spread_with(np.stack(slopes, axis=-1))
    parts = np.sqrt(np.diag(spread))[len(now.mean) :]
    for k, by, part, slope in zip(moves, own, parts, slopes, strict=True):
        off = min(float(np.hypot(part, _off_size(selection, h, slope))), 2.0)
        yield k, float(np.hypot(by, off * steps[k]))


def _slope(selection: Selection, h: Hypothesis, k: int, by: float) -> np.ndarray:
    """Change of the torque with a nonlinear number (R, n)."""
    low, high = min(0.0, *_sides(h, k, by)), max(0.0, *_sides(h, k, by))
    residual, now = selection.residual, selection.posterior
    at_low, at_high = (
        reshaped(h, residual, moved(h, k, x).shape).torque(now.mean[now.part(h)], now.fitted.shape)
        for x in (low, high)
    )
    return (at_high - at_low) / (high - low)


def _off_size(selection: Selection, h: Hypothesis, slope: np.ndarray) -> float:
    """By how many steps a number would have to move to change the torque by what θ is off one, relative to it."""
    if not h.effect.misses:
        return 0.0
    (theta,), ((variance,),) = selection.posterior.of(h)
    precision = selection.evidence.precision
    whole, a_step = (
        float(np.sqrt(np.sum(precision * e**2))) for e in (selection.posterior.torque(h), slope)
    )
    return float(np.hypot(theta - 1.0, np.sqrt(variance))) * whole / max(a_step, 1e-300)


def _sides(h: Hypothesis, k: int, by: float) -> list[float]:
    """Moves of a nonlinear number to both sides of it that do not change its sign."""
    return [x for x in (by, -by) if (h.shape[k] + x) * h.shape[k] >= 0]


def _by_evidence(selection: Selection, h: Hypothesis, k: int, step: float) -> float:
    """Standard deviation of the `k`-th nonlinear number by a parabola through the evidence, all else marginalised.

    At the number and as far to both sides as it takes to fall (Laplace 1774); no more than twice the grid's spacing.
    """
    residual, evidence = selection.residual, selection.evidence
    rest = selection.posterior.without(h)
    top, by = float(evidence.gains(rest, (h,))[0]), FIRST * step
    while True:
        trials = tuple(reshaped(h, residual, moved(h, k, x).shape) for x in _sides(h, k, by))
        gains = evidence.gains(rest, trials)
        fall = top - float(np.mean(np.where(np.isfinite(gains), gains, -np.inf)))
        if fall >= FALL or by >= 2.0 * step:
            return by * float(np.sqrt(FALL / max(fall, FALL)))
        by *= 2.0


def reported(selection: Selection, h: Hypothesis) -> tuple[np.ndarray, np.ndarray]:
    """(mean (k,), covariance (k, k)) of a hypothesis' numbers as they are reported, in their own units.

    Parts of the log and the equation's own error are in the covariance. Dry and viscous friction and a constant torque
    are those that come nearest to the joint's whole law, its mild forms included (`friction_laws.nearest_numbers`):
    what a model of these numbers should hold. A joint's own numbers are those after its motor's gain.
    """
    mean, numbers = _in_own_units(selection, h)
    covariance = numbers @ (selection.posterior.covariance + selection.spread) @ numbers.T
    return mean, covariance + _systematic(selection, h)


def _in_own_units(selection: Selection, h: Hypothesis) -> tuple[np.ndarray, np.ndarray]:
    """(mean (k,), slopes (k, p)) of a hypothesis' numbers as they are reported, linear in the posterior's."""
    now = selection.posterior
    numbers = np.zeros((h.count, len(now.mean)))
    numbers[:, now.part(h)] = np.diag(h.scale)
    mean, numbers = after_gain(selection, h, numbers)
    if h.ordinary and h.family in NEAREST:
        _, beyond, slopes = nearest_numbers(selection, h.place.name, h.place.index)[h.family]
        if h.family in FRICTION:
            return np.array([beyond]), slopes[None]
        return mean + beyond, numbers + slopes
    return mean, numbers


def _systematic(selection: Selection, h: Hypothesis) -> np.ndarray:
    """Covariance of a friction's number by its own equation: a law of another form has no one level and no one slope.

    By how far such a law's torque may be off (`FORM_TOLERANCE` of the joint's whole friction), in the number's unit.
    """
    if h.family not in FRICTION:
        return np.zeros((h.count, h.count))
    now, row = selection.posterior, h.place.index
    weight = selection.residual.weight[:, [row]]
    laws = (*FRICTION, "friction_forms")
    own = [now.torque(c) for c in now.chosen if c.family in laws and c.place == h.place]
    whole = rms(np.sum(own, axis=0)[:, [row]], weight)
    per_unit = max(rms(h.own_columns, weight), 1e-12)
    return np.diag([(FORM_TOLERANCE * whole / per_unit) ** 2])


def added(p: Interval, level: Interval) -> Interval:
    half = np.hypot(0.5 * (p.high - p.low), 0.5 * (level.high - level.low))
    value = p.value + level.value
    return Interval(value, value - half, value + half, p.unit, p.factor)


def joint_numbers(selection: Selection) -> dict[str, dict[str, Interval]]:
    """The four ordinary numbers of every joint, the model's own included."""
    now, context = selection.posterior, selection.residual.context
    chosen = {h.key: h for h in now.chosen}
    out = {}
    for name, row in context.joint_dofs.items():
        own = {}
        for family, (attribute, unit) in ORDINARY_NUMBERS.items():
            h = chosen.get((family, "joint", name))
            if h is None and family in NEAREST and any(c.ordinary for c in now.chosen):
                own[family] = _of_law(selection, name, row, family, unit)
                continue
            if h is None:
                nominal = nominal_number(context, family, row)
                stated = chosen.get(("stated_numbers", "joint", name))
                own[family] = _stated(selection, stated, family, nominal, unit)
                continue
            (p,) = intervals(selection, h, *reported(selection, h)).values()
            whole = p.whole
            low = whole.low if attribute is None else max(whole.low, 0.0)
            own[family] = dataclasses.replace(whole, low=low)
        out[name] = own
    return out


def _of_law(selection: Selection, name: str, row: int, family: str, unit: str) -> Interval:
    """What a joint without a level or slope of its own should have in a model, by the mild forms of its friction."""
    nominal, beyond, slopes = nearest_numbers(selection, name, row)[family]
    covariance = selection.posterior.covariance + selection.spread
    half = 1.96 * float(np.sqrt(max(slopes @ covariance @ slopes, 0.0)))
    value = nominal + beyond
    low = value - half if family not in FRICTION else max(value - half, 0.0)
    return Interval(value, low, value + half, unit)


def _stated(
    selection: Selection, h: Hypothesis | None, family: str, nominal: float, unit: str
) -> Interval:
    """A number of the model's own to which nothing was found, its error within the tolerance taken out.

    The model's own where that says nothing of it.
    """
    if h is None or family not in STATED:
        return Interval(nominal, nominal, nominal, unit)
    now, k = selection.posterior, STATED.index(family)
    at = now.part(h).start + k
    sd = nominal * float(StatedNumbers.relative(h.shape)[k])
    value = nominal + sd * float(now.mean[at])
    half = 1.96 * sd * float(np.sqrt(now.covariance[at, at] + selection.spread[at, at]))
    return Interval(value, max(value - half, 0.0), value + half, unit)


def joint_slopes(selection: Selection, name: str, row: int) -> dict[str, tuple[np.ndarray, float]]:
    """Of a joint's numbers by family: slopes (p,) by the posterior's numbers, and what its equation adds to its σ."""
    now = selection.posterior
    chosen = {h.key: h for h in now.chosen}
    bought = any(h.ordinary for h in now.chosen)
    nearest = nearest_numbers(selection, name, row) if bought else {}
    out = {}
    for family in ORDINARY_NUMBERS:
        h = chosen.get((family, "joint", name))
        stated = chosen.get(("stated_numbers", "joint", name))
        slope, own = np.zeros(len(now.mean)), 0.0
        if h is not None:
            slope = _in_own_units(selection, h)[1][0]
            own = float(np.sqrt(_systematic(selection, h)[0, 0]))
        elif family in nearest:
            slope = nearest[family][2]
        elif stated is not None and family in STATED:
            k = STATED.index(family)
            nominal = nominal_number(selection.residual.context, family, row)
            slope[now.part(stated).start + k] = nominal * StatedNumbers.relative(stated.shape)[k]
        out[family] = slope, own
    return out
