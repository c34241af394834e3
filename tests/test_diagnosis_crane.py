"""A crane in MuJoCo C: a jib on a soft gear, a boom that slides, sensors that are glitched now and then."""

import dataclasses

import mujoco
import numpy as np
import pytest

from jax_inertia import load_model
from jax_inertia.diagnosis.entry import diagnose
from jax_inertia.diagnosis.result import Verdict
from jax_inertia.logs.log import Log, TorqueKind
from jax_inertia.signals.spikes import torque_spikes

RATE, STEPS = 250, 20
GEAR, ROTOR, BRISTLE = 1.5e6, 2500.0, 1e-4
QPOS, TAU = 5e-5, np.array([300.0, 15.0])
STIFF = 90000.0 * np.array([40.0, 0.3])
CRANE = """
<mujoco>
  <compiler autolimits="true"/>
  <option timestep="{step}" integrator="implicitfast"/>
  <worldbody>
    <body name="jib" pos="0 0 4">{joints}
      <inertial pos="3.6 0.04 0.1" mass="260" diaginertia="12 1500 1500"/>
      <body name="boom" pos="4 0 0.1">
        <joint name="extend" type="slide" axis="1 0 0" damping="900" armature="60"/>
        <inertial pos="2.5 0 0" mass="150" diaginertia="3 260 260"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""
LUFF = '<joint name="luff" axis="0 1 0" damping="700" armature="2500"/>'
SOFT = f"""
<joint name="luff" axis="0 1 0" damping="700" armature="{ROTOR}"/>
<joint name="gear" axis="0 1 0" stiffness="{GEAR}" damping="12000"/>"""


def wave(t: float, seed: int) -> np.ndarray:
    """Path, speed and acceleration of both joints (3, 2)."""
    rng = np.random.default_rng(seed)
    hertz = rng.uniform(0.12, 0.55, (4, 2))
    size = rng.uniform(0.5, 1.0, (4, 2)) * [0.05, 0.13] / (hertz / 0.3)
    omega, phase = 2 * np.pi * hertz, 2 * np.pi * hertz * t + rng.uniform(0, 2 * np.pi, (4, 2))
    return np.stack(
        [
            np.sum(size * np.sin(phase), axis=0),
            np.sum(size * omega * np.cos(phase), axis=0),
            np.sum(-size * omega**2 * np.sin(phase), axis=0),
        ]
    )


def simulate(*, soft=False, friction=0.0, seed=1, seconds=8.0) -> Log:
    """Computed torque, held for a sample; `friction` [N] of the sliding joint, by a bristle."""
    joints, step = SOFT if soft else LUFF, 1.0 / RATE / STEPS
    model = mujoco.MjModel.from_xml_string(CRANE.format(step=step, joints=joints))
    plain = mujoco.MjModel.from_xml_string(CRANE.format(step=step, joints=LUFF))
    data, ideal = mujoco.MjData(model), mujoco.MjData(plain)
    at = [0, model.nv - 1]
    data.qpos[at], data.qvel[at] = wave(0.0, seed)[:2]
    if soft:
        # The jib hangs in its gear as it would.
        ideal.qpos[:] = data.qpos[at]
        mujoco.mj_inverse(plain, ideal)
        data.qpos[1] = -ideal.qfrc_inverse[0] / GEAR
    bristle = 0.0
    rng = np.random.default_rng(seed + 70)
    time, qpos, tau = [], [], []
    for _ in range(round(seconds * RATE)):
        path, speed, push = wave(data.time, seed)
        ideal.qpos[:], ideal.qvel[:], ideal.qacc[:] = path, speed, push
        mujoco.mj_inverse(plain, ideal)
        off, late = path - data.qpos[at], speed - data.qvel[at]
        command = ideal.qfrc_inverse + STIFF * (off + 0.3 * late)
        time.append(data.time)
        qpos.append(data.qpos[at].copy())
        tau.append(command)
        for _ in range(STEPS):
            v = data.qvel[at[1]]
            bristle += (v - abs(v) * bristle / BRISTLE) * step
            data.qfrc_applied[at] = command
            data.qfrc_applied[at[1]] -= friction * np.clip(bristle / BRISTLE, -1, 1)
            mujoco.mj_step(model, data)
    qpos, tau = np.array(qpos), np.array(tau)
    return Log(
        time=np.array(time),
        joint_names=("luff", "extend"),
        qpos=qpos + QPOS * rng.standard_normal(qpos.shape),
        qvel=None,
        tau=tau + TAU * rng.standard_normal(tau.shape),
        tau_kind=TorqueKind.COMMANDED,
    )


def glitched(log: Log, seed=3) -> Log:
    """The log with a few single samples of torque that no motor makes."""
    rng, tau = np.random.default_rng(seed), np.array(log.tau)
    for k in rng.choice(len(tau) - 20, 6, replace=False) + 10:
        tau[k, k % 2] += rng.choice([-3.0, 3.0]) * np.abs(tau).max()
    return dataclasses.replace(log, tau=tau)


@pytest.fixture(scope="module")
def robot():
    model = CRANE.format(step=0.002, joints=LUFF)
    return load_model(mujoco.MjModel.from_xml_string(model))


@pytest.mark.slow
def test_a_soft_gear_is_named_on_a_log_that_begins_amid_the_motion(robot):
    """It rings at 1.5 Hz, in the motion's own band, on the other motion as well."""
    found = diagnose(robot, simulate(soft=True), test_log=simulate(soft=True, seed=2))
    assert found.verdict is Verdict.EXPLAINED
    (effect,) = found.odd
    assert (effect.family, effect.place.name) == ("joint_elasticity", "luff")
    assert effect.parameters["stiffness"].value == pytest.approx(GEAR, rel=0.1)
    assert found.test is not None
    assert found.test.after < 0.5 * found.test.before


@pytest.mark.slow
def test_a_sliding_joints_friction_is_in_newtons_and_glitches_are_left_out(robot):
    log = glitched(simulate(friction=120.0))
    assert torque_spikes(log).sum() == 6
    found = diagnose(robot, log)
    assert found.verdict is Verdict.EXPLAINED
    (effect,) = found.odd
    assert (effect.family, effect.place.name) == ("coulomb_friction", "extend")
    level = effect.parameters["coulomb"]
    assert (level.value, level.unit) == (pytest.approx(120.0, rel=0.1), "N")
    own = {(f, p.name): x.unit for f, p, x in found.undetectable_below if p.kind == "joint"}
    assert own["viscous_friction", "extend"] == "N s/m"
    assert own["viscous_friction", "luff"] == "N m s/rad"
    assert own["armature", "extend"] == "kg"


def test_glitches_beside_missing_samples_are_seen():
    log = simulate(seconds=1.0)
    tau = np.array(log.tau)
    tau[50], tau[120, 1] = np.nan, 50.0 * np.nanmax(np.abs(tau[:, 1]))
    told = torque_spikes(dataclasses.replace(log, tau=tau))
    assert told[120, 1]
    assert told.sum() == 1
    assert not torque_spikes(dataclasses.replace(log, tau=np.full_like(tau, np.nan))).any()
