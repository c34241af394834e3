"""The filter step that is timed: humanoid, torso and forearm (20 states, 29 rows), every robot its own belief."""

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.harness.states import BODIES, humanoid, states
from jax_inertia import inverse_dynamics, load_model
from jax_inertia.estimation.inertial_filter import Estimator, State, make_estimator
from jax_inertia.estimation.priors import Load
from jax_inertia.maths.gates import ChiSquaredGate
from jax_inertia.maths.kalman import Form
from jax_inertia.model.robot import Robot
from jax_inertia.signals.differences import Observation
from jax_inertia.signals.generalised_motion import Motion

RATE, LOAD = 333.0, 1.0  # Hz; kg on the torso, unknown to the filter
# With 5 kg one iteration is no filter on states as wild as these: after three samples the gate holds the rest off,
# opens every 0.2 s, and which 1 % of the samples get in hangs on the last bit.


def estimator(
    robot: Robot, *, iterations: int = 1, form: Form | None = None, analytic: bool = True
) -> Estimator:
    """Settings for a load that may change by 0.02 kg in a second."""
    return make_estimator(
        robot,
        BODIES,
        sigma_tau=1.0,
        prior=Load(LOAD, 0.2),
        drift=Load(0.02, 0.004),
        gate=ChiSquaredGate(0.999, robot.nv),
        reopen_after=0.2,
        iterations=iterations,
        form=form,
        analytic_jacobian=analytic,
    )


def observations(robot: Robot, samples: int) -> Observation:
    """Random states, torques of the robot with its load and noise of 1 N m, one log."""
    dtype = robot.pi.dtype
    q, v, a = states(humanoid(), samples, dtype)
    torso = robot.body_index(BODIES[0])
    ball = jnp.zeros(10, dtype).at[0].set(LOAD)
    loaded = robot.with_pi((torso,), (robot.pi[torso] + ball)[None])
    one = jax.jit(lambda x: jax.lax.map(lambda s: inverse_dynamics(loaded, *s), x, batch_size=64))
    tau = np.array(one((q, v, a))) + np.random.default_rng(1).normal(size=(samples, robot.nv))
    motion = Motion(
        time=jnp.arange(samples, dtype=dtype) / RATE,
        q=q,
        v=v,
        tau=jnp.asarray(tau, dtype),
        valid=jnp.ones((samples, robot.nv), bool),
    )
    return Observation(motion, a)


def load_error(filter_: Estimator, state: State) -> float:
    """Estimated load on the torso less the true one [kg], mean over the fleet."""
    mean = state.belief.mean.reshape(-1, len(BODIES), 10)
    nominal = filter_.robot.pi[filter_.bodies[0], 0]
    return float(jnp.mean(filter_.chart.to_pi(mean)[:, 0, 0]) - nominal - LOAD)


def humanoid_robot(dtype: str) -> Robot:
    """The humanoid in the given precision."""
    return load_model(humanoid()).astype(dtype)
