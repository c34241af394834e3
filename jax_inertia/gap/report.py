"""The contract's report.json."""

import math

from jax_inertia.gap.diagnosis import Diagnosis, Finding, Shrink
from jax_inertia.gap.families.base import Place


def to_report(found: Diagnosis) -> dict:
    """The diagnosis in the contract's form, schema 1: only JSON's own types, no NaN."""
    report = {
        "schema": 1,
        "verdict": str(found.verdict),
        "confidence": found.confidence,
        "gap": {
            "chi2": found.chi2,
            "noise_floor": found.noise_floor,
            "per_joint_rms": found.per_joint_rms,
            "share": found.share,
        },
        "effects": [_effect(f) for f in found.findings],
        "shrink": {
            "heldout": _shrink(found.heldout),
            "test_log": None if found.test is None else _shrink(found.test),
            "rollout": None,
        },
        "when": [list(w) for w in found.when],
        "undetectable_below": [
            {"family": family, "location": _place(place), "value": p.value, "unit": p.unit}
            for family, place, p in found.undetectable_below
        ],
        "suggested_motion": {},
        "notes": list(found.notes),
    }
    return {name: _clean(value) for name, value in report.items()}


def _effect(f: Finding) -> dict:
    return {
        "family": f.family,
        "location": _place(f.place),
        "parameters": {
            name: {"value": p.value, "ci95": [p.low, p.high], "unit": p.unit}
            for name, p in f.parameters.items()
        },
        "explained_heldout": f.explained,
        "probability": f.probability,
        "equivalent": [
            {"family": t.family, "location": _place(t.place), "kind": t.kind} for t in f.equivalent
        ],
    }


def _shrink(s: Shrink) -> dict:
    return {"before": s.before, "after": s.after, "noise": s.noise, "unit": "N m"}


def _place(place: Place) -> dict:
    return {"kind": place.kind, "name": place.name}


def _clean(x):
    """Plain floats; what is not finite becomes null, which JSON has."""
    if isinstance(x, dict):
        return {k: _clean(v) for k, v in x.items()}
    if isinstance(x, list):
        return [_clean(v) for v in x]
    if isinstance(x, float) or hasattr(x, "dtype"):
        value = float(x)
        return value if math.isfinite(value) else None
    return x
