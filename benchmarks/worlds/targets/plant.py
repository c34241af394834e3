"""The robot that is told positions, by MuJoCo C at half a millisecond: friction by a bristle, play by a second mass.

Shares no law with the package: friction is LuGre's, integrated exactly between samples; a motor behind play is a mass
of its own on a stiff spring; the torque limit that falls with speed is cut off at the stall torque when braking.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field

import mujoco
import numpy as np

STEP = 5e-4
_INNER = 4  # Steps of a motor behind play in one of MuJoCo's.
_BRISTLE = 8e-4  # Displacement before a joint slides [rad].


@dataclass(frozen=True)
class Robot:
    """A model without friction and rotors, its joints, gains, and how far and fast targets go."""

    name: str
    xml: str
    joints: tuple[str, ...]
    bodies: tuple[str, ...]
    kp: np.ndarray
    kd: np.ndarray
    middle: np.ndarray
    swing: np.ndarray
    fastest: float
    """Of the sines that targets are made of [Hz]."""
    armature: float = 0.0
    """What the model has of each joint's rotor [kg m²]."""


class Unstable(Exception):
    """The robot flew off."""


def _zeros(n: int):
    return field(default_factory=lambda: np.zeros(n))


@dataclass
class Truth:
    """What this robot is, joint by joint (n,)."""

    armature: np.ndarray
    damping: np.ndarray
    dry: np.ndarray
    offset: np.ndarray
    kp: np.ndarray
    kd: np.ndarray
    delay: np.ndarray
    lag: np.ndarray
    bias: np.ndarray
    limit: np.ndarray
    no_load: np.ndarray
    dead: np.ndarray
    play: np.ndarray
    load: np.ndarray
    static: np.ndarray
    """Friction at rest over that in motion."""
    slow: np.ndarray
    mass: dict[str, float] = dataclasses.field(default_factory=dict)

    @staticmethod
    def sound(robot: Robot) -> Truth:
        n = len(robot.joints)
        z, inf = np.zeros(n), np.full(n, np.inf)
        return Truth(
            z + robot.armature, z, z, z, robot.kp, robot.kd, z, z, z, inf, inf, z, z, z, z + 1.0, z + 0.1,
        )  # fmt: skip


def targets(robot: Robot, seconds: float, rng: np.random.Generator, period: float) -> np.ndarray:
    """(K, n): sines of several frequencies, jumps, and stretches of standing still, one row each period."""
    at = np.arange(0.0, seconds + period, period)
    n = len(robot.joints)
    out = np.zeros((len(at), n))
    for j in range(n):
        for _ in range(4):
            f = robot.fastest * rng.uniform(0.08, 1.0)
            out[:, j] += (
                rng.uniform(0.3, 1.0) / (1 + f) * np.sin(2 * np.pi * (f * at + rng.uniform()))
            )
        edges = np.cumsum(rng.uniform(0.6, 1.6, int(seconds) + 2))
        level = rng.normal(size=len(edges) + 1) * 0.5
        out[:, j] += level[np.searchsorted(edges, at)]
    # At times the whole robot holds still.
    for first in rng.uniform(0.1, 0.9, max(int(seconds / 6), 1)) * seconds:
        rows = (at >= first) & (at < first + 0.8)
        if rows.any():
            out[rows] = out[np.flatnonzero(rows)[0]]
    ramp = np.minimum(at / 0.3, 1.0)[:, None]
    return robot.middle + ramp * robot.swing * out / np.maximum(np.abs(out).max(axis=0), 1e-9)


def simulate(
    robot: Robot,
    truth: Truth,
    told: np.ndarray,
    period: float,
    loop_hz: int,
    log_hz: int,
    counts: float,
) -> dict[str, np.ndarray]:
    """The log of a run: time, qpos, qpos_target, tau (what the motors give)."""
    spec = mujoco.MjSpec.from_string(robot.xml)
    model = spec.compile()
    model.opt.timestep = STEP
    behind = truth.play > 0
    model.dof_armature[:] = np.where(behind, 1e-6, truth.armature)
    for name, added in truth.mass.items():
        b = model.body(name).id
        share = 1.0 + added / model.body_mass[b]
        model.body_mass[b] *= share
        model.body_inertia[b] *= share
    data = mujoco.MjData(model)
    data.qpos[:] = told[0] - truth.offset
    n = len(robot.joints)
    motor, speed = data.qpos.copy(), np.zeros(n)
    bristle, arrived, tau = np.zeros(n), told[0].copy(), np.zeros(n)
    every, log_every = round(1 / (loop_hz * STEP)), round(1 / (log_hz * STEP))
    steps = int((len(told) - 1) * period / STEP)
    rows = []
    joint = np.arange(n)
    stiff = 40.0 * np.maximum(robot.kp, 1.0)
    for k in range(steps):
        t = k * STEP
        q, v = np.where(behind, motor, data.qpos), np.where(behind, speed, data.qvel)
        if k % every == 0:
            seen = np.round((q + truth.offset) / counts) * counts
            row = np.clip(np.floor((t - truth.delay + 1e-9) / period).astype(int), 0, len(told) - 1)
            keep = np.where(truth.lag > 0, np.exp(-every * STEP / np.maximum(truth.lag, 1e-9)), 0.0)
            arrived = keep * arrived + (1 - keep) * told[row, joint]
            miss = arrived - seen
            miss = np.sign(miss) * np.maximum(np.abs(miss) - truth.dead, 0.0)
            asked = truth.kp * miss - truth.kd * v + truth.bias
            top = (
                np.minimum(truth.limit, truth.limit * (1 - v / truth.no_load))
                if np.isfinite(truth.no_load).any()
                else truth.limit
            )
            low = (
                np.maximum(-truth.limit, -truth.limit * (1 + v / truth.no_load))
                if np.isfinite(truth.no_load).any()
                else -truth.limit
            )
            tau = np.clip(asked, np.minimum(low, 0), np.maximum(top, 0))
        if k % log_every == 0:
            seen = np.round((q + truth.offset) / counts) * counts
            now = told[min(int((t + 1e-9) / period), len(told) - 1)]
            rows.append((t, *seen, *now, *tau))
        dry = truth.dry + truth.load * np.abs(tau)
        size = np.maximum(dry * (1 + (truth.static - 1) * np.exp(-((v / truth.slow) ** 2))), 1e-9)
        end = np.sign(v) * _BRISTLE * size / np.maximum(dry, 1e-9)
        rate = np.abs(v) / (_BRISTLE * size / np.maximum(dry, 1e-9))
        new = end + (bristle - end) * np.exp(-rate * STEP)
        rub = np.where(dry > 1e-8, dry / _BRISTLE * new, 0.0)
        # A little damping of the bristle, or it rings.
        rub += np.where(dry > 1e-8, 0.05 * dry * (new - bristle) / STEP / _BRISTLE * 0.02, 0.0)
        bristle = new
        given = tau - rub - truth.damping * v
        passed = given.copy()
        if behind.any():
            h = STEP / _INNER
            link, link_v = data.qpos.copy(), data.qvel.copy()
            mean = np.zeros(n)
            for _ in range(_INNER):
                gap = motor - link
                out = np.sign(gap) * np.maximum(np.abs(gap) - 0.5 * truth.play, 0.0)
                touch = np.where(
                    out != 0,
                    stiff * out + 0.02 * np.sqrt(stiff * truth.armature) * (speed - link_v),
                    0.0,
                )
                speed = speed + h * np.where(
                    behind, (given - touch) / np.maximum(truth.armature, 1e-6), 0.0
                )
                motor, link = motor + h * speed, link + h * link_v
                mean += touch / _INNER
            passed = np.where(behind, mean, given)
            motor = np.where(behind, motor, data.qpos)
        data.qfrc_applied[:] = passed
        mujoco.mj_step(model, data)
        if not np.all(np.isfinite(data.qpos)) or np.abs(data.qvel).max() > 300:
            raise Unstable
    x = np.array(rows)
    return {
        "time": x[:, 0], "joint_names": np.array(robot.joints), "qpos": x[:, 1 : 1 + n],
        "qpos_target": x[:, 1 + n : 1 + 2 * n], "tau": x[:, 1 + 2 * n :], "kp": robot.kp, "kd": robot.kd,
    }  # fmt: skip
