"""A log as the baselines see it: plain low-pass filters, MuJoCo's own inverse dynamics, one column for each guess.

The missing torque is y = mj_inverse(q, v, a) − τ − Jᵀλ, without whitening, weighting or nuisances. Nothing here
imports the package under test.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from scipy import signal

CUTOFF = 10.0  # Hz
GRID, KEPT = 250.0, 50.0  # Hz: where physics is evaluated, where fits are made
EDGE = 0.3  # s at both ends
SIGN = 0.01  # rad/s


def smooth(x: np.ndarray, rate: float) -> np.ndarray:
    """Zero-phase low-pass along the leading axis."""
    return signal.sosfiltfilt(signal.butter(3, CUTOFF, fs=rate, output="sos"), x, axis=0)


@dataclass(frozen=True, eq=False)
class Guess:
    """A linear family at a place: e = columns θ, and θ in the field's terms."""

    family: str
    kind: str
    name: str
    columns: np.ndarray
    """(R, nv, k), low-passed."""
    parameters: Callable[[np.ndarray], dict[str, float]]
    least: tuple[float, ...] = ()
    """Lower bounds of θ, where there are any: loads and friction are not negative."""

    def possible(self, theta: np.ndarray) -> bool:
        """Whether θ is within its bounds."""
        return not self.least or bool(np.all(theta >= np.array(self.least)))

    def effect(self, theta: np.ndarray) -> dict:
        """As in report.json; baselines state no intervals."""
        return as_effect(self.family, self.kind, self.name, self.parameters(theta))


def as_effect(family: str, kind: str, name: str, parameters: dict[str, float]) -> dict:
    """An effect of report.json, without what baselines do not know."""
    return {
        "family": family,
        "location": {"kind": kind, "name": name},
        "parameters": {
            n: {"value": float(x), "ci95": [float("nan")] * 2} for n, x in parameters.items()
        },
        "equivalent": [],
        "probability": None,
    }


class Residual:
    """One log's missing torque; arrays on the fast grid have T samples, finished ones R."""

    def __init__(self, model: mujoco.MjModel, log: dict[str, np.ndarray]):
        self.model: mujoco.MjModel = model
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
        self.data = mujoco.MjData(model)
        rate = 1.0 / float(np.median(np.diff(log["time"])))
        step = max(1, round(rate / GRID))
        self.rate = rate / step
        joints = [model.joint(str(name)) for name in log["joint_names"]]
        self.joints = {j.name: (int(j.dofadr[0]), int(j.qposadr[0])) for j in joints}
        dofs = [int(j.dofadr[0]) for j in joints]
        q = np.tile(model.qpos0, (len(log["time"]), 1))
        v = np.zeros((len(q), model.nv))
        moving = smooth(log["qpos"], rate)
        q[:, [int(j.qposadr[0]) for j in joints]] = moving
        v[:, dofs] = np.gradient(moving, 1.0 / rate, axis=0)
        self.floating = "base_pos" in log
        if self.floating:
            quat = (
                log["base_quat"]
                * np.sign(np.sum(log["base_quat"] * log["base_quat"][0], axis=1))[:, None]
            )
            quat = smooth(quat, rate)
            q[:, :3] = smooth(log["base_pos"], rate)
            q[:, 3:7] = quat / np.linalg.norm(quat, axis=1, keepdims=True)
            v[:, :3], v[:, 3:6] = smooth(log["base_linvel"], rate), smooth(log["base_angvel"], rate)
        a = np.asarray(np.gradient(v, 1.0 / rate, axis=0))
        tau = np.zeros_like(v)
        tau[:, dofs] = smooth(log["tau"], rate)
        self.time = np.asarray(log["time"][::step])
        self.q: np.ndarray = q[::step]
        self.v: np.ndarray = v[::step]
        self.a: np.ndarray = a[::step]
        self.tau: np.ndarray = tau[::step]
        self.contacts = tuple(map(str, log.get("contact_bodies", ())))
        wrench = smooth(log["contact_wrench"], rate)[::step] if self.contacts else None
        self.contact = self._contact_rows(wrench)
        self.inverse = self.needed(self.q, self.v, self.a)
        edge, stride = round(EDGE * self.rate), max(1, round(self.rate / KEPT))
        self.kept = slice(edge, len(self.time) - edge, stride)
        self.missing = self.inverse - self.tau - self.contact.sum(axis=1)
        self.y = self.finish(self.missing)

    @classmethod
    def read(cls, folder: Path) -> Residual:
        """Of a folder with log.npz and nominal.xml."""
        with np.load(folder / "log.npz") as file:
            log = {name: file[name] for name in file.files}
        return cls(mujoco.MjModel.from_xml_path(str(folder / "nominal.xml")), log)

    def finish(self, x: np.ndarray) -> np.ndarray:
        """Low-passed and thinned out."""
        return smooth(x, self.rate)[self.kept]

    def needed(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        """Torque that the nominal model needs (T, nv), contacts apart."""
        out = np.empty_like(v)
        for k in range(len(q)):
            self.data.qpos[:], self.data.qvel[:], self.data.qacc[:] = q[k], v[k], a[k]
            mujoco.mj_inverse(self.model, self.data)
            out[k] = self.data.qfrc_inverse
        return out

    def _contact_rows(self, wrench: np.ndarray | None) -> np.ndarray:
        """Torque of each measured wrench (T, C, nv)."""
        out = np.zeros((len(self.q), len(self.contacts), self.model.nv))
        if wrench is None:
            return out
        bodies = [self.model.body(name).id for name in self.contacts]
        for k in range(len(self.q)):
            self.data.qpos[:] = self.q[k]
            mujoco.mj_kinematics(self.model, self.data)
            mujoco.mj_comPos(self.model, self.data)
            for c, body in enumerate(bodies):
                w = wrench[k, c]
                mujoco.mj_applyFT(
                    self.model, self.data, w[:3], w[3:], self.data.xpos[body], body, out[k, c]
                )
        return out

    def bodies(self) -> dict[str, int]:
        """Moving bodies with mass, by name."""
        m = self.model
        return {
            m.body(b).name: b
            for b in range(1, m.nbody)
            if m.body_mass[b] > 0 and m.body_weldid[b] != 0
        }

    def body_columns(self, bodies: list[int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(regressor of π (T, nv, B, 10), Jᵀ at the centre of mass (T, nv, B, 3), its velocity (T, B, 3))."""
        m, d = self.model, self.data
        size = (len(self.q), m.nv, len(bodies))
        regressor, rows = np.zeros((*size, 10)), np.zeros((*size, 3))
        speed = np.zeros((len(self.q), len(bodies), 3))
        jp, jr = np.zeros((3, m.nv)), np.zeros((3, m.nv))
        velocity, acceleration = np.zeros(6), np.zeros(6)
        frame = mujoco.mjtObj.mjOBJ_XBODY
        for k in range(len(self.q)):
            d.qpos[:], d.qvel[:], d.qacc[:] = self.q[k], self.v[k], self.a[k]
            mujoco.mj_inverse(m, d)
            mujoco.mj_rnePostConstraint(m, d)
            for i, b in enumerate(bodies):
                mujoco.mj_jacBodyCom(m, d, jp, None, b)
                rows[k, :, i], speed[k, i] = jp.T, jp @ self.v[k]
                mujoco.mj_jacBody(m, d, jp, jr, b)
                mujoco.mj_objectVelocity(m, d, frame, b, velocity, 1)
                mujoco.mj_objectAcceleration(m, d, frame, b, acceleration, 1)
                force, moment = newton_euler(velocity[:3], acceleration[:3], acceleration[3:])
                rotation = d.xmat[b].reshape(3, 3)
                regressor[k, :, i] = jp.T @ rotation @ force + jr.T @ rotation @ moment
        return regressor, rows, speed


def skew(x: np.ndarray) -> np.ndarray:
    """[x]×."""
    return np.array([[0, -x[2], x[1]], [x[2], 0, -x[0]], [-x[1], x[0], 0]])


def _inertia(x: np.ndarray) -> np.ndarray:
    """I x as a matrix on (Ixx, Ixy, Ixz, Iyy, Iyz, Izz)."""
    a, b, c = x
    return np.array([[a, b, c, 0, 0, 0], [0, a, 0, b, c, 0], [0, 0, a, 0, b, c]])


def newton_euler(w: np.ndarray, dw: np.ndarray, a: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Force and moment at a body's origin as matrices (3, 10) on [m, h, I]; a is the origin's, gravity taken off."""
    turn = skew(dw) + skew(w) @ skew(w)
    force = np.concatenate([a[:, None], turn, np.zeros((3, 6))], axis=1)
    moment = np.concatenate(
        [np.zeros((3, 1)), -skew(a), _inertia(dw) + skew(w) @ _inertia(w)], axis=1
    )
    return force, moment


def body_pi(model: mujoco.MjModel, body: int) -> np.ndarray:
    """[m, h, I] of a body about its frame origin (10,)."""
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, model.body_iquat[body])
    r, m, c = rotation.reshape(3, 3), model.body_mass[body], model.body_ipos[body]
    i = r @ np.diag(model.body_inertia[body]) @ r.T + m * (c @ c * np.eye(3) - np.outer(c, c))
    return np.array([m, *(m * c), *i[np.triu_indices(3)]])
