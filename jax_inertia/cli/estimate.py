"""`jax-inertia estimate`: the inertial parameters of chosen bodies from a log, over time and over the whole log."""

import argparse
import dataclasses
import textwrap
from pathlib import Path
from typing import TYPE_CHECKING

from jax_inertia.cli import estimate_wrench
from jax_inertia.cli.conventions import add_conventions
from jax_inertia.cli.estimate_wrench import add_wrench

if TYPE_CHECKING:
    from jax_inertia.estimation.estimate_inputs import Inputs

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

  a wrist sensor, and no joint torques: what does it carry, and what is its offset?
    jax-inertia estimate poses.mcap --model arm.urdf --wrench tool0=/ft_sensor/wrench

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
    add("--bodies", nargs="+", metavar="B", help="bodies to estimate, by name")
    add(
        "--out",
        type=Path,
        metavar="DIR",
        help="where to write (default: out/<name of LOG>/estimate)",
    )

    write_help = (
        "write the model with the estimated bodies, and with all that was calibrated: a URDF as URDF (and as MJCF, "
        "where joints were calibrated), MJCF as MJCF"
    )
    add("--write-model", action="store_true", help=write_help)
    add("--json", action="store_true", help="print report.json instead of the tables")

    _add_torques(
        parser.add_argument_group("torques that are not in N m (motor currents, PWM)").add_argument
    )
    _add_filter(parser.add_argument_group("filter").add_argument)
    _add_signals(parser.add_argument_group("signals").add_argument)
    add_wrench(parser.add_argument_group("a wrist's force/torque sensor").add_argument)
    add_conventions(parser)
    parser.set_defaults(run=lambda args: run(args, parser))


def _add_torques(add) -> None:
    gains_help = "N m per logged unit, one for each joint of the log, or one for all"
    add("--gains", nargs="+", type=float, metavar="G", help=gains_help)
    calibrate_help = (
        "logs without load: fit gains (if not in N m), friction, damping, armature, torque offsets and all "
        "bodies on these, hold them, then estimate; --gains is then where the fit starts (default 10)"
    )
    add("--calibrate", nargs="+", type=Path, metavar="LOG", help=calibrate_help)
    add(
        "--gain-sigma",
        type=_positive,
        metavar="S",
        help="relative uncertainty of the gains to calibrate (default: 1, or 0.5 with --gains)",
    )

    trust_help = (
        "how well the model is known, for --calibrate: masses in parts, centres of mass in m (default 0.1 0.05). "
        "Currents have no scale of torque but this, so a load weighed with fitted gains hangs on it"
    )
    add(
        "--trust",
        nargs=2,
        type=_positive,
        default=(0.1, 0.05),
        metavar=("MASS", "COM"),
        help=trust_help,
    )


def _add_filter(add) -> None:
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


def _add_signals(add) -> None:
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


def run(args: argparse.Namespace, parser: argparse.ArgumentParser) -> int:
    """Do it; raises ValueError with one line where log, model or settings cannot be used."""
    if args.wrench is not None:
        return estimate_wrench.run(args, parser)
    if not args.bodies:
        raise ValueError("no body to estimate; give --bodies, or the sensor's with --wrench")
    if args.wrench_axes is not None or args.flip_wrenches:
        raise ValueError("--wrench-axes and --flip-wrenches are of --wrench BODY; give that too")
    from jax_inertia.cli import estimate_output as output
    from jax_inertia.cli.console import folder_for, output_folder, stages
    from jax_inertia.estimation import pipeline
    from jax_inertia.model.write import write_with_inertials

    out = args.out if args.out is not None else folder_for(args.log) / "estimate"
    written = []
    with stages() as stage:
        inputs = read(args)
        with output_folder(out) as folder:
            found = pipeline.run(inputs, stage)
            stage("writing")
            report = output.report(args, found)
            output.write(folder, found, report)
            if args.write_model:
                written = write_with_inertials(
                    folder,
                    "estimated",
                    args.model,
                    found.calibrated_pi | found.pi,
                    joints=found.calibrated_joints,
                    home=out,
                )
    output.show(found, report, out, as_json=args.json)
    if not args.json:
        for file in written:
            print(f"The model with what was estimated: {out / file.name}")
    return 0


def read(args: argparse.Namespace) -> "Inputs":
    """Read model and logs, and look at them before anything is computed."""
    from jax_inertia.cli.console import warn
    from jax_inertia.cli.conventions import met
    from jax_inertia.estimation.estimate_inputs import Names, Settings, checked
    from jax_inertia.logs.findings import Finding, Severity
    from jax_inertia.logs.log_files import read_log
    from jax_inertia.logs.readers import Options
    from jax_inertia.model.load import load_model
    from jax_inertia.model.log_match import afloat
    from jax_inertia.replay.entry import of_loop
    from jax_inertia.text.closest_names import suggestion

    robot = load_model(args.model)
    paths = (args.log, *(args.calibrate or ()))
    options = Options(time_unit=args.time_unit)
    log, *references = [read_log(path, names=robot, options=options) for path in paths]
    robot, found = afloat(robot, args.model, log)
    log, *references = (of_loop(one, robot, args.model) for one in (log, *references))
    robot, (log, *references), notes = met(args, robot, (log, *references), gains=None)
    for name in args.bodies:
        if name not in robot.body_names:
            raise ValueError(
                f"{args.model} has no moving body {name!r}; {suggestion(name, robot.body_names)}"
            )

    def report(path: str, finding: Finding) -> None:
        if finding.severity is Severity.WARNING and finding.check != "torque_unit":
            warn(f"{path}: {finding.message}")

    return checked(
        robot,
        log,
        args.bodies,
        references,
        Settings(**{f.name: getattr(args, f.name) for f in dataclasses.fields(Settings)}),
        names=Names(str(paths[0]), [str(path) for path in paths[1:]], _option),
        found=(*found, *notes),
        report=report,
    )


def _option(name: str) -> str:
    return f"--{name.replace('_', '-')}"


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
