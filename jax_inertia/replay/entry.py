"""One call that diagnoses a log by closed-loop replays of its targets, or by its torques where no loop is known."""

import dataclasses
import functools
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jax_inertia.diagnosis import entry as by_torque
from jax_inertia.diagnosis.effects.registry import NAMES
from jax_inertia.diagnosis.report import json_report
from jax_inertia.diagnosis.result import Diagnosis as ByTorque
from jax_inertia.diagnosis.result import Verdict
from jax_inertia.estimation import log_estimate
from jax_inertia.estimation.log_estimate import LogEstimate
from jax_inertia.logs.log import Log, LogError
from jax_inertia.model.load import compile_spec, load_model, load_spec, model_path
from jax_inertia.model.mujoco_types import MjModel, MjSpec
from jax_inertia.model.robot import Robot
from jax_inertia.preflight.mended import mended, while_targeted
from jax_inertia.preflight.position_targets import position_targets
from jax_inertia.preflight.preflight import Finding, Preflight, Severity, preflight
from jax_inertia.replay import handover, pipeline
from jax_inertia.replay.command import of_the_loop
from jax_inertia.replay.inputs import FLOATS
from jax_inertia.replay.loop import UNITS, Loop, position_loop
from jax_inertia.replay.output import report
from jax_inertia.replay.result import Diagnosis
from jax_inertia.replay.simulation.spec_edits import fixed_base
from jax_inertia.signals.held import with_loop_torque
from jax_inertia.text.closest_names import listed
from jax_inertia.text.progress import shared

FAMILIES = tuple(dict.fromkeys((*NAMES, *UNITS)))
"""Of effects, those of both ways to diagnose."""


def unknown_families(names: Sequence[str]) -> list[str]:
    """Those that are no families of effects."""
    return sorted(set(names) - set(FAMILIES) - {"odd"})


def nominal_spec(model: str | Path, fix_base: bool) -> MjSpec:
    """The model's spec, its base fixed where asked for."""
    spec = load_spec(model)
    if fix_base:
        fixed_base(spec)
    return spec


def usable(log: Log, robot: Robot, loop: Loop | None = None) -> tuple[Log, tuple[Finding, ...]]:
    """A log that is to be replayed without what cannot be, and what there is to say of it; LogError if it cannot be.

    By the torque of its `loop`, where that is known, its positions are compared with what the model needs.
    """
    if log.qpos_target is None:
        raise LogError("a replay needs the joints' position targets: qpos_target")
    if robot.has_free_base:
        raise LogError(FLOATS)
    log, untargeted = while_targeted(log)
    log, left_out = mended(log, kinds=robot.joint_kinds)
    driven = log if loop is None else dataclasses.replace(log, kp=loop.kp, kd=loop.kd)
    found = preflight(driven, robot)
    # Of a log with torque they are warnings, since who uses that alone need not know them.
    targets = () if log.tau is None else position_targets(log, robot.joint_kinds)
    wrong = (one for one in targets if one.severity is Severity.ERROR)
    Preflight((*found.findings, *wrong)).raise_for_errors()
    return log, (*untargeted, *left_out, *found.findings)


def known_loop(
    log: Log,
    model: MjModel,
    kp: Sequence[float] | None = None,
    kd: Sequence[float] | None = None,
    *,
    model_first: bool = False,
) -> Loop | None:
    """The log's position loop (`loop.position_loop`); None where nobody says its gains."""
    try:
        return position_loop(log, model, kp, kd, model_first=model_first)
    except (LogError, KeyError):
        return None


def diagnose(
    robot: Robot | str | Path,
    log: Log,
    *,
    more_logs: Sequence[Log] = (),
    validation_log: Log | None = None,
    test_log: Log | None = None,
    exclude: Sequence[str] = (),
    max_effects: int | None = None,
    kp: Sequence[float] | None = None,
    kd: Sequence[float] | None = None,
    fix_base: bool = False,
    progress: Callable[[str], None] = lambda stage: None,
) -> ByTorque | Diagnosis:
    """What the model lacks of the robot that a log was recorded on: what `jax-inertia diagnose` finds.

    `robot` is a loaded model, or the path of its file, which a log of targets needs: they are replayed, through the
    loop whose gains are known, where the base is fixed; torques of that loop are a further output of the replays. All
    results have `verdict`, `confidence`, `headline` and `notes`, and `to_report` makes report.json of each.
    `validation_log` is another motion of the same robot, by which effects are chosen and to which no number is fitted;
    without it they are chosen by rows that are held out. `test_log` is read once, at the end: the stated errors are of
    it, and nothing depends on it. `exclude` removes families of effects. Of logs with torque: `max_effects`, how many
    odd ones at most; torques that are no N m get one drive gain per joint from the log itself, and a note says so;
    computed in double precision, whatever JAX is set to. Of logs of targets: `more_logs` are fitted too, and may be of
    other gains; `kp` [N m/rad], `kd` [N m s/rad] of the position loop (one or each) and `fix_base` as in the command.
    Of a base that floats, the torque is what that loop makes of the targets. `progress` is called with the text of each
    stage as it begins; its `share` is the part of the work that is usually done by then. Raises ValueError for an
    unknown family or an argument of the other kind of log, and LogError for a log that cannot be used.

    >>> import jax_inertia as ji
    >>> from jax_inertia.robots.pendulum import double_pendulum, swing
    >>> found = ji.diagnose(ji.load_model(double_pendulum()), swing(load=0.5, seconds=8.0))
    >>> str(found.verdict), ji.to_report(found)["effects"][0]["family"]
    ('explained', 'payload')
    """
    progress = shared(progress)
    if log.tau is None and not fix_base:
        own = robot if isinstance(robot, Robot) else load_model(robot)
        if own.has_free_base:
            of = own, None if isinstance(robot, Robot) else Path(robot), kp, kd
            log, kp, kd = of_loop(log, *of), None, None
            test_log = None if test_log is None else of_loop(test_log, *of)
            validation_log = None if validation_log is None else of_loop(validation_log, *of)
    by_file = not isinstance(robot, Robot)
    every = [log, *more_logs, *([] if validation_log is None else [validation_log])]
    if log.tau is None or (by_file and replayable(Path(robot), every, kp, kd, fix_base)):
        if isinstance(robot, Robot):
            raise LogError(
                "a log without torque is replayed, which takes the model's file: diagnose('arm.xml', log)"
            )
        logs = [log, *more_logs]
        found = by_replays(
            Path(robot), logs, test_log, exclude, validation_log=validation_log, kp=kp, kd=kd, fix_base=fix_base,
            progress=progress,
        )  # fmt: skip
        if fix_base or not left_to_torque(found, logs):
            return found
        exclude, kp, kd = [x for x in exclude if x in NAMES], None, None
    of_targets = {
        "more_logs": more_logs or None, "kp": kp, "kd": kd,
        "fix_base": fix_base or None,
    }  # fmt: skip
    for name, value in of_targets.items():
        if value is not None:
            raise ValueError(
                f"{name} is for logs of targets that are replayed; this log is diagnosed by its torque"
            )
    loaded = robot if isinstance(robot, Robot) else load_model(robot)
    return by_torque.diagnose(
        loaded,
        log,
        validation_log=validation_log,
        test_log=test_log,
        nominal=None if isinstance(robot, Robot) else load_spec(robot),
        exclude=exclude,
        max_effects=max_effects,
        progress=progress,
    )


def replayable(
    model: Path,
    logs: Sequence[Log],
    kp: Sequence[float] | None = None,
    kd: Sequence[float] | None = None,
    fix_base: bool = False,
) -> bool:
    """Whether logs with torque are to be replayed: fixed base, known gains, and torques that are those of the loop."""
    if any(one.qpos_target is None for one in logs):
        return False
    compiled = compile_spec(nominal_spec(model, fix_base), model)
    if load_model(compiled).has_free_base:
        return False
    loops = [known_loop(one, compiled, kp, kd) for one in logs]
    return all(
        loop is not None and of_the_loop(one, loop) for one, loop in zip(logs, loops, strict=True)
    )


def left_to_torque(found: Diagnosis, logs: Sequence[Log]) -> bool:
    """Whether replays explain nothing of a log with torque, which may show what they do not seek: pushes, springs."""
    return found.verdict is Verdict.UNKNOWN and len(logs) == 1 and logs[0].tau is not None


def of_loop(
    log: Log,
    robot: Robot,
    model: Path | None,
    kp: Sequence[float] | None = None,
    kd: Sequence[float] | None = None,
) -> Log:
    """The log of a floating base with the torque of its position loop, where it has targets and no torque.

    Gains that are not given are those of the log, or of the actuators of a model's file.
    """
    if not robot.has_free_base or log.tau is not None or log.qpos_target is None:
        return log
    if model is not None:
        return with_loop_torque(
            log, *position_loop(log, compile_spec(load_spec(model), model), kp, kd)
        )
    return with_loop_torque(
        log,
        log.kp if kp is None else np.asarray(kp, float),
        log.kd if kd is None else np.asarray(kd, float),
    )


def by_replays(
    model: Path,
    logs: Sequence[Log],
    test_log: Log | None,
    exclude: Sequence[str],
    *,
    validation_log: Log | None = None,
    kp: Sequence[float] | None,
    kd: Sequence[float] | None,
    fix_base: bool,
    home: Path | None = None,
    progress: Callable[[str], None],
) -> Diagnosis:
    """The diagnosis by replays, every log looked at first; `home`: where corrected.xml is to lie, if anywhere."""
    if unknown := unknown_families(exclude):
        raise ValueError(f"unknown families {unknown}; valid: {', '.join(FAMILIES)}")
    compiled = compile_spec(nominal_spec(model, fix_base), model)
    robot = load_model(compiled)

    def looked_at(one: Log) -> Log:
        return usable(one, robot, known_loop(one, compiled, kp, kd))[0]

    logs = [looked_at(one) for one in logs]
    validation_log = None if validation_log is None else looked_at(validation_log)
    test_log = None if test_log is None else looked_at(test_log)
    for one in (*logs, validation_log, test_log):
        if one is not None and one.joint_names != logs[0].joint_names:
            raise LogError(
                f"logs have different joints: {listed(logs[0].joint_names)}; {listed(one.joint_names)}"
            )
    with tempfile.TemporaryDirectory() as nowhere:
        return pipeline.diagnose(
            logs,
            functools.partial(nominal_spec, model, fix_base),
            test_log=test_log,
            validation_log=validation_log,
            kp=kp,
            kd=kd,
            exclude=exclude,
            write=handover.in_folder(model_path(model), home or Path(nowhere)),
            progress=progress,
        )


def to_report(found: ByTorque | LogEstimate | Diagnosis) -> dict[str, Any]:
    """report.json of what `diagnose` or `estimate` found: only JSON's own types, no NaN.

    >>> import jax_inertia as ji
    >>> from jax_inertia.robots.pendulum import double_pendulum, swing
    >>> found = ji.diagnose(ji.load_model(double_pendulum()), swing(load=0.5, seconds=8.0))
    >>> ji.to_report(found)["effects"][0]["location"]["name"]
    'lower'
    """
    if isinstance(found, Diagnosis):
        return report.to_report(found)
    if isinstance(found, LogEstimate):
        return log_estimate.to_report(found)
    return json_report.to_report(found)
