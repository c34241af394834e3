"""`jax-inertia estimate`: the inertial parameters of chosen bodies from a log, over time and over the whole log."""

import argparse
import dataclasses
import textwrap
from pathlib import Path
from typing import TYPE_CHECKING

from jax_inertia.cli import estimate_wrench
from jax_inertia.cli.conventions import add_conventions, add_model, add_prior_mass, number, positive
from jax_inertia.cli.estimate_wrench import add_wrench

if TYPE_CHECKING:
    from jax_inertia.control.payload import Frame
    from jax_inertia.estimation.estimate_inputs import Inputs

DRIVERS = ("ur", "franka", "kuka", "xarm")
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
    add_model(add, "MJCF or URDF with the bodies as known beforehand")
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

    _add_driver(parser.add_argument_group("a line for the robot's driver").add_argument)
    _add_torques(
        parser.add_argument_group("torques that are not in N m (motor currents, PWM)").add_argument
    )
    _add_unknown(parser.add_argument_group("what the model lacks").add_argument)
    _add_filter(parser.add_argument_group("filter").add_argument)
    _add_signals(parser.add_argument_group("signals").add_argument)
    add_wrench(parser.add_argument_group("a wrist's force/torque sensor").add_argument)
    add_conventions(parser)
    parser.set_defaults(run=lambda args: run(args, parser))


def _add_driver(add) -> None:
    driver_help = (
        "print what the body carries beyond the model as the line that sets a payload: of a Universal Robot "
        "(URScript), Franka (libfranka), KUKA (KRL) or xArm (its SDK)"
    )
    add("--driver", choices=DRIVERS, help=driver_help)
    flange_help = "site or link of the model in whose frame the driver takes it (default: the body's own frame)"
    add("--flange", metavar="FRAME", help=flange_help)


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
        type=positive,
        metavar="S",
        help="relative uncertainty of the gains to calibrate (default: 1, or 0.5 with --gains)",
    )

    trust_help = (
        "for --calibrate: standard deviations of masses (relative) and centres of mass [m] (default 0.1 0.05). "
        "Currents alone have no torque scale, so a load that is weighed with fitted gains depends on it"
    )
    add(
        "--trust",
        nargs=2,
        type=positive,
        default=(0.1, 0.05),
        metavar=("MASS", "COM"),
        help=trust_help,
    )


def _add_unknown(add) -> None:
    friction_help = (
        "estimate every joint's viscous and dry friction and its torque's offset with the bodies (default: where the "
        "log's own residual shows them)"
    )
    add("--friction", action=argparse.BooleanOptionalAction, default=None, help=friction_help)
    tolerance_help = (
        "how well links are known: masses in parts, centres of mass in m, radii of gyration in parts (default: as a "
        "corrected.xml says itself, else 0.02 0.001 0.05; 0 0 0: exactly); intervals contain it"
    )
    add(
        "--tolerance",
        nargs=3,
        type=_not_negative,
        metavar=("MASS", "COM", "RADIUS"),
        help=tolerance_help,
    )


def _add_filter(add) -> None:
    chart_help = (
        f"coordinates: {', '.join(CHARTS)} (default {CHARTS[0]}, whose filter is over π and gives the most "
        "probable bodies; the others are filtered in themselves; the paper's: log-cholesky)"
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
        type=positive,
        metavar="S",
        help="a gate that rejects everything for S seconds reopens for a new load (default 0.5 s)",
    )
    add(
        "--iterations",
        type=_count,
        metavar="N",
        help="iterations of each update (default 5; 1 is the paper's extended Kalman filter)",
    )
    add(
        "--sigma-tau",
        nargs="+",
        type=positive,
        metavar="S",
        help="noise of one filtered sample [N m], one for all rows or one each (default: from residuals)",
    )
    add_prior_mass(add)
    add(
        "--prior-reach",
        type=positive,
        default=0.2,
        metavar="M",
        help="distance from the body's origin within which to expect it (default 0.2 m)",
    )
    add(
        "--drift-time",
        type=positive,
        metavar="S",
        help="time in which bodies may drift by the expected load (default 3600; 3 without gate)",
    )


def _add_signals(add) -> None:
    ignore_help = "leave an optional channel out: qvel, where positions are better differentiated"
    add("--ignore", nargs="+", choices=("qvel",), default=(), metavar="CHANNEL", help=ignore_help)
    add(
        "--cutoff",
        type=positive,
        metavar="HZ",
        help="cutoff of the low-pass (default 10 Hz, at most a fifth of the log's rate)",
    )
    add(
        "--rate",
        type=positive,
        metavar="HZ",
        help="rate of the resampled log (default: ten times the cutoff, or the log's rate)",
    )
    add(
        "--bias-window",
        type=positive,
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
        raise ValueError("--wrench-axes and --flip-wrenches need --wrench BODY")
    from jax_inertia.cli import estimate_output as output
    from jax_inertia.cli.console import folder_for, output_folder
    from jax_inertia.cli.running.stages import stages
    from jax_inertia.control.payload import payload_report
    from jax_inertia.estimation import pipeline
    from jax_inertia.model.write import write_with_inertials

    out = args.out if args.out is not None else folder_for(args.log) / "estimate"
    written = []
    with stages() as stage:
        inputs = read(args)
        frame = _flange(args)
        with output_folder(out) as folder:
            found = pipeline.run(inputs, stage)
            stage("writing")
            report = output.report(args, found)
            if args.driver is not None:
                report["payload"] = payload_report(found, args.driver, frame, args.flange)
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
        if args.driver is not None:
            print("\n".join(report["payload"]["said"]))
        for file in written:
            print(f"The model with what was estimated: {out / file.name}")
    return 0


def _flange(args: argparse.Namespace) -> "Frame | None":
    """The frame that a driver takes a load in, None for the body's own."""
    from jax_inertia.control.payload import frame_of

    if args.driver is not None and len(args.bodies) != 1:
        raise ValueError(f"--driver {args.driver} takes one load: give one of --bodies")
    if args.flange is not None and args.driver is None:
        raise ValueError(f"--flange {args.flange} needs --driver {{{','.join(DRIVERS)}}}")
    return None if args.flange is None else frame_of(args.model, args.flange, args.bodies[0])


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


def _not_negative(text: str) -> float:
    value = number(text)
    if not 0 <= value < float("inf"):
        raise argparse.ArgumentTypeError(f"{text} is not a number from zero up")
    return value


def _probability(text: str) -> float:
    value = number(text)
    if not 0 < value <= 1:
        raise argparse.ArgumentTypeError(
            f"{text} is no probability; it must lie above 0, and not above 1 (no gate)"
        )
    return value


def _count(text: str) -> int:
    if not text.isdecimal() or not 1 <= int(text) <= 100:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from 1 to 100")
    return int(text)
