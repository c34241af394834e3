"""What a model may be off by: what a filter estimates of it, how far the rest puts it off, and is anything held at all?

Linear rows of the log about the model, with friction and offset where those are estimated; the tolerances of the other
links, the gains, and forces of the ground that nobody measured are further columns of unit variance.

Masses, centres and inertias of the other links, and the gains of the drives, are as unknown as a load, but do not
change. Torque is linear in all of them (Atkeson, An and Hollerbach, Int. J. Robotics Research 5(3), 1986): a model that
is off by E z, z ~ N(0, 1) (`ModelErrors`), is off in its torque by

    Δτ_t = B_t z,      B_t = Y_t E,

and z are further states of the linear kind that friction and offsets are, with prior N(0, 1) and without process noise
(parameters as states: Kopp and Orford, AIAA Journal 1(10), 1963). An innovation's covariance is then H P Hᵀ + R with
them in P, so that the gate knows what a link that is off by its tolerance does, and the bodies' covariance contains
what z leaves open of them.

Most of z does nothing that a log shows. With B whitened by each row's noise R, Σ_t B_tᵀ R⁻¹ B_t = V diag(s²) Vᵀ: along
V_i, z moves all rows of the log together by s_i standard deviations of their noise. Where s_i < 1 the log says less of
it than the prior, and no sample is refused for it: those directions are no states, and count in intervals alone, as
what is taken for exact (the consider covariance of Schmidt, 1966).
"""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax.scipy.linalg import block_diag
from jaxtyping import Bool, Float

from jax_inertia.dynamics.rigid_body import resolve_bodies
from jax_inertia.estimation import log_filter, pieces
from jax_inertia.estimation.batch_fit import carried_with
from jax_inertia.estimation.batch_rows import error_columns, joint_columns, uncertain_bodies
from jax_inertia.estimation.inertial_filter import Estimator, Trace
from jax_inertia.estimation.joint_terms import JointTerms
from jax_inertia.estimation.priors import Load, Tolerance
from jax_inertia.maths import charts
from jax_inertia.maths.kalman import Belief
from jax_inertia.model.model_errors import ModelErrors
from jax_inertia.model.robot import Robot
from jax_inertia.signals.differences import Observation


class Unknown(NamedTuple):
    """What is estimated or considered together with the bodies that were asked for."""

    joints: JointTerms | None
    """Friction and offsets."""
    errors: ModelErrors | None
    """What the model may be off by besides; None: it is exact."""
    gain_sigma: float
    """Of each joint's torque, relative."""


class Considered(NamedTuple):
    """What a filter knows at the end, with what it takes for exact (Schmidt 1966) [kg, kg m, kg m²]."""

    bodies: Float[np.ndarray, "bodies 10 10"]
    """Covariance of π that the filter's own does not contain."""
    bare: Float[np.ndarray, "bodies 10"]
    """By how much the empty-handed bodies are believed to differ from the model."""
    loads: Float[np.ndarray, "bodies 10 10"]
    """Covariance of what the bodies have beyond their bare selves, all in all."""


class Held(NamedTuple):
    """Linear rows of a log, and of what its model may be off by: how far that puts a filter off, and what is held."""

    rows: pieces.LinearRows
    more: Float[np.ndarray, "T nv k"]
    """Torque of one standard deviation of each number that the model may be off by."""
    constants: int
    """How many of these, the first ones, are numbers of the model: links and gains."""
    own: Float[np.ndarray, "bodies 10 k"]
    """Error of the bodies' own π, empty-handed, for each of these."""
    stride: int
    """Rows of the log to a sample of the filter."""

    @classmethod
    def of(
        cls,
        robot: Robot,
        observation: Observation,
        bodies: Sequence[int | str],
        prior: Load,
        bias: Float[np.ndarray, " nv"],
        unknown: Unknown,
        cutoff: float | None,
    ) -> "Held":
        """Of a log in N m; `cutoff` as given to `log_filter.observe` [Hz]."""
        rows, _ = log_filter.in_pieces(robot, observation, bodies, prior, bias)
        if unknown.joints is not None:
            rows = rows.with_joints(unknown.joints, np.asarray(observation.motion.v))
        chosen, steps = resolve_bodies(robot, bodies), len(rows.residual)
        more = [np.zeros((steps, robot.nv, 0))]
        own = np.zeros((len(chosen), 10, 0))
        if (errors := unknown.errors) is not None:
            others = uncertain_bodies(errors, chosen)
            y = np.zeros((steps, robot.nv, 0))
            if others:
                y, _, _ = log_filter.regressors(robot, observation, others, bias)
            y = y.reshape(steps, robot.nv, len(others), 10)
            columns = error_columns(errors, others, y, joint_columns(observation))
            more.append(np.nan_to_num(columns))
            own = np.asarray(errors.pi)[list(chosen)]
        if unknown.gain_sigma > 0:
            tau = np.nan_to_num(np.asarray(observation.motion.tau))
            more.append(unknown.gain_sigma * tau[:, :, None] * np.eye(robot.nv))
        constants = sum(x.shape[2] for x in more)
        if observation.motion.unsure is not None:
            more.append(np.nan_to_num(np.asarray(observation.motion.unsure)))
        stride, whole = log_filter.stride(observation, cutoff), np.concatenate(more, axis=2)
        own = np.pad(own, ((0, 0), (0, 0), (0, whole.shape[2] - own.shape[2])))
        return cls(rows, whole, constants, own, stride)

    def seen(
        self, valid: Bool[np.ndarray, "t nv"], noise: Float[np.ndarray, " nv"]
    ) -> Float[np.ndarray, "k r"]:
        """Directions of all columns that a filter is to estimate, given which rows of its samples it uses."""
        seen = seen_directions(self.more[:: self.stride, :, : self.constants], valid, noise)
        return np.pad(seen, ((0, self.more.shape[2] - self.constants), (0, 0)))

    def of_constants(self, seen: Float[np.ndarray, "k r"]) -> Float[np.ndarray, "t nv r"] | None:
        """Torque of one standard deviation of what is `seen`, for each of the filter's samples; None of nothing."""
        return self.more[:: self.stride] @ seen if seen.shape[1] else None

    def considered(
        self,
        estimator: Estimator,
        belief: Belief,
        trace: Trace,
        noise: Float[np.ndarray, " nv"],
        seen: Float[np.ndarray, "k r"],
    ) -> Considered:
        """What the filter knows at its end, having estimated what is `seen` and taken the rest for exact."""
        count, n = seen.shape[1], 10 * len(self.own)
        # B z of the rest has the covariance B (1 − V Vᵀ) Bᵀ, and 1 − V Vᵀ is its own square.
        rest = np.eye(len(seen)) - seen @ seen.T
        rows = self.rows.with_columns(self.more @ seen, np.ones(count))
        s = pieces.sensitivity(rows, self._last(trace), self._of_grid(noise), self.more @ rest)
        bodies = s[:n].reshape(len(self.own), 10, -1)
        # What a bare body weighs more than the model says is taken for a load.
        off = bodies + self.own @ rest
        mean, p = np.asarray(belief.mean), np.asarray(belief.covariance)
        states = np.r_[:n, len(p) - count : len(p)]
        slope = np.asarray(estimator.chart.jacobian(jnp.asarray(mean[:n].reshape(-1, 10))))
        loads = off @ np.swapaxes(off, 1, 2)
        for i, own in enumerate(self.own):
            of_load = np.zeros((10, n + count))
            of_load[:, 10 * i : 10 * i + 10], of_load[:, n:] = slope[i], -own @ seen
            loads[i] += of_load @ p[np.ix_(states, states)] @ of_load.T
        bare = self.own @ seen @ mean[len(mean) - count :]
        return Considered(bodies @ np.swapaxes(bodies, 1, 2), bare, loads)

    def p_values(
        self, trace: Trace, noise: Float[np.ndarray, " nv"]
    ) -> Float[np.ndarray, " bodies"]:
        """For each body the chance of what is seen at the end of the log if it held nothing (`pieces.load_test`)."""
        rows = self.rows.with_columns(self.more, np.ones(self.more.shape[2]))
        part, noise = self._last(trace), self._of_grid(noise)
        return np.array(
            [pieces.load_test(rows, part, noise, i, own[:4]) for i, own in enumerate(self.own)]
        )

    def _last(self, trace: Trace) -> slice:
        """From the last reopening on."""
        at = np.flatnonzero(np.asarray(trace.reopened))
        return slice(int(at[-1]) * self.stride if len(at) else 0, len(self.rows.residual))

    def _of_grid(self, noise: Float[np.ndarray, " nv"]) -> Float[np.ndarray, " nv"]:
        """Noise of a row of the grid, from that of a filter's sample."""
        return np.maximum(noise, 1e-9) * np.sqrt(self.stride)


def errors_of(
    robot: Robot, bodies: Sequence[int | str], tolerance: Tolerance | None
) -> ModelErrors:
    """What the bodies and all that their joints carry may be off by: by a tolerance, else as the model says itself."""
    chosen = resolve_bodies(robot, bodies)
    off = (*chosen, *carried_with(robot, chosen))
    if tolerance is None:
        assert robot.errors is not None
        moved = np.any(robot.topology.body_dof[list(chosen)] > 0, axis=0)
        return robot.errors.of(off, np.flatnonzero(moved & robot.topology.dof_scalar).tolist())
    chart, pi = charts.LogCholeskyUUt(), robot.pi[np.array(off)]
    slope = chart.jacobian(chart.from_pi(pi))
    roots = slope @ np.linalg.cholesky(np.asarray(tolerance.covariance(chart, pi)))
    every = np.zeros((robot.nb, 10, 10 * len(off)))
    for k, (body, root) in enumerate(zip(off, roots, strict=True)):
        every[body, :, 10 * k : 10 * k + 10] = root
    return ModelErrors(jnp.asarray(every), jnp.zeros((robot.nv, 4, 10 * len(off))))


_TOGETHER = 4
"""The number of constants is a multiple of this (a decision), since each number of states is compiled anew."""


def seen_directions(
    columns: Float[np.ndarray, "T nv k"],
    valid: Bool[np.ndarray, "T nv"],
    noise: Float[np.ndarray, " nv"],
) -> Float[np.ndarray, "k r"]:
    """Orthonormal directions of the constants that a filter's samples see beyond their noise, the strongest first.

    Up to three weaker ones come with them.

    >>> import numpy as np
    >>> from jax_inertia.estimation.held_load import seen_directions
    >>> columns = np.zeros((9, 1, 5))
    >>> columns[:, 0, 2] = 7.0
    >>> abs(seen_directions(columns, np.ones((9, 1), bool), np.ones(1))[:, 0])
    array([0., 0., 1., 0., 0.])
    """
    count = columns.shape[2]
    white = np.where(valid[..., None], columns / noise[:, None], 0.0)
    white = white.reshape(valid.size, count)
    square, directions = np.linalg.eigh(white.T @ white)
    seen = -(-int(np.sum(square > 1.0)) // _TOGETHER) * _TOGETHER
    return directions[:, ::-1][:, : min(seen, count)]


def with_constants(estimator: Estimator, count: int) -> Estimator:
    """The estimator with so many constants of unit variance as further states.

    >>> from jax_inertia import load_model, make_estimator
    >>> from jax_inertia.estimation.held_load import with_constants
    >>> from jax_inertia.robots.pendulum import double_pendulum
    >>> ekf = make_estimator(load_model(double_pendulum()), ["lower"], sigma_tau=0.1)
    >>> with_constants(ekf, 3).initial().belief.covariance.shape
    (13, 13)
    """
    if not count:
        return estimator
    prior = estimator.prior
    zero, one = jnp.zeros(count, prior.mean.dtype), jnp.eye(count, dtype=prior.mean.dtype)
    return dataclasses.replace(
        estimator,
        prior=Belief(jnp.concatenate([prior.mean, zero]), block_diag(prior.covariance, one)),
        process_noise=block_diag(estimator.process_noise, 0.0 * one),
        constants=count,
    )
