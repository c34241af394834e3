"""A seven-joint arm of 18 kg as MJCF. Figures of our own, of the size usual for such arms; no product is meant."""

import xml.etree.ElementTree as ET
from typing import NamedTuple

from jax_inertia.robots.mjcf_elements import element

HAND = "hand"
"""The last body, which carries the load."""


class _Link(NamedTuple):
    name: str
    position: tuple[float, float, float]  # of its frame in the link before [m]
    axis: tuple[int, int, int]
    mass: float  # kg
    com: tuple[float, float, float]  # m
    inertia: tuple[
        float, float, float, float, float, float
    ]  # xx yy zz xy xz yz about the CoM [kg m²]
    armature: float  # rotor inertia seen at the joint [kg m²]
    damping: float  # N m s/rad
    torque: float  # most that the motor gives [N m]


_Z, _Y = (0, 0, 1), (0, 1, 0)
_LINKS = (
    _Link("shoulder", (0.0, 0.0, 0.2), _Z, 4.2, (0.0, 0.02, 0.06),
          (0.022, 0.02, 0.014, 0.0, 0.0, -0.002), 0.12, 1.2, 180.0),
    _Link("upper_arm", (0.0, 0.0, 0.14), _Y, 3.8, (0.0, -0.03, 0.11),
          (0.03, 0.028, 0.011, 0.0, 0.001, 0.003), 0.12, 1.2, 180.0),
    _Link("upper_roll", (0.0, 0.0, 0.22), _Z, 2.9, (0.02, 0.01, 0.1),
          (0.019, 0.02, 0.008, 0.0004, -0.002, 0.0), 0.09, 0.8, 120.0),
    _Link("forearm", (0.04, 0.0, 0.2), _Y, 2.6, (-0.02, 0.02, 0.08),
          (0.015, 0.014, 0.007, -0.0005, 0.001, -0.001), 0.09, 0.8, 120.0),
    _Link("forearm_roll", (-0.04, 0.0, 0.2), _Z, 1.9, (0.0, 0.03, 0.07),
          (0.011, 0.009, 0.005, 0.0, 0.0, -0.001), 0.05, 0.4, 60.0),
    _Link("wrist", (0.0, 0.0, 0.19), _Y, 1.5, (0.03, 0.0, 0.02),
          (0.0028, 0.0042, 0.004, 0.0002, -0.0003, 0.0), 0.05, 0.4, 60.0),
    _Link(HAND, (0.06, 0.0, 0.09), _Z, 1.1, (0.01, 0.0, 0.06),
          (0.0026, 0.0022, 0.0014, 0.0, -0.0001, 0.0), 0.03, 0.2, 30.0),
)  # fmt: skip


def arm_mjcf() -> str:
    """MJCF text of the arm: bodies shoulder to hand, joints joint1 to joint7, one motor each, nothing collides."""
    root = ET.Element("mujoco", model="arm")
    element(root, "compiler", angle="radian", autolimits="true")
    option = element(root, "option", timestep=0.0005, integrator="RK4")
    element(option, "flag", contact="disable")
    world = element(root, "worldbody")
    element(world, "light", pos=(0.0, -1.0, 2.5), dir=(0.0, 0.4, -1.0))
    body = element(world, "body", name="base")
    element(body, "geom", type="cylinder", fromto=(0, 0, 0, 0, 0, 0.14), size=0.08)
    actuator = element(root, "actuator")
    for i, link in enumerate(_LINKS, start=1):
        if i > 1:
            # What is drawn, not what is weighed: every inertial is explicit.
            ends = (0.0, 0.0, 0.0, *link.position)
            element(body, "geom", type="capsule", fromto=ends, size=0.05, mass=0)
        body = element(body, "body", name=link.name, pos=link.position)
        element(body, "inertial", pos=link.com, mass=link.mass, fullinertia=link.inertia)
        joint = f"joint{i}"
        element(
            body, "joint", name=joint, axis=link.axis, armature=link.armature, damping=link.damping
        )
        limit = (-link.torque, link.torque)
        element(actuator, "motor", name=f"motor{i}", joint=joint, ctrlrange=limit)
    element(body, "geom", type="box", size=(0.05, 0.04, 0.05), pos=(0.0, 0.0, 0.06), mass=0)
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"
