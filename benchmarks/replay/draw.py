"""What is hidden in each robot of this benchmark: nothing, ordinary physics, one odd effect, or two."""

from __future__ import annotations

import dataclasses

import numpy as np
from replay.plant import Truth
from replay.robots import Robot

KINDS = ("sound", "ordinary", "single", "single", "single", "pair")
ODD = (
    "torque_saturation", "torque_speed", "dead_band", "backlash", "load_friction", "stribeck_friction", "target_lag",
    "target_delay_joint", "payload", "torque_bias",
)  # fmt: skip
ALONE = ("target_delay", "kp_scale", "coulomb_friction", "armature")
"""Ordinary numbers that are hidden one at a time."""


def ordinary(robot: Robot, truth: Truth, typical: np.ndarray, inertia: np.ndarray, rng) -> Truth:
    """Rotor, viscous and dry friction at every joint, small offsets, one delay; kp as said."""
    n = len(robot.joints)
    return dataclasses.replace(
        truth,
        armature=np.maximum(robot.armature, inertia) * rng.uniform(0.4, 1.5, n),
        damping=0.25 * robot.kd * rng.uniform(0.3, 1.2, n),
        dry=typical * rng.uniform(0.08, 0.35, n),
        offset=rng.normal(size=n) * 0.008,
        delay=np.full(n, rng.uniform(0.002, 0.018)),
    )


def add(
    robot: Robot, truth: Truth, family: str, asked: np.ndarray, fastest: np.ndarray, typical, rng
):
    """(truth with one more effect, its entry in truth.json); `asked` and `fastest`: 99.5 % of torque and speed."""
    j = int(rng.integers(len(robot.joints)))
    new = {k: np.array(x) for k, x in vars(truth).items() if k != "mass"}
    place, size = ("joint", robot.joints[j]), 0.0
    if family == "torque_saturation":
        size = new["limit"][j] = asked[j] * rng.uniform(0.45, 0.75)
    elif family == "torque_speed":
        size = new["limit"][j] = asked[j] * rng.uniform(0.7, 1.0)
        new["no_load"][j] = fastest[j] * rng.uniform(1.1, 1.8)
    elif family == "dead_band":
        size = new["dead"][j] = rng.uniform(0.008, 0.025)
    elif family == "backlash":
        size = new["play"][j] = rng.uniform(0.012, 0.04)
    elif family == "load_friction":
        size = new["load"][j] = rng.uniform(0.12, 0.3)
    elif family == "stribeck_friction":
        new["static"][j], new["slow"][j] = rng.uniform(1.6, 2.6), rng.uniform(0.04, 0.2)
        new["dry"][j] = max(new["dry"][j], 0.2 * typical[j])
        size = (new["static"][j] - 1) * new["dry"][j]
    elif family == "target_lag":
        size = new["lag"][j] = rng.uniform(0.012, 0.04)
    elif family == "target_delay_joint":
        size = rng.uniform(0.01, 0.03)
        new["delay"][j] += size
    elif family == "payload":
        b = len(robot.bodies) - 1 if robot.name == "arm" else int(rng.integers(len(robot.bodies)))
        size = rng.uniform(0.05, 0.15) if robot.name == "arm" else rng.uniform(0.15, 0.5)
        mass = {**truth.mass, robot.bodies[b]: size}
        entry = {"family": "payload", "kind": "body", "name": robot.bodies[b], "size": size}
        return dataclasses.replace(truth, mass=mass), entry
    elif family == "torque_bias":
        size = new["bias"][j] = rng.choice([-1, 1]) * typical[j] * rng.uniform(0.3, 0.8)
    elif family == "target_delay":
        size = rng.uniform(0.01, 0.03)
        new["delay"] += size
        place = ("global", "global")
    elif family == "kp_scale":
        size = rng.choice([rng.uniform(0.6, 0.85), rng.uniform(1.2, 1.5)])
        new["kp"][j] *= size
    elif family == "coulomb_friction":
        size = typical[j] * rng.uniform(0.2, 0.5)
        new["dry"][j] += size
    elif family == "armature":
        size = (
            0.01 * rng.uniform(0.6, 2.0) if robot.name != "arm" else 0.004 * rng.uniform(0.6, 2.0)
        )
        new["armature"][j] += size
    name = "target_delay" if family == "target_delay_joint" else family
    entry = {"family": name, "kind": place[0], "name": place[1], "size": float(size)}
    return dataclasses.replace(truth, **new), entry
