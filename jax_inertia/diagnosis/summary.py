"""From a selection and its checks to what is reported: effects with intervals, the joints' table, the remainder."""

import dataclasses
from collections.abc import Iterator
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jax_inertia.diagnosis.causes import carried_over, judges_of, odds_of_another
from jax_inertia.diagnosis.checks import Check, HeldOut, OtherRun, rows, share
from jax_inertia.diagnosis.effects.actuator import GainTolerance
from jax_inertia.diagnosis.effects.base import Interval
from jax_inertia.diagnosis.effects.registry import LEVEL_OF
from jax_inertia.diagnosis.effects.tolerances import inertial_changes
from jax_inertia.diagnosis.hypothesis import Hypothesis
from jax_inertia.diagnosis.intervals import joint_numbers
from jax_inertia.diagnosis.listing import as_listed, effects
from jax_inertia.diagnosis.motor_gains import motor_gains
from jax_inertia.diagnosis.report.gap_stretches import gap_stretches
from jax_inertia.diagnosis.report.where import body_forces, regions, states
from jax_inertia.diagnosis.report.wording import headline
from jax_inertia.diagnosis.residual import Residual
from jax_inertia.diagnosis.result import Diagnosis, Found, Remainder, Shrink, Trace, Verdict
from jax_inertia.diagnosis.search.evidence import Evidence, Posterior
from jax_inertia.diagnosis.search.ordinary import bounded
from jax_inertia.diagnosis.search.refuted_tolerances import refuted
from jax_inertia.diagnosis.search.selection import Selection
from jax_inertia.diagnosis.settings import Settings
from jax_inertia.diagnosis.verdict import Doubts, confidence, verdict
from jax_inertia.maths.inertial_parameters import is_physical

SHARES = (1.0, 0.9, 0.75, 0.5, 0.25)
"""Of a body's error, the largest first, that may be taken out."""


def summarised(
    selection: Selection,
    everything: Posterior,
    heldout: HeldOut,
    other: OtherRun | None,
    dropped: tuple[Hypothesis, ...],
    as_bought: float,
    settings: Settings,
) -> Diagnosis:
    """Everything that is reported of a selection; `everything`: with the stand-ins that help to predict.

    `as_bought`: log odds that its model is [nats].
    """
    now, evidence, residual = selection.posterior, selection.evidence, selection.residual
    names = residual.context.row_names
    ordinary = evidence.posterior(tuple(h for h in now.chosen if not h.is_odd))
    left = residual.y - now.fitted
    shares = {id(h): share(residual, left, now.torque(h)) for h in now.chosen}
    likely, doubtful = effects(selection, shares, settings)
    generic = [h for h in now.chosen if h.is_odd and (not h.named or h in doubtful)]
    judge = heldout if other is None else other
    causes = _causes(selection, generic, judge, settings)
    by_cause = judge.check(ordinary, causes)
    # Shapes are there to predict: where the causes do it better, they are not.
    best = min(everything, causes, key=judge.error)
    own_causes = by_cause if other is None else heldout.check(ordinary, causes)
    own = own_causes if best is causes else heldout.check(ordinary, best)
    test = None
    if other is not None:
        test = by_cause if best is causes else other.check(ordinary, best)
    likely = [(h, f) for h, f in likely if h in causes.chosen]
    told = dataclasses.replace(selection, posterior=causes)
    before = dataclasses.replace(selection, posterior=everything)
    another = odds_of_another(before, causes, dropped, judges_of(heldout, other))
    bent = tuple(x.line for x in refuted(told, settings))
    doubts = Doubts(another, bool(bent), bool(generic))
    on_other = None if other is None else by_cause
    judged = verdict(own_causes, on_other, bool(likely), doubts, settings)
    trust = settings.adequate[0 if judged is Verdict.EXPLAINED else 1]
    found = as_listed(told, _by_other_stretches(heldout, causes, likely), trust)
    odd = [f.probability for f in found if not f.ordinary]
    sure = confidence(by_cause, judged, odd, doubts, settings)
    remainder = _remainder(by_cause, selection, generic)
    shrinks = _shrink(own, names), None if test is None else _shrink(test, names)
    joints, gains = joint_numbers(told), motor_gains(told)
    return Diagnosis(
        verdict=judged,
        confidence=sure,
        headline=headline(judged, found, shrinks, remainder, _lacking(residual, found), bent),
        found=found,
        joints=joints,
        gains=gains,
        presliding={
            h.place.name: float(h.shape[0]) for h in now.chosen if h.family == "coulomb_friction"
        },
        as_bought=as_bought,
        heldout=shrinks[0],
        test=shrinks[1],
        remainder=remainder,
        inertials=_inertials(told),
        notes=(*bent, *_flags(told, joints), *_gains(told, gains, settings), *_left_out(dropped)),
        trace=_trace(residual if other is None else other.residual, own if test is None else test),
        **_gap(residual, evidence),
    )


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


def _causes(
    selection: Selection, generic: list[Hypothesis], judge: HeldOut | OtherRun, settings: Settings
) -> Posterior:
    """What the verdict is about, and whose numbers are stated: a shape that names no cause explains nothing."""
    now, residual = selection.posterior, selection.residual
    causes = selection.evidence.posterior(tuple(h for h in now.chosen if h not in generic))
    causes = carried_over(bounded(residual, selection.evidence, causes), judge)
    causes = _at_stated_gains(causes, judge, settings)
    return bounded(residual, selection.evidence, causes)


def _at_stated_gains(now: Posterior, judge: HeldOut | OtherRun, settings: Settings) -> Posterior:
    """With motors' gains at one, as the log has them, where they are not distinct from it and predict no better.

    How uncertain they are stays in every interval.
    """
    gains = [
        now.part(h)
        for h in now.chosen
        if isinstance(h.effect, GainTolerance) and not _distinct(now, h, settings)
    ]
    if not gains:
        return now
    at = np.concatenate([np.arange(part.start, part.stop) for part in gains])
    stated = now.given(at, np.zeros(len(at)))
    return stated if judge.error(stated) <= (1.0 + settings.gate) * judge.error(now) else now


def _distinct(now: Posterior, h: Hypothesis, settings: Settings) -> bool:
    """Whether a gain is another than the one that the log's torques were computed with."""
    mean, covariance = now.of(h)
    return bool(abs(mean[0]) > settings.distinct * np.sqrt(covariance[0, 0]))


def _left_out(dropped: tuple[Hypothesis, ...]) -> tuple[str, ...]:
    """A line for each effect that the other run refuted."""
    return tuple(
        f"{h.family.replace('_', ' ')}{_at(h)} fits this log but not the other run; left out"
        for h in dropped
        if h.named
    )


def _at(h: Hypothesis) -> str:
    return "" if h.place.kind == "global" else f" at {h.place.name}"


def _inertials(selection: Selection) -> dict[str, tuple[float, ...]]:
    """Bodies without the errors that the log says they have, as far towards that as bodies can exist."""
    now, residual = selection.posterior, selection.residual
    base = next((h for h in now.chosen if h.family == "tolerances"), None)
    if base is None:
        return {}
    numbers = now.of(base)[0]
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
        at = {f.place.name for f in found if family in (f.family, LEVEL_OF.get(f.family))}
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


def _gains(selection: Selection, gains: dict[str, Interval], settings: Settings) -> Iterator[str]:
    """Torque constants that are distinct from what the log's torques were computed with."""
    for h in selection.posterior.chosen:
        if isinstance(h.effect, GainTolerance) and _distinct(selection.posterior, h, settings):
            gain = gains[h.place.name]
            yield (
                f"the motor of {h.place.name} gives {gain.value:.3g} [{gain.low:.3g}, {gain.high:.3g}] times the "
                "torque that its current was taken for"
            )


def _remainder(check: Check, selection: Selection, generic: list[Hypothesis]) -> Remainder:
    """What the causes leave, and shapes that name no cause."""
    now, residual = selection.posterior, selection.residual
    names = residual.context.row_names
    shapes = sum((now.torque(h) for h in generic), np.zeros_like(residual.y))
    rms = rows(shapes, residual.weight)
    # Within what equations may err by, a shape that is distinct is there all the same.
    energy = np.maximum(check.per_joint_after**2 - check.expected**2, rms**2)
    total = float(energy.sum())
    where = {n: float(e / total) if total > 0 else 0.0 for n, e in zip(names, energy, strict=True)}
    carried = tuple(f"{h.family} at {h.place.name}" for h in generic)
    return Remainder(check.unexplained, where, carried, check.after)


def _shares(evidence: Evidence) -> Float[np.ndarray, " n"]:
    """What each row has of the gap's energy."""
    energy = evidence.gap**2 * evidence.count
    return energy / max(energy.sum(), 1e-300)


def _trace(residual, checked: Check) -> Trace:
    names = residual.context.row_names
    return Trace(residual.time, residual.y, checked.left, residual.weight, names, states(residual))


def _shrink(c: Check, names: tuple[str, ...]) -> Shrink:
    rows_of = {
        n: (float(b), float(a))
        for n, b, a in zip(names, c.per_joint_before, c.per_joint_after, strict=True)
    }
    return Shrink(c.before, c.ordinary, c.after, c.noise, rows_of, c.interval)
