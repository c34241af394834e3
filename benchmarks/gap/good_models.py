"""Effects on models that have their ordinary physics: logs drawn, diagnosed and counted in one go.

    python benchmarks/gap/good_models.py OUT --seed 21 --jobs 16 [--seconds 500]
    python benchmarks/gap/good_models.py OUT --table

Draws logs of the generator's strata (`generate.py`), diagnoses each, and writes a row per log into OUT/rows. The table
is by kind of log and by family. A second call skips what is done; `--seconds` starts no log after that.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import json
import multiprocessing
import time
import traceback
import warnings
from collections import Counter, defaultdict
from pathlib import Path

import evaluate
import generate

COUNTS = {
    "exciting": 22,
    "ordinary": 22,
    "hard": 22,
    "none": 28,
    "presliding": 8,
    "backlash": 6,
    "unknown": 18,
    "pair": 20,
    "legged": 22,
    "legged_none": 10,
}
"""Logs of each stratum: every family of arms comes once in the first three, of legs in `legged`."""
KNOWN = {"joint_coupling": "joint_coupling", "quadratic_friction": "quadratic_viscous"}
"""Families of mechanisms that were in no library when the generator was written."""


def run(job: tuple[str, int, str, int, float]) -> str:
    """Draws one log, diagnoses it, writes its row; the line that says how it went."""
    out, seed, stratum, index, until = job
    file = Path(out) / "rows" / f"{stratum}-{index:05d}.json"
    if file.exists() or time.time() > until:
        return ""
    data = Path(out) / "data" / stratum
    (data / "truth").mkdir(parents=True, exist_ok=True)
    try:
        generate.write(data, stratum, seed, index)
    except RuntimeError as error:
        return f"{stratum} {index}: {error}"
    import jax_inertia
    from jax_inertia.diagnosis.entry import diagnose
    from jax_inertia.diagnosis.report.json_report import to_report
    from jax_inertia.logs.log import LogError
    from jax_inertia.logs.log_files import read_log
    from jax_inertia.model.load import load_spec

    warnings.simplefilter("ignore")
    truth = json.loads((data / "truth" / f"{index:05d}.json").read_text())
    folder = data / "logs" / f"{index:05d}"
    robot = jax_inertia.load_model(folder / "nominal.xml")
    log = read_log(folder / "log.npz")
    row = {"stratum": stratum, "log": f"{index:05d}"}
    start = time.process_time()
    try:
        found = diagnose(robot, log, nominal=load_spec(folder / "nominal.xml"))
    except LogError as error:
        return f"{stratum} {index}: refused, {error}"
    except Exception:
        row["error"] = traceback.format_exc()[-1500:]
    else:
        report = to_report(found)
        keep = {k: report.get(k) for k in ("effects", "shrink", "remainder", "gap", "notes")}
        seconds = time.process_time() - start
        row |= {"seconds": seconds, "votes": found.as_bought, "report": keep}
        row |= evaluate.compare(truth, report, evaluate.on_test_run(found, report, folder))
        row["mechanism"] = [e.get("mechanism", e["family"]) for e in truth["effects"]]
    file.write_text(json.dumps(row))
    return f"{stratum} {index}: {outcome(row)}"


def outcome(row: dict) -> str:
    """One word for how a row went, `right` where nothing is wrong; exact equivalents and ties told count as found."""
    if "error" in row:
        return "error"
    if row["stratum"] in evaluate.QUIET:
        return "alarm" if row["found"] else "right" if row["verdict"] == "no_gap" else "unknown"
    if row["stratum"] == "unknown":
        known = [(KNOWN.get(m), t[1]) for m, t in zip(row["mechanism"], row["true"], strict=True)]
        if [tuple(f) for f in row["found"]] == known:
            return "right"
        wrong = {"explained": "invention", "no_gap": "missed"}
        return wrong.get(row["verdict"], "right")
    if row["right"] or (len(row["true"]) == 1 == len(row["found"]) and row["in_set"]):
        return "right" if row["verdict"] == "explained" else "right, not explained"
    if not row["found"]:
        return "missed" if row["verdict"] == "no_gap" else "unknown"
    if row["hits"] == len(row["true"]):
        return "and another"
    return "one of two" if row["hits"] else "another"


def table(rows: list[dict]) -> str:
    """Markdown: kinds of logs, then families of effects, then logs that are not right."""
    lines = ["| logs | right | how not | numbers ≤ 10 % | covered | foretold within 0.1 |"]
    lines += ["|---|---|---|---|---|---|"]
    kinds = defaultdict(list)
    for r in rows:
        kinds[r["stratum"]].append(r)
    lines += [f"| {stratum} | {_line(rs)} |" for stratum, rs in sorted(kinds.items())]
    one = [r for r in rows if r["stratum"] not in (*evaluate.QUIET, "unknown", "pair")]
    lines.append(f"| one effect, all | {_line(one)} |")
    lines += ["", "| family (one-effect logs) | right |", "|---|---|"]
    families = defaultdict(list)
    for r in one:
        if "error" not in r:
            families[r["true"][0][0]].append(r)
    lines += [f"| {family} | {_share(rs)} |" for family, rs in sorted(families.items())]
    lines.append("")
    for r in rows:
        if not outcome(r).startswith("right"):
            lines.append(f"- {r['stratum']} {r['log']}: {_told(r)}")
    return "\n".join(lines) + "\n"


def _line(rows: list[dict]) -> str:
    outcomes = Counter(outcome(r) for r in rows)
    right = sum(n for o, n in outcomes.items() if o.startswith("right"))
    wrong = ", ".join(f"{o} {n}" for o, n in sorted(outcomes.items()) if o != "right")
    good = [r for r in rows if "error" not in r]
    numbers = [p for r in good for p in r["parameters"]]
    foretold = [r["shrink"] for r in good if r["found"] and len(r["shrink"]) == 2]
    near = sum(abs(s["heldout"] - s["test"]) < 0.1 for s in foretold)
    close, covered = (sum(map(test, numbers)) for test in (_close, _covers))
    return (
        f"{right}/{len(rows)} | {wrong or '–'} | {close}/{len(numbers)} | {covered}/{len(numbers)} "
        f"| {near}/{len(foretold)}"
    )


def _close(p: dict) -> bool:
    return p["error"] < 0.1


def _covers(p: dict) -> bool:
    return p["covers"]


def _share(rows: list[dict]) -> str:
    right = sum(outcome(r).startswith("right") for r in rows)
    others = Counter(o for r in rows if not (o := outcome(r)).startswith("right"))
    told = ", ".join(f"{o} {n}" for o, n in sorted(others.items()))
    return f"{right}/{len(rows)}{f' ({told})' if told else ''}"


def _told(r: dict) -> str:
    if "error" in r:
        return r["error"].splitlines()[-1]
    true = " + ".join(f"{m} at {t[1]}" for m, t in zip(r["mechanism"], r["true"], strict=True))
    found = " + ".join(f"{f} at {p}" for f, p in r["found"]) or "nothing"
    return f"{true or 'nothing'} ({r['robot']}, {r['motion']}, ×{r['noise']}) → {found} ({r['verdict']})"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("out", type=Path)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--stratum", choices=sorted(COUNTS), action="append")
    parser.add_argument("--share", type=float, default=1.0, help="of the usual number of logs")
    parser.add_argument("--seconds", type=float, default=1e9)
    parser.add_argument("--table", action="store_true", help="only the table of what is there")
    args = parser.parse_args()
    (args.out / "rows").mkdir(parents=True, exist_ok=True)
    if not args.table:
        until = time.time() + args.seconds
        chosen = args.stratum or COUNTS
        most = max(COUNTS.values())
        # Strata in turn: what a time limit cuts is cut of all.
        jobs = [
            (str(args.out), args.seed, s, k, until)
            for k in range(most)
            for s in chosen
            if k < round(args.share * COUNTS[s])
        ]
        with multiprocessing.get_context("spawn").Pool(args.jobs) as pool:
            for line in pool.imap_unordered(run, jobs):
                if line:
                    print(line, flush=True)
    rows = [json.loads(f.read_text()) for f in sorted((args.out / "rows").glob("*.json"))]
    text = table(rows)
    (args.out / "GOOD_MODELS.md").write_text(text)
    print(text)


if __name__ == "__main__":
    main()
