"""`estimate`: log → observations → calibration → batch fit → noise → filter → what the log can tell."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jax_inertia.dynamics.sparse_rows import moved_rows
from jax_inertia.estimation import batch_fit, joint_terms, log_filter
from jax_inertia.estimation.batch_fit import BatchFit
from jax_inertia.estimation.estimate_inputs import CHARTS, TOLERANCE, Inputs, Settings, checked
from jax_inertia.estimation.filter_settings import GATE
from jax_inertia.estimation.held_load import Considered, Held, Unknown, errors_of, with_constants
from jax_inertia.estimation.identifiability import knowledge
from jax_inertia.estimation.inertial_filter import Trace
from jax_inertia.estimation.joint_terms import JointTerms
from jax_inertia.estimation.log_estimate import LogEstimate
from jax_inertia.estimation.physical_estimate import ANY_SHAPE, Estimate, as_bodies
from jax_inertia.estimation.priors import Load, Tolerance
from jax_inertia.logs.log import Log, LogError
from jax_inertia.maths import charts
from jax_inertia.maths.inertial_parameters import is_physical
from jax_inertia.maths.precision import in_double_precision
from jax_inertia.model.robot import Robot
from jax_inertia.signals.differences import Observation
from jax_inertia.signals.holds import holds_note, holds_of
from jax_inertia.signals.misfit import misfit_notes, misfits
from jax_inertia.text.closest_names import listed
from jax_inertia.text.progress import shared


@in_double_precision
def estimate(
    robot: Robot,
    log: Log,
    bodies: Sequence[int | str],
    *,
    calibrate: Sequence[Log] | Log = (),
    gains: Sequence[float] | float | None = None,
    gain_sigma: float | None = None,
    trust: Sequence[float] = (0.1, 0.05),
    chart: charts.Chart | str = "log-cholesky-uut",
    gate: float | None = None,
    reopen_after: float | None = None,
    iterations: int | None = None,
    sigma_tau: Sequence[float] | float | None = None,
    prior_mass: float | None = None,
    prior_reach: float = 0.2,
    drift_time: float | None = None,
    cutoff: float | None = None,
    rate: float | None = None,
    bias_window: float | None = None,
    ignore: Sequence[str] = (),
    friction: bool | None = None,
    tolerance: Sequence[float] | None = None,
    progress: Callable[[str], None] = lambda stage: None,
) -> LogEstimate:
    """Inertial parameters of bodies from a log, over time and over the whole log: what `jax-inertia estimate` does.

    Torques that are no N m: `gains` in N m per logged unit (one for each joint of the log, or one for all), or
    `calibrate`, logs without load on which gains, friction, damping, armature, torque offsets and all bodies are fitted
    and then held; `gains` (default 10) is then where the fit starts, `gain_sigma` their relative uncertainty (default
    1, or 0.5 with gains), and `trust` how well the model is known: masses in parts, centres of mass in m.

    Filter: over π, whose most probable bodies are given; with a `chart` other than the default, itself or by its name
    in `CHARTS`, the extended filter in its coordinates (`make_estimator`), with so many `iterations` of each update
    (default 5). `gate` is the probability of keeping a good sample (default 0.9999; 1: no gate), which reopens after
    rejecting everything for `reopen_after` (default 0.5 s); `sigma_tau`, noise of one filtered sample [N m] (default:
    from residuals); the load to expect, `prior_mass` [kg] (default: a tenth of the robot) within `prior_reach` [m], by
    which bodies may drift in `drift_time` (default 3600 s; 3 without gate).

    Signals: low-pass at `cutoff` (default 10 Hz, at most a fifth of the log's rate) on a grid of `rate` (default: ten
    times the cutoff, or the log's); the mean residual of the first `bias_window` seconds, when nothing is carried, is
    the torques' offset. Velocities that contradict positions are left out; `ignore=["qvel"]` leaves them out anyway.

    What the model may lack or be off by: `friction` of every joint, viscous and dry, and its torque's offset are fitted
    with the bodies (default: where the log's own residual shows them; a log with `calibrate` has them from there), and
    `tolerance` is how well links are known: masses in parts, centres of mass in m, radii of gyration in parts (all
    zero: exactly). By default a model that `diagnose` corrected says so itself (`Robot.errors`), and of any other it is
    (0.02, 0.001, 0.05). Intervals contain what these leave open.

    `progress` is called with the text of each stage as it begins; its `share` is the part of the work that is usually
    done by then. Computed in double precision, whatever JAX is set to. Raises ValueError for a body or a setting that
    cannot be, and LogError for a log that cannot be used.

    >>> import jax_inertia as ji
    >>> from jax_inertia.robots.pendulum import double_pendulum, swing
    >>> found = ji.estimate(ji.load_model(double_pendulum()), swing(load=0.5), ["lower"])
    >>> bool(abs(found.pi["lower"][0] - 1.5) < 0.05)  # 1 kg of link, 0.5 kg of load
    True
    """
    settings = Settings(
        gains=gains,
        gain_sigma=gain_sigma,
        trust=trust,
        chart=chart,
        gate=gate,
        reopen_after=reopen_after,
        iterations=iterations,
        sigma_tau=sigma_tau,
        prior_mass=prior_mass,
        prior_reach=prior_reach,
        drift_time=drift_time,
        cutoff=cutoff,
        rate=rate,
        bias_window=bias_window,
        ignore=ignore,
        friction=friction,
        tolerance=tolerance,
    )
    references = [calibrate] if isinstance(calibrate, Log) else calibrate
    return run(
        checked(robot.astype("float64"), log, bodies, references, settings), shared(progress)
    )


def run(inputs: Inputs, progress: Callable[[str], None]) -> LogEstimate:
    """`estimate` of what was looked at; `progress` hears which stage begins."""
    settings, bodies, notes = inputs.settings, inputs.bodies, []
    progress("resampling, low-pass, differences")
    start = _without_load(inputs, progress)
    robot, prior, bias = start.robot, _prior(inputs), start.bias
    observation = log_filter.in_newton_metres(start.raw, start.gains)
    if start.calibration is not None and not start.calibration.converged:
        notes.append("the calibration did not settle; its parameters are the last round's")
    if settings.bias_window is not None:
        progress("start-up bias")
        bias = bias + _start_up_bias(inputs, robot, observation, bias, prior)
    unknown = _unknown(inputs, robot, observation, prior, bias)
    if unknown.joints is not None and holds_of(observation) is None:
        kept = [
            log_filter.without_reversals(x, robot, unknown.joints) for x in (start.raw, observation)
        ]
        start, observation = start._replace(raw=kept[0]), kept[1]
    progress("batch fit")
    fit = _fit(inputs, start, prior, bias, unknown)
    if not fit.converged:
        notes.append("the batch fit did not settle; its values are the last round's")
    progress("noise")
    noise, changed = _noise(inputs, robot, observation, prior, fit, bias, unknown.joints)
    progress("filter")
    thinned = _thinned(inputs, robot, observation)
    held = Held.of(robot, observation, bodies, prior, bias, unknown, settings.cutoff)
    trace, considered = _filter(inputs, robot, thinned, held, noise, prior, bias, unknown.joints)
    load = _load_with_calibration(inputs, start, prior, progress)
    progress("what the log can tell")
    found = LogEstimate(
        bodies=bodies,
        robot=robot,
        findings=inputs.findings,
        notes=(*_tied(robot, bodies), *notes),
        observation=observation,
        trace=trace,
        time=np.asarray(thinned.motion.time),
        physical=np.asarray(is_physical(trace.estimate.pi)),
        fit=fit,
        calibration=start.calibration,
        load=load,
        noise=noise,
        bias=bias,
        gains=start.gains,
        prior=prior,
        gate=GATE if settings.gate is None else settings.gate,
        changed=changed,
        known=knowledge(
            robot, observation, bodies, np.maximum(fit.noise, 1e-9), prior=prior, bias=bias
        ),
        held=holds_of(observation) is not None,
        friction=unknown.joints is not None,
        considered=considered,
        held_p=held.p_values(trace, noise),
        row_names=_row_names(robot),
        settings={f.name: getattr(settings, f.name) for f in dataclasses.fields(settings)},
    )
    return dataclasses.replace(found, notes=(*found.notes, *_notes(inputs, start, found)))


def _notes(inputs: Inputs, start: "_WithoutLoad", found: LogEstimate) -> list[str]:
    """What is to be said of the estimate."""
    notes, changed = [_CHANGED] if found.changed else [], found.changed
    residual = _residual_of(found, inputs.settings.cutoff)
    notes += misfit_notes(misfits(*residual), found.row_names)
    if (holds := holds_of(found.observation)) is not None:
        notes.append(holds_note(holds, found.fit.rms_after, found.row_names))
    between = _between_reopenings(found.bodies, found.time, found.trace)
    if (holds is None or changed) and between:
        notes.append(f"mass between the gate's reopenings: {between}")
    if start.references and found.load is None:
        notes.append("intervals take the calibration for exact; with one body they do not")
    return [*notes, *found.disagreements]


# Frames of a URDF weigh next to nothing, and nobody puts a load on them.
_FRAME = 1e-6  # kg


def _tied(robot: Robot, bodies: Sequence[str]) -> list[str]:
    """Where a body that was asked for is one with others."""
    mass = dict(zip(robot.body_names, np.asarray(robot.pi)[:, 0], strict=True))
    told = []
    for body in bodies:
        if others := [name for name in robot.rigid_with(body) if mass[name] > _FRAME]:
            are = "is" if len(others) == 1 else "are"
            told.append(
                f"{listed(others)} {are} fixed to {body} without a joint: no torque tells whose a load is; mass and "
                f"centre are given as {body}'s, in its frame"
            )
    return told


_CHANGED = (
    "the bodies changed during the log: read the filter's estimates over time; the batch fit, which takes them for "
    "constant, means nothing here"
)


class _WithoutLoad(NamedTuple):
    """What is held while the load is estimated, and the observations that it was taken from."""

    robot: Robot
    gains: Float[np.ndarray, " nv"]
    bias: Float[np.ndarray, " nv"]
    calibration: BatchFit | None
    raw: Observation
    """Of the log, torques in its own unit."""
    references: list[Observation]


def _without_load(inputs: Inputs, progress: Callable[[str], None]) -> _WithoutLoad:
    """The log's observations, and what the logs without load say: gains, offsets, all that is not asked for."""
    robot, raw, bias = inputs.robot, _observe(inputs, inputs.log), np.zeros(inputs.robot.nv)
    _require_rows(inputs, raw)
    if not inputs.references:
        if holds_of(raw) is None:
            raw = log_filter.without_reversals(raw, robot)
        return _WithoutLoad(robot, _first_gains(inputs), bias, None, raw, [])
    progress("calibrating on the logs without load")
    references = [_observe(inputs, one) for one in inputs.references]
    raw, *references = [log_filter.without_slow_rows(one, robot) for one in (raw, *references)]
    fit = _calibrate(inputs, references)
    # The bodies asked for start at the model's own: calibrated ones may be as thin as rods, where charts end.
    chosen = inputs.chosen
    robot = fit.robot.with_pi(chosen, robot.pi[np.array(chosen)])
    return _WithoutLoad(robot, fit.gains, fit.bias, fit, raw, references)


def _require_rows(inputs: Inputs, observation: Observation) -> None:
    """LogError where a body hangs on legs whose torques went into the forces at their feet."""
    if inputs.log.contact_wrench is not None or observation.motion.wrench is None:
        return
    used_up = ~np.asarray(observation.motion.valid).any(axis=0)
    rows = inputs.robot.topology.body_dof[:, used_up]
    names = [n for n, k in zip(inputs.bodies, inputs.chosen, strict=True) if rows[k].any()]
    if names:
        raise LogError(
            f"no contact_wrench: the torques of the legs that stand give the forces at their feet, and nothing of "
            f"{', '.join(names)} on them; estimate what the legs carry, or log the wrenches"
        )


def _observe(inputs: Inputs, log: Log) -> Observation:
    settings = inputs.settings
    return log_filter.observe(
        log,
        inputs.robot,
        rate=settings.rate,
        cutoff=settings.cutoff,
        any_unit=not inputs.in_newton_metres,
    )


def _first_gains(inputs: Inputs) -> Float[np.ndarray, " nv"]:
    """Gains as given, or where their fit starts."""
    given = inputs.settings.gains
    usual = 1.0 if inputs.in_newton_metres else 10.0
    return log_filter.joint_gains(inputs.log, inputs.robot, usual if given is None else given)


def _calibrate(
    inputs: Inputs, observations: list[Observation], carried: batch_fit.Carried | None = None
) -> BatchFit:
    settings = inputs.settings
    usual = 0.0 if inputs.in_newton_metres else 1.0 if settings.gains is None else 0.5
    return batch_fit.fit(
        inputs.robot,
        observations,
        prior=Tolerance(*settings.trust),
        joint_terms=batch_fit.JOINT_TERMS,
        gains=_first_gains(inputs),
        gain_sigma=usual if settings.gain_sigma is None else settings.gain_sigma,
        carried=carried,
    )


def _prior(inputs: Inputs) -> Load:
    given = inputs.settings.prior_mass
    mass = 0.1 * float(jnp.sum(inputs.robot.pi[:, 0])) if given is None else given
    return Load(mass, inputs.settings.prior_reach)


def _start_up_bias(
    inputs: Inputs, robot: Robot, observation: Observation, bias: np.ndarray, prior: Load
) -> np.ndarray:
    """What the mean residual of the log's unloaded start adds to the bias."""
    time, window = np.asarray(observation.motion.time), inputs.settings.bias_window
    assert window is not None
    rows = time <= time[0] + window
    if rows.all():
        raise ValueError(
            f"{inputs.option('bias_window')} {window:g} s covers the whole log ({time[-1] - time[0]:.3g} s); "
            "it must be the unloaded start of it"
        )
    estimator = log_filter.online(robot, inputs.bodies, np.ones(robot.nv), prior=prior)
    state = eqx.tree_at(lambda s: s.bias, estimator.initial(), jnp.asarray(bias))
    unloaded = jax.tree.map(lambda x: x[rows], observation)
    return np.asarray(estimator.calibrate_bias(state, unloaded).bias) - bias


def _unknown(
    inputs: Inputs, robot: Robot, observation: Observation, prior: Load, bias: np.ndarray
) -> Unknown:
    """What is estimated or considered with the bodies; nothing after a calibration, which has fitted it."""
    settings = inputs.settings
    joints = joint_terms.of_log(
        robot, np.asarray(observation.motion.tau), np.asarray(observation.motion.v)
    )
    wanted = settings.friction
    if wanted is None:
        wanted = not inputs.references and log_filter.shows_friction(
            robot, observation, inputs.bodies, joints, prior=prior, bias=bias
        )
    errors, tolerance = None, settings.tolerance
    if tolerance is None and robot.errors is None:
        tolerance = TOLERANCE
    if not inputs.references and (tolerance is None or any(tolerance)):
        # A number that is known exactly is known to a part in a million: factors need one.
        stated = None if tolerance is None else Tolerance(*np.maximum(tolerance, 1e-6))
        errors = errors_of(robot, inputs.bodies, stated)
    sigma = 0.0 if inputs.references or settings.gains is None else settings.gain_sigma or 0.0
    return Unknown(joints if wanted else None, errors, sigma)


def _fit(
    inputs: Inputs,
    start: _WithoutLoad,
    prior: Load,
    bias: np.ndarray,
    unknown: Unknown,
) -> BatchFit:
    """Constant bodies, with what is unknown besides."""
    return batch_fit.fit(
        start.robot,
        [start.raw],
        inputs.bodies,
        prior=Load(prior.mass, prior.reach, ANY_SHAPE),
        gains=start.gains,
        gain_sigma=unknown.gain_sigma,
        bias=bias,
        joints=unknown.joints,
        errors=unknown.errors,
    )


def _noise(
    inputs: Inputs,
    robot: Robot,
    observation: Observation,
    prior: Load,
    fit: BatchFit,
    bias: np.ndarray,
    joints: JointTerms | None,
) -> tuple[np.ndarray, bool]:
    """Noise of one sample as the filter gets it, and whether the bodies changed during the log."""
    noise, changed = log_filter.residual_noise(
        robot, observation, inputs.bodies, prior=prior, whole=fit, bias=bias, joints=joints
    )
    if (given := inputs.settings.sigma_tau) is None:
        return noise / np.sqrt(log_filter.stride(observation, inputs.settings.cutoff)), changed
    return np.broadcast_to(np.asarray(given, float), (robot.nv,)).copy(), changed


def _thinned(inputs: Inputs, robot: Robot, observation: Observation) -> Observation:
    """Samples of the filter, without the rows that the bodies do not move, whose own friction it does not know."""
    moved = np.isin(np.arange(robot.nv), moved_rows(robot, inputs.chosen))
    thinned = log_filter.thinned(observation, inputs.settings.cutoff)
    valid = np.asarray(thinned.motion.valid) & moved
    return eqx.tree_at(lambda o: o.motion.valid, thinned, valid)


def _filter(
    inputs: Inputs,
    robot: Robot,
    thinned: Observation,
    held: Held,
    noise: np.ndarray,
    prior: Load,
    bias: np.ndarray,
    joints: JointTerms | None,
) -> tuple[Trace, Considered]:
    """Bodies over time, and what is known of them at the end."""
    settings, chart, pi = inputs.settings, inputs.settings.chart, robot.pi[np.array(inputs.chosen)]
    if isinstance(chart, str):
        chart = CHARTS[chart](pi)
    over_pi = isinstance(chart, charts.LogCholeskyUUt)
    seen = np.zeros((held.more.shape[2], 0))
    if over_pi:
        # No linearisation grows old there; `as_bodies` makes bodies of what is found.
        chart = charts.Linear()
        seen = held.seen(np.asarray(thinned.motion.valid), np.maximum(noise, 1e-9))
    estimator = log_filter.online(
        robot,
        inputs.bodies,
        noise,
        prior=prior,
        chart=chart,
        gate=settings.gate,
        reopen_after=settings.reopen_after,
        iterations=settings.iterations,
        drift_seconds=settings.drift_time,
        joints=joints,
    )
    estimator = with_constants(estimator, seen.shape[1])
    state = eqx.tree_at(lambda s: s.bias, estimator.initial(), jnp.asarray(bias))
    state, trace = log_filter.run(estimator, state, thinned, held.of_constants(seen))
    considered = held.considered(estimator, state.belief, trace, noise, seen)
    if over_pi:
        physical = as_bodies(trace.estimate, trace.covariance, prior.anchor(pi))
        trace = eqx.tree_at(lambda t: t.estimate, trace, physical)
    return trace, considered


def _load_with_calibration(
    inputs: Inputs, start: _WithoutLoad, prior: Load, progress: Callable[[str], None]
) -> Estimate | None:
    """The load fitted in one problem with all that the calibration fits: its interval knows what that leaves open.

    None without a calibration, and for several bodies.
    """
    if not start.references or len(inputs.bodies) != 1:
        return None
    progress("load and calibration in one fit")
    carried = batch_fit.Carried(inputs.bodies[0], (len(start.references),), prior)
    return _calibrate(inputs, [*start.references, start.raw], carried).load


def _residual_of(
    found: LogEstimate, cutoff: float | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(residual, torque, which rows count) of independent samples: of the fit, or of the filter if bodies changed."""
    observation, trace = found.observation, found.trace
    step = log_filter.stride(observation, cutoff)
    y, others, valid = log_filter.regressors(found.robot, observation, found.bodies, found.bias)
    residual = others + y @ np.asarray(found.fit.estimate.pi).ravel()
    if found.friction:
        # The fit's own friction and offset act on the motor's side.
        terms = [found.fit.joint_terms[name] for name in joint_terms.NAMES]
        columns = joint_terms.columns(np.asarray(observation.motion.v))
        residual = residual + np.where(valid, np.einsum("tjk,kj->tj", columns, terms), 0.0)
    residual, valid = residual[::step], valid[::step]
    torque = np.nan_to_num(np.asarray(observation.motion.tau))[::step]
    if found.changed:
        # An innovation is measured minus predicted torque.
        residual = -np.asarray(trace.innovation.residual)
        valid = valid & np.asarray(trace.innovation.accepted)[:, None] & (residual != 0)
    return residual, torque, valid


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
