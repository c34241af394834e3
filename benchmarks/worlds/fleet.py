"""Robots of a sealed set, none of which the method was developed on: sixteen shapes, whose figures each set draws anew.

A row a joint: kind (turn or slide), place in the link before [m], axis, range [rad, m], mass [kg], centre of mass and
sides of a box that turns alike [m]. Figures are our own, of the size of common machines. Of a set with a seed they are
other robots: larger or smaller ones, with other proportions, masses, centres and slightly other axes (`drawn`).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import mujoco
import numpy as np

from benchmarks.worlds.own_robot import robot_of
from benchmarks.worlds.robots import Robot

X, Y, Z = (1, 0, 0), (0, 1, 0), (0, 0, 1)
T, S = "hinge", "slide"
Link = tuple[str, tuple, tuple, tuple, float, tuple, tuple]

FLEET: dict[str, list[Link]] = {
    "scara": [
        (T, (0, 0, 0.4), Z, (-2.2, 2.2), 5.2, (0.15, 0.01, 0.02), (0.36, 0.12, 0.1)),
        (T, (0.32, 0, 0.05), Z, (-2.4, 2.4), 3.1, (0.11, -0.012, 0.04), (0.3, 0.1, 0.14)),
        (S, (0.26, 0, 0), Z, (-0.22, 0.0), 1.4, (0.004, 0, -0.05), (0.05, 0.05, 0.34)),
        (T, (0, 0, -0.2), Z, (-2.9, 2.9), 0.6, (0.03, 0.008, -0.03), (0.09, 0.05, 0.05)),
    ],
    "gantry": [
        (S, (0, 0, 0.8), X, (-0.5, 0.5), 9.0, (0.02, 0.1, 0), (0.14, 0.9, 0.12)),
        (S, (0, 0, 0.06), Y, (-0.35, 0.35), 4.1, (0, 0.01, 0.03), (0.16, 0.14, 0.2)),
        (S, (0.05, 0, 0), Z, (-0.3, 0.1), 2.3, (0.01, 0, -0.12), (0.07, 0.07, 0.5)),
        (T, (0, 0, -0.34), Y, (-1.6, 1.6), 0.9, (0.02, 0.015, -0.06), (0.06, 0.06, 0.15)),
    ],
    "oblique": [
        (T, (0, 0, 0.2), (0.5, 0, 0.8660254), (-2.5, 2.5), 4.4, (0.05, 0.02, 0.1), (0.14, 0.15, 0.24)),
        (T, (0.09, 0, 0.2), (-0.5, 0.6, 0.6244998), (-2.1, 2.1), 3.2, (0.06, -0.03, 0.12), (0.12, 0.1, 0.3)),
        (T, (0.1, 0.03, 0.24), (0.7071068, 0.7071068, 0), (-2.0, 2.0), 1.9, (0.02, 0.05, 0.09), (0.09, 0.1, 0.24)),
        (T, (0.03, 0.06, 0.2), (0.3, -0.7, 0.6480741), (-2.6, 2.6), 0.8, (0.03, 0.01, 0.07), (0.07, 0.06, 0.16)),
    ],
    "delta_leg": [
        (T, (0.1, 0, 0.9), Y, (-0.9, 1.2), 0.9, (0.09, 0.004, -0.01), (0.24, 0.05, 0.05)),
        (T, (0.2, 0, 0), Y, (0.4, 2.1), 0.34, (0.21, 0, 0.003), (0.44, 0.03, 0.03)),
        (T, (0.42, 0, 0), X, (-0.5, 0.5), 0.5, (0.02, 0.03, -0.02), (0.06, 0.1, 0.05)),
    ],
    "hexapod_leg": [
        (T, (0, 0, 0.3), Z, (-1.0, 1.0), 0.19, (0.02, 0.003, 0.002), (0.07, 0.04, 0.05)),
        (T, (0.055, 0, 0), Y, (-1.3, 1.0), 0.26, (0.05, -0.006, 0.004), (0.14, 0.04, 0.05)),
        (T, (0.11, 0, 0), Y, (0.3, 2.4), 0.2, (0.07, 0.002, 0), (0.2, 0.03, 0.04)),
    ],
    "snake": [
        (T, (0, 0, 0.7) if k == 0 else (0.11, 0, 0), Y if k % 2 else Z, (-0.9, 0.9), 0.62 - 0.03 * k,
         (0.055, 0.004 * (-1) ** k, 0.003), (0.11, 0.07, 0.07))
        for k in range(9)
    ],
    "camera_head": [
        (T, (0, 0, 1.2), Z, (-2.8, 2.8), 2.1, (0.01, 0.03, 0.06), (0.12, 0.2, 0.14)),
        (T, (0, 0, 0.14), Y, (-1.0, 1.3), 3.4, (0.06, -0.01, 0.05), (0.3, 0.15, 0.16)),
    ],
    "palletizer": [
        (T, (0, 0, 0.35), Z, (-2.7, 2.7), 21.0, (0.06, 0.03, 0.14), (0.36, 0.34, 0.4)),
        (T, (0.13, 0, 0.28), Y, (-0.7, 1.3), 14.0, (0.02, -0.06, 0.33), (0.14, 0.16, 0.8)),
        (T, (0, 0, 0.72), Y, (-0.2, 1.9), 9.5, (0.27, 0.03, 0.04), (0.8, 0.12, 0.14)),
        (T, (0.68, 0, 0), Y, (-1.6, 1.6), 3.8, (0.05, 0.01, -0.06), (0.16, 0.14, 0.16)),
    ],
    "digger": [
        (T, (0, 0, 0.5), Z, (-2.5, 2.5), 120.0, (-0.1, 0.02, 0.1), (0.8, 0.7, 0.5)),
        (T, (0.3, 0, 0.2), Y, (-1.1, 0.5), 42.0, (0.62, 0.01, 0.12), (1.4, 0.14, 0.22)),
        (T, (1.25, 0, 0.1), Y, (0.3, 2.2), 21.0, (0.31, 0, 0.04), (0.8, 0.11, 0.16)),
        (T, (0.66, 0, 0), Y, (-0.6, 1.9), 13.0, (0.14, 0, -0.1), (0.3, 0.36, 0.28)),
    ],
    "finger": [
        (T, (0, 0, 0.3), X, (-0.5, 0.5), 0.11, (0.002, 0.004, 0.02), (0.035, 0.03, 0.05)),
        (T, (0, 0, 0.035), Y, (-0.3, 1.5), 0.09, (0.003, 0, 0.028), (0.024, 0.022, 0.07)),
        (T, (0, 0, 0.056), Y, (0.0, 1.8), 0.06, (0.002, 0.001, 0.019), (0.02, 0.02, 0.05)),
    ],
    "exo_leg": [
        (T, (0, 0, 1.0), X, (-0.4, 0.5), 2.3, (0.02, 0.04, -0.03), (0.14, 0.16, 0.15)),
        (T, (0, 0.1, -0.05), Y, (-1.2, 0.5), 5.4, (0.01, 0.02, -0.19), (0.13, 0.14, 0.44)),
        (T, (0, 0, -0.42), Y, (0.1, 1.7), 3.2, (-0.006, 0.012, -0.17), (0.1, 0.11, 0.4)),
        (T, (0, 0, -0.4), Y, (-0.6, 0.5), 1.3, (0.05, 0, -0.04), (0.25, 0.09, 0.07)),
    ],
    "rail_arm": [
        (S, (0, 0, 0.3), Y, (-0.6, 0.6), 11.0, (0, 0.02, 0.06), (0.3, 0.36, 0.16)),
        (T, (0, 0, 0.15), Z, (-2.6, 2.6), 3.9, (0.01, 0.03, 0.09), (0.15, 0.15, 0.2)),
        (T, (0, 0, 0.2), Y, (-1.6, 1.4), 3.5, (0.02, 0.04, 0.16), (0.1, 0.12, 0.4)),
        (T, (0, 0, 0.36), Y, (-2.2, 2.2), 2.0, (0.14, -0.02, 0.01), (0.36, 0.09, 0.09)),
        (T, (0.3, 0, 0), X, (-2.6, 2.6), 0.8, (0.05, 0.012, 0.01), (0.12, 0.08, 0.07)),
    ],
    "scope": [
        (T, (0, 0, 0.9), (0.7071068, 0, 0.7071068), (-1.3, 1.3), 3.6, (0.12, 0.03, 0.06), (0.3, 0.12, 0.2)),
        (T, (0.25, 0, 0.1), Y, (-0.9, 0.9), 2.2, (0.05, -0.02, -0.12), (0.1, 0.09, 0.36)),
        (S, (0.08, 0, -0.1), Z, (-0.16, 0.06), 0.7, (0.006, 0.003, -0.09), (0.05, 0.05, 0.36)),
    ],
    "humanoid_arm": [
        (T, (0, 0.2, 1.3), Y, (-2.2, 1.0), 1.8, (0.004, 0.04, -0.01), (0.12, 0.14, 0.12)),
        (T, (0, 0.08, 0), X, (0.0, 2.0), 1.5, (0.01, 0.01, -0.06), (0.1, 0.1, 0.18)),
        (T, (0, 0, -0.14), Z, (-1.5, 1.5), 1.3, (0.008, -0.004, -0.08), (0.08, 0.09, 0.2)),
        (T, (0.02, 0, -0.16), Y, (-2.1, 0.0), 1.1, (-0.004, 0.006, -0.09), (0.07, 0.08, 0.22)),
        (T, (-0.02, 0, -0.22), Z, (-2.0, 2.0), 0.6, (0.012, 0.006, -0.06), (0.06, 0.09, 0.14)),
    ],
    "ceiling_arm": [
        (T, (0, 0, 2.2), Z, (-2.8, 2.8), 4.6, (0.01, 0.03, -0.08), (0.16, 0.17, 0.2)),
        (T, (0, 0.08, -0.16), Y, (-2.0, 2.0), 5.3, (0, 0.03, -0.19), (0.13, 0.12, 0.46)),
        (T, (0, -0.06, -0.42), Y, (-2.4, 2.4), 3.0, (0.02, 0.02, -0.14), (0.1, 0.1, 0.36)),
        (T, (0.03, 0.02, -0.34), X, (-2.7, 2.7), 1.4, (0.05, 0.006, -0.01), (0.14, 0.08, 0.09)),
        (T, (0.11, 0, 0), Y, (-1.9, 1.9), 1.1, (0.03, -0.01, -0.04), (0.1, 0.08, 0.12)),
        (T, (0.02, 0, -0.1), Z, (-2.8, 2.8), 0.5, (0.014, 0.011, -0.03), (0.07, 0.09, 0.07)),
    ],
    "gimbal": [
        (T, (0, 0, 0.6), Z, (-2.0, 2.0), 3.0, (0.03, 0.05, 0.05), (0.3, 0.36, 0.16)),
        (T, (0.02, 0, 0.12), X, (-1.3, 1.3), 1.9, (0.04, 0.02, 0.03), (0.26, 0.3, 0.1)),
        (T, (0, 0.03, 0), Y, (-1.4, 1.4), 2.4, (0.05, -0.02, 0.04), (0.2, 0.16, 0.14)),
    ],
}  # fmt: skip
LIGHT = ("camera_head", "delta_leg", "scope", "gimbal", "scara", "oblique", "exo_leg")
"""Those of 2 to 4 joints and some kilograms: of logs of targets, whose diagnosis replays them many times."""


def drawn(name: str, seed: int | None) -> list[Link]:
    """Rows of a set's own robot; the table's without a seed."""
    if seed is None:
        return FLEET[name]
    rng = np.random.default_rng([seed, list(FLEET).index(name), 77])
    large, heavy = np.exp(0.3 * rng.normal()), np.exp(0.3 * rng.normal())
    links = []
    for kind, place, axis, room, mass, centre, sides in FLEET[name]:
        size = large * np.exp(0.2 * rng.normal(size=4))
        axis = np.array(axis) + 0.03 * rng.normal(size=3) * (max(axis) < 1)
        room = tuple(large * np.array(room)) if kind == S else room
        mass *= heavy * large**3 * np.exp(0.25 * rng.normal())
        off = np.array(centre) * size[1] + 0.06 * np.max(sides) * size[1] * rng.normal(size=3)
        place = tuple(np.array(place) * size[0])
        links.append(
            (
                kind,
                place,
                tuple(axis),
                room,
                float(mass),
                tuple(off),
                tuple(np.array(sides) * size[1:]),
            )
        )
    return links


def mjcf(name: str, seed: int | None = None) -> str:
    """The drawing, without friction and rotors."""
    spec = mujoco.MjSpec()
    spec.modelname, spec.compiler.degree = name, False
    spec.option.timestep, spec.option.integrator = 1e-3, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    parent = spec.worldbody
    for k, (kind, place, axis, room, mass, centre, sides) in enumerate(drawn(name, seed), start=1):
        parent = parent.add_body(name=f"{name}_link{k}", pos=place)
        parent.explicitinertial, parent.mass, parent.ipos = True, mass, centre
        square = np.square(sides)
        parent.inertia = mass / 12.0 * (square.sum() - square)
        sort = {T: mujoco.mjtJoint.mjJNT_HINGE, S: mujoco.mjtJoint.mjJNT_SLIDE}[kind]
        parent.add_joint(
            name=f"{name}_joint{k}", type=sort, axis=axis, range=room,
            limited=mujoco.mjtLimited.mjLIMITED_TRUE,
        )  # fmt: skip
    spec.compile()
    return spec.to_xml()


def robot(name: str, seed: int | None = None) -> Robot:
    """As the generator wants it: its mechanics, and what motions, loads and forces suit it."""
    return robot_of(mujoco.MjModel.from_xml_string(mjcf(name, seed)), name)


def robots(seed: int) -> dict[str, Callable[[], Robot]]:
    """Those of a set."""
    return {name: partial(robot, name, seed) for name in FLEET}
