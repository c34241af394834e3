"""Robots of this benchmark as MJCF, made up here: one-joint rig, suspended leg, suspended quadruped, desktop arm."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Robot:
    """A model without friction and rotors, its joints, gains, and how far and fast targets go."""

    name: str
    xml: str
    joints: tuple[str, ...]
    bodies: tuple[str, ...]
    kp: np.ndarray
    kd: np.ndarray
    middle: np.ndarray
    swing: np.ndarray
    fastest: float
    """Of the sines that targets are made of [Hz]."""
    armature: float = 0.0
    """What the model has of each joint's rotor [kg m²]."""


def _body(
    name: str,
    joint: str,
    pos,
    axis,
    mass: float,
    centre,
    inertia,
    inside: str = "",
    rotor: float = 0.0,
) -> str:
    x = [" ".join(f"{v:g}" for v in part) for part in (pos, axis, centre, inertia)]
    return (
        f'<body name="{name}" pos="{x[0]}"><joint name="{joint}" axis="{x[1]}" armature="{rotor:g}"/>'
        f'<inertial pos="{x[2]}" mass="{mass:g}" diaginertia="{x[3]}"/>{inside}</body>'
    )


def _leg(prefix: str, pos, side: float) -> str:
    shank = _body(
        f"{prefix}shank", f"{prefix}knee", (0, 0, -0.21), (0, 1, 0), 0.25, (0.005, 0, -0.11),
        (0.0021, 0.0021, 0.0001),
    )  # fmt: skip
    thigh = _body(
        f"{prefix}thigh", f"{prefix}pitch", (0, 0.09 * side, 0), (0, 1, 0), 1.1, (-0.004, -0.02 * side, -0.035),
        (0.0062, 0.0058, 0.0011), shank,
    )  # fmt: skip
    return _body(
        f"{prefix}hip", f"{prefix}roll", pos, (1, 0, 0), 0.7, (-0.005, 0.003 * side, 0),
        (0.0005, 0.0009, 0.0006), thigh,
    )  # fmt: skip


def _whole(name: str, inside: str) -> str:
    return (
        f'<mujoco model="{name}"><option timestep="0.001"/><worldbody>{inside}</worldbody></mujoco>'
    )


def _gains(kp, kd, n: int) -> tuple[np.ndarray, np.ndarray]:
    return np.resize(np.asarray(kp, float), n), np.resize(np.asarray(kd, float), n)


_SERVO = 0.008  # Of a servo's gears and rotor at the joint.


def rig() -> Robot:
    """A bar with a weight at its end."""
    bar = _body("bar", "hinge", (0, 0, 0), (0, 1, 0), 0.6, (0, 0, -0.14), (0.004, 0.004, 0.0005))
    return Robot(
        "rig", _whole("rig", bar), ("hinge",), ("bar",), *_gains(14, 0.35, 1), np.array([0.4]),
        np.array([1.0]), 1.6,
    )  # fmt: skip


def leg() -> Robot:
    """One leg of a small quadruped, its hip held."""
    joints = ("roll", "pitch", "knee")
    return Robot(
        "leg", _whole("leg", _leg("", (0, 0, 0), 1)), joints, ("hip", "thigh", "shank"), *_gains(30, 0.8, 3),
        np.array([0.0, 0.8, -1.5]), np.array([0.35, 0.6, 0.6]), 2.0,
    )  # fmt: skip


def quadruped() -> Robot:
    """Four of them on a trunk that hangs."""
    places = {
        "FL_": (0.19, 0.05),
        "FR_": (0.19, -0.05),
        "RL_": (-0.19, 0.05),
        "RR_": (-0.19, -0.05),
    }
    inside = "".join(_leg(p, (x, y, 0), np.sign(y)) for p, (x, y) in places.items())
    joints = tuple(f"{p}{j}" for p in places for j in ("roll", "pitch", "knee"))
    bodies = tuple(f"{p}{b}" for p in places for b in ("hip", "thigh", "shank"))
    return Robot(
        "quadruped", _whole("quadruped", inside), joints, bodies, *_gains(30, 0.8, 12),
        np.tile([0.0, 0.8, -1.5], 4), np.tile([0.35, 0.6, 0.6], 4), 2.0,
    )  # fmt: skip


def arm() -> Robot:
    """A desktop arm of six servos."""
    parts = [
        ("pan", (0, 0, 0.06), (0, 0, 1), 0.16, (0, 0, 0.03), 1.2e-4),
        ("lift", (0, 0, 0.05), (0, 1, 0), 0.14, (0.01, 0, 0.07), 2.2e-4),
        ("elbow", (0, 0, 0.13), (0, 1, 0), 0.13, (0.06, 0, 0.01), 1.9e-4),
        ("bend", (0.13, 0, 0), (0, 1, 0), 0.09, (0.03, 0, 0), 6e-5),
        ("roll", (0.06, 0, 0), (1, 0, 0), 0.08, (0.03, 0.006, 0), 5e-5),
        ("jaw", (0.05, 0.02, 0), (0, 0, 1), 0.03, (0.03, 0.008, 0), 1.5e-5),
    ]
    inside = ""
    for joint, pos, axis, mass, centre, inertia in reversed(parts):
        inside = _body(
            f"{joint}_link", joint, pos, axis, mass, centre, (inertia,) * 3, inside, _SERVO
        )
    joints = tuple(x[0] for x in parts)
    return Robot(
        "arm", _whole("arm", inside), joints, tuple(f"{j}_link" for j in joints),
        *_gains([18, 22, 20, 14, 12, 10], [0.6, 0.7, 0.6, 0.4, 0.3, 0.25], 6),
        np.array([0.0, 0.3, 0.6, 0.2, 0.0, 0.3]), np.array([0.8, 0.5, 0.6, 0.6, 0.8, 0.4]), 0.8, _SERVO,
    )  # fmt: skip


ROBOTS = {"rig": rig, "leg": leg, "quadruped": quadruped, "arm": arm}
