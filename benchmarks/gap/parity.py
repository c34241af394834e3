"""Single effects on good models: how the search of the whole robot does beside the search for one effect.

    python benchmarks/gap/parity.py OUT --seed 21 --jobs 16 [--seconds 500]
    python benchmarks/gap/parity.py OUT --table

Draws logs of the generator's strata with fixed bases (`generate.py`), diagnoses each with both searches, whatever the
log says of its model, and writes a row per log and search into OUT/rows. The table is by kind of log and by family.
A second call skips what is done; `--seconds` starts no log after that.
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
}
"""Logs of each stratum: every family of arms comes once in the first three."""
KNOWN = {"joint_coupling": "joint_coupling", "quadratic_friction": "quadratic_viscous"}
"""Families of mechanisms that were in no library when the generator was written."""
SEARCHES = ("one effect", "whole robot")


def diagnosed(robot, logs: tuple, search: str):
    """(report, votes [nats] that the model lacks ordinary physics; None of the other search)."""
    from jax_inertia.diagnosis import pipeline
    from jax_inertia.diagnosis.report import json_report as whole_report
    from jax_inertia.gap import diagnosis as single
    from jax_inertia.gap import report as single_report

    log, test = logs
    if search == "whole robot":
        found = pipeline.diagnose(robot, log, test_log=test)
        return whole_report.to_report(found), found.as_bought
    return single_report.to_report(single.diagnose(robot, log, test_log=test)), None


def run(job: tuple[str, int, str, int, tuple[str, ...], float]) -> str:
    """Draws one log, asks each search, writes a row for each; the line that says how it went."""
    out, seed, stratum, index, searches, until = job
    rows = Path(out) / "rows"
    files = {s: rows / f"{stratum}-{index:05d}-{s.replace(' ', '_')}.json" for s in searches}
    left = [s for s in searches if not files[s].exists()]
    if not left or time.time() > until:
        return ""
    data = Path(out) / "data" / stratum
    (data / "truth").mkdir(parents=True, exist_ok=True)
    try:
        generate.write(data, stratum, seed, index)
    except RuntimeError as error:
        return f"{stratum} {index}: {error}"
    import jax

    jax.config.update("jax_enable_x64", True)
    import jax_inertia
    from jax_inertia.gap.either import usable
    from jax_inertia.logs.log import LogError
    from jax_inertia.logs.log_files import read_log

    warnings.simplefilter("ignore")
    truth = json.loads((data / "truth" / f"{index:05d}.json").read_text())
    folder = data / "logs" / f"{index:05d}"
    robot = jax_inertia.load_model(folder / "nominal.xml").astype("float64")
    try:
        log, drives, _ = usable(read_log(folder / "log.npz"), robot, None, "log")
        test, _, _ = usable(read_log(folder / "test.npz"), robot, drives, "test_log")
    except LogError as error:
        # Neither search sees it.
        return f"{stratum} {index}: refused, {error}"
    said = []
    for search in left:
        row = {"stratum": stratum, "log": f"{index:05d}", "search": search}
        start = time.process_time()
        try:
            report, votes = diagnosed(robot, (log, test), search)
        except Exception:
            row["error"] = traceback.format_exc()[-1500:]
        else:
            keep = {k: report.get(k) for k in ("effects", "shrink", "remainder", "gap", "notes")}
            row |= {"seconds": time.process_time() - start, "votes": votes, "report": keep}
            row |= evaluate.compare(truth, report)
            row["mechanism"] = [e.get("mechanism", e["family"]) for e in truth["effects"]]
        files[search].write_text(json.dumps(row))
        said.append(outcome(row))
    return f"{stratum} {index}: {'; '.join(said)}"


def outcome(row: dict) -> str:
    """One word for how a row went, `right` where nothing is wrong; exact equivalents and ties told count as found."""
    if "error" in row:
        return "error"
    if row["stratum"] == "none":
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
    """Markdown: kinds of logs, then families that one of the searches has not right, then those logs."""
    lines = ["| logs | search | right | how not | numbers ≤ 10 % | covered | foretold within 0.1 |"]
    lines += ["|---|---|---|---|---|---|---|"]
    kinds = defaultdict(list)
    for r in rows:
        kinds[r["stratum"], r["search"]].append(r)
    for (stratum, search), rs in sorted(kinds.items()):
        lines.append(f"| {stratum} | {search} | {_line(rs)} |")
    one = [r for r in rows if "error" in r or len(r["true"]) == 1]
    one = [r for r in one if r["stratum"] not in ("none", "unknown", "pair")]
    for search in SEARCHES:
        lines.append(
            f"| one effect, all | {search} | {_line([r for r in one if r['search'] == search])} |"
        )
    lines += ["", "| family (one-effect logs) | " + " | ".join(SEARCHES) + " |", "|---|---|---|"]
    families = defaultdict(lambda: defaultdict(list))
    for r in one:
        if "error" not in r:
            families[r["true"][0][0]][r["search"]].append(r)
    for family, by in sorted(families.items()):
        lines.append(f"| {family} | " + " | ".join(_share(by[s]) for s in SEARCHES) + " |")
    lines.append("")
    for r in rows:
        if not outcome(r).startswith("right"):
            lines.append(f"- {r['search']}, {r['stratum']} {r['log']}: {_told(r)}")
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
    parser.add_argument("--search", choices=SEARCHES, action="append")
    parser.add_argument("--stratum", choices=sorted(COUNTS), action="append")
    parser.add_argument("--share", type=float, default=1.0, help="of the usual number of logs")
    parser.add_argument("--seconds", type=float, default=1e9)
    parser.add_argument("--table", action="store_true", help="only the table of what is there")
    args = parser.parse_args()
    (args.out / "rows").mkdir(parents=True, exist_ok=True)
    if not args.table:
        until, searches = time.time() + args.seconds, tuple(args.search or SEARCHES)
        chosen = args.stratum or COUNTS
        most = max(COUNTS.values())
        # Strata in turn: what a time limit cuts is cut of all.
        jobs = [
            (str(args.out), args.seed, s, k, searches, until)
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
    (args.out / "PARITY.md").write_text(text)
    print(text)


if __name__ == "__main__":
    main()
