"""Nominal robots of the sealed check. Every log has its own: lengths and masses vary about these figures.

All figures are ours, of the size of common machines; no robot is copied.
"""

from __future__ import annotations

import numpy as np

from world.describe import Link, Machine

THIGH, CALF, OFFSET, HIP = 0.21, 0.22, 0.09, (0.19, 0.06)
FOOT = 0.02
SIDES = {"LF": (1, 1), "RF": (1, -1), "LH": (-1, 1), "RH": (-1, -1)}
"""Front or hind, left or right."""


def _rod(mass: float, pos, com, thick: float) -> tuple[np.ndarray, np.ndarray]:
    """Centre of mass and inertia of a lumpy rod along `pos`."""
    length = np.asarray(pos, float)
    span = length @ length
    inertia = mass / 12.0 * (span * np.eye(3) - np.outer(length, length))
    inertia += mass * thick**2 * np.diag([0.45, 0.5, 0.4])
    return np.asarray(com, float), inertia


def _arm(name, rows, rng, **limits) -> Machine:
    """`rows`: axis, place on the link before, the link's own reach, mass, thickness, armature, damping, friction."""
    long, heavy = rng.uniform(0.88, 1.15), rng.uniform(0.85, 1.2)
    links = []
    for k, (axis, pos, reach, mass, thick, armature, damping, friction) in enumerate(rows):
        own, stretch = heavy * rng.uniform(0.9, 1.1), long * rng.uniform(0.97, 1.03)
        reach = stretch * np.asarray(reach, float)
        lump = rng.normal(0.0, 0.25 * thick, 3)
        com, inertia = _rod(own * mass, reach, 0.5 * reach + lump, thick)
        links.append(
            Link(
                name=f"segment{k + 1}",
                parent=k - 1,
                pos=tuple(float(long * x) for x in pos),
                axis=axis,
                joint=f"axis{k + 1}",
                mass=float(own * mass),
                com=com,
                inertia=inertia,
                armature=float(armature * rng.uniform(0.85, 1.2)),
                damping=float(damping * rng.uniform(0.8, 1.25)),
                friction=float(friction * rng.uniform(0.8, 1.25)),
            )
        )
    arrays = {key: np.array(limits.pop(key), float) for key in ("peak", "lower", "upper", "speed")}
    return Machine(name=name, links=tuple(links), **arrays, **limits)


def six(rng: np.random.Generator) -> Machine:
    """A six-joint arm of about 20 kg with three offset wrist joints."""
    rows = [
        ("z", (0, 0, 0.10), (0, 0.05, 0.06), 4.2, 0.08, 0.65, 1.4, 1.5),
        ("y", (0, 0.12, 0.07), (0.42, 0, 0), 8.1, 0.07, 0.72, 1.6, 2.0),
        ("y", (0.42, -0.11, 0), (0.38, 0, 0), 3.4, 0.055, 0.42, 0.8, 0.8),
        ("y", (0.38, 0.10, 0), (0, 0.08, 0), 1.6, 0.045, 0.13, 0.25, 0.3),
        ("z", (0, 0.09, 0), (0, 0, -0.08), 1.5, 0.045, 0.12, 0.22, 0.25),
        ("y", (0, 0, -0.09), (0, 0.1, 0), 0.7, 0.04, 0.10, 0.18, 0.0),
    ]
    return _arm(
        "six",
        rows,
        rng,
        peak=[150, 150, 100, 28, 28, 28],
        lower=[-2.2, -1.9, -1.9, -2.2, -2.0, -2.5],
        upper=[2.2, -0.4, 1.9, 1.5, 2.0, 2.5],
        speed=[1.7, 1.5, 1.9, 2.4, 2.4, 2.6],
        payload=(0.05, 4.0),
        force=(1.0, 60.0),
    )


def seven(rng: np.random.Generator) -> Machine:
    """A light seven-joint arm of about 11 kg, axes z y z y z y x."""
    rows = [
        ("z", (0, 0, 0.16), (0, 0, 0.12), 2.3, 0.06, 0.33, 0.7, 0.5),
        ("y", (0, 0.01, 0.12), (0, 0, 0.21), 2.2, 0.055, 0.33, 0.7, 0.7),
        ("z", (0, 0, 0.21), (0, 0, 0.19), 1.6, 0.05, 0.21, 0.4, 0.0),
        ("y", (0.02, 0, 0.19), (-0.02, 0, 0.20), 1.8, 0.05, 0.21, 0.4, 0.3),
        ("z", (-0.02, 0, 0.20), (0, 0, 0.18), 1.2, 0.045, 0.09, 0.16, 0.0),
        ("y", (0, 0, 0.18), (0, 0.04, 0.06), 0.9, 0.04, 0.08, 0.14, 0.12),
        ("x", (0, 0.05, 0.07), (0.05, 0, 0.10), 0.6, 0.035, 0.06, 0.1, 0.1),
    ]
    return _arm(
        "seven",
        rows,
        rng,
        peak=[60, 60, 40, 40, 14, 14, 10],
        lower=[-2.3, -1.3, -2.3, -2.2, -2.3, -1.6, -2.4],
        upper=[2.3, 1.3, 2.3, 0.4, 2.3, 1.6, 2.4],
        speed=[2.0, 1.7, 2.0, 2.2, 2.6, 2.6, 3.0],
        payload=(0.03, 2.0),
        force=(0.5, 30.0),
    )


def two(rng: np.random.Generator) -> Machine:
    """Two links in a vertical plane, hanging at zero: small enough for a test."""
    rows = [
        ("y", (0, 0, 0.9), (0, 0, -0.35), 2.4, 0.05, 0.06, 0.2, 0.0),
        ("y", (0, 0.05, -0.35), (0, 0, -0.31), 1.3, 0.045, 0.028, 0.09, 0.1),
    ]
    return _arm(
        "two",
        rows,
        rng,
        peak=[35, 14],
        lower=[-1.9, -2.1],
        upper=[1.9, 2.1],
        speed=[3.0, 3.8],
        payload=(0.02, 1.0),
        force=(0.3, 20.0),
    )


def dog(rng: np.random.Generator) -> Machine:
    """A quadruped of about 15 kg on ball feet: abduction, hip, knee on each leg."""
    heavy = rng.uniform(0.85, 1.2)
    m = 7.4 * heavy
    links = [
        Link("body", -1, (0, 0, 0.33), "", "float", m, np.array([0.006, -0.002, 0.008]),
             m * np.array([[0.006, 0.0001, -0.0002], [0.0001, 0.016, 0.0], [-0.0002, 0.0, 0.019]]))
    ]  # fmt: skip

    def add(name, parent, pos, axis, joint, mass, com, diagonal, armature, damping, friction):
        own = heavy * mass * rng.uniform(0.92, 1.08)
        com = np.array(com) + rng.normal(0.0, 0.002, 3)
        links.append(
            Link(name, parent, pos, axis, joint, own, com, own * np.diag(diagonal),
                 armature * rng.uniform(0.85, 1.2), damping * rng.uniform(0.8, 1.25), friction)
        )  # fmt: skip
        return len(links) - 1

    for leg, (f, s) in SIDES.items():
        hip = add(f"{leg}_hip", 0, (f * HIP[0], s * HIP[1], 0.0), "x", f"{leg}_HAA", 0.7,
                  (0.0, s * 0.015, 0.0), (8e-4, 1.2e-3, 1e-3), 0.009, 0.07, 0.0)  # fmt: skip
        thigh = add(f"{leg}_thigh", hip, (0.0, s * OFFSET, 0.0), "y", f"{leg}_HFE", 0.95,
                    (-0.004, -s * 0.02, -0.04), (5e-3, 5e-3, 1.2e-3), 0.009, 0.07, 0.0)  # fmt: skip
        calf = add(f"{leg}_calf", thigh, (0.0, 0.0, -THIGH), "y", f"{leg}_KFE", 0.24,
                   (0.005, 0.0, -0.10), (5e-3, 5e-3, 2e-4), 0.016, 0.09, 0.1)  # fmt: skip
        links.append(
            Link(f"{leg}_foot", calf, (0.0, 0.0, -CALF), "", "", 0.06 * heavy, np.zeros(3),
                 0.06 * heavy * np.diag([1.6e-4] * 3), radius=FOOT)
        )  # fmt: skip
    return Machine(
        name="dog",
        links=tuple(links),
        peak=np.tile([24.0, 24.0, 32.0], 4),
        lower=np.tile([-0.7, -0.6, -2.4], 4),
        upper=np.tile([0.7, 1.9, -0.6], 4),
        speed=np.full(12, 9.0),
        payload=(0.05, 3.0),
        force=(1.5, 50.0),
        height=0.30,
    )


def humanoid(rng: np.random.Generator) -> Machine:
    """A humanoid of about 55 kg, hung by four straps over a load cell: legs of six, arms of four, a waist."""
    heavy, long = rng.uniform(0.85, 1.15), rng.uniform(0.92, 1.08)
    links = [
        Link("pelvis", -1, (0, 0, 1.2), "", "float", 9.0 * heavy, np.array([0.01, 0.0, 0.04]),
             9.0 * heavy * np.diag([0.011, 0.008, 0.012]))
    ]  # fmt: skip
    peak, lower, upper, speed = [], [], [], []

    def add(name, parent, pos, axis, mass, reach, thick, limits, armature):
        own = heavy * mass * rng.uniform(0.92, 1.08)
        reach = long * np.asarray(reach, float)
        com, inertia = _rod(own, reach, 0.5 * reach + rng.normal(0, 0.15 * thick, 3), thick)
        top, low, high = limits
        links.append(
            Link(name, parent, tuple(float(long * x) for x in pos), axis, f"j_{name}", own, com,
                 inertia, armature * rng.uniform(0.85, 1.2), 0.02 * top * rng.uniform(0.5, 1.2))
        )  # fmt: skip
        peak.append(top)
        lower.append(low)
        upper.append(high)
        speed.append(2.2)
        return len(links) - 1

    for side, s in (("l", 1), ("r", -1)):
        at = add(
            f"{side}_hip_yaw",
            0,
            (0, 0.1 * s, -0.04),
            "z",
            1.6,
            (0, 0, -0.06),
            0.05,
            (50, -0.4, 0.4),
            0.07,
        )
        at = add(
            f"{side}_hip_roll",
            at,
            (0, 0, -0.06),
            "x",
            1.5,
            (0, 0, -0.06),
            0.05,
            (70, -0.3, 0.3),
            0.1,
        )
        at = add(
            f"{side}_thigh", at, (0, 0, -0.05), "y", 5.0, (0, 0, -0.34), 0.06, (80, -1.0, 0.4), 0.14
        )
        at = add(
            f"{side}_shin", at, (0, 0, -0.37), "y", 2.9, (0, 0, -0.33), 0.05, (80, 0.1, 1.5), 0.14
        )
        at = add(
            f"{side}_ankle", at, (0, 0, -0.36), "y", 0.6, (0, 0, -0.04), 0.04, (30, -0.5, 0.5), 0.05
        )
        add(
            f"{side}_foot",
            at,
            (0, 0, -0.02),
            "x",
            1.1,
            (0.12, 0, -0.05),
            0.05,
            (20, -0.3, 0.3),
            0.04,
        )
    torso = add("torso", 0, (0, 0, 0.12), "z", 14.0, (0, 0, 0.4), 0.14, (60, -0.5, 0.5), 0.15)
    for side, s in (("l", 1), ("r", -1)):
        at = add(
            f"{side}_shoulder",
            torso,
            (0, 0.2 * s, 0.34),
            "y",
            1.3,
            (0, 0.05 * s, 0),
            0.05,
            (40, -1.4, 0.9),
            0.07,
        )
        at = add(
            f"{side}_upper",
            at,
            (0, 0.05 * s, 0),
            "x",
            1.8,
            (0, 0, -0.22),
            0.045,
            (40, -0.5, 0.5),
            0.07,
        )
        at = add(
            f"{side}_twist", at, (0, 0, -0.14), "z", 0.8, (0, 0, -0.12), 0.04, (18, -1.0, 1.0), 0.03
        )
        add(
            f"{side}_forearm",
            at,
            (0, 0, -0.13),
            "y",
            1.5,
            (0, 0, -0.26),
            0.04,
            (25, -1.6, -0.1),
            0.04,
        )
    return Machine(
        name="humanoid",
        links=tuple(links),
        peak=np.array(peak, float),
        lower=np.array(lower),
        upper=np.array(upper),
        speed=np.array(speed),
        payload=(0.1, 8.0),
        force=(2.0, 120.0),
        height=1.2,
        straps=((0.12, 0.15, 0.1), (0.12, -0.15, 0.1), (-0.12, 0.15, 0.1), (-0.12, -0.15, 0.1)),
    )


MACHINES = {"six": six, "seven": seven, "two": two, "dog": dog, "humanoid": humanoid}
