"""`jax-inertia estimate`: the inertial parameters of chosen bodies from a log, over time and over the whole log."""

import argparse
import textwrap
from pathlib import Path

CHARTS = ("log-cholesky-uut", "log-cholesky", "relative", "linear")

_DESCRIPTION = """
Estimate mass, centre of mass and inertia of BODIES from LOG: over time by a Kalman filter, and over the whole log by
a batch fit. Writes estimates.npz, estimates.csv, report.json and estimate.png.
"""
_EXAMPLES = """
examples:
  an arm with torque sensors; what does its hand carry, and since when?
    jax-inertia estimate log.npz --model arm.xml --bodies hand

  an arm that logs motor currents: learn gains and friction from logs without load, then weigh the load
    jax-inertia estimate loaded.npz --model ur10e.urdf --bodies wrist_3_link --calibrate free_1.npz free_2.npz

  the paper's baseline Kalman filter
    jax-inertia estimate log.npz --model arm.xml --bodies hand --chart linear --iterations 1 --gate 1

No log at hand? jax-inertia demo --out demo   makes one, and prints the command for it.
"""

_LOG_HELP = ".npz, .csv, .parquet, ROS bag or MCAP (what needs options: see jax-inertia convert)"


def add_parser(subparsers) -> None:
    """Add `estimate` to the command line."""
    parser = subparsers.add_parser(
        "estimate",
        help="inertial parameters of bodies from a log",
        description=textwrap.dedent(_DESCRIPTION),
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add("log", metavar="LOG", type=Path, help=_LOG_HELP)
    add("--model", type=Path, required=True, help="MJCF or URDF, the bodies as known beforehand")
    add("--bodies", nargs="+", required=True, metavar="B", help="bodies to estimate, by name")
    add("--out", type=Path, metavar="DIR", help="where to write (default: out/<name of LOG>)")

    write_help = "write the model with the estimated bodies too: a URDF as URDF, MJCF as MJCF"
    add("--write-model", action="store_true", help=write_help)
    add("--json", action="store_true", help="print report.json instead of the tables")

    group = parser.add_argument_group("torques that are not in N m (motor currents, PWM)")
    gains_help = "N m per logged unit, one for each joint of the log, or one for all"
    group.add_argument("--gains", nargs="+", type=float, metavar="G", help=gains_help)
    calibrate_help = (
        "logs without load: fit gains (if not in N m), friction, damping, armature, torque offsets and all "
        "bodies on these, hold them, then estimate; --gains is then where the fit starts (default 10)"
    )
    group.add_argument("--calibrate", nargs="+", type=Path, metavar="LOG", help=calibrate_help)
    group.add_argument(
        "--gain-sigma",
        type=_positive,
        metavar="S",
        help="relative uncertainty of the gains to calibrate (default: 1, or 0.5 with --gains)",
    )

    trust_help = (
        "how well the model is known, for --calibrate: masses in parts, centres of mass in m (default 0.1 0.05). "
        "Currents have no scale of torque but this, so a load weighed with fitted gains hangs on it"
    )
    group.add_argument(
        "--trust",
        nargs=2,
        type=_positive,
        default=(0.1, 0.05),
        metavar=("MASS", "COM"),
        help=trust_help,
    )

    group = parser.add_argument_group("filter")
    add = group.add_argument
    chart_help = (
        f"coordinates: {', '.join(CHARTS)} (default {CHARTS[0]}; the paper's: log-cholesky)"
    )
    add("--chart", choices=CHARTS, default=CHARTS[0], metavar="CHART", help=chart_help)
    add(
        "--gate",
        type=_probability,
        metavar="P",
        help="probability of keeping a good sample, up to 1: no gate (default 0.9999)",
    )
    add(
        "--reopen-after",
        type=_positive,
        metavar="S",
        help="a gate that rejects everything for so long meets a new load (default 0.5 s)",
    )
    add(
        "--iterations",
        type=_count,
        metavar="N",
        help="of each update (default 5; 1 is the paper's extended Kalman filter)",
    )
    add(
        "--sigma-tau",
        nargs="+",
        type=_positive,
        metavar="S",
        help="noise of one filtered sample [N m], one for all rows or one each (default: from residuals)",
    )
    add(
        "--prior-mass",
        type=_positive,
        metavar="KG",
        help="load to expect (default: a tenth of the robot)",
    )
    add(
        "--prior-reach", type=_positive, default=0.2, metavar="M", help="and within (default 0.2 m)"
    )
    add(
        "--drift-time",
        type=_positive,
        metavar="S",
        help="time in which bodies may drift by the expected load (default 3600; 3 without gate)",
    )

    group = parser.add_argument_group("signals")
    add = group.add_argument
    add(
        "--cutoff",
        type=_positive,
        metavar="HZ",
        help="low-pass (default 10 Hz, at most a fifth of the log's rate)",
    )
    add(
        "--rate",
        type=_positive,
        metavar="HZ",
        help="grid (default: ten times the cutoff, or the log's)",
    )
    add(
        "--bias-window",
        type=_positive,
        metavar="S",
        help="take the mean residual of the first S seconds, when nothing is carried, as torque offset",
    )
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Do it; raises ValueError with one line where log, model or settings cannot be used."""
    from jax_inertia.cli import estimate_output as output
    from jax_inertia.cli import estimate_run as pipeline
    from jax_inertia.cli.console import folder_for, output_folder, stages
    from jax_inertia.model.write import write_with_inertials

    out = args.out if args.out is not None else folder_for(args.log)
    written = None
    with stages() as stage:
        inputs = pipeline.read(args)
        with output_folder(out) as folder:
            result = pipeline.estimate(args, inputs, stage)
            stage("writing")
            output.write(folder, args, result)
            if args.write_model:
                best = output.best(result)
                written = write_with_inertials(folder, "estimated", args.model, best)
    output.show(args, result, out)
    if written is not None and not args.json:
        print(f"The model with these bodies: {out / written.name}")
    return 0


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is no number") from None


def _positive(text: str) -> float:
    value = _number(text)
    if not 0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"{text} is not a positive number")
    return value


def _probability(text: str) -> float:
    value = _number(text)
    if not 0 < value <= 1:
        raise argparse.ArgumentTypeError(
            f"{text} is no probability; it must lie above 0, and not above 1 (no gate)"
        )
    return value


def _count(text: str) -> int:
    if not text.isdecimal() or not 1 <= int(text) <= 100:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from 1 to 100")
    return int(text)
