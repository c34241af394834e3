"""From a selection and its checks to what is reported: effects with intervals, the joints' table, the remainder."""

import dataclasses

import jax.numpy as jnp
import numpy as np

from jax_inertia.diagnosis.checks import Check, HeldOut, OtherRun, rivals, rms, rows
from jax_inertia.diagnosis.effects.base import Interval
from jax_inertia.diagnosis.effects.dry_friction import FORM_TOLERANCE
from jax_inertia.diagnosis.effects.registry import DRY_FORMS
from jax_inertia.diagnosis.effects.tolerances import inertial_changes
from jax_inertia.diagnosis.hypothesis import Hypothesis
from jax_inertia.diagnosis.report.wording import headline
from jax_inertia.diagnosis.result import Diagnosis, Found, Remainder, Shrink, Tie, Trace, Verdict
from jax_inertia.diagnosis.search import Selection
from jax_inertia.diagnosis.settings import Settings
from jax_inertia.diagnosis.verdict import confidence, verdict
from jax_inertia.maths.inertial_parameters import is_physical

ORDINARY_NUMBERS = {
    "viscous_friction": ("damping", "N m s/rad"),
    "coulomb_friction": ("frictionloss", "N m"),
    "armature": ("armature", "kg m²"),
    "torque_bias": (None, "N m"),
}
"""Family, the robot's own number of it, and its unit."""
SHARES = (1.0, 0.9, 0.75, 0.5, 0.25)
"""Of a body's error, the largest first, that may be taken out."""


def summarised(
    selection: Selection,
    heldout: HeldOut,
    other: OtherRun | None,
    dropped: tuple[Hypothesis, ...],
    settings: Settings,
) -> Diagnosis:
    """Everything that is reported of a selection."""
    now, evidence, residual = selection.posterior, selection.evidence, selection.residual
    names = residual.context.row_names
    ordinary = evidence.posterior(tuple(h for h in now.chosen if not h.is_odd))
    own = heldout.check(ordinary, now)
    test = None if other is None else other.check(ordinary, now)
    checked = own if test is None else test
    shares = {id(h): _share(selection, h) for h in now.chosen}
    generic = [h for h in now.chosen if h.is_odd and not h.named]
    found = _effects(selection, shares, settings)
    bare = evidence.posterior(tuple(h for h in now.chosen if h.family == "tolerances"))
    tolerated = rms(residual.y - bare.fitted, residual.weight)
    generic_share = float(sum(max(shares[id(h)], 0.0) for h in generic))
    judged = verdict(checked, tolerated, bool(found), generic_share, settings)
    trust = settings.adequate[0 if judged is Verdict.EXPLAINED else 1]
    found = tuple(
        f if f.ordinary else dataclasses.replace(f, probability=trust * f.probability)
        for f in found
    )
    sure = confidence(checked, judged, [f.probability for f in found if not f.ordinary], settings)
    remainder = _remainder(checked, names, generic)
    gap = evidence.gap
    chi = float(np.sum(residual.weight * (residual.y / np.maximum(residual.sensors, 1e-12)) ** 2))
    energy = evidence.gap**2 * evidence.count
    shrinks = _shrink(own, names), None if test is None else _shrink(test, names)
    joints = _joints(selection, settings)
    notes = tuple(
        f"{h.family.replace('_', ' ')}{_at(h)} fits this log but not the other run; left out"
        for h in dropped
        if h.named
    )
    return Diagnosis(
        verdict=judged,
        confidence=sure,
        headline=headline(judged, found, shrinks, remainder, _lacking(residual, found)),
        found=found,
        joints=joints,
        presliding={
            h.place.name: float(h.shape[0]) for h in now.chosen if h.family == "coulomb_friction"
        },
        heldout=shrinks[0],
        test=shrinks[1],
        remainder=remainder,
        chi2=chi / max(float(residual.weight.sum()), 1.0),
        noise_floor=1.0,
        per_joint_rms=dict(zip(names, gap.tolist(), strict=True)),
        share=dict(zip(names, (energy / max(energy.sum(), 1e-300)).tolist(), strict=True)),
        inertials=_inertials(selection),
        notes=(*_flags(selection, joints), *notes),
        trace=_trace(residual if other is None else other.residual, checked),
        units={n: "N m" if residual.rotates(k) else "N" for k, n in enumerate(names)},
    )


def _effects(
    selection: Selection, shares: dict[int, float], settings: Settings
) -> tuple[Found, ...]:
    """What is listed, the largest first; `shares` of the gap's energy, by hypothesis."""
    now = selection.posterior
    worths = dict(zip(map(id, now.chosen), selection.evidence.worths(now), strict=True))
    listed = [h for h in now.chosen if h.named and _is_listed(selection, h, worths, settings)]
    every = (_found(selection, h, listed, shares, worths, settings) for h in listed)
    return _one_dry_law(tuple(sorted(every, key=lambda f: -f.share)))


def _at(h: Hypothesis) -> str:
    return "" if h.place.kind == "global" else f" at {h.place.name}"


def _is_listed(selection, h: Hypothesis, worths, settings: Settings) -> bool:
    """Odd effects are, ordinary ones where they are distinct from zero and matter at their joint."""
    if not h.ordinary:
        return True
    mean, covariance = selection.posterior.of(h)
    distinct = abs(mean[0]) > settings.distinct * np.sqrt(covariance[0, 0])
    row = h.place.index
    attribute = ORDINARY_NUMBERS[h.family][0]
    own = 0.0 if attribute is None else float(getattr(selection.residual.context, attribute)[row])
    if abs(mean[0]) < settings.ordinary_tolerance * own:
        return False
    torque = selection.posterior.torque(h)
    size = rows(torque, selection.residual.weight)[row]
    matters = size**2 > settings.material * selection.evidence.gap[row] ** 2
    return bool(distinct and matters and worths[id(h)] > h.odds)


def _systematic(h: Hypothesis, mean: np.ndarray) -> np.ndarray:
    """Covariance of a friction's number by its own equation: a law of another form has no one level."""
    known_to = FORM_TOLERANCE if h.family in ("viscous_friction", "coulomb_friction") else 0.0
    return np.diag((known_to * mean) ** 2)


def _share(selection: Selection, h: Hypothesis) -> float:
    """Of the gap's energy, what returns when it alone is left out."""
    now, residual = selection.posterior, selection.residual
    left = residual.y - now.fitted
    whole = float((residual.weight * residual.y**2).sum())
    back = residual.weight * ((left + now.torque(h)) ** 2 - left**2)
    return float(back.sum() / max(whole, 1e-300))


def _found(selection, h: Hypothesis, listed, shares, worths, settings: Settings) -> Found:
    mean, covariance = selection.posterior.of(h)
    covariance = covariance + selection.jackknife(h) + _systematic(h, mean)
    others = () if h.ordinary else rivals(selection, h, settings)
    own = worths[id(h)] - h.odds
    reach = max(settings.tie, settings.tie_share * abs(own))
    ties = tuple(
        Tie(r.hypothesis.family, r.hypothesis.place, _kind(selection, h, r.hypothesis))
        for r in others
        if r.behind < reach
    )
    # Odds against rivals beyond the tie, and against nothing at all, tempered: equations are not exact.
    beyond = [-(r.behind / settings.temper) for r in others if r.behind >= reach]
    nothing = -own / settings.temper
    probability = float(1.0 / (1.0 + np.exp(np.clip(np.array([*beyond, nothing]), -50, 50)).sum()))
    return Found(
        family=h.family,
        place=h.place,
        parameters=intervals(selection, h, mean, covariance),
        share=shares[id(h)],
        evidence=float(own),
        probability=probability,
        equivalent=ties,
        ordinary=h.ordinary,
        equation=h.effect.equation,
    )


def _kind(selection: Selection, h: Hypothesis, other: Hypothesis) -> str:
    """'exact' where the two torques are one along this motion to a part in ten thousand of their energy."""
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


def intervals(
    selection: Selection, h: Hypothesis, mean: np.ndarray, covariance: np.ndarray
) -> dict[str, Interval]:
    """95 % intervals of what is reported, by the delta method."""
    residual = selection.residual
    base = h.numbers(residual, mean)
    slopes = {name: np.zeros(len(mean)) for name in base}
    for k in range(len(mean)):
        step = np.zeros(len(mean))
        step[k] = 1e-3 * max(float(np.sqrt(covariance[k, k])), 1e-12)
        up, down = h.numbers(residual, mean + step), h.numbers(residual, mean - step)
        for name in base:
            slopes[name][k] = (up[name].value - down[name].value) / (2 * step[k])
    out = {}
    for name, p in base.items():
        half = 1.96 * float(np.sqrt(max(slopes[name] @ covariance @ slopes[name], 0.0)))
        low = max(p.value - half, min(p.least, p.value))
        out[name] = Interval(p.value, low, p.value + half, p.unit, p.factor)
    return out


def _one_dry_law(found: tuple[Found, ...]) -> tuple[Found, ...]:
    """A joint's level of dry friction goes with its first other form, whose numbers are then the whole law's."""
    levels = {f.place.name: f for f in found if f.family == "coulomb_friction"}
    out, used = [], set()
    for f in found:
        level = levels.get(f.place.name)
        if f.family in DRY_FORMS and level is not None and f.place.name not in used:
            used.add(f.place.name)
            own = level.parameters["coulomb"]
            grown = {
                name: _plus(p, own)
                if name in ("coulomb", "stiction", "positive", "negative")
                else p
                for name, p in f.parameters.items()
            }
            f = dataclasses.replace(f, parameters=grown)
        out.append(f)
    return tuple(f for f in out if not (f.family == "coulomb_friction" and f.place.name in used))


def _plus(p: Interval, level: Interval) -> Interval:
    half = np.hypot(0.5 * (p.high - p.low), 0.5 * (level.high - level.low))
    value = p.value + level.value
    return Interval(value, value - half, value + half, p.unit, p.factor)


def _joints(selection: Selection, settings: Settings) -> dict[str, dict[str, Interval]]:
    """The four ordinary numbers of every joint, the model's own included."""
    now, context = selection.posterior, selection.residual.context
    chosen = {h.key: h for h in now.chosen}
    out = {}
    for name, row in context.joint_dofs.items():
        own = {}
        for family, (attribute, unit) in ORDINARY_NUMBERS.items():
            nominal = 0.0 if attribute is None else float(getattr(context, attribute)[row])
            h = chosen.get((family, "joint", name))
            if h is None:
                own[family] = Interval(0.0, 0.0, 0.0, unit)
                continue
            mean, covariance = now.of(h)
            (p,) = intervals(
                selection, h, mean, covariance + selection.jackknife(h) + _systematic(h, mean)
            ).values()
            low = p.low + nominal if attribute is None else max(p.low + nominal, 0.0)
            own[family] = Interval(p.value + nominal, low, p.high + nominal, p.unit)
        out[name] = own
    return out


def _inertials(selection: Selection) -> dict[str, tuple[float, ...]]:
    """Bodies without the errors that the log says they have, as far towards that as bodies can exist."""
    now, residual = selection.posterior, selection.residual
    base = next(h for h in now.chosen if h.family == "tolerances")
    numbers = now.mean[now.slices[now.chosen.index(base)]]
    out, at = {}, 0
    for change, name, pi in inertial_changes(residual.context, base.shape):
        size = change.shape[1]
        # The tolerances' torque is what the model needs too much: the body is lighter by it.
        error = change @ numbers[at : at + size]
        at += size
        share = next((t for t in SHARES if bool(is_physical(jnp.asarray(pi - t * error)))), 0.0)
        if share:
            out[name] = tuple(float(x) for x in pi - share * error)
    return out


def _lacking(residual, found: tuple[Found, ...]) -> str:
    """What the model has at no joint though it is found at half of them or more."""
    context, count = residual.context, max(len(residual.context.joint_dofs), 1)
    dofs = list(context.joint_dofs.values())
    words = []
    for family, own, word in (
        ("coulomb_friction", context.frictionloss, "dry friction"),
        ("viscous_friction", context.damping, "damping"),
        ("armature", context.armature, "rotor inertia"),
    ):
        at = {
            f.place.name
            for f in found
            if f.family == family or (family == "coulomb_friction" and f.family in DRY_FORMS)
        }
        if not np.any(own[dofs]) and 2 * len(at) >= count:
            words.append(word)
    return " and ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)


def _flags(selection: Selection, joints: dict[str, dict[str, Interval]]) -> tuple[str, ...]:
    """Numbers that fit and that no robot has."""
    out = []
    context = selection.residual.context
    _, _, da = context.sensitivity
    for name, row in context.joint_dofs.items():
        link = float(np.median(da[:, row, row])) - float(context.armature[row])
        rotor = joints[name]["armature"].value
        if rotor > 20.0 * max(link, 1e-9) and rotor > 0.5:
            out.append(
                f"rotor inertia of {rotor:.3g} kg m² at {name} is over 20 times what the joint moves: "
                "it fits, and is no rotor's"
            )
    return tuple(out)


def _remainder(check: Check, names: tuple[str, ...], generic: list[Hypothesis]) -> Remainder:
    energy = np.maximum(check.per_joint_after**2 - check.expected**2, 0.0)
    total = float(energy.sum())
    where = {n: float(e / total) if total > 0 else 0.0 for n, e in zip(names, energy, strict=True)}
    carried = tuple(f"{h.family} at {h.place.name}" for h in generic)
    return Remainder(check.unexplained, where, carried)


def _trace(residual, checked: Check) -> Trace:
    names = residual.context.row_names
    return Trace(residual.time, residual.y, checked.left, residual.weight, names)


def _shrink(c: Check, names: tuple[str, ...]) -> Shrink:
    rows_of = {
        n: (float(b), float(a))
        for n, b, a in zip(names, c.per_joint_before, c.per_joint_after, strict=True)
    }
    return Shrink(c.before, c.ordinary, c.after, c.noise, rows_of)
