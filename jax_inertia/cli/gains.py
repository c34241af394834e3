"""Options of a position loop, which two commands have; nothing heavy is imported for `--help`."""

from collections.abc import Callable


def add_gains(add: Callable) -> None:
    """Add --kp, --kd and --fix-base to a parser, by its `add_argument`."""
    kp_help = "gain of the position loop, one for all joints or one each [N m/rad]"
    add("--kp", nargs="+", type=float, metavar="KP", help=kp_help)
    add("--kd", nargs="+", type=float, metavar="KD", help="damping of the loop [N m s/rad]")
    fix_help = "the robot hangs: take the free joint out of the model, and contacts"
    add("--fix-base", action="store_true", help=fix_help)
