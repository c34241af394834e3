"""How large an effect is in a clean log, against the noise: the generator's own yardstick.

Not a diagnosis: the residual of one model on noise-free signals, low-passed at 10 Hz, to draw
effects that a fair examiner may ask for and to tell in the truth how visible each one was.
"""

from __future__ import annotations

import copy

import mujoco
import numpy as np
from plant import Noise
from robots import Robot
from scipy.signal import butter, sosfiltfilt

CUT_HZ = 10.0
REST = 0.012


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


def coordinates(robot: Robot, log: dict) -> tuple[np.ndarray, np.ndarray]:
    """Generalised position (T, nq) and velocity (T, nv) of a log."""
    if not robot.floating:
        return log["qpos"], log["qvel"]
    base = log["base"]
    return np.hstack([base[:, :7], log["qpos"]]), np.hstack([base[:, 7:], log["qvel"]])


def residual(robot: Robot, model: mujoco.MjModel, log: dict) -> tuple[np.ndarray, np.ndarray]:
    """Low-passed torque residual (T, nv) of a clean log under `model`, and the mask of motion."""
    dt = float(log["time"][1] - log["time"][0])
    q, v = coordinates(robot, log)
    applied = np.zeros((len(q), model.nv))
    centred = log["tau"].copy()
    # Row k's torque is held from there on: the mean with the row before is centred on the row.
    centred[1:] = 0.5 * (centred[1:] + centred[:-1])
    if robot.floating:
        applied[:, 6:] = centred
        wrench = log["contact_wrench"].copy()
        wrench[1:] = 0.5 * (wrench[1:] + wrench[:-1])
        applied += contact_torque(robot, model, q, wrench)
    else:
        applied += centred
    a = np.gradient(v, dt, axis=0)
    raw = inverse_dynamics(model, q, v, a) - applied
    sos = butter(2, CUT_HZ, fs=1.0 / dt, output="sos")
    moving = np.abs(v) > REST
    # The model's own dry friction is arbitrary near a reversal, and the filter spreads that.
    reach = np.ones(2 * int(0.1 / dt) + 1)
    for dof in np.flatnonzero(model.dof_frictionloss):
        moving[:, dof] &= np.convolve(np.abs(v[:, dof]) < 0.05, reach, "same") < 0.5
    edge = int(0.2 / dt)
    moving[:edge] = moving[-edge:] = False
    return sosfiltfilt(sos, raw, axis=0), moving


def contact_torque(robot: Robot, model: mujoco.MjModel, q: np.ndarray, wrench: np.ndarray):
    """Σ Jᵀ w over the feet, (T, nv)."""
    data = mujoco.MjData(model)
    feet = [model.body(name).id for name in robot.feet]
    jacp, jacr = np.zeros((3, model.nv)), np.zeros((3, model.nv))
    out = np.zeros((len(q), model.nv))
    for k in range(len(q)):
        data.qpos[:] = q[k]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        for i, foot in enumerate(feet):
            mujoco.mj_jacBody(model, data, jacp, jacr, foot)
            out[k] += wrench[k, i, :3] @ jacp + wrench[k, i, 3:] @ jacr
    return out


def noise_floor(robot: Robot, model: mujoco.MjModel, noise: Noise, rate: float, q) -> np.ndarray:
    """Rough standard deviation (nv) of the low-passed residual that the sensors alone give."""
    data = mujoco.MjData(model)
    data.qpos[:] = q
    mujoco.mj_forward(model, data)
    inertia = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, inertia)
    band = 2.0 / rate
    sigma_v = np.concatenate([noise.base[6:], noise.qvel]) if robot.floating else noise.qvel
    acceleration = sigma_v * 2 * np.pi * np.sqrt(band * CUT_HZ**3 / 3.0)
    tau = np.hypot(noise.tau, noise.ripple) * np.sqrt(band * CUT_HZ)
    if robot.floating:
        jac = contact_jacobian(robot, model, data)
        sensed = (jac**2).reshape(len(robot.feet), 6, model.nv)
        foot = np.sqrt((sensed * noise.wrench[None, :, None] ** 2).sum((0, 1)) * band * CUT_HZ)
        tau = np.hypot(np.concatenate([np.zeros(6), tau]), foot)
    return np.sqrt(tau**2 + inertia**2 @ acceleration**2) + 1e-9


def contact_jacobian(robot: Robot, model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    rows = []
    for name in robot.feet:
        jacp, jacr = np.zeros((3, model.nv)), np.zeros((3, model.nv))
        mujoco.mj_jacBody(model, data, jacp, jacr, model.body(name).id)
        rows += [jacp, jacr]
    return np.vstack(rows)


def nuisance_columns(robot: Robot, q, v, a) -> np.ndarray:
    """Derivatives (T, nv, k) of the inverse dynamics per 1 % mass, 1 mm centre, 7.5 % damping."""
    model = robot.model()
    model.dof_frictionloss[:] = 0.0
    plain = inverse_dynamics(model, q, v, a)
    columns = []
    for body in range(1, model.nbody):
        if model.body_mass[body] == 0.0 or model.body_weldid[body] == 0:
            continue
        varied = robot.model()
        varied.dof_frictionloss[:] = 0.0
        varied.body_mass[body] *= 1.01
        varied.body_inertia[body] *= 1.01
        columns.append(inverse_dynamics(varied, q, v, a) - plain)
        for axis in range(3):
            varied = robot.model()
            varied.dof_frictionloss[:] = 0.0
            varied.body_ipos[body, axis] += 1e-3
            columns.append(inverse_dynamics(varied, q, v, a) - plain)
    for dof in np.flatnonzero(model.dof_damping):
        column = np.zeros_like(plain)
        column[:, dof] = 0.075 * model.dof_damping[dof] * v[:, dof]
        columns.append(column)
    return np.stack(columns, axis=-1)


def visibility(robot: Robot, model: mujoco.MjModel, log: dict, noise: Noise) -> dict:
    """χ² of the residual over independent samples, and its size per degree of freedom.

    `distinct` is the χ² that remains when errors of the nominal model may explain it at the price
    of their prior: an effect without it hides behind a model that is 1 % wrong.
    """
    r, moving = residual(robot, model, log)
    rate = 1.0 / float(log["time"][1] - log["time"][0])
    q, v = coordinates(robot, log)
    floor = noise_floor(robot, model, noise, rate, q[0])
    weighted = np.where(moving, r / floor, 0.0)
    rms = np.sqrt((np.where(moving, r, 0.0) ** 2).mean(0))

    thin = slice(0, None, max(round(rate / 50.0), 1))
    sos = butter(2, CUT_HZ, fs=rate, output="sos")
    smooth = sosfiltfilt(sos, v, axis=0)
    accel = np.gradient(smooth, 1.0 / rate, axis=0)
    columns = nuisance_columns(robot, q[thin], smooth[thin], accel[thin])
    share = np.sqrt(2 * CUT_HZ / 50.0)
    columns = columns * (moving[thin] / floor)[:, :, None] * share
    columns = columns.reshape(-1, columns.shape[-1])
    y = weighted[thin].ravel() * share
    fit = np.linalg.solve(columns.T @ columns + np.eye(columns.shape[1]), columns.T @ y)
    base = ["base_x", "base_y", "base_z", "base_roll", "base_pitch", "base_yaw"]
    names = base + list(robot.joints) if robot.floating else robot.joints
    return {
        "chi2": float((weighted**2).sum() * 2 * CUT_HZ / rate),
        "distinct": float(y @ y - y @ columns @ fit),
        "rms": {name: float(x) for name, x in zip(names, rms, strict=True)},
        "noise": {name: float(x) for name, x in zip(names, floor, strict=True)},
    }
