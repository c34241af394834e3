"""`jax-inertia convert`: a log of any kind into the form that the other commands read fastest."""

import argparse
import json
import sys
import textwrap
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from jax_inertia.cli.conventions import add_time_unit

if TYPE_CHECKING:
    from jax_inertia.logs.log import Log
    from jax_inertia.model.robot import Robot
    from jax_inertia.preflight.preflight import Preflight

_DESCRIPTION = """
Read a log as people have it (CSV, Parquet, a ROS 1 or ROS 2 bag, MCAP, a LeRobot dataset) and write it as .npz, .csv
or .parquet. With --model its joints, bodies and values are checked as the other commands do, and joints that the
robot does not have are left out. What was assumed on the way is printed.
"""
_EXAMPLES = """
columns of CSV and Parquet: time [s], qpos.<joint>, tau.<joint>, and where there are any qvel.<joint>,
tau_command.<joint>, qpos_target.<joint>, sigma_tau.<joint>, base_pos.x ... base_quat.w ... base_linvel.x ...
base_angvel.x ..., base_linacc.x ..., contact_wrench.<body>.fx ... mz, contact_force.<body>, contact_flag.<body>,
imu_body, imu_pos.x ..., tau_unit, tau_kind. A heading may end in its unit: qpos.elbow [deg].

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


_WIDEST = 10_000


def add_parser(subparsers) -> None:
    """Add `convert` to the command line."""
    parser = subparsers.add_parser(
        "convert",
        help="a log from CSV, Parquet, ROS bags or MCAP",
        description=textwrap.dedent(_DESCRIPTION),
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    _add_any(parser.add_argument)
    _add_tables(parser.add_argument_group("CSV, Parquet, LeRobot").add_argument)
    _add_bags(parser.add_argument_group("ROS bags and MCAP").add_argument)
    parser.set_defaults(run=run)


def _add_any(add: Callable[..., object]) -> None:
    """Add what holds for a log of any kind."""
    kinds = (
        ".csv, .parquet, .bag, .mcap, .db3, .npz, or the folder of a ROS 2 bag or LeRobot dataset"
    )
    add("log", metavar="IN", type=Path, help=kinds)
    add("out", metavar="OUT", type=Path, help=".npz, .csv or .parquet")
    add("--model", type=Path, help="MJCF or URDF to check joints, bodies and units against")
    add("--tau-unit", type=_said, metavar="U", help="unit of the torques: N m, A, mA, PWM ...")
    add("--tau-kind", choices=("commanded", "current", "sensor"), help="where they come from")
    add_time_unit(add)
    add("--degrees", action="store_true", help="positions and velocities are in degrees")
    add(
        "--rename",
        type=_pair,
        action="append",
        metavar="FILE=MODEL",
        help="a joint by the file's name and by the model's",
    )
    add("--json", action="store_true", help="print what was written as JSON")


def _add_tables(add: Callable[..., object]) -> None:
    """Add which columns are what, and which episode is read."""
    add(
        "--column",
        type=_pair,
        action="append",
        metavar="NAME=COLUMN",
        help="a column by the contract's name and by the file's; one * in both stands for the joint; "
        "columns of lists that are parts of one array: once each",
    )
    add("--joints", nargs="+", metavar="J", help="joints of columns that hold lists, in order")
    add("--episode", type=_natural, metavar="N", help="which episode of a dataset, from 0")
    calibration_help = (
        "JSON file of the motors' ranges, where a dataset's positions are normalised to ±100"
    )
    add("--calibration", type=Path, metavar="FILE", help=calibration_help)


def _add_bags(add: Callable[..., object]) -> None:
    """Add which topics are what, and how their wrenches are meant."""
    joints_help = (
        "sensor_msgs/JointState, one topic or several (default: all, put together by joint)"
    )
    add("--topic-joints", nargs="+", metavar="T", help=joints_help)
    add("--topic-base", metavar="T", help="nav_msgs/Odometry of the floating base")
    add("--topic-imu", metavar="T", help="sensor_msgs/Imu of the floating base, along its axes")
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


def run(args: argparse.Namespace) -> int:
    """Do it; raises ValueError with one line where the log or the model cannot be used."""
    from jax_inertia.cli.console import stages, warn
    from jax_inertia.logs.atomic_files import check_target
    from jax_inertia.logs.log import LogError
    from jax_inertia.logs.log_files import read_log, write_log
    from jax_inertia.logs.readers import Options, WrenchAxes
    from jax_inertia.model.load import load_model
    from jax_inertia.model.log_match import afloat
    from jax_inertia.preflight.preflight import Severity
    from jax_inertia.signals.wrench_axes import wrenches_in_world

    check_target(args.out)
    if args.out.exists() and args.log.exists() and args.out.samefile(args.log):
        raise ValueError(
            f"cannot write {args.out}: it is the log to be read; give OUT another name"
        )
    if args.wrench_axes == "body" and args.model is None:
        raise ValueError("--wrench-axes body needs --model, which says how the body is turned")
    options = Options(
        columns=_columns(args.column),
        joints=tuple(args.joints or ()),
        episode=args.episode,
        calibration=args.calibration,
        topic_joints=args.topic_joints,
        topic_base=args.topic_base,
        topic_imu=args.topic_imu,
        topic_wrenches=_once(args.topic_wrench, "--topic-wrench"),
        wrench_axes=WrenchAxes(args.wrench_axes),
        flip_wrenches=args.flip_wrenches,
        rename=_once(args.rename, "--rename"),
        degrees=args.degrees,
        time_unit=args.time_unit,
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
        found = _looked_at(log, robot)
        try:
            # Stamps in a wrong unit, or a log of no motion at all, are of no use in any form.
            found.only("rate").raise_for_errors()
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
    _show(args, log)
    return 0


def _looked_at(log: "Log", robot: "Robot | None") -> "Preflight":
    """What there is to say of a log; joints that the other commands hold are no fault of it."""
    from jax_inertia.model.joint_match import same_joints
    from jax_inertia.preflight.preflight import Preflight, preflight

    if robot is None:
        return preflight(log)
    robot, (log,), notes = same_joints(robot, [log])
    return Preflight((*preflight(log, robot).findings, *notes))


def _show(args: argparse.Namespace, log) -> None:
    """Print what was read, and what was assumed and done on the way."""
    import numpy as np
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    from jax_inertia.cli.console import one_line
    from jax_inertia.logs.log import TorqueUnit
    from jax_inertia.logs.schema import CHANNELS

    table = Table(title=escape(one_line(f"{args.log} → {args.out}")), title_justify="left")
    table.add_column("what")
    table.add_column("as written", overflow="fold")

    def line(what: str, text: str) -> None:
        table.add_row(what, escape(one_line(text)))

    line("time", f"{len(log.time)} samples, {log.duration:.4g} s at {log.rate:.4g} Hz")
    line("joints", f"{len(log.joint_names)}: {', '.join(log.joint_names)}")
    if log.contact_bodies:
        line("contacts", ", ".join(log.contact_bodies))
    units = {"qpos": "rad", "qpos_target": "rad", "qvel": "rad/s"}
    for name in CHANNELS:
        if (value := getattr(log, name)) is None:
            continue
        finite = np.asarray(value)[np.isfinite(np.asarray(value))]
        text = f"{finite.min():.4g} to {finite.max():.4g}" if finite.size else "nothing finite"
        if name == "tau":
            known = log.tau_unit is TorqueUnit.NEWTON_METRE
            text += f" {log.tau_unit_text}, {log.tau_kind}" + " (not N m)" * (not known)
        else:
            text += f" {units.get(name, '')}"
        line(name, text)
    for note in log.notes:
        line("note", note)
    # Piped, a table is as wide as it needs to be: who looks for a word finds it in one line.
    Console(width=None if sys.stdout.isatty() else _WIDEST).print(table)
    print(f"written to {args.out}")


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


def _said(text: str) -> str:
    if not text.strip():
        raise argparse.ArgumentTypeError("it is empty")
    return text


def _natural(text: str) -> int:
    if not text.isdecimal() or len(text) > 9:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from 0")
    return int(text)


def _columns(pairs: list[tuple[str, str]] | None) -> dict[str, str | list[str]]:
    """Columns by the contract's name; several of the file's for an array as a whole only."""
    given: dict[str, list[str]] = {}
    for name, column in pairs or ():
        given.setdefault(name, []).append(column)
        if len(given[name]) > 1 and ("." in name or "*" in name):
            raise ValueError(f"--column names {name} twice; it may have one")
    return {name: found[0] if len(found) == 1 else found for name, found in given.items()}


def _once(pairs: list[tuple[str, str]] | None, option: str) -> dict[str, str]:
    out = dict(pairs or ())
    if len(out) < len(pairs or ()):
        raise ValueError(f"{option} names {', '.join(out)}, one of them twice; each may have one")
    return out
