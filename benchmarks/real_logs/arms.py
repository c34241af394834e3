"""Panda and LWR4+ (joint torque sensors): fit on one log, judged on others; what the log cannot determine."""

import time
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jax_inertia as ji
from benchmarks.real_logs.logs import LWR, PANDA, Setting
from jax_inertia.estimation import batch_fit
from jax_inertia.estimation.batch_fit import BatchFit
from jax_inertia.estimation.inertial_filter import make_estimator
from jax_inertia.estimation.physical_estimate import Estimate
from jax_inertia.estimation.priors import Tolerance
from jax_inertia.maths.inertial_parameters import PI_NAMES
from jax_inertia.maths.least_squares import Identifiability, weighted_least_squares
from jax_inertia.model.robot import Robot
from jax_inertia.signals.differences import Observation
from jax_inertia.signals.torque_residual import FRICTION_VELOCITY, torque_residuals


@dataclass(frozen=True)
class Arm:
    """One robot's logs and models."""

    name: str
    setting: Setting
    model: str
    reference: str
    trust: Tolerance
    train: str
    tests: tuple[str, ...]


ARMS = (
    # The placeholder model has 1 kg at each joint: nothing of it is trusted.
    Arm(
        "Panda",
        PANDA,
        "model_kinematics_placeholder.xml",
        "reference_model_identified.xml",
        Tolerance(1.0, 0.1, 1.0),
        "train",
        ("test",),
    ),
    Arm(
        "LWR4+",
        LWR,
        "model_kuka_lwr4_nominal_centroepiaggio.urdf",
        "reference_kuka_lwr4_identified.urdf",
        Tolerance(0.3, 0.05, 0.5),
        "train_1",
        ("train_2_repeat", "test_3"),
    ),
)


@dataclass(frozen=True)
class ArmResult:
    """What came of one arm."""

    arm: Arm
    fit: BatchFit
    seconds: float
    prior: Estimate
    residuals: dict[str, dict[str, np.ndarray]]
    """log → model → rms of the residual of each joint [N m]."""
    torque: dict[str, np.ndarray]
    """log → rms of the torque about its mean [N m]."""
    structural: Identifiability
    """Of random postures and motions: what no log can tell."""
    by_log: Identifiability


def evaluate(arm: Arm) -> ArmResult:
    """Fit on the training log; residuals on all logs."""
    robot, reference = arm.setting.model(arm.model), arm.setting.model(arm.reference)
    logs = {name: arm.setting.observation(robot, name) for name in (arm.train, *arm.tests)}
    start = time.perf_counter()
    fit = batch_fit.fit(
        robot, [logs[arm.train]], prior=arm.trust, joint_terms=batch_fit.JOINT_TERMS
    )
    seconds = time.perf_counter() - start
    # The reference's own damping and friction are not the published ones: rigid bodies alone.
    rigid = eqx.tree_at(
        lambda r: (r.damping, r.frictionloss), reference, (jnp.zeros(robot.nv),) * 2
    )
    models = {
        "model as given": (robot, np.zeros(robot.nv)),
        "published bodies, no friction": (rigid, np.zeros(robot.nv)),
        "fitted": (fit.robot, fit.bias),
    }
    residuals = {
        name: {label: _rms(*model, log) for label, model in models.items()}
        for name, log in logs.items()
    }
    return ArmResult(
        arm=arm,
        fit=fit,
        seconds=seconds,
        prior=_prior(robot, arm.trust),
        residuals=residuals,
        torque={name: _spread(log) for name, log in logs.items()},
        structural=_identifiability(robot, *_random_states(robot)),
        by_log=_identifiability(robot, *_states(logs[arm.train])),
    )


def _rms(robot: Robot, bias: np.ndarray, log: Observation) -> np.ndarray:
    regressor, others = _residuals(robot, log, (0,), jnp.asarray(bias))
    residual = others + regressor[:, :, 0] @ robot.pi[0]
    valid = np.asarray(log.motion.valid)
    return np.sqrt(np.sum(np.where(valid, residual, 0.0) ** 2, axis=0) / valid.sum(axis=0))


def _spread(log: Observation) -> np.ndarray:
    tau = np.where(log.motion.valid, log.motion.tau, np.nan)
    return np.nanstd(tau, axis=0)


def _prior(robot: Robot, trust: Tolerance) -> Estimate:
    estimator = make_estimator(robot, range(robot.nb), sigma_tau=1.0, prior=trust)
    return estimator.estimate(estimator.prior)


def _states(log: Observation) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    every = slice(None, None, 5)
    return tuple(np.asarray(x)[every] for x in (log.motion.q, log.motion.v, log.a))


def _random_states(robot: Robot) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    q = rng.uniform(-np.pi, np.pi, (400, robot.nq))
    v, a = rng.normal(size=(2, 400, robot.nv))
    return q, 2 * v, 5 * a


def _identifiability(robot: Robot, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> Identifiability:
    """Rank and null space of [bodies, damping, friction, armature, offset]."""
    bodies = np.asarray(_regressors(robot, q, v, a)).reshape(len(q), robot.nv, -1)
    terms = np.stack([v, np.tanh(v / FRICTION_VELOCITY), a, np.ones_like(v)], axis=-1)
    eye = np.eye(robot.nv)[None, :, :, None]
    own = (terms[:, :, None, :] * eye).reshape(len(q), robot.nv, -1)
    names = [f"{b}.{p}" for b in robot.body_names for p in PI_NAMES]
    names += [f"{j}.{t}" for j in robot.joint_names for t in batch_fit.JOINT_TERMS]
    y = np.concatenate([bodies, own], axis=-1).reshape(-1, len(names))
    return weighted_least_squares(y, np.zeros(len(y)), names=names).identifiability


_residuals = eqx.filter_jit(torque_residuals)


@eqx.filter_jit
def _regressors(robot, q, v, a):
    return jax.lax.map(lambda x: ji.torque_regressor(robot, *x), (q, v, a), batch_size=64)
