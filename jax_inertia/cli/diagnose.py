"""`jax-inertia diagnose`: which effects the model lacks, where, how large, and how far the gap shrinks with them."""

import argparse
import dataclasses
import textwrap
from pathlib import Path

from jax_inertia.cli.conventions import add_conventions, add_gains, add_model
from jax_inertia.trainers import SIMULATORS

_DESCRIPTION = """
Find what MODEL lacks, compared with the robot of LOG: each effect, its place, its size, and how far the error shrinks
with it. Writes report.json, report.html (one file, for people) and corrected.xml (MODEL with the
effects added), and of a URDF corrected.urdf. A LOG of a position-controlled robot, with
the torque of its loop or without, is diagnosed by closed-loop replays of its targets: see docs/position_controlled.md.
"""
_EXAMPLES = """
examples:
  what does the simulation of this arm lack?
    jax-inertia diagnose log.npz --model arm.xml

  the same, checked on another motion
    jax-inertia diagnose log.npz --model arm.xml --test-log other.npz --out diagnosis

  without an effect that cannot be (this arm has no belts)
    jax-inertia diagnose log.npz --model arm.xml --exclude joint_elasticity backlash

  a position-controlled robot, no torque in the log
    jax-inertia diagnose log.npz --model arm.xml --test-log other.npz --kp 20 --kd 0.5

  the same, with files to train a policy with
    jax-inertia diagnose log.npz --model arm.xml --export isaaclab playground

  the same from several motions
    jax-inertia diagnose a.npz --more-logs b.npz c.npz --model arm.xml --test-log other.npz

No log at hand? jax-inertia demo --out demo   makes one, and diagnoses it.
"""

_LOG_HELP = ".npz, .csv, .parquet, ROS bag or MCAP (what needs options: see jax-inertia convert)"


_PRODUCTS = (
    "report.json", "report.html", "corrected.xml", "corrected.urdf", "policy.json", "draws.npz",
    "diagnosis.mcap",
    *(f"{name}.py" for name in SIMULATORS),
)  # fmt: skip


def add_parser(subparsers) -> None:
    """Add `diagnose` to the command line."""
    parser = subparsers.add_parser(
        "diagnose",
        help="which effects a model lacks, from a log",
        description=textwrap.dedent(_DESCRIPTION),
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add("log", metavar="LOG", type=Path, help=_LOG_HELP)
    add_model(add, "MJCF or URDF, the robot as modelled")
    test_help = (
        "another motion of the robot: quotes the error of what is handed over, and decides nothing"
    )
    add("--test-log", type=Path, metavar="LOG2", help=test_help)
    validation_help = (
        "another motion, by which effects are chosen (default: rows of LOG that are held out)"
    )
    add("--validation-log", type=Path, metavar="LOG3", help=validation_help)
    more_help = "further logs of targets, fitted with LOG; their gains may be others"
    add(
        "--more-logs",
        nargs="+",
        type=Path,
        action="extend",
        default=[],
        metavar="LOG",
        help=more_help,
    )
    exclude_help = "effects that cannot be (see docs/effects.md)"
    add("--exclude", nargs="+", action="extend", default=[], metavar="FAMILY", help=exclude_help)
    effects_help = "largest number of odd effects (default: as many as LOG supports)"
    add("--max-effects", type=_count, metavar="N", help=effects_help)
    export_help = (
        "also write files to train a policy with, from a log of targets (see docs/training.md)"
    )
    add("--export", nargs="+", action="extend", default=[], choices=SIMULATORS, help=export_help)
    record_help = (
        "also write diagnosis.mcap: measured, predicted and residual along time, for Foxglove"
    )
    add("--mcap", action="store_true", help=record_help)
    uncertain_help = (
        "standard deviations of the model's masses (relative), centres of mass [m] and inertias (relative); "
        "default: typical errors of drawings of built arms"
    )
    add(
        "--nominal-uncertainty",
        nargs=3,
        type=_positive,
        metavar=("MASS", "COM", "INERTIA"),
        help=uncertain_help,
    )
    add_gains(add)
    add("--out", type=Path, metavar="DIR", help="where to write (default: out/<name of LOG>)")
    add("--json", action="store_true", help="print report.json instead of the table")
    add_conventions(parser, gains=True)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Do it; raises ValueError with one line where log or model cannot be used."""
    from jax_inertia.cli import diagnose_run as pipeline
    from jax_inertia.cli.console import folder_for, output_folder
    from jax_inertia.cli.running.stages import stages

    gains = pipeline.Gains(args.kp, args.kd, args.fix_base)
    out = args.out if args.out is not None else folder_for(args.log)
    with stages() as stage:
        inputs = pipeline.read(
            args.model, args.log, args.test_log, args.exclude, args, gains, args.more_logs,
            args.validation_log,
        )  # fmt: skip
        if args.nominal_uncertainty is not None:
            inputs = dataclasses.replace(inputs, uncertainty=tuple(args.nominal_uncertainty))
        with output_folder(out, products=_PRODUCTS) as folder:
            show = pipeline.diagnosed(
                folder, inputs, args.exclude, args.max_effects, stage, gains, args.export, args.mcap
            )
    show(out, as_json=args.json)
    return 0


def _positive(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.0 < value < 10.0:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number above 0 and below 10")
    return value


def _count(text: str) -> int:
    if not text.isdecimal() or not 1 <= int(text) <= 20:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from 1 to 20")
    return int(text)
