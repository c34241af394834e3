"""Inverse dynamics by MuJoCo C, and what the sensors' noise makes of a torque below 10 Hz."""

from __future__ import annotations

import copy

import mujoco
import numpy as np

from benchmarks.worlds.plant import Noise

CUT_HZ = 10.0


def inverse_dynamics(model: mujoco.MjModel, q, v, a) -> np.ndarray:
    """Generalised force (T, nv) of the model without contacts; friction loss as F tanh(v/0.003)."""
    bare = copy.copy(model)
    friction = bare.dof_frictionloss.copy()
    bare.dof_frictionloss[:] = 0.0
    bare.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    data = mujoco.MjData(bare)
    out = np.empty((len(q), bare.nv))
    for k in range(len(q)):
        data.qpos[:], data.qvel[:], data.qacc[:] = q[k], v[k], a[k]
        mujoco.mj_inverse(bare, data)
        out[k] = data.qfrc_inverse
    return out + friction * np.tanh(v / 0.003)


def noise_floor(model: mujoco.MjModel, noise: Noise, rate: float, q) -> np.ndarray:
    """Rough standard deviation (nv) of the low-passed residual that the sensors alone give; a fixed base."""
    data = mujoco.MjData(model)
    data.qpos[:] = q
    mujoco.mj_forward(model, data)
    inertia = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, inertia)
    band = 2.0 / rate
    acceleration = noise.qvel * 2 * np.pi * np.sqrt(band * CUT_HZ**3 / 3.0)
    tau = np.hypot(noise.tau, noise.ripple) * np.sqrt(band * CUT_HZ)
    return np.sqrt(tau**2 + inertia**2 @ acceleration**2) + 1e-9
