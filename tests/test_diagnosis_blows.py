"""A robot that is struck: forces that change by a hundred weights a second, by a sensor that is late."""

import mujoco
import numpy as np
import pytest

from jax_inertia import load_model
from jax_inertia.diagnosis.entry import diagnose
from jax_inertia.diagnosis.result import Verdict
from jax_inertia.logs.log import Log, TorqueKind
from jax_inertia.signals.sensor_noise import quiet_noise, sensor_noise

HOPPER = """<mujoco><option timestep="0.0005" gravity="0 0 0" integrator="RK4"/><worldbody>
<body name="trunk"><freejoint/>
<inertial mass="8" pos="0.01 0 0.02" diaginertia="0.1 0.12 0.08"/>
<body name="thigh" pos="0 0 -0.1"><joint name="hip" axis="0 1 0" damping="0.1"/>
<inertial mass="1" pos="0 0 -0.1" fullinertia="0.01 0.011 0.003 0 0.0005 0"/>
<body name="foot" pos="0 0 -0.2"><joint name="knee" axis="0 1 0" damping="0.1"/>
<inertial mass="0.4" pos="0.02 0 -0.1" diaginertia="0.004 0.004 0.001"/></body></body></body></worldbody></mujoco>"""
STEPS = 8
RATE = 250


def kick(t):
    """Force on the trunk [N]: up to a weight within 8 ms, held a while, and back as fast; then the other way."""
    size = np.array([30.0, -20.0, 90.0])
    edges = (np.clip((t % 0.5 - start) / 0.008, 0, 1) for start in (0.05, 0.15, 0.30, 0.40))
    up, down, under, back = edges
    return size * (up - down - under + back)


def kicked(late=0, seconds=6.0, seed=0, push=0.0):
    """A log of the hopper afloat, struck twice in half a second; the wrench's means are `late` steps late.

    `push`: a force on its foot for half a second [N], which no sensor shows.
    """
    model = mujoco.MjModel.from_xml_string(HOPPER)
    data = mujoco.MjData(model)
    rng = np.random.default_rng(seed)
    joint, rows, forces, asked = slice(7, 9), [], [], np.zeros(2)
    trunk, foot = model.body("trunk").id, model.body("foot").id
    for k in range(round(seconds * RATE) * STEPS + 1):
        t = k / (RATE * STEPS)
        if k % STEPS == 0:
            target = 0.5 * np.sin(2 * np.pi * np.array([0.7, 1.1]) * t + np.array([0.0, 1.0]))
            asked = 8.0 * (target - data.qpos[joint]) - 0.5 * data.qvel[6:]
            rows.append((t, data.qpos.copy(), data.qvel.copy(), asked))
        force = kick(t)
        forces.append(force)
        # At the trunk's origin, in world axes.
        arm = data.xpos[trunk] - data.xipos[trunk]
        data.xfrc_applied[trunk] = np.concatenate([force, np.cross(arm, force)])
        data.xfrc_applied[foot, 0] = push * (2.0 < t < 2.5)
        data.qfrc_applied[6:] = asked
        mujoco.mj_step(model, data)
    time, q, v, tau = (np.array(x) for x in zip(*rows[:-1], strict=True))
    count = len(time)
    begins = np.maximum(np.arange(count)[:, None] * STEPS + np.arange(STEPS) - late, 0)
    means = np.array(forces)[begins].mean(axis=1)

    def seen(x, noise):
        return x + noise * rng.standard_normal(x.shape)

    wrench = np.concatenate([seen(means, 0.2), seen(np.zeros((count, 3)), 0.004)], axis=1)
    return Log(
        time=time,
        joint_names=("hip", "knee"),
        qpos=seen(q[:, joint], 2e-5),
        tau=seen(tau, 0.01),
        tau_kind=TorqueKind.COMMANDED,
        base_pos=seen(q[:, :3], 5e-5),
        base_quat=q[:, 3:7],
        base_linvel=seen(v[:, :3], 1e-3),
        base_angvel=seen(v[:, 3:6], 1e-3),
        contact_wrench=wrench[:, None],
        contact_bodies=("trunk",),
        sigma_qpos=np.full(2, 2e-5),
        sigma_tau=np.full(2, 0.01),
    )


@pytest.fixture(scope="module")
def robot():
    return load_model(mujoco.MjModel.from_xml_string(HOPPER))


@pytest.mark.slow
@pytest.mark.parametrize("late", [0, STEPS // 4])
def test_blows_are_no_gap_whenever_in_its_period_a_wrench_was_measured(robot, late):
    found = diagnose(robot, kicked(late))
    assert found.verdict is Verdict.NO_GAP, found


@pytest.mark.slow
def test_wrenches_that_are_late_by_periods_are_named(robot):
    found = diagnose(robot, kicked(3 * STEPS))
    assert found.verdict in (Verdict.UNKNOWN, Verdict.PARTLY)


@pytest.mark.slow
def test_a_push_amid_blows_is_found(robot):
    found = diagnose(robot, kicked(STEPS // 4, seed=1, push=3.0))
    assert found.verdict is Verdict.EXPLAINED
    (effect,) = found.odd
    assert (effect.family, effect.place.name) == ("push", "foot")


def test_noise_of_forces_that_ring_is_read_where_they_are_quiet():
    rng = np.random.default_rng(0)
    t = np.arange(5000) / 500
    ringing = 40.0 * np.sin(2 * np.pi * 60 * t) * np.exp(-(t % 0.4) / 0.04)
    noisy = ringing[:, None] + 0.3 * rng.standard_normal((5000, 2))
    assert np.all(sensor_noise(noisy) > 0.39)
    assert quiet_noise(noisy) == pytest.approx([0.3, 0.3], rel=0.1)
    calm = rng.standard_normal((5000, 2))
    assert quiet_noise(calm) == pytest.approx([1.0, 1.0], rel=0.05)
    # In the air it shows nothing at all.
    swinging = np.where(t % 0.8 < 0.5, 0.0, 1.0)[:, None] * calm
    assert quiet_noise(swinging) == pytest.approx([1.0, 1.0], rel=0.1)
