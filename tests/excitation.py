"""Data for estimators, made by MuJoCo C: motions, torques by mj_inverse, a humanoid stepping on its floor."""

import copy

import mujoco
import numpy as np
from models import MODELS

from jax_inertia.robots import home_pose, humanoid_mjcf
from jax_inertia.signals.differences import Observation
from jax_inertia.signals.generalised_motion import Motion

LOAD = {"mass": 2.4, "com": np.array([0.03, -0.02, 0.08]), "moments": (0.006, 0.008, 0.005)}


def compiled(name: str) -> mujoco.MjModel:
    """A test robot without dry friction, which MuJoCo regularises in a way of its own."""
    model = mujoco.MjModel.from_xml_string(MODELS[name])
    model.dof_frictionloss[:] = 0.0
    return model


def loaded(model: mujoco.MjModel, name: str, mass: float = LOAD["mass"]) -> mujoco.MjModel:
    """A copy in which the body carries a load of the given mass [kg], its inertia in proportion."""
    out = copy.copy(model)
    b = model.body(name).id
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, model.body_iquat[b])
    rotation = rotation.reshape(3, 3)
    own = rotation @ np.diag(model.body_inertia[b]) @ rotation.T
    about = np.diag(LOAD["moments"]) * mass / LOAD["mass"]
    parts = [(model.body_mass[b], model.body_ipos[b].copy(), own), (mass, LOAD["com"], about)]
    total = sum(m for m, _, _ in parts)
    centre = sum(m * c for m, c, _ in parts) / total
    inertia = sum(
        i + m * ((c - centre) @ (c - centre) * np.eye(3) - np.outer(c - centre, c - centre))
        for m, c, i in parts
    )
    moments, axes = np.linalg.eigh(inertia)
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, axes.ravel())
    out.body_mass[b], out.body_ipos[b] = total, centre
    out.body_iquat[b], out.body_inertia[b] = quat, moments
    # The compiler noted where frames coincide or inertias are simple; here they no longer do.
    out.body_sameframe[b] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE
    out.body_simple[b] = 0
    return out


def motion_of(model: mujoco.MjModel, samples: int, seed: int = 0, rate: float = 100.0):
    """(time, q, v, a) of a robot of hinges and slides: three sines a joint, exact in every derivative."""
    rng = np.random.default_rng(seed)
    time = np.arange(samples) / rate
    q, v, a = np.zeros((3, samples, model.nv))
    for j in range(model.nv):
        for _ in range(3):
            w, size, phase = rng.uniform(1.0, 6.0), rng.uniform(0.2, 0.5), rng.uniform(0, 2 * np.pi)
            q[:, j] += size * np.sin(w * time + phase)
            v[:, j] += size * w * np.cos(w * time + phase)
            a[:, j] -= size * w**2 * np.sin(w * time + phase)
    return time, q, v, a


def torques(model: mujoco.MjModel, q, v, a) -> np.ndarray:
    """Generalised force that gives the motion, by mj_inverse: damping and springs included."""
    data, out = mujoco.MjData(model), np.zeros_like(v)
    for k in range(len(q)):
        data.qpos[:], data.qvel[:], data.qacc[:] = q[k], v[k], a[k]
        mujoco.mj_inverse(model, data)
        out[k] = data.qfrc_inverse
    return out


def observation(time, q, v, a, tau, **changes) -> Observation:
    """All rows measured."""
    motion = Motion(time=time, q=q, v=v, tau=tau, valid=np.isfinite(tau), **changes)
    return Observation(motion, a)


def log_of(model: mujoco.MjModel, samples: int, noise: float = 0.0, seed: int = 0) -> Observation:
    """A motion and its torques, with white noise on the torques [N m]."""
    time, q, v, a = motion_of(model, samples, seed)
    tau = torques(model, q, v, a)
    rng = np.random.default_rng([seed, 1])
    return observation(time, q, v, a, tau + noise * rng.normal(size=tau.shape))


def humanoid() -> mujoco.MjModel:
    """The humanoid with contacts solved to rounding and no joint stops: Δτ can then vanish to rounding."""
    model = mujoco.MjModel.from_xml_string(humanoid_mjcf())
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_LIMIT)
    model.opt.iterations, model.opt.ls_iterations, model.opt.tolerance = 200, 100, 0.0
    return model


def stepping(model: mujoco.MjModel, seconds: float = 1.2) -> Observation:
    """The humanoid dropped by 1 cm onto its feet; it sways, swings its arms and lifts its left foot.

    Every fifth step, all of one instant: state, acceleration, joint torques and the wrench of each foot, forces and
    moments on the robot in world axes, moments about the foot's frame origin.
    """
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("home").id)
    data.qpos[2] += 0.01
    names = [model.joint(j).name for j in range(1, model.njnt)]
    home = np.array([home_pose()[name] for name in names])
    feet = ("left_foot_link", "right_foot_link")
    parts = {k: [] for k in ("time", "q", "v", "a", "tau", "wrench")}
    for step in range(int(seconds / model.opt.timestep)):
        target = home + _gesture(names, data.time)
        gain = np.where([("shoulder" in n or "elbow" in n) for n in names], 60.0, 600.0)
        data.qfrc_applied[6:] = gain * (target - data.qpos[7:]) - 0.06 * gain * data.qvel[6:]
        mujoco.mj_forward(model, data)
        if step % 5 == 0:
            parts["time"].append(data.time)
            parts["q"].append(data.qpos.copy())
            parts["v"].append(data.qvel.copy())
            parts["a"].append(data.qacc.copy())
            parts["tau"].append(data.qfrc_applied.copy())
            parts["wrench"].append([_wrench(model, data, model.body(f).id) for f in feet])
        mujoco.mj_step(model, data)
    arrays = {k: np.array(x) for k, x in parts.items()}
    acceleration = arrays.pop("a")
    motion = Motion(
        **arrays,
        valid=np.ones(acceleration.shape, bool),
        contact_bodies=feet,
        quaternions=(3,),
    )
    return Observation(motion, acceleration)


def _gesture(names: list[str], t: float) -> np.ndarray:
    out = np.zeros(len(names))
    for k, name in enumerate(names):
        if "shoulder" in name or "elbow" in name:
            out[k] = 0.5 * np.sin((5.0 + k % 3) * t + k)
        elif "spine" in name:
            out[k] = 0.15 * np.sin((4.0 + k % 3) * t + k)
        elif name in ("left_hip_y", "left_knee_y"):
            lift = 0.5 * max(0.0, np.sin(2 * np.pi * (t - 0.4)))
            out[k] = -lift if name == "left_hip_y" else 2 * lift
    return out


def _wrench(model: mujoco.MjModel, data: mujoco.MjData, body: int) -> np.ndarray:
    """Force and moment of all contacts on one body, about its frame origin, from MuJoCo's own contact forces."""
    total = np.zeros(6)
    for c in range(data.ncon):
        contact = data.contact[c]
        bodies = [model.geom_bodyid[g] for g in contact.geom]
        if body not in bodies:
            continue
        local = np.zeros(6)
        mujoco.mj_contactForce(model, data, c, local)
        axes = contact.frame.reshape(3, 3)
        # Positive on the second geom's body.
        sign = 1.0 if bodies[1] == body else -1.0
        force, moment = sign * axes.T @ local[:3], sign * axes.T @ local[3:]
        lever = contact.pos - data.xpos[body]
        total += np.concatenate([force, moment + np.cross(lever, force)])
    return total
