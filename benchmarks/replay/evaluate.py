"""Diagnose development data and score it; PACE-like beside.

    python benchmarks/replay/evaluate.py diagnose DATA [--only 00003 ...]     writes DATA/*/found.json
    python benchmarks/replay/evaluate.py score DATA                           the table

A diagnosis sees log.npz without torque (its last 30 % are the gate); errors are of test.npz, which neither fit saw.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import argparse
import json
import resource
import time
from pathlib import Path

import mujoco
import numpy as np
from evaluator import replayed
from pace_like import PaceLike, errors

ORDINARY = {
    "armature", "viscous_friction", "coulomb_friction", "encoder_offset", "kp_scale", "kd_scale", "target_delay",
}  # fmt: skip


def diagnose(folder: Path) -> None:
    """Write found.json of a folder."""
    import jax_inertia as ji
    from jax_inertia.replay import command, pipeline
    from jax_inertia.replay.output import report
    from jax_inertia.replay.record import record_of
    from jax_inertia.replay.simulation.spec_edits import with_loop

    def spec():
        return mujoco.MjSpec.from_file(str(folder / "nominal.xml"))

    logs = [ji.read_log(folder / f"{name}.npz") for name in ("log", "test")]
    halves = command.command_half(logs[0])
    log, test = (_without_torque(x) for x in logs)
    clock, cpu = time.time(), _cpu()
    found = pipeline.diagnose([log], spec)
    spent = _cpu() - cpu
    record = record_of(test, found.loop)
    run = record.time, record.q, record.target
    given = spec()
    if found.loop.source != "model":
        with_loop(given, log.joint_names, found.loop)
    given.compile()
    nominal, path = (replayed(text, log.joint_names, *run) for text in (given.to_xml(), found.text))
    start = _cpu()
    pace = PaceLike(spec(), log.joint_names, found.loop.kp, found.loop.kd)
    fitted = record_of(log, found.loop)
    numbers = pace.fit([(fitted.time, fitted.q, fitted.target)], [1.0])
    out = report.to_report(found)
    keep = ("verdict", "confidence", "headline", "effects", "notes", "joints", "all_joints")
    kp, kd = np.asarray(logs[0].kp), np.asarray(logs[0].kd)
    result = {k: out[k] for k in keep} | {
        "seconds": time.time() - clock, "cpu": spent, "pace_cpu": _cpu() - start,
        "gate": out["shrink"]["replay"],
        "test": {
            "nominal": errors(nominal, run).tolist(),
            "ours": errors(path, run).tolist(),
            "pace": errors(pace.replay(numbers, run), run).tolist(),
        },
        "command": command.findings(halves, kp, kd, logs[0].joint_names) if halves else None,
    }  # fmt: skip
    (folder / "found.json").write_text(json.dumps(report.clean(result), indent=1))


def _cpu() -> float:
    use = resource.getrusage(resource.RUSAGE_SELF)
    return use.ru_utime + use.ru_stime


def _without_torque(log):
    from jax_inertia.logs.log import Log

    keep = ("time", "joint_names", "qpos", "qpos_target", "kp", "kd")
    return Log(**{k: getattr(log, k) for k in keep})


def key(effect: dict) -> tuple[str, str]:
    """Family and place."""
    return effect["family"], effect["location"]["name"]


def judged(truth: dict, found: dict) -> dict:
    """Which hidden effects were named, or are ties of one that was; what was invented."""
    hidden = [(e["family"], e["name"]) for e in truth["effects"]]
    listed = [key(e) for e in found["effects"]]
    ties = {key(t) for e in found["effects"] for t in e["equivalent"]}
    odd = [key(e) for e in found["effects"] if not e["ordinary"]]
    allowed = {*hidden, *ties}
    # One rotor, friction, delay at every joint is hidden too.
    usual = truth["kind"] not in ("sound", "alone")
    wrong = [x for x in odd if x not in allowed]
    if not usual:
        wrong += [x for x in listed if x[0] in ORDINARY and x not in allowed]
    return {
        "named": [x in listed for x in hidden],
        "tied": [x in listed or x in ties for x in hidden],
        "first": bool(hidden) and (odd or listed or [None])[0] in hidden,
        "wrong": wrong,
    }


def score(data: Path) -> str:
    """The table, and one line a log."""
    lines, rows = [], []
    for folder in sorted(data.iterdir()):
        if not (folder / "found.json").exists():
            continue
        truth, found = (json.loads((folder / f"{x}.json").read_text()) for x in ("truth", "found"))
        verdict, test = judged(truth, found), {k: np.array(v) for k, v in found["test"].items()}
        rms = {k: float(np.sqrt(np.mean(v**2))) for k, v in test.items()}
        rows.append((truth, found, verdict, rms, test))
        hidden = ", ".join(f"{e['family']} {e['name']}" for e in truth["effects"]) or "-"
        told = ", ".join(" ".join(key(e)) for e in found["effects"] if not e["ordinary"]) or "-"
        lines.append(
            f"{folder.name} {truth['robot']:9} {truth['kind']:8} {found['verdict']:9} hidden: {hidden}; odd: {told}; "
            f"mrad {1e3 * rms['nominal']:.1f} -> {1e3 * rms['ours']:.2f} (PACE-like {1e3 * rms['pace']:.2f}); "
            f"CPU {found['cpu']:.0f} s"
        )
    return "\n".join([*table(rows), "", *lines])


def table(rows) -> list[str]:
    """By kind of robot."""
    out = [
        "| hidden | logs | no_gap | named | or tied | first | invented (logs) | error after / before | PACE-like "
        "| ours ≤ PACE-like |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for kind in ("sound", "ordinary", "alone", "single", "pair"):
        mine = [r for r in rows if r[0]["kind"] == kind]
        if not mine:
            continue
        named = [x for r in mine for x in r[2]["named"]]
        tied = [x for r in mine for x in r[2]["tied"]]
        share = [np.median([r[3][k] / r[3]["nominal"] for r in mine]) for k in ("ours", "pace")]
        better = sum(r[3]["ours"] <= 1.02 * r[3]["pace"] for r in mine)
        cells = (
            kind, len(mine), sum(r[1]["verdict"] == "no_gap" for r in mine), f"{sum(named)} of {len(named)}",
            f"{sum(tied)} of {len(tied)}", sum(r[2]["first"] for r in mine), sum(bool(r[2]["wrong"]) for r in mine),
            f"{share[0]:.3f}", f"{share[1]:.3f}", better,
        )  # fmt: skip
        out.append("| " + " | ".join(map(str, cells)) + " |")
    families = sorted({e["family"] for r in rows for e in r[0]["effects"]})
    out += ["", "| family | hidden | named | or tied |", "|---|---|---|---|"]
    for family in families:
        hits = [
            (n, t)
            for r in rows
            for e, n, t in zip(r[0]["effects"], r[2]["named"], r[2]["tied"], strict=True)
            if e["family"] == family
        ]
        out.append(
            f"| {family} | {len(hits)} | {sum(h[0] for h in hits)} | {sum(h[1] for h in hits)} |"
        )
    return out


def main() -> None:
    """Of the command line."""
    parser = argparse.ArgumentParser()
    parser.add_argument("what", choices=("diagnose", "score"))
    parser.add_argument("data", type=Path)
    parser.add_argument("--only", nargs="+", default=[])
    args = parser.parse_args()
    if args.what == "score":
        print(score(args.data))
        return
    for folder in sorted(args.data.iterdir()):
        if folder.is_dir() and (not args.only or folder.name in args.only):
            diagnose(folder)


if __name__ == "__main__":
    main()
