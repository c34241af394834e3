"""Scores the diagnosis on logs made by `generate.py`: a row per stratum, wrong logs first.

    python benchmarks/gap/evaluate.py DATA --jobs 2 --out DATA/results [--baselines with|only]

DATA holds STRATUM/logs and STRATUM/truth. Only this file reads both truth and diagnosis; the diagnosis itself sees
a log and the nominal model, and what it hands over is judged on another motion by `report_torque.py`. Writes
results.json (a row per log) and RESULTS.md; logs that are in an earlier call's results.json are not diagnosed again.
`--baselines with` scores what an engineer would try on the same logs; `only` adds that to the results.json of an
earlier run.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import json
import multiprocessing
import tempfile
import time
import traceback
import warnings
from collections import Counter, defaultdict
from pathlib import Path

import beside
import numpy as np
from report_torque import on_other_run, written

# Strata without a hidden effect.
QUIET = ("none", "legged_none")


def run(job: tuple[str, str, str]) -> dict:
    """Diagnoses one log, then compares with its truth."""
    data, stratum, name = job
    import jax

    jax.config.update("jax_enable_x64", True)
    import jax_inertia
    from jax_inertia.diagnosis.entry import diagnose
    from jax_inertia.diagnosis.report.json_report import to_report
    from jax_inertia.logs.log_files import read_log
    from jax_inertia.model.load import load_spec

    warnings.simplefilter("ignore")
    folder = Path(data) / stratum / "logs" / name
    start = time.perf_counter()
    try:
        robot = jax_inertia.load_model(folder / "nominal.xml")
        nominal = load_spec(folder / "nominal.xml")
        found = diagnose(robot, read_log(folder / "log.npz"), nominal=nominal)
        report = to_report(found)
        other = on_test_run(found, report, folder)
    except Exception:
        return {"stratum": stratum, "log": name, "error": traceback.format_exc()[-1500:]}
    seconds = time.perf_counter() - start
    truth = json.loads((Path(data) / stratum / "truth" / f"{name}.json").read_text())
    return {"stratum": stratum, "log": name, "seconds": seconds, **compare(truth, report, other)}


def on_test_run(found, report: dict, folder: Path) -> dict[str, float] | None:
    """Torque error of what is handed over on test.npz, which the diagnosis never saw (`report_torque.on_other_run`)."""
    if not (folder / "test.npz").exists() or found.corrected is None:
        return None
    with tempfile.TemporaryDirectory() as place:
        written(report, found.corrected.spec.to_xml(), Path(place))
        return on_other_run(Path(place), folder)


def key(effect: dict) -> tuple[str, str]:
    return effect["family"], effect["location"]["name"]


def compare(truth: dict, report: dict, other: dict | None = None) -> dict:
    """What was right, by the contract's terms; `other`: torque error of another run, before and after."""
    true = [key(e) for e in truth["effects"]]
    found = [key(e) for e in report["effects"]]
    sets = [{key(e), *map(key, e["equivalent"])} for e in report["effects"]]
    declared = [{key(e), *map(key, e.get("equivalent", []))} for e in truth["effects"]]
    matched = [bool(d & {f}) for d in declared for f in found[:1]]
    hits = sum(any(f in d for f in found) for d in declared)
    own = report["shrink"]["heldout"]
    # A motion that hardly holds the gap, such as one without the push, has no share of it to lose.
    gap = {
        where: 1 - _off(s["after"], s["noise"]) / _off(s["before"], s["noise"])
        for where, s in (("heldout", own), ("test", other and other | {"noise": own["noise"]}))
        if s and s["before"] > 1.5 * s["noise"]
    }
    return {
        "robot": truth["robot"],
        "motion": truth["motion"]["log"],
        "noise": truth["noise_factor"],
        "true": true,
        "found": found,
        "verdict": report["verdict"],
        "true_verdict": truth["verdict"],
        "chi2": report["gap"]["chi2"],
        "floor": report["gap"]["noise_floor"],
        "right": bool(true) and len(found) == len(true) and hits == len(true),
        "first_right": any(matched),
        "family": any(f[0] == t[0] for f in found[:1] for t in true),
        "place": any(f[1] == t[1] for f in found[:1] for t in true),
        "in_set": any(t in s for s in sets[:1] for t in true),
        "hits": hits,
        "parameters": _parameters(truth, report),
        "probability": report["effects"][0]["probability"] if found else None,
        "shrink": gap,
    }


def _off(x: float, noise: float) -> float:
    return float(np.sqrt(max(x**2 - noise**2, 0.0)))


def _parameters(truth: dict, report: dict) -> list[dict]:
    """Each parameter that both name: relative error, and whether the interval covers; vectors as one, by length."""
    out = []
    for t in truth["effects"]:
        for e in report["effects"]:
            if key(t) != key(e):
                continue
            for name, p in t["parameters"].items():
                true = np.atleast_1d(np.asarray(p["value"], float))
                parts = [name] if np.isscalar(p["value"]) else [f"{name}_{k}" for k in "xyz"]
                found = [e["parameters"].get(part) for part in parts[: len(true)]]
                if any(f is None or f["value"] is None for f in found):
                    continue
                value = np.array([f["value"] for f in found])
                covers = (
                    f["ci95"][0] <= x <= f["ci95"][1] for f, x in zip(found, true, strict=True)
                )
                error = np.linalg.norm(value - true) / max(np.linalg.norm(true), 1e-12)
                out.append(
                    {
                        "family": t["family"],
                        "name": name,
                        "error": float(error),
                        "covers": all(covers),
                    }
                )
    return out


def wilson(k: int, n: int) -> str:
    """Share with its Wilson 95 % interval."""
    if n == 0:
        return "–"
    z, p = 1.96, k / n
    centre = (p + z * z / (2 * n)) / (1 + z * z / n)
    half = z * np.sqrt(p * (1 - p) / n + z * z / (4 * n * n)) / (1 + z * z / n)
    return f"{p:.2f} [{max(centre - half, 0):.2f}, {min(centre + half, 1):.2f}] ({k}/{n})"


def table(rows: list[dict]) -> str:
    """Markdown: the strata, then the wrong logs, then the confusion of families."""
    strata = defaultdict(list)
    for r in rows:
        strata[r["stratum"]].append(r)
    head = "| stratum | family | place | in set | exactly right | false alarm / unknown | parameters ≤ 10 % | covers |"
    lines = [head, "|---|---|---|---|---|---|---|---|"]
    for name, rs in sorted(strata.items()):
        good = [r for r in rs if "error" not in r]
        n = len(good)
        params = [p for r in good for p in r["parameters"]]
        count = {k: sum(r[k] for r in good) for k in ("family", "place", "in_set", "right")}
        if name in QUIET:
            special = wilson(sum(bool(r["found"]) for r in good), n) + " alarms"
        elif name == "unknown":
            special = wilson(sum(r["verdict"] == "unknown" for r in good), n) + " unknown"
        else:
            special = wilson(sum(r["verdict"] == "unknown" for r in good), n) + " called unknown"
        lines.append(
            f"| {name} | {wilson(count['family'], n)} | {wilson(count['place'], n)} "
            f"| {wilson(count['in_set'], n)} | {wilson(count['right'], n)} | {special} "
            f"| {wilson(sum(p['error'] < 0.1 for p in params), len(params))} "
            f"| {wilson(sum(p['covers'] for p in params), len(params))} |"
        )
    wrong = [r for r in rows if "error" in r or not _fine(r)]
    lines += ["", f"Wrong logs ({len(wrong)} of {len(rows)}):", ""]
    for r in wrong:
        if "error" in r:
            lines.append(f"- {r['stratum']} {r['log']}: {r['error'].splitlines()[-1]}")
        else:
            lines.append(
                f"- {r['stratum']} {r['log']} ({r['robot']}, {r['motion']}, noise ×{r['noise']}): "
                f"{_words(r['true'])} taken for {_words(r['found'])} ({r['verdict']})"
            )
    confusion = Counter(
        (r["true"][0][0], r["found"][0][0] if r["found"] else r["verdict"])
        for r in rows
        if "error" not in r and len(r["true"]) == 1
    )
    lines += ["", "| true family | found | count |", "|---|---|---|"]
    lines += [f"| {t} | {f} | {c} |" for (t, f), c in sorted(confusion.items()) if t != f]
    shrinks = [
        r["shrink"] for r in rows if "error" not in r and r["found"] and len(r["shrink"]) == 2
    ]
    near = sum(abs(s["heldout"] - s["test"]) < 0.1 for s in shrinks)
    seconds = [r["seconds"] for r in rows if "error" not in r]
    lines += [
        "",
        f"Shrink predicted within 0.10 of achieved on the other motion: {wilson(near, len(shrinks))}.",
        f"Median {np.median(seconds):.1f} s a log, one core, compilation included.",
    ]
    return "\n".join(lines) + "\n"


def _fine(r: dict) -> bool:
    if r["stratum"] in QUIET:
        return not r["found"]
    if r["stratum"] == "unknown":
        return r["verdict"] == "unknown"
    return r["right"] or (len(r["true"]) == 1 and len(r["found"]) == 1 and r["in_set"])


def _words(effects: list) -> str:
    return " + ".join(f"{f} at {p}" for f, p in effects) or "nothing"


def diagnosed(jobs: list[tuple[str, str, str]], workers: int, results: Path) -> list[dict]:
    """A row for each log, by the diagnosis; what is done so far is in `results`, and is not done again."""
    rows = json.loads(results.read_text()) if results.exists() else []
    done = {(r["stratum"], r["log"]) for r in rows}
    left = [job for job in jobs if job[1:] not in done]
    with multiprocessing.get_context("spawn").Pool(workers) as pool:
        for row in pool.imap_unordered(run, left):
            rows.append(row)
            print(f"\r{len(rows)} of {len(jobs)}", end="", flush=True)
            part = results.with_suffix(".part")
            part.write_text(json.dumps(rows))
            part.replace(results)
    return sorted(rows, key=lambda r: (r["stratum"], r["log"]))


def with_baselines(rows: list[dict], data: Path, workers: int) -> list[dict]:
    """The same rows with the baselines' scores in `others`."""
    jobs = [(str(data), r["stratum"], r["log"], compare) for r in rows]
    scores = {}
    with multiprocessing.get_context("spawn").Pool(workers) as pool:
        for k, (stratum, name, others) in enumerate(pool.imap_unordered(beside.add, jobs)):
            scores[stratum, name] = others
            print(f"\rbaselines: {k + 1} of {len(jobs)}", end="", flush=True)
    return [{**r, "others": scores[r["stratum"], r["log"]]} for r in rows]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("data", type=Path)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--baselines", choices=("with", "only"))
    args = parser.parse_args()
    out = args.out or args.data / "results"
    out.mkdir(parents=True, exist_ok=True)
    results = out / "results.json"
    if args.baselines == "only":
        rows = json.loads(results.read_text())
    else:
        truths = sorted(args.data.glob("*/truth/*.json"))
        # The largest logs first: they take longest.
        truths.sort(key=lambda t: -(t.parents[1] / "logs" / t.stem / "log.npz").stat().st_size)
        jobs = [(str(args.data), t.parents[1].name, t.stem) for t in truths]
        rows = diagnosed(jobs, args.jobs, results)
    if args.baselines:
        rows = with_baselines(rows, args.data, args.jobs)
        results.write_text(json.dumps(rows))
    text = table(rows)
    if more := beside.table(rows, wilson):
        text += "\n" + more
    (out / "RESULTS.md").write_text(text)
    print("\n" + text)


if __name__ == "__main__":
    main()
