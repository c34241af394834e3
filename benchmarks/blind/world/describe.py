"""A robot in words and numbers, and its translations: MJCF for MuJoCo and the diagnosis, a model for Pinocchio."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

AXES = {"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1)}


@dataclass(frozen=True)
class Link:
    """One body and the hinge that carries it; frames are parallel where all angles are zero.

    `inertia` (3, 3) is about the centre of mass `com`, in the link's axes. `axis` is empty for a floating base and for
    what is welded on; the latter has no `joint` either.
    """

    name: str
    parent: int
    pos: tuple[float, float, float]
    axis: str
    joint: str
    mass: float
    com: np.ndarray
    inertia: np.ndarray
    armature: float = 0.0
    damping: float = 0.0
    friction: float = 0.0
    radius: float = 0.0
    """Of the ball it stands on, about its frame's origin; 0 where it touches nothing."""


@dataclass(frozen=True)
class Machine:
    """A robot with what its motions need: rated torque, range and speed of every joint.

    `straps`: points on the base, from which it hangs; each strap leads straight up.
    """

    name: str
    links: tuple[Link, ...]
    peak: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    speed: np.ndarray
    payload: tuple[float, float]
    force: tuple[float, float]
    height: float = 0.0
    straps: tuple[tuple[float, float, float], ...] = ()
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)

    @property
    def floating(self) -> bool:
        return not self.links[0].axis

    @property
    def moved(self) -> tuple[Link, ...]:
        """The links that a hinge carries."""
        return tuple(link for link in self.links if link.axis)

    @property
    def joints(self) -> tuple[str, ...]:
        return tuple(link.joint for link in self.moved)

    @property
    def feet(self) -> tuple[str, ...]:
        return tuple(link.name for link in self.links if link.radius > 0)

    @property
    def sensed(self) -> tuple[str, ...]:
        """Bodies whose contact wrench is measured."""
        return self.feet or ((self.links[0].name,) if self.straps else ())

    def index(self, body: str) -> int:
        return [link.name for link in self.links].index(body)

    def of_joint(self, joint: str) -> int:
        return [link.joint for link in self.links].index(joint)

    def edited(self, which: int, **changes) -> Machine:
        """This robot with one link changed."""
        links = list(self.links)
        links[which] = replace(links[which], **changes)
        return replace(self, links=tuple(links))

    def array(self, field: str) -> np.ndarray:
        """A number of every hinge, (n)."""
        return np.array([getattr(link, field) for link in self.moved])


def merged(link: Link, mass: float, com: np.ndarray, inertia: np.ndarray) -> dict:
    """Mass, centre and inertia of a link with a rigid piece welded on."""
    total = link.mass + mass
    centre = (link.mass * link.com + mass * np.asarray(com)) / total

    def about(m, c):
        r = np.asarray(c) - centre
        return m * (r @ r * np.eye(3) - np.outer(r, r))

    tensor = link.inertia + about(link.mass, link.com) + inertia + about(mass, com)
    return {"mass": total, "com": centre, "inertia": tensor}


def _numbers(values) -> str:
    return " ".join(f"{x:.9g}" for x in values)


def to_mjcf(machine: Machine, passive: bool = True) -> str:
    """MJCF text; without `passive` no damping and no friction, which the mechanics then bring along."""
    floor = '    <geom name="floor" type="plane" size="5 5 0.1" contype="0" conaffinity="1"/>\n'
    lines = [
        f'<mujoco model="{machine.name}">\n  <compiler angle="radian" autolimits="true"/>\n'
        f'  <option timestep="0.001" integrator="implicitfast" gravity="{_numbers(machine.gravity)}"/>\n'
        '  <default><geom friction="0.9 0.02 0.001" solref="0.006 1" solimp="0.95 0.99 0.001"'
        ' condim="3" contype="0" conaffinity="0" mass="0"/></default>\n  <worldbody>\n'
        + (floor if machine.feet else "")
    ]
    children = {k: [] for k in range(-1, len(machine.links))}
    for k, link in enumerate(machine.links):
        children[link.parent].append(k)

    def write(k: int, pad: str) -> None:
        link = machine.links[k]
        i = link.inertia
        full = (i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2])
        lines.append(f'{pad}<body name="{link.name}" pos="{_numbers(link.pos)}">\n')
        lines.append(
            f'{pad}  <inertial pos="{_numbers(link.com)}" mass="{link.mass:.9g}" '
            f'fullinertia="{_numbers(full)}"/>\n'
        )
        if link.axis:
            rest = (
                f' damping="{link.damping:.9g}" frictionloss="{link.friction:.9g}"'
                if passive
                else ""
            )
            lines.append(
                f'{pad}  <joint name="{link.joint}" type="hinge" axis="{_numbers(AXES[link.axis])}" '
                f'armature="{link.armature:.9g}"{rest}/>\n'
            )
        elif link.joint:
            lines.append(f'{pad}  <freejoint name="{link.joint}"/>\n')
        for child in children[k]:
            end = machine.links[child].pos
            if np.linalg.norm(end) > 0.03:
                lines.append(
                    f'{pad}  <geom type="capsule" size="0.02" fromto="0 0 0 {_numbers(end)}"/>\n'
                )
        if link.radius:
            lines.append(f'{pad}  <geom type="sphere" size="{link.radius}" contype="1"/>\n')
        for child in children[k]:
            write(child, pad + "  ")
        lines.append(f"{pad}</body>\n")

    for root in children[-1]:
        write(root, "    ")
    motors = "".join(f'    <motor name="drive_{j}" joint="{j}"/>\n' for j in machine.joints)
    return "".join(lines) + f"  </worldbody>\n  <actuator>\n{motors}  </actuator>\n</mujoco>\n"


def to_pinocchio(machine: Machine) -> tuple[pin.Model, list[tuple[int, np.ndarray]]]:
    """The rigid bodies, with armature, without damping and friction; joint number and place in it of every link."""
    model = pin.Model()
    kinds = {"x": pin.JointModelRX, "y": pin.JointModelRY, "z": pin.JointModelRZ}
    seats: list[tuple[int, np.ndarray]] = []
    for link in machine.links:
        on, offset = seats[link.parent] if link.parent >= 0 else (0, np.zeros(3))
        # A free joint's position holds the base's own place.
        place = offset + (np.array(link.pos) if link.axis or not link.joint else 0.0)
        if link.joint:
            joint = kinds[link.axis]() if link.axis else pin.JointModelFreeFlyer()
            seats.append(
                (model.addJoint(on, joint, pin.SE3(np.eye(3), place), link.joint), np.zeros(3))
            )
        else:
            seats.append((on, place))
        which, at = seats[-1]
        inertia = pin.Inertia(link.mass, np.asarray(link.com), link.inertia)
        model.appendBodyToJoint(which, inertia, pin.SE3(np.eye(3), at))
    model.gravity = pin.Motion(np.array(machine.gravity), np.zeros(3))
    armature = np.zeros(model.nv)
    armature[model.nv - len(machine.joints) :] = machine.array("armature")
    model.armature = armature
    return model, seats
