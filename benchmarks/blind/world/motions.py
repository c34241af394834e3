"""Reference motions: angle, speed and acceleration of every joint at any time, also before zero."""

from __future__ import annotations

import math

import numpy as np

from world.describe import Machine
from world.machines import CALF, FOOT, HIP, OFFSET, SIDES, THIGH


class Sines:
    """Exciting: a few sines a joint, frequencies free between 0.08 and `top` Hz, never the same on two joints."""

    kind = "exciting"

    def __init__(self, machine: Machine, rng: np.random.Generator, share: float = 1.0):
        n = len(machine.joints)
        top = rng.uniform(0.6, 1.5)
        count = int(rng.integers(3, 7))
        self.omega = 2 * np.pi * np.exp(rng.uniform(np.log(0.08), np.log(top), (count, n)))
        self.phase = rng.uniform(0, 2 * np.pi, (count, n))
        self.gain = rng.uniform(0.3, 1.0, (count, n)) / self.omega**0.7
        span = 0.5 * (machine.upper - machine.lower)
        scale = np.minimum(
            span / self.gain.sum(0), machine.speed / (self.gain * self.omega).sum(0) * 1.25
        )
        self.gain *= share * scale * rng.uniform(0.6, 1.0, n)
        room = span - np.minimum(self.gain.sum(0), span)
        self.centre = 0.5 * (machine.upper + machine.lower) + rng.uniform(-0.8, 0.8, n) * room

    def __call__(self, t: float):
        angle = self.omega * t + self.phase
        s, c = self.gain * np.sin(angle), self.gain * np.cos(angle)
        q = self.centre + s.sum(0)
        return q, (self.omega * c).sum(0), -(self.omega**2 * s).sum(0)


class Stations:
    """Ordinary: between a few stations with cycloidal moves and dwells; in each move some joints rest."""

    kind = "ordinary"

    def __init__(self, machine: Machine, rng: np.random.Generator, share: float = 1.0):
        low, high = machine.lower, machine.upper
        n = len(low)
        home = rng.uniform(low + 0.2 * (high - low), high - 0.2 * (high - low))
        stops = [home + 0.8 * share * (rng.uniform(low, high) - home) for _ in range(4)]
        self.time, self.q = [-3.0, -rng.uniform(0.0, 0.8)], [home, home]
        while self.time[-1] < 14.0:
            goal = stops[rng.integers(4)] + rng.normal(0.0, 0.05, n)
            goal = np.clip(np.where(rng.random(n) < 0.15, self.q[-1], goal), low, high)
            # The peak speed of a cycloid is twice its mean.
            needed = np.max(2.0 * np.abs(goal - self.q[-1]) / machine.speed)
            length = max(needed * rng.uniform(1.0, 1.7), 0.55)
            self.time += [self.time[-1] + length, self.time[-1] + length + rng.uniform(0.1, 0.9)]
            self.q += [goal, goal]

    def __call__(self, t: float):
        k = min(max(int(np.searchsorted(self.time, t, side="right")) - 1, 0), len(self.time) - 2)
        span = self.time[k + 1] - self.time[k]
        s = min(max((t - self.time[k]) / span, 0.0), 1.0)
        delta, w = self.q[k + 1] - self.q[k], 2 * math.pi
        q = self.q[k] + delta * (s - math.sin(w * s) / w)
        v = delta * (1.0 - math.cos(w * s)) / span
        return q, v, delta * w * math.sin(w * s) / span**2


def leg_angles(foot: np.ndarray, front: int, side: int) -> np.ndarray:
    """Angles of a dog's leg whose ball is at `foot` in the trunk's frame."""
    x, y, z = foot - np.array([front * HIP[0], side * HIP[1], 0.0])
    lateral = side * OFFSET
    down = math.sqrt(max(y * y + z * z - lateral * lateral, 1e-4))
    roll = math.atan2(y, -z) - math.atan2(lateral, down)
    reach2 = x * x + down * down
    cosine = (reach2 - THIGH**2 - CALF**2) / (2 * THIGH * CALF)
    knee = -math.acos(min(max(cosine, -1.0), 1.0))
    pitch = math.atan2(-x, down) - math.atan2(CALF * math.sin(knee), THIGH + CALF * math.cos(knee))
    return np.array([roll, pitch, knee])


class Paws:
    """A dog on its feet: the trunk dances over four feet, or lifts them one after the other (`crawl`)."""

    def __init__(self, machine: Machine, rng: np.random.Generator, kind: str):
        self.kind, self.machine = kind, machine
        scale = {
            "dance": np.array([0.035, 0.03, 0.035, 0.10, 0.09, 0.10]),
            "squat": np.array([0.012, 0.01, 0.05, 0.04, 0.05, 0.04]),
            "crawl": np.array([0.004, 0.004, 0.006, 0.015, 0.015, 0.02]),
        }[kind]
        top = {"dance": 1.1, "squat": 1.3, "crawl": 0.6}[kind]
        self.omega = 2 * np.pi * rng.uniform(0.2, top, (3, 6))
        self.phase = rng.uniform(0, 2 * np.pi, (3, 6))
        self.gain = scale * rng.uniform(0.25, 0.6, (3, 6))
        wide = HIP[1] + OFFSET
        self.feet = np.array([[f * HIP[0], s * wide, FOOT] for f, s in SIDES.values()])
        self.period, self.lift = rng.uniform(1.1, 1.5), rng.uniform(0.03, 0.05)
        self.order = [0, 3, 1, 2]

    def swing(self, t: float) -> tuple[int, float, float]:
        """Which foot is to be in the air, how far along it is (0 on the ground), and how light the foot is (0 to 1)."""
        if self.kind != "crawl" or t < -0.4:
            return 0, 0.0, 0.0
        slot = t / self.period
        s = slot % 1.0
        light = min(max((min(s, 1 - s) - 0.12) / 0.2, 0.0), 1.0)
        along = min(max((s - 0.36) / 0.28, 0.0), 1.0)
        return self.order[math.floor(slot) % 4], along, light

    def pose(self, t: float) -> np.ndarray:
        fade = min(max((t + 1.0) / 0.7, 0.0), 1.0)
        fade *= fade * (3 - 2 * fade)
        pose = fade * (self.gain * np.sin(self.omega * t + self.phase)).sum(0)
        pose[2] += self.machine.height - (0.03 if self.kind == "squat" else 0.0)
        if self.kind == "crawl" and t > -0.4:
            leg, _, light = self.swing(t)
            smooth = light * light * (3 - 2 * light)
            pose[:2] -= 0.42 * smooth * self.feet[leg, :2]
        return pose

    def weights(self, t: float) -> np.ndarray:
        """Share of the load that each foot may carry."""
        leg, _, light = self.swing(t)
        out = np.ones(4)
        out[leg] -= light
        return out

    def __call__(self, t: float):
        h = 2e-3
        before, now, after = self.angles(t - h), self.angles(t), self.angles(t + h)
        return now, (after - before) / (2 * h), (after - 2 * now + before) / h**2

    def angles(self, t: float) -> np.ndarray:
        pose, (leg, along, _) = self.pose(t), self.swing(t)
        rot = rotation(pose[3:])
        out = []
        for k, (f, s) in enumerate(SIDES.values()):
            foot = self.feet[k].copy()
            if k == leg and along > 0:
                foot[2] += self.lift * math.sin(math.pi * along) ** 2
            out.append(leg_angles(rot.T @ (foot - pose[:3]), f, s))
        return np.concatenate(out)


def rotation(rpy: np.ndarray) -> np.ndarray:
    """Roll, pitch, yaw to a matrix."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy), np.sin(rpy)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def make(machine: Machine, kind: str, rng: np.random.Generator):
    """`kind`: exciting or ordinary; dance, squat or crawl for a dog."""
    if machine.feet:
        return Paws(machine, rng, kind)
    share = 0.55 if machine.floating else 1.0
    return (Sines if kind == "exciting" else Stations)(machine, rng, share)
