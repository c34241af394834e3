"""The contract's report.json."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from jax_inertia.gap.energies import Shrink
from jax_inertia.gap.families.base import Place
from jax_inertia.gap.finding import Diagnosis, Finding
from jax_inertia.gap.rollout import Rollouts
from jax_inertia.gap.suggest import Suggestion, suggestions
from jax_inertia.gap.trace import regions
from jax_inertia.preflight.preflight import Finding as Quality


def to_report(
    found: Diagnosis, *, rollouts: Rollouts | None = None, quality: Sequence[Quality] = ()
) -> dict[str, Any]:
    """The diagnosis in the contract's form, schema 1: only JSON's own types, no NaN.

    Beyond the contract: `where` (rows, bodies, regions of state), `doubts`, `data_quality`, `notes`.
    """
    heldout = _shrink(found.heldout, found.unit)
    if found.heldout.interval is not None:
        heldout["ci95"] = list(found.heldout.interval)
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
            "heldout": heldout,
            "test_log": None if found.test is None else _shrink(found.test, found.unit),
            "rollout": None if rollouts is None else _rollout(rollouts),
        },
        "when": [[round(t, 3) for t in w] for w in found.when],
        "undetectable_below": [
            {"family": family, "location": located(place), "value": p.value, "unit": p.unit}
            for family, place, p in found.undetectable_below
        ],
        "suggested_motion": _motion(suggestions(found)),
        "where": _where(found),
        "data_quality": [
            {"severity": str(f.severity), "check": f.check, "message": f.message} for f in quality
        ],
        "doubts": list(found.doubts),
        "notes": list(found.notes),
    }
    return {name: clean(value) for name, value in report.items()}


def _effect(f: Finding) -> dict[str, Any]:
    return {
        "family": f.family,
        "location": located(f.place),
        "parameters": {
            name: {"value": p.value, "ci95": [p.low, p.high], "unit": p.unit}
            for name, p in f.parameters.items()
        },
        "explained_heldout": f.explained,
        "probability": f.probability,
        "equivalent": [
            {"family": t.family, "location": located(t.place), "kind": t.kind} for t in f.equivalent
        ],
    }


def _shrink(s: Shrink, unit: str) -> dict[str, Any]:
    return {
        "before": s.before,
        "after": s.after,
        "noise": s.noise,
        "sensor_noise": s.sensors,
        "model_errors": s.excused,
        "unit": unit,
        "band_hz": s.band,
    }


def _rollout(r: Rollouts) -> dict[str, Any]:
    return {
        "horizon_s": r.horizon,
        "before": r.before,
        "after": r.after,
        "floor": r.floor,
        "unit": r.unit,
        "windows": len(r.starts),
        "notes": list(r.notes),
    }


def _motion(wanted: tuple[Suggestion, ...]) -> dict[str, Any]:
    """The first suggestion, with all others beside it; empty where nothing ties."""
    if not wanted:
        return {}
    every = [
        {
            "between": list(s.between),
            "joint": s.where,
            "kind": s.kind,
            "text": s.text,
            "numbers": s.numbers,
        }
        for s in wanted
    ]
    return {**every[0], "others": every[1:]}


def _where(found: Diagnosis) -> dict[str, Any]:
    base = sum(share for row, share in found.share.items() if row.startswith("base["))
    return {
        "rows": {"base": base, "joints": sum(found.share.values()) - base},
        "bodies": [
            {"body": f.body, "share": f.share, "peak_force_N": f.peak} for f in found.trace.forces
        ],
        "regions": [
            {"row": r.row, "signal": r.signal, "edges": r.edges.tolist(), "share": r.share.tolist()}
            for r in regions(found.trace)
        ],
    }


def located(place: Place) -> dict[str, Any]:
    """A place as the contract writes it."""
    return {"kind": place.kind, "name": place.name}


def clean(x):
    """Plain floats; what is not finite becomes null, which JSON has."""
    if isinstance(x, dict):
        return {k: clean(v) for k, v in x.items()}
    if isinstance(x, list):
        return [clean(v) for v in x]
    if isinstance(x, float | np.generic):
        value = float(x)
        return value if math.isfinite(value) else None
    return x
