"""What a diagnosis hands over, on robots as bought whose other run it never sees.

    python -m benchmarks.exam.handed_over run OUT --n 210 --seed 703 --jobs 2
    python -m benchmarks.exam.handed_over store OUT/rows.json --commit HASH
    python -m benchmarks.exam.handed_over page [--check]

`run` draws robots (`worlds/as_bought.py`), diagnoses each with `jax-inertia diagnose LOG --model MODEL` in a fresh
process, and computes report.json and corrected.xml again on the other run (`report_torque.py`, no code of the package).
`store` keeps the rows in benchmarks/results/handed_over.json; `page` writes HANDED_OVER.md beside this file from there,
and with `--check` says by its exit status whether the page is that of the stored rows.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import json
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import mujoco
import numpy as np

HERE = Path(__file__).resolve().parent
STORED, PAGE = HERE.parent / "results" / "handed_over.json", HERE / "HANDED_OVER.md"
OUTSIDE = ("position_dependent_friction", "resonance", "hysteretic_hose")
CLEAR = 3.0
"""Sigmas from which an effect counts as visible (`worlds/truth.py`)."""


def judged(data: Path, out: Path) -> dict:
    """One log: what is stated, what is handed over, and plain least squares, over the gap of the same rows.

    A row that `out` has is not made again.
    """
    from benchmarks.exam.least_squares import fit
    from benchmarks.exam.report_torque import of_folder
    from benchmarks.exam.torque_error import needed, read, torque_error

    kept = out / "row.json"
    if kept.exists():
        return json.loads(kept.read_text())
    begun = time.perf_counter()
    command = [sys.executable, "-m", "jax_inertia", "diagnose", str(data / "log.npz")]
    command += ["--model", str(data / "nominal.xml"), "--out", str(out), "--json"]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    if run.returncode:
        return {"name": data.name, "failed": run.stderr.strip().splitlines()[-1]}
    report = json.loads((out / "report.json").read_text())
    truth = json.loads((data / "truth.json").read_text())
    log, test = read(data / "log.npz"), read(data / "test.npz")
    model = mujoco.MjModel.from_xml_path(str(data / "nominal.xml"))
    given = {k: torque_error(model, needed, x) for k, x in (("log", log), ("test", test))}
    before = {k: x["rms"] for k, x in given.items()}
    told, odd = of_folder(out, data), truth["odd"]
    stated, error = report["shrink"]["heldout"], told.error(test)
    row = {
        "name": data.name,
        "robot": truth["robot"],
        "verdict": report["verdict"],
        "confidence": report["confidence"],
        "log_odds": report["log_odds"],
        "gaps": before | {"stated": stated["before"]},
        "stated": stated["after"] / stated["before"],
        "own": of_folder(out, data).error(log)["rms"] / before["log"],
        "handed": error["rms"] / before["test"],
        "handed_away": error["away"] / given["test"]["away"],
        "ls": torque_error(model, fit(model, log), test)["rms"] / before["test"],
        "left_out": sorted(told.left_out),
        "kind": truth["motion"]["test"],
        "odd": None
        if odd is None
        else [
            odd.get("mechanism", odd["family"]),
            odd["location"]["name"],
            odd["visibility"]["sigmas"],
        ],
        "equiv": [] if odd is None else odd.get("equivalent", []),
        "present": truth["present"],
        "listed": [
            [
                e["family"],
                e["location"]["name"],
                e["probability"],
                [[t["family"], t["location"]["name"]] for t in e["equivalent"]],
                e["log_odds"],
            ]
            for e in report["effects"]
            if not e["ordinary"]
        ],
        "not_listed": [
            [e["family"], e["location"]["name"], e["log_odds"]] for e in report["not_listed"]
        ],
        "seconds": time.perf_counter() - begun,
    }
    kept.write_text(json.dumps(row))
    return row


def found(row: dict) -> bool:
    """Whether the hidden effect is listed, or one that is tied with it."""
    family, place, _ = row["odd"]
    right = {(family, place), *((e["family"], e["location"]["name"]) for e in row["equiv"])}
    listed = ({(x[0], x[1]), *((t[0], t[1]) for t in x[3])} for x in row["listed"])
    return any(own & right for own in listed)


def invented(row: dict) -> list[tuple[str, str]]:
    """What is listed on a robot without an odd effect and is not there."""
    there = {(p["family"], p["location"]["name"]) for p in row["present"]}
    return [(x[0], x[1]) for x in row["listed"] if (x[0], x[1]) not in there]


def summary(rows: list[dict]) -> dict:
    """Every figure of the page."""
    done = [r for r in rows if "failed" not in r]
    counted = [r for r in done if not r["left_out"]]
    arrays = {k: np.array([r[k] for r in counted]) for k in ("stated", "own", "handed", "ls")}
    ratios = {
        "handed_over_vs_least_squares": arrays["handed"] / arrays["ls"],
        "handed_over_vs_stated": arrays["handed"] / arrays["stated"],
    }
    if counted and all("handed_away" in r for r in counted):
        away = np.array([r["handed_away"] for r in counted])
        ratios["away_vs_stated"] = away / arrays["stated"]
    if counted and all("gaps" in r for r in counted):
        own, other = (np.array([r["gaps"][k] for r in counted]) for k in ("stated", "test"))
        ratios["in_newton_metres"] = ratios["handed_over_vs_stated"] * other / own
    library = [r for r in done if r["odd"] and r["odd"][0] not in OUTSIDE]
    clear = [r for r in library if r["odd"][2] >= CLEAR]
    outside = [r for r in done if r["odd"] and r["odd"][0] in OUTSIDE and r["odd"][2] >= CLEAR]
    ordinary = [r for r in done if r["odd"] is None]
    return {
        "logs": len(rows),
        "failed": [r["name"] for r in rows if "failed" in r],
        "not_computed_again": len(done) - len(counted),
        "quantiles": {
            k: np.quantile(x, [0.1, 0.5, 0.9]).tolist() for k, x in (arrays | ratios).items()
        },
        "no_worse_than_least_squares": [
            int((arrays["handed"] <= arrays["ls"]).sum()),
            len(counted),
        ],
        "odd_found": [sum(map(found, clear)), len(clear)],
        "inventions": [sum(bool(invented(r)) for r in ordinary), len(ordinary)],
        "outside_flagged": [sum(r["verdict"] != "explained" for r in outside), len(outside)],
        "missed": [[r["name"], *r["odd"], r["verdict"]] for r in clear if not found(r)],
        "worse": [
            [r["name"], r["handed"], r["ls"], r["odd"] and r["odd"][0], r["verdict"]]
            for r in counted
            if r["handed"] > r["ls"]
        ],
    }


def page(stored: dict) -> str:
    """HANDED_OVER.md of the stored rows."""
    s = summary(stored["rows"])
    q = s["quantiles"]
    lines = [
        "# What is handed over",
        "",
        f"Robots as bought, seed {stored['seed']}, {s['logs']} logs, drawn and diagnosed once at commit "
        f"`{stored['commit']}` ({stored['date']}); the tool never saw the other run. Written by "
        "`benchmarks/exam/handed_over.py page` from `benchmarks/results/handed_over.json`.",
        "",
        "Torque error over that of the model as given. *Stated*: on held-out rows of the log. *Handed over*: "
        "report.json and corrected.xml on another run, computed by a program that shares no code with the tool.",
        "",
        "| | 10 % | median | 90 % |",
        "|---|---|---|---|",
    ]
    names = {
        "stated": "stated (held-out rows)",
        "own": "files on the same log",
        "handed": "**handed over (another run)**",
        "ls": "plain least squares (the same other run)",
        "handed_over_vs_least_squares": "handed over / least squares",
        "handed_over_vs_stated": "handed over / stated",
        "away_vs_stated": "the same of rows that are 0.1 s from any rest, handed over",
        "in_newton_metres": "the same of both errors in N m, whatever the gap of their rows",
    }
    for key, name in names.items():
        if key not in q:
            continue
        lines.append(f"| {name} | " + " | ".join(f"{x:.3g}" for x in q[key]) + " |")
    of = lambda pair: f"{pair[0]} of {pair[1]}"  # noqa: E731
    lines += [
        "",
        "| | |",
        "|---|---|",
        f"| no worse than least squares | {of(s['no_worse_than_least_squares'])} |",
        f"| odd effect of {CLEAR:g} sigma and more listed, ties counted | {of(s['odd_found'])} |",
        f"| something invented on robots without an odd effect | {of(s['inventions'])} |",
        f"| effect outside the library not called `explained` | {of(s['outside_flagged'])} |",
        f"| no report | {len(s['failed'])} ({', '.join(s['failed']) or 'none'}) |",
        f"| families that the evaluator does not compute (play, torque–speed line) | {s['not_computed_again']} |",
        "",
        "Worse than least squares: "
        + (
            "; ".join(f"{n} ({h:.3g} for {ls:.3g}, {o}, {v})" for n, h, ls, o, v in s["worse"])
            or "none"
        )
        + ".",
        "",
        "Missed: "
        + (
            "; ".join(f"{n} {f} at {p} ({z:.1f} sigma, {v})" for n, f, p, z, v in s["missed"])
            or "none"
        )
        + ".",
        *(line for note in stored.get("notes", []) for line in ("", note)),
    ]
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    commands = parser.add_subparsers(dest="command", required=True)
    run = commands.add_parser("run")
    run.add_argument("out", type=Path)
    run.add_argument("--n", type=int, default=210)
    run.add_argument("--seed", type=int, default=703)
    run.add_argument("--jobs", type=int, default=1)
    store = commands.add_parser("store")
    store.add_argument("rows", type=Path)
    store.add_argument("--commit", required=True)
    store.add_argument("--seed", type=int, default=703)
    store.add_argument("--date", default=time.strftime("%Y-%m-%d"))
    store.add_argument("--note", action="append", default=[])
    commands.add_parser("page").add_argument("--check", action="store_true")
    args = parser.parse_args()
    if args.command == "run":
        data = args.out / "data"
        draw = [sys.executable, "-m", "benchmarks.worlds.as_bought", str(data), "--n", str(args.n)]
        draw += ["--seed", str(args.seed), "--jobs", str(args.jobs)]
        subprocess.run(draw, check=False)
        folders = sorted(p for p in data.iterdir() if p.is_dir())
        with ProcessPoolExecutor(args.jobs) as pool:
            reports = [args.out / "reports" / p.name for p in folders]
            rows = list(pool.map(judged, folders, reports))
        (args.out / "rows.json").write_text(json.dumps(rows, indent=1))
    elif args.command == "store":
        rows = json.loads(args.rows.read_text())
        kept = {"commit": args.commit, "seed": args.seed, "date": args.date, "notes": args.note}
        STORED.write_text(json.dumps(kept | {"rows": rows}) + "\n")
    else:
        text = page(json.loads(STORED.read_text()))
        if args.check:
            raise SystemExit(int(PAGE.read_text() != text))
        PAGE.write_text(text)


if __name__ == "__main__":
    main()
