"""report.json, report.html and the figure of replays."""

import base64
import io
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from jax_inertia.replay.corrected import policy
from jax_inertia.replay.loop import UNITS, Loop
from jax_inertia.replay.pipeline import PARAMETERS, size_of
from jax_inertia.replay.result import Diagnosis, Effect, Replayed, total
from jax_inertia.text.report_page import rendered
from jax_inertia.text.words import chance, number, percent, plain, unit

BLUE, ORANGE, GREY = "#0072B2", "#D55E00", "#666666"
_SHOWN = 10.0  # Of a motion, seconds about the worst moment.


def to_report(found: Diagnosis, *, quality=(), command: dict | None = None) -> dict[str, Any]:
    """The diagnosis in the contract's form, schema 1: only JSON's own types, no NaN."""
    r = found.replayed
    energy = np.maximum(r.before**2 - r.floor**2, 0.0)
    rest = np.maximum(r.after**2 - r.floor**2, 0.0)
    joints: dict[str, dict] = {name: {} for name in found.names}
    shared: dict[str, dict] = {}
    for k, p in enumerate(found.everything.table):
        size = size_of(found.everything, k, found.loop)
        (joints[found.names[p.joint]] if p.joint >= 0 else shared)[p.family] = _size(size)
    return clean(
        {
            "schema": 1,
            "verdict": str(found.verdict),
            "confidence": found.confidence,
            "headline": found.headline,
            "gap": {
                "unit": "rad",
                "chi2": float(np.mean((r.before / np.maximum(r.floor, 1e-12)) ** 2)),
                "noise_floor": total(r.floor),
                "per_joint_rms": dict(zip(found.names, r.before, strict=True)),
                "share": dict(zip(found.names, energy / max(energy.sum(), 1e-300), strict=True)),
            },
            "effects": [_effect(e) for e in found.effects],
            "joints": joints,
            "all_joints": shared,
            "shrink": {
                "heldout": None,
                "test_log": None,
                "rollout": None,
                "replay": replay_report(found.names, r),
            },
            "explained_share": 1.0 - float(rest.sum() / max(energy.sum(), 1e-300)),
            "remainder": {
                "share": float(rest.sum() / max(energy.sum(), 1e-300)),
                "where": dict(zip(found.names, rest / max(rest.sum(), 1e-300), strict=True)),
                "resembles": "",
            },
            "loop": loop_report(found.names, found.loop),
            "command": command,
            "policy": policy(found),
            "when": [],
            "undetectable_below": [],
            "suggested_motion": {},
            "data_quality": [
                {"severity": str(q.severity), "check": q.check, "message": q.message} for q in quality
            ],
            "doubts": [f"the corrected model replays {name!r} worse than the nominal one" for name in found.worse],
            "notes": list(found.notes),
        }
    )  # fmt: skip


def replay_report(names, r: Replayed) -> dict[str, Any]:
    """What replays say, over all joints and each."""
    before, after, floor = (total(x) for x in (r.before, r.after, r.floor))
    return {
        "before": before,
        "after": after,
        "floor": floor,
        "unit": "rad",
        "of": r.of,
        "per_joint": {
            name: {"before": b, "after": a, "floor": f}
            for name, b, a, f in zip(names, r.before, r.after, r.floor, strict=True)
        },
    }


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
        "ordinary": e.ordinary,
        "parameters": {e.parameter: _size(e.size)},
        "share": e.share,
        "explained_heldout": e.share,
        "equivalent": [
            {"family": tie, "location": {"kind": e.kind, "name": e.name}, "kind": kind}
            for tie, kind in e.ties
        ],
    }  # fmt: skip


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


def figure(names, r: Replayed, *, both: bool = True) -> Figure:
    """Joint positions as commanded, as measured and as replayed, around the nominal model's largest error."""
    error = np.abs(r.nominal - r.record.q)
    worst = float(r.record.time[int(np.argmax(error.max(axis=1)))])
    first = min(max(worst - 0.5 * _SHOWN, 0.0), max(r.record.time[-1] - _SHOWN, 0.0))
    rows = (r.record.time >= first) & (r.record.time <= first + _SHOWN)
    t, n = r.record.time[rows], len(names)
    columns = 1 if n < 4 else 2
    high = -(-n // columns)
    with rc_context({"text.parse_math": False, "font.size": 8.5}):
        out = Figure((5.4 * columns, 0.9 + 1.5 * high), layout="constrained")
        grid = out.subplots(high, columns, sharex=True, squeeze=False)
        for j, axes in enumerate(grid.ravel()[:n]):
            axes.step(
                t, r.record.target[rows, j], where="post", color="#bbbbbb", lw=0.9, label="target"
            )
            axes.plot(t, r.record.q[rows, j], color="black", lw=1.4, label="robot")
            axes.plot(
                t,
                r.nominal[rows, j],
                color=ORANGE,
                lw=1.1,
                label="model" if not both else "nominal model",
            )
            if both:
                axes.plot(
                    t, r.corrected[rows, j], color=BLUE, lw=1.1, ls="--", label="corrected model"
                )
            text = f"{1e3 * r.before[j]:.3g} mrad" + (f" → {1e3 * r.after[j]:.3g}" if both else "")
            axes.set_title(f"{names[j]}: {text} rms", fontsize=8.5, loc="left")
            axes.grid(color="#e3e6ea", lw=0.6)
        for axes in grid.ravel()[n:]:
            axes.set_axis_off()
        for axes in grid[-1]:
            axes.set_xlabel("time [s]")
        grid[0, 0].set_ylabel("rad")
        handles, labels = grid[0, 0].get_legend_handles_labels()
        out.legend(handles, labels, loc="outside upper right", ncols=4, frameon=False)
    return out


def page(found: Diagnosis, report: dict, names: tuple[str, str]) -> str:
    """The report as one HTML file, every name in it escaped; `names`: of log and model."""
    filters = {"plain": plain, "number": number, "percent": percent, "chance": chance}
    out = io.BytesIO()
    figure(found.names, found.replayed).savefig(out, format="svg", metadata={"Date": None})
    picture = "data:image/svg+xml;base64," + base64.b64encode(out.getvalue()).decode()
    families = [f for f in PARAMETERS if any(f in own for own in report["joints"].values())]
    return rendered(
        "jax_inertia.replay",
        filters,
        found=found,
        report=report,
        names=names,
        picture=picture,
        families=families,
        units=UNITS,
        unit_of=unit,
    )
