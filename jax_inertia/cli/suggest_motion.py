"""`jax-inertia suggest-motion`: the motion to record, so that a log says most of chosen bodies."""

import argparse
import json
import textwrap
from pathlib import Path

from jax_inertia.cli.conventions import add_model

_DESCRIPTION = """
Optimise the motion most informative about BODIES, within the joints' ranges, velocities and torques, free of
collisions of the model's geoms. Writes a CSV to play (time, qpos.JOINT, qvel.JOINT, qacc.JOINT, tau_command.JOINT: what
the model needs) and a figure next to it. The motion starts and ends at rest in one posture: go there slowly first.
"""
_EXAMPLES = """
examples:
  ten seconds that weigh whatever the hand carries, for a robot that is allowed 1 rad/s
    jax-inertia suggest-motion arm.xml --bodies hand --velocity 1 --out motion.csv

  a table in front of the robot, and room for a load: less range at two joints, two thirds of the torque
    jax-inertia suggest-motion arm.xml --bodies hand --range joint2 -0.5 0.8 --range joint4 0.3 1.9 --share 0.66
"""


def add_parser(subparsers) -> None:
    """Add `suggest-motion` to the command line."""
    parser = subparsers.add_parser(
        "suggest-motion",
        help="the motion to record for chosen bodies",
        description=textwrap.dedent(_DESCRIPTION),
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add_model(add, "MJCF or URDF", name="MODEL")
    add("--bodies", nargs="+", required=True, metavar="B", help="bodies to estimate, by name")
    add("--out", type=Path, default=Path("motion.csv"), metavar="CSV", help="default: motion.csv")
    velocity_help = "largest speed, one for all joints or one each [rad/s, m/s] (default 1.5)"
    add("--velocity", nargs="+", type=float, default=[1.5], metavar="V", help=velocity_help)
    range_help = "range of a joint (default: the model's, or 1 rad to each side of its reference)"
    add(
        "--range",
        nargs=3,
        action="append",
        default=[],
        metavar=("JOINT", "LOW", "HIGH"),
        help=range_help,
    )
    share_help = (
        "share of ranges and torques to use (default 0.9; a smaller one leaves room for a load)"
    )
    add("--share", type=float, default=0.9, metavar="S", help=share_help)
    add("--period", type=float, default=10.0, metavar="S", help="length (default 10 s)")
    add("--rate", type=float, default=100.0, metavar="HZ", help="samples a second (default 100)")
    mass_help = "expected load (default: a tenth of the robot's mass)"
    add("--prior-mass", type=float, metavar="KG", help=mass_help)
    add("--seed", type=int, default=0, metavar="N", help="other starts (default 0)")
    add("--json", action="store_true", help="print numbers for scripts instead of the table")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Do it; raises ValueError with one line where model or settings cannot be used."""
    import mujoco
    import numpy as np

    from jax_inertia.cli.console import output_folder
    from jax_inertia.cli.running.stages import stages
    from jax_inertia.estimation.priors import Load
    from jax_inertia.estimation.suggest.excitation import suggest_motion
    from jax_inertia.estimation.suggest.motion_limits import Limits, collision_free
    from jax_inertia.logs.plain_file import require_replaceable
    from jax_inertia.model.load import compile_spec, load_model, load_spec

    if args.out.suffix.lower() != ".csv":
        raise ValueError(f"--out {args.out}: a motion is written as .csv")
    require_replaceable(args.out)
    for name in ("period", "rate", "share", "prior_mass"):
        value = getattr(args, name)
        if value is not None and not 0 < value < float("inf"):
            raise ValueError(f"--{name.replace('_', '-')} is {value:g}; it must be above 0")
    if args.share > 1:
        raise ValueError(f"--share is {args.share:g}; it is a share of the limits, at most 1")
    with stages() as stage:
        robot = load_model(args.model)
        model: mujoco.MjModel = compile_spec(load_spec(args.model), args.model)
        if len(args.velocity) not in (1, robot.nv):
            raise ValueError(
                f"{len(args.velocity)} values of --velocity for {robot.nv} joints; one for all, or one each"
            )
        if robot.nv != len(robot.joint_names):
            raise ValueError(
                f"{args.model} has a floating base or a ball joint; give a model of the arm alone, fixed to the world"
            )
        speed = np.broadcast_to(np.asarray(args.velocity, float), (robot.nv,))
        limits = _with_ranges(Limits.of(model, velocity=speed, share=args.share), robot, args.range)
        prior = None if args.prior_mass is None else Load(args.prior_mass)
        with output_folder(args.out.parent, args.out.name) as folder:
            found = suggest_motion(
                robot,
                args.bodies,
                limits,
                prior=prior,
                period=args.period,
                rate=args.rate,
                clear=collision_free(model),
                seed=args.seed,
                progress=stage,
            )
            stage("writing")
            _write(folder / args.out.name, found)
            from jax_inertia.cli.plots import suggestion_figure

            figure = suggestion_figure(found, limits)
            figure.savefig((folder / args.out.name).with_suffix(".png"), dpi=110)
    if args.json:
        print(json.dumps(_numbers(found), indent=1))
    else:
        _show(found, args.out)
    return 0


def _with_ranges(limits, robot, ranges: list[list[str]]):
    """The limits with ranges that were given by name."""
    import equinox as eqx

    low, high = limits.low.copy(), limits.high.copy()
    for name, *values in ranges:
        index = robot.joint_index(name)
        try:
            low[index], high[index] = (float(x) for x in values)
        except ValueError:
            raise ValueError(f"--range {name} {' '.join(values)}: two numbers are needed") from None
    return eqx.tree_at(lambda x: (x.low, x.high), limits, (low, high))


def _write(path: Path, found) -> None:
    import numpy as np

    channels = {
        "qpos": found.q,
        "qvel": found.v,
        "qacc": found.a,
        "tau_command": found.tau,
    }
    header = ["time"] + [f"{key}.{name}" for key in channels for name in found.joint_names]
    table = np.column_stack([found.time, *channels.values()])
    np.savetxt(path, table, fmt="%.9g", delimiter=",", header=",".join(header), comments="")


def _numbers(found) -> dict:
    from jax_inertia.maths.inertial_parameters import PI_NAMES

    def by_name(values) -> dict:
        return {
            f"{body}.{name}": float(x)
            for body, row in zip(found.known.bodies, values, strict=True)
            for name, x in zip(PI_NAMES, row, strict=True)
        }

    return {
        "schema": 1,
        "nats": {"suggested": found.log_det, "random": found.random.log_det},
        "sigma": {
            "prior": by_name(found.known.prior_sigma),
            "random": by_name(found.random.sigma),
            "suggested": by_name(found.known.sigma),
        },
        "determined": [c.text for c in found.known.combinations],
        "start": dict(zip(found.joint_names, found.q[0].tolist(), strict=True)),
    }


def _show(found, out: Path) -> None:
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    console, numbers = Console(), _numbers(found)
    console.print(
        "Standard deviation that a log of it leaves, in kg, kg m and kg m² (random: of a random motion as large as the "
        "same limits allow)",
        soft_wrap=True,
    )
    table = Table()
    for column in ("", *numbers["sigma"]):
        table.add_column(column, justify="left" if not column else "right")
    for name in numbers["sigma"]["prior"]:
        table.add_row(
            escape(name), *(f"{column[name]:.2g}" for column in numbers["sigma"].values())
        )
    console.print(table)
    sums = [c.text for c in found.known.combinations if " " in c.text]
    if sums:
        console.print(escape("Only in sums: " + "; ".join(sums)))
    start = ", ".join(f"{name} {q:.3f}" for name, q in numbers["start"].items())
    console.print(
        f"Go to the start slowly first [rad, m]: {start}",
        soft_wrap=True,
        highlight=False,
        markup=False,
    )
    console.print(f"Written: {escape(str(out))}, {out.with_suffix('.png').name}", soft_wrap=True)
