"""A quadruped whose torques and contact wrenches are logged, and its exercises: the trunk's pose and which feet stand.

All figures are our own, of the size of common machines. Lengths in m, masses in kg, angles in rad.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from benchmarks.worlds.robots import Robot

LEGS = ("FL", "FR", "RL", "RR")
THIGH, SHANK, HIP_Y = 0.23, 0.23, 0.085
HIP_X, HIP_W = 0.21, 0.055
STAND_HEIGHT = 0.36


def _leg_xml(leg: str) -> str:
    front, left = (1 if leg[0] == "F" else -1), (1 if leg[1] == "L" else -1)
    return f"""
      <body name="{leg}_hip" pos="{front * HIP_X} {left * HIP_W} 0">
        <inertial pos="{front * -0.004} {left * 0.012} 0.001" mass="0.68" diaginertia="0.0006 0.0011 0.0009"/>
        <joint name="{leg}_abduction" axis="1 0 0" armature="0.011" damping="0.06"/>
        <body name="{leg}_thigh" pos="0 {left * HIP_Y} 0">
          <inertial pos="-0.005 {left * -0.018} -0.045" mass="1.15" diaginertia="0.0066 0.0064 0.0015"/>
          <joint name="{leg}_hip_pitch" axis="0 1 0" armature="0.011" damping="0.06"/>
          <geom type="capsule" size="0.02" fromto="0 0 0 0 0 {-THIGH}" mass="0" contype="0" conaffinity="0"/>
          <body name="{leg}_shank" pos="0 0 {-THIGH}">
            <inertial pos="0.004 0 -0.098" mass="0.26" diaginertia="0.0019 0.0019 0.00008"/>
            <joint name="{leg}_knee" axis="0 1 0" armature="0.019" damping="0.08" frictionloss="0.12"/>
            <geom type="capsule" size="0.012" fromto="0 0 0 0 0 {-SHANK}" mass="0" contype="0" conaffinity="0"/>
            <body name="{leg}_foot" pos="0 0 {-SHANK}">
              <inertial pos="0 0 0" mass="0.07" diaginertia="0.00002 0.00002 0.00002"/>
              <geom name="{leg}_sole" type="sphere" size="0.022" mass="0" contype="1" conaffinity="0"/>
            </body>
          </body>
        </body>
      </body>"""


def quadruped() -> Robot:
    """Twelve joints on a floating trunk, 17 kg, ball feet on a flat floor."""
    joints = [f"{leg}_{part}" for leg in LEGS for part in ("abduction", "hip_pitch", "knee")]
    motors = "".join(f'    <motor name="m_{j}" joint="{j}"/>\n' for j in joints)
    xml = f"""<mujoco model="quadruped">
  <compiler angle="radian" autolimits="true"/>
  <option timestep="0.001" integrator="implicitfast" gravity="0 0 -9.81"/>
  <default><geom friction="0.9 0.02 0.001" solref="0.006 1" solimp="0.95 0.99 0.001" condim="3"/></default>
  <worldbody>
    <light pos="0 0 3"/>
    <geom name="floor" type="plane" size="5 5 0.1" contype="0" conaffinity="1"/>
    <body name="trunk" pos="0 0 0.36">
      <freejoint name="root"/>
      <inertial pos="0.009 0.002 0.006" mass="8.4" fullinertia="0.041 0.128 0.151 0.0004 -0.0018 0.0003"/>
      <geom type="box" size="0.22 0.09 0.05" mass="0" contype="0" conaffinity="0"/>{"".join(map(_leg_xml, LEGS))}
    </body>
  </worldbody>
  <actuator>
{motors}  </actuator>
</mujoco>
"""
    parts = ("hip", "thigh", "shank")
    return Robot(
        name="quadruped",
        xml=xml,
        joints=tuple(joints),
        bodies=("trunk", *(f"{leg}_{p}" for leg in LEGS for p in parts)),
        peak=np.tile([24.0, 24.0, 36.0], 4),
        lower=np.tile([-0.8, -0.5, -2.6], 4),
        upper=np.tile([0.8, 2.5, -0.6], 4),
        max_speed=np.full(12, 12.0),
        payload=(0.4, 4.0),
        force=(8.0, 60.0),
        feet=tuple(f"{leg}_foot" for leg in LEGS),
        root="trunk",
    )


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
