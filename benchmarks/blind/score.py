"""Scores folders of answers on a sealed set, after seed, commitment and every log have been checked.

    python -m benchmarks.blind.score run LOGS VAULT --commitment HEX --out OUT [--jobs 1] [--reached] \\
        --tool NAME=FOLDER [--tool ...]
    python -m benchmarks.blind.score store OUT/rows.json --set S1 --seed SEED --note "what was run" ...
    python -m benchmarks.blind.score add ROWS.json --note "what was run"
    python -m benchmarks.blind.score page [--check]

Each tool's folder holds results/NAME/report.json (PROTOCOL.md). `run` writes OUT/rows.json, a row a log and tool; the
tool called pace_like is what the first tool's closed-loop replays are compared with, and a log that a tool has no
answer to counts as refused. Rows that OUT has are not made again. `store` keeps them under benchmarks/results with the
opened seed, `add` keeps rows of further logs of that set, diagnosed once its seed was open, and `page` writes
RESULTS.md beside this file from there, its figure, and the table that docs/results.md opens with. NumPy, MuJoCo and
matplotlib; nothing of the package.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import hashlib
import json
import re
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path

from rich.progress import track

from benchmarks.blind import vault
from benchmarks.exam import marks, page

HERE = Path(__file__).resolve().parent

RESULTS = HERE.parent / "results"
STORED, SUMMARY, PAGE = RESULTS / "sealed_rows.json", RESULTS / "sealed.json", HERE / "RESULTS.md"
DOCS = HERE.parents[1] / "docs"
BLOCK = re.compile(
    r"(?<=<!-- sealed: written by benchmarks/blind/score.py page -->\n).*?(?=<!-- end of sealed -->)",
    re.DOTALL,
)


def opened(logs: Path, hidden: Path, name: str, out: Path) -> Path:
    """A folder with log, model, test run and truth side by side, as the marks want them."""
    folder = out / "opened" / name
    folder.mkdir(parents=True, exist_ok=True)
    for place, files in ((logs, vault.SHOWN), (hidden, vault.HIDDEN)):
        for file in files:
            if (place / name / file).exists() and not (folder / file).exists():
                (folder / file).symlink_to((place / name / file).resolve())
    return folder


def marked(folder: Path, place: Path, kept: Path) -> dict:
    """A row, made once."""
    if not kept.exists():
        row = marks.mark(folder, place)
        part = kept.with_suffix(".part")
        part.write_text(json.dumps(row))
        part.rename(kept)
    return json.loads(kept.read_text())


def score(
    logs: Path,
    hidden: Path,
    promise: str,
    tools: dict[str, Path],
    out: Path,
    jobs: int = 1,
    reached: bool = False,
) -> dict[str, list[dict]]:
    """Rows of every tool, log by log; `vault.SealBroken` where the set is not the one that was committed to.

    `reached`: of the logs alone that the first tool was given.
    """
    names = sorted(vault.check(logs, hidden, promise)["logs"])
    if reached:
        first = next(iter(tools.values()))
        names = [name for name in names if (first / "results" / name).exists()]
    rows: dict[str, list[dict]] = {}
    folders = {name: opened(logs, hidden, name, out) for name in names}
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        running = {}
        for tool, answers in tools.items():
            kept = out / "rows" / tool
            kept.mkdir(parents=True, exist_ok=True)
            for name in names:
                given = folders[name], answers / "results" / name, kept / f"{name}.json"
                running[pool.submit(marked, *given)] = tool
        for done in track(as_completed(running), "scoring", len(running)):
            rows.setdefault(running[done], []).append(done.result())
    for some in rows.values():
        some.sort(key=lambda r: r["log"])
    return {tool: rows[tool] for tool in tools}


def store(rows: dict[str, list[dict]], about: dict, more: dict[str, list[dict]]) -> None:
    """Rows, a line each, and what other programs read; `more`: further logs of the set, by what was run."""
    first = next(iter(rows))
    made = page.summary(rows[first], rows.get(page.PACE, []))
    SUMMARY.write_text(json.dumps(made, indent=1) + "\n")
    text = f'"about": {json.dumps(about)},\n"tools": {_lines(rows)},\n"more": {_lines(more)}'
    STORED.write_text(f"{{\n{text}\n}}\n")


def _lines(rows: dict[str, list[dict]]) -> str:
    lines = [
        f"{json.dumps(name)}: [\n" + ",\n".join(map(json.dumps, some)) + "\n]"
        for name, some in rows.items()
    ]
    return "{\n" + ",\n".join(lines) + "\n}"


def written() -> dict[Path, str]:
    """RESULTS.md and docs/results.md of the stored rows."""
    stored = json.loads(STORED.read_text())
    about, tools = stored["about"], stored["tools"]
    rows = next(iter(tools.values()))
    lines = ["", about["head"][0], "", *page.goals(rows, tools.get(page.PACE, [])), "", ""]
    more = [line for x in stored["more"].items() for line in page.further(*x)]
    lines += more
    docs = DOCS / "results.md"
    return {
        PAGE: page.page(about, tools) + "\n".join(["", *more]),
        docs: BLOCK.sub(lambda _: "\n".join(lines), docs.read_text()),
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(dest="command", required=True)
    run = commands.add_parser("run")
    run.add_argument("logs", type=Path)
    run.add_argument("vault", type=Path)
    run.add_argument("--commitment", required=True, help="as published")
    run.add_argument("--tool", action="append", required=True, metavar="NAME=FOLDER")
    run.add_argument("--out", type=Path, required=True)
    run.add_argument("--jobs", type=int, default=1)
    run.add_argument(
        "--reached", action="store_true", help="the logs alone that the first tool was given"
    )
    keep = commands.add_parser("store")
    keep.add_argument("rows", type=Path)
    keep.add_argument("--set", required=True)
    keep.add_argument("--seed", type=Path, required=True)
    keep.add_argument("--note", action="append", default=[], help="a paragraph of the page")
    add = commands.add_parser("add")
    add.add_argument("rows", type=Path)
    add.add_argument("--note", required=True)
    commands.add_parser("page").add_argument("--check", action="store_true")
    args = parser.parse_args()
    if args.command == "run":
        tools = {name: Path(place) for name, _, place in (t.partition("=") for t in args.tool)}
        try:
            rows = score(
                args.logs, args.vault, args.commitment, tools, args.out, args.jobs, args.reached
            )
        except vault.SealBroken as error:
            raise SystemExit(f"score: {error}") from None
        (args.out / "rows.json").write_text(json.dumps(rows))
        print("\n".join(page.leaderboard(rows)))
    elif args.command == "store":
        seed = args.seed.read_bytes()
        about = {
            "set": args.set,
            "seed": seed.decode(),
            "seed_sha256": hashlib.sha256(seed).hexdigest(),
            "head": args.note,
        }
        store(json.loads(args.rows.read_text()), about, {})
    elif args.command == "add":
        stored = json.loads(STORED.read_text())
        more = stored.get("more", {}) | {args.note: json.loads(args.rows.read_text())}
        store(stored["tools"], stored["about"], more)
    else:
        pages = written()
        if args.check:
            raise SystemExit(int(any(p.read_text() != text for p, text in pages.items())))
        for place, text in pages.items():
            place.write_text(text)
        from benchmarks.exam import figures  # Matplotlib, which scoring does without.

        rows = next(iter(json.loads(STORED.read_text())["tools"].values()))
        figures.confidence(page.reliability(rows), DOCS / "figures" / "confidence.png")


if __name__ == "__main__":
    main()
