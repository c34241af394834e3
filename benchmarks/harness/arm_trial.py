"""One closed-loop trial in MJX: an arm picks something up, weighs it, and its controller takes the filter's word.

The law is computed torque with the *estimated* parameters of the hand, so that the estimator is inside the loop. All
that is random hangs on the seed and the trial's own number, never on how trials are batched.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Float, Int
from mujoco import mjx

from jax_inertia import inverse_dynamics, load_model, mass_matrix
from jax_inertia.dynamics.rigid_body import passive_torque
from jax_inertia.estimation.inertial_filter import Estimator, make_estimator
from jax_inertia.estimation.priors import Load
from jax_inertia.maths.gates import ChiSquaredGate
from jax_inertia.maths.inertial_parameters import is_physical
from jax_inertia.robots.arm import HAND, arm_mjcf
from jax_inertia.signals.differences import Observation
from jax_inertia.signals.generalised_motion import Motion

STEP, PER_TICK, PICK_UP = 0.002, 2, 0.6  # s, steps, s
TICK = STEP * PER_TICK
SIGMA_TAU, SIGMA_V = 0.5, 1e-3  # N m, rad/s
STIFFNESS, DAMPING = 60.0, 15.0  # 1/s², 1/s
DRIFT = 1.0  # kg/√s that the filter is told of
KEPT = 25  # entries of the mass's course that are kept


_SMALL = """
<mujoco><option timestep="0.002"/><worldbody>
  <body name="upper" pos="0 0 1"><joint name="a" axis="0 1 0" damping="0.3" armature="0.02"/>
    <inertial pos="0.01 0 -0.2" mass="2.1" diaginertia="0.03 0.03 0.004"/>
    <body name="hand" pos="0 0 -0.4"><joint name="b" axis="1 1 0" damping="0.2" armature="0.02"/>
      <inertial pos="0.02 0.01 -0.15" mass="1.1" diaginertia="0.01 0.011 0.002"/></body></body>
</worldbody><actuator><motor joint="a" ctrlrange="-60 60" ctrllimited="true"/>
<motor joint="b" ctrlrange="-30 30" ctrllimited="true"/></actuator></mujoco>
"""
ROBOTS = {"small": lambda: _SMALL, "arm": arm_mjcf}
"""Two hinges, quick to compile, and the arm of seven; both carry the load in a body `hand`."""


class Outcome(eqx.Module):
    """What is kept of a trial."""

    index: Int[Array, "*n"]
    load: Float[Array, "*n"]
    mass: Float[Array, "*n course"]
    """Estimated mass of the hand, evenly over the trial [kg]."""
    error: Float[Array, "*n"]
    """Estimated less true mass at the end [kg]."""
    sigma: Float[Array, "*n"]
    tracking: Float[Array, "*n"]
    """Root mean square joint error after the pick-up [rad]."""
    nis_over_rows: Float[Array, "*n"]
    rejected: Float[Array, "*n"]
    physical: Float[Array, "*n"]
    """Share of samples whose estimate is a body that can exist."""


class ArmTrial(eqx.Module):
    """What all trials share."""

    estimator: Estimator
    model: mjx.Model
    start: mjx.Data
    limit: Float[Array, "n"]
    hand: int = eqx.field(static=True)
    ticks: int = eqx.field(static=True)

    def __call__(self, seed: Int[Array, ""], index: Int[Array, ""]) -> Outcome:
        """Trial number `index`."""
        keys = jax.random.split(jax.random.fold_in(jax.random.key(seed), index), 4)
        robot, nominal = self.estimator.robot, self.estimator.robot.pi
        joints = robot.nv
        load = jax.random.uniform(keys[0], minval=0.5, maxval=3.0)
        rate = 2.0 * jnp.pi * jax.random.uniform(keys[1], (joints,), minval=0.2, maxval=0.7)
        phase = jax.random.uniform(keys[2], (joints,), maxval=2.0 * jnp.pi)

        def wanted(t):
            return jnp.stack(
                [
                    0.4 * jnp.sin(rate * t + phase),
                    0.4 * rate * jnp.cos(rate * t + phase),
                    -0.4 * rate**2 * jnp.sin(rate * t + phase),
                ]
            )

        def tick(carry, k):
            data, state, v_before = carry
            t = k * TICK
            want, noise = wanted(t), jax.random.normal(jax.random.fold_in(keys[3], k), (2, joints))
            told = self.estimator.chart.to_pi(state.belief.mean.reshape(-1, 10))
            known = robot.with_pi(self.estimator.bodies, told)
            a = want[2] + STIFFNESS * (want[0] - data.qpos) + DAMPING * (want[1] - data.qvel)
            tau = inverse_dynamics(known, data.qpos, data.qvel, a)
            tau = tau - passive_torque(known, data.qpos, data.qvel)
            tau = jnp.clip(tau, -self.limit, self.limit)
            carried = jnp.where(t >= PICK_UP, load, 0.0)
            model = self.model.replace(
                body_mass=self.model.body_mass.at[self.hand].add(carried),
                body_inertia=self.model.body_inertia.at[self.hand].add(0.4 * carried * 0.05**2),
            )
            held = data.replace(ctrl=tau)
            after = jax.lax.fori_loop(0, PER_TICK, lambda _, d: mjx.step(model, d), held)
            v_after = after.qvel + SIGMA_V * noise[0]
            motion = Motion(
                time=t,
                q=0.5 * (data.qpos + after.qpos),
                v=0.5 * (v_before + v_after),
                tau=tau + SIGMA_TAU * noise[1],
                valid=jnp.ones(joints, bool),
            )
            seen = Observation(motion, (v_after - v_before) / TICK)
            state, step = self.estimator.step(state, seen, TICK)
            pi = self.estimator.chart.to_pi(state.belief.mean.reshape(-1, 10))[0]
            made = step.innovation
            off = jnp.mean((after.qpos - wanted(t + TICK)[0]) ** 2)
            record = (pi[0], made.nis / joints, made.accepted, off, is_physical(pi))
            return (after, state, v_after), record

        at_start = self.start.replace(qpos=wanted(0.0)[0], qvel=wanted(0.0)[1])
        begin = (at_start, self.estimator.initial(), at_start.qvel)
        numbers = jnp.arange(self.ticks)
        (_, state, _), (mass, nis, used, off, physical) = jax.lax.scan(tick, begin, numbers)
        loaded = (numbers * TICK > PICK_UP + 0.3).astype(mass.dtype)
        share = loaded / jnp.sum(loaded)
        own = self.estimator.estimate(state.belief)
        return Outcome(
            index=index,
            load=load,
            mass=mass[np.linspace(0, self.ticks - 1, KEPT).astype(int)],
            error=mass[-1] - nominal[self.estimator.bodies[0], 0] - load,
            sigma=own.sigma_pi[0, 0],
            tracking=jnp.sqrt(share @ off),
            nis_over_rows=share @ nis,
            rejected=1.0 - jnp.mean(used.astype(mass.dtype)),
            physical=jnp.mean(physical.astype(mass.dtype)),
        )


def arm_trial(name: str, seconds: float) -> ArmTrial:
    """A trial of so many seconds with one of `ROBOTS`."""
    model = mujoco.MjModel.from_xml_string(ROBOTS[name]())
    model.opt.timestep = STEP
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_EULER
    off = mujoco.mjtDisableBit
    model.opt.disableflags |= int(off.mjDSBL_EULERDAMP | off.mjDSBL_CONSTRAINT)
    # Nothing touches, and MJX has no collision of a cylinder with a box even so.
    model.geom_contype[:] = model.geom_conaffinity[:] = 0
    robot = load_model(model).astype("float32")
    # Differences of a noisy velocity are a noisy acceleration, which the arm's inertia makes a torque.
    inertia = jnp.diagonal(mass_matrix(robot, jnp.zeros(robot.nq, "float32")))
    sigma_tau = jnp.hypot(SIGMA_TAU, jnp.sqrt(2.0) * SIGMA_V / TICK * inertia)
    estimator = make_estimator(
        robot,
        [HAND],
        sigma_tau=sigma_tau,
        prior=Load(2.0, 0.1),
        # A pick-up that the gate does not notice must be within what may happen, or σ shrinks about the old load.
        drift=Load(DRIFT, 0.1),
        gate=ChiSquaredGate(0.999, robot.nv),
        reopen_after=0.05,
    )
    # Of several processes each must have constants on a device of its own; MJX would put them on the first of all.
    own = jax.local_devices()[0]
    ported = mjx.put_model(model, device=own)
    limited = model.actuator_ctrllimited.astype(bool)
    return ArmTrial(
        estimator=estimator,
        model=ported,
        start=mjx.put_data(model, mujoco.MjData(model), device=own),
        limit=jnp.where(limited, model.actuator_ctrlrange[:, 1], jnp.inf),
        hand=model.body(HAND).id,
        ticks=round(seconds / TICK),
    )
