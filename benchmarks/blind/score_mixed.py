"""Opens a sealed set of mixed strata, checks commitment and logs, and scores any number of tools on it.

    python benchmarks/blind/score_mixed.py LOGS SEALED --commitment HEX --out OUT [--jobs 1] \\
        --tool diagnose=FOUND [--tool NAME=FOLDER ...] [--summary benchmarks/results/sealed.json] [--key FILE]

Each tool's folder holds results/NAME/report.json (PROTOCOL.md); the one called pace_like is what the first tool's
closed-loop replays are compared with. Writes OUT/RESULTS.md (wrong rows of the first tool), OUT/LEADERBOARD.md,
OUT/confidence.png and OUT/rows.json. With --part LOGS may hold some of the logs alone: those that every tool has an
answer to are scored, and the rows of OUT/rows.json kept. NumPy, MuJoCo and matplotlib; nothing of the package.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import json
import shutil
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
for folder in (HERE, HERE.parent / "gap"):
    sys.path.append(str(folder))

import vault  # noqa: E402
from exam import figures, mixed_marks, mixed_page  # noqa: E402

PACE = "pace_like"


def opened(answers: dict, names: list[str], logs: Path, out: Path) -> list[Path]:
    """Folders with log, model and truth.json side by side, as the marks want them."""
    folders = []
    for name in names:
        folder = out / "opened" / name
        folder.mkdir(parents=True, exist_ok=True)
        for file in vault.FILES:
            if not (folder / file).exists():
                shutil.copyfile(logs / name / file, folder / file)
        (folder / "truth.json").write_text(json.dumps(answers["logs"][name]["truth"]))
        folders.append(folder)
    return folders


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("logs", type=Path)
    parser.add_argument("sealed", type=Path)
    parser.add_argument("--commitment", required=True, help="as published, or a file that holds it")
    parser.add_argument("--key", type=Path, help="where the key lies apart from SEALED")
    parser.add_argument("--tool", action="append", required=True, metavar="NAME=FOLDER")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--summary", type=Path, help="file for the machine-readable rates")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--part", action="store_true", help="score some logs, keep other rows")
    args = parser.parse_args()
    told = Path(args.commitment)
    promise = (told.read_text() if told.exists() else args.commitment).strip()
    try:
        answers = vault.unseal(args.sealed, promise, args.logs, args.key, args.part)
    except vault.SealBroken as error:
        raise SystemExit(f"score: {error}") from None
    tools = {name: Path(place) for name, _, place in (t.partition("=") for t in args.tool)}
    first = next(iter(tools))
    names = sorted(answers["logs"])
    kept: dict[str, list[dict]] = {name: [] for name in tools}
    if args.part:
        names = [n for n in names if (args.logs / n).exists()]
        names = [n for n in names if all((p / "results" / n).exists() for p in tools.values())]
        if (args.out / "rows.json").exists():
            kept |= json.loads((args.out / "rows.json").read_text())
    args.out.mkdir(parents=True, exist_ok=True)
    folders = opened(answers, names, args.logs, args.out)
    rows = {name: mixed_marks.mark_all(folders, place, args.jobs) for name, place in tools.items()}
    for name, some in rows.items():
        some += [r for r in kept[name] if r["log"] not in names]
        some.sort(key=lambda r: r["log"])
    head = (
        f"Commitment `{promise}`, published before any log was diagnosed and checked against the answers. Seed "
        f"`{answers['seed']}` (generator at {answers['commit'][:10]}): `seal.py --mixed --seed` makes these logs "
        "again.\n\n![Stated confidence against what was right](confidence.png)"
    )
    pace = rows.get(PACE, [])
    text = mixed_page.page(
        rows[first], pace, f"Sealed check of {len(rows[first])} logs: {first}", head
    )
    figures.confidence(mixed_page.reliability(rows[first]), args.out / "confidence.png")
    (args.out / "RESULTS.md").write_text(text)
    (args.out / "LEADERBOARD.md").write_text(mixed_page.leaderboard(rows))
    (args.out / "rows.json").write_text(json.dumps(rows, indent=1))
    if args.summary:
        made = mixed_page.summary(rows[first], pace)
        args.summary.write_text(json.dumps(made, indent=1) + "\n")
    print(text)


if __name__ == "__main__":
    main()
