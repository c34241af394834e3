"""`jax-inertia compare`: reports of several logs or robots side by side."""

import argparse
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from jax_inertia.fleet.page import Column

_DESCRIPTION = """
Put several diagnoses on one page: what each model lacks, how far its error shrinks, every number with its interval,
and which numbers differ by more than their intervals say. REPORT is report.json of a diagnosis, or the folder with it.
Writes compare.html and compare.json.
"""
_EXAMPLES = """
examples:
  the same arm on two days
    jax-inertia compare out/monday out/friday

  three robots, under their own names
    jax-inertia compare a/report.json b/report.json c/report.json --names left right spare --out compared
"""


def add_parser(subparsers) -> None:
    """Add `compare` to the command line."""
    parser = subparsers.add_parser(
        "compare",
        help="several reports on one page",
        description=textwrap.dedent(_DESCRIPTION),
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add("reports", metavar="REPORT", nargs="+", type=Path, help="report.json, or its folder")
    add("--names", nargs="+", metavar="N", help="of the columns (default: their folders)")
    add(
        "--out",
        type=Path,
        metavar="DIR",
        default=Path("out/compare"),
        help="where to write (default: out/compare)",
    )
    add("--json", action="store_true", help="print compare.json instead of the table")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Do it; raises ValueError with one line for what is no report."""
    import json

    from jax_inertia.cli.console import output_folder, warn
    from jax_inertia.fleet.page import Column, Refused, page, to_json
    from jax_inertia.fleet.report_file import read_report

    if len(args.reports) < 2:
        raise ValueError("one report is nothing to compare; give two or more")
    names = args.names or _names(args.reports)
    if len(names) != len(args.reports):
        raise ValueError(f"--names: {len(names)} names for {len(args.reports)} reports")
    columns, refused = [], []
    for name, path in zip(names, args.reports, strict=True):
        try:
            columns.append(Column(name, read_report(path)))
        except ValueError as error:
            refused.append(Refused(name, str(error)))
    if len(columns) < 2:
        raise ValueError(refused[0].reason)
    for one in refused:
        warn(f"left out: {one.reason}")
    found = to_json(columns, refused=refused)
    with output_folder(args.out, "compare") as folder:
        (folder / "compare.html").write_text(
            page(" · ".join(names), columns, refused=refused), encoding="utf-8"
        )
        (folder / "compare.json").write_text(
            json.dumps(found, indent=1, allow_nan=False) + "\n", encoding="utf-8"
        )
    if args.json:
        print(json.dumps(found, indent=1, allow_nan=False))
    else:
        show(columns)
        print(f"page: {args.out / 'compare.html'}")
    return 0


def _names(paths: Sequence[Path]) -> list[str]:
    """Of the folders, as they were given."""
    return [str(p if p.is_dir() else p.parent) for p in paths]


def show(columns: "Sequence[Column]") -> None:
    """Each report in a row, and the numbers that differ."""
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    from jax_inertia.fleet.page import label, table
    from jax_inertia.text.words import number, plain

    console = Console()
    rows = Table(title="what each model lacks", title_justify="left")
    for name in ("report", "verdict", "error before → after", "lacks"):
        rows.add_column(name)
    for c in columns:
        e = c.errors
        shrink = "" if e is None else f"{number(e.before)} → {number(e.after)} {e.unit}"
        cells = c.name, plain(c.report["verdict"]), shrink, "; ".join(c.lacks)
        rows.add_row(*map(escape, cells))
    console.print(rows)
    marked = [row for row in table(columns) if row.changes]
    if not marked:
        console.print("no number differs by more than its interval says")
    for row in marked:
        values = ", ".join("–" if x is None else f"{x.value:.3g}" for x in row.cells)
        text = f"{label(row.quantity)} at {row.quantity.place or 'all joints'} differs: {values}"
        console.print(escape(text), highlight=False, soft_wrap=True)
