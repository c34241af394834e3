"""Composite adaptation in MuJoCo C's closed loop: its Lyapunov function falls, and the load is found."""

import equinox as eqx
import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from jax_inertia import inverse_dynamics, load_model, mass_matrix
from jax_inertia.control.composite import (
    composite_step,
    damping_step,
    divergence,
    reference_regressor,
)
from jax_inertia.dynamics.rigid_body import passive_torque, torque_regressor
from jax_inertia.maths.inertial_parameters import from_com, is_physical
from jax_inertia.signals.differences import Observation
from jax_inertia.signals.generalised_motion import Motion
from jax_inertia.signals.torque_residual import torque_residual

ARM = """
<mujoco><option timestep="0.0005" integrator="RK4"/><worldbody>
  <body name="upper" pos="0 0 1"><joint name="a" axis="0 1 0" damping="0.3" armature="0.02"/>
    <inertial pos="0.01 0 -0.2" mass="2.1" diaginertia="0.03 0.03 0.004"/>
    <body name="hand" pos="0 0 -0.4"><joint name="b" axis="1 1 0" damping="0.2" armature="0.02"/>
      <inertial pos="0.02 0.01 -0.15" mass="1.1" diaginertia="0.01 0.011 0.002"/>{load}</body></body>
</worldbody><actuator><motor joint="a"/><motor joint="b"/></actuator></mujoco>
"""
LOAD = '<body pos="0.03 0 -0.2"><inertial pos="0 0 0" mass="1.5" diaginertia="0.004 0.004 0.004"/></body>'
HAND, DT, STIFF, DAMP = 1, 0.002, 8.0, 6.0


@pytest.fixture(scope="module")
def robot():
    return load_model(mujoco.MjModel.from_xml_string(ARM.format(load="")))


def wanted(t):
    """Position, velocity, acceleration."""
    w, phase = np.array([2.1, 3.4]), np.array([0.0, 1.0])
    return (
        0.6 * np.sin(w * t + phase),
        0.6 * w * np.cos(w * t + phase),
        -0.6 * w**2 * np.sin(w * t + phase),
    )


@pytest.mark.slow
def test_the_reference_regressor_is_the_law_s(robot):
    rng = np.random.default_rng(0)
    q, v, a, u = (jnp.asarray(x) for x in rng.normal(size=(4, 2)))

    def torque(first, second):
        y = reference_regressor(robot, q, first, second, a)
        return jnp.einsum("vbp,bp->v", y, robot.pi)

    whole = inverse_dynamics(robot, q, v, a) - robot.armature * a
    np.testing.assert_allclose(torque(v, v), whole, atol=1e-12)
    np.testing.assert_allclose(torque(v, u), torque(u, v), atol=1e-12)
    # Ṁ − 2 C is skew: uᵀ (½ Ṁ u − C u) = 0, with C u the part of the torque that is linear in v.
    rate = jax.jvp(lambda q: mass_matrix(robot, q), (q,), (v,))[1]
    coupling = torque(v, u) - torque(jnp.zeros(2), u)
    assert float(u @ (0.5 * rate @ u - coupling)) == pytest.approx(0.0, abs=1e-12)


@eqx.filter_jit
def control(robot, pi, q, v, a, tau, want, gain, predict):
    """(torque, s, π̂ after the step); a and tau are those measured over the last step."""
    reference_v = want[1] - STIFF * (q - want[0])
    reference_a = want[2] - STIFF * (v - want[1])
    s = v - reference_v
    y = reference_regressor(robot, q, v, reference_v, reference_a)
    torque = jnp.einsum("vbp,bp->v", y, robot.pi.at[HAND].set(pi[0]))
    torque = torque + robot.armature * reference_a - DAMP * s - passive_torque(robot, q, v)
    motion = Motion(time=jnp.zeros(()), q=q, v=v, tau=tau, valid=jnp.ones(2, bool))
    w, residual = torque_residual(robot, Observation(motion, a), (HAND,), jnp.zeros(2))
    slope = jnp.einsum("vbp,v->bp", w, jnp.einsum("vbp,bp->v", w, pi) + residual)
    after = composite_step(pi, y[:, HAND:], s, gain, DT, predict * slope)
    return torque, s, after


def run(robot, gain: float, predict: float, seconds: float = 5.0):
    """(s, π̂, V / 1 J) along the run."""
    plant = mujoco.MjModel.from_xml_string(ARM.format(load=LOAD))
    data = mujoco.MjData(plant)
    data.qpos[:], data.qvel[:], _ = wanted(0.0)
    ball = from_com(jnp.asarray(1.5), jnp.array([0.03, 0.0, -0.2]), 0.004 * jnp.eye(3))
    true = robot.pi[HAND] + ball
    loaded = robot.with_pi((HAND,), true[None])
    energy = eqx.filter_jit(
        lambda q, s, pi: 0.5 * s @ mass_matrix(loaded, q) @ s + divergence(true, pi[0]) / gain
    )
    pi, a, tau = robot.pi[HAND][None], np.zeros(2), np.zeros(2)
    rows: list[tuple] = []
    for k in range(round(seconds / DT)):
        now = (data.qpos.copy(), data.qvel.copy())
        active = predict if k else 0.0
        torque, s, after = control(robot, pi, *now, a, tau, wanted(k * DT), gain, active)
        rows.append((np.asarray(s), np.asarray(pi[0]), float(energy(now[0], s, pi))))
        data.ctrl[:], pi = torque, after
        for _ in range(4):
            mujoco.mj_step(plant, data)
        # As sensors have it: what the step's end measures, at its end.
        mujoco.mj_forward(plant, data)
        a, tau = data.qacc.copy(), np.asarray(torque)
    return [np.array(x) for x in zip(*rows, strict=True)]


@pytest.mark.slow
def test_the_task_s_error_decays_at_the_stated_rate_along_what_the_body_can_do(robot):
    """−y of the change, taken through M⁻¹, is `rate` times the part of s along M⁻¹ y; other joints' errors stay."""
    q = jnp.array([0.4, -0.7])
    y = torque_regressor(robot, q, jnp.zeros(2), jnp.zeros(2), (HAND,))
    mass, pi = mass_matrix(robot, q), robot.pi[HAND][None]
    for s in (jnp.array([1e-5, -2e-5]), jnp.array([0.0, 3e-5])):
        moved = damping_step(pi, y, s, mass, rate=50.0)
        torque = jnp.einsum("vbp,bp->v", y, moved - pi)
        pushed = jnp.linalg.solve(mass, torque)
        along = (torque @ s) / (torque @ pushed) * pushed
        np.testing.assert_allclose(pushed, -50.0 * along, rtol=1e-3)
    np.testing.assert_allclose(damping_step(pi, y, jnp.zeros(2), mass, rate=50.0), pi)
    far = damping_step(pi, y, jnp.array([30.0, -50.0]), mass, rate=50.0)
    assert bool(is_physical(far).all())


@pytest.mark.slow
def test_the_lyapunov_function_falls_and_the_load_is_found(robot):
    s, pi, v = run(robot, gain=5.0, predict=1.0)
    # Sampled at 500 Hz, a law in continuous time may rise a little.
    assert np.maximum(np.diff(v), 0.0).sum() < 1e-3 * v[0]
    assert is_physical(jnp.asarray(pi)).all()
    assert pi[-1, 0] == pytest.approx(2.6, abs=0.05)
    fixed = run(robot, gain=1e-9, predict=0.0)[0]
    task = run(robot, gain=5.0, predict=0.0)[0]
    late = slice(len(s) // 2, None)
    error = [float(np.sqrt(np.mean(x[late] ** 2))) for x in (s, task, fixed)]
    assert error[0] < 0.6 * error[1] < 0.1 * error[2]
