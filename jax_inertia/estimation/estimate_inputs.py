"""What `estimate` is asked: its settings, the logs, and a look at them all before anything is computed."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from jax_inertia.dynamics.rigid_body import resolve_bodies
from jax_inertia.logs.log import Log, LogError, TorqueUnit
from jax_inertia.maths import charts
from jax_inertia.maths.argument_checks import is_positive, require
from jax_inertia.model.robot import Robot
from jax_inertia.preflight.mended import mended
from jax_inertia.preflight.preflight import NO_TORQUE, Finding, Preflight, Severity, preflight
from jax_inertia.signals.held import with_loop_torque
from jax_inertia.text.closest_names import suggestion

# By the bodies asked for as the model has them.
CHARTS: Mapping[str, Callable[[Float[jax.Array, "bodies 10"]], charts.Chart]] = {
    "log-cholesky-uut": lambda pi: charts.LogCholeskyUUt(),
    "log-cholesky": lambda pi: charts.LogCholesky(),
    "relative": charts.Relative.to,
    "linear": lambda pi: charts.Linear(),
}
_MOST_ITERATIONS = 100
TOLERANCE = 0.02, 0.001, 0.05
"""Of a model that says nothing of its errors: masses (relative), centres [m], radii of gyration (relative). CAD masses
of built arms: 2 to 5 %."""


@dataclasses.dataclass(frozen=True)
class Settings:
    """Of `estimate`, which says what each is; ValueError for a number that cannot be."""

    gains: Sequence[float] | float | None = None
    gain_sigma: float | None = None
    trust: Sequence[float] = (0.1, 0.05)
    chart: charts.Chart | str = "log-cholesky-uut"
    gate: float | None = None
    reopen_after: float | None = None
    iterations: int | None = None
    sigma_tau: Sequence[float] | float | None = None
    prior_mass: float | None = None
    prior_reach: float = 0.2
    drift_time: float | None = None
    cutoff: float | None = None
    rate: float | None = None
    bias_window: float | None = None
    ignore: Sequence[str] = ()
    friction: bool | None = None
    tolerance: Sequence[float] | None = None

    def __post_init__(self) -> None:
        for name in (
            *("gain_sigma", "trust", "reopen_after", "sigma_tau", "prior_mass", "prior_reach"),
            *("drift_time", "cutoff", "rate", "bias_window"),
        ):
            if (value := getattr(self, name)) is not None:
                require(name, value, is_positive, "positive")
        sizes = np.asarray(TOLERANCE if self.tolerance is None else self.tolerance, float)
        if sizes.shape != (3,) or not np.all(np.isfinite(sizes) & (sizes >= 0)):
            raise ValueError(
                f"tolerance is {self.tolerance!r}; give three numbers, zero or more: masses in parts, centres in m, "
                "radii of gyration in parts"
            )
        if np.shape(self.trust) != (2,):
            raise ValueError(
                f"trust is {self.trust!r}; give two numbers: masses in parts, centres in m"
            )
        if isinstance(self.chart, str) and self.chart not in CHARTS:
            raise ValueError(f"no chart {self.chart!r}; {suggestion(self.chart, tuple(CHARTS))}")
        n = self.iterations
        if n is not None and not (isinstance(n, int) and 1 <= n <= _MOST_ITERATIONS):
            raise ValueError(
                f"iterations is {n!r}; it must be a whole number from 1 to {_MOST_ITERATIONS}"
            )
        if self.gate is not None and not 0 < self.gate <= 1:
            raise ValueError(
                f"gate is {self.gate}; it must be a probability above 0, and not above 1 (no gate)"
            )


class Names(NamedTuple):
    """What messages call things: a log by its file, an option as it is written where it is given."""

    log: str = "log"
    calibrate: Sequence[str] = ()
    option: Callable[[str], str] = str


@dataclasses.dataclass(frozen=True)
class Inputs:
    """What was given, and found sound."""

    robot: Robot
    log: Log
    bodies: tuple[str, ...]
    references: tuple[Log, ...]
    findings: tuple[Finding, ...]
    settings: Settings
    option: Callable[[str], str]

    @property
    def in_newton_metres(self) -> bool:
        """Whether torques are, or else in a unit of the drives'."""
        return self.log.tau_unit is TorqueUnit.NEWTON_METRE

    @property
    def chosen(self) -> tuple[int, ...]:
        """Indices of the bodies."""
        return resolve_bodies(self.robot, self.bodies)


def checked(
    robot: Robot,
    log: Log,
    bodies: Sequence[int | str],
    references: Sequence[Log],
    settings: Settings,
    *,
    names: Names | None = None,
    found: Sequence[Finding] = (),
    report: Callable[[str, Finding], None] = lambda name, finding: None,
) -> Inputs:
    """Look at everything before anything is computed; ValueError or LogError with one line.

    `found` is what is known of the log already; `report` gets each finding, with its log's name, as it is found.
    """
    if names is None:
        names = Names(calibrate=[f"calibrate[{k}]" for k in range(len(references))])
    if robot.has_free_base:
        log, *references = (_driven(one) for one in (log, *references))
    chosen = resolve_bodies(robot, bodies)
    if not chosen:
        raise ValueError("no body to estimate; name at least one")
    findings, logs = [*found], []
    for name, one in zip((names.log, *names.calibrate), (log, *references), strict=True):
        one, left_out = mended(one, settings.ignore, robot.joint_kinds)
        logs.append(one)
        seen = preflight(one, robot)
        seen = Preflight((*left_out, *seen.findings))
        try:
            seen.raise_for_errors()
        except LogError as error:
            raise LogError(f"{name}: {error}") from None
        if one.tau is None:
            raise LogError(f"{name}: {NO_TORQUE}")
        for finding in _with_support(seen, one, robot).findings:
            report(name, finding)
            findings.append(finding)
    log, *references = logs
    _require_unit(log, references, settings, names)
    if (count := np.size(1.0 if settings.sigma_tau is None else settings.sigma_tau)) not in (
        1,
        robot.nv,
    ):
        raise ValueError(
            f"{count} values of {names.option('sigma_tau')} for {robot.nv} rows; give one for all, or one each"
        )
    return Inputs(
        robot=robot,
        log=log,
        bodies=tuple(robot.body_names[k] for k in chosen),
        references=tuple(references),
        findings=tuple(findings),
        settings=settings,
        option=names.option,
    )


def _require_unit(log: Log, references: Sequence[Log], settings: Settings, names: Names) -> None:
    """ValueError where torques are in no unit that can be used, or logs are in several."""
    torque, given = log.tau_unit is TorqueUnit.NEWTON_METRE, settings.gains is not None
    if not torque and not given and not references:
        raise ValueError(
            f"{names.log}: tau is in {log.tau_unit_text!r}, not N m; give {names.option('gains')} (N m per unit, one "
            f"for each joint), or {names.option('calibrate')} with logs without load"
        )
    if torque and given:
        raise ValueError(
            f"{names.log}: tau is in N m; {names.option('gains')} is for currents and counts; say which in the log's "
            "unit of torque (--tau-unit)"
        )
    for name, one in zip(names.calibrate, references, strict=True):
        if one.tau_unit is not log.tau_unit:
            raise ValueError(
                f"{name}: tau is in {one.tau_unit_text!r}, in {names.log} {log.tau_unit_text!r}"
            )


def _driven(log: Log) -> Log:
    """The log with the torque of its position loop, where it has no other and says its targets and gains."""
    given = log.tau is None and log.qpos_target is not None
    return with_loop_torque(log, log.kp, log.kd) if given else log


def _with_support(found: Preflight, log: Log, robot: Robot) -> Preflight:
    """What was found, and that nobody measured what carries a robot that floats."""
    if not robot.has_free_base or log.contact_wrench is not None:
        return found
    message = (
        "the model's base floats and the log has no contact_wrench: forces at its feet are taken from their legs' own "
        "torques, which then say nothing of the legs; whatever else holds the robot is taken out of the bodies that "
        "are estimated"
    )
    return Preflight((Finding(Severity.WARNING, "contact_wrench", message), *found.findings))
