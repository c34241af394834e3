"""Robots of any shape for `any_robots.py`: trees of hinges and slides, their links and their MJCF."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

STEP = 2.5e-4  # s


@dataclass
class Joint:
    """One joint and the link behind it."""

    name: str
    parent: int  # of the joints, −1: the base
    slide: bool
    place: np.ndarray  # in the parent link [m]
    axis: np.ndarray
    mass: float
    centre: np.ndarray
    inertia: np.ndarray  # principal [kg m²]
    turn: np.ndarray  # quaternion of the principal axes
    damping: float = 0.0
    loss: float = 0.0
    armature: float = 0.0


def unit(rng: np.random.Generator) -> np.ndarray:
    x = rng.normal(size=3)
    return x / np.linalg.norm(x)


def tree(rng: np.random.Generator) -> list[Joint]:
    """Links that grow lighter outwards; one joint in seven branches off an earlier link."""
    n, out = int(rng.integers(2, 8)), []
    size, mass = rng.uniform(0.15, 0.4), rng.uniform(2.0, 8.0)
    for k in range(n):
        parent = k - 1 if k < 2 or rng.random() > 0.15 else int(rng.integers(0, k - 1))
        length = size * rng.uniform(0.5, 1.2) * 0.85**k
        square = rng.random() < 0.7
        axis = np.eye(3)[rng.integers(3)] if square else unit(rng)
        thick = length * rng.uniform(0.15, 0.4)
        m = mass * 0.65**k * rng.uniform(0.6, 1.4)
        box = np.array([thick, thick * rng.uniform(0.7, 1.3), length])
        inertia = m / 12 * (np.sum(box**2) - box**2)
        along = unit(rng) * np.array([0.4, 0.4, 1.0])
        place = np.zeros(3) if k == 0 else unit(rng) * 0.1 * length + out[parent].centre * 2.0
        out.append(
            Joint(
                "",
                parent,
                bool(rng.random() < 0.1),
                place,
                axis,
                m,
                along / np.linalg.norm(along) * 0.5 * length,
                inertia,
                np.array([1.0, *(0.3 * rng.normal(size=3))]),
            )
        )
    return out


def depth_first(joints: list[Joint]) -> list[Joint]:
    """The same in MuJoCo's order, named anew along it."""
    order: list[int] = []

    def visit(k: int) -> None:
        order.append(k)
        for c, j in enumerate(joints):
            if j.parent == k:
                visit(c)

    visit(0)
    out = [joints[k] for k in order]
    for j, letter in zip(out, "abcdefg", strict=False):
        j.parent = order.index(j.parent) if j.parent >= 0 else -1
        j.name = f"{'slide' if j.slide else 'joint'}_{letter}"
    return out


def mjcf(joints: list[Joint]) -> str:
    def numbers(x) -> str:
        return " ".join(f"{v:.10g}" for v in np.atleast_1d(x))

    def body(k: int) -> str:
        j = joints[k]
        inside = "".join(body(c) for c in range(len(joints)) if joints[c].parent == k)
        kind = "slide" if j.slide else "hinge"
        return (
            f'<body name="link_{j.name[-1]}" pos="{numbers(j.place)}">'
            f'<joint name="{j.name}" type="{kind}" axis="{numbers(j.axis)}" damping="{j.damping:.8g}" '
            f'frictionloss="{j.loss:.8g}" armature="{j.armature:.8g}"/>'
            f'<inertial mass="{j.mass:.10g}" pos="{numbers(j.centre)}" quat="{numbers(j.turn)}" '
            f'diaginertia="{numbers(j.inertia)}"/>{inside}</body>'
        )

    roots = "".join(body(k) for k in range(len(joints)) if joints[k].parent < 0)
    return (
        f'<mujoco model="robot"><option integrator="implicitfast" timestep="{STEP}"/><compiler autolimits="true"/>'
        f"<worldbody>{roots}</worldbody></mujoco>"
    )


def motion_span(robot: list[Joint]) -> np.ndarray:
    """Half of each joint's range [rad, m]."""
    return np.array([0.15 if j.slide else 0.9 for j in robot])
