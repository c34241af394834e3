"""One call that diagnoses, by whichever way serves the model: every joint at once, or one effect on a good model.

`diagnosis` seeks the ordinary physics of every joint and what is odd beyond it, `gap` single effects that a model lacks
which has its ordinary physics already. What those do not explain is asked of the former, too. This goes with `gap`.
"""

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from jax_inertia.diagnosis import pipeline
from jax_inertia.diagnosis.effects.base import Effect
from jax_inertia.diagnosis.effects.registry import NAMES
from jax_inertia.diagnosis.report import json_report as whole_report
from jax_inertia.diagnosis.result import Diagnosis as WholeRobot
from jax_inertia.diagnosis.settings import CalibrationState, Settings
from jax_inertia.estimation import log_estimate
from jax_inertia.estimation.log_estimate import LogEstimate
from jax_inertia.gap import diagnosis as single
from jax_inertia.gap import report as single_report
from jax_inertia.gap.finding import Diagnosis
from jax_inertia.gap.nuisance import Tolerance
from jax_inertia.gap.units import drive_gains, in_newton_metres
from jax_inertia.gap.verdict import Verdict
from jax_inertia.logs.log import Log, LogError
from jax_inertia.maths.precision import in_double_precision
from jax_inertia.model.robot import Robot
from jax_inertia.preflight.preflight import NO_TORQUE, Finding, Severity, preflight
from jax_inertia.signals.ground_support import BASE
from jax_inertia.signals.held import with_loop_torque

ENOUGH = (Verdict.EXPLAINED, Verdict.NO_GAP)
"""Verdicts of the search for single effects after which nothing else is asked."""


@in_double_precision
def diagnose(
    robot: Robot,
    log: Log,
    *,
    test_log: Log | None = None,
    exclude: Sequence[str] = (),
    extra: Sequence[Effect] = (),
    max_effects: int = 3,
    nominal_uncertainty: tuple[float, float, float] | None = None,
    progress: Callable[[str], None] = lambda stage: None,
) -> Diagnosis | WholeRobot:
    """What the model lacks of the robot that a log was recorded on: what `jax-inertia diagnose` finds.

    Both results have `verdict`, `confidence`, `headline` and `notes`, and `to_report` makes report.json of either.
    `test_log` is another motion of the same robot: effects must carry over to it. `exclude` removes families of
    effects, `extra` adds effects of your own; `max_effects` holds where single effects are sought.
    `nominal_uncertainty`: one standard deviation of the model's masses (relative), centres of mass [m] and rotational
    inertias (relative). Torques that are no N m get one drive gain per joint from the log itself, and a note says so.
    Computed in double precision, whatever JAX is set to. Raises ValueError for an unknown family, and LogError for a
    log that cannot be used.

    >>> import jax_inertia as ji
    >>> from jax_inertia.robots.pendulum import double_pendulum, swing
    >>> found = ji.diagnose(ji.load_model(double_pendulum()), swing(load=0.5, seconds=8.0))
    >>> str(found.verdict), ji.to_report(found)["effects"][0]["family"]
    ('explained', 'payload')
    """
    if unknown := unknown_families(exclude):
        raise ValueError(f"unknown families {unknown}; valid: {', '.join(NAMES)}")
    if max_effects < 1:
        raise ValueError(f"max_effects is {max_effects}; at least one")
    progress("looking at the log")
    robot = robot.astype("float64")
    notes, drives = [], None
    logs = {"log": log} | ({} if test_log is None else {"test_log": test_log})
    for name, one in logs.items():
        try:
            logs[name], drives, findings = usable(one, robot, drives, name)
        except LogError as error:
            raise LogError(f"{name}: {error}") from None
        notes += [f"{name}: {f.message}" for f in findings if f.severity is Severity.WARNING]
    of = logs["log"], logs.get("test_log")
    found = searched(robot, of, Asked(exclude, extra, nominal_uncertainty, progress), max_effects)
    return dataclasses.replace(found, notes=(*notes, *found.notes))


def unknown_families(names: Sequence[str]) -> list[str]:
    """Those that are no families of effects."""
    return sorted(set(names) - set(NAMES))


class Drives(NamedTuple):
    """How torques of a log are read, and with it those of another motion."""

    gains: list[float]
    """N m per unit of the log, one for each joint; none for a log in N m."""
    unit: str
    name: str
    """Of the log that they were taken from."""


def usable(
    log: Log, robot: Robot, drives: Drives | None, name: str
) -> tuple[Log, Drives, tuple[Finding, ...]]:
    """A log in N m, how its torques were read, and what there is to say of it; LogError where it cannot be used.

    `drives` are those of the log before, if there is one: a gain that does not carry over is part of what is tested.
    """
    if log.tau is None:
        if not robot.has_free_base or log.qpos_target is None:
            raise LogError(NO_TORQUE)
        log = with_loop_torque(log, log.kp, log.kd)
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
    return in_newton_metres(log, drives.gains), drives, (*found.findings, *remarks)


class Asked(NamedTuple):
    """What a user asks for beside model and logs."""

    exclude: Sequence[str]
    extra: Sequence[Effect]
    nominal_uncertainty: tuple[float, float, float] | None
    progress: Callable[[str], None]


def searched(
    robot: Robot, logs: tuple[Log, Log | None], asked: Asked, max_effects: int
) -> Diagnosis | WholeRobot:
    """What the search that serves the model finds, of logs in N m: of a log and, where there is one, another motion.

    Of a calibrated model single effects are sought, and where those do not explain the log, whatever helps to predict,
    joint by joint.
    """
    found = _whole_robot(pipeline.diagnose_as_bought, robot, logs, asked)
    if found is not None:
        return found
    found = single_effects(robot, logs, asked, max_effects)
    if found.verdict in ENOUGH:
        return found
    # More than that is off, so the model is none that has its ordinary physics.
    as_bought = functools.partial(pipeline.diagnose, state=CalibrationState.AS_BOUGHT)
    return _whole_robot(as_bought, robot, logs, asked) or found


def single_effects(
    robot: Robot, logs: tuple[Log, Log | None], asked: Asked, max_effects: int
) -> Diagnosis:
    """Single effects that a calibrated model lacks, of logs in N m."""
    return single.diagnose(
        robot,
        logs[0],
        test_log=logs[1],
        exclude=asked.exclude,
        extra=asked.extra,
        max_effects=max_effects,
        nominal_uncertainty=_tolerance(asked.nominal_uncertainty),
        progress=asked.progress,
    )


def _whole_robot(
    search: Callable[..., WholeRobot | None],
    robot: Robot,
    logs: tuple[Log, Log | None],
    asked: Asked,
) -> WholeRobot | None:
    """The diagnosis of every joint at once by one of `pipeline`'s searches.

    None where that finds none, and for what it does not do yet: a base that floats on forces that are not measured, and
    rows that are no hinge's, slide's or base's.
    """
    floats = robot.has_free_base
    measured = all(one is None or one.contact_wrench is not None for one in logs)
    joints = robot.topology.dof_scalar[BASE if floats else 0 :]
    if (floats and not measured) or not all(joints):
        return None
    settings = Settings()
    if asked.nominal_uncertainty is not None:
        mass, com, inertia = asked.nominal_uncertainty
        settings = Settings(mass_tolerance=mass, com_stated=com, inertia_tolerance=inertia)
    return search(
        robot,
        logs[0],
        test_log=logs[1],
        exclude=asked.exclude,
        extra=asked.extra,
        settings=settings,
        progress=asked.progress,
    )


def _tolerance(nominal_uncertainty: tuple[float, float, float] | None) -> Tolerance | None:
    """What the search for single effects takes a nominal model to be off by, where it is stated."""
    if nominal_uncertainty is None:
        return None
    mass, com, inertia = nominal_uncertainty
    return Tolerance(mass=mass, com=com, inertia=inertia)


def to_report(found: Diagnosis | WholeRobot | LogEstimate) -> dict[str, Any]:
    """report.json of what `diagnose` or `estimate` found: only JSON's own types, no NaN.

    >>> import jax_inertia as ji
    >>> from jax_inertia.robots.pendulum import double_pendulum, swing
    >>> found = ji.diagnose(ji.load_model(double_pendulum()), swing(load=0.5, seconds=8.0))
    >>> ji.to_report(found)["effects"][0]["location"]["name"]
    'lower'
    """
    if isinstance(found, LogEstimate):
        return log_estimate.to_report(found)
    if isinstance(found, WholeRobot):
        return whole_report.to_report(found)
    return single_report.to_report(found)
