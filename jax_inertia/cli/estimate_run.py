"""What `jax-inertia estimate` computes, from files to numbers."""

import argparse
import dataclasses
from collections.abc import Callable, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jax_inertia.cli.console import warn
from jax_inertia.dynamics.rigid_body import resolve_bodies
from jax_inertia.estimation import batch_fit, log_filter
from jax_inertia.estimation.batch_fit import BatchFit
from jax_inertia.estimation.filter_settings import GATE
from jax_inertia.estimation.identifiability import Knowledge, knowledge
from jax_inertia.estimation.inertial_filter import Trace
from jax_inertia.estimation.physical_estimate import Estimate
from jax_inertia.estimation.priors import Load, Tolerance
from jax_inertia.logs.log import Log, LogError, TorqueUnit, read_log
from jax_inertia.maths import charts
from jax_inertia.maths.inertial_parameters import is_physical
from jax_inertia.model.load import load_model
from jax_inertia.model.log_match import afloat
from jax_inertia.model.robot import Robot
from jax_inertia.preflight.preflight import Finding, Preflight, Severity, preflight
from jax_inertia.signals.differences import Observation
from jax_inertia.text.closest_names import suggestion


@dataclasses.dataclass(frozen=True)
class Inputs:
    """What was read, and found sound."""

    robot: Robot
    log: Log
    references: tuple[Log, ...]
    findings: tuple[Finding, ...]


@dataclasses.dataclass(frozen=True)
class Result:
    """What was found."""

    bodies: tuple[str, ...]
    robot: Robot
    """Calibrated where that was asked for, with the bodies asked for as the model has them."""
    findings: tuple[Finding, ...]
    notes: tuple[str, ...]
    observation: Observation
    trace: Trace
    time: Float[np.ndarray, " T"]
    physical: Bool[np.ndarray, "T bodies"]
    fit: BatchFit
    calibration: BatchFit | None
    load: Estimate | None
    """With one body and a calibration: the load, fitted together with all that was calibrated."""
    noise: Float[np.ndarray, " nv"]
    bias: Float[np.ndarray, " nv"]
    gains: Float[np.ndarray, " nv"]
    prior: Load
    gate: float
    changed: bool
    known: Knowledge
    """Whose word each parameter is: the log's, the prior's, or nobody's."""
    row_names: tuple[str, ...]

    @property
    def unloaded_mass(self) -> Float[np.ndarray, " bodies"]:
        """What the bodies weigh without load: as calibrated, else as in the model [kg]."""
        robot = self.robot if self.calibration is None else self.calibration.robot
        return np.asarray(robot.pi)[list(resolve_bodies(robot, self.bodies)), 0]

    @property
    def calibration_sigma(self) -> float:
        """What the calibration leaves open of the load's mass [kg]; zero where it was not asked for."""
        if self.load is None:
            return 0.0
        whole, given = float(self.load.sigma_pi[0, 0]), float(self.fit.estimate.sigma_pi[0, 0])
        return float(np.sqrt(max(whole**2 - given**2, 0.0)))


def read(args: argparse.Namespace) -> Inputs:
    """Read model and logs, and look at them before anything is computed."""
    robot = load_model(args.model)
    log, *references = [read_log(path, names=robot) for path in (args.log, *(args.calibrate or ()))]
    robot, told = afloat(robot, args.model, log)
    for name in args.bodies:
        if name not in robot.body_names:
            raise ValueError(
                f"{args.model} has no moving body {name!r}; {suggestion(name, robot.body_names)}"
            )
    resolve_bodies(robot, args.bodies)
    findings = [*told]
    for path, one in zip((args.log, *(args.calibrate or ())), (log, *references), strict=True):
        found = preflight(one, robot)
        try:
            found.raise_for_errors()
        except LogError as error:
            raise LogError(f"{path}: {error}") from None
        found = _with_support(found, one, robot)
        for finding in found.of(Severity.WARNING):
            if finding.check != "torque_unit":
                warn(f"{path}: {finding.message}")
        findings += found.findings
    torque = log.tau_unit is TorqueUnit.NEWTON_METRE
    if not torque and not args.gains and not args.calibrate:
        raise ValueError(
            f"{args.log}: tau is in {log.tau_unit_text!r}, not N m; give --gains (N m per unit, one for "
            "each joint), or --calibrate with logs without load"
        )
    if torque and args.gains:
        raise ValueError(f"{args.log}: tau is in N m; --gains is for currents and counts")
    for path, one in zip(args.calibrate or (), references, strict=True):
        if one.tau_unit is not log.tau_unit:
            raise ValueError(
                f"{path}: tau is in {one.tau_unit_text!r}, in {args.log} {log.tau_unit_text!r}"
            )
    return Inputs(robot, log, tuple(references), tuple(findings))


def _with_support(found: Preflight, log: Log, robot: Robot) -> Preflight:
    """What was found, and that nothing is known to carry a robot that floats."""
    if not robot.has_free_base or log.contact_wrench is not None:
        return found
    message = (
        "the model's base floats and the log has no contact_wrench: unless the robot flies, what carries its weight is "
        "taken out of the bodies that are estimated; log the contacts' wrenches"
    )
    return Preflight((Finding(Severity.WARNING, "contact_wrench", message), *found.findings))


def estimate(args: argparse.Namespace, inputs: Inputs, stage: Callable[[str], None]) -> Result:
    """Signals, calibration, batch fit, noise, filter, and what the log can tell at all."""
    robot, log, notes = inputs.robot, inputs.log, []
    stage("resampling, low-pass, differences")
    torque = log.tau_unit is TorqueUnit.NEWTON_METRE
    gains = log_filter.joint_gains(log, robot, 1.0 if torque else args.gains or 10.0)
    raw = log_filter.observe(log, robot, rate=args.rate, cutoff=args.cutoff, any_unit=not torque)
    start, bias, calibration, references = gains, np.zeros(robot.nv), None, []
    if inputs.references:
        stage("calibrating on the logs without load")
        references = [
            log_filter.observe(one, robot, rate=args.rate, cutoff=args.cutoff, any_unit=not torque)
            for one in inputs.references
        ]
        raw, *references = [log_filter.without_slow_rows(one, robot) for one in (raw, *references)]
        calibration = _calibrate(args, inputs, references, gains)
        # The bodies asked for start at the model's own: calibrated ones may be as thin as rods, where charts end.
        chosen = resolve_bodies(robot, args.bodies)
        robot = calibration.robot.with_pi(chosen, robot.pi[np.array(chosen)])
        gains, bias = calibration.gains, calibration.bias
        if not calibration.converged:
            notes.append("the calibration did not settle; its parameters are the last round's")
    mass = (
        0.1 * float(jnp.sum(inputs.robot.pi[:, 0])) if args.prior_mass is None else args.prior_mass
    )
    prior = Load(mass, args.prior_reach)
    observation = log_filter.in_newton_metres(raw, gains)
    if args.bias_window is not None:
        stage("start-up bias")
        bias = bias + _start_up_bias(args, robot, observation, bias, prior)
    stage("batch fit")
    fit = batch_fit.fit(robot, [raw], args.bodies, prior=prior, gains=gains, bias=bias)
    if not fit.converged:
        notes.append("the batch fit did not settle; its values are the last round's")
    stage("noise")
    noise, changed = log_filter.residual_noise(
        robot, observation, args.bodies, prior=prior, whole=fit, bias=bias
    )
    if changed:
        notes.append(
            "the bodies changed during the log: read the filter's estimates over time; the batch fit, which takes "
            "them for constant, means nothing here"
        )
    noise = noise / np.sqrt(log_filter.stride(raw, args.cutoff))
    if args.sigma_tau is not None:
        noise = _given_noise(args.sigma_tau, robot)
    stage("filter")
    gate = GATE if args.gate is None else args.gate
    trace = _filter(args, robot, observation, noise, prior, bias)
    time = np.asarray(log_filter.thinned(observation, args.cutoff).motion.time)
    if told := _between_reopenings(args.bodies, time, trace):
        notes.append(f"mass between the gate's reopenings: {told}")
    load = None
    if references and len(args.bodies) == 1:
        stage("load and calibration in one fit")
        load = _load_with_calibration(args, inputs, references, raw, start, prior)
    elif references:
        notes.append("intervals take the calibration for exact; with one body they do not")
    stage("what the log can tell")
    floor = np.maximum(fit.noise, 1e-9)
    known = knowledge(robot, observation, args.bodies, floor, prior=prior, bias=bias)
    return Result(
        bodies=tuple(args.bodies),
        robot=robot,
        findings=inputs.findings,
        notes=tuple(notes),
        observation=observation,
        trace=trace,
        time=time,
        physical=np.asarray(is_physical(trace.estimate.pi)),
        fit=fit,
        calibration=calibration,
        load=None if load is None else load.load,
        noise=noise,
        bias=bias,
        gains=gains,
        prior=prior,
        gate=gate,
        changed=changed,
        known=known,
        row_names=_row_names(robot),
    )


# Where the gate reopens more often the figure tells it better.
_TOLD = 5


def _between_reopenings(bodies: Sequence[str], time: Float[np.ndarray, " T"], trace: Trace) -> str:
    """What each body weighed between the gate's reopenings; nothing where it never reopened, or often."""
    at = np.flatnonzero(trace.reopened[1:]) + 1
    if not 0 < len(at) <= _TOLD:
        return ""
    mass, accepted = np.asarray(trace.estimate.pi[:, :, 0]), np.asarray(trace.innovation.accepted)
    ends = [f" kg until {time[k]:.1f} s, " for k in at] + [" kg since"]
    told = [f"{name} " for name in bodies]
    for spell, taken, end in zip(np.split(mass, at), np.split(accepted, at), ends, strict=True):
        # Rejected samples leave the estimate as it was, and the load as it no longer is.
        typical = np.median(spell[taken] if taken.any() else spell, axis=0)
        told = [text + f"{m:.3f}{end}" for text, m in zip(told, typical, strict=True)]
    return "; ".join(told)


def _calibrate(
    args,
    inputs: Inputs,
    observations: list[Observation],
    gains,
    carried: batch_fit.Carried | None = None,
) -> BatchFit:
    robot = inputs.robot
    unknown = inputs.log.tau_unit is not TorqueUnit.NEWTON_METRE
    usual = (0.5 if args.gains else 1.0) if unknown else 0.0
    return batch_fit.fit(
        robot,
        observations,
        prior=Tolerance(*args.trust),
        joint_terms=batch_fit.JOINT_TERMS,
        gains=gains,
        gain_sigma=usual if args.gain_sigma is None else args.gain_sigma,
        carried=carried,
    )


def _start_up_bias(args, robot: Robot, observation: Observation, bias, prior: Load) -> np.ndarray:
    time = np.asarray(observation.motion.time)
    rows = time <= time[0] + args.bias_window
    if rows.all():
        raise ValueError(
            f"--bias-window {args.bias_window:g} s covers the whole log ({time[-1] - time[0]:.3g} s); "
            "it must be the unloaded start of it"
        )
    estimator = log_filter.online(robot, args.bodies, np.ones(robot.nv), prior=prior)
    state = eqx.tree_at(lambda s: s.bias, estimator.initial(), jnp.asarray(bias))
    window = jax.tree.map(lambda x: x[rows], observation)
    return np.asarray(estimator.calibrate_bias(state, window).bias) - bias


def _given_noise(values: list[float], robot: Robot) -> np.ndarray:
    if len(values) not in (1, robot.nv):
        raise ValueError(
            f"{len(values)} values of --sigma-tau for {robot.nv} rows; give one for all, or one each"
        )
    return np.broadcast_to(np.asarray(values, float), (robot.nv,)).copy()


def _filter(args, robot: Robot, observation: Observation, noise, prior: Load, bias) -> Trace:
    nominal = robot.pi[np.array(resolve_bodies(robot, args.bodies))]
    chart = {
        "linear": charts.Linear,
        "log-cholesky": charts.LogCholesky,
        "log-cholesky-uut": charts.LogCholeskyUUt,
        "relative": lambda: charts.Relative.to(nominal),
    }[args.chart]()
    estimator = log_filter.online(
        robot,
        args.bodies,
        noise,
        prior=prior,
        chart=chart,
        gate=args.gate,
        reopen_after=args.reopen_after,
        iterations=args.iterations,
        drift_seconds=args.drift_time,
    )
    state = eqx.tree_at(lambda s: s.bias, estimator.initial(), jnp.asarray(bias))
    return log_filter.run(estimator, state, log_filter.thinned(observation, args.cutoff))[1]


def _load_with_calibration(
    args, inputs: Inputs, references: list[Observation], raw: Observation, gains, prior: Load
) -> BatchFit:
    """The load fitted in one problem with all that the calibration fits: its interval knows what that leaves open."""
    carried = batch_fit.Carried(args.bodies[0], (len(references),), prior)
    return _calibrate(args, inputs, [*references, raw], gains, carried)


def _row_names(robot: Robot) -> tuple[str, ...]:
    """A name for every row of the equations of motion: its joint's, with the component where there are several."""
    count = np.diff([*robot.joint_dofadr, robot.nv])
    parts = {
        1: [""],
        3: [" x", " y", " z"],
        6: [f" {k}" for k in ("x", "y", "z", "rx", "ry", "rz")],
    }
    names = zip(robot.joint_names, count, strict=True)
    return tuple(joint + part for joint, n in names for part in parts[int(n)])
