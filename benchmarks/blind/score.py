"""Opens the answers of a sealed set, checks the commitment and every log, and writes the tables.

    python benchmarks/blind/score.py LOGS SEALED FOUND --commitment HEX --out OUT \\
        [--baseline NAME=FOLDER ...] [--left-out FOLDER] [--summary benchmarks/results/blind.json] [--partial] \\
        [--still FILE]

FOUND is what `solve.py` wrote, each FOLDER what `rivals.py` did. HEX is the commitment as it was published before
any diagnosis. Writes OUT/RESULTS.md, OUT/rows.json and OUT/figures. A log without a report counts as wrong; with
`--partial`, logs that `solve.py` has not reached are left out, and the page says how many. FILE of `--still` is what
`still.py` made for a set that was sealed before effects were measured against the same motion without them.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterable
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1] / "gap"))

import left_out
import vault
from exam import figures, tables
from exam.marks import fine, mark
from exam.rates import summary
from report_torque import on_other_run


def reports(found: Path, names: Iterable[str]) -> dict[str, dict | None]:
    """report.json by log; None where the command failed or has not run."""
    out = {}
    for name in names:
        file = found / "results" / name / "report.json"
        out[name] = json.loads(file.read_text()) if file.exists() else None
    return out


def marked(answers: dict, found: Path, logs: Path) -> list[dict]:
    """One row a log, by name."""
    said, rows = reports(found, answers["logs"]), []
    for name, answer in answers["logs"].items():
        other = said[name] and on_other_run(found / "results" / name, logs / name)
        rows.append({"log": name} | mark(answer, said[name], other))
    return rows


def reached(answers: dict, found: Path) -> dict:
    """The answers to logs that were diagnosed, or failed to be; `sealed` keeps how many there were."""
    logs = {n: a for n, a in answers["logs"].items() if (found / "results" / n).exists()}
    return answers | {"logs": logs, "sealed": len(answers["logs"])}


def against_still(answers: dict, visible: dict[str, list[dict]]) -> dict:
    """Answers whose effects count as visible by what they add to the same motion without them."""
    for name, answer in answers["logs"].items():
        for effect, seen in zip(answer["truth"]["effects"], visible[name], strict=True):
            effect["visibility"] = seen
    return answers


def seconds(found: Path) -> list[float]:
    files = sorted(found.glob("results/*/run.json"))
    every = [json.loads(f.read_text())["seconds"] for f in files]
    return [s for s in every if s is not None]


def results(
    answers: dict, promise: str, rows: list[dict], others: dict[str, list[dict]], found: Path,
    out: Path, pictures: dict[str, str], wrong: dict[str, str], left: Path | None,
) -> str:  # fmt: skip
    """RESULTS.md."""
    file = found / "runs.json"
    runs = json.loads(file.read_text()) if file.exists() else []
    failed = [r["log"] for r in rows if r["failed"]]
    head = [
        f"# Sealed check of {len(rows)} logs",
        "",
        f"Commitment `{promise.strip()}`, published before any log was diagnosed and checked against the answers.",
        f"Seed `{answers['seed']}` (generator at {answers['commit'][:10]}): `seal.py --seed` makes these logs again.",
        "",
    ]
    if (sealed := answers.get("sealed", len(rows))) > len(rows):
        head[4:4] = [
            f"{len(rows)} of {sealed} sealed logs were diagnosed before the answers were opened; the others were not "
            "reached and are not counted. Which ones did not depend on the answers: small robots came first.",
            "",
        ]
    for run in runs:
        versions = ", ".join(f"{k} {v}" for k, v in run["versions"].items() if v)
        head.append(
            f"- {run['began']} UTC: `{run['command']}`, commit {run['commit'][:10]}, "
            f"Python {run['python']}, {run['machine']}, {run['jobs']} jobs, {versions}"
        )
    head += ["", tables.times(seconds(found))]
    if failed:
        head.append(
            f"No report for {len(failed)} logs ({', '.join(failed[:8])}): counted as wrong."
        )
    parts = [
        "\n".join(head),
        tables.wrong_rows(rows, wrong),
        tables.rates(rows, others),
        "\n\n".join(f"![{name}]({path})" for name, path in pictures.items()),
        tables.families(rows),
        tables.confusion(rows),
        tables.parameters(rows),
        "## Where it is hard\n\n" + tables.breakdowns(rows),
    ]
    if left is not None:
        parts.append(left_out.table(answers, left, found))
    return "\n\n".join(parts) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("logs", type=Path)
    parser.add_argument("sealed", type=Path)
    parser.add_argument("found", type=Path)
    parser.add_argument("--commitment", required=True, help="as published, or a file that holds it")
    parser.add_argument("--key", type=Path, help="where the key lies apart from SEALED")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--baseline", action="append", default=[], metavar="NAME=FOLDER")
    parser.add_argument("--left-out", type=Path, help="what left_out.py wrote")
    parser.add_argument("--summary", type=Path, help="file for the machine-readable rates")
    parser.add_argument("--still", type=Path, help="what still.py wrote")
    parser.add_argument("--partial", action="store_true", help="leave out logs not reached yet")
    args = parser.parse_args()
    told = Path(args.commitment)
    promise = told.read_text() if told.exists() else args.commitment
    try:
        answers = vault.unseal(args.sealed, promise, args.logs, args.key)
    except vault.SealBroken as error:
        raise SystemExit(f"score: {error}") from None
    if args.still:
        answers = against_still(answers, json.loads(args.still.read_text()))
    if args.partial:
        answers = reached(answers, args.found)
    score(answers, promise, args.logs, args.found, args.out, _pairs(args.baseline), args.left_out)
    if args.summary:
        rows = json.loads((args.out / "rows.json").read_text())
        args.summary.parent.mkdir(parents=True, exist_ok=True)
        args.summary.write_text(json.dumps(summary(rows), indent=1) + "\n")


def _pairs(texts: list[str]) -> dict[str, Path]:
    return {name: Path(folder) for name, _, folder in (t.partition("=") for t in texts)}


def score(
    answers: dict, promise: str, logs: Path, found: Path, out: Path,
    baselines: dict[str, Path], left: Path | None = None,
) -> list[dict]:  # fmt: skip
    """Everything `main` writes into OUT but the summary; the rows."""
    rows = marked(answers, found, logs)
    others = {name: marked(answers, folder, logs) for name, folder in baselines.items()}
    drawn = out / "figures"
    drawn.mkdir(parents=True, exist_ok=True)
    makers = {
        "confusion": figures.confusion,
        "calibration": figures.calibration,
        "accuracy against size": figures.against_size,
        "shrink": figures.shrink,
    }
    pictures = {
        name: make(rows, drawn / f"{name.replace(' ', '_')}.png") for name, make in makers.items()
    }
    wrong = {
        r["log"]: figures.one_log(r, logs / r["log"], drawn / f"{r['log']}.png")
        for r in rows
        if not fine(r)
    }
    (out / "rows.json").write_text(json.dumps(rows, indent=1))
    text = results(answers, promise, rows, others, found, out, pictures, wrong, left)
    (out / "RESULTS.md").write_text(text)
    return rows


if __name__ == "__main__":
    main()
