"""Robots as MJCF text: the humanoid of the paper, from its published figures."""

from jax_inertia.robots.humanoid import (
    CORNERS,
    Armature,
    Corner,
    HumanoidOptions,
    Terrain,
    home_pose,
    humanoid_mjcf,
)

__all__ = [
    "CORNERS",
    "Armature",
    "Corner",
    "HumanoidOptions",
    "Terrain",
    "home_pose",
    "humanoid_mjcf",
]
