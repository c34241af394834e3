"""report.json, report.html and the figure of replays."""

import base64
import dataclasses
import io
from typing import Any

import numpy as np

from jax_inertia.replay.command import Half
from jax_inertia.replay.command import to_report as measured
from jax_inertia.replay.listing import PARAMETERS, size_of
from jax_inertia.replay.loop import COMMAND, UNITS, Loop
from jax_inertia.replay.output.figures import replays
from jax_inertia.replay.output.policy import policy
from jax_inertia.replay.result import OTHER_RUN, Diagnosis, Effect, Replayed, Size, total
from jax_inertia.replay.step_law import law
from jax_inertia.text.report_page import rendered
from jax_inertia.text.words import chance, number, percent, plain, unit


def to_report(found: Diagnosis, *, quality=(), halves: tuple[Half, ...] = ()) -> dict[str, Any]:
    """The diagnosis in the contract's form, schema 1, in JSON's own types, no NaN; `halves`: loops by torque alone."""
    out = clean(
        _verdict(found)
        | _joints(found)
        | _replays(found)
        | {
            "effects": [_effect(e) for e in found.effects],
            "loop": loop_report(found.names, found.loop),
            "command": None,
            "step_law": law(found.names, found.numbers),
            "clock": {name: _size(size) for name, size in found.clock},
            "changes": [x._asdict() for x in found.changes],
            "policy": policy(found),
            "when": [],
            "undetectable_below": [],
            "suggested_motion": {},
            "data_quality": [
                {"severity": str(q.severity), "check": q.check, "message": q.message}
                for q in quality
            ],
            "doubts": [
                *found.impossible,
                *(
                    f"the corrected model replays {name!r} worse than the nominal one"
                    for name in found.worse
                ),
            ],
            "notes": list(found.notes),
        }
    )
    if halves:
        out["command"] = clean(command_report(halves, found.loop, out))
    return out


def _verdict(found: Diagnosis) -> dict[str, Any]:
    return {
        "schema": 1,
        "verdict": str(found.verdict),
        "confidence": found.confidence,
        "log_odds": found.log_odds,
        "headline": found.headline,
    }


def _joints(found: Diagnosis) -> dict[str, Any]:
    """Every ordinary number, listed as an effect or not."""
    joints: dict[str, dict] = {name: {} for name in found.names}
    shared: dict[str, dict] = {}
    for k, p in enumerate(found.everything.table):
        size = size_of(found.everything, k, found.loop)
        if p.body:
            continue
        if p.family == "viscous_friction":
            joints[found.names[p.joint]] |= _damping(size, float(found.loop.kd[p.joint]))
            continue
        (joints[found.names[p.joint]] if p.joint >= 0 else shared)[p.family] = _size(size)
    return {"joints": joints, "all_joints": shared}


def _replays(found: Diagnosis) -> dict[str, Any]:
    """Errors of the test rows, and the remainder of the gap."""
    r = found.replayed
    energy = np.maximum(r.before**2 - r.floor**2, 0.0)
    rest = np.maximum(r.after**2 - r.floor**2, 0.0)
    left = float(rest.sum() / max(energy.sum(), 1e-300))
    return {
        "gap": {
            "unit": "rad",
            "chi2": float(np.mean((r.before / np.maximum(r.floor, 1e-12)) ** 2)),
            "noise_floor": total(r.floor),
            "per_joint_rms": dict(zip(found.names, r.before, strict=True)),
            "share": dict(zip(found.names, energy / max(energy.sum(), 1e-300), strict=True)),
        },
        "shrink": {
            "heldout": None if r.of == OTHER_RUN else torque_report(found.names, r),
            "test_log": torque_report(found.names, r) if r.of == OTHER_RUN else None,
            "rollout": None,
            "replay": replay_report(found.names, r, found.discrepancy),
        },
        "explained_share": 1.0 - left,
        "remainder": {
            "share": left,
            "where": dict(zip(found.names, rest / max(rest.sum(), 1e-300), strict=True)),
            "resembles": "; ".join(str(x) for x in found.resembles),
            "joints": [dataclasses.asdict(x) for x in found.left],
        },
    }


def _damping(size: Size, kd: float) -> dict[str, dict[str, Any]]:
    """A sum of damping and kd, less kd, as two numbers that are possible: a sum below kd is less kd and no damping."""
    ends = size.value, size.low, size.high
    damping, less = ([f(x, 0.0) for x in ends] for f in (max, min))
    out = {"viscous_friction": _size(Size(damping[0], damping[1], damping[2], size.unit))}
    if kd > 0 and less[0] < 0:
        out["kd"] = _size(Size(kd + less[0], kd + less[1], kd + less[2], size.unit))
    return out


def replay_report(names, r: Replayed, discrepancy: np.ndarray) -> dict[str, Any]:
    """What replays say, over all joints and each."""
    before, after, floor = (total(x) for x in (r.before, r.after, r.floor))
    return {
        "before": before,
        "after": after,
        "floor": floor,
        "unit": "rad",
        "of": r.of,
        "per_joint": {
            name: {"before": b, "after": a, "floor": f, "discrepancy": d}
            for name, b, a, f, d in zip(names, r.before, r.after, r.floor, discrepancy, strict=True)
        },
    }


def torque_report(names, r: Replayed) -> dict[str, Any] | None:
    """Torque along the replays against what was logged; `loop`: of the loop alone, at the measured positions."""
    x = r.torques
    if x is None:
        return None
    return {
        "before": total(x.before),
        "after": total(x.after),
        "noise": total(x.replay_floor),
        "unit": "N m",
        "per_joint": {
            name: {"before": b, "after": a}
            for name, b, a in zip(names, x.before, x.after, strict=True)
        },
        "loop": {
            "before": total(x.loop_before),
            "after": total(x.loop_after),
            "noise": total(x.floor),
        },
    }


def command_report(halves: tuple[Half, ...], loop: Loop, out: dict[str, Any]) -> dict | None:
    """The `command` key: each joint's loop as its torque alone shows it, and what the search says of this half."""
    said = measured(halves, loop.kp, loop.kd, list(out["loop"]["joints"]))
    if said is None:
        return None
    return said | {"effects": [e for e in out["effects"] if e["half"] == "command"]}


def loop_report(names, loop: Loop) -> dict[str, Any]:
    """The position loop that was replayed."""
    return {
        "source": loop.source,
        "joints": {
            name: {"kp": kp, "kd": kd, "limit": limit if np.isfinite(limit) else None}
            for name, kp, kd, limit in zip(names, loop.kp, loop.kd, loop.limit, strict=True)
        },
    }


def _effect(e: Effect) -> dict[str, Any]:
    return {
        "family": e.family,
        "location": {"kind": e.kind, "name": e.name},
        "half": "command" if e.family in COMMAND else "motion",
        "ordinary": e.ordinary,
        "parameters": {name: _size(size) for name, size in e.sizes},
        "share": e.share,
        "probability": e.probability,
        "log_odds": e.log_odds,
        "explained_heldout": e.share,
        "equivalent": [
            {
                "family": tie.family,
                "location": {"kind": tie.kind, "name": tie.name},
                "kind": "exact" if tie.exact else "motion_limited",
                "text": tie.text,
            }
            for tie in e.ties
        ],
    }


def _size(s) -> dict[str, Any]:
    return {"value": s.value, "ci95": [s.low, s.high], "unit": s.unit}


def clean(x: Any) -> Any:
    """JSON's own types; what is not finite is none."""
    if isinstance(x, dict):
        return {str(k): clean(v) for k, v in x.items()}
    if isinstance(x, list | tuple):
        return [clean(v) for v in x]
    if isinstance(x, np.generic):
        x = x.item()
    return x if not isinstance(x, float) or np.isfinite(x) else None


def page(found: Diagnosis, report: dict, names: tuple[str, str]) -> str:
    """The report as one HTML file, every name in it escaped; `names`: of log and model."""
    filters = {"plain": plain, "number": number, "percent": percent, "chance": chance}
    out = io.BytesIO()
    replays(found.names, found.replayed).savefig(out, format="svg", metadata={"Date": None})
    picture = "data:image/svg+xml;base64," + base64.b64encode(out.getvalue()).decode()
    families = [f for f in PARAMETERS if any(f in own for own in report["joints"].values())]
    commanded = [e for e in found.effects if e.family in COMMAND]
    moving = [e for e in found.effects if e.family not in COMMAND]
    halves = [
        ("From targets to torque", "gains, delay, limits, dead band", commanded),
        ("From torque to motion", "rotor, friction, play, masses, encoders", moving),
    ]
    return rendered(
        "jax_inertia.replay",
        filters,
        found=found,
        halves=halves,
        report=report,
        names=names,
        picture=picture,
        families=families,
        units=UNITS,
        unit_of=unit,
    )
