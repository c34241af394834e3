"""From causes and their checks to what is reported: effects with intervals, the joints' table, the remainder."""

import dataclasses
from collections.abc import Iterator
from typing import Any

import numpy as np
from jaxtyping import Float

from jax_inertia.diagnosis.certainty.doubts import odds_of_verdict
from jax_inertia.diagnosis.certainty.probability import confidence, probability
from jax_inertia.diagnosis.checks import (
    Check,
    HeldOut,
    OtherRun,
    noise_of,
    rms,
    rows,
    shrink_interval,
)
from jax_inertia.diagnosis.conclusion.listing import as_listed
from jax_inertia.diagnosis.conclusion.stated_causes import Causes
from jax_inertia.diagnosis.corrected.baseline import left_by_least_squares
from jax_inertia.diagnosis.corrected.covariance import model_errors
from jax_inertia.diagnosis.corrected.friction_laws import friction_curves
from jax_inertia.diagnosis.corrected.handed_over import HandedOver
from jax_inertia.diagnosis.corrected.intervals import joint_numbers
from jax_inertia.diagnosis.corrected.motor_gains import motor_gains
from jax_inertia.diagnosis.corrected.unusual_numbers import unusual
from jax_inertia.diagnosis.effects.registry import LEVEL_OF
from jax_inertia.diagnosis.effects.tolerances import inertial_changes
from jax_inertia.diagnosis.hypothesis import Hypothesis
from jax_inertia.diagnosis.report.gap_stretches import gap_stretches
from jax_inertia.diagnosis.report.where import body_forces, regions, states
from jax_inertia.diagnosis.report.wording import headline
from jax_inertia.diagnosis.residual import Residual
from jax_inertia.diagnosis.result import (
    Diagnosis,
    Found,
    NotListed,
    Remainder,
    Shrink,
    Trace,
    Verdict,
)
from jax_inertia.diagnosis.search.evidence import Evidence, Posterior
from jax_inertia.diagnosis.search.selection import Selection
from jax_inertia.diagnosis.settings import Settings
from jax_inertia.diagnosis.verdict import joined, judged


def drafted(causes: Causes, heldout: HeldOut, as_bought: float, settings: Settings) -> Diagnosis:
    """Every number of the report and of the corrected model, before their prediction error is computed.

    `as_bought`: log odds that its model is [nats].
    """
    told, residual = causes.told, causes.told.residual
    listed = as_listed(told, _by_other_stretches(heldout, causes.now, causes.likely))
    joints, gains = joint_numbers(told), motor_gains(told)
    nothing = Shrink(0.0, 0.0, 0.0, 0.0, {})
    empty = np.zeros((0, residual.y.shape[1]))
    return Diagnosis(
        verdict=Verdict.UNKNOWN,
        confidence=0.0,
        log_odds=0.0,
        headline="",
        found=listed,
        joints=joints,
        gains=gains,
        presliding={
            h.place.name: float(h.shape[0])
            for h in causes.now.chosen
            if h.family == "coulomb_friction"
        },
        friction=friction_curves(told),
        not_listed=tuple(
            NotListed(h.family, h.place, odds, probability(odds)) for h, odds in causes.others
        ),
        as_bought=as_bought,
        heldout=nothing,
        validation=None,
        test=None,
        remainder=Remainder(0.0, dict.fromkeys(residual.context.row_names, 0.0), (), 0.0),
        inertials=_inertials(told),
        errors=model_errors(told),
        notes=(
            *causes.bent,
            *unusual(told, joints, gains, settings),
            *_left_out(causes.dropped),
        ),
        trace=Trace(np.zeros(0), empty, empty, empty, residual.context.row_names, {}),
        **_gap(residual, told.evidence),
    )


def concluded(
    draft: Diagnosis,
    causes: Causes,
    handed: HandedOver,
    heldout: tuple[HeldOut, Float[np.ndarray, "R n"]],
    validation: OtherRun | None,
    test: OtherRun | None,
) -> Diagnosis:
    """The diagnosis with its verdict, by the error of what is handed over on the last run there is.

    `heldout`: held-out rows of the log, and what the files leave of them.
    """
    again = handed.on_another_run()
    others = [run for run in (validation, test) if run is not None]
    runs: list[tuple[HeldOut | OtherRun, Float[np.ndarray, "R n"]]] = [heldout]
    runs += [(other, _of_another_run(other, causes, again)) for other in others]
    checks = [run.check(causes.now, left) for run, left in runs]
    own = causes.selection.residual
    shrinks = [_shrink(run, left, causes.ordinary, own) for run, left in runs]
    by_run = dict(zip([id(run) for run, _ in runs], shrinks, strict=True))
    run, check = runs[-1][0], checks[-1]
    named = bool(draft.found)
    # Where nothing is named the files differ from the model within its tolerances alone, and every run has to be quiet.
    counted = checks[-1:] if named else checks
    errors = joined([c.errors for c in counted])
    errors = errors if named else errors.as_given()
    given = judged(errors, named, tuple(causes.doubts.against(named))).verdict
    limit = np.split(errors.limit if named else errors.silence, len(counted))
    within = [c.odds_within(top) for c, top in zip(counted, limit, strict=True)]
    odds = odds_of_verdict(np.concatenate(within), given, draft.odd, causes.doubts)
    remainder = _remainder(check, causes, run, given)
    out = dataclasses.replace(
        draft,
        verdict=given,
        confidence=confidence(odds),
        log_odds=odds,
        heldout=shrinks[0],
        validation=by_run.get(id(validation)),
        test=by_run.get(id(test)),
        remainder=remainder,
        trace=_trace(run.residual, check),
    )
    return dataclasses.replace(out, headline=headline(out, _lacking(own, out.found), causes.bent))


def _of_another_run(run: OtherRun, causes: Causes, handed: HandedOver) -> Float[np.ndarray, "R n"]:
    """Residual of another run by what is handed over [N m], less what happens once and does so in this run too.

    When and how hard this run tells: so that is believed where nothing else is left. A part of something else that a
    push may take is none of it.
    """
    left = causes.by_files(run.residual, handed)
    passing = run.once_more(causes.now, left)
    if not passing.any() or not np.all(run.check(causes.now, left - passing).errors.done):
        return left
    return left - passing


def _by_other_stretches(
    heldout: HeldOut, causes: Posterior, listed: list[tuple[Hypothesis, Found]]
) -> list[tuple[Hypothesis, Found]]:
    """What is listed, with what each explains of stretches that its numbers were not fitted to."""
    returned = heldout.shares(causes, [h for h, _ in listed])
    return [
        (h, dataclasses.replace(f, explained_heldout=back))
        for (h, f), back in zip(listed, returned, strict=True)
    ]


def _gap(residual: Residual, evidence: Evidence) -> dict[str, Any]:
    """How large the gap is, and where it lies: fields of the diagnosis that no effect is needed for."""
    names = residual.context.row_names
    z = np.sqrt(residual.weight) * residual.y / np.maximum(residual.sensors, 1e-12)
    return {
        "chi2": float(np.sum(z**2)) / max(float(residual.weight.sum()), 1.0),
        "noise_floor": 1.0,
        "per_joint_rms": dict(zip(names, evidence.gap.tolist(), strict=True)),
        "share": dict(zip(names, _shares(evidence).tolist(), strict=True)),
        "units": {n: "N m" if residual.rotates(k) else "N" for k, n in enumerate(names)},
        "regions": regions(residual),
        "forces": body_forces(residual),
        "when": gap_stretches(residual.time, z),
    }


def _left_out(dropped: tuple[Hypothesis, ...]) -> Iterator[str]:
    """A line for each effect that the other run refuted."""
    for h in dropped:
        if h.named:
            at = "" if h.place.kind == "global" else f" at {h.place.name}"
            what = h.family.replace("_", " ")
            yield f"{what}{at} fits this log but not the other run; left out"


def _inertials(selection: Selection) -> dict[str, tuple[float, ...]]:
    """Bodies without the errors that the log says they have."""
    now, residual = selection.posterior, selection.residual
    base = next((h for h in now.chosen if h.family == "tolerances"), None)
    if base is None:
        return {}
    numbers = now.of(base)[0]
    out, at = {}, 0
    for change, name, pi in inertial_changes(residual.context, base.shape):
        size = change.shape[1]
        # The tolerances' torque is what the model needs too much: the body is lighter by it.
        out[name] = tuple(float(x) for x in pi - change @ numbers[at : at + size])
        at += size
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
        at = {f.place.name for f in found if family in (f.family, LEVEL_OF.get(f.family))}
        if not np.any(own[dofs]) and 2 * len(at) >= count:
            words.append(word)
    return " and ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)


def _remainder(check: Check, causes: Causes, run: HeldOut | OtherRun, given: Verdict) -> Remainder:
    """What the causes leave, and shapes that name no cause."""
    now, residual = causes.selection.posterior, causes.selection.residual
    names = residual.context.row_names
    shapes = sum((now.torque(h) for h in causes.generic), np.zeros_like(residual.y))
    size = rows(shapes, residual.weight)
    # Within what equations may err by, a shape that is distinct is there all the same.
    e = check.errors
    energy = np.maximum(e.after**2 - e.floor**2 - e.discrepancy**2, size**2)
    total = float(energy.sum())
    where = {n: float(e / total) if total > 0 else 0.0 for n, e in zip(names, energy, strict=True)}
    with_shapes = min(run.error(causes.everything), check.after) if causes.generic else check.after
    return Remainder(check.unexplained, where, _resembled(causes, given), with_shapes)


def _resembled(causes: Causes, given: Verdict) -> tuple[str, ...]:
    """Shapes that are carried without a name; of a remainder without one, the candidate that would take most of it."""
    like = list(causes.generic)
    if not like and given in (Verdict.UNKNOWN, Verdict.PARTLY):
        told = causes.told
        barred = {h.key for h in (*causes.dropped, *told.posterior.chosen)}
        others = [c for c in told.candidates if c.key not in barred]
        gains = told.evidence.gains(told.posterior, others) if others else np.zeros(0)
        if np.max(gains, initial=0.0) > 0.0:
            like = [others[int(np.argmax(gains))]]
    return tuple(f"{h.family} at {h.place.name}" for h in like)


def _shares(evidence: Evidence) -> Float[np.ndarray, " n"]:
    """What each row has of the gap's energy."""
    energy = evidence.gap**2 * evidence.count
    return energy / max(energy.sum(), 1e-300)


def _trace(residual, checked: Check) -> Trace:
    names = residual.context.row_names
    return Trace(residual.time, residual.y, checked.left, residual.weight, names, states(residual))


def _shrink(
    run: HeldOut | OtherRun, left: Float[np.ndarray, "R n"], ordinary: Posterior, own: Residual
) -> Shrink:
    """What is quoted of a run: every row in which a joint moves alike."""
    residual, y = run.residual, run.residual.y
    moving = residual.moving
    noise = noise_of(residual, left)
    per_joint = zip(rows(y, moving).tolist(), rows(left, moving).tolist(), strict=True)
    return Shrink(
        rms(y, moving),
        rms(run.left(ordinary), moving),
        rms(left, moving),
        rms(np.broadcast_to(noise, y.shape), moving),
        dict(zip(residual.context.row_names, per_joint, strict=True)),
        shrink_interval(moving * y**2, moving * left**2),
        rms(left_by_least_squares(own, run), moving),
    )
