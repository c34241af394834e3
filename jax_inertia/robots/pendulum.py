"""A double pendulum and a log of it: the smallest robot that examples can be checked on by hand."""

import mujoco
import numpy as np

from jax_inertia.logs.log import Log, TorqueKind
from jax_inertia.model.mujoco_types import MjModel

# Links of 1 m, hung at each other's ends, their masses half-way down.
_LINK = """<body name="{name}" pos="0 0 {z}"><joint name="{joint}" axis="0 1 0"/>
  <inertial pos="0 0 -0.5" mass="{mass}" diaginertia="0.02 0.02 0.01"/>{inner}</body>"""
_NOISE = 0.02


def double_pendulum(load: float = 0.0) -> MjModel:
    """Bodies upper (2 kg) and lower (1 kg), joints shoulder and elbow about y; `load` [kg] sits in the lower's middle.

    >>> from jax_inertia.robots.pendulum import double_pendulum
    >>> float(double_pendulum(load=0.5).body_mass.sum())
    3.5
    """
    ball = f'<inertial pos="0 0 0" mass="{load}" diaginertia="1e-6 1e-6 1e-6"/>'
    held = f'<body name="load" pos="0 0 -0.5">{ball}</body>' if load > 0 else ""
    lower = _LINK.format(name="lower", joint="elbow", z=-1, mass=1, inner=held)
    upper = _LINK.format(name="upper", joint="shoulder", z=0, mass=2, inner=lower)
    text = f'<mujoco model="double pendulum"><worldbody>{upper}</worldbody></mujoco>'
    return mujoco.MjModel.from_xml_string(text)


def swing(load: float = 0.0, *, seconds: float = 4.0, rate: float = 100.0) -> Log:
    """A log of the pendulum driven along two sines: torques by MuJoCo's inverse dynamics, and 0.02 N m of noise.

    >>> from jax_inertia.robots.pendulum import swing
    >>> swing(seconds=1.0)
    Log(0.99 s at 100 Hz, 100 samples; joints shoulder, elbow; qpos, tau, qvel; torque sensor in N m)
    """
    model = double_pendulum(load)
    data, time = mujoco.MjData(model), np.arange(round(seconds * rate)) / rate
    size, speed = np.array([0.8, 1.1]), 2 * np.pi * np.array([0.5, 0.8])
    angle = speed * time[:, None]
    q, v = size * np.sin(angle), size * speed * np.cos(angle)
    tau = np.zeros_like(q)
    for k, (data.qpos[:], data.qvel[:], data.qacc[:]) in enumerate(
        zip(q, v, -(speed**2) * q, strict=True)
    ):
        mujoco.mj_inverse(model, data)
        tau[k] = data.qfrc_inverse
    return Log(
        time=time,
        joint_names=("shoulder", "elbow"),
        qpos=q,
        qvel=v,
        tau=tau + _NOISE * np.random.default_rng(0).normal(size=tau.shape),
        tau_kind=TorqueKind.SENSOR,
    )
