"""An arm that follows a moving point: its model, the motions that are wanted, and the "real" one.

The real arm is MuJoCo C at half a millisecond. Its friction is LuGre's bristle [Canudas de Wit et al., IEEE TAC 40(3),
1995], exact over a step, its drive runs at 1 kHz, and it is of this file alone.
"""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np

PERIOD, STEPS, SECONDS = 0.02, 5, 2.0
"""Of the policy [s], steps of the simulation in one, and of one motion [s]."""
UPPER, LOWER = 0.35, 0.3  # m
JOINTS = ("yaw", "shoulder", "elbow")
MODEL = f"""
<mujoco model="arm">
  <option timestep="{PERIOD / STEPS}" integrator="implicitfast" iterations="4" ls_iterations="6"/>
  <worldbody>
    <body name="column">
      <joint name="yaw" axis="0 0 1" damping="0.3" armature="0.03" frictionloss="0.2"/>
      <inertial pos="0 0 0.05" mass="2" diaginertia="0.01 0.01 0.008"/>
      <body name="upper" pos="0 0 0.1">
        <joint name="shoulder" axis="0 1 0" damping="0.3" armature="0.03" frictionloss="0.2"/>
        <inertial pos="{0.45 * UPPER} 0 0" mass="1.6" diaginertia="0.002 0.018 0.018"/>
        <body name="lower" pos="{UPPER} 0 0">
          <joint name="elbow" axis="0 1 0" damping="0.2" armature="0.02" frictionloss="0.15"/>
          <inertial pos="{0.4 * LOWER} 0 0" mass="0.9" diaginertia="0.001 0.008 0.008"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position joint="yaw" kp="60" kv="4"/>
    <position joint="shoulder" kp="90" kv="6"/>
    <position joint="elbow" kp="45" kv="2.5"/>
  </actuator>
</mujoco>
"""
# What the real arm has and the model lacks.
LATE, WEAK, LOAD, FRICTION = 0.02, 0.7, 0.5, 1.2
"""Delay of targets [s], gain of the elbow's motor, kg at the tip, dry friction of the shoulder [N m]."""
_STEP, _DRIVE, _BRISTLE, _ENCODER = 5e-4, 2, 1e-3, 2e-4


def tip(q, xp=np):
    """Where the hand is (..., 3) [m], of joints (..., 3)."""
    yaw, shoulder, elbow = (q[..., k] for k in range(3))
    reach = UPPER * xp.cos(shoulder) + LOWER * xp.cos(shoulder + elbow)
    height = -UPPER * xp.sin(shoulder) - LOWER * xp.sin(shoulder + elbow)
    return xp.stack([reach * xp.cos(yaw), reach * xp.sin(yaw), height], axis=-1)


def wanted(rng: np.random.Generator, seconds: float = SECONDS, fastest: float = 1.4) -> np.ndarray:
    """Joints of a motion that is wanted, one row each period (K, 3) [rad]; from rest, of three sines a joint."""
    t = np.arange(0.0, seconds + 0.2, PERIOD)
    middle, size = np.array([0.0, -0.3, 0.7]), np.array([0.5, 0.35, 0.5])
    waves = np.zeros((len(t), 3))
    for _ in range(3):
        f, phase = rng.uniform(0.2, fastest, 3), rng.uniform(0, 2 * np.pi, 3)
        waves += rng.uniform(0.2, 0.5, 3) * (
            np.sin(2 * np.pi * f * t[:, None] + phase) - np.sin(phase)
        )
    return middle + np.minimum(t / 0.5, 1.0)[:, None] ** 2 * size * waves


def _real() -> mujoco.MjModel:
    """Without friction, damping and drive, which `moved` adds; with the load."""
    spec = mujoco.MjSpec.from_string(MODEL)
    for joint in spec.joints:
        joint.damping, joint.frictionloss = np.zeros(3), 0.0
    for actuator in list(spec.actuators):
        spec.delete(actuator)
    load = spec.body("lower").add_body(name="load", pos=[LOWER, 0, 0])
    load.mass, load.inertia, load.explicitinertial = LOAD, [4e-4] * 3, True
    load.ipos = np.zeros(3)
    spec.option.timestep, spec.option.integrator = _STEP, mujoco.mjtIntegrator.mjINT_EULER
    return spec.compile()


def moved(
    policy: Callable[[int, np.ndarray, np.ndarray], np.ndarray], motion: np.ndarray, seed: int
) -> tuple[np.ndarray, np.ndarray]:
    """Joints that encoders saw and targets that were given, each period (K, 3), along a motion that is wanted.

    `policy(k, q, v)` gives the targets of period k by positions and velocities.
    """
    model, rng = _real(), np.random.default_rng(seed)
    data = mujoco.MjData(model)
    data.qpos[:] = motion[0]
    given_by = mujoco.MjModel.from_xml_string(MODEL)
    gain = np.array([1.0, 1.0, WEAK])
    kp, kd = gain * given_by.actuator_gainprm[:, 0], -gain * given_by.actuator_biasprm[:, 2]
    dry, damping = given_by.dof_frictionloss.copy(), given_by.dof_damping
    dry[1] = FRICTION
    bristle, torque = np.zeros(3), np.zeros(3)
    count = len(motion) - round(0.2 / PERIOD)
    inner = round(PERIOD / _STEP)
    seen, sent = np.zeros((count, 3)), np.zeros((count, 3))
    before = motion[0]
    for k in range(count):
        seen[k] = data.qpos + _ENCODER * rng.normal(size=3)
        speed = (seen[k] - before) / PERIOD
        before = seen[k]
        sent[k] = policy(k, seen[k], speed)
        for i in range(inner):
            if i % _DRIVE == 0:
                late = int(np.floor(k + (i * _STEP - LATE) / PERIOD + 1e-9))
                torque = kp * (sent[max(late, 0)] - data.qpos) - kd * data.qvel
            end = np.sign(data.qvel) * _BRISTLE
            new = end + (bristle - end) * np.exp(-np.abs(data.qvel) * _STEP / _BRISTLE)
            # A little damping of the bristle, or it rings.
            rub = dry / _BRISTLE * (new + 2e-3 * (new - bristle) / _STEP)
            bristle = new
            data.qfrc_applied[:] = torque - rub - damping * data.qvel
            mujoco.mj_step(model, data)
    return seen, sent
