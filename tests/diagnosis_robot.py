"""Logs for the whole-robot diagnosis, in closed form: torques of MuJoCo C's inverse dynamics along a smooth motion.

Nothing is simulated and nothing of the package is used: what a robot's motors gave is what its model needs along the
motion, plus what the physics that the model lacks takes.
"""

import mujoco
import numpy as np

from jax_inertia.logs.log import Log

NOMINAL = """
<mujoco><compiler angle="radian"/><option gravity="0 0 -9.81"/><worldbody>
<body name="upper" pos="0 0 1">
  <joint name="shoulder" axis="0 1 0"/>
  <inertial pos="0.02 0 -0.2" mass="3" diaginertia="0.05 0.05 0.01"/>
  <body name="lower" pos="0 0 -0.4">
    <joint name="elbow" axis="0 1 0"/>
    <inertial pos="0 0.01 -0.15" mass="1.5" diaginertia="0.02 0.02 0.004"/>
    <body name="hand" pos="0 0 -0.3">
      <joint name="wrist" axis="1 0 0"/>
      <inertial pos="0 0 -0.05" mass="0.6" diaginertia="0.002 0.002 0.001"/>
    </body>
  </body>
</body>
</worldbody></mujoco>"""
VISCOUS, COULOMB = np.array([0.9, 0.5, 0.15]), np.array([1.2, 0.7, 0.25])
ARMATURE, BIAS = np.array([0.15, 0.08, 0.02]), np.array([0.2, -0.1, 0.03])


def motion(seed: int, late: float = 0.0, seconds: float = 10.0, rate: float = 200.0):
    """(t, q, v, a) of three joints, sums of five sines each; `late`: as they are so much later [s]."""
    rng, t = np.random.default_rng(seed), np.arange(0.0, seconds, 1.0 / rate)
    f = rng.uniform(0.15, 0.9, (5, 3))
    phase, size = rng.uniform(0, 2 * np.pi, (2, 5, 3))
    size = 0.3 * (0.4 + size / (2 * np.pi)) / (1 + f)
    w = 2 * np.pi * f
    angle = w * (t + late)[:, None, None] + phase
    q = (size * np.sin(angle)).sum(1)
    v = (size * w * np.cos(angle)).sum(1)
    a = -(size * w**2 * np.sin(angle)).sum(1)
    return t, q, v, a


def needed(model: mujoco.MjModel, q, v, a) -> np.ndarray:
    """Torque of MuJoCo C's inverse dynamics (T, n)."""
    data, out = mujoco.MjData(model), np.zeros_like(v)
    for k in range(len(q)):
        data.qpos[:], data.qvel[:], data.qacc[:] = q[k], v[k], a[k]
        mujoco.mj_inverse(model, data)
        out[k] = data.qfrc_inverse
    return out


def ordinary(v, a, level: float = 1.0) -> np.ndarray:
    """Torque that every joint's friction, rotor and offset take."""
    return level * (VISCOUS * v + COULOMB * np.tanh(v / 0.002) + ARMATURE * a - BIAS)


def log_of(t, q, tau, seed: int = 0, noise: float = 0.01) -> Log:
    """With the sensors' noise; a torque sensor's, so that nothing is held."""
    rng = np.random.default_rng(seed)
    return Log(
        time=t,
        joint_names=("shoulder", "elbow", "wrist"),
        qpos=q + rng.normal(0, 2e-5, q.shape),
        tau=tau + rng.normal(0, noise, tau.shape),
        tau_kind="sensor",
    )
