"""The contract's report.json."""

from collections.abc import Sequence
from typing import Any

from jax_inertia.diagnosis.report.json_values import clean, located, motion_values, rollout_values
from jax_inertia.diagnosis.simulate.rollout import Rollouts
from jax_inertia.gap.energies import Shrink
from jax_inertia.gap.finding import Diagnosis, Finding
from jax_inertia.gap.suggest import suggestions
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
            "rollout": None if rollouts is None else rollout_values(rollouts),
        },
        "when": [[round(t, 3) for t in w] for w in found.when],
        "undetectable_below": [
            {"family": family, "location": located(place), "value": p.value, "unit": p.unit}
            for family, place, p in found.undetectable_below
        ],
        "suggested_motion": motion_values(suggestions(found)),
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
