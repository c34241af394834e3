"""Motions with loads drawn at random, and what sensors make of them: torques by MuJoCo C's inverse dynamics.

Joints (and a floating base, held by a load cell whose wrench is logged) follow sums of sines, exact in every
derivative; nothing of the package's dynamics is used. A load is a ball within `REACH` of its link's centre of mass.
"""

import copy
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from benchmarks.worlds.feet.quadruped import quadruped
from jax_inertia.robots import HumanoidOptions, humanoid_mjcf
from jax_inertia.robots.arm import arm_mjcf
from jax_inertia.signals.differences import Observation, aligned_differences
from jax_inertia.signals.generalised_motion import Motion

RATE, WINDOW = 500.0, 8  # Hz, periods: an observation every 16 ms
REACH = 0.2  # m


@dataclass(frozen=True)
class Subject:
    """A robot, the links that may carry a load, and its sensors' noise."""

    name: str
    model: mujoco.MjModel
    links: tuple[str, ...]
    load: float
    """Size of a load [kg]: what the filter's prior is told."""
    sigma_tau: float = 0.3  # N m
    sigma_v: float = 2e-3  # rad/s, m/s
    sigma_wrench: float = 1.0  # N, N m of the load cell
    swing: float = 0.5  # rad

    @property
    def floating(self) -> bool:
        return bool(self.model.nq > self.model.nv)


_SMALL = """
<mujoco><worldbody>
  <body name="upper" pos="0 0 1"><joint name="a" axis="0 1 0" damping="0.3" armature="0.02"/>
    <inertial pos="0.01 0 -0.2" mass="2.1" diaginertia="0.03 0.03 0.004"/>
    <body name="hand" pos="0 0 -0.4"><joint name="b" axis="1 1 0" damping="0.2" armature="0.02"/>
      <inertial pos="0.02 0.01 -0.15" mass="1.1" diaginertia="0.01 0.011 0.002"/></body></body>
</worldbody></mujoco>
"""


def subject(name: str) -> Subject:
    """One of `NAMES`."""
    text, links, load = {
        "small": lambda: (_SMALL, ("hand",), 1.0),
        "arm": lambda: (arm_mjcf(), ("hand", "wrist", "forearm_roll"), 1.5),
        "humanoid": lambda: (
            humanoid_mjcf(HumanoidOptions(visual=False)),
            ("torso_link", "left_elbow_pitch_link", "right_elbow_pitch_link"),
            5.0,
        ),
        "quadruped": lambda: (
            quadruped().xml,
            ("trunk", "FL_shank", "FR_shank", "RL_shank", "RR_shank"),
            2.0,
        ),
    }[name]()
    model = mujoco.MjModel.from_xml_string(text)
    model.dof_frictionloss[:] = 0.0  # MuJoCo's inverse makes a force of its own of it at rest
    off = mujoco.mjtDisableBit
    model.opt.disableflags |= int(off.mjDSBL_CONTACT | off.mjDSBL_LIMIT)
    return Subject(name, model, links, load, swing=0.3 if model.nq > model.nv else 0.5)


NAMES = ("small", "arm", "humanoid", "quadruped")


@dataclass(frozen=True)
class Ball:
    """A load: a homogeneous ball, `at` [m] in its link's frame."""

    mass: float
    at: np.ndarray
    radius: float

    def pi(self) -> np.ndarray:
        """[m, h, I] about the link's frame origin."""
        own = 0.4 * self.mass * self.radius**2 * np.eye(3)
        i = own + self.mass * (self.at @ self.at * np.eye(3) - np.outer(self.at, self.at))
        return np.array([self.mass, *(self.mass * self.at), *i[np.triu_indices(3)]])


def ball(who: Subject, link: str, rng: np.random.Generator, *, least: float = 0.0) -> Ball:
    """A load of `least` to twice the usual size [share], anywhere within REACH of the link's centre of mass."""
    direction = rng.normal(size=3)
    away = REACH * rng.uniform() ** (1 / 3) * direction / np.linalg.norm(direction)
    at = who.model.body(link).ipos + away
    return Ball(who.load * rng.uniform(max(least, 0.02), 2.0), at, rng.uniform(0.02, 0.08))


def carrying(model: mujoco.MjModel, loads: dict[str, Ball]) -> mujoco.MjModel:
    """A copy of the model with each load welded to its link."""
    out = copy.copy(model)
    for link, load in loads.items():
        b = model.body(link).id
        rotation = np.zeros(9)
        mujoco.mju_quat2Mat(rotation, out.body_iquat[b])
        axes = rotation.reshape(3, 3)
        parts = [
            (
                out.body_mass[b],
                out.body_ipos[b].copy(),
                axes @ np.diag(out.body_inertia[b]) @ axes.T,
            ),
            (load.mass, load.at, 0.4 * load.mass * load.radius**2 * np.eye(3)),
        ]
        mass = sum(m for m, _, _ in parts)
        centre = sum(m * c for m, c, _ in parts) / mass
        away = [(m, c - centre, i) for m, c, i in parts]
        inertia = sum(i + m * (d @ d * np.eye(3) - np.outer(d, d)) for m, d, i in away)
        moments, turned = np.linalg.eigh(inertia)
        turned[:, 2] *= np.sign(np.linalg.det(turned))
        quat = np.zeros(4)
        mujoco.mju_mat2Quat(quat, turned.ravel())
        out.body_mass[b], out.body_ipos[b] = mass, centre
        out.body_iquat[b], out.body_inertia[b] = quat, moments
        # The compiler noted where frames coincide or inertias are simple; here they no longer do.
        out.body_sameframe[b] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE
        out.body_simple[b] = 0
    mujoco.mj_setConst(out, mujoco.MjData(out))
    return out


@dataclass(frozen=True)
class Trajectory:
    """q, v, v̇ at the stamps."""

    time: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray


def trajectory(who: Subject, seconds: float, rng: np.random.Generator) -> Trajectory:
    """Two sines of 0.2 to 1.2 Hz to each joint and to each coordinate of a floating base."""
    time = np.arange(round(seconds * RATE) + 1) / RATE
    joints = who.model.nv - 6 * who.floating
    size = np.concatenate([np.full(3 * who.floating, 0.03), np.full(3 * who.floating, 0.15),
                           np.full(joints, who.swing)])  # fmt: skip
    omega = 2 * np.pi * rng.uniform(0.2, 1.2, (2, len(size), 1))
    phase = rng.uniform(0, 2 * np.pi, (2, len(size), 1))

    def derivative(t: np.ndarray, order: int) -> np.ndarray:
        wave = size[:, None] * omega**order * np.sin(omega * t + phase + 0.5 * np.pi * order)
        return wave.sum(axis=0).T

    home = who.model.qpos0 if who.model.nkey == 0 else who.model.key_qpos[0]
    x = [derivative(time, order) for order in range(3)]
    if not who.floating:
        return Trajectory(time, home + x[0], x[1], x[2])
    q = np.hstack([home[:3] + x[0][:, :3], _quaternion(x[0][:, 3:6]), home[7:] + x[0][:, 6:]])
    step = 1e-4

    def rate(t: np.ndarray) -> np.ndarray:
        before, after = (_quaternion(derivative(t + s, 0)[:, 3:6]) for s in (-step, step))
        return _turned(before, after) / (2 * step)

    v, a = x[1].copy(), x[2].copy()
    v[:, 3:6] = rate(time)
    a[:, 3:6] = (rate(time + step) - rate(time - step)) / (2 * step)
    return Trajectory(time, q, v, a)


def _quaternion(turn: np.ndarray) -> np.ndarray:
    angle = np.linalg.norm(turn, axis=1, keepdims=True)
    return np.hstack([np.cos(angle / 2), 0.5 * np.sinc(angle / (2 * np.pi)) * turn])


def _turned(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Rotation vector of p⁻¹ q, in the body's axes, for small ones."""
    w, x = p[:, :1], -p[:, 1:]
    s = w * q[:, :1] - np.sum(x * q[:, 1:], axis=1, keepdims=True)
    u = w * q[:, 1:] + q[:, :1] * x + np.cross(x, q[:, 1:])
    norm = np.linalg.norm(u, axis=1, keepdims=True)
    return 2 * np.arctan2(norm, s) * u / np.where(norm > 0, norm, 1.0)


def forces(model: mujoco.MjModel, path: Trajectory, rows: slice = slice(None)) -> np.ndarray:
    """Generalised forces of the motion: MuJoCo C's inverse dynamics."""
    data, out = mujoco.MjData(model), []
    for q, v, a in zip(path.q[rows], path.v[rows], path.a[rows], strict=True):
        data.qpos[:], data.qvel[:], data.qacc[:] = q, v, a
        mujoco.mj_inverse(model, data)
        out.append(data.qfrc_inverse.copy())
    return np.array(out)


def observed(
    who: Subject,
    path: Trajectory,
    force: np.ndarray,
    rng: np.random.Generator,
    window: int = WINDOW,
) -> Observation:
    """What the robot's sensors give, as the package prepares it: windows that follow one another."""
    v = path.v + who.sigma_v * rng.normal(size=path.v.shape)
    tau, wrench, bodies, quats = force + who.sigma_tau * rng.normal(size=v.shape), None, (), ()
    if who.floating:
        tau[:, :6] = 0.0
        moment = np.array(
            [_rotate(q, m) for q, m in zip(path.q[:, 3:7], force[:, 3:6], strict=True)]
        )
        wrench = np.hstack([force[:, :3], moment]) + who.sigma_wrench * rng.normal(size=(len(v), 6))
        wrench, bodies, quats = wrench[:, None], (who.model.body(1).name,), (3,)
    motion = Motion(
        time=path.time,
        q=path.q,
        v=v,
        tau=tau,
        valid=np.ones(v.shape, bool),
        wrench=wrench,
        contact_bodies=bodies,
        quaternions=quats,
    )
    every = aligned_differences(motion, window)
    rows = slice(None, None, window)
    m = every.motion
    kept = {n: getattr(m, n)[rows] for n in ("time", "q", "v", "tau", "valid")}
    kept["wrench"] = None if m.wrench is None else m.wrench[rows]
    return Observation(replace(m, **kept), every.a[rows])


def _rotate(quat: np.ndarray, x: np.ndarray) -> np.ndarray:
    out = np.zeros(3)
    mujoco.mju_rotVecQuat(out, x, quat)
    return out


def noise_of_torque(who: Subject, window: int = WINDOW) -> np.ndarray:
    """σ of an observation's Δτ, accelerations apart (nv,), as a sum of many has it.

    Windows that follow one another share a sample, half of it each: one mean has σ √(w − ½) / w, n of them σ √(n / w).
    """
    mean = window**-0.5
    sigma = np.full(who.model.nv, who.sigma_tau)
    if who.floating:
        sigma[:6] = who.sigma_wrench
    return sigma * mean


def noise_of_acceleration(who: Subject, window: int = WINDOW) -> float:
    """σ of a difference over a window [rad/s², m/s²]."""
    return np.sqrt(2.0) * who.sigma_v / (window / RATE)
