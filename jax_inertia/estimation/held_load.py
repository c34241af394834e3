"""What an estimate takes for exact: how far that puts it off, and whether anything is in the hand at all.

Linear rows of the log about the model, with friction and offset where those are estimated; the tolerances of the other
links, the gains, and forces of the ground that nobody measured are further columns of unit variance.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jax_inertia.dynamics.rigid_body import resolve_bodies
from jax_inertia.estimation import log_filter, pieces
from jax_inertia.estimation.batch_fit import carried_with
from jax_inertia.estimation.batch_rows import error_columns, joint_columns, uncertain_bodies
from jax_inertia.estimation.inertial_filter import Trace
from jax_inertia.estimation.joint_terms import JointTerms
from jax_inertia.estimation.priors import Load, Tolerance
from jax_inertia.maths import charts
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
    """Consider covariances of π (Schmidt 1966) [kg, kg m, kg m²]."""

    bodies: Float[np.ndarray, "bodies 10 10"]
    loads: Float[np.ndarray, "bodies 10 10"]
    """Of what the bodies have beyond the model's own."""


class Held(NamedTuple):
    """Linear rows of a log, and of what its filter takes for exact: how far that puts it off, and what is held."""

    rows: pieces.LinearRows
    more: Float[np.ndarray, "T nv k"]
    """Torque of one standard deviation of each number that is taken for exact."""
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
        if observation.motion.unsure is not None:
            more.append(np.nan_to_num(np.asarray(observation.motion.unsure)))
        stride, whole = log_filter.stride(observation, cutoff), np.concatenate(more, axis=2)
        own = np.pad(own, ((0, 0), (0, 0), (0, whole.shape[2] - own.shape[2])))
        return cls(rows, whole, own, stride)

    def considered(self, trace: Trace, noise: Float[np.ndarray, " nv"]) -> "Considered":
        """Covariances at the end that the filter's own does not contain: of what it takes for exact."""
        size = len(self.own)
        if not self.more.shape[2]:
            return Considered(*np.zeros((2, size, 10, 10)))
        s = pieces.sensitivity(self.rows, self._last(trace), self._of_grid(noise), self.more)
        bodies = s[: 10 * size].reshape(size, 10, -1)
        # What a bare body weighs more than the model says is taken for a load.
        loads = bodies + self.own
        return Considered(*(x @ np.swapaxes(x, 1, 2) for x in (bodies, loads)))

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
