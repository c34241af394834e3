"""`jax-inertia replay`: a log's targets through a model, and how far the model parts from the robot."""

import argparse
import textwrap
from pathlib import Path

_DESCRIPTION = """
Replay LOG's position targets through MODEL in MuJoCo, closed loop, over the whole motion: the error
of every joint in rad, as a table, replay.json and a figure (replay.png). Nothing is fitted. MODEL's position actuators
are the loop; if it has none, kp and kd come from LOG or from the options.
"""
_EXAMPLES = """
examples:
  how far is this simulation from the robot?
    jax-inertia replay log.npz --model arm.xml

  a model with motors, and the gains that the policy was trained with
    jax-inertia replay log.npz --model leg.xml --kp 35 --kd 0.8

  the same motion with what a diagnosis found
    jax-inertia diagnose log.npz --model arm.xml && jax-inertia replay other.npz --model out/log/corrected.xml
"""


def add_parser(subparsers) -> None:
    """Add `replay` to the command line."""
    from jax_inertia.cli.conventions import add_gains, add_model, add_time_unit

    parser = subparsers.add_parser(
        "replay",
        help="replay a log's targets through a model, closed loop",
        description=textwrap.dedent(_DESCRIPTION),
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    kinds = ".npz, .csv, .parquet or a LeRobot dataset, with qpos and qpos_target"
    add("log", metavar="LOG", type=Path, help=kinds)
    add_model(add, "MJCF or URDF")
    add_time_unit(add)
    add_gains(add)
    add("--out", type=Path, metavar="DIR", help="where to write (default: out/<name of LOG>)")
    add("--json", action="store_true", help="print replay.json instead of the table")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Do it; raises ValueError with one line where log or model cannot be used."""
    import json

    from jax_inertia.cli import replay_run
    from jax_inertia.cli.console import folder_for, output_folder
    from jax_inertia.cli.running.stages import stages

    out = args.out if args.out is not None else folder_for(args.log)
    gains = replay_run.Gains(args.kp, args.kd, args.fix_base)
    with stages() as stage:
        stage("reading")
        log, _ = replay_run.read(args.model, args.log, gains, args.time_unit)
        with output_folder(out, "replay") as folder:
            stage("replaying")
            loop, done = replay_run.replay(args.model, log, gains)
            report = replay_run.write_replay(folder, log, loop, done)
    if args.json:
        print(json.dumps(report, indent=1))
    else:
        replay_run.show_replay(report, out)
    return 0
