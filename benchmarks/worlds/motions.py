"""Reference motions: exciting Fourier trajectories, and pick and place.

They give joint angle, speed and acceleration at any time, also before zero (the plant runs a second of pre-roll).
"""

from __future__ import annotations

import numpy as np

from benchmarks.worlds.robots import Robot


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


def make_motion(robot: Robot, kind: str, seed: list[int]):
    """`kind`: exciting or ordinary."""
    rng = np.random.default_rng(seed)
    return Fourier(robot, rng) if kind == "exciting" else PickPlace(robot, rng)
