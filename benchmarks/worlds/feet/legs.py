"""Robots on their feet, made up here for the stratum `imu`: quadrupeds and bipeds of drawn sizes, and their targets.

Lengths in m, masses in kg, angles in rad. MJCF without friction and rotors; feet are balls, four to a biped's sole.
Axes: x ahead, y to the left, z up; each leg has hip roll, hip pitch and knee, a biped's ankle pitch and roll besides.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

Targets = Callable[[float], np.ndarray]
SOLE = np.array([[0.09, 0.035], [0.09, -0.035], [-0.06, 0.035], [-0.06, -0.035]])
"""Of a biped's foot: where the balls are under the ankle (x, y)."""


@dataclass(frozen=True)
class Leg:
    """Where a hip is on the trunk, which side it is on (±1), and the lengths below it."""

    name: str
    hip: tuple[float, float]
    side: float
    aside: float
    thigh: float
    shank: float

    def angles(self, ankle: np.ndarray) -> np.ndarray:
        """Roll, pitch and knee that put the leg's end at `ankle`, from the hip in the trunk's axes."""
        x, y, z = ankle
        down = np.sqrt(max(y * y + z * z - self.aside**2, 1e-6))
        roll = np.arctan2(y, -z) - np.arctan2(self.side * self.aside, down)
        reach = min(np.hypot(x, down), 0.999 * (self.thigh + self.shank))
        cosine = (reach**2 - self.thigh**2 - self.shank**2) / (2 * self.thigh * self.shank)
        bend = float(np.arccos(np.clip(cosine, -1.0, 1.0)))
        lead = np.arctan2(self.shank * np.sin(bend), self.thigh + self.shank * np.cos(bend))
        return np.array([roll, np.arctan2(-x, down) + lead, -bend])


@dataclass(frozen=True)
class Walker:
    """A robot on its feet: its model, its loop, and its legs."""

    name: str
    xml: str
    trunk: str
    joints: tuple[str, ...]
    bodies: tuple[str, ...]
    feet: tuple[str, ...]
    kp: np.ndarray
    kd: np.ndarray
    legs: tuple[Leg, ...]
    height: float
    """Of the hips over the legs' ends as it stands."""
    ankles: bool
    imu: np.ndarray

    def told(self, feet: np.ndarray, pose: np.ndarray) -> np.ndarray:
        """Joint angles (n) of a trunk moved by `pose` (x, y, z, roll, pitch, yaw) over feet moved by `feet`."""
        turn = turned(pose[3:])
        out = []
        for leg, foot in zip(self.legs, feet, strict=True):
            hip = np.array([*leg.hip, 0.0])
            under = np.array([0.0, leg.side * leg.aside, -self.height])
            place = turn.T @ (hip + under + foot - pose[:3]) - hip
            angles = leg.angles(place)
            out.append(angles)
            if self.ankles:
                out.append([-angles[1] - angles[2] - pose[4], -angles[0] - pose[3]])
        return np.concatenate(out)


def turned(rpy: np.ndarray) -> np.ndarray:
    """Rotation by roll, pitch, yaw (3, 3)."""
    out = np.eye(3)
    for axis, angle in zip((2, 1, 0), rpy[::-1], strict=True):
        c, s = np.cos(angle), np.sin(angle)
        i, j = [k for k in range(3) if k != axis]
        one = np.eye(3)
        one[i, i] = one[j, j] = c
        one[i, j], one[j, i] = (-s, s) if axis != 1 else (s, -s)
        out = out @ one
    return out


def sways(robot: Walker, rng: np.random.Generator) -> Targets:
    """The trunk shifts, squats and turns a little over standing feet."""
    size = np.array([0.03, 0.03, 0.035, 0.06, 0.06, 0.05]) * (robot.height / 0.33)
    if robot.ankles:
        size *= [0.25, 0.4, 0.4, 0.0, 0.0, 0.0]
    gain = size * rng.uniform(0.3, 0.6, (2, 6))
    omega = 2 * np.pi * rng.uniform(0.25, 1.3, (2, 6))
    phase = rng.uniform(0, 2 * np.pi, (2, 6))
    still = np.zeros((len(robot.legs), 3))

    def at(t: float) -> np.ndarray:
        fade = min(max(t, 0.0), 1.0)
        return robot.told(still, fade * (gain * np.sin(omega * t + phase)).sum(0))

    return at


def trots(robot: Walker, rng: np.random.Generator) -> Targets:
    """Diagonal legs in turn, on the spot or ahead, as a policy without feedback tells it."""
    period, lift = rng.uniform(0.42, 0.55), rng.uniform(0.04, 0.06)
    stride, swing = rng.uniform(0.0, 0.08), rng.uniform(0.40, 0.46)

    def at(t: float) -> np.ndarray:
        fade, feet = min(max(t, 0.0), 1.0), np.zeros((4, 3))
        for k in range(4):
            phase = (t / period + (0.0 if k in (0, 3) else 0.5)) % 1.0
            if phase < swing:
                s = phase / swing
                feet[k] = [stride * (s - 0.5), 0.0, lift * np.sin(np.pi * s) ** 2]
            else:
                feet[k, 0] = stride * (0.5 - (phase - swing) / (1.0 - swing))
        return robot.told(fade * feet, np.zeros(6))

    return at


def quadruped(rng: np.random.Generator) -> Walker:
    """Twelve joints, 11 to 25 kg."""
    size, weight = rng.uniform(0.9, 1.25), rng.uniform(0.9, 1.15)
    thigh, shank = size * rng.uniform(0.20, 0.22), size * rng.uniform(0.20, 0.22)
    heavy = weight * size**2.5
    trunk = heavy * rng.uniform(6.0, 8.0)
    legs = tuple(
        Leg(name, (front * 0.19 * size, left * 0.05 * size), left, 0.08 * size, thigh, shank)
        for name, front, left in (("FL", 1, 1), ("FR", 1, -1), ("RL", -1, 1), ("RR", -1, -1))
    )
    masses = heavy * np.array([0.6, 1.0, 0.3]) * rng.uniform(0.9, 1.1, 3)
    stiff = 60.0 * heavy * size * rng.uniform(0.9, 1.5)
    imu = rng.uniform([-0.05, -0.02, 0.0], [0.05, 0.02, 0.06])
    return _walker("quadruped", "trunk", legs, trunk, masses, stiff, imu, 0.022 * size, False)


def biped(rng: np.random.Generator) -> Walker:
    """Ten joints with flat feet, 20 to 35 kg."""
    size = rng.uniform(0.9, 1.15)
    thigh, shank = size * rng.uniform(0.27, 0.31), size * rng.uniform(0.27, 0.31)
    heavy = size**2.5 * rng.uniform(0.9, 1.1)
    legs = tuple(
        Leg(name, (0.0, left * 0.07 * size), left, 0.03 * size, thigh, shank)
        for name, left in (("left", 1.0), ("right", -1.0))
    )
    masses = heavy * np.array([1.4, 2.6, 1.6]) * rng.uniform(0.9, 1.1, 3)
    trunk = heavy * rng.uniform(12.0, 15.0)
    imu = rng.uniform([-0.05, -0.02, 0.1], [0.05, 0.02, 0.25])
    return _walker("biped", "torso", legs, trunk, masses, 420.0 * heavy, imu, 0.012, True)


WALKERS = {"quadruped": quadruped, "biped": biped}


def _walker(
    name: str, trunk: str, legs: tuple[Leg, ...], mass: float, masses: np.ndarray, stiff: float,
    imu: np.ndarray, ball: float, ankles: bool,
) -> Walker:  # fmt: skip
    height = (0.88 if ankles else 0.78) * (legs[0].thigh + legs[0].shank)
    ground = height + ball + (0.05 if ankles else 0.0)
    parts = ("roll", "pitch", "knee", *(("ankle_pitch", "ankle_roll") if ankles else ()))
    links = ("hip", "thigh", "shank", *(("ankle", "foot") if ankles else ()))
    box = mass * np.array([0.005, 0.025, 0.028]) * (legs[0].thigh / 0.21) ** 2
    middle = (0.012, -0.002, 0.12 if ankles else 0.004)
    xml = f"""<mujoco model="{name}">
  <compiler angle="radian"/>
  <option timestep="0.00025" integrator="implicitfast" cone="elliptic" impratio="10"/>
  <default>
    <geom contype="0" conaffinity="0" condim="3" friction="0.8 0.02 0.001" solref="0.008 1"/>
  </default>
  <worldbody>
    <geom name="floor" type="plane" size="9 9 1" contype="1" conaffinity="1"/>
    <body name="{trunk}" pos="0 0 {ground:.5f}">
      <freejoint name="root"/>
      <inertial pos="{_numbers(middle)}" mass="{mass:.5f}" diaginertia="{_numbers(box)}"/>
      <site name="imu" pos="{_numbers(imu)}"/>{"".join(_leg(x, masses, ball, ankles) for x in legs)}
    </body>
  </worldbody>
  <sensor><accelerometer name="accelerometer" site="imu"/><gyro name="gyro" site="imu"/></sensor>
</mujoco>"""
    gains = np.array([1.0, 1.0, 1.0, *((0.7, 0.7) if ankles else ())])
    kp = np.tile(stiff * gains, len(legs))
    return Walker(
        name=name, xml=xml, trunk=trunk, ankles=ankles, imu=imu, legs=legs, height=height,
        joints=tuple(f"{x.name}_{p}" for x in legs for p in parts),
        bodies=(trunk, *(f"{x.name}_{p}" for x in legs for p in links)),
        feet=tuple(f"{x.name}_{'foot' if ankles else 'shank'}" for x in legs),
        kp=kp, kd=0.03 * kp,
    )  # fmt: skip


def _numbers(x) -> str:
    return " ".join(f"{v:.6g}" for v in x)


def _leg(leg: Leg, masses: np.ndarray, ball: float, ankles: bool) -> str:
    s, (hip, thigh, shank), (up, low) = leg.side, masses, (leg.thigh, leg.shank)

    def geom(k: int, x: float, y: float, z: float) -> str:
        return (
            f'<geom name="{leg.name}_{k}" type="sphere" size="{ball:.5g}" pos="{_numbers((x, y, z))}" mass="0" '
            'contype="1" conaffinity="1"/>'
        )

    def body(link: str, joint: str, pos, axis: str, mass: float, centre, inertia, inside: str):
        return (
            f'<body name="{leg.name}_{link}" pos="{_numbers(pos)}">'
            f'<joint name="{leg.name}_{joint}" axis="{axis}"/>'
            f'<inertial pos="{_numbers(centre)}" mass="{mass:.5f}" diaginertia="{_numbers(inertia)}"/>{inside}</body>'
        )

    end = geom(0, 0.0, 0.0, -low)
    if ankles:
        sole = "".join(geom(k, x, y, -0.05) for k, (x, y) in enumerate(SOLE))
        foot = body("foot", "ankle_roll", (0, 0, 0), "1 0 0", 0.3 * shank, (0.01, 0, -0.03),
                    0.3 * shank * np.array([0.001, 0.003, 0.003]), sole)  # fmt: skip
        end = body("ankle", "ankle_pitch", (0, 0, -low), "0 1 0", 0.15 * shank, (0, 0, 0),
                   0.15 * shank * np.array([0.001, 0.001, 0.001]), foot)  # fmt: skip
    thin, thicker = np.array([[1.0, 1.0, 0.06], [1.0, 1.0, 0.16]])
    lower = body("shank", "knee", (0, 0, -up), "0 1 0", shank, (0.005, 0, -0.45 * low),
                 shank * low**2 / 11 * thin, end)  # fmt: skip
    upper = body("thigh", "pitch", (0, s * leg.aside, 0), "0 1 0", thigh, (-0.003, -0.012 * s, -0.2 * up),
                 thigh * up**2 / 10 * thicker, lower)  # fmt: skip
    first = hip * leg.thigh**2 * np.array([0.02, 0.03, 0.02])
    return body("hip", "roll", (*leg.hip, 0), "1 0 0", hip, (0.0, 0.01 * s, 0.0), first, upper)
