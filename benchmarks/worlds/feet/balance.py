"""The quadruped on its feet by a controller that knows the nominal model and noisy signals, and the log of it."""

from __future__ import annotations

import math

import mujoco
import numpy as np

from benchmarks.worlds.effects import Effect
from benchmarks.worlds.feet.legs import Leg, turned
from benchmarks.worlds.feet.quadruped import (
    HIP_W,
    HIP_X,
    HIP_Y,
    LEGS,
    SHANK,
    THIGH,
    Legged,
    quadruped,
)
from benchmarks.worlds.friction import KnownFriction
from benchmarks.worlds.plant import Noise, Plant, disturb_base
from benchmarks.worlds.robots import Robot

SIDES = tuple(
    Leg(leg, (HIP_X * (1 if leg[0] == "F" else -1), HIP_W * left), left, HIP_Y, THIGH, SHANK)
    for leg in LEGS
    for left in (1.0 if leg[1] == "L" else -1.0,)
)


def leg_angles(foot: np.ndarray, leg: Leg) -> np.ndarray:
    """Joint angles that put the foot's centre at `foot` (trunk frame)."""
    return leg.angles(foot - np.array([*leg.hip, 0.0]))


class Balance:
    """A wrench on the trunk shared among the standing feet, and joint feedback around the IK."""

    def __init__(self, robot: Robot, motion: Legged):
        self.model = robot.model()
        self.model.dof_frictionloss[:] = 0.0
        self.data = mujoco.MjData(self.model)
        self.motion, self.limit = motion, robot.peak
        self.feet = [self.model.body(f).id for f in robot.feet]
        self.mass = float(self.model.body_mass.sum())
        self.down: list[np.ndarray | None] = [None] * 4
        self.lifted = list(motion.home)
        self.jac = np.zeros((3, self.model.nv))

    def start(self) -> np.ndarray:
        """qpos of the standing robot at the motion's first pose."""
        pose = self.motion.pose(-2.0)
        home = self.motion.home - np.array([0.0, 0.0, pose[2]])
        legs = [leg_angles(p, leg) for p, leg in zip(home, SIDES, strict=True)]
        return np.concatenate([[0, 0, pose[2] - 0.0005, 1, 0, 0, 0], *legs])

    def __call__(self, k: int, t: float, q, v, base, target):
        m, d = self.model, self.data
        d.qpos[:7], d.qpos[7:], d.qvel[:6], d.qvel[6:] = base[:7], q, base[7:], v
        mujoco.mj_fwdPosition(m, d)
        mujoco.mj_fwdVelocity(m, d)
        h = 4e-3
        before, after = self.motion.pose(t - h), self.motion.pose(t + h)
        pose, speed = target.pose, (after - before) / (2 * h)
        accel = (after - 2 * pose + before) / h**2
        rot, want = d.xmat[1].reshape(3, 3), turned(pose[3:])
        error = want @ rot.T
        error = 0.5 * np.array(
            [error[2, 1] - error[1, 2], error[0, 2] - error[2, 0], error[1, 0] - error[0, 1]]
        )
        omega = rot @ base[10:13]
        force = accel[:3] + 60.0 * (pose[:3] - base[:3]) + 12.0 * (speed[:3] - base[7:10])
        force[2] += 9.81
        torque = np.array([0.3, 0.6, 0.6]) * (160.0 * error + 18.0 * (speed[3:] - omega))
        wrench = np.concatenate([self.mass * force, torque])

        position = d.xpos[self.feet]
        arms = position - d.subtree_com[1]
        grasp = np.zeros((6, 12))
        for i, (x, y, z) in enumerate(arms):
            grasp[:3, 3 * i : 3 * i + 3] = np.eye(3)
            grasp[3:, 3 * i : 3 * i + 3] = [[0, -z, y], [z, 0, -x], [-y, x, 0]]
        weights = np.repeat(target.weight, 3) * np.tile([0.5, 0.5, 1.0], 4)
        scaled = grasp * weights
        forces = scaled.T @ np.linalg.solve(scaled @ grasp.T + 1e-4 * np.eye(6), wrench)
        forces = forces.reshape(4, 3)
        forces[:, 2] = np.maximum(forces[:, 2], 0.0)
        flat = np.linalg.norm(forces[:, :2], axis=1) + 1e-9
        forces[:, :2] *= np.minimum(1.0, 0.6 * forces[:, 2] / flat)[:, None]

        tau, angles = d.qfrc_bias[6:].copy(), np.empty(12)
        for i, side in enumerate(SIDES):
            leg = slice(3 * i, 3 * i + 3)
            foot, gains = self._foot(i, target, position[i], base)
            angles[leg] = leg_angles(want.T @ (foot - pose[:3]), side)
            mujoco.mj_jacBody(m, d, self.jac, None, self.feet[i])
            tau[leg] -= self.jac[:, 6 + 3 * i : 9 + 3 * i].T @ forces[i]
            tau[leg] += gains[0] * (angles[leg] - q[leg]) - gains[1] * v[leg]
        return np.clip(tau, -self.limit, self.limit), angles

    def _foot(self, i: int, target, measured: np.ndarray, base: np.ndarray):
        """World target of one foot and the joint gains for its phase."""
        if target.swing[i] < 0.0:
            if self.down[i] is None:
                self.down[i] = np.array([measured[0], measured[1], 0.022])
            return self.down[i], (25.0, 0.8)
        if self.down[i] is not None:
            self.lifted[i], self.down[i] = self.down[i], None
        # Raibert's placement: under the moving trunk, ahead by half a stance, drifting home.
        drift, speed = base[:2] - target.pose[:2], base[7:9]
        place = target.feet[i].copy()
        stance = self.motion.duty * self.motion.period
        place[:2] += np.clip(0.8 * drift + (0.5 * stance + 0.06) * speed, -0.12, 0.12)
        s = target.swing[i]
        along = s * s * (3 - 2 * s)
        foot = (1 - along) * self.lifted[i] + along * place
        foot = foot + np.array([0, 0, self.motion.lift * math.sin(math.pi * s) ** 2])
        return foot, (120.0, 2.2)


def drawing_errors(model: mujoco.MjModel, rng: np.random.Generator) -> mujoco.MjModel:
    """The model with masses up to 1 %, centres 1 mm and dampings 5 to 10 % off, in place."""
    for body in range(1, model.nbody):
        factor = 1.0 + rng.uniform(-0.01, 0.01)
        model.body_mass[body] *= factor
        model.body_inertia[body] *= factor
        model.body_ipos[body] += rng.uniform(-1e-3, 1e-3, 3)
    level = rng.uniform(0.05, 0.10)
    model.dof_damping[:] *= 1.0 + rng.uniform(-level, level, model.nv)
    return model


def sensors(robot: Robot) -> Noise:
    """Encoders of 3e-5 rad, torques of 0.2 % of their rating, a base by motion capture, wrenches of 0.25 N."""
    n = len(robot.joints)
    base, wrench = np.repeat([2e-4, 2e-4, 3e-3, 3e-3], 3), np.repeat([0.25, 0.004], 3)
    qpos = np.full(n, 3e-5)
    return Noise(qpos, 25.0 * qpos, 2e-3 * robot.peak, np.zeros(n), base, wrench)


def walk(
    kind: str, seed: list[int], seconds: float, rate: int = 500, effects: tuple[Effect, ...] = (),
    model: mujoco.MjModel | None = None,
) -> dict[str, np.ndarray]:  # fmt: skip
    """The log of a squat, a sway or a trot as a diagnosis gets it; `model`: the real robot, else the nominal one.

    Friction losses are bristles'.
    """
    robot, rng = quadruped(), np.random.default_rng(seed)
    motion, noise = Legged(kind, rng), sensors(robot)
    model = model or robot.model()
    losses = {j: float(model.joint(j).frictionloss[0]) for j in robot.joints}
    known = [
        KnownFriction("joint", j, {"coulomb": level, "presliding": 7e-4})
        for j, level in losses.items()
        if level > 0
    ]
    plant, balance = Plant(robot, model, [*effects, *known]), Balance(robot, motion)
    start = balance.start(), np.zeros(plant.model.nv)
    log = plant.run(balance, motion, start, rate, seconds, noise, rng)
    error, rows = log["noise"], round(seconds * rate)
    pairs = zip(log["base"], error["base"], strict=True)
    base = np.array([disturb_base(clean, off) for clean, off in pairs])
    sensed = {name: log[name] + error[name] for name in ("qpos", "qvel", "tau")} | {
        "time": log["time"], "base_pos": base[:, :3], "base_quat": base[:, 3:7],
        "base_linvel": base[:, 7:10], "base_angvel": base[:, 10:],
        "contact_wrench": log["contact_wrench"] + error["wrench"],
    }  # fmt: skip
    out = {name: np.ascontiguousarray(x[:rows]) for name, x in sensed.items()}
    return out | {
        "joint_names": np.array(robot.joints), "contact_bodies": log["contact_bodies"],
        "tau_kind": np.array("current"), "sigma_qpos": noise.qpos, "sigma_tau": noise.tau,
    }  # fmt: skip
