"""`jax-inertia convert`: a log of any kind into the form that the other commands read fastest."""

import argparse
import json
import sys
import textwrap
from pathlib import Path
from typing import TYPE_CHECKING

from jax_inertia.cli.conversion.options import add_options, stated

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
    add_options(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Do it; raises ValueError with one line where the log or the model cannot be used."""
    from jax_inertia.cli.console import warn
    from jax_inertia.cli.running.stages import stages
    from jax_inertia.logs.log import LogError
    from jax_inertia.logs.log_files import read_log, write_log
    from jax_inertia.model.load import load_model
    from jax_inertia.model.log_match import afloat
    from jax_inertia.preflight.mended import mended
    from jax_inertia.preflight.preflight import Preflight, Severity
    from jax_inertia.signals.wrench_axes import wrenches_in_world

    _require_another(args.out, args.log)
    if args.wrench_axes == "body" and args.model is None:
        raise ValueError("--wrench-axes body needs --model, which says how the body is turned")
    options = stated(args)
    with stages() as stage:
        stage("reading the model")
        robot = None if args.model is None else load_model(args.model)
        stage("reading the log")
        log = read_log(args.log, options=options, names=robot)
        if robot is not None and args.model is not None:
            robot, _ = afloat(robot, args.model, log)
        stage("looking at the log")
        log, left_out = (log, ()) if robot is None else mended(log, kinds=robot.joint_kinds)
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
    found = Preflight((*left_out, *found.findings))
    for finding in (*found.of(Severity.ERROR), *found.of(Severity.WARNING)):
        warn(f"{args.log}: {finding.message}")
    if args.json:
        print(json.dumps(_summary(args.out, log, found), indent=1, allow_nan=False))
        return 0
    _show(args, log)
    return 0


def _require_another(out: Path, log: Path) -> None:
    """ValueError where `out` cannot be written, or is the log itself."""
    from jax_inertia.logs.atomic_files import check_target

    check_target(out)
    if out.exists() and log.exists() and out.samefile(log):
        raise ValueError(f"cannot write {out}: it is the log to be read; give OUT another name")


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
