"""URDFs as they ship, in words that MuJoCo takes: its reader is stricter than those that robots' makers test with.

urdfdom, which ROS, Pinocchio and Drake read with, takes the first of elements that are there twice and does not look at
materials. MuJoCo refuses both, and lets a floating joint hang on the world alone. The text is edited in place, and
what is taken out is made blank, so that line numbers in messages stay true.
"""

import html
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from jax_inertia.model.file_safety import Tag, tags
from jax_inertia.text.closest_names import listed

# A root link of this name is the world itself: a robot that says so is fixed to it.
WORLD = "world"

# What an element holds once. Of shapes the first counts, whichever it is.
_ONCE = {
    "link": ("inertial",),
    "inertial": ("origin", "mass", "inertia"),
    "visual": ("origin", "geometry"),
    "collision": ("origin", "geometry"),
    "joint": ("origin", "parent", "child", "axis", "limit", "dynamics", "mimic", "calibration"),
}
_SHAPES = ("box", "cylinder", "sphere", "mesh", "capsule")
_SEEN = ("visual", "collision")

_Edit = tuple[int, int, str]
"""First letter, one past the last, and what is put there."""


@dataclass(slots=True)
class Element:
    """One element of the text: its first tag, where it ends, and what it stands in."""

    tag: Tag
    end: int
    up: "Element | None"
    part: "Element | None"
    """The robot's link or joint that it belongs to, itself where it is one."""
    seen: bool
    """Whether it is, or belongs to, a shape."""
    first: dict[str, "Element"] = field(default_factory=dict)
    """The first of each kind of element in it."""

    @property
    def name(self) -> str:
        return self.tag.name

    @property
    def parent(self) -> str:
        """Name of the element that it stands in."""
        return "" if self.up is None else self.up.name

    @property
    def called(self) -> str:
        return self.tag.attributes.get("name", "")


def elements(text: str) -> list[Element]:
    """The elements of a text, each after what it stands in; what is not closed ends with the text."""
    found: list[Element] = []
    stack: list[Element] = []
    for tag in tags(text):
        if tag.closes:
            if stack and stack[-1].name == tag.name:
                stack.pop().end = tag.end
            continue
        up = stack[-1] if stack else None
        one = Element(tag, tag.end if tag.empty else len(text), up, None, tag.name in _SEEN)
        if up is not None:
            one.part, one.seen = up.part, up.seen or one.seen
            up.first.setdefault(one.name, one)
            if one.name in ("link", "joint") and up.name == "robot" and up.up is None:
                one.part = one
        found.append(one)
        if not tag.empty:
            stack.append(one)
    return found


def for_mujoco(text: str) -> tuple[str, list[str]]:
    """A URDF's text as MuJoCo's reader takes it, with the same dynamics; and a line for each thing read otherwise.

    Materials and what is only seen are left out: neither has mass. Of an element that stands repeated where URDF has
    one, the first is read. An inertial without inertia is a point mass. A joint that floats below links that are fixed
    to the root hangs on the world instead.
    """
    found = elements(text)
    if not found or found[0].name != "robot":
        return text, []
    repeated, twice = _repeated(found)
    points = [e for e in found if e.name == "inertial" and _of_part(e) and "inertia" not in e.first]
    zeros = "".join(f' {ij}="0"' for ij in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"))
    points = [e for e in points if not e.tag.empty]
    filled = [(e.tag.end, e.tag.end, f"<inertia{zeros}/>") for e in points]
    out = _edited(
        text, [*_unseen(found), *_names(found), *repeated, *filled, *_afloat(text, found)]
    )
    told = {
        "stands repeated, and the first is read": twice,
        "an inertial without inertia is read as a point mass": [_owner(e) for e in points],
    }
    return out, [f"{what}: {listed(names, 20)}" for what, names in told.items() if names]


def part_at(text: str, line: int) -> str:
    """The link or joint of a URDF in which a line stands, counted from 1; nothing where it stands in none."""
    at = -1
    for _ in range(line - 1):
        at = text.find("\n", at + 1)
        if at < 0:
            return ""
    end = text.find("\n", at + 1)
    end = len(text) if end < 0 else end
    inside = [e for e in elements(text) if e.part is e and e.tag.start < end and e.end > at + 1]
    return _owner(inside[-1]) if inside else ""


def _owner(e: Element) -> str:
    """The link or joint that an element belongs to, as it is called in messages."""
    return "" if e.part is None else f"{e.part.name} {e.part.called!r}"


def _of_part(e: Element) -> bool:
    """Whether an element stands right in a link or joint of the robot."""
    return e.part is not None and e.up is e.part


def _edited(text: str, edits: list[_Edit]) -> str:
    """The text with spans replaced; lines stay where they were. Of overlapping spans the first counts."""
    out, at = [], 0
    for start, end, new in sorted(edits, key=lambda edit: (edit[0], -edit[1])):
        if start < at:
            continue
        out += [text[at:start], new, "\n" * (text.count("\n", start, end) - new.count("\n"))]
        at = end
    return "".join([*out, text[at:]])


def _unseen(found: list[Element]) -> Iterator[_Edit]:
    """Materials; and what is only seen, unless the file asks MuJoCo to keep it."""
    keep = any(
        e.name == "compiler" and e.tag.attributes.get("discardvisual") == "false" for e in found
    )
    for e in found:
        seen = e.name == "visual" and _of_part(e) and not keep
        if seen or (e.name == "material" and e.parent in ("robot", *_SEEN)):
            yield e.tag.start, e.end, ""


def _names(found: list[Element]) -> Iterator[_Edit]:
    """Names of shapes that another has already: MuJoCo says so on the standard output."""
    taken = set()
    for e in found:
        if e.name in _SEEN and e.called:
            if e.called in taken:
                yield e.tag.start, e.tag.end, f"<{e.name}{'/' * e.tag.empty}>"
            taken.add(e.called)


def _repeated(found: list[Element]) -> tuple[list[_Edit], list[str]]:
    """Elements that are not the first of their kind, and what they say of dynamics, by owner."""
    edits, twice = [], []
    shapes: set[int] = set()
    for e in found:
        if e.part is None or e.up is None or e is e.part:
            continue
        if e.parent == "geometry" and e.name in _SHAPES:
            again = e.up.tag.start in shapes
            shapes.add(e.up.tag.start)
        else:
            again = e.name in _ONCE.get(e.parent, ()) and e.up.first[e.name] is not e
        if not again:
            continue
        edits.append((e.tag.start, e.end, ""))
        if not e.seen:
            twice.append(f"{e.name} of {_owner(e)}")
    return edits, twice


class _Joint(NamedTuple):
    kind: str
    parent: Element
    child: str
    origin: Element | None
    pose: np.ndarray

    @property
    def below(self) -> str:
        """The link that it hangs on."""
        return self.parent.tag.attributes.get("link", "")


def _joints(found: list[Element]) -> Iterator[_Joint]:
    """The robot's joints that have a parent, a child and a pose that can be read."""
    for e in found:
        if e.name != "joint" or e.part is not e or not {"parent", "child"} <= e.first.keys():
            continue
        origin = e.first.get("origin")
        pose = _pose({} if origin is None else origin.tag.attributes)
        if pose is not None:
            child = e.first["child"].tag.attributes.get("link", "")
            kind = e.tag.attributes.get("type", "")
            yield _Joint(kind, e.first["parent"], child, origin, pose)


def _afloat(text: str, found: list[Element]) -> list[_Edit]:
    """Floating joints below links that are fixed to the root, hung on the world where these links hold them."""
    joints = list(_joints(found))
    if not any(joint.kind == "floating" for joint in joints):
        return []
    links = [e.called for e in found if e.name == "link" and e.part is e]
    above = {joint.child: joint for joint in joints}
    root = next((name for name in links if name not in above), "")
    if WORLD in links and root != WORLD:
        return []
    edits: list[_Edit] = []
    for joint in joints:
        if joint.kind != "floating":
            continue
        link, pose, hops = joint.below, joint.pose, 0
        while link in above and above[link].kind == "fixed" and hops < len(joints):
            pose, link, hops = above[link].pose @ pose, above[link].below, hops + 1
        # What floats below a link that moves is for MuJoCo to refuse.
        if link != root or joint.below == WORLD:
            continue
        start, end = joint.parent.tag.start, joint.parent.end
        edits.append((start, end, f'<parent link="{WORLD}"/>{_origin(pose)}'))
        if joint.origin is not None:
            edits.append((joint.origin.tag.start, joint.origin.end, ""))
    if edits and root != WORLD:
        taken, name = {e.called for e in found}, "root_joint"
        while name in taken:
            name += "_"
        end = text.rfind("</", 0, found[0].end)
        hung = (
            f'<link name="{WORLD}"/><joint name="{name}" type="fixed"><parent link="{WORLD}"/>'
            f'<child link="{html.escape(root)}"/></joint>'
        )
        edits.append((end, end, hung))
    return edits


def _pose(attributes: Mapping[str, str]) -> np.ndarray | None:
    """The 4 × 4 pose of an origin: rotations about fixed x, y, z in this order (URDF, origin).

    None for what is no finite numbers.
    """
    try:
        xyz = np.array(attributes.get("xyz", "0 0 0").split(), float)
        roll, pitch, yaw = (float(x) for x in attributes.get("rpy", "0 0 0").split())
    except ValueError:
        return None
    if xyz.shape != (3,) or not np.isfinite([*xyz, roll, pitch, yaw]).all():
        return None
    (cr, cp, cy), (sr, sp, sy) = np.cos([roll, pitch, yaw]), np.sin([roll, pitch, yaw])
    out = np.eye(4)
    out[:3, :3] = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    out[:3, 3] = xyz
    return out


def _origin(pose: np.ndarray) -> str:
    """A pose as a URDF's origin."""
    r = pose[:3, :3]
    pitch = np.arctan2(-r[2, 0], np.hypot(r[0, 0], r[1, 0]))
    if np.hypot(r[0, 0], r[1, 0]) > 1e-9:
        roll, yaw = np.arctan2(r[2, 1], r[2, 2]), np.arctan2(r[1, 0], r[0, 0])
    else:
        roll, yaw = np.arctan2(-r[1, 2], r[1, 1]), 0.0
    numbers = [" ".join(repr(float(x)) for x in part) for part in (pose[:3, 3], (roll, pitch, yaw))]
    return f'<origin xyz="{numbers[0]}" rpy="{numbers[1]}"/>'
