"""A robot with a hidden effect, made in MuJoCo C: which one, where and how large is the seed's secret.

The model that the diagnosis gets is the arm's own; the plant that makes the data has one thing more. Friction is a
bristle here, a delay is a buffer: not the equations that are fitted.
"""

import dataclasses
from collections.abc import Callable

import mujoco
import numpy as np

from jax_inertia.cli.demo.simulation import (
    SIGMA_Q,
    Load,
    Scenario,
    computed_torque,
    path,
    with_load,
)
from jax_inertia.logs.log import Log, TorqueKind
from jax_inertia.robots.arm import HAND, arm_mjcf

_PERIOD, _SUBSTEPS = 2e-3, 4
_SIGMA_TAU = 0.002  # of each joint's peak
_BRISTLE = 3e-4  # rad
_STEEL = 7850.0  # kg/m³, of the cube that the hand holds


@dataclasses.dataclass(frozen=True)
class Secret:
    """What the plant has and the model has not."""

    family: str
    place: str
    size: float
    """The family's first reported number."""
    unit: str

    def __str__(self) -> str:
        where = "" if self.place == "global" else f" at {self.place}"
        return f"{self.family.replace('_', ' ')}{where}, {self.size:.3g} {self.unit}".rstrip(" 1")


@dataclasses.dataclass(frozen=True)
class Case:
    """Two logs of one plant on two motions, the model, and the secret."""

    log: Log
    test_log: Log
    model_xml: str
    secret: Secret


def draw(seed: int, duration: float = 9.0) -> Case:
    """Draw an effect, make its plant, and record two motions; the same seed gives the same data."""
    rng = np.random.default_rng([seed, 2])
    xml = arm_mjcf()
    bare = mujoco.MjModel.from_xml_string(xml)
    motions = [Scenario(duration, 99.0, 99.0, seed=1000 + 2 * seed + k) for k in (0, 1)]
    peak, speed = _demand(bare, motions[0])
    family = str(rng.choice(list(_UNITS)))
    joint = int(rng.integers(bare.nv))
    size = _size(family, float(rng.uniform()), float(peak[joint]), float(speed[joint]))
    elsewhere = {"payload": HAND, "time_delay": "global"}
    place = elsewhere[family] if family in elsewhere else str(bare.joint(joint).name)
    secret = Secret(family, place, size, _UNITS[family])
    first, second = (
        _record(xml, secret, joint, motion, peak, np.random.default_rng([seed, 3 + k]))
        for k, motion in enumerate(motions)
    )
    return Case(first, second, xml, secret)


_UNITS = {
    "viscous_friction": "N m s/rad",
    "coulomb_friction": "N m",
    "armature": "kg m²",
    "joint_spring": "N m/rad",
    "torque_gain": "1",
    "torque_bias": "N m",
    "time_delay": "s",
    "payload": "kg",
}


def _size(family: str, u: float, peak: float, speed: float) -> float:
    """Of usual size, by a number u in [0, 1]."""
    match family:
        case "viscous_friction":
            return (0.05 + 0.1 * u) * peak / speed
        case "coulomb_friction":
            return (0.05 + 0.07 * u) * peak
        case "armature":
            return 0.05 + 0.1 * u
        case "joint_spring":
            return (0.1 + 0.2 * u) * peak
        case "torque_gain":
            return 0.82 + 0.1 * u
        case "torque_bias":
            return (0.05 + 0.05 * u) * peak
        case "time_delay":
            return 0.004 + 0.01 * u
        case _:
            return 0.4 + 1.5 * u


def _demand(model: mujoco.MjModel, scenario: Scenario) -> tuple[np.ndarray, np.ndarray]:
    """Peak torque and speed of each joint along a motion."""
    data, at = mujoco.MjData(model), path(scenario, model.nv)
    torques, speeds = [], []
    for t in np.arange(0.0, scenario.duration, 0.02):
        data.qpos, data.qvel, data.qacc = at(t)
        mujoco.mj_inverse(model, data)
        torques.append(np.abs(data.qfrc_inverse))
        speeds.append(np.abs(data.qvel))
    return np.max(torques, axis=0), np.max(speeds, axis=0)


def _record(
    xml: str,
    secret: Secret,
    joint: int,
    scenario: Scenario,
    peak: np.ndarray,
    rng: np.random.Generator,
) -> Log:
    bare = mujoco.MjModel.from_xml_string(xml)
    model = mujoco.MjModel.from_xml_string(xml)
    if secret.family == "payload":
        edge = (secret.size / _STEEL) ** (1 / 3)
        model = with_load(xml, Load(secret.size, edges=(edge, edge, edge)))
    elif secret.family == "armature":
        model.dof_armature[joint] += secret.size
    controller, plant = mujoco.MjData(bare), mujoco.MjData(model)
    at = path(scenario, bare.nv)
    plant.qpos, plant.qvel = at(0.0)[:2]
    step = model.opt.timestep
    act = _effect(secret, joint, step, bare.nv)
    rows: list[tuple] = []
    for k in range(round(scenario.duration / _PERIOD)):
        q = plant.qpos + SIGMA_Q * rng.normal(size=bare.nq)
        u = computed_torque(bare, controller, q, plant.qvel, *at(k * _PERIOD))
        rows.append((plant.time, q, u + _SIGMA_TAU * peak * rng.normal(size=bare.nv)))
        for _ in range(_SUBSTEPS):
            plant.qfrc_applied[:] = act(plant.qpos, plant.qvel, u)
            mujoco.mj_step(model, plant)
    time, qpos, tau = (np.array(x) for x in zip(*rows, strict=True))
    names = tuple(bare.joint(j).name for j in range(bare.njnt))
    return Log(time=time, joint_names=names, qpos=qpos, tau=tau, tau_kind=TorqueKind.CURRENT)


def _effect(
    secret: Secret, joint: int, step: float, rows: int
) -> Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]:
    """(q, v, u) → the torque that really acts, once a step."""
    here = np.eye(rows)[joint]
    bristle = 0.0
    late = (
        [np.zeros(rows)] * max(1, round(secret.size / step))
        if secret.family == "time_delay"
        else []
    )

    def act(q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
        nonlocal bristle
        match secret.family:
            case "viscous_friction":
                return u - secret.size * here * v
            case "coulomb_friction":
                bristle = float(np.clip(bristle + v[joint] * step / _BRISTLE, -1, 1))
                return u - secret.size * bristle * here
            case "joint_spring":
                return u - secret.size * here * (q - 0.3)
            case "torque_gain":
                return u + (secret.size - 1) * here * u
            case "torque_bias":
                return u + secret.size * here
            case "time_delay":
                late.append(u.copy())
                return late.pop(0)
        return u

    return act
