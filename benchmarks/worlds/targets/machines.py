"""Position-controlled robots with one thing hidden, for the closed-loop likelihood: another plant than the fit's.

MuJoCo C in steps of 0.25 ms; dry friction by bristles (Dahl 1968) with a tenth more at rest, where the fit's is
MuJoCo's constraint; a loop that samples quantised encoders and holds its torque, where the fit's is continuous; targets
that jump at 50 Hz. Shares no code with the package.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import mujoco
import numpy as np

STEP = 2.5e-4
_BRISTLE = 3e-4  # Displacement over which friction turns round [rad].
_AT_REST, _SLOW = (
    0.1,
    0.03,
)  # Friction at rest beyond that in motion, and the speed that it goes with [rad/s].
COUNT = 2.0 * np.pi / 2**14


@dataclass(frozen=True)
class Machine:
    """A robot's model, its loop, and how its targets move."""

    name: str
    xml: str
    joints: tuple[str, ...]
    kp: np.ndarray
    kd: np.ndarray
    middle: np.ndarray
    swing: np.ndarray
    loop_hz: int
    log_hz: int


@dataclass
class Hidden:
    """What the robot has beyond its model, joint by joint."""

    friction: np.ndarray | float = 0.0
    kp: np.ndarray | float = 1.0
    motor: np.ndarray | float = 1.0
    rotor: np.ndarray | float = 0.0
    delay: float = 0.0
    mass: dict[str, float] = field(default_factory=dict)


def _chain(parts) -> str:
    inside = ""
    for name, pos, axis, mass, com, inertia, rotor, damping, dry in reversed(parts):
        numbers = (" ".join(f"{x:g}" for x in v) for v in (pos, axis, com, inertia))
        pos, axis, com, inertia = numbers
        inside = (
            f'<body name="{name}_link" pos="{pos}"><joint name="{name}" axis="{axis}" armature="{rotor}" '
            f'damping="{damping}" frictionloss="{dry}"/><inertial pos="{com}" mass="{mass}" diaginertia="{inertia}"/>'
            f"{inside}</body>"
        )
    return inside


def _model(inside: str) -> str:
    return f'<mujoco><option timestep="0.001"/><worldbody>{inside}</worldbody></mujoco>'


def _leg_parts(prefix: str, at, side: float):
    return [
        (f"{prefix}abduct", at, (1, 0, 0), 0.8, (0.01, 0.02 * side, 0), (8e-4, 9e-4, 7e-4), 0.006, 0.02, 0.08),
        (f"{prefix}hip", (0, 0.08 * side, 0), (0, 1, 0), 1.2, (0, 0.02 * side, -0.05), (7e-3, 6e-3, 1e-3), 0.006, 0.02,
         0.08),
        (f"{prefix}knee", (0, 0, -0.22), (0, 1, 0), 0.3, (0, 0, -0.1), (2.4e-3, 2.4e-3, 1e-4), 0.006, 0.02, 0.08),
    ]  # fmt: skip


def leg() -> Machine:
    """One leg of a quadruped, its base held: a loop of 1 kHz, logged at 500 Hz."""
    parts = _leg_parts("", (0, 0, 0), 1.0)
    return Machine(
        "leg", _model(_chain(parts)), tuple(p[0] for p in parts), np.full(3, 28.0), np.full(3, 0.9),
        np.array([0.0, 0.7, -1.4]), np.array([0.3, 0.5, 0.6]), 1000, 500,
    )  # fmt: skip


def rig() -> Machine:
    """A servo that swings a bar: 4096 counts a turn are rounded finer here, a loop of 500 Hz, logged at 100 Hz."""
    parts = [
        ("servo", (0, 0, 0), (0, 1, 0), 0.4, (0, 0, -0.12), (2e-3, 2e-3, 1e-4), 0.005, 0.02, 0.05)
    ]
    return Machine(
        "rig", _model(_chain(parts)), ("servo",), np.array([9.0]), np.array([0.3]), np.array([0.3]), np.array([0.9]),
        500, 100,
    )  # fmt: skip


def arm() -> Machine:
    """An arm like a UR5e: six joints, stiff loops of 500 Hz, logged at 500 Hz."""
    parts = [
        ("pan", (0, 0, 0.16), (0, 0, 1), 3.7, (0, -0.02, 0), (0.010, 0.010, 0.007), 0.4, 3.0, 4.0),
        ("lift", (0, 0.13, 0), (0, 1, 0), 8.4, (0, 0, 0.21), (0.13, 0.13, 0.015), 0.4, 3.0, 4.0),
        ("elbow", (0, -0.12, 0.425), (0, 1, 0), 2.3, (0, 0, 0.2), (0.031, 0.031, 0.004), 0.3, 2.0, 2.0),
        ("wrist1", (0, 0, 0.392), (0, 1, 0), 1.2, (0, 0.1, 0), (2.6e-3, 2.6e-3, 2.2e-3), 0.1, 1.0, 0.8),
        ("wrist2", (0, 0.1, 0), (0, 0, 1), 1.2, (0, 0, 0.08), (2.6e-3, 2.6e-3, 2.2e-3), 0.1, 1.0, 0.8),
        ("wrist3", (0, 0, 0.1), (0, 1, 0), 0.25, (0.01, 0.05, 0), (1e-4, 1e-4, 1.3e-4), 0.1, 1.0, 0.5),
    ]  # fmt: skip
    return Machine(
        "arm", _model(_chain(parts)), tuple(p[0] for p in parts), np.array([2000.0, 2500, 2000, 500, 500, 400]),
        np.array([200.0, 250, 200, 40, 40, 30]), np.array([0.2, -0.6, 0.9, 0.1, 0.4, 0.0]),
        np.array([0.6, 0.4, 0.5, 0.6, 0.6, 0.6]), 500, 500,
    )  # fmt: skip


def quadruped() -> Machine:
    """Four legs on a base that is held: 12 joints, loops of 1 kHz, logged at 200 Hz."""
    inside, names = "", []
    for prefix, at, side in (("fl_", (0.2, 0.05, 0), 1.0), ("fr_", (0.2, -0.05, 0), -1.0),
                             ("rl_", (-0.2, 0.05, 0), 1.0), ("rr_", (-0.2, -0.05, 0), -1.0)):  # fmt: skip
        parts = _leg_parts(prefix, at, side)
        inside += _chain(parts)
        names += [p[0] for p in parts]
    return Machine(
        "quadruped", _model(inside), tuple(names), np.full(12, 28.0), np.full(12, 0.9), np.tile([0.0, 0.7, -1.4], 4),
        np.tile([0.3, 0.5, 0.6], 4), 1000, 200,
    )  # fmt: skip


def at(machine: Machine, joint: str, value: float, others: float = 0.0) -> np.ndarray:
    """A number of one joint, and another one of all others."""
    return np.array([value if x == joint else others for x in machine.joints])


MACHINES = {"leg": leg, "rig": rig, "arm": arm, "quadruped": quadruped}
CASES = {
    "leg/sound": lambda m: Hidden(),
    "rig/sound": lambda m: Hidden(),
    "arm/sound": lambda m: Hidden(),
    "quadruped/sound": lambda m: Hidden(),
    "leg/friction": lambda m: Hidden(friction=at(m, "knee", 0.8)),
    "leg/kp": lambda m: Hidden(kp=at(m, "hip", 0.75, 1.0)),
    "leg/motor": lambda m: Hidden(motor=at(m, "knee", 0.8, 1.0)),
    "leg/delay": lambda m: Hidden(delay=0.02),
    "leg/load": lambda m: Hidden(mass={"knee_link": 0.2}),
    "rig/friction": lambda m: Hidden(friction=0.10),
    "arm/friction": lambda m: Hidden(friction=at(m, "elbow", 4.0)),
    "arm/rotor": lambda m: Hidden(rotor=0.08),
    "quadruped/motor": lambda m: Hidden(motor=0.85),
}  # fmt: skip
"""Name: what is hidden, by machine."""


def targets(machine: Machine, seconds: float, seed: int) -> np.ndarray:
    """Positions told at 50 Hz: sines, steps, and stretches at rest."""
    rng, n = np.random.default_rng(seed), len(machine.joints)
    t = np.arange(0.0, seconds + 0.02, 0.02)
    told = np.zeros((len(t), n))
    for _ in range(4):
        f, phase = rng.uniform(0.15, 1.8, n), rng.uniform(0, 2 * np.pi, n)
        told += rng.uniform(0.2, 0.8, n) / (1 + f) * np.sin(2 * np.pi * np.outer(t, f) + phase)
    told += 0.4 * np.repeat(rng.normal(size=(len(t) // 45 + 1, n)), 45, axis=0)[: len(t)]
    for first in rng.uniform(0.15, 0.9, max(int(seconds / 5), 1)) * len(t):
        told[int(first) : int(first) + 35] = told[int(first)]
    told *= np.minimum(t / 0.4, 1.0)[:, None]
    return machine.middle + machine.swing * told / np.abs(told).max(axis=0)


def simulated(machine: Machine, hidden: Hidden, seconds: float = 10.0, seed: int = 0) -> dict:
    """A log as arrays: time, joint_names, qpos, qpos_target, kp, kd; `truth` has the positions before the encoder."""
    model = mujoco.MjModel.from_xml_string(machine.xml)
    model.opt.timestep, n = STEP, len(machine.joints)
    dry = model.dof_frictionloss + hidden.friction
    model.dof_frictionloss[:] = 0.0
    model.dof_armature[:] += hidden.rotor
    for name, mass in hidden.mass.items():
        b = model.body(name).id
        share = 1.0 + mass / model.body_mass[b]
        model.body_mass[b] *= share
        model.body_inertia[b] *= share
    mujoco.mj_setConst(model, mujoco.MjData(model))
    data, told = mujoco.MjData(model), targets(machine, seconds, seed)
    data.qpos[:] = told[0]
    kp, kd = machine.kp * hidden.kp, machine.kd
    z, given, rows = np.zeros(n), np.zeros(n), []
    every, log_every = round(1 / machine.loop_hz / STEP), round(1 / machine.log_hz / STEP)
    # The loop and the log run on clocks of their own.
    first = every // 2
    for k in range(int(seconds / STEP)):
        t = k * STEP
        seen = np.round(data.qpos / COUNT) * COUNT
        if k % log_every == 0:
            rows.append((t, *seen, *told[int(t / 0.02 + 1e-9)], *data.qpos))
        if k % every == first % every:
            now = told[max(int((t - hidden.delay) / 0.02 + 1e-9), 0)]
            given = hidden.motor * (kp * (now - seen) - kd * data.qvel)
        speed = data.qvel
        size = 1.0 + _AT_REST * np.exp(-((speed / _SLOW) ** 2))
        end, stays = np.sign(speed) * size, np.exp(-np.abs(speed) * STEP / (_BRISTLE * size))
        new = end + (z - end) * stays
        rub = dry * (new + 0.02 * (new - z) / (STEP * 50.0))
        z = new
        data.qfrc_applied[:] = given - rub
        mujoco.mj_step(model, data)
    x = np.array(rows)
    return {
        "time": x[:, 0], "joint_names": np.array(machine.joints), "qpos": x[:, 1 : 1 + n],
        "qpos_target": x[:, 1 + n : 1 + 2 * n], "kp": machine.kp, "kd": machine.kd, "truth": x[:, 1 + 2 * n :],
    }  # fmt: skip


def case(name: str, seconds: float = 10.0, seed: int = 0) -> tuple[Machine, dict, dict]:
    """(machine, log, log of another motion) of a case."""
    machine = MACHINES[name.split("/")[0]]()
    hidden = CASES[name](machine)
    return (
        machine,
        simulated(machine, hidden, seconds, seed),
        simulated(machine, hidden, seconds, seed + 100),
    )
