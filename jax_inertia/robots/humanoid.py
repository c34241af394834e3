"""The humanoid of the paper (Nadia) as MJCF: 23 joints, floating base, spheres under the feet.

Each foot touches the ground with four small spheres, one under each corner of the sole, by explicit
contact pairs. All other geoms are for pictures and touch nothing. A sphere on a plane is a contact
that MuJoCo C and MJX treat alike, so both simulate the same robot. The ground is one flat floor,
or, for terrain, one plane per corner: a mocap body whose height is set before every step to that of
the terrain under the corner. Its limits: normals are vertical and toes do not stub.
"""

import math
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

from jax_inertia.robots.humanoid_looks import draw, lights, scenery
from jax_inertia.robots.mjcf_elements import element
from jax_inertia.robots.nadia_figures import (
    DAMPING,
    JOINTS,
    ROOT,
    SOLE_DEPTH,
    SOLE_HALF_WIDTH,
    SOLE_X,
    Vector,
    effort_limit,
    links,
)


def _require(holds: bool, name: str, value: object, wanted: str) -> None:
    if not holds:
        raise ValueError(f"HumanoidOptions: {name} is {value}; it must be {wanted}")


class Terrain(Enum):
    """The ground: one floor at z = 0, or one mocap plane per foot corner.

    The planes are bodies `terrain_<corner>`; mocap id = index in `CORNERS`, height = `mocap_pos[id,
    2]`.
    """

    FLAT = "flat"
    CORNER_PLANES = "corner planes"


class Corner(NamedTuple):
    """A foot corner: name of its geom and pair, link, contact point in the link's frame (m)."""

    name: str
    link: str
    pos: Vector


CORNERS: tuple[Corner, ...] = tuple(
    Corner(f"{side}_{end}_{edge}", f"{side}_foot_link", (x, sign * SOLE_HALF_WIDTH, -SOLE_DEPTH))
    for side in ("left", "right")
    for end, x in zip(("heel", "toe"), SOLE_X, strict=True)
    for edge, sign in (("right", -1), ("left", 1))
)


@dataclass(frozen=True)
class Armature:
    """Reflected rotor inertia per joint, in kg m²: unpublished, small values of our own."""

    leg: float = 0.05
    spine: float = 0.05
    arm: float = 0.02

    def of(self, joint: str) -> float:
        """Armature of the joint of that name."""
        if joint.startswith("spine"):
            return self.spine
        return self.arm if "shoulder" in joint or "elbow" in joint else self.leg


@dataclass(frozen=True)
class HumanoidOptions:
    """What may be chosen about the humanoid's model.

    Raises `ValueError` where a number is out of its range.
    """

    terrain: Terrain = Terrain.FLAT
    timestep: float = 0.0015  # s
    solver_iterations: int = (
        4  # Newton; enough for these eight contacts, and what bounds MJX's time
    )
    line_search_iterations: int = 6
    friction: float = 0.8  # sliding coefficient of every corner
    solref: tuple[float, float] = (0.006, 1.0)  # contact time constant in s, damping ratio
    corner_radius: float = 0.01  # m
    armature: Armature = Armature()
    load_cells: bool = False  # sensors <side>_foot_force, <side>_foot_torque at the soles' sites
    corner_forces: bool = False  # sensors <corner>_force: see `humanoid_mjcf`
    corner_positions: bool = False  # sensors <corner>_position: centre of the corner's sphere (m)
    visual: bool = True  # shapes, lights and textures; leave out where only speed counts

    def __post_init__(self) -> None:
        _require(self.timestep > 0, "timestep", self.timestep, "more than 0 s")
        _require(self.solver_iterations >= 1, "solver_iterations", self.solver_iterations, "≥ 1")
        line_search = self.line_search_iterations
        _require(line_search >= 1, "line_search_iterations", line_search, "≥ 1")
        _require(self.friction > 0, "friction", self.friction, "more than 0")
        _require(0 < self.corner_radius <= 0.05, "corner_radius", self.corner_radius, "0 to 0.05 m")
        # MuJoCo raises a shorter time constant to this bound without a word.
        _require(
            self.solref[0] >= 2 * self.timestep, "solref", self.solref, "at least twice timestep"
        )
        smallest = min(self.armature.leg, self.armature.spine, self.armature.arm)
        _require(smallest >= 0, "armature", self.armature, "≥ 0 kg m²")


# rad; joints that are not named are at 0. Hip, knee and ankle pitch sum to 0, so that the soles lie
# flat, and bring the centre of mass over the soles' centres to within 1 cm.
_HOME = {
    "hip_y": -0.26,
    "knee_y": 0.5,
    "ankle_y": -0.24,
    "shoulder_x": 0.15,
    "shoulder_z": 0.7,
    "elbow_y": -0.7,
}
_MIRRORED = ("_x", "_z")  # joints about these axes turn the other way on the right side


def home_pose() -> dict[str, float]:
    """Joint angles (rad) of keyframe `home`: knees slightly bent, soles flat, forearms forward."""
    pose = {}
    for name in JOINTS:
        angle = _HOME.get(name.removeprefix("left_").removeprefix("right_"), 0.0)
        flip = name.startswith("right_") and name.endswith(_MIRRORED)
        pose[name] = -angle if flip else angle
    return pose


def humanoid_mjcf(options: HumanoidOptions = HumanoidOptions()) -> str:
    """MJCF text of the humanoid: nq 30, nv 29, nu 23, 90.898 kg, keyframe `home` standing at z = 0.

    The free joint is `floating_base` on `pelvis_link`; links and joints are named as in the source
    (`nadia_figures`). Each joint has a motor of its name: control = torque in N m, within the
    joint's effort limit. Sites `left_sole` and `right_sole` lie at the soles' centres, axes as the
    feet's.

    Sensors, where asked for. `<side>_foot_force` and `<side>_foot_torque` (N, N m; sole's site, its
    axes) are what the ankle exerts on the foot, as a load cell between them would read: standing,
    minus the ground's force less the foot's weight. `<corner>_force` (N) is the ground's force on
    the corner in the contact's axes (z, y, −x of the world): in MJX the public way to contact
    forces.
    """
    root = ET.Element("mujoco", model="nadia")
    element(root, "compiler", angle="radian", eulerseq="XYZ", autolimits="true")
    # Nothing touches but the pairs named below.
    element(element(root, "default"), "geom", contype=0, conaffinity=0)
    option = element(
        root,
        "option",
        timestep=options.timestep,
        cone="pyramidal",
        impratio=1,
        solver="Newton",
        iterations=options.solver_iterations,
        ls_iterations=options.line_search_iterations,
        jacobian="dense",
    )
    # With implicit damping Δv/Δt would not be the acceleration of the equation of motion.
    element(option, "flag", eulerdamp="disable")
    if options.visual:
        scenery(root)
    world = element(root, "worldbody")
    if options.visual:
        lights(world)
    height, soles = _home_placement()
    _ground(world, options, soles)
    _tree(world, options, height)
    _contacts(root, options)
    actuators = element(root, "actuator")
    for name in JOINTS:
        limit = effort_limit(name)
        element(actuators, "motor", name=name, joint=name, ctrlrange=(-limit, limit))
    _sensors(root, options)
    keyframes = element(root, "keyframe")
    qpos = (0.0, 0.0, height, 1.0, 0.0, 0.0, 0.0, *home_pose().values())
    element(keyframes, "key", name="home", qpos=qpos)
    ET.indent(root)
    return ET.tostring(root, encoding="unicode")


def _home_placement() -> tuple[float, dict[str, Vector]]:
    """Height of the pelvis in the home pose, and the ground point under each corner."""
    pose = home_pose()
    feet: dict[str, Vector] = {}
    for side in ("left", "right"):
        x = y = z = pitch = 0.0
        for name, joint in JOINTS.items():
            if not name.startswith((f"{side}_hip", f"{side}_knee", f"{side}_ankle")):
                continue
            c, s = math.cos(pitch), math.sin(pitch)
            dx, dy, dz = joint.pos
            x, y, z = x + c * dx + s * dz, y + dy, z - s * dx + c * dz
            if name.endswith("_y"):
                pitch += pose[name]
        feet[f"{side}_foot_link"] = (x, y, z)
    height = SOLE_DEPTH - feet["left_foot_link"][2]
    ground = {}
    for corner in CORNERS:
        x, y, _ = feet[corner.link]
        ground[corner.name] = (x + corner.pos[0], y + corner.pos[1], 0.0)
    return height, ground


def _ground(world: ET.Element, options: HumanoidOptions, under: dict[str, Vector]) -> None:
    material = {"material": "floor"} if options.visual else {}
    if options.terrain is Terrain.FLAT:
        element(world, "geom", name="floor", type="plane", size=(0, 0, 0.05), **material)
        return
    for corner in CORNERS:
        name = f"terrain_{corner.name}"
        body = element(world, "body", name=name, mocap="true", pos=under[corner.name])
        # The size is what is drawn; the plane that the sphere meets has no edge.
        tile = (0.03, 0.03, 0.01)
        element(body, "geom", name=name, type="plane", size=tile, **material)


def _tree(world: ET.Element, options: HumanoidOptions, height: float) -> None:
    figures = links()
    bodies = {ROOT: element(world, "body", name=ROOT, pos=(0, 0, height))}
    element(bodies[ROOT], "freejoint", name="floating_base")
    for name, joint in JOINTS.items():
        parent = bodies[joint.parent]
        body = element(parent, "body", name=joint.child, pos=joint.pos, euler=joint.rpy)
        element(
            body,
            "joint",
            name=name,
            axis=joint.axis,
            range=joint.range,
            damping=DAMPING,
            armature=options.armature.of(name),
        )
        bodies[joint.child] = body
    for name, body in bodies.items():
        link = figures[name]
        ixx, ixy, ixz, iyy, iyz, izz = link.inertia
        inertia = (ixx, iyy, izz, ixy, ixz, iyz)  # MJCF's order
        element(body, "inertial", pos=link.com, mass=link.mass, fullinertia=inertia)
        if options.visual:
            draw(body, name)
    for corner in CORNERS:
        x, y, z = corner.pos
        centre = (x, y, z + options.corner_radius)
        element(
            bodies[corner.link],
            "geom",
            name=corner.name,
            size=options.corner_radius,
            pos=centre,
            group=3,
        )
    for side in ("left", "right"):
        centre = (sum(SOLE_X) / 2, 0.0, -SOLE_DEPTH)
        element(bodies[f"{side}_foot_link"], "site", name=f"{side}_sole", pos=centre, size=0.005)


def _contacts(root: ET.Element, options: HumanoidOptions) -> None:
    contact = element(root, "contact")
    for corner in CORNERS:
        element(
            contact,
            "pair",
            name=corner.name,
            geom1=_ground_geom(corner, options),
            geom2=corner.name,
            condim=3,
            friction=(options.friction, options.friction, 0.005, 0.0001, 0.0001),
            solref=options.solref,
        )


def _sensors(root: ET.Element, options: HumanoidOptions) -> None:
    sensor = element(root, "sensor")
    if options.load_cells:
        for side in ("left", "right"):
            element(sensor, "force", name=f"{side}_foot_force", site=f"{side}_sole")
            element(sensor, "torque", name=f"{side}_foot_torque", site=f"{side}_sole")
    if options.corner_forces:
        for corner in CORNERS:
            element(
                sensor,
                "contact",
                name=f"{corner.name}_force",
                geom1=_ground_geom(corner, options),
                geom2=corner.name,
                data="force",
                reduce="mindist",  # without it MJX 3.17 gives every sensor its first contact
            )
    if options.corner_positions:
        for corner in CORNERS:
            name = f"{corner.name}_position"
            element(sensor, "framepos", name=name, objtype="geom", objname=corner.name)


def _ground_geom(corner: Corner, options: HumanoidOptions) -> str:
    return "floor" if options.terrain is Terrain.FLAT else f"terrain_{corner.name}"
