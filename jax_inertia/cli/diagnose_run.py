"""What `jax-inertia diagnose` computes, writes and prints."""

import argparse
import dataclasses
import functools
from collections.abc import Callable, Sequence
from pathlib import Path

from threadpoolctl import threadpool_limits

from jax_inertia.cli import diagnose_output as output
from jax_inertia.cli import replay_run
from jax_inertia.cli.console import warn
from jax_inertia.cli.conventions import met
from jax_inertia.cli.replay_run import SILENT, Gains
from jax_inertia.diagnosis import entry as diagnosis
from jax_inertia.diagnosis import pipeline
from jax_inertia.diagnosis.effects.registry import NAMES as BY_TORQUE
from jax_inertia.diagnosis.result import Diagnosis
from jax_inertia.logs.log import Log, LogError
from jax_inertia.logs.log_files import read_log
from jax_inertia.logs.readers import Options
from jax_inertia.model.load import (
    compile_spec,
    load_model,
)
from jax_inertia.model.log_match import afloat
from jax_inertia.model.mujoco_types import MjModel
from jax_inertia.model.robot import Robot
from jax_inertia.preflight.preflight import Finding as Quality
from jax_inertia.preflight.preflight import Severity
from jax_inertia.replay import entry
from jax_inertia.replay.loop import one_each
from jax_inertia.replay.output import recording

_NOT_REPLAYED = (
    "--export needs a log of targets (qpos_target), by whose replay a position loop is known: nothing is exported; "
    "train with corrected.xml"
)


@dataclasses.dataclass(frozen=True)
class Inputs:
    """What was read, and found sound."""

    model: Path
    path: Path
    robot: Robot
    log: Log
    test_log: Log | None
    quality: tuple[Quality, ...]
    more: tuple[Log, ...] = ()
    validation_log: Log | None = None
    """By which effects are chosen; none where that is by stretches of the log."""
    of_loop: bool = False
    """Whether torques are not of the log, but what a position loop gives."""
    replayed: bool = False
    """Whether targets are replayed."""
    drives: diagnosis.Drives | None = None
    """How the log's torques were read."""
    uncertainty: tuple[float, float, float] | None = None
    """Standard deviations of the model's masses (relative), centres [m] and inertias (relative), where stated."""


def read(
    model: Path,
    log: Path,
    test_log: Path | None,
    exclude: Sequence[str],
    conventions: argparse.Namespace | None = None,
    gains: Gains = SILENT,
    more: Sequence[Path] = (),
    validation: Path | None = None,
) -> Inputs:
    """Read model and logs, and look at them before anything is computed; ValueError with one line.

    `conventions` are the options of `cli.conventions`, `gains` those of a position loop. `more` logs are fitted with
    the first, where targets are replayed; by the `validation` log effects are chosen.
    """
    if unknown := entry.unknown_families(exclude):
        raise ValueError(
            f"--exclude {' '.join(unknown)}: no such family; valid: {', '.join(entry.FAMILIES)}"
        )
    held = gains.fix_base

    @functools.cache
    def compiled() -> MjModel:
        return compile_spec(entry.nominal_spec(model, held), model)

    robot = load_model(compiled() if held else model)
    paths = (log, *more, *(path for path in (validation, test_log) if path is not None))
    options = Options(time_unit=None if conventions is None else conventions.time_unit)
    given = [read_log(path, names=robot, options=options) for path in paths]
    robot, told = afloat(robot, model, given[0])
    of_loop = given[0].tau is None and robot.has_free_base
    given = [entry.of_loop(one, robot, model, gains.kp, gains.kd) for one in given]
    quality: list[Quality] = [*told]
    if conventions is not None:
        robot, given, notes = met(conventions, robot, given, gains=conventions.gains)
        quality += notes
    logs, drives, found = looked_at(paths, given, robot, compiled, gains)
    quality += found
    for finding in quality:
        if finding.severity is Severity.WARNING:
            warn(finding.message)
    for name, values in (("--kp", gains.kp), ("--kd", gains.kd)):
        one_each(name, values, len(logs[0].joint_names))
    own = given if test_log is None else given[:-1]
    replayed = logs[0].tau is None or (
        not of_loop and entry.replayable(model, own, gains.kp, gains.kd, held)
    )
    if more and not replayed:
        raise ValueError(
            f"--more-logs is for logs of targets that are replayed, and {log.name} is diagnosed by its torque: leave "
            "it out"
        )
    last = len(more) + 1
    test = logs[-1] if test_log is not None else None
    checking = logs[last] if validation is not None else None
    more_logs = tuple(logs[1:last])
    return Inputs(
        model, log, robot, logs[0], test, tuple(quality), more_logs, checking, of_loop, replayed,
        drives,
    )  # fmt: skip


def looked_at(
    paths: Sequence[Path],
    given: Sequence[Log],
    robot: Robot,
    model: Callable[[], MjModel],
    gains: Gains,
) -> tuple[list[Log], diagnosis.Drives | None, list[Quality]]:
    """Logs as they are used, how torques were read, and what there is to say; LogError where one cannot be used."""
    logs: list[Log] = []
    quality: list[Quality] = []
    drives = None
    for path, one in zip(paths, given, strict=True):
        try:
            if one.tau is None and (not logs or logs[0].tau is None):
                loop = entry.known_loop(one, model(), gains.kp, gains.kd)
                one, findings = entry.usable(one, robot, loop)
            else:
                one, drives, findings = diagnosis.usable(one, robot, drives, path.name)
        except LogError as error:
            raise LogError(f"{path}: {error}") from None
        logs.append(one)
        quality += [f._replace(message=f"{path.name}: {f.message}") for f in findings]
    return logs, drives, quality


def diagnosed(
    folder: Path,
    inputs: Inputs,
    exclude: Sequence[str],
    max_effects: int | None,
    stage: Callable[[str], None],
    gains: Gains = SILENT,
    exports: Sequence[str] = (),
    record: bool = False,
) -> Callable[..., None]:
    """Diagnose, and write everything into a folder; what prints it, given where it is and `as_json`.

    With `record` diagnosis.mcap, too.

    By replays of the targets where the loop is known, torque or none; else by torque, and the loop on its own.
    """
    if inputs.replayed:
        paths, logs = (inputs.path, inputs.model), (inputs.log, *inputs.more)
        loop = {"kp": gains.kp, "kd": gains.kd, "fix_base": gains.fix_base}
        found = entry.by_replays(
            inputs.model, logs, inputs.test_log, exclude,
            validation_log=inputs.validation_log, home=folder.parent, progress=stage, **loop,
        )  # fmt: skip
        if not entry.left_to_torque(found, logs):
            stage("writing")
            if record:
                lines = recording.by_replays(found, inputs.log.joint_names)
                recording.write(folder / recording.NAME, lines)
            return replay_run.written(folder, paths, found, inputs.log, inputs.quality, exports)
        if exports:
            warn(_NOT_REPLAYED)
        exclude = [x for x in exclude if x in BY_TORQUE]
    told = by_torque(folder, inputs, exclude, max_effects, stage)
    if record:
        recording.write(folder / recording.NAME, recording.by_torque(told[0]))
    show_it = functools.partial(output.show, *told)
    if inputs.of_loop:
        return show_it
    return replay_run.add_command(folder, inputs.model, inputs.log, gains, show_it)


# As the diagnosis itself: rollouts and figures wait for spinning threads too.
@threadpool_limits.wrap(limits=1, user_api="blas")
def by_torque(
    folder: Path,
    inputs: Inputs,
    exclude: Sequence[str],
    max_effects: int | None,
    stage: Callable[[str], None],
) -> tuple[Diagnosis, dict]:
    """Diagnose torque → motion, and write everything into a folder; what was found, and the report."""
    found = pipeline.diagnose(
        inputs.robot,
        inputs.log,
        validation_log=inputs.validation_log,
        test_log=inputs.test_log,
        nominal=output.nominal_of(inputs.model, inputs.robot),
        exclude=exclude,
        settings=diagnosis.stated(max_effects, inputs.uncertainty),
        progress=stage,
    )
    found = diagnosis.with_drives(found, inputs.drives, inputs.log)
    stage("rolling models out in MuJoCo")
    paths = inputs.path, inputs.model
    return found, output.write(folder, found, inputs.robot, inputs.log, paths, inputs.quality)
