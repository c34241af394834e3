"""Scores reports on the robots of `cad.py`: the goals' table, row by row, beside plain least squares.

    python benchmarks/gap/evaluate_cad.py DATA [--reports DIR] [--run] [--jobs 1] [--out DIR] [--python PYTHON]

DATA holds 00042/{nominal.xml, log.npz, test.npz, truth.json}. The report of log 42 is DIR/00042/report.json (DIR is
DATA where none is named; 00042/out/report.json is found too). `--run` first diagnoses what has no report yet, each in
a fresh process of its own whose seconds are kept, `--jobs` of them at a time. Only this file reads both truth and
report. Writes results.json (a row per log) and RESULTS.md.

An odd effect counts as found where a listed effect that is not ordinary, or one stated equivalent to it, is the true
one or one that the truth states equivalent. It is asked for where it changes the log's torque by three sigma of what
else is uncertain (`cad_truth`). A listed effect is there if the truth has it: the ordinary terms of the joint, the odd
one, or the mild Stribeck and load parts that ordinary joints have (`present`).
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import copy
import json
import subprocess
import sys
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path

import baseline_least_squares
import mujoco
import numpy as np
from evaluate import key, wilson
from report_torque import NAMES, ORDINARY, ReportTorque
from torque_error import needed, read, torque_error

SEEN = 3.0  # sigma of what else is uncertain
DETERMINED = 0.10  # of a term's size: half of its 95 % interval under the truth's own uncertainty
CLOSE = 0.10
# A joint whose friction is odd has no ordinary friction to be compared with.
FRICTION = ("stribeck_friction", "load_friction", "asymmetric_coulomb", "unknown")


def diagnose(folder: Path, out: Path, python: str) -> None:
    """The command in a fresh process; time.json holds its seconds."""
    if (out / "report.json").exists():
        return
    out.mkdir(parents=True, exist_ok=True)
    command = [python, "-m", "jax_inertia", "diagnose", str(folder / "log.npz")]
    command += ["--model", str(folder / "nominal.xml")]
    begun = time.perf_counter()
    with (out / "console.txt").open("w") as console:
        status = subprocess.run([*command, "--out", str(out)], stdout=console, stderr=console)
    seconds = time.perf_counter() - begun
    (out / "time.json").write_text(json.dumps({"seconds": seconds, "exit": status.returncode}))


def report_of(reports: Path, name: str) -> Path | None:
    places = (reports / name, reports / name / "out")
    return next((p for p in places if (p / "report.json").exists()), None)


# -- a row


def score(job: tuple[str, str, str]) -> dict:
    """One log: what the tool says, what least squares leaves, what the truth told as a report leaves."""
    data, reports, name = job
    folder = Path(data) / name
    truth = json.loads((folder / "truth.json").read_text())
    odd = truth["odd"]
    row = {
        "log": name,
        "robot": truth["robot"],
        "odd": [odd.get("mechanism", odd["family"]), odd["location"]["name"]] if odd else None,
        "outside": bool(odd) and odd["family"] == "unknown",
        "sigmas": odd["visibility"]["sigmas"] if odd else 0.0,
        "errors": errors(folder, truth),
    }
    place = report_of(Path(reports), name)
    if place is None:
        return row | {"missing": True}
    try:
        report = json.loads((place / "report.json").read_text())
        row |= compare(truth, report)
        row["errors"]["tool"] = own_error(place, folder, report)
    except (KeyError, ValueError, TypeError) as error:
        return row | {"missing": True, "reason": f"{type(error).__name__}: {error}"}
    timing = place / "time.json"
    row["seconds"] = json.loads(timing.read_text())["seconds"] if timing.exists() else None
    return row


def errors(folder: Path, truth: dict) -> dict:
    """The measure [N m] on the other motion: nominal, least squares, the truth as a report; kept beside the log."""
    kept = folder / "errors.json"
    if kept.exists():
        return json.loads(kept.read_text())
    model = mujoco.MjModel.from_xml_path(str(folder / "nominal.xml"))
    log, test = read(folder / "log.npz"), read(folder / "test.npz")
    nominal = torque_error(model, needed, test)
    fitted = torque_error(model, baseline_least_squares.fit(model, log), test)
    told, left_out = oracle(folder, truth, test)
    out = {"nominal": nominal, "least_squares": fitted, "oracle": told, "oracle_without": left_out}
    part = kept.with_suffix(f".{os.getpid()}")
    part.write_text(json.dumps(out))
    part.replace(kept)
    return out


def oracle(folder: Path, truth: dict, test: dict) -> tuple[dict, list[str]]:
    """The least that such forms leave: real bodies, nearest ordinary terms with real bristles, and the odd effect."""
    real = folder / f".real.{os.getpid()}.xml"
    real.write_text(real_xml((folder / "nominal.xml").read_text(), truth["inertials"]))
    joints = copy.deepcopy(truth["joints"])
    for name, terms in joints.items():
        terms["coulomb_friction"]["presliding"] = truth["law"]["presliding"][name]
    odd = truth["odd"]
    known = odd and odd["family"] != "unknown"
    report = {"effects": [odd] if known else [], "joints": joints}
    told = ReportTorque(real, report)
    real.unlink()
    error = told.error(test)
    outside = ["outside the library"] if odd and not known else []
    return error, sorted(told.left_out) + outside


def real_xml(nominal: str, inertials: dict) -> str:
    """The nominal MJCF with the real bodies."""
    spec = mujoco.MjSpec.from_string(nominal)
    for name, error in inertials.items():
        body = spec.body(name)
        body.fullinertia = np.array(body.fullinertia) * (1 + error["mass"]) * (1 + error["inertia"])
        body.mass *= 1 + error["mass"]
        body.ipos = np.array(body.ipos) + error["com"]
    spec.compile()
    return spec.to_xml()


def own_error(place: Path, folder: Path, report: dict) -> dict | None:
    """The measure of the report, computed again; None where a family cannot be."""
    told = ReportTorque(folder / "nominal.xml", report, place / "corrected.xml")
    error = told.error(read(folder / "test.npz"))
    return error if not told.left_out else None


def keys_of(effect: dict) -> set[tuple[str, str]]:
    return {key(effect), *map(key, effect.get("equivalent", []))}


def compare(truth: dict, report: dict) -> dict:
    """What was right, by the contract's terms."""
    effects = report["effects"]
    odd_listed = [
        e for e in effects if not e.get("ordinary", False) and e["family"] not in ORDINARY
    ]
    ordinary_listed = [e for e in effects if e not in odd_listed]
    odd = truth["odd"]
    declared = keys_of(odd) if odd and odd["family"] != "unknown" else set()
    present = {key(e) for e in truth["present"]}
    is_odd = [bool(keys_of(e) & declared) for e in odd_listed]
    there = [hit or key(e) in present for e, hit in zip(odd_listed, is_odd, strict=True)]
    # At a joint with odd friction its ordinary part may be listed as the odd law's own.
    ordinary_there = [
        truth["joints"].get(e["location"]["name"], {}).get(e["family"], {"value": 0.0})["value"]
        != 0.0
        for e in ordinary_listed
    ]
    shrink = (report.get("shrink") or {}).get("heldout") or {}
    where = (report.get("remainder") or {}).get("where") or {}
    top = max(where, key=where.get) if where else None
    place = odd["location"]["name"] if odd else None
    if odd and odd["location"]["kind"] == "body":
        place = None
    return {
        "listed": [list(key(e)) for e in odd_listed],
        "there": there,
        "ordinary_there": ordinary_there,
        "found": any(is_odd),
        "family_right": bool(odd) and any(e["family"] == odd["family"] for e in odd_listed),
        "first": bool(is_odd) and is_odd[0],
        "invented": [list(key(e)) for e, t in zip(odd_listed, there, strict=True) if not t],
        "verdict": report.get("verdict"),
        "confidence": report.get("confidence"),
        "probability": [[e.get("probability"), t] for e, t in zip(odd_listed, there, strict=True)],
        "remainder_top": top,
        "remainder_right": top is not None and top == place,
        "flagged": report.get("verdict") in ("unknown", "partly"),
        "stated": {"before": shrink.get("before"), "after": shrink.get("after")},
        "terms": terms(truth, report),
        "parameters": odd_parameters(odd, odd_listed),
    }


def terms(truth: dict, report: dict) -> list[dict]:
    """Every ordinary term of every joint: error, whether the interval covers, whether the log determines it."""
    out, odd = [], truth["odd"]
    for joint, own in truth["joints"].items():
        odd_here = bool(odd) and odd["family"] in FRICTION and odd["location"]["name"] == joint
        for family, t in own.items():
            if odd_here and family in ("viscous_friction", "coulomb_friction"):
                continue
            told = report.get("joints", {}).get(joint, {}).get(family)
            told = told or _as_effect(report, joint, family)
            value = told.get("value") if told else None
            size = abs(t["value"])
            ci = told.get("ci95") if told else None
            out.append(
                {
                    "joint": joint,
                    "family": family,
                    "true": t["value"],
                    "told": value,
                    "determined": 1.96 * t["sigma"] < DETERMINED * size,
                    "close": value is not None and abs(value - t["value"]) < CLOSE * size,
                    "covers": None if not ci else ci[0] <= t["value"] <= ci[1],
                }
            )
    return out


def _as_effect(report: dict, joint: str, family: str) -> dict | None:
    for e in report["effects"]:
        if key(e) == (family, joint):
            for name in NAMES[family]:
                if name in e["parameters"]:
                    return e["parameters"][name]
    return None


def odd_parameters(odd: dict | None, listed: list[dict]) -> list[dict]:
    """Scalars of the odd effect that both name: relative error, and whether the interval covers."""
    out = []
    for e in listed:
        if odd is None or key(e) != key(odd):
            continue
        for name, p in odd["parameters"].items():
            told = e["parameters"].get(name)
            if not isinstance(p["value"], float) or told is None or told["value"] is None:
                continue
            ci = told.get("ci95")
            out.append(
                {
                    "name": f"{odd['family']}.{name}",
                    "error": abs(told["value"] - p["value"]) / max(abs(p["value"]), 1e-12),
                    "covers": None if not ci else ci[0] <= p["value"] <= ci[1],
                }
            )
    return out


# -- the table


def ratios(rows: list[dict], tool: str, measure: str = "rms") -> np.ndarray:
    """After over before on the other motion."""
    out = []
    for r in rows:
        error = r["errors"].get(tool)
        if error:
            out.append(error[measure] / r["errors"]["nominal"][measure])
    return np.array(out)


def spread(x: np.ndarray) -> str:
    if not len(x):
        return "–"
    low, middle, high = np.percentile(x, [10, 50, 90])
    return f"{middle:.3f} (10–90 %: {low:.3f}–{high:.3f}, {len(x)})"


def table(rows: list[dict]) -> str:
    """Markdown."""
    told = [r for r in rows if not r.get("missing")]
    stated = [
        r["stated"]["after"] / r["stated"]["before"]
        for r in told
        if r["stated"]["after"] is not None and r["stated"]["before"]
    ]
    odd = [r for r in told if r["odd"] and not r["outside"]]
    seen = [r for r in odd if r["sigmas"] >= SEEN]
    none, outside = [r for r in told if not r["odd"]], [r for r in told if r["outside"]]
    outside_seen = [r for r in outside if r["sigmas"] >= SEEN]
    flagged = [r["flagged"] for r in outside_seen]
    placed = [r["flagged"] and r["remainder_right"] for r in outside_seen]
    every = [t for r in told for t in r["terms"]]
    fixed = [t for t in every if t["determined"]]
    cover = [t["covers"] for t in every if t["covers"] is not None]
    there = [t for r in told for t in (*r["there"], *r["ordinary_there"])]
    odd_there = [t for r in told for t in r["there"]]
    numbers = [p for r in odd for p in r["parameters"]]
    seconds = [r["seconds"] for r in told if r.get("seconds")]
    pairs = [
        (r["errors"]["tool"]["rms"], r["errors"]["least_squares"]["rms"])
        for r in told
        if r["errors"].get("tool")
    ]
    share = lambda xs: wilson(sum(map(bool, xs)), len(xs))  # noqa: E731
    lines = [
        f"{len(told)} reports of {len(rows)} logs.",
        "",
        "| goal | value |",
        "|---|---|",
        f"| held-out rows, after / before, as the report states | {spread(np.array(stated))} |",
    ]
    for measure, words in (("rms", "moving rows"), ("away", "0.1 s from rest")):
        lines += [
            f"| … computed again from the report, {words} | {spread(ratios(told, 'tool', measure))} |",
            f"| … plain least squares, {words} | {spread(ratios(rows, 'least_squares', measure))} |",
            f"| … the truth told in these forms, {words} | {spread(ratios(rows, 'oracle', measure))} |",
        ]
    lines += [
        f"| computed again: no worse than least squares (2 %) | {share([a <= 1.02 * b for a, b in pairs])} |",
        f"| ordinary terms within 10 %, where determined | {share([t['close'] for t in fixed])} |",
        *(
            f"| … {family} | {share([t['close'] for t in fixed if t['family'] == family])} |"
            for family in ORDINARY
        ),
        f"| intervals of ordinary terms cover | {share(cover)} |",
        f"| listed effects that are there, all | {share(there)} |",
        f"| … odd ones alone | {share(odd_there)} |",
        f"| odd effect found, above {SEEN:g} sigma (of all: {share([r['found'] for r in odd])}) "
        f"| {share([r['found'] for r in seen])} |",
        f"| … first of the odd ones | {share([r['first'] for r in seen])} |",
        f"| … its numbers within 10 % | {share([p['error'] < CLOSE for p in numbers])} |",
        f"| ordinary robots with an invention | {share([r['invented'] for r in none])} |",
        f"| outside the library, above {SEEN:g} sigma: `unknown` or `partly` | {share(flagged)} |",
        f"| … and the remainder largest at the right joint | {share(placed)} |",
        f"| seconds a log | {spread(np.array(seconds))} |",
        "",
        "Verdicts: "
        + ", ".join(f"{k} {n}" for k, n in Counter(r["verdict"] for r in told).items()),
        "",
        "Not found, above the limit:",
        "",
    ]
    lines += [
        f"- {r['log']} {r['robot']}: {' at '.join(r['odd'])} ({r['sigmas']:.0f} sigma), listed: {_words(r['listed'])}"
        for r in seen
        if not r["found"]
    ]
    lines += ["", "Invented:", ""]
    lines += [
        f"- {r['log']} {r['robot']} ({' at '.join(r['odd']) if r['odd'] else 'ordinary'}): {_words(r['invented'])}"
        for r in told
        if r["invented"]
    ]
    lines += ["", "No report:", ""]
    lines += [f"- {r['log']} {r.get('reason', '')}" for r in rows if r.get("missing")]
    return "\n".join(lines) + "\n"


def _words(effects: list) -> str:
    return ", ".join(f"{f} at {p}" for f, p in effects) or "nothing"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("--reports", type=Path)
    parser.add_argument("--run", action="store_true", help="diagnose what has no report yet")
    parser.add_argument("--python", default=sys.executable)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--out", type=Path)
    args = parser.parse_args()
    reports = args.reports or args.data
    names = sorted(p.parent.name for p in args.data.glob("[0-9]*/truth.json"))
    if args.run:
        with ThreadPoolExecutor(args.jobs) as pool:
            asked = [pool.submit(diagnose, args.data / n, reports / n, args.python) for n in names]
            for k, _ in enumerate(as_completed(asked), start=1):
                print(f"\rdiagnosed {k} of {len(names)}", end="", flush=True)
    jobs = [(str(args.data), str(reports), name) for name in names]
    with ProcessPoolExecutor(args.jobs, mp_context=get_context("spawn")) as pool:
        rows = list(pool.map(score, jobs))
    out = args.out or reports
    out.mkdir(parents=True, exist_ok=True)
    (out / "results.json").write_text(json.dumps(rows, indent=1))
    text = table(rows)
    (out / "RESULTS.md").write_text(text)
    print("\n" + text)


if __name__ == "__main__":
    main()
