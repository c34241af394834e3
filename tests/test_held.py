"""What torques of a slow log stand for, against the mean torque of a loop in MuJoCo C that runs at 1 kHz."""

import dataclasses

import mujoco
import numpy as np
import pytest
from scipy import signal

from jax_inertia.logs.log import Log, TorqueKind
from jax_inertia.signals.held import (
    LOOP_LATE,
    PositionLoop,
    _jolt,
    later,
    of_loop,
    position_loop,
    timing_of,
)

ARMATURE, STEP, HOLD = 0.1, 1e-3, 20
XML = f"""<mujoco><option timestep="{STEP}" gravity="0 0 0"/><worldbody><body>
<joint name="a" axis="0 0 1" armature="{ARMATURE}" damping="0.3"/>
<inertial pos="0 0 0" mass="1" diaginertia="0.01 0.01 0.01"/></body></worldbody></mujoco>"""


def run(kp, kd, seconds=10.0, every=HOLD, jump=0.0, steps=1):
    """A log of targets held for 20 ms, and the mean torque of the 1 kHz loop about each stamp; one row `every` ms.

    Of 1 kHz, `steps` of MuJoCo each: its Euler takes velocities half a step late.
    """
    model = mujoco.MjModel.from_xml_string(XML)
    model.opt.timestep = STEP / steps
    data, count = mujoco.MjData(model), round(seconds / STEP)
    torque, rows, target = np.zeros(count), [], 0.0
    for k in range(count):
        if k % HOLD == 0:
            # A policy's targets move from side to side of where they are going.
            target = np.sin(2 * np.pi * 0.5 * k * STEP) + jump * (-1) ** (k // HOLD)
        torque[k] = kp * (target - data.qpos[0]) - kd * data.qvel[0]
        if k % every == 0:
            rows.append((k * STEP, target, data.qpos[0], data.qvel[0], torque[k]))
        data.qfrc_applied[0] = torque[k]
        mujoco.mj_step(model, data, nstep=steps)
    time, target, q, v, tau = np.array(rows).T
    log = Log(
        time=time,
        joint_names=("a",),
        qpos=q[:, None],
        qvel=v[:, None],
        tau=tau[:, None],
        qpos_target=target[:, None],
    )
    # Of the hold before a stamp and the one after it.
    of_hold = torque.reshape(-1, every).mean(axis=1)
    mean = 0.5 * (np.concatenate([[0.0], of_hold[:-1]]) + of_hold)
    return log, mean


@pytest.mark.parametrize(("kp", "kd"), [(35.0, 2.0), (500.0, 25.0), (2000.0, 60.0)])
def test_the_mean_torque_of_a_loop_that_is_seen_at_50_hz(kp, kd):
    log, mean = run(kp, kd)
    loop = position_loop(log)
    assert loop is not None
    assert (loop.kp[0], loop.kd[0]) == pytest.approx((kp, kd), rel=1e-6)
    found = of_loop(log, loop, log.time[:1], np.array([[[ARMATURE + 0.01]]]))[:, 0]
    inner, v = slice(50, -50), np.asarray(log.qvel)[:, 0]

    def damping(torque):
        """What the miss passes for [N m s/rad]."""
        return float(np.sum((torque - mean)[inner] * v[inner]) / np.sum(v[inner] ** 2))

    # The loop of 1 kHz is half a millisecond late, and taken for one of up to a whole.
    assert abs(damping(found)) < 0.6 * kp * LOOP_LATE
    held = np.asarray(log.tau)[:, 0]
    assert abs(damping(held)) > 5 * kp * LOOP_LATE
    shifted = 0.5 * (held + np.concatenate([held[:1], held[:-1]]))
    assert abs(damping(shifted)) > 5 * kp * LOOP_LATE


@pytest.mark.parametrize("every", [2, 5])
@pytest.mark.parametrize(("kp", "kd"), [(35.0, 2.0), (500.0, 25.0)])
@pytest.mark.parametrize("jump", [0.0, 0.05])
def test_the_mean_torque_of_a_loop_that_is_seen_at_200_and_500_hz(kp, kd, jump, every):
    """What is left of the loop's own lateness, which no log shows; by half a sample's hold it would be all of it."""
    log, mean = run(kp, kd, every=every, jump=jump, steps=10)
    log = dataclasses.replace(log, qvel=None)
    loop = position_loop(log)
    assert loop is not None
    # A jolt of 4 ms is no more than guessed by differences over 5 ms.
    assert (loop.kp[0], loop.kd[0]) == pytest.approx((kp, kd), rel=0.2)
    found = of_loop(log, loop, log.time[:1], np.array([[[ARMATURE + 0.01]]]))[:, 0]
    inner = slice(200, -200)
    band = signal.butter(4, 10.0, fs=1000.0 / every, output="sos")
    v = signal.sosfiltfilt(band, np.gradient(np.asarray(log.qpos)[:, 0], np.asarray(log.time)))
    a = np.gradient(v, np.asarray(log.time))

    def passes_for(torque):
        """Damping [N m s/rad] and rotor inertia [kg m²] that the miss passes for, below 10 Hz."""
        miss = signal.sosfiltfilt(band, torque - mean)
        return np.linalg.lstsq(np.stack([v, a], axis=1)[inner], miss[inner], rcond=None)[0]

    # The loop of 1 kHz is half a millisecond late, and taken for one of up to a whole.
    bound = 0.7 * LOOP_LATE * np.array([kp, kd])
    assert np.all(np.abs(passes_for(found)) < bound)
    if every == 5:
        assert np.abs(passes_for(later(np.asarray(log.tau)[:, 0], 0.5)))[0] > 2 * bound[0]


def test_a_slow_loop_is_half_a_period_late():
    loop = PositionLoop(np.array([1.0]), np.array([0.0]))
    assert _jolt(loop, np.array([[1e3]]), 0.02, 0.0)[0, 0] == pytest.approx(1.0, abs=1e-6)


def test_a_loop_is_not_seen_where_there_is_none():
    log, _ = run(500.0, 25.0)
    rng = np.random.default_rng(0)
    noise = rng.standard_normal(np.shape(log.tau))
    assert position_loop(Log(log.time, log.joint_names, log.qpos, noise)) is None
    other = Log(log.time, log.joint_names, log.qpos, noise, qpos_target=log.qpos_target)
    assert position_loop(other) is None


def test_what_pushes_along_the_motion_is_no_loop():
    """A torque that is fed forward and goes with the velocity: kd would have to be below zero."""
    time = np.arange(0.0, 10.0, 0.004)
    q, apart = np.sin(2.0 * time), 0.01 * np.sin(7.0 * time)
    log = Log(time, ("a",), q[:, None], 500.0 * apart[:, None], qpos_target=(q + apart)[:, None])
    loop = position_loop(log)
    assert loop is not None
    assert (loop.kp[0], loop.kd[0]) == pytest.approx((500.0, 0.0), abs=1e-3)
    along = 500.0 * apart + np.std(500.0 * apart) * np.cos(2.0 * time)
    assert position_loop(dataclasses.replace(log, tau=along[:, None])) is None


@pytest.mark.parametrize("kind", [TorqueKind.COMMANDED, TorqueKind.CURRENT, TorqueKind.UNKNOWN])
@pytest.mark.parametrize("rate", [50.0, 500.0])
def test_torques_of_the_moment_and_held_ones_are_within_what_is_known_of_when_they_act(kind, rate):
    """A drive may be many times as fast as its log, or hold its torque from sample to sample: two σ or less each."""
    time = np.arange(50) / rate
    log = Log(time=time, joint_names=("a",), qpos=time[:, None], tau=time[:, None], tau_kind=kind)
    late, error, most = timing_of(log)
    assert max(late, 0.5 - late) <= min(2.0 * error, most)
