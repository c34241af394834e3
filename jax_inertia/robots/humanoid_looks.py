"""What the humanoid looks like: plain shapes per link, for pictures only (no mass, no contact)."""

import xml.etree.ElementTree as ET
from typing import NamedTuple

from jax_inertia.robots.mjcf_elements import element

Vector = tuple[float, float, float]


class Shape(NamedTuple):
    """A visual geom in its link's frame, in m.

    A capsule of radius `size[0]` from `a` to `b`, or a box or ellipsoid with half-axes `size` at
    `a`.
    """

    kind: str
    size: tuple[float, ...]
    a: Vector
    b: Vector | None = None
    material: str = "shell"


def _capsule(radius: float, a: Vector, b: Vector, material: str = "shell") -> Shape:
    return Shape("capsule", (radius,), a, b, material)


def _box(half: Vector, centre: Vector, material: str = "shell") -> Shape:
    return Shape("box", half, centre, None, material)


def _ellipsoid(half: Vector, centre: Vector, material: str = "shell") -> Shape:
    return Shape("ellipsoid", half, centre, None, material)


def _leg(side: int) -> dict[str, tuple[Shape, ...]]:
    """Shapes of one leg; `side` is +1 on the left, −1 on the right."""
    return {
        "hip_yaw_link": (_capsule(0.055, (0.0, 0.0, 0.01), (0.02, 0.01 * side, -0.05), "joint"),),
        "hip_roll_link": (_capsule(0.05, (0.0, 0.0, 0.0), (0.0, 0.0, -0.079), "joint"),),
        "thigh_link": (
            _capsule(0.06, (0.0, -0.045, 0.0), (0.0, 0.045, 0.0), "joint"),
            _capsule(0.078, (0.005, 0.012 * side, -0.06), (0.0, 0.01 * side, -0.24)),
            _capsule(0.06, (0.0, 0.008 * side, -0.24), (0.0, 0.0, -0.36)),
        ),
        "shin_link": (
            _capsule(0.052, (0.0, -0.035, 0.0), (0.0, 0.035, 0.0), "joint"),
            _capsule(0.06, (-0.012, 0.0, -0.08), (-0.018, 0.0, -0.22)),
            _capsule(0.042, (-0.016, 0.0, -0.22), (-0.0083, 0.0, -0.36)),
        ),
        "ankle_link": (_capsule(0.036, (0.0, -0.022, 0.0), (0.0, 0.022, 0.0), "joint"),),
        "foot_link": (
            _box((0.125, 0.06, 0.012), (0.053, 0.0, -0.071), "joint"),
            _ellipsoid((0.115, 0.052, 0.04), (0.05, 0.0, -0.052)),
        ),
    }


def _arm(side: int) -> dict[str, tuple[Shape, ...]]:
    return {
        "shoulder_pitch_link": (
            _capsule(0.058, (0.0, 0.02 * side, 0.0), (0.0, 0.12 * side, -0.01), "joint"),
        ),
        "shoulder_roll_link": (
            _ellipsoid((0.068, 0.068, 0.075), (0.0, 0.025 * side, 0.0)),
            _capsule(0.05, (0.0, 0.03 * side, -0.03), (0.005, 0.03 * side, -0.14)),
        ),
        "shoulder_yaw_link": (
            _capsule(0.044, (0.002, 0.0, -0.16), (0.01, 0.0, -0.37)),
            _capsule(0.045, (0.015, -0.03, -0.4), (0.015, 0.03, -0.4), "joint"),
        ),
        "elbow_pitch_link": (
            _capsule(0.038, (0.0, 0.0, -0.05), (-0.008, 0.0, -0.28)),
            _ellipsoid((0.035, 0.03, 0.055), (-0.01, 0.0, -0.355), "joint"),
        ),
    }


_TRUNK = {
    "pelvis_link": (
        _box((0.085, 0.1, 0.045), (0.01, 0.0, -0.02), "joint"),
        _ellipsoid((0.12, 0.15, 0.075), (0.005, 0.0, -0.02)),
    ),
    "spine_yaw_link": (_capsule(0.065, (-0.01, 0.0, 0.01), (-0.01, 0.0, 0.06), "joint"),),
    "spine_roll_link": (_capsule(0.055, (0.0, -0.05, 0.0), (0.0, 0.05, 0.0), "joint"),),
    "torso_link": (
        _capsule(0.085, (-0.02, -0.05, 0.1), (-0.02, 0.05, 0.1), "joint"),
        _ellipsoid((0.125, 0.19, 0.2), (-0.025, 0.0, 0.25)),
        _box((0.06, 0.13, 0.15), (-0.12, 0.0, 0.27), "joint"),
        _capsule(0.04, (-0.01, 0.0, 0.42), (0.0, 0.0, 0.49), "joint"),
        _ellipsoid((0.085, 0.075, 0.1), (0.015, 0.0, 0.56)),
        _ellipsoid((0.05, 0.06, 0.035), (0.06, 0.0, 0.57), "visor"),
    ),
}

SHAPES: dict[str, tuple[Shape, ...]] = _TRUNK | {
    f"{name}_{link}": shapes
    for name, side in (("left", 1), ("right", -1))
    for link, shapes in (_leg(side) | _arm(side)).items()
}

_MATERIALS = {
    "shell": (0.80, 0.82, 0.85, 1.0),
    "joint": (0.16, 0.17, 0.20, 1.0),
    "visor": (0.05, 0.35, 0.55, 1.0),
}


def draw(body: ET.Element, link: str) -> None:
    """Add the link's shapes to its body."""
    for shape in SHAPES[link]:
        place = {"pos": shape.a} if shape.b is None else {"fromto": (*shape.a, *shape.b)}
        look = {"type": shape.kind, "size": shape.size, "material": shape.material}
        element(body, "geom", **look, **place, group=2)


def scenery(root: ET.Element) -> None:
    """Add sky, floor texture, materials and the offscreen picture's size."""
    visual = element(root, "visual")
    element(visual, "global", offwidth=1280, offheight=960, azimuth=140, elevation=-12)
    element(visual, "headlight", ambient=(0.35,) * 3, diffuse=(0.35,) * 3, specular=(0.1,) * 3)
    element(visual, "quality", shadowsize=4096)
    asset = element(root, "asset")
    sky = {"rgb1": (0.62, 0.72, 0.82), "rgb2": (0.93, 0.95, 0.97), "width": 256, "height": 1536}
    element(asset, "texture", type="skybox", builtin="gradient", **sky)
    tiles = {"rgb1": (0.72, 0.74, 0.76), "rgb2": (0.66, 0.68, 0.70), "width": 256, "height": 256}
    element(asset, "texture", name="tiles", type="2d", builtin="checker", **tiles)
    element(asset, "material", name="floor", texture="tiles", texrepeat=(2, 2), texuniform="true")
    for name, rgba in _MATERIALS.items():
        element(asset, "material", name=name, rgba=rgba, specular=0.35, shininess=0.4)


def lights(world: ET.Element) -> None:
    """Add two lights, one of which casts shadows."""
    key = {"dir": (-0.5, 0.5, -1), "diffuse": (0.55,) * 3, "castshadow": "true"}
    fill = {"dir": (-1, -1, -1), "diffuse": (0.2,) * 3, "castshadow": "false"}
    for pos, light in (((2, -2, 4), key), ((3, 3, 3), fill)):
        element(world, "light", pos=pos, type="directional", **light)
