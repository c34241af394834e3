"""The inertial Kalman filter of the paper: a belief about a few bodies, updated by one torque sample at a time.

    estimator = make_estimator(robot, ["forearm"], sigma_tau=0.5)
    state = estimator.initial()
    state, step = eqx.filter_jit(estimator.step)(state, observation, dt)
    estimator.estimate(state.belief).pi                                   # (bodies, 10)

By default it is what was measured to work on logs and in simulation loops: coordinates U Uᵀ, five iterations, a χ²
gate that reopens, little drift. With `paper=True` it is the filter of Foster et al. to the letter: UᵀU, one iteration,
no gate unless given; with `chart=Linear()` besides, their baseline Kalman filter.
"""

from collections.abc import Callable, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.linalg import block_diag
from jaxtyping import Array, Bool, Float

from jax_inertia.dynamics.rigid_body import resolve_bodies
from jax_inertia.dynamics.sparse_rows import moved_rows
from jax_inertia.estimation import filter_settings as settings
from jax_inertia.estimation.joint_terms import FoundTerms, JointTerms, with_terms
from jax_inertia.estimation.physical_estimate import Estimate, own_blocks, physical_units
from jax_inertia.estimation.priors import Load, Uncertainty
from jax_inertia.maths import charts, kalman
from jax_inertia.maths.argument_checks import floats_as
from jax_inertia.maths.gates import ChiSquaredGate, Gate, Reopening
from jax_inertia.maths.noise import IndependentNoise, Noise
from jax_inertia.maths.precision import in_full_precision
from jax_inertia.maths.row_runs import spread_rows, take_rows
from jax_inertia.model.robot import Robot
from jax_inertia.signals.differences import Observation
from jax_inertia.signals.errors_in_variables import agreed_residual
from jax_inertia.signals.generalised_motion import Motion
from jax_inertia.signals.torque_residual import torque_residual, torque_residuals


class State(eqx.Module):
    """What is carried from one sample to the next; save it, and the filter goes on bit for bit."""

    belief: kalman.Belief
    bias: Float[Array, " nv"]
    """Constant torque that the model lacks, from `calibrate_bias` [N m]."""
    rejected_for: Float[Array, ""]
    """How long the gate has rejected every sample [s]."""


class Step(eqx.Module):
    """What one sample gave: the belief after it, and how it compared with the one before."""

    belief: kalman.Belief
    innovation: kalman.Innovation
    threshold: Float[Array, ""]
    """γ of the gate for this sample."""
    reopened: Bool[Array, ""]


class Trace(eqx.Module):
    """A filter's run over a log, one entry a sample."""

    estimate: Estimate
    innovation: kalman.Innovation
    threshold: Float[Array, " T"]
    reopened: Bool[Array, " T"]
    covariance: Float[Array, "T bodies 10 10"]
    """Of each body's own coordinates."""
    joints: FoundTerms | None = None
    """Friction and offsets, where they are estimated."""


class Estimator(eqx.Module):
    """Filter settings and the robot; immutable. Make one with `make_estimator`."""

    robot: Robot
    chart: charts.Chart
    prior: kalman.Belief
    process_noise: Float[Array, "n n"]
    """Growth of the covariance per second, in the chart's coordinates."""
    noise: Noise
    sigma_a: Float[Array, " nv"] | None
    """Noise of v̇ [m/s², rad/s²] that is not in `noise`; None: the paper's filter, which takes v̇ for exact."""
    gate: Gate
    outliers: Gate | None
    """Beyond it a sample that the gate lets pass counts as noisier: `kalman.update`."""
    form: kalman.Form
    reopening: Reopening
    """A gate that has rejected everything for so long is facing a new load, not an impact."""
    loaded: Float[Array, "k b"]
    """Coordinates of the bodies with the prior's load, and with several times as much: where else iterations may start.
    The prior's covariance is stated at the first of them (`Uncertainty.anchor`), and there its slope is the load's.
    """
    joints: JointTerms | None
    """Friction and offsets of the rows that the bodies move, estimated with them: the last states, three a row."""
    bodies: tuple[int, ...] = eqx.field(static=True)
    iterations: int = eqx.field(static=True)
    analytic_jacobian: bool = eqx.field(static=True)
    constants: int = eqx.field(static=True, default=0)
    """How many constants of the model are further states, the last ones: `held_load`."""

    def initial(self) -> State:
        """State before the first sample."""
        zero = jnp.zeros((), self.prior.mean.dtype)
        return State(self.prior, jnp.zeros(self.robot.nv, zero.dtype), zero)

    @in_full_precision
    def step(
        self, state: State, observation: Observation, dt: Float[Array, ""] | float
    ) -> tuple[State, Step]:
        """Predict over `dt` [s] and update with one sample (Foster et al., eq. process to eq. measurement).

        A `dt` that is no positive number is a fault of a clock, and counts as no time at all. Raises ValueError where
        constants of the model are estimated, whose columns `update` and `run` take.
        """
        if self.constants:
            raise ValueError(
                "constants of the model are estimated; give their columns to update or run"
            )
        observation = floats_as(observation, self.robot.pi.dtype)
        known = self.robot, observation, self.bodies, state.bias
        valid = jnp.asarray(observation.motion.valid)
        if self.sigma_a is None:
            speed = jnp.asarray(observation.motion.v)
            return self._updated(
                state, lambda: self._measurement(*torque_residual(*known), valid, speed), dt, speed
            )
        belief, _ = self._predicted(state, _elapsed(dt, state))
        own, p = self._own(belief.mean).reshape(-1, 10), self._own(belief.covariance)
        g = jax.scipy.linalg.block_diag(*self.chart.jacobian(own))
        of_pi = self.chart.to_pi(own), g @ p @ g.T
        *rows, noise = agreed_residual(*known, *of_pi, self.noise, self.sigma_a)
        own = eqx.tree_at(lambda e: e.noise, self, noise)
        return own.update(state, *rows, valid, dt, speed=jnp.asarray(observation.motion.v))

    @in_full_precision
    def update(
        self,
        state: State,
        regressor: Float[Array, "nv bodies 10"],
        residual: Float[Array, " nv"],
        valid: Bool[Array, " nv"],
        dt: Float[Array, ""] | float,
        *,
        speed: Float[Array, " nv"] | None = None,
        of_constants: Float[Array, "nv k"] | None = None,
    ) -> tuple[State, Step]:
        """`step` for a regressor Y^est and a torque residual y computed before (`signals.torque_residual`).

        The measurement is Δτ = −y = Y π + noise (Foster et al., eq. measurement), so an innovation is measured minus
        predicted torque.

        A χ² gate alone would reject a genuine pick-up for ever. Impacts pass in some 50 ms; where everything that could
        be tested is rejected for `reopen_after` (`gates.Reopening`), the model is what is wrong, so the prior's
        covariance is added to the belief's: the gate opens, and the filter looks anew. `speed` are the joints'
        velocities, which friction hangs on, and `of_constants` the torques of one standard deviation of each of the
        model's constants (`held_load`). Raises ValueError where these are estimated and left out.
        """
        if self.joints is not None and speed is None:
            raise ValueError("friction is estimated, and update has no speed; give the velocities")
        count = 0 if of_constants is None else of_constants.shape[-1]
        if count != self.constants:
            raise ValueError(
                f"of_constants has {count} columns; this filter estimates {self.constants} constants of the model"
            )
        measure = lambda: self._measurement(regressor, residual, valid, speed, of_constants)  # noqa: E731
        return self._updated(state, measure, dt, speed)

    def _known(
        self,
        state: State,
        regressor: Array,
        residual: Array,
        motion: Motion,
        of_constants: Array | None,
        dt: Float[Array, ""],
    ) -> tuple[State, Step]:
        """`update` by what was computed before, for a moment's motion."""
        valid, speed = jnp.asarray(motion.valid), jnp.asarray(motion.v)
        return self.update(
            state, regressor, residual, valid, dt, speed=speed, of_constants=of_constants
        )

    def _measurement(
        self,
        regressor: Float[Array, "nv bodies 10"],
        residual: Float[Array, " nv"],
        valid: Array,
        speed: Float[Array, " nv"] | None,
        of_constants: Float[Array, "nv k"] | None = None,
    ) -> kalman.Measurement:
        """Of the rows that the bodies move the regressor must be finite; of the others it is zero."""
        moved = moved_rows(self.robot, self.bodies)
        own = take_rows(regressor, moved)
        broken = ~jnp.all(jnp.isfinite(own), axis=(1, 2))
        terms = jnp.zeros((len(moved), 0), own.dtype)
        if self.joints is not None and speed is not None:
            columns = take_rows(self.joints.columns(speed), moved)
            broken = broken | ~jnp.all(jnp.isfinite(columns), axis=1)
            each = jnp.eye(len(moved), dtype=own.dtype)[:, :, None] * columns[:, None, :]
            terms = each.reshape(len(moved), -1)
        if of_constants is not None:
            others = take_rows(of_constants, moved)
            broken = broken | ~jnp.all(jnp.isfinite(others), axis=1)
            terms = jnp.concatenate([terms, others], axis=1)

        def predicted(x: Float[Array, " n"]) -> Float[Array, " nv"]:
            rows = jnp.einsum("vbp,bp->v", own, self._pi(x)) + terms @ x[self._size :]
            return spread_rows(rows, moved, len(residual))

        def jacobian(x: Float[Array, " n"]) -> Float[Array, "nv n"]:
            at = self._own(x).reshape(-1, 10)
            g = self.chart.jacobian(at) if self.analytic_jacobian else _slopes(self.chart, at)
            rows = jnp.einsum("vbp,bpj->vbj", own, g).reshape(len(moved), -1)
            return spread_rows(jnp.concatenate([rows, terms], axis=1), moved, len(residual))

        usable = valid & ~spread_rows(broken, moved, len(residual))
        return kalman.Measurement(-residual, predicted, jacobian, usable)

    def _updated(
        self,
        state: State,
        measure: Callable[[], kalman.Measurement],
        dt: Float[Array, ""] | float,
        speed: Float[Array, " nv"] | None,
    ) -> tuple[State, Step]:
        """Predict, and update by what is measured."""
        dt = _elapsed(dt, state)
        belief, reopened = self._predicted(state, dt)
        noise = self._noise(belief, speed)
        independent = isinstance(noise, IndependentNoise)
        terms = belief.mean[self._size :]
        places = [jnp.concatenate([place, terms]) for place in self.loaded]
        belief, innovation = kalman.update_by(
            belief,
            measure,
            noise,
            # Noise that mixes rows ties those that no body moves to the others.
            rows=moved_rows(self.robot, self.bodies) if independent else None,
            gate=self.gate,
            outliers=self.outliers,
            iterations=self.iterations,
            elsewhere=jnp.stack(places),
            form=self.form,
            project=self._projected,
        )
        waited = self.reopening.doubted_for(
            state.rejected_for, dt, tested=innovation.tested, believed=innovation.accepted
        )
        threshold = self.gate.threshold(innovation.rows)
        out = State(belief, state.bias, waited)
        return out, Step(belief, innovation, threshold, reopened)

    def run(
        self,
        state: State,
        observations: Observation,
        *,
        dt: Float[Array, " T"] | None = None,
        used: Bool[Array, " T"] | None = None,
        of_constants: Float[Array, "T nv k"] | None = None,
    ) -> tuple[State, Trace]:
        """`step` over a log: regressors in batches, one scan, then physical units in batches. Jit it.

        `dt` [s] is the time since the sample before, by default that of the log, whose first sample is taken to come
        one period after `state`. Samples that are not `used` (default: all are) leave no trace in the state.
        `of_constants` are the columns of the model's constants, where these are estimated (`held_load`).
        Raises ValueError for fewer than two samples without a `dt`, and for columns of other constants.
        """
        if dt is None:
            dt = jnp.diff(jnp.asarray(observations.motion.time))
            if not len(dt):
                count = len(observations.motion.time)
                raise ValueError(f"a log of {count} samples has no period; give dt, one a sample")
            dt = jnp.concatenate([dt[:1], dt])
        # Stamps of a real clock need float64 until they are subtracted.
        observations = floats_as(observations, self.robot.pi.dtype)
        follow: Callable[..., tuple[State, Step]] = self.step
        samples: tuple = (observations,)
        if self.sigma_a is None:  # else regressors hang on the belief
            rows = torque_residuals(self.robot, observations, self.bodies, state.bias)
            if of_constants is not None:
                of_constants = jnp.asarray(of_constants, self.robot.pi.dtype)
            follow, samples = self._known, (*rows, observations.motion, of_constants)

        def one(carry, x):
            sample, since, use = x
            after, step = follow(carry, *sample, since)
            if use is not None:
                after = jax.tree.map(lambda new, old: jnp.where(use, new, old), after, carry)
            mean, p = step.belief.mean, step.belief.covariance
            own = (self._own(mean), own_blocks(self._own(p)))
            return after, (
                own,
                self._terms(mean, p),
                step.innovation,
                step.threshold,
                step.reopened,
            )

        steps = (samples, dt, used)
        state, (own, terms, innovation, threshold, reopened) = jax.lax.scan(one, state, steps)
        estimate = jax.lax.map(lambda x: physical_units(self.chart, *x), own, batch_size=64)
        return state, Trace(estimate, innovation, threshold, reopened, own[1], terms)

    @in_full_precision
    def calibrate_bias(self, state: State, observations: Observation) -> State:
        """Take the mean residual over a window into the bias, parameters held (Foster et al., sec. IV-B).

        b ← b − mean(y + Y π): accumulated, so that a second window refines the first. Rows that are nowhere
        valid keep their bias. A load carried meanwhile would be calibrated away: call it unloaded.
        """
        regressors, others = torque_residuals(self.robot, observations, self.bodies, state.bias)
        residual = others + jnp.einsum("tvbp,bp->tv", regressors, self._pi(state.belief.mean))
        used = jnp.asarray(observations.motion.valid) & jnp.isfinite(residual)
        mean = jnp.sum(jnp.where(used, residual, 0.0), 0) / jnp.maximum(jnp.sum(used, 0), 1)
        return eqx.tree_at(lambda s: s.bias, state, state.bias - mean)

    def estimate(self, belief: kalman.Belief) -> Estimate:
        """A belief in physical units: π, centre of mass, and their standard deviations to first order."""
        return physical_units(self.chart, self._own(belief.mean), self._own(belief.covariance))

    def joint_terms(self, belief: kalman.Belief) -> FoundTerms | None:
        """Friction and offsets of the rows that the bodies move, beyond the model's own; None where not estimated."""
        return self._terms(belief.mean, belief.covariance)

    def _predicted(
        self, state: State, dt: Float[Array, ""]
    ) -> tuple[kalman.Belief, Bool[Array, ""]]:
        reopened = self.reopening.due(state.rejected_for)
        # A load is new, friction and the model are not.
        own = jnp.arange(len(state.belief.mean)) < self._size
        # Twice what it was: where the last reopening was in vain, a load is larger than the prior says.
        wider = state.belief.covariance + self.prior.covariance
        extra = jnp.where(reopened & own[:, None] & own, wider, 0.0)
        return kalman.predict(state.belief, self.process_noise * dt + extra), reopened

    @property
    def _size(self) -> int:
        """Number of the states that are bodies' coordinates, the first ones."""
        return 10 * len(self.bodies)

    def _own(self, x: Float[Array, "..."]) -> Float[Array, "..."]:
        """The bodies' part of a mean or a covariance."""
        return x[(slice(self._size),) * x.ndim]

    def _pi(self, x: Float[Array, " n"]) -> Float[Array, "bodies 10"]:
        return self.chart.to_pi(self._own(x).reshape(-1, 10))

    def _terms(self, mean: Float[Array, " n"], p: Float[Array, "n n"]) -> FoundTerms | None:
        if self.joints is None:
            return None
        own = slice(self._size, len(mean) - self.constants)
        sigma = jnp.sqrt(jnp.diagonal(p))[own]
        return FoundTerms(mean[own].reshape(-1, 3), sigma.reshape(-1, 3))

    def _projected(self, x: Float[Array, " n"]) -> Float[Array, " n"]:
        """Bodies as the chart has them, and no friction below zero in all; in a chart without bounds nothing has any.

        A mean that is moved to a bound has not the covariance that it had, and contradicts the sample that it is of.
        """
        if isinstance(self.chart, charts.Linear):
            return x
        own = self.chart.project(self._own(x).reshape(-1, 10)).ravel()
        if self.joints is None:
            return jnp.concatenate([own, x[self._size :]]) if self.constants else own
        moved = np.array(moved_rows(self.robot, self.bodies))
        least = jnp.stack([-self.robot.damping, -self.robot.frictionloss], axis=1)[moved]
        free = jnp.full((len(moved), 1), -jnp.inf, x.dtype)
        least = jnp.concatenate([least.astype(x.dtype), free], axis=1)
        free = jnp.full(self.constants, -jnp.inf, x.dtype)
        least = jnp.concatenate([least.ravel(), free])
        return jnp.concatenate([own, jnp.maximum(x[self._size :], least)])

    def _noise(self, belief: kalman.Belief, speed: Float[Array, " nv"] | None) -> Noise:
        """With the dry friction of rows that hardly move, which is anything up to its level."""
        if self.joints is None or speed is None:
            return self.noise
        moved, found = moved_rows(self.robot, self.bodies), self.joint_terms(belief)
        assert found is not None
        level = found.value[:, 1] + self.robot.frictionloss[np.array(moved)]
        square = spread_rows(level**2 + found.sigma[:, 1] ** 2, moved, self.robot.nv)
        still = 1.0 - self.joints.columns(speed)[:, 1] ** 2
        extra = jnp.where(jnp.isfinite(still), square * still, 0.0)
        if isinstance(self.noise, IndependentNoise):
            return IndependentNoise(self.noise.variance + extra)
        return self.noise.plus(jnp.diag(extra))


@in_full_precision
def make_estimator(
    robot: Robot,
    bodies: Sequence[int | str],
    *,
    sigma_tau: Float[Array, "#nv"] | Float[Array, ""] | Sequence[float] | float,
    prior: Uncertainty | None = None,
    drift: Uncertainty | Float[Array, ""] | float | None = None,
    chart: charts.Chart | None = None,
    noise: Noise | None = None,
    sigma_a: Float[Array, "#nv"] | Float[Array, ""] | Sequence[float] | float | None = None,
    gate: Gate | float | None = None,
    reopen_after: Float[Array, ""] | float | None = None,
    iterations: int | None = None,
    form: kalman.Form | None = None,
    joints: JointTerms | None = None,
    analytic_jacobian: bool = True,
    paper: bool = False,
) -> Estimator:
    """Estimator of the chosen bodies, started at the robot's own parameters.

    `sigma_tau` is the noise of each row [N m, N] (overridden by `noise`); `prior` how far the bodies may be from the
    model at the start (default: a load of a tenth of the robot's mass); `drift` how fast, per √second, or the seconds
    in which they may drift by the prior (default: an hour with a gate that reopens, which is what notices a new load;
    else 3 s). Both are stated in physical units, so that every chart gets the same statement. `sigma_a` is the noise of
    accelerations [m/s², rad/s²], which is in the regressor too: modelled apart, it draws inertias far less towards zero
    (`errors_in_variables`); left out (the paper), it belongs into `sigma_tau`. `gate` is a gate, or the
    probability of keeping a good sample, 1 for none; `reopen_after` [s] see `Estimator.update`. With `joints` friction
    and offsets of the rows that the bodies move are estimated with them (`joint_terms`): what the motion does not tell
    apart is in the intervals.

    Defaults are safe: chart `LogCholeskyUUt`, five iterations, gate 0.9999, reopened after 0.5 s; without a gate
    an outlier counts as noisier (`kalman.update`, `outliers`). With `paper` it is the paper's: `LogCholesky`, one
    iteration, no gate, no reopening, every sample at its word.
    Numbers may be traced: the whole of it runs under `jit`, `grad` and `vmap`, where they cannot be looked at.
    Raises ValueError for an unknown body, one that no chart reaches (zero mass, unphysical), noise that is not
    positive, settings that no filter can have, or a form that leaves rows out with correlated noise.

    >>> from jax_inertia import load_model
    >>> from jax_inertia.estimation.inertial_filter import make_estimator
    >>> from jax_inertia.robots.pendulum import double_pendulum
    >>> robot = load_model(double_pendulum())
    >>> ekf = make_estimator(robot, ["lower"], sigma_tau=0.1)
    >>> ekf.iterations, make_estimator(robot, ["lower"], sigma_tau=0.1, paper=True).iterations
    (5, 1)
    >>> ekf.estimate(ekf.initial().belief).pi[0, :4].round(6) + 0.0
    Array([ 1. ,  0. ,  0. , -0.5], dtype=float64)
    """
    chosen = resolve_bodies(robot, bodies)
    if not chosen:
        raise ValueError("no body to estimate; name at least one")
    preset = settings.PAPER if paper else settings.SAFE
    iterations = preset.iterations if iterations is None else iterations
    reopen_after = preset.reopen_after if reopen_after is None else reopen_after
    gate = settings.gate_of(preset.gate if gate is None else gate, robot)
    settings.require_filter(iterations, gate, reopen_after, robot)
    prior = Load(0.1 * jnp.sum(robot.pi[:, 0])) if prior is None else prior
    prior = prior.of_bodies() if preset.loads_are_bodies else prior
    chart = preset.chart() if chart is None else chart
    nominal = robot.pi[np.array(chosen)]
    mean = chart.from_pi(nominal)
    settings.require_physical(robot, chosen, chart, mean)
    noise = settings.noise_of(noise, sigma_tau, robot)
    if sigma_a is not None:
        sigma_a = settings.of_rows("sigma_a", sigma_a, robot)
    covariance = block_diag(*settings.covariance("prior", prior, chart, nominal))
    start = kalman.Belief(mean.ravel(), covariance)
    loaded = jnp.stack([chart.from_pi(x).ravel() for x in settings.loaded(prior, nominal)])
    usual = settings.drift_seconds(gate, reopen_after, robot)
    growth = settings.growth(usual if drift is None else drift, chart, nominal, covariance)
    if joints is not None:
        start, growth = with_terms(start, growth, joints, moved_rows(robot, chosen))
    weighs = preset.weighs_outliers and not isinstance(gate, ChiSquaredGate)
    return Estimator(
        robot=robot,
        chart=chart,
        prior=start,
        process_noise=growth,
        noise=noise,
        sigma_a=sigma_a,
        gate=gate,
        outliers=settings.gate_of(settings.GATE, robot) if weighs else None,
        form=kalman.default_form(robot.pi.dtype) if form is None else form,
        reopening=Reopening(jnp.asarray(reopen_after, robot.pi.dtype)),
        loaded=loaded,
        joints=joints,
        bodies=chosen,
        iterations=iterations,
        analytic_jacobian=analytic_jacobian,
    )


def _elapsed(dt: Float[Array, ""] | float, state: State) -> Float[Array, ""]:
    """dt as the state counts time; a clock's faults count as none."""
    since = jnp.asarray(dt, state.rejected_for.dtype)
    return jnp.where(jnp.isfinite(since) & (since > 0), since, 0.0)


def _slopes(chart: charts.Chart, x: Float[Array, "bodies 10"]) -> Float[Array, "bodies 10 10"]:
    """`Chart.jacobian` by autodiff: each body's π hangs on its own coordinates alone, so ten tangents do for all."""

    def along(direction: Float[Array, "10"]) -> Float[Array, "bodies 10"]:
        return jax.jvp(chart.to_pi, (x,), (jnp.broadcast_to(direction, x.shape),))[1]

    return jax.vmap(along, out_axes=-1)(jnp.eye(10, dtype=x.dtype))
