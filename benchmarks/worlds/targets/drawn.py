"""Robots that are told positions: nothing is hidden in one, or ordinary physics, one odd effect, or two.

Every sixth robot is sound, every sixth has ordinary physics everywhere and nothing else, three have one odd effect
besides (or, of every third, one ordinary number alone), one two. Shares no code with the package.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import mujoco
import numpy as np

from benchmarks.worlds.targets.plant import Robot, Truth, simulate, targets

ATTEMPTS = 12
_TOLD = 0.02
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
        b = int(rng.integers(len(robot.bodies)))
        size = rng.uniform(0.15, 0.5)
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
        size = 0.01 * rng.uniform(0.6, 2.0)
        new["armature"][j] += size
    name = "target_delay" if family == "target_delay_joint" else family
    entry = {"family": name, "kind": place[0], "name": place[1], "size": float(size)}
    return dataclasses.replace(truth, **new), entry


def nominal_run(
    robot: Robot, told: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Of the sound robot: torque and speed that it needs at most, typical torque, and inertia of each joint."""
    run = simulate(robot, Truth.sound(robot), told, _TOLD, 1000, 500, 1e-6)
    speed = np.abs(np.gradient(run["qpos"], run["time"], axis=0))
    model = mujoco.MjModel.from_xml_string(robot.xml)
    data, full = mujoco.MjData(model), np.zeros((model.nv, model.nv))
    data.qpos[:] = robot.middle
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, full)
    torque = run["tau"]
    inertia = np.diagonal(full).copy()
    typical = np.sqrt(np.mean(torque**2, axis=0)) + 0.1 * inertia * 20.0
    return (
        np.percentile(np.abs(torque), 99.5, axis=0),
        np.percentile(speed, 99.5, axis=0),
        typical,
        inertia,
    )


@dataclass
class Drawn:
    """A robot with all that is hidden in it, and what it is told."""

    robot: Robot
    kind: str
    truths: list[Truth]
    """Before the first odd effect, and after each."""
    entries: list[dict]
    """The odd effects, as truth.json has them."""
    told: tuple[np.ndarray, np.ndarray]
    loop_hz: int
    log_hz: int
    counts: float

    def log(self, which: int, effects: int | None = None) -> dict[str, np.ndarray]:
        """The log of motion 0 or 1, of the robot with its first `effects` odd effects, else all; `Unstable`."""
        return self.run(self.truths[-1 if effects is None else effects], which)

    def run(self, truth: Truth, which: int, seconds: float = np.inf) -> dict[str, np.ndarray]:
        """The same of any robot, the first `seconds` of it; `Unstable`."""
        told = self.told[which]
        told = told[: int(min(seconds / _TOLD, len(told) - 1)) + 1]
        rates = self.loop_hz, self.log_hz
        return simulate(self.robot, truth, told, _TOLD, *rates, self.counts)

    def said(self) -> dict:
        """What truth.json holds."""
        numbers = {k: v.tolist() for k, v in vars(self.truths[-1]).items() if k != "mass"}
        return {
            "robot": self.robot.name, "kind": self.kind, "loop_hz": self.loop_hz, "log_hz": self.log_hz,
            "effects": self.entries,
            "numbers": {k: [x if np.isfinite(x) else None for x in v] for k, v in numbers.items()},
        }  # fmt: skip


def without_torque(log: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The log of a drive that says none."""
    return {k: v for k, v in log.items() if k != "tau"}


def drawn(number: int, rng: np.random.Generator, robot: Robot, seconds: float) -> Drawn:
    """What log `number` holds, on this robot."""
    kind = KINDS[number % len(KINDS)]
    told = targets(robot, seconds, rng, _TOLD), targets(robot, seconds, rng, _TOLD)
    asked, fastest, typical, inertia = nominal_run(robot, told[0])
    truth, effects = Truth.sound(robot), []
    if kind == "single" and number % 3 == 1 and rng.random() < 0.5:
        effects = [str(rng.choice(ALONE))]
        kind = "alone"
    else:
        if kind != "sound":
            truth = ordinary(robot, truth, typical, inertia, rng)
        effects = [str(x) for x in rng.permutation(ODD)[: {"single": 1, "pair": 2}.get(kind, 0)]]
        if kind == "single":
            effects = [ODD[(number // 2) % len(ODD)]]
    truths, entries = [truth], []
    for family in effects:
        truth, entry = add(robot, truths[-1], family, asked, fastest, typical, rng)
        truths.append(truth)
        entries.append(entry)
    if kind == "alone":
        rng.permutation(ODD)  # As of every other log: what is drawn after it keeps its place.
    loop_hz = int(rng.choice([500, 1000]))
    log_hz, counts = int(rng.choice([200, 500])), 2 * np.pi / 2**14
    return Drawn(robot, kind, truths, entries, told, loop_hz, log_hz, counts)
