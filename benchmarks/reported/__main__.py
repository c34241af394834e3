"""Files and logs that people report trouble with, made anew in small, through the real commands.

    python -m benchmarks.reported --page docs/reported.md

Prints a line for each kind, and ends with status 1 where an answer is missing.
"""

import argparse
import contextlib
import io
import re
import sys
import tempfile
import warnings
from pathlib import Path

from benchmarks.reported.kinds import KINDS, Kind, Tried


def answer(words: list[str]) -> tuple[int, str]:
    """Status of a command, and its last words on either stream."""
    from jax_inertia.cli.main import main

    out, err = io.StringIO(), io.StringIO()
    with (
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
        warnings.catch_warnings(),
    ):
        warnings.simplefilter("ignore")
        try:
            status = main(words)
        except SystemExit as end:
            status = int(end.code or 0)
    return int(status or 0), err.getvalue() + out.getvalue()


def line_of(text: str, folder: Path) -> str:
    """The one line that matters, without the place of this run."""
    lines = text.splitlines()
    kinds = ("error:", "warning:", "│ note ")
    rows = next((found for kind in kinds if (found := [x for x in lines if kind in x])), [""])
    said = " ".join(rows[0].replace(str(folder) + "/", "").strip("│").split())
    return said.removeprefix("jax-inertia: ").removeprefix("note │ ")


def tried(kind: Kind, folder: Path) -> Tried:
    """Run one kind in an empty folder."""
    status, text = answer(kind.build(folder))
    expected = 2 if kind.outcome == "refused" else 0
    right = status == expected and bool(re.search(kind.right, text))
    return Tried(right, status, line_of(text, folder))


PAGE = """# What people report

Files and logs that public threads report trouble with, made anew in small with data of our own, and what the command
answers. `python -m benchmarks.reported --page docs/reported.md` runs them and writes this page;
`tests/test_files_reported.py` checks the answers.

| kind | thread | answer |
|---|---|---|
"""


def row_of(kind: Kind, found: Tried) -> str:
    """A row of the page."""
    said = found.said.replace("|", "\\|")
    if len(said) > 420:
        said = said[:420] + " ..."
    answer = {0: "read", 2: "refused"}[found.status]
    text = f"{answer}: `{said}`" if said else answer
    return f"| {kind.what} | {kind.thread} | {text} |\n"


def main() -> int:
    """Run all, or those that are named, and print a line for each."""
    parser = argparse.ArgumentParser(description="Kinds of files that people report")
    parser.add_argument("--only", help="those whose name holds this")
    parser.add_argument("--page", type=Path)
    args = parser.parse_args()
    page, wrong = PAGE, 0
    some = [kind for kind in KINDS if not args.only or args.only in kind.what]
    for kind in some:
        with tempfile.TemporaryDirectory() as name:
            found = tried(kind, Path(name))
        wrong += not found.right
        page += row_of(kind, found)
        print(
            f"{'right' if found.right else 'WRONG'} {found.status} {kind.what}: {found.said[:300]}",
            flush=True,
        )
    print(f"{len(some)} kinds, {wrong} without the answer")
    if args.page:
        args.page.write_text(page)
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
