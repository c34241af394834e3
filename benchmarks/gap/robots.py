"""Nominal robots of the development generator: two arms and a quadruped, as MJCF.

All figures are our own, chosen to be of the size of common machines; no robot is copied. Frames are
parallel in the zero configuration, lengths in m, masses in kg, angles in rad.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from effects import editable

LEGS = ("FL", "FR", "RL", "RR")
THIGH, SHANK, HIP_Y = 0.23, 0.23, 0.085
HIP_X, HIP_W = 0.21, 0.055


@dataclass(frozen=True)
class Robot:
    """A nominal model with what its motions and its controller need to know.

    `peak` is the rated joint torque (N m); `lower` and `upper` bound the motions (rad), inside the
    joint limits; `payload`, `force` are the ranges of hidden payloads (kg) and forces (N).
    """

    name: str
    xml: str
    joints: tuple[str, ...]
    bodies: tuple[str, ...]
    peak: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    max_speed: np.ndarray
    payload: tuple[float, float]
    force: tuple[float, float]
    feet: tuple[str, ...] = ()
    root: str = ""

    @property
    def floating(self) -> bool:
        return bool(self.feet)

    def model(self) -> mujoco.MjModel:
        return editable(mujoco.MjModel.from_xml_string(self.xml))


def _vec(values) -> str:
    return " ".join(f"{x:.6g}" for x in values)


def _arm_xml(name: str, links: list[dict], base_height: float) -> str:
    """A serial chain of hinges without contacts; each link is nested in the one before it."""
    head = (
        f'<mujoco model="{name}">\n'
        '  <compiler angle="radian" autolimits="true"/>\n'
        '  <option timestep="0.001" integrator="implicitfast" gravity="0 0 -9.81"/>\n'
        '  <default><geom contype="0" conaffinity="0" rgba="0.7 0.7 0.75 1"/></default>\n'
        "  <worldbody>\n"
        '    <light pos="0 0 3"/>\n'
        f'    <body name="base" pos="0 0 {base_height}">\n'
        '      <inertial pos="0 0 -0.05" mass="3" diaginertia="0.02 0.02 0.02"/>\n'
    )
    opening, pad = [], "      "
    for k, link in enumerate(links, start=1):
        opening.append(
            f'{pad}<body name="link{k}" pos="{_vec(link["pos"])}">\n'
            f'{pad}  <inertial pos="{_vec(link["com"])}" mass="{link["mass"]}" '
            f'fullinertia="{_vec(link["inertia"])}"/>\n'
            f'{pad}  <joint name="joint{k}" type="hinge" axis="{_vec(link["axis"])}" '
            f'range="{_vec(link["range"])}" limited="false" armature="{link["armature"]}" '
            f'damping="{link["damping"]}" frictionloss="{link.get("frictionloss", 0)}"/>\n'
            f'{pad}  <geom type="capsule" size="0.04" mass="0" fromto="0 0 0 '
            f'{_vec(link["tip"])}"/>\n'
        )
        pad += "  "
    closing = [f"{'  ' * (k + 2)}</body>\n" for k in range(len(links), 0, -1)]
    actuators = "".join(
        f'    <motor name="motor{k}" joint="joint{k}"/>\n' for k in range(1, len(links) + 1)
    )
    tail = "    </body>\n  </worldbody>\n  <actuator>\n" + actuators + "  </actuator>\n</mujoco>\n"
    return head + "".join(opening) + "".join(closing) + tail


def _link(pos, tip, com, mass, inertia, axis, limits, armature, damping, frictionloss=0.0) -> dict:
    """`inertia` is (Ixx, Iyy, Izz, Ixy, Ixz, Iyz) about the centre of mass, MuJoCo's order."""
    return {
        "pos": pos,
        "tip": tip,
        "com": com,
        "mass": mass,
        "inertia": inertia,
        "axis": axis,
        "range": limits,
        "armature": armature,
        "damping": damping,
        "frictionloss": frictionloss,
    }


def arm7() -> Robot:
    """A seven-joint arm of 18 kg that stands upright at zero, axes z y z y z y z."""
    z, y = (0, 0, 1), (0, 1, 0)
    links = [
        _link((0, 0, 0.14), (0, 0, 0.2), (0.002, -0.024, 0.13), 3.5,
              (0.031, 0.029, 0.0105, 0.0002, -0.0004, 0.0031), z, (-2.8, 2.8), 0.52, 1.1),
        _link((0, 0, 0.20), (0, 0, 0.2), (-0.003, 0.042, 0.085), 3.6,
              (0.030, 0.026, 0.0112, -0.0003, 0.0005, -0.0042), y, (-1.8, 1.8), 0.50, 1.2, 1.1),
        _link((0, 0, 0.20), (0.06, 0, 0.19), (0.026, 0.031, 0.125), 3.1,
              (0.027, 0.025, 0.0098, -0.0011, -0.0021, -0.0018), z, (-2.8, 2.8), 0.41, 0.85),
        _link((0.06, 0, 0.19), (-0.06, 0, 0.18), (-0.031, 0.034, 0.072), 2.8,
              (0.020, 0.018, 0.0089, 0.0012, 0.0016, -0.0017), y, (-2.8, 0.2), 0.40, 0.8),
        _link((-0.06, 0, 0.18), (0, 0, 0.2), (0.001, 0.036, 0.118), 2.5,
              (0.024, 0.022, 0.0057, 0.0, 0.0002, -0.0041), z, (-2.8, 2.8), 0.15, 0.32, 0.30),
        _link((0, 0, 0.20), (0.08, 0, 0), (0.048, -0.012, 0.008), 1.5,
              (0.0032, 0.0052, 0.0056, 0.0004, -0.0002, 0.0001), y, (-1.7, 2.6), 0.13, 0.28),
        _link((0.08, 0, 0.02), (0, 0, 0.12), (0.017, 0.009, 0.092), 1.1,
              (0.0049, 0.0051, 0.0021, 0.0001, 0.0003, 0.0002), z, (-2.8, 2.8), 0.10, 0.22),
    ]  # fmt: skip
    return Robot(
        name="arm7",
        xml=_arm_xml("arm7", links, 0.2),
        joints=tuple(f"joint{k}" for k in range(1, 8)),
        bodies=tuple(f"link{k}" for k in range(1, 8)),
        peak=np.array([87.0, 87, 87, 87, 12, 12, 12]),
        lower=np.array([-1.7, -0.9, -1.7, -2.3, -1.7, -1.0, -1.9]),
        upper=np.array([1.7, 1.4, 1.7, -0.2, 1.7, 1.9, 1.9]),
        max_speed=np.array([1.9, 1.6, 1.9, 1.9, 2.4, 2.4, 2.6]),
        payload=(0.1, 3.0),
        force=(5.0, 50.0),
    )


def arm2() -> Robot:
    """Two links in a vertical plane, hanging at zero."""
    y = (0, 1, 0)
    links = [
        _link((0, 0, 0), (0, 0, -0.42), (0.004, 0.01, -0.19), 3.1,
              (0.046, 0.047, 0.0041, 0.0, 0.0004, 0.0005), y, (-3.1, 3.1), 0.075, 0.24),
        _link((0, 0.06, -0.42), (0, 0, -0.36), (-0.006, 0.004, -0.15), 1.7,
              (0.019, 0.0195, 0.0017, 0.0, -0.0003, 0.0001), y, (-3.1, 3.1), 0.031, 0.11, 0.14),
    ]  # fmt: skip
    return Robot(
        name="arm2",
        xml=_arm_xml("arm2", links, 1.0),
        joints=("joint1", "joint2"),
        bodies=("link1", "link2"),
        peak=np.array([40.0, 18.0]),
        lower=np.array([-1.8, -2.0]),
        upper=np.array([1.8, 2.0]),
        max_speed=np.array([3.2, 4.0]),
        payload=(0.05, 1.0),
        force=(3.0, 25.0),
    )


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


ROBOTS = {"arm7": arm7, "arm2": arm2, "quadruped": quadruped}
