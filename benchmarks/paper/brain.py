"""What runs at 333 Hz on every robot: estimator, hand-over, reference, whole-body controller, batched over the fleet.

Four controllers share one code and differ in the parameters that they are told: `NONE` the nominal ones, `ADAPTIVE`
the filter's through the slew, `ORACLE` the true ones, `COMPOSITE` the filter's moved by the tasks' error besides.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from benchmarks.paper.plant import PER_TICK, TICK, Sensed, Sensors
from jax_inertia import load_model
from jax_inertia.control.composite import damping_step
from jax_inertia.control.whole_body import Gains, Reference, WholeBody, make_whole_body
from jax_inertia.dynamics.rigid_body import (
    body_jacobian,
    body_poses,
    mass_matrix,
    torque_regressor,
)
from jax_inertia.dynamics.sparse_rows import moved_rows
from jax_inertia.estimation.inertial_filter import Estimator, State, Step, make_estimator
from jax_inertia.estimation.online.slew import Slew
from jax_inertia.estimation.priors import Uncertainty
from jax_inertia.maths import spatial
from jax_inertia.maths.charts import Chart, LogCholeskyUUt
from jax_inertia.maths.gates import Gate
from jax_inertia.maths.inertial_parameters import is_physical
from jax_inertia.maths.noise import CorrelatedNoise
from jax_inertia.model.robot import Robot
from jax_inertia.robots import CORNERS
from jax_inertia.signals.differences import Observation
from jax_inertia.signals.generalised_motion import Motion

NONE, ADAPTIVE, ORACLE, COMPOSITE = range(4)
MODES = ("none", "adaptive", "oracle", "composite")
FEET = ("left_foot_link", "right_foot_link")
POINTS = np.array([c.pos for c in CORNERS]).reshape(2, 4, 3)
ARM = ("shoulder", "elbow")
GAINS = Gains()


class Inputs(eqx.Module):
    """One robot's tick: what it senses, who it is, and the truth that only `ORACLE` is told."""

    q: Float[Array, "nq"]
    v: Float[Array, "nv"]
    mean_q: Float[Array, "nq"]
    mean_v: Float[Array, "nv"]
    a: Float[Array, "nv"]
    tau: Float[Array, "nv"]
    force: Float[Array, "8 3"]
    mode: Int[Array, ""]
    truth: Float[Array, "n 10"]
    on: Float[Array, ""]
    """1 once the estimator may run."""


class Memory(eqx.Module):
    """What a robot keeps from tick to tick."""

    filter: State
    handed: Float[Array, "n 10"]
    plan: Any
    time: Float[Array, ""]
    reference: Reference
    """Of the tick before; its own is not known before the parameters are told."""


class Output(eqx.Module):
    """What a tick gives: torques for the plant, the rest for the record."""

    torque: Float[Array, "nu"]
    pi: Float[Array, "n 10"]
    physical: Array
    nis: Float[Array, ""]
    accepted: Array
    residual: Float[Array, ""]
    converged: Array
    record: Any


Refer = Callable[..., tuple[Any, Reference, Any]]
"""Plan, terms, inputs, time → plan, reference, record."""


class Brain(eqx.Module):
    """Constants of the fleet's robots."""

    robot: Robot
    controller: WholeBody
    estimator: Estimator
    slew: Slew
    refer: Refer
    damping: Float[Array, ""] | None
    """Rate at which `COMPOSITE` lets the tasks' error decay [1/s]; None: nobody runs it."""

    def start(self, plan: Any) -> Memory:
        """Memory of one robot before its first tick."""
        nominal = self.robot.pi[np.array(self.estimator.bodies)]
        zero = jnp.zeros(())
        none = Reference(
            com_acceleration=jnp.zeros(2),
            height=jnp.zeros(3),
            heading=zero,
            foot=jnp.zeros((2, 3, 3)),
            foot_heading=jnp.zeros(2),
            contact=jnp.zeros(8),
            stance=jnp.zeros(2),
            posture=jnp.zeros((3, self.robot.nv - 6)),
        )
        return Memory(self.estimator.initial(), nominal, plan, zero, none)

    def tick(self, memory: Memory, x: Inputs) -> tuple[Memory, Output]:
        """One robot, one tick."""
        bodies = self.estimator.bodies
        running, step, pi = self.follow(memory.filter, x)
        handed = self.slew.step(memory.handed, pi, TICK)
        moved = self.moved_by_the_task(handed, x, memory)
        told = jnp.stack([self.robot.pi[np.array(bodies)], handed, x.truth, moved])[x.mode]
        now = self.controller.terms(self.robot.with_pi(bodies, told), x.q, x.v)
        plan, reference, record = self.refer(memory.plan, now, x, memory.time)
        command = self.controller.command(now, x.q, x.v, reference)
        out = Output(
            command.torque,
            pi,
            is_physical(pi),
            step.innovation.nis,
            step.innovation.accepted,
            command.residual,
            command.converged,
            record,
        )
        return Memory(running, handed, plan, memory.time + TICK, reference), out

    def moved_by_the_task(
        self, pi: Float[Array, "n 10"], x: Inputs, memory: Memory
    ) -> Float[Array, "n 10"]:
        """π of the bodies, moved by the tasks' error s along the geodesic of composite adaptation.

        The filter is the part of the law that follows the prediction's error, with its covariance for a gain; this is
        the part that follows the task's.
        """
        if self.damping is None:
            return pi
        bodies = self.estimator.bodies
        regressor = torque_regressor(self.robot, x.q, x.v, jnp.zeros_like(x.v), bodies)
        s = tracking_error(self.controller, x.q, x.v, memory.reference)
        s = jnp.where(carrying_rows(self.robot, self.controller.arm, bodies), s, 0.0)
        s = jnp.where(memory.time > 0, s, 0.0)
        mass = mass_matrix(self.robot.with_pi(bodies, pi), x.q)
        return damping_step(pi, regressor, s, mass, self.damping)

    def follow(self, state: State, x: Inputs) -> tuple[State, Step, Float[Array, "n 10"]]:
        """The filter's part of a tick: its state, what the sample gave, and π of the bodies."""
        running, step = self.estimator.step(state, self.observation(x), TICK)
        running = jax.tree.map(lambda a, b: jnp.where(x.on > 0, a, b), running, state)
        return running, step, self.estimator.chart.to_pi(running.belief.mean.reshape(-1, 10))

    def observation(self, x: Inputs) -> Observation:
        """The window's means as the estimator reads them, corner forces as wrenches on the feet."""
        motion = Motion(
            time=jnp.zeros(()),
            q=x.mean_q,
            v=x.mean_v,
            tau=x.tau,
            valid=jnp.ones(self.robot.nv, bool),
            wrench=foot_wrenches(self.robot, x.mean_q, x.force),
            contact_bodies=FEET,
            quaternions=(3,),
        )
        return Observation(motion, x.a)


def tracking_error(
    controller: WholeBody,
    q: Float[Array, " nq"],
    v: Float[Array, " nv"],
    reference: Reference,
) -> Float[Array, " nv"]:
    """s = v − v_r of the pelvis's height and of the arms, zero in the other rows [m/s, rad/s].

    v_r has errors decay at the rate of the tasks' own feedback. Attitude is left out: what corrects it is the centre of
    mass, which the walk's plan is made of.
    """
    gains, height, posture = controller.gains, reference.height, reference.posture
    rise = v[2] - height[1] + decay_rate(gains.height) * (q[2] - height[0])
    arms = v[6:] - posture[1] + decay_rate(gains.posture) * (q[7:] - posture[0])
    arms = jnp.where(np.array(controller.arm), arms, 0.0)
    return jnp.concatenate([jnp.zeros(2), rise[None], jnp.zeros(3), arms])


def carrying_rows(
    robot: Robot, arm: tuple[bool, ...], bodies: tuple[int, ...]
) -> Bool[np.ndarray, " nv"]:
    """Rows of `tracking_error` that the bodies answer for: joints of `arm` that carry them, else the pelvis's height.

    The pelvis carries all 90 kg. What it is off by, by the ground's give for one, is no sign of what a forearm weighs,
    and a forearm that made up for it would hold its own elbow off.
    """
    moved = np.isin(np.arange(robot.nv), moved_rows(robot, bodies))
    own = moved & np.concatenate([np.zeros(6, bool), arm])
    return own if own.any() else np.arange(robot.nv) == 2


def decay_rate(gain: tuple) -> Float[Array, ""]:
    """λ of v_r = −λ e for feedback −k e − d ė: the slower root of x² − d x + k [1/s]."""
    k, d = (jnp.asarray(x, float) for x in gain)
    return 0.5 * (d - jnp.sqrt(jnp.maximum(d**2 - 4.0 * k, 0.0)))


def foot_wrenches(
    robot: Robot, q: Float[Array, "nq"], force: Float[Array, "8 3"]
) -> Float[Array, "2 6"]:
    """[force; moment about the foot's frame origin], world axes, of forces at the soles' corners."""
    rotation, _ = body_poses(robot, q)
    index = np.array([robot.body_index(name) for name in FEET])
    arm = jnp.einsum("fij,fpj->fpi", rotation[index], jnp.asarray(POINTS, q.dtype))
    force = force.reshape(2, 4, 3)
    moment = spatial.cross(arm, force)
    return jnp.concatenate([force.sum(axis=1), moment.sum(axis=1)], axis=-1)


def measurement_noise(
    robot: Robot,
    q: Float[np.ndarray, "nq"],
    sensors: Sensors,
    model_error: tuple[float, float, float, float],
) -> CorrelatedNoise:
    """R of Δτ in the pose q, accelerations apart: torque noise, J Σ_λ Jᵀ of the feet, model error.

    Rows that the chosen bodies do not move matter too: they share the noise of those that do. Without the model's own
    error in R, friction in a knee would be read as noise of the ground's force, and so as mass.
    """
    pose = jnp.asarray(q)
    torque = np.full(robot.nv, (sensors.torque * sensors.averaged()) ** 2)
    torque[:6] = 0.0
    force, moment, leg, arm = model_error
    names = robot.joint_names[1:]
    own = [arm if any(part in name for part in ARM) else leg for name in names]
    r = np.diag(torque + np.array([force] * 3 + [moment] * 3 + own) ** 2)
    for side, name in enumerate(FEET):
        lever = np.zeros((4, 6, 3))
        lever[:, :3] = np.eye(3)
        rotation = np.asarray(body_poses(robot, pose)[0][robot.body_index(name)])
        lever[:, 3:] = np.asarray(spatial.skew(jnp.asarray(POINTS[side] @ rotation.T)))
        # Four corners, half of `foot_force` each.
        wrench = np.einsum("kij,klj->il", lever, lever) * (0.5 * sensors.foot_force()) ** 2
        j = np.asarray(body_jacobian(robot, pose, name))
        r = r + j.T @ wrench @ j
    return CorrelatedNoise(jnp.asarray(r))


def with_accelerations(
    noise: CorrelatedNoise, robot: Robot, q: Float[np.ndarray, " nq"], sensors: Sensors
) -> CorrelatedNoise:
    """R with M Σ_v̇ Mᵀ in the pose q added: noise of accelerations told as if it were torque's, as in the paper."""
    spread = mass_matrix(robot, jnp.asarray(q)) * sensors.acceleration()
    return noise.plus(spread @ spread.T)


_CHART = LogCholeskyUUt()


@dataclass(frozen=True)
class Settings:
    """The estimator's figures; each experiment states its own."""

    bodies: tuple[str, ...]
    prior: Uncertainty
    drift: Uncertainty
    chart: Chart = _CHART
    iterations: int = 1
    model_error: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    """What the model is off by, in R beside the sensors' noise: base (N, N m), legs and spine, arms (N m)."""
    gate: Gate | None = None
    reopen_after: float = float("inf")
    slew: float = 1e6  # kg/s
    damping: float | None = (
        None  # 1/s, of the tasks' error where it moves what the filter hands over
    )
    noisy_regressor: bool = False
    """Noise of accelerations is told as such, not as torque in the home pose; samples that windows share count once."""


def make_brain(
    model: mujoco.MjModel,
    settings: Settings,
    sensors: Sensors,
    refer: Refer,
    *,
    gains: Gains = GAINS,
    friction: float = 0.6,
    nominal_mass: float | None = None,
) -> Brain:
    """Estimator and controller of the robot `model`; `nominal_mass` is what they take the first body to weigh."""
    robot = load_model(model)
    if nominal_mass is not None:
        i = robot.body_index(settings.bodies[0])
        robot = robot.with_pi((i,), (robot.pi[i] * (nominal_mass / robot.pi[i, 0]))[None])
    home = model.key_qpos[0]
    noise = measurement_noise(robot, home, sensors, settings.model_error)
    sigma_a = None
    if settings.noisy_regressor:
        overlap = sensors.window / PER_TICK
        noise = CorrelatedNoise(noise.covariance * overlap)
        sigma_a = jnp.asarray(sensors.acceleration() * overlap**0.5)
    else:
        noise = with_accelerations(noise, robot, home, sensors)
    estimator = make_estimator(
        robot,
        settings.bodies,
        sigma_tau=1.0,
        prior=settings.prior,
        drift=settings.drift,
        chart=settings.chart,
        noise=noise,
        sigma_a=sigma_a,
        gate=settings.gate,
        reopen_after=settings.reopen_after,
        iterations=settings.iterations,
        paper=True,
    )
    controller = make_whole_body(
        robot,
        pelvis="pelvis_link",
        torso="torso_link",
        feet=FEET,
        points=POINTS,
        friction=friction,
        torque_limit=model.actuator_ctrlrange[:, 1],
        arm_joints=[j for j in robot.joint_names if any(a in j for a in ARM)],
        gains=jax.tree.map(jnp.asarray, gains),
    )
    damping = None if settings.damping is None else jnp.asarray(settings.damping)
    return Brain(robot, controller, estimator, Slew(settings.slew), refer, damping)


def inputs(sensed: Sensed, mode: np.ndarray, truth: np.ndarray, on: bool = True) -> Inputs:
    """`Inputs` of the whole fleet."""
    size = len(mode)
    state = (sensed.q, sensed.v, sensed.mean_q, sensed.mean_v, sensed.a, sensed.tau, sensed.force)
    told = np.broadcast_to(truth, (size, *truth.shape[-2:]))
    return Inputs(*(jnp.asarray(x) for x in (*state, mode, told, np.full(size, float(on)))))


def spread(tree: Any, size: int) -> Any:
    """One robot's memory for each of the fleet."""
    return jax.tree.map(lambda x: jnp.repeat(jnp.asarray(x)[None], size, axis=0), tree)
