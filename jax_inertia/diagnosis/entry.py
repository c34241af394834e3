"""The diagnosis of logs as they come: looked at first, in N m, then the search of the whole robot (`pipeline`)."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import NamedTuple

from jax_inertia.diagnosis import pipeline
from jax_inertia.diagnosis.effects.base import Effect
from jax_inertia.diagnosis.result import Diagnosis
from jax_inertia.diagnosis.settings import Settings
from jax_inertia.logs.log import Log, LogError
from jax_inertia.maths.precision import in_double_precision
from jax_inertia.model.mujoco_types import MjSpec
from jax_inertia.model.robot import Robot
from jax_inertia.preflight.drive_gains import drive_gains, in_newton_metres
from jax_inertia.preflight.mended import mended
from jax_inertia.preflight.preflight import NO_TORQUE, Finding, Severity, preflight
from jax_inertia.signals.held import with_loop_torque


class Drives(NamedTuple):
    """How torques of a log are read, and with it those of another motion."""

    gains: list[float]
    """N m per unit of the log, one for each joint; none for a log in N m."""
    unit: str
    name: str
    """Of the log that they were taken from."""


@in_double_precision
def diagnose(
    robot: Robot,
    log: Log,
    *,
    validation_log: Log | None = None,
    test_log: Log | None = None,
    nominal: MjSpec | None = None,
    exclude: Sequence[str] = (),
    extra: Sequence[Effect] = (),
    max_effects: int | None = None,
    nominal_uncertainty: tuple[float, float, float] | None = None,
    progress: Callable[[str], None] = lambda stage: None,
) -> Diagnosis:
    """What the model lacks of the robot that a log was recorded on: what `jax-inertia diagnose` finds of its torques.

    `validation_log` is another motion of the same robot, by which effects are chosen and to which no number is fitted;
    `test_log` is one on which nothing depends: the error of what is handed over is quoted there. `nominal` is the spec
    that corrected.xml is made of, the robot's own without it. `exclude` removes families of
    effects, `extra` adds effects of your own; `max_effects`: how many odd ones at most, as many as the log supports
    without it. `nominal_uncertainty`: one standard deviation of the model's masses (relative), centres of mass [m] and
    rotational inertias (relative). Torques that are no N m get one drive gain per joint from the log itself, and a note
    says so. Computed in double precision, whatever JAX is set to. Raises ValueError for an unknown family, and LogError
    for a log that cannot be used.

    >>> import jax_inertia as ji
    >>> from jax_inertia.robots.pendulum import double_pendulum, swing
    >>> found = ji.diagnose(ji.load_model(double_pendulum()), swing(load=0.5, seconds=8.0))
    >>> str(found.verdict), ji.to_report(found)["effects"][0]["family"]
    ('explained', 'payload')
    """
    settings = stated(max_effects, nominal_uncertainty)
    progress("looking at the log")
    robot = robot.astype("float64")
    notes, drives = [], None
    logs = {"log": log, "validation_log": validation_log, "test_log": test_log}
    logs = {name: one for name, one in logs.items() if one is not None}
    for name, one in logs.items():
        try:
            logs[name], drives, findings = usable(one, robot, drives, name)
        except LogError as error:
            raise LogError(f"{name}: {error}") from None
        notes += [f"{name}: {f.message}" for f in findings if f.severity is Severity.WARNING]
    found = pipeline.diagnose(
        robot,
        logs["log"],
        validation_log=logs.get("validation_log"),
        test_log=logs.get("test_log"),
        nominal=nominal,
        exclude=exclude,
        extra=extra,
        settings=settings,
        progress=progress,
    )
    return with_drives(found, drives, logs["log"], notes)


def with_drives(
    found: Diagnosis, drives: Drives | None, log: Log, notes: Sequence[str] = ()
) -> Diagnosis:
    """The diagnosis with the drive gains that its log's torques were read with, and with more notes.

    >>> import jax_inertia as ji
    >>> from jax_inertia.diagnosis.entry import usable, with_drives
    >>> from jax_inertia.robots.pendulum import double_pendulum, swing
    >>> robot, log = ji.load_model(double_pendulum()), swing(load=0.5, seconds=8.0)
    >>> log, drives, _ = usable(log, robot, None, "log")
    >>> with_drives(ji.diagnose(robot, log), drives, log, ["read as N m"]).notes[0]
    'read as N m'
    """
    gains = drives.gains if drives is not None else []
    read = dict(zip(log.joint_names, gains, strict=True)) if gains else {}
    return dataclasses.replace(found, drive_gains=read, notes=(*notes, *found.notes))


def stated(
    max_effects: int | None, nominal_uncertainty: tuple[float, float, float] | None
) -> Settings:
    """Settings with what a user states: how many odd effects at most, and what the model may be off by.

    >>> from jax_inertia.diagnosis.entry import stated
    >>> stated(2, (0.03, 0.002, 0.1)).mass_tolerance
    0.03
    """
    if max_effects is not None and max_effects < 1:
        raise ValueError(f"max_effects is {max_effects}; at least one")
    settings = Settings(most_effects=max_effects)
    if nominal_uncertainty is None:
        return settings
    mass, com, inertia = nominal_uncertainty
    return dataclasses.replace(
        settings, mass_tolerance=mass, com_stated=com, inertia_tolerance=inertia
    )


def usable(
    log: Log, robot: Robot, drives: Drives | None, name: str
) -> tuple[Log, Drives, tuple[Finding, ...]]:
    """A log in N m, how its torques were read, and what there is to say of it; LogError where it cannot be used.

    `drives` are those of the log before, if there is one: a gain that does not carry over is part of what is tested.

    >>> import jax_inertia as ji
    >>> from jax_inertia.diagnosis.entry import usable
    >>> from jax_inertia.robots.pendulum import double_pendulum, swing
    >>> _, drives, _ = usable(swing(load=0.5), ji.load_model(double_pendulum()), None, "log")
    >>> drives.unit
    'N m'
    """
    if log.tau is None:
        if not robot.has_free_base or log.qpos_target is None:
            raise LogError(NO_TORQUE)
        log = with_loop_torque(log, log.kp, log.kd)
    log, left_out = mended(log, kinds=robot.joint_kinds)
    found = preflight(log, robot)
    found.raise_for_errors()
    for finding in found.findings:
        if finding.check == "no_motion" and finding.severity is Severity.WARNING:
            raise LogError(finding.message)
    remarks: tuple[Finding, ...] = ()
    if drives is None:
        try:
            gains, remarks = drive_gains(log, robot)
        except ValueError as error:
            raise LogError(str(error)) from None
        drives = Drives(gains, log.tau_unit_text, name)
    elif log.tau_unit_text != drives.unit:
        raise LogError(f"tau is in {log.tau_unit_text!r}, {drives.name} in {drives.unit!r}")
    return in_newton_metres(log, drives.gains), drives, (*left_out, *found.findings, *remarks)
