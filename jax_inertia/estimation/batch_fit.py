"""Batch fit of bodies, joints and drive gains to logs, physical by construction.

The nonlinear counterpart of the paper's eq. least-squares: bodies move in a chart (so every iterate is physical), with
a Gaussian prior about the model; joint damping, dry friction, rotor inertia, torque offset and drive gain are fitted
with them where asked for. One joint's rows of a whole log are compressed by QR to a triangle as small as the number
of columns, so that Levenberg–Marquardt (optimistix) never sees the samples.

Model errors, not sensors, make most of a real residual, and they are slow: the noise of each joint is its residual's
standard deviation, widened by its correlation time. Intervals mean little without that.

Where the log holds currents, nothing in it sets the scale of torque: gains, bodies and friction may grow together.
Only the prior about the bodies stops them, so a load weighed by fitted gains is as uncertain as the model's own
masses. `Carried` fits a load in the same problem as the bodies and gains, so that its interval says so.
"""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jax_inertia.dynamics.rigid_body import resolve_bodies
from jax_inertia.estimation import batch_solve
from jax_inertia.estimation.batch_rows import TERMS, Rows, correlation_inflation, rows_of
from jax_inertia.estimation.inertial_filter import make_estimator
from jax_inertia.estimation.joint_terms import JointTerms
from jax_inertia.estimation.physical_estimate import Estimate, physical_units
from jax_inertia.estimation.priors import Load, Uncertainty
from jax_inertia.maths import charts
from jax_inertia.maths.argument_checks import is_positive, require
from jax_inertia.maths.inertial_parameters import is_physical
from jax_inertia.model.model_errors import ModelErrors
from jax_inertia.model.robot import Robot
from jax_inertia.signals.differences import Observation
from jax_inertia.text.notebook_page import line, table

JOINT_TERMS = ("damping", "frictionloss", "armature", "offset")


class Carried(eqx.Module):
    """A load that some of the logs carry and the others do not, fitted together with the bodies.

    Its π is signed (the `Linear` chart about zero): no load then reads zero on average, which a mass that must be
    positive cannot.
    """

    body: int | str = eqx.field(static=True)
    """The body that it is fixed to; its π is about this body's frame."""
    logs: tuple[int, ...] = eqx.field(static=True)
    """Which of the observations carry it."""
    prior: Load


class Calibrated(NamedTuple):
    """What a filter needs of a calibration."""

    robot: Robot
    gains: Float[np.ndarray, " nv"]
    bias: Float[np.ndarray, " nv"]


class BatchFit(eqx.Module):
    """A model fitted to logs."""

    robot: Robot
    """The robot with the fitted bodies, damping, friction and armature; a carried load is no part of it."""
    estimate: Estimate
    """The fitted bodies in physical units."""
    added: Estimate
    """What the fitted bodies have beyond the model's own, whose errors are in σ: a load that they carry."""
    load: Estimate | None
    """The carried load, one body, where one was asked for."""
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
    steps: int = eqx.field(static=True)
    """Levenberg–Marquardt steps, all rounds together."""
    cost: float = eqx.field(static=True)
    """½ of the sum of squares at the end, in units of the noise, the prior's share included."""
    converged: bool = eqx.field(static=True)
    _nominal: Robot
    _bodies: tuple[int, ...] = eqx.field(static=True)
    _problem: batch_solve.Problem
    _solution: batch_solve.Solution

    @property
    def bias(self) -> Float[np.ndarray, " nv"]:
        """The torque offset, as the filter's bias."""
        return self.joint_terms["offset"]

    def __repr__(self) -> str:
        rms = [float(np.sqrt(np.mean(x**2))) for x in (self.rms_before, self.rms_after)]
        state = f"settled in {self.steps} steps" if self.converged else "not settled"
        lines = [f"BatchFit({state}; residual {rms[0]:.3g} → {rms[1]:.3g} N m rms; ± 95 %)"]
        for body, (mass, com) in zip(self._bodies, self.estimate.rows(), strict=True):
            lines.append(f"  {self.robot.body_names[body]}: {mass} kg at {com} mm")
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        """For notebooks: the fitted bodies with 95 % intervals."""
        names = (self.robot.body_names[b] for b in self._bodies)
        rows = ((n, *row) for n, row in zip(names, self.estimate.rows(), strict=True))
        head = ("body", "mass [kg]", "centre of mass [mm]")
        return line(repr(self).partition("\n")[0]) + table(head, rows)

    def draws(self, count: int, seed: int = 0) -> list[Calibrated]:
        """Models drawn from the posterior: run a filter over each to see what the calibration leaves open."""
        z = self._solution.z
        root = np.linalg.cholesky(np.asarray(z.covariance))
        normal = np.random.default_rng(seed).normal(size=(count, len(root)))
        return [
            _calibrated(
                self._nominal, self._bodies, self._problem, jnp.asarray(z.mean + root @ one)
            )
            for one in normal
        ]


def fit(
    robot: Robot,
    observations: Sequence[Observation],
    bodies: Sequence[int | str] | None = None,
    *,
    prior: Uncertainty,
    joint_terms: Sequence[str] = (),
    joints: JointTerms | None = None,
    errors: ModelErrors | None = None,
    gains: Float[np.ndarray, " nv"] | None = None,
    gain_sigma: float = 0.0,
    bias: Float[np.ndarray, " nv"] | None = None,
    carried: Carried | None = None,
    chart: charts.Chart | None = None,
) -> BatchFit:
    """Fit bodies (default: all with mass) and joint terms to one or several logs of the same robot.

    `prior` says how far bodies may be from the model; `joint_terms` any of
    "damping", "frictionloss", "armature", "offset" (one of each per joint; never below zero in total, offset apart),
    each as large as the joint's whole torque may make it; `joints` gives sizes of its own to friction and offset
    instead. By its `errors` the rest of the model may be off: they are fitted in the same problem, and the intervals
    contain what they leave open. Those of the bodies that are fitted count for what these have `added` alone.
    Where the logged torque is a current, `gains` are the torques per unit to start from and `gain_sigma` their
    relative uncertainty (0: they are exact); the log's torque must then still be in its own unit. Raises ValueError
    for unknown names or terms, where there is no list of observations, and for a prior that is no positive number.

    >>> from jax_inertia import load_model
    >>> from jax_inertia.estimation import batch_fit, log_filter
    >>> from jax_inertia.estimation.priors import Load
    >>> from jax_inertia.robots.pendulum import double_pendulum, swing
    >>> robot = load_model(double_pendulum())
    >>> log = log_filter.observe(swing(load=0.5), robot)
    >>> found = batch_fit.fit(robot, [log], ["lower"], prior=Load(1.0))
    >>> round(float(found.estimate.pi[0, 0]), 1)  # 1 kg of link, 0.5 kg of load
    1.5
    """
    _check_observations(observations)
    _check_terms(joint_terms)
    chosen = _fittable(robot) if bodies is None else resolve_bodies(robot, bodies)
    # The factor whose t is the centre of mass needs the fewest steps: mass and inertia about it decouple.
    chart = charts.LogCholeskyUUt() if chart is None else chart
    rows, problem = _pose(
        robot, observations, chosen, prior, joint_terms, gains, gain_sigma, bias, carried, errors,
        chart,
    )  # fmt: skip
    if joints is not None:
        own = _sizes(joints)
        problem = eqx.tree_at(lambda p: p.terms_sigma, problem, own)
    before = _before(robot, rows, problem, chosen)
    problem, solution, steps = _alternate(robot, rows, problem)

    unknowns = batch_solve.unpack(problem, solution.z.mean)
    gain = np.asarray(unknowns.gains)
    n, linear, terms, _ = problem.sizes
    spread = np.sqrt(np.diagonal(np.asarray(solution.z.covariance)))
    z_terms, z_gain = np.split(spread[n + linear :], [terms])
    covariance = problem.bodies_root @ solution.z.covariance[:n, :n] @ problem.bodies_root.T
    sigma = np.asarray(problem.terms_sigma) * z_terms.reshape(-1, TERMS)
    after = rows.residual(np.asarray(unknowns.weights(chart)), gain)
    return BatchFit(
        robot=_calibrated(robot, chosen, problem, solution.z.mean).robot,
        estimate=physical_units(chart, unknowns.x, covariance),
        added=_added(robot, chosen, problem, solution, errors, _spread(rows, problem, solution)),
        load=None if carried is None else _load(problem, solution),
        joint_terms=dict(zip(JOINT_TERMS, np.asarray(unknowns.terms).T, strict=True)),
        joint_sigma=dict(zip(JOINT_TERMS, sigma.T, strict=True)),
        gains=gain,
        gains_sigma=np.abs(gain) * np.asarray(problem.gain_sigma) * z_gain,
        rms_before=rows.rms(before * np.asarray(problem.gain_start)),
        rms_after=rows.rms(after * gain),
        noise=np.asarray(problem.noise) * np.abs(gain),
        steps=steps,
        cost=float(solution.cost),
        converged=bool(solution.successful),
        _nominal=robot,
        _bodies=chosen,
        _problem=problem,
        _solution=solution,
    )


def _check_observations(observations: Sequence[Observation]) -> None:
    right = "give a list: [logfilter.observe(log, robot)]"
    if not isinstance(observations, Sequence):
        raise ValueError(f"observations is one {type(observations).__name__}; {right}")
    if not observations:
        raise ValueError(f"observations is empty; {right}")
    for k, one in enumerate(observations):
        if not isinstance(one, Observation):
            raise ValueError(f"observations[{k}] is of type {type(one).__name__}; {right}")


def _check_terms(joint_terms: Sequence[str]) -> None:
    if isinstance(joint_terms, str):
        raise ValueError(f"joint_terms is the text {joint_terms!r}; give a list: [{joint_terms!r}]")
    if unknown := [t for t in joint_terms if t not in JOINT_TERMS]:
        raise ValueError(f"unknown joint terms {unknown}; valid: {', '.join(JOINT_TERMS)}")


def _fittable(robot: Robot) -> tuple[int, ...]:
    """Bodies that a chart reaches: massless frames of a URDF stay as they are."""
    return tuple(int(i) for i in np.flatnonzero(np.asarray(is_physical(robot.pi))))


def carried_with(robot: Robot, asked: tuple[int, ...]) -> tuple[int, ...]:
    """Other bodies carried by the same joints as those in `asked`: their errors enter the same torque rows.

    Of the six rows of a floating base, which carries all, nothing is made.

    >>> from jax_inertia import load_model
    >>> from jax_inertia.estimation.batch_fit import carried_with
    >>> from jax_inertia.robots.pendulum import double_pendulum
    >>> carried_with(load_model(double_pendulum()), (1,))
    (0,)
    """
    moved = np.asarray(robot.topology.body_dof) > 0
    rows = np.any(moved[list(asked)], axis=0) & robot.topology.dof_scalar
    seen = np.any(moved[:, rows], axis=1)
    return tuple(i for i in _fittable(robot) if seen[i] and i not in asked)


def _sizes(joints: JointTerms) -> jax.Array:
    """Prior σ of the four joint terms in the order of `JOINT_TERMS`: no armature."""
    damping, friction, offset = joints.sigma.T
    return jnp.stack([damping, friction, jnp.zeros_like(offset), offset], axis=1)


def _pose(
    robot: Robot,
    observations: Sequence[Observation],
    chosen: tuple[int, ...],
    prior: Uncertainty,
    joint_terms: Sequence[str],
    gains: Float[np.ndarray, " nv"] | None,
    gain_sigma: float,
    bias: Float[np.ndarray, " nv"] | None,
    carried: Carried | None,
    errors: ModelErrors | None,
    chart: charts.Chart,
) -> tuple[Rows, batch_solve.Problem]:
    """The rows, and the problem with noise still to be found."""
    start = make_estimator(robot, chosen, sigma_tau=1.0, prior=prior, chart=chart).prior
    root = jnp.linalg.cholesky(start.covariance)
    if not np.all(np.isfinite(root)):
        raise ValueError(
            f"the prior ({type(prior).__name__}) holds a body fast; its numbers must be positive"
        )
    gain_start = np.ones(robot.nv) if gains is None else np.asarray(gains, float)
    fixed_bias = np.zeros(robot.nv) if bias is None else np.asarray(bias, float)
    carrier, carrying, load_sigma = None, (), np.zeros(0)
    if carried is not None:
        (carrier,) = resolve_bodies(robot, [carried.body])
        carrying, load_sigma = carried.logs, np.asarray(carried.prior.sigma_pi())
        require("sigma_pi of the load carried", load_sigma, is_positive, "positive and finite")
        if not carrying or not set(carrying) <= set(range(len(observations))):
            raise ValueError(
                f"logs {list(carrying)} carry the load; expected some of 0 to {len(observations) - 1}"
            )
    rows = rows_of(robot, observations, chosen, fixed_bias, carrier, carrying, errors)
    count = 0 if errors is None else errors.pi.shape[-1]
    scale = np.abs(gain_start) * rows.rms(rows.raw)
    problem = batch_solve.Problem(
        triangles=jnp.asarray(rows.triangles()),
        chart=chart,
        bodies=start.mean,
        bodies_root=root,
        linear_sigma=jnp.asarray(np.append(load_sigma, np.ones(count))),
        terms_start=jnp.zeros((robot.nv, TERMS)),
        terms_sigma=jnp.asarray(_terms_sigma(robot, rows, scale, joint_terms)),
        gain_start=jnp.asarray(gain_start),
        gain_sigma=jnp.asarray(np.where(robot.topology.dof_scalar, gain_sigma, 0.0)),
        noise=jnp.ones(robot.nv),
    )
    return rows, problem


def _terms_sigma(
    robot: Robot, rows: Rows, scale: np.ndarray, joint_terms: Sequence[str]
) -> np.ndarray:
    """Prior σ of each joint term: enough to make up the joint's whole torque, or for the model's own to vanish."""
    size = np.stack([rows.rms(rows.columns[:, :, k - TERMS]) for k in range(TERMS)], axis=1)
    sigma = scale[:, None] / np.maximum(size, 1e-9)
    sigma[:, :3] = np.maximum(sigma[:, :3], _own_terms(robot))
    wanted = np.array([t in joint_terms for t in JOINT_TERMS])
    return np.where(wanted & robot.topology.dof_scalar[:, None] & (size > 0), sigma, 0.0)


def _own_terms(robot: Robot) -> np.ndarray:
    """The model's own damping, dry friction and armature (nv, 3)."""
    return np.stack([robot.damping, robot.frictionloss, robot.armature], axis=1)


def _before(
    robot: Robot, rows: Rows, problem: batch_solve.Problem, chosen: tuple[int, ...]
) -> np.ndarray:
    """Residual of the model as it was given."""
    w = np.zeros((robot.nv, rows.columns.shape[2]))
    w[:, : 10 * len(chosen)] = np.asarray(robot.pi)[list(chosen)].ravel()
    return rows.residual(w, np.asarray(problem.gain_start))


def _alternate(
    robot: Robot, rows: Rows, problem: batch_solve.Problem
) -> tuple[batch_solve.Problem, batch_solve.Solution, int]:
    """Fit, take the noise that the residual shows, fit again: (problem, solution, steps).

    The first noise is what each joint's best linear fit leaves, whatever the other joints say. It takes part in the
    second as a lower bound, and there is no third: iterated further, noise would drive a joint that the model fits
    badly out of the fit (less weight, a slower and larger residual, less weight still).
    """
    floor = np.maximum(1e-4 * rows.rms(rows.raw), 1e-9)
    best = rows.linear_residual(
        np.asarray(problem.triangles),
        np.asarray(problem.gain_start),
        np.asarray(problem.gain_sigma) > 0,
    )
    first = np.maximum(_effective_noise(rows, best), floor)
    problem = _with_noise(problem, first)
    problem, solution, steps = _solve(robot, problem, jnp.zeros(sum(problem.sizes)))
    unknowns = batch_solve.unpack(problem, solution.z.mean)
    left = rows.residual(np.asarray(unknowns.weights(problem.chart)), np.asarray(unknowns.gains))
    problem = _with_noise(problem, np.maximum(_effective_noise(rows, left), first))
    problem, solution, more = _solve(robot, problem, solution.z.mean)
    return problem, solution, steps + more


def _solve(
    robot: Robot, problem: batch_solve.Problem, z: jax.Array
) -> tuple[batch_solve.Problem, batch_solve.Solution, int]:
    """Solve from z with no joint term below zero in total: (problem, solution, steps).

    An active set: in each round and of each joint, the term that is furthest below is fixed at zero.
    """
    own, steps = _own_terms(robot), 0
    while True:
        solution = batch_solve.solve(problem, z)
        z, steps = solution.z.mean, steps + int(solution.steps)
        sigma = np.array(problem.terms_sigma)
        total = own + np.asarray(batch_solve.unpack(problem, z).terms)[:, :3]
        below = np.where(sigma[:, :3] > 0, total / np.maximum(sigma[:, :3], 1e-300), 0.0)
        worst, joint = np.argmin(below, axis=1), np.arange(robot.nv)
        negative = below[joint, worst] < -1e-9
        if not negative.any():
            return problem, solution, steps
        at = joint[negative], worst[negative]
        sigma[at] = 0.0
        start = np.array(problem.terms_start)
        start[at] = -own[at]
        problem = eqx.tree_at(
            lambda p: (p.terms_start, p.terms_sigma),
            problem,
            (jnp.asarray(start), jnp.asarray(sigma)),
        )


def _effective_noise(rows: Rows, residual: np.ndarray) -> np.ndarray:
    return rows.rms(residual) * correlation_inflation(residual, rows.valid)


def _with_noise(problem: batch_solve.Problem, noise: np.ndarray) -> batch_solve.Problem:
    return eqx.tree_at(lambda p: p.noise, problem, jnp.asarray(noise))


def _calibrated(
    robot: Robot, chosen: tuple[int, ...], problem: batch_solve.Problem, z: jax.Array
) -> Calibrated:
    unknowns = batch_solve.unpack(problem, z)
    # A chart may reach negative masses (`Linear`), and what was found is to be seen.
    fitted = robot.believed(chosen, problem.chart.to_pi(unknowns.x.reshape(-1, 10)))
    # The fit itself keeps totals above zero; a draw from its Gaussian may not.
    total = jnp.maximum(jnp.asarray(_own_terms(robot)) + unknowns.terms[:, :3], 0.0)
    damping, friction, armature = total.T
    fitted = eqx.tree_at(
        lambda r: (r.damping, r.frictionloss, r.armature), fitted, (damping, friction, armature)
    )
    return Calibrated(fitted, np.asarray(unknowns.gains), np.asarray(unknowns.terms[:, 3]))


def _load(problem: batch_solve.Problem, solution: batch_solve.Solution) -> Estimate:
    n = len(problem.bodies)
    sigma = problem.linear_sigma[:10]
    covariance = solution.z.covariance[n : n + 10, n : n + 10] * sigma[:, None] * sigma
    pi = batch_solve.unpack(problem, solution.z.mean).linear[:10]
    return physical_units(charts.Linear(), pi, covariance)


def _added(
    robot: Robot,
    chosen: tuple[int, ...],
    problem: batch_solve.Problem,
    solution: batch_solve.Solution,
    errors: ModelErrors | None,
    spread: Float[np.ndarray, "z z"],
) -> Estimate:
    """π of the bodies less the model's own: l = π(x) − π₀ − E z, E: what one σ of each error is of π₀.

    x and z are believed jointly, so what both are off by together is not in l. What remains is small enough for errors
    of the equations to count: the `spread` of tenths of the log is in its σ.
    """
    unknowns = batch_solve.unpack(problem, solution.z.mean)
    x = unknowns.x.reshape(-1, 10)
    count = 0 if errors is None else errors.pi.shape[-1]
    n, last = len(unknowns.x), len(unknowns.x) + len(unknowns.linear)
    own = np.zeros((n, 0)) if errors is None else errors.pi[np.array(chosen)].reshape(n, count)
    slope = jnp.zeros((n, len(solution.z.mean)))
    g = jax.scipy.linalg.block_diag(*problem.chart.jacobian(x))
    slope = slope.at[:, :n].set(g @ problem.bodies_root).at[:, last - count : last].set(-own)
    z = unknowns.linear[len(unknowns.linear) - count :]
    added = problem.chart.to_pi(x).ravel() - robot.pi[np.array(chosen)].ravel() - own @ z
    covariance = slope @ (solution.z.covariance + spread) @ slope.T
    return physical_units(charts.Linear(), added, covariance)


_GROUPS = 10
"""Parts of a log that are taken for independent of each other, as in a diagnosis (`Selection.spread_with`)."""


def _spread(
    rows: Rows, problem: batch_solve.Problem, solution: batch_solve.Solution
) -> Float[np.ndarray, "z z"]:
    """Covariance of z by what tenths of the log say of it: C Σ_g s_g s_gᵀ C · G / (G − 1), s_g their centred scores.

    Rows may err together within a tenth (White, Econometrica 48(4), 1980; Liang and Zeger, Biometrika 73(1), 1986).
    """
    z = solution.z.mean
    slopes = np.asarray(
        jax.jacfwd(lambda z: batch_solve.unpack(problem, z).weights(problem.chart))(z)
    )
    unknowns, noise = batch_solve.unpack(problem, z), np.asarray(problem.noise)
    gain = np.asarray(unknowns.gains)
    e = rows.residual(np.asarray(unknowns.weights(problem.chart)), gain)
    e = np.where(rows.valid, e, 0.0) / noise**2 / gain
    groups = np.array_split(np.arange(len(e)), _GROUPS)
    scores = np.array(
        [
            np.einsum("jc,jcz->z", np.einsum("tjc,tj->jc", rows.columns[g], e[g]), slopes)
            for g in groups
        ]
    )
    moved = (scores - scores.mean(axis=0)) @ np.asarray(solution.z.covariance)
    return moved.T @ moved * (_GROUPS / (_GROUPS - 1))
