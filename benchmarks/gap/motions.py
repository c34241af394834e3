"""Reference motions: exciting Fourier trajectories, pick and place, and a quadruped's exercises.

Arm motions give joint angle, speed and acceleration at any time, also before zero (the plant runs a
second of pre-roll). Leg motions give the trunk's pose and which feet stand.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from robots import HIP_W, HIP_X, HIP_Y, Robot

STAND_HEIGHT = 0.36


class Fourier:
    """Random Fourier series within the motion limits, f₀ = 0.1 Hz, band up to 0.7–1.6 Hz."""

    def __init__(self, robot: Robot, rng: np.random.Generator):
        n = len(robot.joints)
        top = rng.uniform(0.7, 1.6)
        count = int(top / 0.1)
        self.omega = 2 * np.pi * 0.1 * np.arange(1, count + 1)[:, None]
        tilt = rng.uniform(0.4, 1.0)
        gain = rng.normal(size=(2, count, n)) / np.arange(1, count + 1)[:, None] ** tilt
        self.a, self.b = gain
        self.centre = np.zeros(n)
        span = 0.5 * (robot.upper - robot.lower)
        grid = np.linspace(0.0, 10.0, 2000)
        q, v, _ = (np.array(x) for x in zip(*(self(t) for t in grid), strict=True))
        half = 0.5 * (q.max(0) - q.min(0))
        scale = np.minimum(span / half, robot.max_speed / np.abs(v).max(0))
        scale *= rng.uniform(0.7, 1.0, n)
        self.a, self.b = self.a * scale, self.b * scale
        half, middle = half * scale, 0.5 * (q.max(0) + q.min(0)) * scale
        room = np.maximum(span - half, 0.0)
        home = 0.5 * (robot.upper + robot.lower)
        self.centre = home - middle + rng.uniform(-1.0, 1.0, n) * room

    def __call__(self, t: float):
        w = self.omega[:, 0]
        s, c = np.sin(w * t), np.cos(w * t)
        q = s @ self.a + c @ self.b
        a = -((w * w * s) @ self.a) - (w * w * c) @ self.b
        return self.centre + q, (w * c) @ self.a - (w * s) @ self.b, a


class PickPlace:
    """Minimum-jerk moves between random poses with dwells; some joints stay put in some moves."""

    def __init__(self, robot: Robot, rng: np.random.Generator):
        n = len(robot.joints)
        self.time, self.q = [-2.0, 0.0 - rng.uniform(0.0, 0.6)], []
        first = rng.uniform(robot.lower, robot.upper)
        self.q = [first, first]
        stations = first + 0.75 * (rng.uniform(robot.lower, robot.upper, (5, n)) - first)
        while self.time[-1] < 16.0:
            goal = stations[rng.integers(5)] + rng.normal(0.0, 0.08, n)
            goal = np.clip(goal, robot.lower, robot.upper)
            goal = np.where(rng.random(n) < 0.12, self.q[-1], goal)
            # The peak speed of a minimum-jerk move is 1.875 times its mean.
            fastest = np.max(1.875 * np.abs(goal - self.q[-1]) / robot.max_speed)
            duration = max(fastest * rng.uniform(1.0, 1.6), 0.5)
            dwell = rng.uniform(0.15, 0.8)
            self.time += [self.time[-1] + duration, self.time[-1] + duration + dwell]
            self.q += [goal, goal]

    def __call__(self, t: float):
        k = int(np.searchsorted(self.time, t, side="right")) - 1
        k = min(max(k, 0), len(self.time) - 2)
        start, delta = self.q[k], self.q[k + 1] - self.q[k]
        span = self.time[k + 1] - self.time[k]
        s = min(max((t - self.time[k]) / span, 0.0), 1.0)
        q = start + delta * s**3 * (10 - 15 * s + 6 * s * s)
        v = delta * 30 * s**2 * (1 - s) ** 2 / span
        return q, v, delta * 60 * s * (1 - s) * (1 - 2 * s) / span**2


@dataclass(frozen=True)
class Stance:
    """Targets of the quadruped; `swing`: a foot's phase in the air, −1 on the ground."""

    pose: np.ndarray  # x, y, z (m), roll, pitch, yaw (rad)
    weight: np.ndarray  # 4: share of load a foot may take, 0 to 1
    swing: np.ndarray  # 4
    feet: np.ndarray  # 4 x 3 touchdown places, world frame


class Legged:
    """Squats, sways and pushes of the trunk over four feet, or a trot in place."""

    def __init__(self, kind: str, rng: np.random.Generator):
        self.kind = kind
        scale = {
            "squat": [0.015, 0.01, 0.055, 0.05, 0.05, 0.04],
            "sway": [0.045, 0.035, 0.02, 0.12, 0.10, 0.12],
            "trot": [0.012, 0.012, 0.008, 0.02, 0.02, 0.08],
        }[kind]
        top = {"squat": 1.3, "sway": 1.1, "trot": 0.6}[kind]
        self.omega = 2 * np.pi * rng.uniform(0.2, top, (3, 6))
        self.phase = rng.uniform(0, 2 * np.pi, (3, 6))
        self.gain = np.array(scale) * rng.uniform(0.25, 0.6, (3, 6))
        self.height = STAND_HEIGHT - (0.05 if kind == "squat" else 0.02)
        self.period = rng.uniform(0.42, 0.55)
        self.duty = rng.uniform(0.56, 0.64)
        self.lift = rng.uniform(0.04, 0.06)
        wide = HIP_W + HIP_Y
        self.home = np.array(
            [[f * HIP_X, s * wide, 0.022] for f, s in ((1, 1), (1, -1), (-1, 1), (-1, -1))]
        )

    def pose(self, t: float) -> np.ndarray:
        fade = min(max((t + 1.0) / 0.8, 0.0), 1.0)
        fade = fade * fade * (3 - 2 * fade)
        pose = fade * (self.gain * np.sin(self.omega * t + self.phase)).sum(0)
        pose[2] += self.height
        return pose

    def __call__(self, t: float) -> Stance:
        pose = self.pose(t)
        weight, swing = np.ones(4), np.full(4, -1.0)
        if self.kind == "trot" and t > -1.0:
            for k in range(4):
                phase = (t / self.period + (0.0 if k in (0, 3) else 0.5)) % 1.0
                if phase < self.duty:
                    edge = min(phase, self.duty - phase) / 0.06
                    weight[k] = min(max(edge, 0.02), 1.0)
                else:
                    weight[k], swing[k] = 0.0, (phase - self.duty) / (1 - self.duty)
        c, s = math.cos(pose[5]), math.sin(pose[5])
        turned = self.home.copy()
        if self.kind == "trot":
            turned[:, 0] = pose[0] + c * self.home[:, 0] - s * self.home[:, 1]
            turned[:, 1] = pose[1] + s * self.home[:, 0] + c * self.home[:, 1]
        return Stance(pose, weight, swing, turned)


def make_motion(robot: Robot, kind: str, seed: list[int]):
    """`kind`: exciting or ordinary for arms; squat, sway or trot for the quadruped."""
    rng = np.random.default_rng(seed)
    if robot.floating:
        return Legged(kind, rng)
    return Fourier(robot, rng) if kind == "exciting" else PickPlace(robot, rng)
