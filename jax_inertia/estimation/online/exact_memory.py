"""An inertial filter that forgets no linearisation: every sample so far as one quadratic in π, relinearised as a whole.

    estimator = make_exact_estimator(robot, ["hand"], sigma_tau=0.3, sigma_v=0.002, prior=Load(2.0))
    state = estimator.initial()
    state, step = eqx.filter_jit(estimator.step)(state, observation, dt)
    estimator.estimate(state.belief).sigma_pi

Torque is linear in π (Foster et al., eq. invdyn-regressor), so that all samples' likelihood is |R π − z|² / 2 with an
n × n matrix R, whatever the chart. An extended filter does not use this: it takes each sample at the slope of its own
moment, and where motion says little of some directions, slopes at different places add up to a certainty that is not
there (Huang, Mourikis and Roumeliotis 2010, of SLAM). Here the belief is the most probable x of

    |R π(x) − z|² / 2 + (x − x₀)ᵀ P₀⁻¹ (x − x₀) / 2

with the covariance of its curvature; what no sample saw stays at the prior, exactly. Compared with the extended filter:

- v̇ = (v_k − v_{k−1}) / T is a difference, and the error of v_k comes back with the other sign in the next sample. Its
  error n_k is a state that lasts two samples, known given π by a Kalman filter of its own, whose mean is linear in π:
  the innovation of Δτ by it is white, and so is what the regressor becomes (the innovations algorithm for a moving
  average: Brockwell and Davis 1991, sec. 5.2). White noise of the same size would make slow motion far too noisy: of a
  sum of differences only the two ends are left.
- A sample that contradicts the belief may be a shock: it counts by `sample_weight.mixture`. Where nothing else has come
  for `reopen_after`, the load is new, and what was known counts as if it had drifted by the prior.
"""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.scipy.linalg import block_diag, solve_triangular
from jaxtyping import Array, Bool, Float

from jax_inertia.dynamics.rigid_body import mass_matrix, resolve_bodies
from jax_inertia.dynamics.sparse_rows import moved_rows
from jax_inertia.estimation import filter_settings as settings
from jax_inertia.estimation.physical_estimate import Estimate, physical_units
from jax_inertia.estimation.priors import Load, Uncertainty
from jax_inertia.maths import inertial_parameters, kalman
from jax_inertia.maths.argument_checks import floats_as, is_positive, require
from jax_inertia.maths.charts import LogCholeskyUUt, Physical
from jax_inertia.maths.gates import Reopening
from jax_inertia.maths.noise import IndependentNoise, Noise
from jax_inertia.maths.precision import in_full_precision
from jax_inertia.maths.sample_weight import mixture
from jax_inertia.model.robot import Robot
from jax_inertia.signals.differences import Observation
from jax_inertia.signals.window_mean import jerk_since, mean_residual


class ExactState(eqx.Module):
    """What is carried from one sample to the next."""

    belief: kalman.Belief
    memory: Float[Array, "n n_and_1"]
    """[R, z]: what all samples say of π."""
    ends: Float[Array, "nv n_and_1"]
    """Error of the velocities at the window's end, mean [slope by −π, at π = 0]."""
    ends_covariance: Float[Array, "nv nv"]
    acceleration: Float[Array, " nv"]
    """Of the sample before, for how fast it changes; NaN where there was none."""
    doubted_for: Float[Array, ""]
    """How long every sample has contradicted the belief [s]."""


class ExactStep(eqx.Module):
    """What one sample gave."""

    belief: kalman.Belief
    nis: Float[Array, ""]
    """νᵀ S⁻¹ ν by the belief before it; χ² of `rows` degrees of freedom."""
    rows: Float[Array, ""]
    weight: Float[Array, ""]
    """How much the sample counted, in parts of a good one."""
    reopened: Bool[Array, ""]


class ExactEstimator(eqx.Module):
    """Filter settings and the robot; immutable. Make one with `make_exact_estimator`."""

    robot: Robot
    chart: Physical
    prior: kalman.Belief
    drift: Float[Array, "n n"]
    """Growth of π's covariance per second."""
    noise: Noise
    sigma_v: Float[Array, " nv"]
    reopening: Reopening
    bodies: tuple[int, ...] = eqx.field(static=True)
    iterations: int = eqx.field(static=True)

    def initial(self) -> ExactState:
        """State before the first sample."""
        n, nv, dtype = len(self.prior.mean), self.robot.nv, self.prior.mean.dtype
        return ExactState(
            belief=self.prior,
            memory=jnp.zeros((n, n + 1), dtype),
            ends=jnp.zeros((nv, n + 1), dtype),
            ends_covariance=jnp.diag(self.sigma_v**2),
            acceleration=jnp.full(nv, jnp.nan, dtype),
            doubted_for=jnp.zeros((), dtype),
        )

    @in_full_precision
    def step(
        self, state: ExactState, observation: Observation, dt: Float[Array, ""] | float
    ) -> tuple[ExactState, ExactStep]:
        """Take one sample, whose acceleration is the difference of velocities over the `dt` [s] since the last."""
        observation = floats_as(observation, self.robot.pi.dtype)
        dt = jnp.asarray(dt, self.prior.mean.dtype)
        pi, n = self._pi(state.belief.mean), len(self.prior.mean)
        believed = self.robot.believed(self.bodies, pi.reshape(-1, 10))
        inertia = mass_matrix(believed, jnp.asarray(observation.motion.q))
        a = jnp.asarray(observation.a)
        jerk = jerk_since(state.acceleration, a, dt)
        rows, used = self._unexplained(observation, jerk, dt)
        counted = used.astype(dt.dtype)

        # The error of the window's beginning is known from the window before, that of its end is not.
        lever = inertia / dt
        fresh = jnp.diag(self.sigma_v**2)
        both = fresh + state.ends_covariance
        noise = self.noise.plus(lever @ both @ lever.T)
        white = noise.whiten(jnp.concatenate([rows + lever @ state.ends, lever], axis=1), counted)
        h, z, lever = white[:, :n], white[:, n], white[:, n + 1 :]

        reopened = self.reopening.due(state.doubted_for)
        memory = self._aged(state, dt, reopened)
        before = self._believed(state.belief.mean, memory)[1]
        root = h @ self._slope(state.belief.mean) @ before
        count = jnp.sum(counted)
        nis, weight, settled = _sample(root, z - h @ pi, count)

        # What is noise in v̇ is in the regressor too (`errors_in_variables`): both are taken where sensors,
        # forces and the belief agree, which the innovation does not correlate with.
        start = state.ends[:, :n] @ pi - state.ends[:, n]
        shift = (start + both @ lever.T @ settled) / dt
        agreed = eqx.tree_at(lambda o: o.a, observation, a + shift)
        rows, _ = self._unexplained(agreed, jerk, dt)
        rows = rows.at[:, n].add(inertia @ shift) + (inertia / dt) @ state.ends
        white = noise.whiten(rows, counted)
        finite = jnp.all(jnp.isfinite(white))
        weight = jnp.where(finite, weight, 0.0)
        taken = jnp.sqrt(weight) * jnp.where(finite, white, 0.0)
        memory = jnp.asarray(jnp.linalg.qr(jnp.concatenate([memory, taken]), mode="r"))[:n]

        x = self._most_probable(state.belief.mean, memory)
        belief = kalman.Belief(x, self._covariance(x, memory))
        # A shock says nothing of the velocity at its end.
        good = weight > 0.5
        gain = lever * self.sigma_v**2
        ends = jnp.where(good, gain.T @ white, 0.0)
        known = jnp.where(good, fresh - gain.T @ gain, fresh)
        own = jnp.asarray(moved_rows(self.robot, self.bodies))
        waited = self.reopening.doubted_for(
            state.doubted_for, dt, tested=jnp.any(used[own]), believed=good
        )
        after = ExactState(belief, memory, ends, known, a, waited)
        return after, ExactStep(belief, nis, count, weight, reopened)

    def _unexplained(
        self, observation: Observation, jerk: Float[Array, " nv"], dt: Float[Array, ""]
    ) -> tuple[Array, Bool[Array, " nv"]]:
        """([Y, Δτ] as the window's means, which rows are measured), zero where they are not."""
        zero = jnp.zeros(self.robot.nv, self.prior.mean.dtype)
        regressor, residual = mean_residual(self.robot, observation, self.bodies, zero, jerk, dt)
        flat = regressor.reshape(len(residual), -1)
        rows = jnp.concatenate([flat, -residual[:, None]], axis=1)
        used = jnp.asarray(observation.motion.valid) & jnp.all(jnp.isfinite(rows), axis=1)
        return jnp.where(used[:, None], rows, 0.0), used

    def estimate(self, belief: kalman.Belief) -> Estimate:
        """A belief in physical units: π, centre of mass, and their standard deviations to first order."""
        return physical_units(self.chart, belief.mean, belief.covariance)

    def _pi(self, x: Float[Array, " n"]) -> Float[Array, " n"]:
        return self.chart.to_pi(x.reshape(-1, 10)).ravel()

    def _slope(self, x: Float[Array, " n"]) -> Float[Array, "n n"]:
        return block_diag(*self.chart.jacobian(x.reshape(-1, 10)))

    def _aged(
        self, state: ExactState, dt: Float[Array, ""], reopened: Bool[Array, ""]
    ) -> Float[Array, "n n_and_1"]:
        """[R, z] after π has drifted: with Q its covariance, RᵀR becomes Rᵀ (1 + R Q Rᵀ)⁻¹ R."""
        g = self._slope(self.prior.mean)
        anew = jnp.where(reopened, 1.0, 0.0) * (g @ self.prior.covariance @ g.T)
        r = state.memory[:, :-1]
        grown = jnp.eye(len(r), dtype=r.dtype) + r @ (self.drift * dt + anew) @ r.T
        return solve_triangular(jnp.linalg.cholesky(grown), state.memory, lower=True)

    def _rows(self, x: Float[Array, " n"], memory: Array) -> tuple[Array, Array]:
        """(J, r) of the cost |r|² / 2 and its slope −Jᵀ r: memory and prior."""
        inverse = solve_triangular(
            kalman.cholesky(self.prior.covariance), jnp.eye(len(x), dtype=x.dtype), lower=True
        )
        r, z = memory[:, :-1], memory[:, -1]
        jacobian = jnp.concatenate([r @ self._slope(x), inverse])
        return jacobian, jnp.concatenate([z - r @ self._pi(x), inverse @ (self.prior.mean - x)])

    def _cost(self, x: Float[Array, " n"], memory: Array) -> Float[Array, ""]:
        left = self._rows(x, memory)[1]
        value = left @ left
        return jnp.where(jnp.isfinite(value), value, jnp.inf)

    def _believed(self, x: Float[Array, " n"], memory: Array) -> tuple[Array, Array]:
        """(Gauss–Newton's step, a root L of the covariance L Lᵀ) at x."""
        jacobian, left = self._rows(x, memory)
        r = jnp.asarray(jnp.linalg.qr(jnp.concatenate([jacobian, left[:, None]], axis=1), mode="r"))
        n = len(x)
        root = solve_triangular(r[:n, :n], jnp.eye(n, dtype=x.dtype), lower=False)
        return root @ r[:n, n], root

    def _covariance(self, x: Float[Array, " n"], memory: Array) -> Float[Array, "n n"]:
        root = self._believed(x, memory)[1]
        return kalman.positive(root @ root.T)

    def _most_probable(self, x: Float[Array, " n"], memory: Array) -> Float[Array, " n"]:
        """Gauss–Newton from where the last sample ended; back with a shorter step where the cost rose.

        Log-Cholesky coordinates have other minima, at bodies that have shrunk to nothing. The cost over π has one: its
        solution, made a body, is a second place to start from, and the lower end counts.
        """

        def again(_, carry):
            x, cost, share = carry
            step = self._believed(x, memory)[0]
            trial = self.chart.project((x + share * step).reshape(-1, 10)).ravel()
            value = self._cost(trial, memory)
            good = value <= cost
            share = jnp.where(good, jnp.minimum(1.0, 4.0 * share), 0.25 * share)
            return jnp.where(good, trial, x), jnp.where(good, value, cost), share

        def down(x: Float[Array, " n"]) -> tuple[Array, Array]:
            start = (x, self._cost(x, memory), jnp.ones((), x.dtype))
            return jax.lax.fori_loop(0, self.iterations, again, start)[:2]

        ends, costs = jax.vmap(down)(jnp.stack([x, self._linear(memory)]))
        return ends[jnp.argmin(costs)]

    def _linear(self, memory: Float[Array, "n n_and_1"]) -> Float[Array, " n"]:
        """x of the body nearest to the least-squares π of memory and prior."""
        g = self._slope(self.prior.mean)
        covariance = g @ self.prior.covariance @ g.T
        nominal = self._pi(self.prior.mean)
        root = kalman.cholesky(covariance)
        r, z = memory[:, :-1], memory[:, -1]
        scaled = r @ root
        inner = jnp.eye(len(z), dtype=z.dtype) + scaled.T @ scaled
        shift = jnp.linalg.solve(inner, scaled.T @ (z - r @ nominal))
        pi = (nominal + root @ shift).reshape(-1, 10)
        x = self.chart.from_pi(inertial_parameters.as_bodies(pi))
        return jnp.where(jnp.all(jnp.isfinite(x)), x, self.prior.mean.reshape(-1, 10)).ravel()


@in_full_precision
def make_exact_estimator(
    robot: Robot,
    bodies: Sequence[int | str],
    *,
    sigma_tau: Float[Array, "#nv"] | Float[Array, ""] | Sequence[float] | float = 1.0,
    sigma_v: Float[Array, "#nv"] | Float[Array, ""] | Sequence[float] | float,
    prior: Uncertainty | None = None,
    drift: Uncertainty | Float[Array, ""] | float = float("inf"),
    noise: Noise | None = None,
    reopen_after: Float[Array, ""] | float = settings.REOPEN_AFTER,
    iterations: int = 3,
) -> ExactEstimator:
    """Estimator of the chosen bodies, started at the robot's own parameters.

    `sigma_tau` is the noise of each observation's row [N m, N], accelerations apart (overridden by `noise`); `sigma_v`
    that of the velocities [m/s, rad/s] whose differences the accelerations are, over windows that follow one another
    (`Stream`, or every w-th row of `aligned_differences`). `prior` as in `make_estimator`, a load's `shape` one where
    it has none; `drift` too, by default none: a load that stays is a constant, and a new one is noticed
    (`reopen_after`).
    Raises ValueError as `make_estimator` does.

    >>> from jax_inertia import load_model
    >>> from jax_inertia.estimation.online.exact_memory import make_exact_estimator
    >>> from jax_inertia.robots.pendulum import double_pendulum
    >>> ekf = make_exact_estimator(load_model(double_pendulum()), ["lower"], sigma_tau=0.1, sigma_v=1e-3)
    >>> ekf.estimate(ekf.initial().belief).pi[0, :4].round(6) + 0.0
    Array([ 1. ,  0. ,  0. , -0.5], dtype=float64)
    """
    chosen = resolve_bodies(robot, bodies)
    if not chosen:
        raise ValueError("no body to estimate; name at least one")
    dtype = robot.pi.dtype
    if noise is None:
        noise = IndependentNoise(settings.of_rows("sigma_tau", sigma_tau, robot) ** 2)
    settings.require_noise(noise, robot)
    speed = settings.of_rows("sigma_v", sigma_v, robot)
    require("reopen_after", reopen_after, is_positive, "positive [s]")
    chart = LogCholeskyUUt()
    nominal = robot.pi[jnp.asarray(chosen)]
    mean = chart.from_pi(nominal)
    settings.require_physical(robot, chosen, chart, mean)
    prior = Load(0.1 * jnp.sum(robot.pi[:, 0])) if prior is None else prior
    prior = prior.of_a_body() if isinstance(prior, Load) else prior
    covariance = block_diag(*settings.covariance("prior", prior, chart, nominal))
    growth = settings.growth(drift, chart, nominal, covariance)
    g = block_diag(*chart.jacobian(mean))
    return ExactEstimator(
        robot=robot,
        chart=chart,
        prior=kalman.Belief(mean.ravel(), covariance.astype(dtype)),
        drift=g @ growth @ g.T,
        noise=noise,
        sigma_v=speed,
        reopening=Reopening(jnp.asarray(reopen_after, dtype)),
        bodies=chosen,
        iterations=iterations,
    )


def _sample(
    root: Float[Array, "nv n"], nu: Float[Array, " nv"], rows: Float[Array, ""]
) -> tuple[Float[Array, ""], Float[Array, ""], Float[Array, " nv"]]:
    """(NIS, weight, S⁻¹ ν) of a whitened innovation whose state's share has this root."""
    inner = jnp.eye(root.shape[1], dtype=nu.dtype) + root.T @ root
    factor = jnp.linalg.cholesky(inner)
    half = solve_triangular(factor, root.T @ nu, lower=True)
    nis = jnp.maximum(nu @ nu - half @ half, 0.0)
    rest = solve_triangular(factor, half, trans=1, lower=True)
    return nis, mixture(nis, rows)[1], nu - root @ rest
