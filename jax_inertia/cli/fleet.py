"""`jax-inertia fleet`: what each of many robots lacks, and how it drifts over the dates of its logs."""

import argparse
import re
import shlex
import sys
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from jax_inertia.cli.conventions import add_model

if TYPE_CHECKING:
    from jax_inertia.fleet.jobs import Outcome, Task
    from jax_inertia.fleet.page import Column

_DESCRIPTION = """
Diagnose many LOGS of robots of one MODEL, several at a time, on this machine or on a Dask cluster, and put them into
one table: what each robot lacks, and how each number drifts over the dates. Robot and date are read from a log's name
(arm3_2026-11-05.npz) or from its folder (arm3/2026-11-05.npz). Writes fleet.html, fleet.json, and for each log a folder
with its own report. Logs that were done are not done again; one that dies does not take the others with it.
"""
_EXAMPLES = """
examples:
  a folder of logs, four at a time
    jax-inertia fleet logs/*.npz --model arm.xml --jobs 4 --out fleet

  with another run of each robot, which only checks
    jax-inertia fleet logs/*.npz --model arm.xml --test-logs checks/*.npz --jobs 4

  names of another form, and options for each diagnosis
    jax-inertia fleet logs/*.csv --model arm.xml --pattern 'SN(?P<robot>\\d+)-(?P<date>\\d{8})' --options '--tau-unit A'

  on a Dask cluster whose machines see the same files
    jax-inertia fleet /share/logs/*.npz --model /share/arm.xml --out /share/fleet --dask tcp://10.0.0.1:8786
"""
PATTERN = r"(?:(?P<robot>[^/\\]*?)[-_/\\])?(?P<date>(?:19|20)\d{2}-?\d{2}-?\d{2})(?!\d)"


def add_parser(subparsers) -> None:
    """Add `fleet` to the command line."""
    parser = subparsers.add_parser(
        "fleet",
        help="diagnose many robots, and how they drift",
        description=textwrap.dedent(_DESCRIPTION),
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add("logs", metavar="LOG", nargs="+", type=Path, help="what jax-inertia diagnose reads")
    add_model(add, "MJCF or URDF, one for all robots")
    tests_help = "other runs that test the results: a log takes its robot's run of the same date, else the only one"
    add("--test-logs", type=Path, nargs="+", default=[], metavar="LOG", help=tests_help)
    add(
        "--jobs",
        type=_count,
        default=1,
        metavar="N",
        help="number of logs diagnosed at the same time (default 1)",
    )
    add("--dask", metavar="ADDRESS", help="scheduler of a Dask cluster, instead of --jobs")
    pattern_help = "regular expression with the groups robot and date, searched in a log's path"
    add("--pattern", type=_pattern, default=_pattern(PATTERN), metavar="P", help=pattern_help)
    options_help = "options of jax-inertia diagnose for every log, as one text"
    add("--options", type=shlex.split, default=[], metavar="TEXT", help=options_help)
    add(
        "--out",
        type=Path,
        default=Path("out/fleet"),
        metavar="DIR",
        help="where to write (default: out/fleet)",
    )
    add("--json", action="store_true", help="print fleet.json instead of the tables")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Do it; raises ValueError with one line where nothing can be done at all."""
    from jax_inertia.fleet import jobs

    if not args.model.exists() and ":" not in str(args.model):
        raise ValueError(f"{args.model}: no such file")
    if args.out.exists() and not args.out.is_dir():
        raise ValueError(f"cannot write to {args.out}: it is not a folder; give another with --out")
    named = [robot_and_date(log, args.pattern) for log in args.logs]
    todo = tasks(args, named)
    told = _Told(len(todo))
    try:
        if args.dask is not None:
            return write(args, jobs.run_on_dask(todo, args.dask, told), named)
        return write(args, jobs.run_here(todo, args.jobs, told), named)
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            "finished logs are kept, and the same command continues from there"
        ) from None


def tasks(args: argparse.Namespace, named: "Sequence[tuple[str, str]]") -> "list[Task]":
    """A task for each log, in a folder of its own; ValueError where two would share one."""
    from importlib.metadata import version

    from jax_inertia.fleet.jobs import Task

    model = args.model.resolve() if args.model.exists() else args.model
    root = None if args.include_root is None else args.include_root.resolve()
    out, taken = args.out.resolve(), {}
    own, options, tests = version("jax-inertia"), tuple(args.options), validating(args, named)
    for log, (robot, _) in zip(args.logs, named, strict=True):
        folder = out / robot / (log.stem.strip(". ") or "log")
        if folder in taken:
            raise ValueError(
                f"{taken[folder].log} and {log} are both {folder.name} of {robot}; give them names of their own"
            )
        test = tests[log]
        taken[folder] = Task(
            log.resolve(), model, folder, options, own, test_log=test, include_root=root
        )
    return list(taken.values())


def validating(
    args: argparse.Namespace, named: "Sequence[tuple[str, str]]"
) -> "dict[Path, Path | None]":
    """The test log of each log: of the same robot and date, else the robot's only one, else none.

    ValueError where a file is missing, where a robot has two of one date, and where one has no log that it belongs to.
    """
    by_name: dict[tuple[str, str], Path] = {}
    for test in args.test_logs:
        if not test.exists():
            raise ValueError(f"--test-logs {test}: no such file")
        name = robot_and_date(test, args.pattern)
        if name in by_name:
            raise ValueError(
                f"--test-logs: {by_name[name]} and {test} are both of {' '.join(name)}"
            )
        by_name[name] = test.resolve()
    found: dict[Path, Path | None] = {}
    for log, name in zip(args.logs, named, strict=True):
        of_robot = [test for (robot, _), test in by_name.items() if robot == name[0]]
        only = of_robot[0] if len(of_robot) == 1 else None
        found[log] = by_name.get(name, only)
    unused = [str(test) for test in by_name.values() if test not in found.values()]
    if unused:
        raise ValueError(
            f"--test-logs {unused[0]}: no log is of its robot and date; they are read from a name by "
            "--pattern"
        )
    return found


def robot_and_date(log: Path, pattern: "re.Pattern[str]") -> tuple[str, str]:
    """Robot and ISO date of a log by its path; the date "" where there is none, and the robot by its folder or name."""
    import datetime

    last = list(pattern.finditer(log.with_suffix("").as_posix()))
    robot, date = (last[-1]["robot"] or "", last[-1]["date"] or "") if last else ("", "")
    try:
        date = datetime.date.fromisoformat(date).isoformat()
    except ValueError:
        date = ""
    robot = robot or (log.resolve().parent.name if date else log.stem)
    return re.sub(r"[^\w.-]", "_", robot).strip(". ") or "robot", date


def write(
    args: argparse.Namespace, ended: "Sequence[Outcome]", named: "Sequence[tuple[str, str]]"
) -> int:
    """fleet.html and fleet.json of all that is there; what is printed."""
    import json

    from jax_inertia.cli.compare import show
    from jax_inertia.cli.console import output_folder, warn
    from jax_inertia.fleet.page import Column, Refused, page, to_json
    from jax_inertia.fleet.report_file import read_report

    columns, refused = [], []
    for outcome, (robot, date) in sorted(zip(ended, named, strict=True), key=lambda x: x[1]):
        folder = outcome.task.out
        try:
            if outcome.status in ("refused", "lost"):
                raise ValueError(outcome.message)
            report = read_report(folder)
        except ValueError as error:
            refused.append(Refused(outcome.task.log.name, str(error)))
            warn(f"{outcome.task.log.name}: {error}")
            continue
        link = f"{robot}/{folder.name}/report.html"
        columns.append(Column(folder.name, report, robot, date, link))
    if not columns:
        raise ValueError("none of the logs could be diagnosed")
    drifting = _drifts(columns)
    found = to_json(columns, drifting, refused)
    with output_folder(args.out, "fleet") as folder:
        html = page(f"Fleet of {args.model.name}", columns, drifting, refused)
        (folder / "fleet.html").write_text(html, encoding="utf-8")
        (folder / "fleet.json").write_text(
            json.dumps(found, indent=1, allow_nan=False) + "\n", encoding="utf-8"
        )
    if args.json:
        print(json.dumps(found, indent=1, allow_nan=False))
        return 0
    show(columns)
    for line in _drift_lines(drifting):
        print(line)
    print(f"page: {args.out / 'fleet.html'}")
    return 0


def _drifts(columns: "Sequence[Column]") -> list:
    """Of every robot with logs of two dates."""
    import datetime

    from jax_inertia.fleet.drift import drifts
    from jax_inertia.fleet.numbers import numbers

    out = []
    for robot in dict.fromkeys(c.robot for c in columns):
        own = [c for c in columns if c.robot == robot and c.date]
        days = [datetime.date.fromisoformat(c.date).toordinal() for c in own]
        if len(set(days)) > 1:
            out += drifts(robot, days, [numbers(c.report) for c in own])
    return sorted(out, key=lambda d: not d.stands_out)


def _drift_lines(drifting: Sequence) -> list[str]:
    from jax_inertia.fleet.page import label

    lines = []
    for d in (d for d in drifting if d.stands_out):
        rate, where = d.per_month, d.quantity.place or "all joints"
        half = 0.5 * (rate.high - rate.low)
        lines.append(
            f"{d.robot} drifts: {label(d.quantity)} at {where} {d.first:.3g} → {d.last:.3g} in {d.logs} logs, "
            f"{rate.value:+.2g} ± {half:.1g} per 30 days"
        )
    return lines or (["no number drifts by more than its interval says"] if drifting else [])


class _Told:
    """A line on stderr for each log that ends."""

    def __init__(self, count: int) -> None:
        self.count = count

    def __call__(self, outcome: "Outcome", ended: int) -> None:
        name = outcome.task.log.name
        status = "done before" if outcome.status == "before" else outcome.status
        print(f"{ended} of {self.count}: {name} {status}", file=sys.stderr, flush=True)


def _count(text: str) -> int:
    if not text.isdecimal() or not 1 <= int(text) <= 256:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from 1 to 256")
    return int(text)


def _pattern(text: str) -> "re.Pattern[str]":
    try:
        pattern = re.compile(text)
    except re.error as error:
        raise argparse.ArgumentTypeError(f"{text!r} is no regular expression: {error}") from None
    if not {"robot", "date"} <= set(pattern.groupindex):
        raise argparse.ArgumentTypeError(f"{text!r} lacks the groups (?P<robot>...), (?P<date>...)")
    return pattern
