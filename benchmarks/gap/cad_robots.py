"""Nominal robots "as they are bought": bodies from the drawing, no friction and no rotor inertia at any joint.

Four arms of 2, 3, 6 and 7 joints and a leg that hangs from a stand. All figures are our own, of the size of common
machines. Lengths in m, masses in kg, angles in rad, torques in N m.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable

import numpy as np
from robots import Robot, _arm_xml, _link, arm2, arm7

X, Y, Z = (1, 0, 0), (0, 1, 0), (0, 0, 1)


def bare(robot: Robot) -> Robot:
    """The same robot without damping, friction loss or armature."""
    xml = re.sub(r'(armature|damping|frictionloss)="[^"]*"', r'\1="0"', robot.xml)
    return dataclasses.replace(robot, xml=xml)


def _robot(name: str, links: list[dict], height: float, **numbers) -> Robot:
    count = range(1, len(links) + 1)
    return Robot(
        name=name,
        xml=_arm_xml(name, links, height),
        joints=tuple(f"joint{k}" for k in count),
        bodies=tuple(f"link{k}" for k in count),
        **{k: np.array(v) if isinstance(v, list) else v for k, v in numbers.items()},
    )


def arm3() -> Robot:
    """Base turn, shoulder and elbow, upright at zero: 12 kg."""
    links = [
        _link((0, 0, 0.11), (0, 0, 0.16), (0.006, -0.011, 0.09), 4.2,
              (0.024, 0.022, 0.013, 0.0003, -0.0006, 0.0011), Z, (-2.9, 2.9), 0, 0),
        _link((0, 0.07, 0.16), (0, 0, 0.38), (0.004, 0.028, 0.17), 4.6,
              (0.071, 0.069, 0.0098, -0.0002, 0.0012, -0.0031), Y, (-2.0, 2.0), 0, 0),
        _link((0, -0.02, 0.38), (0.31, 0, 0.03), (0.136, -0.009, 0.021), 2.7,
              (0.0042, 0.0288, 0.0281, 0.0006, -0.0017, 0.0001), Y, (-2.4, 2.4), 0, 0),
    ]  # fmt: skip
    return _robot(
        "arm3", links, 0.3,
        peak=[70.0, 85.0, 36.0], lower=[-1.8, -1.0, -1.5], upper=[1.8, 1.2, 1.6],
        max_speed=[2.4, 2.2, 3.0], payload=(0.1, 3.0), force=(5.0, 60.0),
    )  # fmt: skip


def arm6() -> Robot:
    """Six joints, three of them parallel, offset wrist, upright at zero: 21 kg."""
    links = [
        _link((0, 0, 0.10), (0, 0, 0.08), (0.001, 0.018, 0.012), 4.4,
              (0.0165, 0.0148, 0.0131, 0.0001, 0.0003, -0.0012), Z, (-3.0, 3.0), 0, 0),
        _link((0, 0.11, 0.06), (0, 0, 0.46), (0.002, 0.037, 0.21), 7.3,
              (0.181, 0.176, 0.021, -0.0006, 0.0024, -0.0101), Y, (-2.2, 2.2), 0, 0),
        _link((0, -0.05, 0.46), (0, 0, 0.43), (-0.003, 0.012, 0.19), 4.1,
              (0.088, 0.087, 0.0072, 0.0003, -0.0014, 0.0021), Y, (-2.6, 2.6), 0, 0),
        _link((0, 0.03, 0.43), (0, 0.10, 0), (0.0005, 0.061, -0.004), 1.9,
              (0.0041, 0.0029, 0.0038, 0.0, 0.0001, 0.0002), Y, (-3.0, 3.0), 0, 0),
        _link((0, 0.10, 0), (0, 0, 0.10), (-0.001, 0.006, 0.058), 1.8,
              (0.0039, 0.0037, 0.0028, 0.0001, -0.0001, -0.0003), Z, (-3.0, 3.0), 0, 0),
        _link((0, 0, 0.10), (0, 0.11, 0), (0.014, 0.067, 0.009), 0.9,
              (0.0019, 0.0012, 0.0020, -0.0002, 0.0001, 0.0001), Y, (-3.0, 3.0), 0, 0),
    ]  # fmt: skip
    return _robot(
        "arm6", links, 0.1,
        peak=[150.0, 160.0, 110.0, 30.0, 28.0, 24.0],
        lower=[-1.8, -1.1, -1.6, -1.9, -1.8, -1.9], upper=[1.8, 1.2, 1.7, 1.9, 1.8, 1.9],
        max_speed=[1.9, 1.6, 2.0, 2.8, 2.8, 3.0], payload=(0.1, 3.0), force=(5.0, 60.0),
    )  # fmt: skip


def leg3() -> Robot:
    """A leg on a stand, foot in the air: abduction, hip and knee, hanging at zero, 7 kg."""
    links = [
        _link((0, 0, 0), (0, 0.08, 0), (-0.009, 0.031, 0.002), 1.3,
              (0.0018, 0.0025, 0.0021, 0.0001, 0.0, -0.0001), X, (-0.9, 0.9), 0, 0),
        _link((0, 0.08, 0), (0, 0, -0.30), (-0.006, -0.022, -0.071), 3.9,
              (0.0372, 0.0361, 0.0089, -0.0004, 0.0011, 0.0022), Y, (-1.6, 2.6), 0, 0),
        _link((0, 0.01, -0.30), (0, 0, -0.30), (0.011, 0.002, -0.134), 1.4,
              (0.0139, 0.0141, 0.0011, 0.0, -0.0006, 0.0001), Y, (-2.7, 0.1), 0, 0),
    ]  # fmt: skip
    robot = _robot(
        "leg3", links, 1.0,
        peak=[40.0, 45.0, 50.0], lower=[-0.6, -0.8, -2.3], upper=[0.6, 1.2, -0.2],
        max_speed=[4.0, 6.0, 7.0], payload=(0.1, 1.5), force=(5.0, 40.0),
    )  # fmt: skip
    names = {"joint1": "abduction", "joint2": "hip", "joint3": "knee",
             "link1": "hip_block", "link2": "thigh", "link3": "shank"}  # fmt: skip
    xml = robot.xml
    for old, new in names.items():
        xml = xml.replace(f'"{old}"', f'"{new}"')
    return dataclasses.replace(
        robot,
        xml=xml,
        joints=tuple(names[x] for x in robot.joints),
        bodies=tuple(names[x] for x in robot.bodies),
    )


CAD_ROBOTS: dict[str, Callable[[], Robot]] = {
    "arm2": lambda: bare(arm2()),
    "arm3": arm3,
    "arm6": arm6,
    "arm7": lambda: bare(arm7()),
    "leg3": leg3,
}
