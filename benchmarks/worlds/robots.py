"""Arms of 2, 3, 6 and 7 joints and a leg that hangs from a stand, as MJCF, and what a robot of these worlds states.

All figures are our own, of the size of common machines; no robot is copied. Frames are parallel in the zero
configuration; lengths in m, masses in kg, angles in rad, torques in N m.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np

from benchmarks.worlds.effects import editable


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
