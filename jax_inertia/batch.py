"""Batch fit of bodies, joints and drive gains to logs, physical by construction.

The nonlinear counterpart of the paper's eq. least-squares: bodies move in a chart (so every iterate is physical), with
a Gaussian prior about the model; joint damping, dry friction, rotor inertia, torque offset and drive gain are fitted
beside them where asked for. One joint's rows of a whole log are compressed by QR to a triangle as small as the number
of columns, so that Levenberg–Marquardt (optimistix) never sees the samples.

Model errors, not sensors, make most of a real residual, and they are slow: the noise of each joint is its residual's
variance times its correlation time, estimated from the fit itself and iterated. Intervals mean little without that.
"""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float

from jax_inertia import charts
from jax_inertia.differences import Observation
from jax_inertia.dynamics import resolve_bodies
from jax_inertia.estimate import Estimate, Load, make_estimator
from jax_inertia.inertia import is_physical
from jax_inertia.kalman import Belief
from jax_inertia.measurement import torque_residuals
from jax_inertia.robot import HINGE, SLIDE, Robot

JOINT_TERMS = ("damping", "frictionloss", "armature", "offset")


class BatchFit(eqx.Module):
    """A model fitted to logs."""

    robot: Robot
    """The robot with the fitted bodies, damping, friction and armature."""
    estimate: Estimate
    """The fitted bodies in physical units."""
    joint_terms: dict[str, Float[np.ndarray, " nv"]]
    """What was added to the model's own, by name: N m s/rad, N m, kg m², N m; zero where not fitted."""
    joint_sigma: dict[str, Float[np.ndarray, " nv"]]
    gains: Float[np.ndarray, " nv"]
    """Torque per logged unit; one where the log is in N m."""
    gains_sigma: Float[np.ndarray, " nv"]
    rms_before: Float[np.ndarray, " nv"]
    rms_after: Float[np.ndarray, " nv"]
    """Residual of each row [N m, N], before (nominal model) and after."""
    noise: Float[np.ndarray, " nv"]
    """Standard deviation of one independent sample of each row, its correlation time taken in [N m, N]."""
    converged: bool = eqx.field(static=True)

    @property
    def bias(self) -> Float[np.ndarray, " nv"]:
        """The torque offset, as the filter's bias."""
        return self.joint_terms["offset"]


class _Problem(eqx.Module):
    """Compressed rows: in units of the log, joint j's residual is triangle_j @ [−w/gain, 1/gain, 1]."""

    triangles: Float[Array, "nv c c"]
    chart: charts.Chart
    start: Belief
    joint_sigma: Float[Array, "nv terms"]
    gain_start: Float[Array, " nv"]
    gain_sigma: Float[Array, " nv"]
    noise: Float[Array, " nv"]


def fit(
    robot: Robot,
    observations: Sequence[Observation],
    bodies: Sequence[int | str] | None = None,
    *,
    prior: Load,
    joint_terms: Sequence[str] = (),
    gains: Float[np.ndarray, " nv"] | None = None,
    gain_sigma: float = 0.0,
    bias: Float[np.ndarray, " nv"] | None = None,
    chart: charts.Chart | None = None,
) -> BatchFit:
    """Fit bodies (default: all with mass) and joint terms to one or several logs of the same robot.

    `prior` says how far bodies may be from the model; `joint_terms` any of "damping", "frictionloss", "armature",
    "offset" (one of each per joint, never below zero in total, offset apart). Where the logged torque is a current,
    `gains` are the torques per unit to start from and `gain_sigma` their relative uncertainty (0: they are exact);
    the log's torque must then still be in its own unit. Raises ValueError for unknown names or terms.
    """
    chosen = _fittable(robot) if bodies is None else resolve_bodies(robot, bodies)
    if unknown := [t for t in joint_terms if t not in JOINT_TERMS]:
        raise ValueError(f"unknown joint terms {unknown}; valid: {', '.join(JOINT_TERMS)}")
    # Here the factor whose t is the centre of mass converges in the fewest steps: mass and inertia about it decouple.
    chart = charts.LogCholeskyUUt() if chart is None else chart
    start = make_estimator(robot, chosen, sigma_tau=1.0, prior=prior, chart=chart).prior
    gain_start = np.ones(robot.nv) if gains is None else np.asarray(gains, float)
    fixed_bias = np.zeros(robot.nv) if bias is None else np.asarray(bias, float)
    columns, base, raw, valid = _columns(robot, observations, chosen, fixed_bias)
    triangles = jnp.asarray(_compress(columns, base, raw, valid))
    nominal = np.concatenate([np.asarray(robot.pi)[list(chosen)].ravel(), np.zeros(4)])
    before = (base - columns @ nominal) / gain_start + raw
    scale = _rms(raw * gain_start, valid)
    joint_sigma = _joint_prior(robot, columns, valid, scale, joint_terms)
    driven = _driven(robot)
    noise = np.maximum(_rms(before, valid), 1e-6)
    floor = 1e-4 * np.maximum(_rms(raw, valid), 1e-3)
    # Alternate: fit, then the noise that its residual shows; a joint term pushed below zero is given up. Correlation
    # counts only once the shape of the residual has settled: at first it is the very signal that is to be fitted.
    y = jnp.concatenate([start.mean, jnp.zeros(5 * robot.nv)])
    for iteration in range(10):
        problem = _Problem(
            triangles=triangles,
            chart=chart,
            start=start,
            joint_sigma=jnp.asarray(joint_sigma),
            gain_start=jnp.asarray(gain_start),
            gain_sigma=jnp.asarray(np.where(driven, gain_sigma, 0.0)),
            noise=jnp.asarray(noise),
        )
        y, covariance, ok = _solve(problem, y)
        w, gain = (np.asarray(x) for x in _unpack(problem, y))
        after = (base - np.einsum("tjc,jc->tj", columns, w)) / gain + raw
        update = _rms(after, valid) if iteration < 2 else _effective_noise(after, valid)
        update = np.maximum(update, floor)
        own = np.stack([robot.damping, robot.frictionloss, robot.armature], axis=1)
        negative = (own + w[:, -4:-1] < -1e-12) & (joint_sigma[:, :3] > 0)
        settled = iteration > 2 and bool(np.all(np.abs(update / noise - 1) < 0.05))
        settled = settled and not negative.any()
        joint_sigma[:, :3] = np.where(negative, 0.0, joint_sigma[:, :3])
        noise = update
        if settled:
            break
    terms, sigma = w[:, -4:], joint_sigma * _block(covariance, 10 * len(chosen), (robot.nv, 4))
    x = y[: 10 * len(chosen)]
    belief = Belief(x, covariance[: len(x), : len(x)])
    estimator = make_estimator(robot, chosen, sigma_tau=1.0, prior=prior, chart=chart)
    estimate = estimator.estimate(belief)
    fitted = robot.with_pi(chosen, estimate.pi)
    fitted = eqx.tree_at(
        lambda r: (r.damping, r.frictionloss, r.armature),
        fitted,
        (
            robot.damping + terms[:, 0],
            robot.frictionloss + terms[:, 1],
            robot.armature + terms[:, 2],
        ),
    )
    gain_spread = _block(covariance, 10 * len(chosen) + 4 * robot.nv, (robot.nv,))
    return BatchFit(
        robot=fitted,
        estimate=estimate,
        joint_terms=dict(zip(JOINT_TERMS, terms.T, strict=True)),
        joint_sigma=dict(zip(JOINT_TERMS, sigma.T, strict=True)),
        gains=gain,
        gains_sigma=gain * gain_sigma * gain_spread * driven,
        rms_before=_rms(before * gain_start, valid),
        rms_after=_rms(after * gain, valid),
        noise=noise * gain,
        converged=bool(ok) and settled,
    )


def _fittable(robot: Robot) -> tuple[int, ...]:
    """Bodies that a chart reaches: massless frames of a URDF stay as they are."""
    return tuple(int(i) for i in np.flatnonzero(np.asarray(is_physical(robot.pi))))


def _columns(
    robot: Robot,
    observations: Sequence[Observation],
    chosen: tuple[int, ...],
    bias: Float[np.ndarray, " nv"],
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """(columns (T, nv, 10 bodies + 4), known torque (T, nv), logged torque, rows to use) of all the logs."""
    parts = []
    for one in observations:
        motion = one.motion
        silent = eqx.tree_at(lambda o: o.motion.tau, one, np.zeros_like(motion.tau))
        regressor, base = _residuals(robot, silent, chosen, jnp.asarray(bias))
        v, a = np.asarray(motion.v), np.asarray(one.a)
        joint = np.stack([v, np.tanh(v / _FRICTION_VELOCITY), a, np.ones_like(v)], axis=-1)
        flat = np.asarray(regressor).reshape(*v.shape, -1)
        columns = np.concatenate([flat, joint], axis=-1)
        finite = np.isfinite(columns).all(axis=-1) & np.isfinite(motion.tau)
        parts.append((columns, np.asarray(base), np.asarray(motion.tau), motion.valid & finite))
    columns, base, raw, valid = (np.concatenate(x) for x in zip(*parts, strict=True))
    return (
        np.where(valid[:, :, None], columns, 0.0),
        np.where(valid, base, 0.0),
        np.where(valid, raw, 0.0),
        valid,
    )


# Dry friction inside a regressor: soft enough to bear velocity noise, far below working speeds.
_FRICTION_VELOCITY = 0.01
_residuals = eqx.filter_jit(torque_residuals)


def _compress(
    columns: np.ndarray, base: np.ndarray, raw: np.ndarray, valid: np.ndarray
) -> np.ndarray:
    """Triangle of each row's [columns, base, raw]: same sums of squares, no samples."""
    c = columns.shape[2] + 2
    out = np.zeros((columns.shape[1], c, c))
    for j in range(columns.shape[1]):
        rows = np.column_stack([columns[:, j], base[:, j], raw[:, j]])[valid[:, j]]
        # A joint sees only the bodies it moves: most columns of most rows are exactly zero.
        seen = np.flatnonzero(np.any(rows != 0, axis=0))
        if len(seen):
            r = np.asarray(np.linalg.qr(rows[:, seen], mode="r"))
            out[j][: len(r), seen] = r
    return out


def _joint_prior(
    robot: Robot,
    columns: np.ndarray,
    valid: np.ndarray,
    scale: np.ndarray,
    joint_terms: Sequence[str],
) -> np.ndarray:
    """Prior σ of each joint term: enough to make up the joint's whole torque; zero where not fitted."""
    size = np.stack([_rms(columns[:, :, k - 4], valid) for k in range(4)], axis=1)
    sigma = scale[:, None] / np.maximum(size, 1e-9)
    wanted = np.array([t in joint_terms for t in JOINT_TERMS])
    return np.where(wanted & _driven(robot)[:, None] & (size > 0), sigma, 0.0)


def _driven(robot: Robot) -> np.ndarray:
    """Rows that belong to a hinge or slide joint."""
    top = robot.topology
    return np.isin(np.array(top.kind)[top.dof_node], (HINGE, SLIDE))


def _unpack(
    problem: _Problem, y: Float[Array, " n"]
) -> tuple[Float[Array, "nv c"], Float[Array, " nv"]]:
    """(w of every row, gains) of the unknowns y = [bodies in the chart, joint terms / σ, log gains / σ]."""
    n, nv = len(problem.start.mean), len(problem.noise)
    pi = problem.chart.to_pi(y[:n].reshape(-1, 10)).ravel()
    terms = y[n : n + 4 * nv].reshape(nv, 4) * problem.joint_sigma
    gain = problem.gain_start * jnp.exp(problem.gain_sigma * y[n + 4 * nv :])
    return jnp.concatenate([jnp.broadcast_to(pi, (nv, len(pi))), terms], axis=1), gain


def _residual(y: Float[Array, " n"], problem: _Problem) -> Float[Array, " m"]:
    w, gain = _unpack(problem, y)
    n = len(problem.start.mean)
    one = jnp.ones_like(gain)[:, None]
    vector = jnp.concatenate([-w / gain[:, None], one / gain[:, None], one], axis=1)
    data = jnp.einsum("jrc,jc->jr", problem.triangles, vector) / problem.noise[:, None]
    # Noise in the log's own unit: in torque units, shrinking the gain and the model together would shrink it too.
    root = jnp.linalg.cholesky(problem.start.covariance)
    bodies = jax.scipy.linalg.solve_triangular(root, y[:n] - problem.start.mean, lower=True)
    return jnp.concatenate([data.ravel(), bodies, y[n:]])


@eqx.filter_jit
def _solve(problem: _Problem, y0: Float[Array, " n"]):
    """(solution, posterior covariance, whether it converged)."""
    # The prior's rows keep the normal equations well posed; a QR of the Jacobian is ten times slower here.
    solver = optx.LevenbergMarquardt(rtol=1e-6, atol=1e-6, linear_solver=lx.Normal(lx.Cholesky()))
    found = optx.least_squares(_residual, solver, y0, args=problem, max_steps=200, throw=False)
    slope = jax.jacfwd(_residual)(found.value, problem)
    triangle = jnp.asarray(jnp.linalg.qr(slope, mode="r"))
    inverse = jax.scipy.linalg.solve_triangular(triangle, jnp.eye(len(y0)))
    return found.value, inverse @ inverse.T, found.result == optx.RESULTS.successful


def _effective_noise(residual: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """σ √(1 + 2 Σ ρ_k): what white noise would have to be to average out as slowly as this residual.

    ρ is summed up to its first zero (Geyer's initial positive sequence).
    """
    out = np.zeros(residual.shape[1])
    for j, (e, ok) in enumerate(zip(residual.T, valid.T, strict=True)):
        e = np.where(ok, e, 0.0)
        count = max(int(ok.sum()), 1)
        size = 2 ** int(np.ceil(np.log2(2 * len(e))))
        correlation = np.fft.irfft(np.abs(np.fft.rfft(e, size)) ** 2)[: len(e) // 4 + 1] / count
        variance = max(correlation[0], 1e-300)
        ends = np.flatnonzero(correlation <= 0)
        stop = ends[0] if len(ends) else len(correlation)
        out[j] = np.sqrt(variance + 2 * correlation[1:stop].sum()) if variance > 1e-300 else 0.0
    return out


def _rms(x: np.ndarray, valid: np.ndarray) -> np.ndarray:
    return np.sqrt(np.sum(np.where(valid, x, 0.0) ** 2, axis=0) / np.maximum(valid.sum(axis=0), 1))


def _block(covariance: Array, start: int, shape: tuple[int, ...]) -> np.ndarray:
    size = int(np.prod(shape))
    return np.sqrt(np.diagonal(np.asarray(covariance))[start : start + size]).reshape(shape)
