"""`jax-inertia convert`: a log of any kind into the form that the other commands read fastest."""

import argparse
import json
import textwrap
from pathlib import Path

_DESCRIPTION = """
Read a log as people have it (CSV, Parquet, a ROS 1 or ROS 2 bag, MCAP, a LeRobot dataset) and write it as .npz, .csv
or .parquet. With --model its joints, bodies and values are checked as the other commands do, and joints that the
robot does not have are left out. What was assumed on the way is printed.
"""
_EXAMPLES = """
columns of CSV and Parquet: time [s], qpos.<joint>, tau.<joint>, and where there are any qvel.<joint>,
tau_command.<joint>, qpos_target.<joint>, sigma_tau.<joint>, base_pos.x ... base_quat.w ... base_linvel.x ...
base_angvel.x ..., contact_wrench.<body>.fx ... mz, tau_unit, tau_kind. A heading may end in its unit: qpos.elbow [deg].

examples:
  a CSV with columns of its own: t, q_elbow, q_wrist, i_elbow, i_wrist (motor currents)
    jax-inertia convert run.csv run.npz --column time=t --column 'qpos.*=q_*' --column 'tau.*=i_*' --tau-unit A

  a bag of a legged robot: joint states, odometry, and the force sensor in the left foot
    jax-inertia convert walk.mcap walk.npz --model robot.urdf --topic-base /odom --topic-wrench l_foot=/ft/left \\
        --wrench-axes body

  the fourth episode of a LeRobot dataset whose joints are logged in degrees
    jax-inertia convert my_dataset episode.npz --episode 3 --degrees

  how a table has to look: write one
    jax-inertia demo && jax-inertia convert out/demo/log.npz log.csv
"""


def add_parser(subparsers) -> None:
    """Add `convert` to the command line."""
    parser = subparsers.add_parser(
        "convert",
        help="a log from CSV, Parquet, ROS bags or MCAP",
        description=textwrap.dedent(_DESCRIPTION),
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    kinds = (
        ".csv, .parquet, .bag, .mcap, .db3, .npz, or the folder of a ROS 2 bag or LeRobot dataset"
    )
    add("log", metavar="IN", type=Path, help=kinds)
    add("out", metavar="OUT", type=Path, help=".npz, .csv or .parquet")
    add("--model", type=Path, help="MJCF or URDF to check joints, bodies and units against")
    add("--tau-unit", metavar="U", help="unit of the torques: N m, A, mA, PWM ...")
    add("--tau-kind", choices=("commanded", "current", "sensor"), help="where they come from")
    add("--degrees", action="store_true", help="positions and velocities are in degrees")
    add(
        "--rename",
        type=_pair,
        action="append",
        metavar="FILE=MODEL",
        help="a joint by the file's name and by the model's",
    )
    add("--json", action="store_true", help="print what was written as JSON")

    add = parser.add_argument_group("CSV, Parquet, LeRobot").add_argument
    add(
        "--column",
        type=_pair,
        action="append",
        metavar="NAME=COLUMN",
        help="a column by the contract's name and by the file's; one * in both stands for the joint",
    )
    add("--joints", nargs="+", metavar="J", help="joints of columns that hold lists, in order")
    add("--episode", type=int, metavar="N", help="which episode of a dataset")

    add = parser.add_argument_group("ROS bags and MCAP").add_argument
    add("--topic-joints", metavar="T", help="sensor_msgs/JointState (default: the only one)")
    add("--topic-base", metavar="T", help="nav_msgs/Odometry of the floating base")
    add(
        "--topic-wrench",
        type=_pair,
        action="append",
        metavar="BODY=T",
        help="geometry_msgs/WrenchStamped: force on the robot at this body",
    )
    add(
        "--wrench-axes",
        choices=("world", "body"),
        default="world",
        help="axes of the wrenches (default world; body needs --model)",
    )
    add(
        "--flip-wrenches",
        action="store_true",
        help="they are the robot's on its surroundings",
    )
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Do it; raises ValueError with one line where the log or the model cannot be used."""
    from jax_inertia.cli.console import stages, warn
    from jax_inertia.logs.atomic_files import check_target
    from jax_inertia.logs.log import LogError, read_log, write_log
    from jax_inertia.logs.readers import Options, WrenchAxes
    from jax_inertia.model.load import load_model
    from jax_inertia.model.log_match import afloat
    from jax_inertia.preflight.preflight import Severity, preflight
    from jax_inertia.signals.wrench_axes import wrenches_in_world

    check_target(args.out)
    if args.out.exists() and args.log.exists() and args.out.samefile(args.log):
        raise ValueError(
            f"cannot write {args.out}: it is the log to be read; give OUT another name"
        )
    if args.wrench_axes == "body" and args.model is None:
        raise ValueError("--wrench-axes body needs --model, which says how the body is turned")
    options = Options(
        columns=_once(args.column, "--column"),
        joints=tuple(args.joints or ()),
        episode=args.episode,
        topic_joints=args.topic_joints,
        topic_base=args.topic_base,
        topic_wrenches=_once(args.topic_wrench, "--topic-wrench"),
        wrench_axes=WrenchAxes(args.wrench_axes),
        flip_wrenches=args.flip_wrenches,
        rename=_once(args.rename, "--rename"),
        degrees=args.degrees,
        tau_unit=args.tau_unit,
        tau_kind=args.tau_kind,
    )
    with stages() as stage:
        stage("reading the model")
        robot = None if args.model is None else load_model(args.model)
        stage("reading the log")
        log = read_log(args.log, options=options, names=robot)
        if robot is not None and args.model is not None:
            robot, _ = afloat(robot, args.model, log)
        stage("looking at the log")
        found = preflight(log, robot)
        try:
            if robot is not None:
                found.raise_for_errors()
                if args.wrench_axes == "body":
                    log = wrenches_in_world(log, robot)
        except LogError as error:
            raise LogError(f"{args.log}: {error}") from None
        stage("writing")
        write_log(log, args.out)
    for finding in (*found.of(Severity.ERROR), *found.of(Severity.WARNING)):
        warn(f"{args.log}: {finding.message}")
    if args.json:
        print(json.dumps(_summary(args.out, log, found), indent=1, allow_nan=False))
        return 0
    print(log)
    for note in log.notes:
        print(f"  {note}")
    print(f"written to {args.out}")
    return 0


def _summary(out: Path, log, found) -> dict:
    return {
        "schema": 1,
        "out": str(out),
        "samples": len(log.time),
        "duration_s": log.duration,
        "rate_hz": log.rate,
        "joints": list(log.joint_names),
        "contact_bodies": list(log.contact_bodies),
        "tau_unit": log.tau_unit_text,
        "tau_kind": str(log.tau_kind),
        "notes": list(log.notes),
        "findings": [
            {"severity": str(f.severity), "check": f.check, "message": f.message}
            for f in found.findings
        ],
    }


def _pair(text: str) -> tuple[str, str]:
    name, sep, value = text.partition("=")
    if not (sep and name and value):
        raise argparse.ArgumentTypeError(f"{text!r} is no pair NAME=VALUE")
    return name, value


def _once(pairs: list[tuple[str, str]] | None, option: str) -> dict[str, str]:
    out = dict(pairs or ())
    if len(out) < len(pairs or ()):
        raise ValueError(f"{option} names {', '.join(out)}, one of them twice; each may have one")
    return out
