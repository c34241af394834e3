"""From a log to an estimate: the one pipeline that the command line, the demo and the benchmarks share.

    observation = observe(log, robot)                      # resampled, low-passed, differentiated: 100 Hz
    fit = batch.fit(robot, [observation], ["hand"], prior=prior)
    noise, changed = residual_noise(robot, observation, ["hand"], prior=prior, whole=fit)
    estimator = online(robot, ["hand"], noise / stride(observation) ** 0.5, prior=prior)
    state, trace = run(estimator, estimator.initial(), thinned(observation))

Two rates: differences need samples much denser than the motion, a filter needs samples whose noise is independent.
So the log is low-passed to 10 Hz, differentiated at ten times that, and filtered at twice that, where neighbours carry
separate news (a log slower than 100 Hz: `bands`). Fed at the full rate, a χ² gate sees a
fifth of the innovation that it is entitled to, and sleeps.
"""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jax_inertia.dynamics.rigid_body import resolve_bodies
from jax_inertia.estimation import pieces
from jax_inertia.estimation.batch_fit import BatchFit
from jax_inertia.estimation.inertial_filter import Estimator, State, Trace, make_estimator
from jax_inertia.estimation.joint_terms import JointTerms
from jax_inertia.estimation.priors import Load
from jax_inertia.logs.log import Log, LogError
from jax_inertia.maths import charts
from jax_inertia.model.robot import HINGE, Robot
from jax_inertia.preflight.preflight import require_usable
from jax_inertia.signals.bands import ESTIMATE, of_estimate
from jax_inertia.signals.differences import Observation
from jax_inertia.signals.holds import holds_of
from jax_inertia.signals.torque_residual import observed, on_the_ground, torque_residuals


def observe(
    log: Log,
    robot: Robot,
    *,
    rate: float | None = None,
    cutoff: float | None = None,
    any_unit: bool = False,
) -> Observation:
    """A log as observations on a uniform grid of `rate` [Hz] (default: ten times `cutoff`, at most the log's own).

    Every channel passes one zero-phase low-pass of `cutoff` [Hz] (default: 10, at most a fifth of `rate`). Torques are
    in N m; those of `any_unit` stay in the log's own, for `batch_fit.fit(gains=...)` or `in_newton_metres`. One
    period of the cutoff is cut off at both ends, where the filter rings. What carries a floating base of a log without
    contact_wrench is taken from its legs' torques, in N m (`base_motion`). Raises LogError for a log that is not of
    this robot or not measured (`preflight.require_usable`), ValueError for rates that do not fit it, and where too
    little is left.

    >>> from jax_inertia import load_model
    >>> from jax_inertia.estimation import log_filter
    >>> from jax_inertia.robots.pendulum import double_pendulum, swing
    >>> robot = load_model(double_pendulum())
    >>> log = log_filter.observe(swing(load=0.5), robot)
    >>> log.a.shape, round(float(log.motion.time[0]), 2)
    ((378, 2), 0.11)
    """
    require_usable(log, robot, any_unit=any_unit)
    bands = of_estimate(round(log.rate, 6), rate, cutoff)
    whole = observed(log, robot, bands)
    edge = int(np.ceil(bands.grid / bands.before))
    if len(whole.a) < 2 * edge + 20:
        raise LogError(
            f"{log.duration:.3g} s of log at {bands.grid:g} Hz are too short for a low-pass of {bands.before:g} Hz; "
            "raise the cutoff or record longer"
        )
    observation = jax.tree.map(lambda x: x[edge:-edge], whole)
    if robot.has_free_base and log.contact_wrench is None and not any_unit:
        observation = on_the_ground(robot, observation, log, 1.0 / bands.before)
    if not np.any(observation.motion.valid):
        raise LogError(
            "no sample is complete (position, velocity and torque all finite); nothing to fit"
        )
    return observation


SLOW = 0.1
"""Speed [rad/s] below which dry friction is not at its kinetic level, its reversal low-passed to 10 Hz; not swept."""


def without_slow_rows(observation: Observation, robot: Robot, slowest: float = SLOW) -> Observation:
    """The same with rows of hinges slower than `slowest` [rad/s] masked: dry friction is below its kinetic level there.

    For robots whose friction was fitted; sensors on the link side do not see it.

    >>> from jax_inertia import load_model
    >>> from jax_inertia.estimation import log_filter
    >>> from jax_inertia.robots.pendulum import double_pendulum, swing
    >>> robot = load_model(double_pendulum())
    >>> log = log_filter.observe(swing(load=0.5), robot)
    >>> faster = log_filter.without_slow_rows(log, robot, slowest=0.5)
    >>> bool(faster.motion.valid.sum() < log.motion.valid.sum())
    True
    """
    top = robot.topology
    hinge = np.array(top.kind)[top.dof_node] == HINGE
    slow = hinge & (np.abs(np.asarray(observation.motion.v)) < slowest)
    valid = np.asarray(observation.motion.valid) & ~slow
    return eqx.tree_at(lambda o: o.motion.valid, observation, valid)


def without_reversals(
    observation: Observation, robot: Robot, joints: JointTerms | None = None
) -> Observation:
    """The same without the slow rows of hinges that have dry friction and are faster most of the time.

    Dry friction by the model, or with `joints` of a size that is estimated. Where a joint turns round, its friction
    depends on what drives it and not on its speed alone, and the low-pass has spread the jump of its torque: an error
    that goes with the load, since it is at the ends of each motion that it comes.

    >>> from jax_inertia import load_model
    >>> from jax_inertia.estimation import log_filter
    >>> from jax_inertia.robots.pendulum import double_pendulum, swing
    >>> robot = load_model(double_pendulum())  # without dry friction
    >>> log = log_filter.observe(swing(load=0.5), robot)
    >>> bool(log_filter.without_reversals(log, robot).motion.valid.all())
    True
    """
    fast = np.median(np.abs(np.asarray(observation.motion.v)), axis=0) > SLOW
    dry = np.asarray(robot.frictionloss) + (
        0.0 if joints is None else np.asarray(joints.sigma)[:, 1]
    )
    rubs = fast & (dry > 0)
    valid = without_slow_rows(observation, robot).motion.valid
    kept = np.where(rubs, valid, observation.motion.valid)
    return eqx.tree_at(lambda o: o.motion.valid, observation, kept)


def stride(observation: Observation, cutoff: float | None = None) -> int:
    """How many samples of the grid one independent sample spans: rate / (2 cutoff), at least one.

    `cutoff` as given to `observe` [Hz].

    >>> from jax_inertia import load_model
    >>> from jax_inertia.estimation import log_filter
    >>> from jax_inertia.robots.pendulum import double_pendulum, swing
    >>> robot = load_model(double_pendulum())
    >>> log = log_filter.observe(swing(load=0.5), robot)
    >>> log_filter.stride(log)
    5
    """
    period = float(np.median(np.diff(np.asarray(observation.motion.time))))
    cutoff = ESTIMATE.on(1.0 / period).cutoff if cutoff is None else cutoff
    return max(1, int(0.5 / (period * cutoff) + 1e-6))


def thinned(observation: Observation, cutoff: float | None = None) -> Observation:
    """Every `stride`-th observation: twice the cutoff, the rate that filters run at.

    >>> from jax_inertia import load_model
    >>> from jax_inertia.estimation import log_filter
    >>> from jax_inertia.robots.pendulum import double_pendulum, swing
    >>> robot = load_model(double_pendulum())
    >>> log = log_filter.observe(swing(load=0.5), robot)
    >>> log_filter.thinned(log).a.shape
    (76, 2)
    """
    step = stride(observation, cutoff)
    return jax.tree.map(lambda x: x[::step], observation)


def joint_gains(
    log: Log, robot: Robot, gains: Sequence[float] | Float[np.ndarray, " n"] | float
) -> Float[np.ndarray, " nv"]:
    """Drive gains in the log's order of joints (or one for all) as gains of the robot's rows; 1 on all others.

    >>> from jax_inertia import load_model
    >>> from jax_inertia.estimation import log_filter
    >>> from jax_inertia.robots.pendulum import double_pendulum, swing
    >>> log_filter.joint_gains(swing(), load_model(double_pendulum()), [10.0, 4.0])
    array([10.,  4.])
    """
    values = np.asarray(gains, float)
    if values.size not in (1, len(log.joint_names)):
        raise ValueError(
            f"{values.size} gains for {len(log.joint_names)} joints; give one for all, or one each for "
            + ", ".join(log.joint_names)
        )
    if not np.all(np.isfinite(values)) or np.any(values == 0):
        raise ValueError(f"gains are {values}; each must be a number other than zero")
    out = np.ones(robot.nv)
    values = np.broadcast_to(values.ravel(), (len(log.joint_names),))
    for name, gain in zip(log.joint_names, values, strict=True):
        out[robot.joint_dofadr[robot.joint_index(name)]] = gain
    return out


def in_newton_metres(observation: Observation, gains: Float[np.ndarray, " nv"]) -> Observation:
    """Observations with torques τ = gain · logged.

    >>> from jax_inertia import load_model
    >>> from jax_inertia.estimation import log_filter
    >>> from jax_inertia.robots.pendulum import double_pendulum, swing
    >>> robot = load_model(double_pendulum())
    >>> log = log_filter.observe(swing(load=0.5), robot)
    >>> import numpy as np
    >>> twice = log_filter.in_newton_metres(log, np.array([2.0, 2.0]))
    >>> bool(np.allclose(twice.motion.tau, 2 * log.motion.tau))
    True
    """
    return eqx.tree_at(
        lambda o: o.motion.tau, observation, np.asarray(observation.motion.tau) * gains
    )


# A log is filtered in a tenth of a second; compiling takes ten. Without optimisation it takes two thirds of that.
_QUICK = {"xla_backend_optimization_level": 0}
_residuals = eqx.filter_jit(torque_residuals, compiler_options=_QUICK)  # pyright: ignore[reportCallIssue]


def regressors(
    robot: Robot,
    observation: Observation,
    bodies: Sequence[int | str],
    bias: Float[np.ndarray, " nv"] | None = None,
) -> tuple[Float[np.ndarray, "T nv n"], Float[np.ndarray, "T nv"], np.ndarray]:
    """(Y^est with n = 10 × bodies, residual y, which rows to use) of every observation, zero where not to be used.

    >>> from jax_inertia import load_model
    >>> from jax_inertia.estimation import log_filter
    >>> from jax_inertia.robots.pendulum import double_pendulum, swing
    >>> robot = load_model(double_pendulum())
    >>> log = log_filter.observe(swing(load=0.5), robot)
    >>> y, residual, valid = log_filter.regressors(robot, log, ["lower"])
    >>> y.shape, residual.shape, bool(valid.all())
    ((378, 2, 10), (378, 2), True)
    """
    chosen = resolve_bodies(robot, bodies)
    bias = np.zeros(robot.nv) if bias is None else bias
    y, residual = (np.asarray(x) for x in _residuals(robot, observation, chosen, jnp.asarray(bias)))
    y = y.reshape(*residual.shape, -1)
    valid = np.asarray(observation.motion.valid) & np.isfinite(residual) & np.isfinite(y).all(-1)
    return np.where(valid[..., None], y, 0.0), np.where(valid, residual, 0.0), valid


def residual_noise(
    robot: Robot,
    observation: Observation,
    bodies: Sequence[int | str],
    *,
    prior: Load,
    whole: BatchFit,
    bias: Float[np.ndarray, " nv"] | None = None,
    joints: JointTerms | None = None,
) -> tuple[Float[np.ndarray, " nv"], bool]:
    """Noise of one observation [N m, N], its correlation time taken in, and whether the bodies changed meanwhile.

    `whole` is the fit of constant bodies to this log (with `joints`, where it has those); its `noise` is the answer
    unless bodies changed, when its residual holds the change itself. So bodies are fitted to pieces of two seconds too
    (ridge regression, which is enough to see its residual); where the median piece has far less than the whole, its
    noise is taken instead. In a log that rests in one pose after another, dry friction is left out of that comparison
    (`holds`), and is noise.

    >>> from jax_inertia import load_model
    >>> from jax_inertia.estimation import batch_fit, log_filter
    >>> from jax_inertia.estimation.priors import Load
    >>> from jax_inertia.robots.pendulum import double_pendulum, swing
    >>> robot = load_model(double_pendulum())
    >>> log = log_filter.observe(swing(load=0.5), robot)
    >>> found = batch_fit.fit(robot, [log], ["lower"], prior=Load(1.0))
    >>> noise, changed = log_filter.residual_noise(robot, log, ["lower"], prior=Load(1.0), whole=found)
    >>> bool((noise < 0.05).all()), changed
    (True, False)
    """
    rows, parts = in_pieces(robot, observation, bodies, prior, bias)
    if len(parts) < 3:
        return whole.noise, False
    if (holds := holds_of(observation)) is not None:
        after = whole.rms_after
        return whole.noise, pieces.changed_between_holds(rows, after, holds, parts)
    if joints is not None:
        rows = rows.with_joints(joints, np.asarray(observation.motion.v))
    rms, noise = pieces.of_each(rows, parts, whole.rms_after)
    changed = bool(np.any(whole.rms_after > pieces.CHANGED * np.where(rms > 0, rms, np.inf)))
    use = changed & np.isfinite(noise)
    return np.where(use, np.minimum(noise, whole.noise), whole.noise), changed


def shows_friction(
    robot: Robot,
    observation: Observation,
    bodies: Sequence[int | str],
    joints: JointTerms,
    *,
    prior: Load,
    bias: Float[np.ndarray, " nv"] | None = None,
) -> bool:
    """Whether a log's own residual shows friction or offsets that the model lacks: by the evidence of most pieces.

    Pieces of two seconds, each with bodies of its own, so that a load taken up meanwhile is no friction. False for a
    log that rests in one pose after another, whose friction is a constant of each pose (`signals.holds`).

    >>> from jax_inertia import load_model
    >>> from jax_inertia.estimation import joint_terms, log_filter
    >>> from jax_inertia.estimation.priors import Load
    >>> from jax_inertia.robots.pendulum import double_pendulum, swing
    >>> robot = load_model(double_pendulum())
    >>> log = log_filter.observe(swing(load=0.5), robot)
    >>> joints = joint_terms.of_log(robot, log.motion.tau, log.motion.v)
    >>> log_filter.shows_friction(robot, log, ["lower"], joints, prior=Load(1.0))
    False
    """
    if holds_of(observation) is not None:
        return False
    rows, parts = in_pieces(robot, observation, bodies, prior, bias)
    parts = parts or [slice(None)]
    wide = rows.with_joints(joints, np.asarray(observation.motion.v))
    count = np.maximum(rows.valid.sum(axis=0), 1)
    size = np.sqrt(np.sum(rows.residual**2, axis=0, where=rows.valid) / count)
    noise = pieces.of_each(wide, parts, size)[1]
    noise = np.where(np.isfinite(noise), noise, np.inf)
    gain = [wide.evidence(part, noise) - rows.evidence(part, noise) for part in parts]
    return float(np.median(gain)) > 0.0


def in_pieces(
    robot: Robot,
    observation: Observation,
    bodies: Sequence[int | str],
    prior: Load,
    bias: Float[np.ndarray, " nv"] | None,
) -> tuple[pieces.LinearRows, list[slice]]:
    """What the bodies' deviation from the model has to explain, and the log's pieces.

    >>> from jax_inertia import load_model
    >>> from jax_inertia.estimation import log_filter
    >>> from jax_inertia.estimation.priors import Load
    >>> from jax_inertia.robots.pendulum import double_pendulum, swing
    >>> robot = load_model(double_pendulum())
    >>> log = log_filter.observe(swing(load=0.5), robot)
    >>> rows, parts = log_filter.in_pieces(robot, log, ["lower"], Load(1.0), None)
    >>> rows.columns.shape, len(parts)
    ((378, 2, 10), 1)
    """
    y, others, valid = regressors(robot, observation, bodies, bias)
    nominal = np.asarray(robot.pi)[list(resolve_bodies(robot, bodies))].ravel()
    sigma = np.broadcast_to(np.asarray(prior.sigma_pi()), (len(nominal) // 10, 10)).ravel()
    period = float(np.median(np.diff(np.asarray(observation.motion.time))))
    return pieces.LinearRows(y, others + y @ nominal, valid, sigma), pieces.cut(len(y), period)


def online(
    robot: Robot,
    bodies: Sequence[int | str],
    noise: Float[np.ndarray, " nv"],
    *,
    prior: Load,
    chart: charts.Chart | None = None,
    gate: float | None = None,
    reopen_after: float | None = None,
    iterations: int | None = None,
    drift_seconds: float | None = None,
    joints: JointTerms | None = None,
) -> Estimator:
    """The filter of a log: `make_estimator` with its defaults.

    `noise` is that of one sample as the filter gets it (see `thinned`), `prior` the load expected. Raises ValueError as
    `make_estimator` does.

    >>> import numpy as np
    >>> from jax_inertia import load_model
    >>> from jax_inertia.estimation import log_filter
    >>> from jax_inertia.estimation.priors import Load
    >>> from jax_inertia.robots.pendulum import double_pendulum, swing
    >>> robot = load_model(double_pendulum())
    >>> log = log_filter.observe(swing(load=0.5), robot)
    >>> ekf = log_filter.online(robot, ["lower"], np.full(2, 0.02), prior=Load(1.0))
    >>> ekf.bodies, ekf.iterations
    ((1,), 5)
    """
    return make_estimator(
        robot,
        bodies,
        sigma_tau=jnp.asarray(noise),
        prior=prior,
        drift=drift_seconds,
        chart=chart,
        gate=gate,
        reopen_after=reopen_after,
        iterations=iterations,
        joints=joints,
    )


_run = eqx.filter_jit(Estimator.run, compiler_options=_QUICK)  # pyright: ignore[reportCallIssue]


def run(
    estimator: Estimator,
    state: State,
    observations: Observation,
    of_constants: Float[np.ndarray, "T nv k"] | None = None,
) -> tuple[State, Trace]:
    """`Estimator.run`, compiled.

    >>> import numpy as np
    >>> from jax_inertia import load_model
    >>> from jax_inertia.estimation import log_filter
    >>> from jax_inertia.estimation.priors import Load
    >>> from jax_inertia.robots.pendulum import double_pendulum, swing
    >>> robot = load_model(double_pendulum())
    >>> log = log_filter.observe(swing(load=0.5), robot)
    >>> ekf = log_filter.online(robot, ["lower"], np.full(2, 0.05), prior=Load(1.0), gate=1.0)
    >>> state, trace = log_filter.run(ekf, ekf.initial(), log_filter.thinned(log))
    >>> mass, sigma = trace.estimate.pi[-1, 0, 0], trace.estimate.sigma_pi[-1, 0, 0]
    >>> bool(abs(mass - 1.5) < 2 * sigma < 1.0)  # 1 kg of link, 0.5 kg of load
    True
    """
    return _run(estimator, state, observations, of_constants=of_constants)
