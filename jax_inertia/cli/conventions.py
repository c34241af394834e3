"""Options that several commands have: where a log means something else than its model, and gains of a position loop."""

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from jax_inertia.logs.findings import Finding
    from jax_inertia.logs.log import Log
    from jax_inertia.model.robot import Robot


def add_conventions(parser: argparse.ArgumentParser, *, gains: bool = False) -> None:
    """Add the options to a command that takes a log and a model; `gains` where it has no such option of its own."""
    add = parser.add_argument_group("if the log means something else than the model").add_argument
    add_time_unit(add)
    unit_help = (
        "unit of the log's torques, whatever the file says: N m, A, mA, PWM, or a word of your own"
    )
    add("--tau-unit", type=_unit, metavar="U", help=unit_help)
    if gains:
        gains_help = "N m per logged unit, one for each joint of the log, or one for all (default: from the log itself)"
        add("--gains", nargs="+", type=float, metavar="G", help=gains_help)
    add(
        "--gravity-compensated",
        action="store_true",
        help="the controller subtracted gravity from the log's torque: add the model's gravity",
    )
    mount_help = (
        "how the base is mounted, turned about x, y (and z) of an upright world [degrees], or a quaternion W,X,Y,Z; "
        "with a minus first: --mount=-90,0"
    )
    add("--mount", type=_mount, metavar="RX,RY[,RZ]", help=mount_help)
    shift_help = "shift the log's torque by S seconds to later times (negative: earlier)"
    add("--shift-torque", type=_seconds, metavar="S", help=shift_help)
    fix_help = "hold a joint of the model, where the log lacks it, at this position [rad, m]"
    add("--fix", nargs="+", action="extend", type=_fixed, metavar="JOINT=VALUE", help=fix_help)
    joints_help = "joints of the log to use; the others must stand still, and are held there"
    add("--joints", nargs="+", metavar="J", help=joints_help)


def add_model(
    add: Callable[..., object], what: str, *, name: str = "--model", required: bool = True
) -> None:
    """Add the model and where it may include files from, by a parser's `add_argument`."""
    if name.startswith("-"):
        add(name, type=Path, required=required, help=what)
    else:
        add(name.lower(), type=Path, metavar=name, help=what)
    root_help = "folder below which the model may include files (default: the model's own)"
    add("--include-root", type=Path, metavar="DIR", help=root_help)


def add_time_unit(add: Callable[..., object]) -> None:
    """Add --time-unit to a parser, by its `add_argument`: an option of every command that reads a log."""
    help_text = "unit of the log's time stamps (default: s, or another unit if it is obvious)"
    add("--time-unit", choices=("s", "ms", "us", "ns"), help=help_text)


def add_prior_mass(add: Callable[..., object]) -> None:
    """Add --prior-mass to a parser, by its `add_argument`: an option of every command that estimates loads."""
    help_text = "expected load (default: a tenth of the robot's mass)"
    add("--prior-mass", type=positive, metavar="KG", help=help_text)


def add_gains(add: Callable) -> None:
    """Add --kp, --kd and --fix-base to a parser, by its `add_argument`."""
    kp_help = "gain of the position loop, one for all joints or one each [N m/rad]"
    add("--kp", nargs="+", type=float, metavar="KP", help=kp_help)
    add("--kd", nargs="+", type=float, metavar="KD", help="damping of the loop [N m s/rad]")
    fix_help = "the robot hangs: remove the free joint and the contacts from the model"
    add("--fix-base", action="store_true", help=fix_help)


def number(text: str) -> float:
    """An option's value as a number, infinite ones included; argparse says in one line what is none."""
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is no number") from None


def positive(text: str) -> float:
    """An option's value as a finite number above zero."""
    value = number(text)
    if not 0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"{text} is not a positive number")
    return value


def met(
    args: argparse.Namespace,
    robot: "Robot",
    logs: "Sequence[Log]",
    *,
    gains: Sequence[float] | None,
) -> "tuple[Robot, tuple[Log, ...], tuple[Finding, ...]]":
    """Robot and logs as the options say, and a note of what was done; ValueError where that cannot be.

    `gains` are applied to the logs' torques; None leaves these in their unit.
    """
    import dataclasses

    from jax_inertia.logs.log import TorqueUnit
    from jax_inertia.model.joint_match import same_joints
    from jax_inertia.signals.corrections import mounted, with_later_torque, with_model_gravity

    if args.tau_unit is not None:
        unit, text = TorqueUnit.parse(args.tau_unit), args.tau_unit
        logs = [dataclasses.replace(one, tau_unit=unit, tau_unit_text=text) for one in logs]
    fix = dict(args.fix or ())
    robot, logs, findings = same_joints(robot, logs, fix=fix, joints=args.joints)
    if args.mount is not None:
        robot = mounted(robot, args.mount)
    out = []
    for log in logs:
        if gains is not None:
            if log.tau_unit is TorqueUnit.NEWTON_METRE:
                raise ValueError(
                    "tau is in N m; --gains is for other units: say which with --tau-unit (motor, A, ...)"
                )
            log = log.with_torque_gains(gains[0] if len(gains) == 1 else gains)
        if args.shift_torque is not None:
            log = with_later_torque(log, args.shift_torque)
        out.append(with_model_gravity(log, robot) if args.gravity_compensated else log)
    return robot, tuple(out), findings


def _unit(text: str) -> str:
    if not text.strip() or not text.isprintable() or len(text) > 60:
        raise argparse.ArgumentTypeError(f"{text[:60]!r} is no unit; N m, A, mA, PWM, or a word")
    return text.strip()


def _number(text: str) -> float:
    value = number(text)
    if not abs(value) < 1e6:
        raise argparse.ArgumentTypeError(f"{text} is no number that can be used")
    return value


def _seconds(text: str) -> float:
    value = _number(text)
    if abs(value) > 1:
        raise argparse.ArgumentTypeError(f"{text} s is too much; at most 1 s")
    return value


def _mount(text: str) -> tuple[float, ...]:
    values = tuple(_number(part) for part in text.split(","))
    if len(values) not in (2, 3, 4):
        raise argparse.ArgumentTypeError(
            f"{text!r} are {len(values)} numbers; give RX,RY or RX,RY,RZ in degrees, or a quaternion W,X,Y,Z"
        )
    if len(values) == 4 and not 0.9 < sum(x * x for x in values) ** 0.5 < 1.1:
        raise argparse.ArgumentTypeError(f"the quaternion {text!r} has not the length 1")
    return values


def _fixed(text: str) -> tuple[str, float]:
    name, equals, value = text.rpartition("=")
    if not equals or not name:
        raise argparse.ArgumentTypeError(f"{text!r} is not of the form JOINT=VALUE")
    return name, _number(value)
