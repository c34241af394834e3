"""How visible an effect is in a clean log, in units of the sensors' noise: the examiner's own measure, no diagnosis.

χ² is that of the torque residual below 10 Hz; `distinct` is what is left of it where errors of the nominal model (1 %
of mass, 1 mm of centre, 7.5 % of damping) may explain their share at the price of their prior.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from scipy.signal import butter, sosfiltfilt

from world.describe import Machine, to_pinocchio
from world.sensors import Sensors

CUT, RATE, REST = 10.0, 50.0, 0.012


def beyond(seen: dict, still: dict) -> dict:
    """`visibility` of an effect alone: what the same motion shows without it (`still`) taken off."""
    return seen | {k: max(seen[k] - still[k], 0.0) for k in ("chi2", "distinct")}


def residual(machine: Machine, log: dict):
    """Low-passed residual (T, nv) of the rigid bodies, damping and Coulomb's friction; joints' speeds (T, n)."""
    model, _ = to_pinocchio(machine)
    data, n = model.createData(), len(machine.joints)
    dt = float(log["time"][1] - log["time"][0])
    q, v = coordinates(machine, log)
    a = np.gradient(v, dt, axis=0)
    out = np.array([pin.rnea(model, data, *row) for row in zip(q, v, a, strict=True)])
    speed = v[:, -n:]
    out[:, -n:] += machine.array("damping") * speed - centred(log["tau"])
    out[:, -n:] += machine.array("friction") * np.tanh(speed / 0.003)
    if machine.sensed:
        out -= contact_torque(machine, model, q, centred(log["wrench"]))
    sos = butter(2, CUT, fs=1.0 / dt, output="sos")
    return sosfiltfilt(sos, out, axis=0), speed


def centred(x: np.ndarray) -> np.ndarray:
    """What is held from each row on, centred on the rows."""
    out = x.copy()
    out[1:] = 0.5 * (x[1:] + x[:-1])
    return out


def coordinates(machine: Machine, log: dict) -> tuple[np.ndarray, np.ndarray]:
    """Pinocchio's q and v of all rows."""
    if not machine.floating:
        return log["qpos"], log["qvel"]
    base = log["base"]
    rot = np.array([pin.Quaternion(*b[3:7]).toRotationMatrix() for b in base])
    linear = np.einsum("kji,kj->ki", rot, base[:, 7:10])
    quat = base[:, [4, 5, 6, 3]]
    return (
        np.hstack([base[:, :3], quat, log["qpos"]]),
        np.hstack([linear, base[:, 10:], log["qvel"]]),
    )


def contact_torque(machine: Machine, model: pin.Model, q: np.ndarray, wrench: np.ndarray):
    """Σ Jᵀ w over the measured bodies, (T, nv)."""
    _, seats = to_pinocchio(machine)
    model = pin.Model(model)
    frames = []
    for body in machine.sensed:
        joint, at = seats[machine.index(body)]
        frame = pin.Frame(body, joint, 0, pin.SE3(np.eye(3), at), pin.FrameType.OP_FRAME)
        frames.append(model.addFrame(frame))
    data, out = model.createData(), np.zeros((len(q), model.nv))
    for k, row in enumerate(q):
        pin.computeJointJacobians(model, data, row)
        for i, frame in enumerate(frames):
            pin.updateFramePlacement(model, data, frame)
            jac = pin.getFrameJacobian(model, data, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
            out[k] += jac.T @ wrench[k, i]
    return out


def floor(machine: Machine, s: Sensors, rate: float, q: np.ndarray) -> np.ndarray:
    """Rough standard deviation (nv) that the sensors alone give the residual."""
    model, _ = to_pinocchio(machine)
    inertia = pin.crba(model, model.createData(), q)
    inertia = np.triu(inertia) + np.triu(inertia, 1).T
    band = 2.0 / rate
    sigma = np.concatenate([s.base[6:], s.qvel]) if machine.floating else s.qvel
    jerk = sigma * 2 * np.pi * np.sqrt(band * CUT**3 / 3.0)
    tau = np.hypot(s.tau, s.ripple) * np.sqrt(band * CUT)
    if machine.sensed:
        unit = np.ones((1, len(machine.sensed), 6)) * s.wrench
        spread = np.abs(contact_torque(machine, model, q[None], unit))[0] * np.sqrt(band * CUT)
        tau = np.hypot(np.concatenate([np.zeros(6), tau]), spread)
    return np.sqrt(tau**2 + inertia**2 @ jerk**2) + 1e-9


def nuisances(machine: Machine, q, v, a) -> np.ndarray:
    """What the residual is per likely error of the nominal model, (T, nv, k)."""
    model, _ = to_pinocchio(machine)
    data, n = model.createData(), len(machine.joints)
    directions = []
    for k in range(1, model.njoints):
        if model.inertias[k].mass < 1e-9:
            continue
        body = model.inertias[k]
        own = body.toDynamicParameters()
        directions.append((k - 1, 0.01 * own))
        for axis in np.eye(3):
            moved = pin.Inertia(body.mass, body.lever + 1e-3 * axis, body.inertia)
            directions.append((k - 1, moved.toDynamicParameters() - own))
    out = np.zeros((len(q), model.nv, len(directions) + n))
    which = np.array([10 * k for k, _ in directions])[:, None] + np.arange(10)
    change = np.array([d for _, d in directions])
    for t, row in enumerate(zip(q, v, a, strict=True)):
        regressor = pin.computeJointTorqueRegressor(model, data, *row)
        out[t, :, : len(change)] = np.einsum("vkp,kp->vk", regressor[:, which], change)
    for j in range(n):
        column = 0.075 * machine.array("damping")[j] * v[:, model.nv - n + j]
        out[:, model.nv - n + j, len(change) + j] = column
    return out


def visibility(machine: Machine, log: dict, s: Sensors, rows: int) -> dict:
    """χ² and `distinct` of a clean log under a model, and the residual's size per joint (N m)."""
    log = {k: x[:rows] for k, x in log.items()}
    rate = 1.0 / float(log["time"][1] - log["time"][0])
    raw, speed = residual(machine, log)
    n = len(machine.joints)
    q, v = coordinates(machine, log)
    sigma = floor(machine, s, rate, q[0])
    moving = np.ones_like(raw, dtype=bool)
    moving[:, -n:] = np.abs(speed) > REST
    # The nominal friction is arbitrary near a reversal, and the filter spreads that.
    reach = np.ones(2 * int(0.1 * rate) + 1)
    for j in np.flatnonzero(machine.array("friction")):
        near = np.convolve(np.abs(speed[:, j]) < 0.05, reach, "same") > 0.5
        moving[:, raw.shape[1] - n + j] &= ~near
    edge = int(0.2 * rate)
    moving[:edge] = moving[-edge:] = False
    weighted = np.where(moving, raw / sigma, 0.0)
    thin = slice(0, None, max(round(rate / RATE), 1))
    sos = butter(2, CUT, fs=rate, output="sos")
    smooth = sosfiltfilt(sos, v, axis=0)
    accel = np.gradient(smooth, 1.0 / rate, axis=0)
    share = np.sqrt(2 * CUT / RATE)
    columns = nuisances(machine, q[thin], smooth[thin], accel[thin])
    columns *= (moving[thin] / sigma)[:, :, None] * share
    columns = columns.reshape(-1, columns.shape[-1])
    y = weighted[thin].ravel() * share
    fit = np.linalg.solve(columns.T @ columns + np.eye(columns.shape[1]), columns.T @ y)
    rms = np.sqrt((np.where(moving, raw, 0.0) ** 2).mean(0))
    return {
        "chi2": float((weighted**2).sum() * 2 * CUT / rate),
        "distinct": float(y @ y - y @ columns @ fit),
        "rms": [float(x) for x in rms],
        "noise": [float(x) for x in sigma],
    }
