"""report.json of a whole-robot diagnosis, schema 1."""

from collections.abc import Sequence
from typing import Any

from jax_inertia.diagnosis.effects.base import Effect, Interval
from jax_inertia.diagnosis.friction_curve import EQUATION, NUMBERS_OF, FrictionCurve
from jax_inertia.diagnosis.report.json_values import clean, located, motion_values, rollout_values
from jax_inertia.diagnosis.report.next_motion import to_record
from jax_inertia.diagnosis.result import Diagnosis, Found, NotListed, Shrink
from jax_inertia.diagnosis.simulate.rollout import Rollouts
from jax_inertia.preflight.preflight import Finding as Quality


def to_report(
    found: Diagnosis,
    *,
    rollouts: Rollouts | None = None,
    quality: Sequence[Quality] = (),
    extra: Sequence[Effect] = (),
) -> dict[str, Any]:
    """The diagnosis in the contract's form: only JSON's own types, no NaN."""
    report = {
        "schema": 1,
        "verdict": str(found.verdict),
        "confidence": found.confidence,
        "log_odds": found.log_odds,
        "headline": found.headline,
        "gap": {
            "chi2": found.chi2,
            "noise_floor": found.noise_floor,
            "per_joint_rms": found.per_joint_rms,
            "share": found.share,
        },
        "effects": [_effect(f) for f in found.found],
        "not_listed": [_not_listed(other) for other in found.not_listed],
        "joints": {
            name: {family: _number(p) for family, p in own.items()}
            | {"coulomb_friction": _dry(own["coulomb_friction"], found.presliding.get(name))}
            | ({"torque_gain": _number(found.gains[name])} if name in found.gains else {})
            for name, own in found.joints.items()
        },
        "friction": {name: _law(curve) for name, curve in found.friction.items()},
        "drive_gains": {"value": found.drive_gains, "unit": "N m per unit of the log"}
        if found.drive_gains
        else None,
        "shrink": {
            "heldout": _shrink(found.heldout),
            "validation_log": None if found.validation is None else _shrink(found.validation),
            "test_log": None if found.test is None else _shrink(found.test),
            "rollout": None if rollouts is None else rollout_values(rollouts),
        },
        "explained_share": 1.0 - found.remainder.share,
        "remainder": {
            "share": found.remainder.share,
            "with_shapes": found.remainder.with_shapes,
            "where": found.remainder.where,
            "resembles": "; ".join(found.remainder.resembles),
        },
        "where": _where(found),
        "when": [list(stretch) for stretch in found.when],
        "undetectable_below": [
            {"family": family, "location": located(place), "value": p.value, "unit": p.unit}
            for family, place, p in found.undetectable_below
        ],
        "suggested_motion": motion_values(to_record(found, extra)),
        "data_quality": [
            {"severity": str(q.severity), "check": q.check, "message": q.message} for q in quality
        ],
        "doubts": [],
        "notes": list(found.notes),
    }
    return {name: clean(value) for name, value in report.items()}


def _effect(f: Found) -> dict[str, Any]:
    return {
        "family": f.family,
        "location": located(f.place),
        "ordinary": f.ordinary,
        "handed_over": f.handed_over,
        "equation": f.equation,
        "parameters": {
            name: _number(p) | ({"added_to": p.added_to} if p.added_to else {})
            for name, p in f.parameters.items()
        },
        "share": f.share,
        "explained_heldout": f.explained_heldout,
        "evidence": f.evidence,
        "log_odds": f.log_odds,
        "probability": f.probability,
        "equivalent": [
            {"family": t.family, "location": located(t.place), "kind": t.kind} for t in f.equivalent
        ],
    }


def _not_listed(other: NotListed) -> dict[str, Any]:
    return {
        "family": other.family,
        "location": located(other.place),
        "log_odds": other.log_odds,
        "probability": other.probability,
    }


def _law(curve: FrictionCurve) -> dict[str, Any]:
    """A joint's friction law, term by term, the main bristle first (`FrictionCurve`)."""
    first = sorted(curve.terms.items(), key=lambda item: item[0] != curve.main)
    return {
        "equation": EQUATION,
        "terms": [
            {"form": term.form}
            | {name: getattr(term, of) for name, of in NUMBERS_OF[term.form].items()}
            | ({"effect": curve.effects[term]} if term in curve.effects else {})
            | _number(p)
            for term, p in first
        ],
        "quadratic_in_model": curve.quadratic,
    }


def _where(found: Diagnosis) -> dict[str, Any]:
    base = sum(share for row, share in found.share.items() if row.startswith("base["))
    return {
        "rows": {"base": base, "joints": sum(found.share.values()) - base},
        "bodies": [
            {"body": f.body, "share": f.share, "peak_force_N": f.peak} for f in found.forces
        ],
        "regions": [
            {"row": r.row, "signal": r.signal, "edges": r.edges.tolist(), "share": r.share.tolist()}
            for r in found.regions
        ],
    }


def _dry(level: Interval, presliding: float | None) -> dict[str, Any]:
    """The level, and the displacement over which it turns round after a reversal, where it has one."""
    turns = presliding is not None and presliding >= 0
    sliding = {"presliding": {"value": presliding, "unit": "rad"}} if turns else {}
    return _number(level) | sliding


def _number(p: Interval) -> dict[str, Any]:
    return {"value": p.value, "ci95": [p.low, p.high], "unit": p.unit}


def _shrink(s: Shrink) -> dict[str, Any]:
    return {
        "before": s.before,
        "ordinary": s.ordinary,
        "least_squares": s.least_squares,
        "after": s.after,
        "noise": s.noise,
        "unit": "N m",
        "ci95": list(s.interval),
        "per_joint": {n: {"before": b, "after": a} for n, (b, a) in s.per_joint.items()},
    }
