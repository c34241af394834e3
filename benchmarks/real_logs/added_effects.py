"""What one more effect would do to the torques of a recorded robot that moves as it did; MuJoCo C, nothing of ours.

A robot with an effect needs other torques for the same motion. Effects of bodies are differences of two inverse
dynamics, those of drives and joints closed forms, evaluated on positions below 12 Hz. An effect is its torque by its
size.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from scipy import signal

# Below this [Hz] positions are motion, and residuals are compared.
BAND = 12.0
# Path [rad] within which dry friction turns over.
PRESLIDING = 5e-4


class Recording:
    """A log of a fixed-base robot as MuJoCo C sees it; arrays (T, n)."""

    def __init__(self, model: Path, time: np.ndarray, qpos: np.ndarray, tau: np.ndarray):
        self.spec = mujoco.MjSpec.from_file(str(model))
        self.model = self._compiled(self.spec)
        self.time, self.tau = time, tau
        self.q = self.below(qpos)
        self.v = np.gradient(self.q, time, axis=0)
        self.a = np.gradient(self.v, time, axis=0)
        self.modelled = self.needed(self.model)
        """What the model needs [N m]."""
        self.missing = self.below(self.modelled - tau)
        """What the robot needs beyond its model [N m]."""

    @staticmethod
    def _compiled(spec: mujoco.MjSpec) -> mujoco.MjModel:
        model = spec.compile()
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
        return model

    def below(self, x: np.ndarray) -> np.ndarray:
        rate = 1.0 / np.median(np.diff(self.time))
        return signal.sosfiltfilt(signal.butter(2, BAND, fs=rate, output="sos"), x, axis=0)

    def needed(self, model: mujoco.MjModel) -> np.ndarray:
        """Inverse dynamics of the motion [N m]."""
        data, out = mujoco.MjData(model), []
        for q, v, a in zip(self.q, self.v, self.a, strict=True):
            data.qpos[:], data.qvel[:], data.qacc[:] = q, v, a
            mujoco.mj_inverse(model, data)
            out.append(data.qfrc_inverse.copy())
        return np.array(out)

    def edited(self, edit: Callable[[mujoco.MjSpec], None]) -> np.ndarray:
        """What the motion needs more once the model is edited."""
        spec = self.spec.copy()
        edit(spec)
        return self.needed(self._compiled(spec)) - self.modelled

    def pulled(self, body: int, force: np.ndarray) -> np.ndarray:
        """What balances a force on a body's centre of mass, in world axes."""
        data, jac, out = mujoco.MjData(self.model), np.zeros((3, self.model.nv)), []
        for q in self.q:
            data.qpos[:] = q
            mujoco.mj_kinematics(self.model, data)
            mujoco.mj_comPos(self.model, data)
            mujoco.mj_jacBodyCom(self.model, data, jac, None, body)
            out.append(-jac.T @ force)
        return np.array(out)

    def rubbed(self, row: int) -> np.ndarray:
        """Dahl's friction of 1 N m on one row: bristles that bend along the path."""
        out = np.zeros(len(self.q))
        for k, path in enumerate(np.diff(self.q[:, row]), start=1):
            side = np.sign(path)
            out[k] = side + (out[k - 1] - side) * np.exp(-abs(path) / PRESLIDING)
        return out


@dataclass(frozen=True)
class Effect:
    """One effect at its place, as the report names them, and the number whose size is asked."""

    family: str
    place: str
    number: str
    torque: Callable[[Recording, float], np.ndarray]
    """Of a recording and a size: what is logged more (T, n) [N m]."""
    value: Callable[[float], float] = float
    """The number of a size."""


def on(row: int, law: Callable[[Recording, float], np.ndarray]) -> Callable:
    """A torque on one row."""

    def torque(r: Recording, size: float) -> np.ndarray:
        out = np.zeros_like(r.tau)
        out[:, row] = law(r, size)
        return out

    return torque


def of_joint(family: str, joint: str, row: int, rng: np.random.Generator) -> Effect:
    """An effect of a joint or its drive."""
    side, rest = float(rng.choice([-1.0, 1.0])), float(rng.uniform(-1.0, 1.0))
    values = {"torque_bias": lambda s: s * side, "torque_gain": lambda s: 1.0 + s * side}
    number, law = {
        "coulomb_friction": ("coulomb", lambda r, s: s * r.rubbed(row)),
        "viscous_friction": ("damping", lambda r, s: s * r.v[:, row]),
        "armature": ("armature", lambda r, s: s * r.a[:, row]),
        "joint_spring": ("stiffness", lambda r, s: s * (r.q[:, row] - rest)),
        "torque_bias": ("bias", lambda r, s: np.full(len(r.q), -s * side)),
        # The drive gives (1 + s) of what is logged.
        "torque_gain": ("gain", lambda r, s: -s * side / (1.0 + s * side) * r.tau[:, row]),
        # What acts now was logged s seconds ago.
        "time_delay": (
            "delay",
            lambda r, s: np.interp(r.time + s, r.time, r.tau[:, row]) - r.tau[:, row],
        ),
    }[family]
    return Effect(family, joint, number, on(row, law), values.get(family, float))


def of_body(family: str, name: str, body: int, rng: np.random.Generator) -> Effect:
    """An effect of a body."""
    if family == "constant_force":
        direction = rng.normal(size=3)
        direction /= np.linalg.norm(direction)
        return Effect(family, name, "force", lambda r, s: s * r.pulled(body, direction))
    com = rng.normal(0.0, 0.04, 3)

    def torque(r: Recording, s: float) -> np.ndarray:
        def edit(spec: mujoco.MjSpec) -> None:
            load = spec.body(name).add_body(pos=r.model.body_ipos[body] + com)
            load.explicitinertial, load.mass, load.inertia = True, s, np.full(3, 2e-3 * s)
            load.ipos = np.zeros(3)  # unset, it is taken to be `pos`

        return r.edited(edit)

    return Effect(family, name, "mass", torque)


JOINT = (
    *("coulomb_friction", "viscous_friction", "armature", "joint_spring"),
    *("torque_bias", "torque_gain", "time_delay"),
)
BODY = ("payload", "constant_force")


def draw(family: str, r: Recording, rng: np.random.Generator) -> Effect:
    """An effect of a family somewhere on the robot: on a joint, or on a body beyond the first joint."""
    if family in JOINT:
        row = int(rng.integers(r.model.nv))
        return of_joint(family, r.model.joint(row).name, row, rng)
    bodies = [b for b in range(2, r.model.nbody) if r.model.body_mass[b] > 0.05]
    body = int(rng.choice(bodies))
    return of_body(family, r.model.body(body).name, body, rng)


def sized(effect: Effect, r: Recording, ratio: float) -> float:
    """The size that adds `ratio` times what the model misses (rms) on the row where it is loudest beside that."""
    gap = np.sqrt(np.mean(r.missing**2, axis=0))
    gap = np.maximum(gap, 1e-3 * gap.max())  # a joint that nothing turns
    size = 0.01
    for _ in range(4):  # nearly linear
        loud = np.sqrt(np.mean(r.below(effect.torque(r, size)) ** 2, axis=0))
        size *= ratio / float((loud / gap).max())
    return size
