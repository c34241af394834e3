"""Effects that are listed: size, evidence, probability, and what each is tied with."""

import dataclasses

import numpy as np

from jax_inertia.diagnosis.certainty.causes import Judges
from jax_inertia.diagnosis.certainty.probability import behind_it, odds_of_effect, probability
from jax_inertia.diagnosis.certainty.rivals import is_law_of, rivals
from jax_inertia.diagnosis.checks import rows
from jax_inertia.diagnosis.corrected.intervals import added, intervals, nominal_number, reported
from jax_inertia.diagnosis.effects.dry_friction import DryFriction
from jax_inertia.diagnosis.effects.registry import LEVEL_OF
from jax_inertia.diagnosis.hypothesis import Hypothesis
from jax_inertia.diagnosis.result import Found, Tie
from jax_inertia.diagnosis.search.selection import Selection
from jax_inertia.diagnosis.settings import Settings


def effects(
    selection: Selection, shares: dict[int, float], judges: Judges, settings: Settings
) -> tuple[list[tuple[Hypothesis, Found]], tuple[Hypothesis, ...]]:
    """What is listed, and odd effects that are no likelier than others in their place; `shares` of the gap's energy."""
    now = selection.posterior
    worths = dict(zip(map(id, now.chosen), selection.evidence.worths(now), strict=True))
    listed = [h for h in now.chosen if h.named and _is_listed(selection, h, worths, settings)]
    every = [(h, _found(selection, h, shares, worths, judges, settings)) for h in listed]
    likely = [(h, f) for h, f in every if f.ordinary or f.probability >= settings.likely]
    told = {id(h) for h, _ in likely}
    return likely, tuple(h for h in listed if id(h) not in told)


def as_listed(selection: Selection, found: list[tuple[Hypothesis, Found]]) -> tuple[Found, ...]:
    """With the numbers of a selection, the largest first."""
    out = []
    for h, f in found:
        numbers = intervals(selection, h, *reported(selection, h))
        out.append((h, dataclasses.replace(f, parameters=numbers)))
    return tuple(sorted((f for _, f in _as_one_law(selection, out)), key=lambda f: -f.share))


def _is_listed(selection, h: Hypothesis, worths, settings: Settings) -> bool:
    """Odd effects are, ordinary ones where they are distinct from zero and matter at their joint."""
    if not h.ordinary:
        return True
    mean, covariance = selection.posterior.of(h)
    distinct = abs(mean[0]) > settings.distinct * np.sqrt(covariance[0, 0])
    row = h.place.index
    own = nominal_number(selection.residual.context, h.family, row)
    if abs(mean[0]) < settings.ordinary_tolerance * own:
        return False
    size = rows(selection.posterior.torque(h), selection.residual.weight)
    gap = selection.evidence.gap
    # What a leg does that stands is seen on the base.
    seen = list(h.rows) if selection.residual.prepared.spreads(row) else [row]
    matters = np.any(size[seen] ** 2 > settings.material * gap[seen] ** 2)
    return bool(distinct and matters and worths[id(h)] > h.odds)


def _found(selection, h: Hypothesis, shares, worths, judges: Judges, settings: Settings) -> Found:
    others = () if h.ordinary else rivals(selection, h, settings)
    own = worths[id(h)] - h.odds
    reach = settings.reach(own)
    # What another predicts as well on rows that no number was fitted to is for no reader to choose from this log.
    behind = [0.0 if r.behind < reach else behind_it(selection, h, r, judges) for r in others]
    ties = tuple(
        Tie(r.hypothesis.family, r.hypothesis.place, _kind(selection, h, r.hypothesis))
        for r, by in zip(others, behind, strict=True)
        if by <= 0.0
    )
    apart = [by for by in behind if by > 0.0]
    odds = own if h.ordinary else odds_of_effect(selection, h, apart, judges)
    return Found(
        family=h.family,
        place=h.place,
        parameters={},
        share=shares[id(h)],
        evidence=float(own),
        log_odds=float(odds),
        probability=probability(odds),
        equivalent=ties,
        ordinary=h.ordinary,
        equation=h.effect.equation,
    )


def _kind(selection: Selection, h: Hypothesis, other: Hypothesis) -> str:
    """'exact' where the two torques are one along this motion to a part in ten thousand of their energy.

    A friction is a constant torque until its joint turns round, and each law with more numbers can be it.
    """
    if is_law_of(other, h):
        return "motion_limited"
    side = selection.residual.context.side
    for one in (h, other):
        if isinstance(one.effect, DryFriction):
            own = side[:, one.place.index]
            if own.min() * own.max() >= 0.0:
                return "motion_limited"
    a = selection.posterior.torque(h).ravel()
    columns = np.zeros((a.size, other.count))
    if other.row is None:
        columns = other.columns.reshape(a.size, -1)
    else:
        wide = np.zeros((*selection.residual.y.shape, other.count))
        wide[:, other.row] = other.columns
        columns = wide.reshape(a.size, -1)
    theta = np.linalg.lstsq(columns, a, rcond=None)[0]
    left = a - columns @ theta
    return "exact" if left @ left < 1e-4 * (a @ a) else "motion_limited"


def _as_one_law(
    selection: Selection, found: list[tuple[Hypothesis, Found]]
) -> list[tuple[Hypothesis, Found]]:
    """An ordinary number goes with the law at its joint that holds it, as a level of dry friction with Stribeck's."""
    ordinary = {h.key: h for h in selection.posterior.chosen if h.ordinary}
    out, held = [], set()
    for h, f in found:
        level = ordinary.get((LEVEL_OF.get(f.family, ""), f.place.kind, f.place.name))
        if level is not None:
            held.add(level.key)
            (own,) = intervals(selection, level, *reported(selection, level)).values()
            whole = {name: added(f.parameters[name], own) for name in h.effect.level_in}
            f = dataclasses.replace(f, parameters=f.parameters | whole)
        out.append((h, f))
    return [(h, f) for h, f in out if h.key not in held]
