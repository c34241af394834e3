"""Rows as their window's means: against MuJoCo C's torques, averaged over the same windows."""

import dataclasses

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from jax_inertia import load_model
from jax_inertia.model.load import body_pi
from jax_inertia.signals.differences import Observation, aligned_differences
from jax_inertia.signals.generalised_motion import Motion
from jax_inertia.signals.torque_residual import torque_residual
from jax_inertia.signals.window_mean import jerk_since, mean_residual

WINDOW, STEP = 16, 0.001
CHAIN = """
<mujoco><worldbody><body name="a" pos="0 0 1">{base}
  <inertial pos="0.02 0.01 -0.2" mass="2" diaginertia="0.03 0.03 0.01"/>
  <body name="b" pos="0 0 -0.4"><joint name="elbow" axis="1 1 0" damping="0.1"/>
    <inertial pos="0.02 0.01 -0.15" mass="1" diaginertia="0.01 0.011 0.004"/></body></body></worldbody></mujoco>
"""
BASES = {
    "hinge": '<joint name="shoulder" axis="0 1 0"/>',
    "ball": '<joint name="shoulder" type="ball"/>',
    "free": "<freejoint/>",
}


def moving(base: str) -> tuple[mujoco.MjModel, Observation]:
    """A motion of some rad/s and its torques without noise, as windows that follow one another."""
    plant = mujoco.MjModel.from_xml_string(CHAIN.format(base=BASES[base]))
    data = mujoco.MjData(plant)
    rng = np.random.default_rng(1)
    size, omega = rng.uniform(0.5, 1.0, plant.nv), rng.uniform(4.0, 8.0, plant.nv)
    rows = []
    for k in range(801):
        t = k * STEP
        data.qvel[:], data.qacc[:] = (
            size * omega * np.cos(omega * t),
            -size * omega**2 * np.sin(omega * t),
        )
        mujoco.mj_inverse(plant, data)
        rows.append((t, data.qpos.copy(), data.qvel.copy(), data.qfrc_inverse.copy()))
        # Midpoint: positions exact to the third order of a step.
        middle = size * omega * np.cos(omega * (t + 0.5 * STEP))
        mujoco.mj_integratePos(plant, data.qpos, middle, STEP)
    time, q, v, tau = (np.array(x) for x in zip(*rows, strict=True))
    at = {"hinge": (), "ball": (0,), "free": (3,)}[base]
    motion = Motion(time=time, q=q, v=v, tau=tau, valid=np.ones(v.shape, bool), quaternions=at)
    every = aligned_differences(motion, WINDOW)
    kept = {n: getattr(every.motion, n)[::WINDOW] for n in ("time", "q", "v", "tau", "valid")}
    return plant, Observation(dataclasses.replace(every.motion, **kept), every.a[::WINDOW])


@pytest.mark.parametrize("base", ["hinge", "free", pytest.param("ball", marks=pytest.mark.slow)])
def test_a_window_s_torque_is_that_of_the_mean_rows(base):
    plant, log = moving(base)
    robot = load_model(plant)
    body = plant.body("b").id
    pi, bodies = body_pi(plant, body), (robot.body_index("b"),)
    zero = jnp.zeros(plant.nv)
    dt = WINDOW * STEP

    def left(rows) -> jnp.ndarray:
        return rows[1] + jnp.einsum("vbp,p->v", rows[0], pi)

    def both(before, x):
        mean = mean_residual(robot, x, bodies, zero, jerk_since(before, x.a, dt), dt)
        return left(mean), left(torque_residual(robot, x, bodies, zero))

    log = jax.tree.map(jnp.asarray, log)
    first = jnp.full((1, plant.nv), jnp.nan)
    mean, plain = jax.jit(jax.vmap(both))(jnp.concatenate([first, log.a[:-1]]), log)
    mean, plain = (np.sqrt(np.mean(np.asarray(x)[1:] ** 2)) for x in (mean, plain))
    assert plain > 1e-3  # N m
    assert mean < 0.15 * plain


def test_without_a_sample_before_nothing_is_known_of_the_jerk():
    now = jnp.array([1.0, 2.0])
    np.testing.assert_array_equal(jerk_since(jnp.array([jnp.nan, 1.0]), now, 0.1), [0.0, 10.0])
    np.testing.assert_array_equal(jerk_since(now - 1.0, now, 0.0), [0.0, 0.0])
