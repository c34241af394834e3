"""Faults of a log's meaning: what people get wrong before any effect is worth looking for.

Each turns the log of a robot as it is bought into what its owner would have recorded: torque without gravity, amperes,
the motor's side of a gear, a channel that is late, a turned sign, two columns exchanged, degrees, a zero elsewhere. A
turned mount is simulated (`Setting.mount`), and here only the model's gravity tells another story.
"""

from __future__ import annotations

import mujoco
import numpy as np

from benchmarks.worlds.dynamics import inverse_dynamics
from benchmarks.worlds.robots import Robot

Log = dict[str, np.ndarray]

FAULTS = (
    *("no_gravity", "amperes", "motor_side", "late_torque", "turned_sign", "other_order"),
    *("degrees", "other_zero", "turned_mount"),
)


def mount(robot: Robot, rng: np.random.Generator) -> np.ndarray:
    """Gravity of a robot on a wall, on a ceiling or on a slope of 20 to 60 degrees, in the base's axes [m/s²]."""
    gravity = robot.model().opt.gravity.copy()
    angle = rng.choice([np.pi / 2, np.pi, rng.uniform(0.35, 1.05)])
    about = rng.uniform(0, 2 * np.pi) if rng.random() < 0.5 else rng.choice([0.0, np.pi / 2])
    axis = np.array([np.cos(about), np.sin(about), 0.0])
    turned = gravity * np.cos(angle) + np.cross(axis, gravity) * np.sin(angle)
    return turned + axis * (axis @ gravity) * (1.0 - np.cos(angle))


def misread(log: Log, fault: str, robot: Robot, seed: list[int]) -> Log:
    """The log as it was recorded under the fault; the same one for every log of this seed."""
    rng = np.random.default_rng(seed)
    out = {name: np.array(x) for name, x in log.items()}
    names = [str(x) for x in log["joint_names"]]
    columns = [robot.joints.index(name) for name in names]
    if fault == "turned_mount":
        return out
    {
        "no_gravity": _no_gravity,
        "amperes": _amperes,
        "motor_side": _motor_side,
        "late_torque": _late,
        "turned_sign": _turned,
        "other_order": _exchanged,
        "degrees": _degrees,
        "other_zero": _zero,
    }[fault](out, robot, columns, rng)
    return out


def _scale_torque(out: Log, factor) -> None:
    for name in ("tau", "sigma_tau"):
        if name in out:
            out[name] = out[name] * factor


def _no_gravity(out: Log, robot: Robot, columns: list[int], rng) -> None:
    still = np.zeros((len(out["qpos"]), len(columns)))
    q = np.empty_like(still)
    q[:, columns] = out["qpos"]
    out["tau"] = out["tau"] - inverse_dynamics(robot.model(), q, still, still)[:, columns]


def _amperes(out: Log, robot: Robot, columns: list[int], rng) -> None:
    constant = np.exp(
        rng.uniform(np.log(4.0), np.log(20.0), len(robot.joints))
    )  # N m/A at the joint
    _scale_torque(out, 1.0 / constant[columns])


def _motor_side(out: Log, robot: Robot, columns: list[int], rng) -> None:
    _scale_torque(out, 1.0 / float(rng.choice([9.0, 25.0, 50.0, 100.0, 160.0])))


def _late(out: Log, robot: Robot, columns: list[int], rng) -> None:
    rate = 1.0 / float(np.median(np.diff(out["time"])))
    rows = max(1, round(float(np.exp(rng.uniform(np.log(0.04), np.log(0.25)))) * rate))
    if rng.random() < 0.5:  # the torque is stamped late, or the encoders are
        out["tau"] = np.concatenate([np.repeat(out["tau"][:1], rows, 0), out["tau"][:-rows]])
        return
    for name in ("qpos", "qvel"):
        if name in out:
            out[name] = np.concatenate([np.repeat(out[name][:1], rows, 0), out[name][:-rows]])


def _turned(out: Log, robot: Robot, columns: list[int], rng) -> None:
    signs = np.ones(len(robot.joints))
    signs[_carrying(robot)[-1] if rng.random() < 0.7 else slice(None)] = -1.0
    out["tau"] = out["tau"] * signs[columns]


def _exchanged(out: Log, robot: Robot, columns: list[int], rng) -> None:
    first, second = _carrying(robot)[-2:] if len(robot.joints) > 1 else (0, 0)
    a, b = columns.index(first), columns.index(second)
    for name in ("tau", "sigma_tau"):
        if name in out:
            out[name][..., [a, b]] = out[name][..., [b, a]]


def _degrees(out: Log, robot: Robot, columns: list[int], rng) -> None:
    for name in ("qpos", "qvel", "sigma_qpos"):
        if name in out:
            out[name] = np.rad2deg(out[name])


def _zero(out: Log, robot: Robot, columns: list[int], rng) -> None:
    joint = columns.index(_carrying(robot)[-1])
    out["qpos"][:, joint] += float(rng.choice([-1.0, 1.0])) * float(rng.choice([np.pi / 2, np.pi]))


def _carrying(robot: Robot) -> list[int]:
    """Joints by the gravity torque that their links ask for, the least first."""
    model = robot.model()
    rng, need = np.random.default_rng(0), np.zeros(model.nv)
    data = mujoco.MjData(model)
    for _ in range(40):
        data.qpos[:] = rng.uniform(robot.lower, robot.upper)
        mujoco.mj_forward(model, data)
        need += data.qfrc_bias**2
    return [int(k) for k in np.argsort(need)]
