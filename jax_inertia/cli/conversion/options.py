"""Options of `jax-inertia convert` on what a file does not say itself, and what readers take of them."""

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from jax_inertia.cli.conventions import add_model, add_time_unit

if TYPE_CHECKING:
    from jax_inertia.logs.readers import Options


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options, those of any file first."""
    _add_any(parser.add_argument)
    _add_positions(parser.add_argument_group("positions and targets").add_argument)
    _add_tables(parser.add_argument_group("CSV, Parquet, HDF5, .mat, LeRobot").add_argument)
    _add_bags(parser.add_argument_group("ROS bags and MCAP").add_argument)


def _add_any(add: Callable[..., object]) -> None:
    """Add what holds for a log of any kind."""
    kinds = ".csv, .parquet, .hdf5, .mat, .bag, .mcap, .db3, .npz, or the folder of a ROS 2 bag or LeRobot dataset"
    add("log", metavar="IN", type=Path, help=kinds)
    add("out", metavar="OUT", type=Path, help=".npz, .csv or .parquet")
    add_model(add, "MJCF or URDF to check joints, bodies and units against", required=False)
    add("--tau-unit", type=_said, metavar="U", help="unit of the torques: N m, A, mA, PWM ...")
    add("--tau-kind", choices=("commanded", "current", "sensor"), help="where they come from")
    add_time_unit(add)
    add(
        "--rename",
        type=_pair,
        action="append",
        metavar="FILE=MODEL",
        help="a joint by the file's name and by the model's; one * in both stands for what all share",
    )
    add("--json", action="store_true", help="print what was written as JSON")


def _add_positions(add: Callable[..., object]) -> None:
    """Add the units and zeros of positions, and what targets mean."""
    add("--degrees", action="store_true", help="positions and velocities are in degrees")
    scale_help = "rad (m) of one of the file's units of position, of all joints or of one; velocities scale along"
    add(
        "--position-scale",
        type=_scale_of_joints,
        nargs="+",
        default=[],
        metavar="[J=]S",
        help=scale_help,
    )
    zero_help = "the file's position at zero, of all joints or of one"
    add("--position-zero", type=_of_joints, nargs="+", default=[], metavar="[J=]X", help=zero_help)
    of_targets = (
        "of all joints or of one, with which target = offset + scale · value (a policy's actions)"
    )
    scale = {"type": _scale_of_joints, "nargs": "+", "default": [], "metavar": "[J=]S"}
    add(
        "--target-scale",
        **scale,
        help=f"rad (m) of one of the file's units of target, {of_targets}",
    )
    offset = {"type": _of_joints, "nargs": "+", "default": [], "metavar": "[J=]X"}
    add(
        "--target-offset",
        **offset,
        help="rad (m) that are added to targets, of all joints or of one",
    )
    relative_help = "targets are differences from the position at their moment"
    add("--relative-targets", action="store_true", help=relative_help)


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
    add(
        "--joints",
        nargs="+",
        metavar="J",
        help="joints of columns that hold lists and of arrays of targets, in order",
    )
    add("--rate", type=float, metavar="HZ", help="samples a second of a table without stamps")
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
    targets_help = (
        "position targets: JointState, JointTrajectoryControllerState, JointTrajectory, Float64MultiArray "
        "(default: the only topic of commands that is of the joints; --joints names those of an array)"
    )
    add("--topic-targets", metavar="T", help=targets_help)
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


def stated(args: argparse.Namespace) -> "Options":
    """How the log is to be read, as the options say; ValueError where they contradict each other."""
    from jax_inertia.logs.readers import Options, WrenchAxes

    return Options(
        columns=_columns(args.column),
        joints=tuple(args.joints or ()),
        rate=args.rate,
        episode=args.episode,
        calibration=args.calibration,
        topic_joints=args.topic_joints,
        topic_targets=args.topic_targets,
        topic_base=args.topic_base,
        topic_imu=args.topic_imu,
        topic_wrenches=_once(args.topic_wrench, "--topic-wrench"),
        wrench_axes=WrenchAxes(args.wrench_axes),
        flip_wrenches=args.flip_wrenches,
        rename=_once(args.rename, "--rename"),
        degrees=args.degrees,
        position_scale=dict(args.position_scale),
        position_zero=dict(args.position_zero),
        target_scale=dict(args.target_scale),
        target_offset=dict(args.target_offset),
        relative_targets=args.relative_targets,
        time_unit=args.time_unit,
        tau_unit=args.tau_unit,
        tau_kind=args.tau_kind,
    )


def _pair(text: str) -> tuple[str, str]:
    name, sep, value = text.partition("=")
    if not (sep and name and value):
        raise argparse.ArgumentTypeError(f"{text!r} is no pair NAME=VALUE")
    return name, value


def _of_joints(text: str) -> tuple[str, float]:
    """A joint ("": all) and its number."""
    name, _, value = text.rpartition("=")
    try:
        number = float(value)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{value!r} is no number") from None
    if not abs(number) < 1e12:
        raise argparse.ArgumentTypeError(f"{value} is no number that can be used")
    return name, number


def _scale_of_joints(text: str) -> tuple[str, float]:
    name, number = _of_joints(text)
    if not number:
        raise argparse.ArgumentTypeError("a scale of 0 leaves nothing of the positions")
    return name, number


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
