"""`jax-inertia estimate --wrench`: what a wrist's force/torque sensor carries, without joint torques."""

import argparse
import dataclasses
import json
from collections.abc import Callable, Iterator
from pathlib import Path

# Options of `estimate` that mean something here; others with a value of their own are refused.
_USED = ("wrench", "wrench_axes", "flip_wrenches", "prior_mass", "prior_reach", "cutoff", "rate")
_USED += (
    "log",
    "model",
    "out",
    "json",
    "time_unit",
    "fix",
    "joints",
    "mount",
    "run",
    "command",
    "no_cache",
)


def add_wrench(add: Callable[..., object]) -> None:
    """Add the options to `estimate`, by its parser's `add_argument`."""
    wrench_help = (
        "weigh what the force/torque sensor at this body's frame carries, by the log's contact_wrench of it, or by "
        "this topic (geometry_msgs/WrenchStamped) of a bag; joint torques are not needed, nor --bodies"
    )
    add("--wrench", type=_sensor, metavar="BODY[=TOPIC]", help=wrench_help)
    axes_help = "axes of the wrench (default: of a topic the body's own, of columns the world's)"
    add("--wrench-axes", choices=("world", "body"), help=axes_help)
    flip_help = "the wrench is the robot's on what it carries, not the opposite"
    add("--flip-wrenches", action="store_true", help=flip_help)


def run(args: argparse.Namespace, parser: argparse.ArgumentParser) -> int:
    """Do it; raises ValueError with one line where log, model or settings cannot be used."""
    from jax_inertia.cli.console import folder_for, output_folder
    from jax_inertia.cli.running.stages import stages
    from jax_inertia.estimation.wrist_sensor import sensed_load

    for name, value in vars(args).items():
        if name not in _USED and value != parser.get_default(name):
            option = f"--{name.replace('_', '-')}"
            raise ValueError(f"{option} does not go with --wrench, which uses no joint torques")
    out = args.out if args.out is not None else folder_for(args.log) / "estimate"
    asked = {name: getattr(args, name) for name in ("prior_mass", "prior_reach", "cutoff", "rate")}
    with stages() as stage:
        stage("reading")
        robot, log, told = _read(args)
        stage("weighing")
        with output_folder(out, "wrench") as folder:
            found = sensed_load(robot, log, args.wrench[0], **asked)
            notes = (*told, *found.notes)
            report = {
                "schema": 1,
                "log": str(args.log),
                "model": str(args.model),
                "settings": asked,
            }
            report |= dataclasses.replace(found, notes=notes).to_report()
            text = json.dumps(report, indent=1, allow_nan=False)
            (folder / "wrench.json").write_text(text + "\n", encoding="utf-8")
    if args.json:
        print(text)
    else:
        _show(found, notes, out)
    return 0


def _read(args: argparse.Namespace):
    """Robot and log as the options say, the wrench in the world's axes, and what is to be said of them."""
    from jax_inertia.cli.conventions import met
    from jax_inertia.logs.log import LogError
    from jax_inertia.logs.log_files import read_log
    from jax_inertia.logs.readers import Options, WrenchAxes
    from jax_inertia.model.load import load_model
    from jax_inertia.preflight.preflight import preflight
    from jax_inertia.signals.wrench_axes import wrenches_in_world

    body, topic = args.wrench
    robot = load_model(args.model)
    robot.body_index(body)
    axes = WrenchAxes(args.wrench_axes or ("body" if topic else "world"))
    options = Options(time_unit=args.time_unit)
    if topic:
        options = dataclasses.replace(options, topic_wrenches={body: topic}, wrench_axes=axes)
    log = read_log(args.log, names=robot, options=options)
    # Torques, if there are any, are another question.
    log = dataclasses.replace(log, tau=None, sigma_tau=None)
    robot, (log,), findings = met(args, robot, (log,), gains=None)
    found = preflight(log, robot)
    try:
        found.raise_for_errors()
        if args.flip_wrenches and log.contact_wrench is not None:
            log = dataclasses.replace(log, contact_wrench=-log.contact_wrench)
        if axes is WrenchAxes.BODY:
            log = wrenches_in_world(log, robot)
    except LogError as error:
        raise LogError(f"{args.log}: {error}") from None
    return robot, log, tuple(f.message for f in (*found.findings, *findings))


def _show(found, notes: tuple[str, ...], out: Path) -> None:
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    table = Table(title=escape(f"carried at {found.body}, ± 95 %"), title_justify="left")
    table.add_column("")
    table.add_column("", justify="left")
    for label, text in _lines(found):
        table.add_row(escape(label), text)
    console = Console()
    console.print(table)
    if found.modelled > 0:
        load = found.pi[0] - found.modelled
        console.print(
            f"The model has {found.modelled:.3f} kg from {escape(found.body)} outward: {load:+.3f} kg on top"
        )
    for note in notes:
        console.print(f"Note: {escape(note)}.", soft_wrap=True)
    console.print(f"Written to {escape(str(out))}/: wrench.json", soft_wrap=True)


def _lines(found) -> Iterator[tuple[str, str]]:
    from jax_inertia.estimation.wrist_sensor import AXES, Z95

    yield "mass [kg]", f"{found.pi[0]:.3f} ± {Z95 * found.sigma_pi[0]:.3f}"
    for axis, c, s in zip("xyz", found.com, found.sigma_com, strict=True):
        yield f"centre of mass, {axis} [mm]", f"{1e3 * c:.1f} ± {1e3 * Z95 * s:.2g}"
    for k, axis in enumerate(AXES):
        drift, spread = 60.0 * found.drift[k], 60.0 * Z95 * found.sigma_drift[k]
        text = f"{found.offset[k]:.3g} ± {Z95 * found.sigma_offset[k]:.2g}"
        yield (
            f"offset of {axis} [{'N' if k < 3 else 'N m'}]",
            f"{text}, drift {drift:.2g} ± {spread:.1g} a minute",
        )


def _sensor(text: str) -> tuple[str, str]:
    body, equals, topic = text.partition("=")
    if not body.strip() or (equals and not topic.strip()):
        raise argparse.ArgumentTypeError(f"{text!r} is not of the form BODY or BODY=TOPIC")
    return body, topic
