"""A report's torque, computed again from what it says: families and numbers, MuJoCo C, NumPy; no package code.

The bodies (and gravity) are those of corrected.xml where there is one, else the nominal ones with the report's
payloads and shifts. All else comes from report.json: `joints` gives every joint's ordinary terms, `effects` the odd
ones. Dry friction is F tanh(v / 0.003), or Dahl's where the report states a `presliding` [rad] beside it. A prediction
is a pair: what reaches the joint of the logged torque (gain, limit, delay, lag), and what the joint needs. Families
that cannot be computed here are named in `left_out`: then the number is no check of the tool.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path

import mujoco
import numpy as np
from scipy.signal import lfilter

from benchmarks.exam.report_numbers import LAWS, dahl, law_torque, number, push_window, vector
from benchmarks.exam.torque_error import (
    SIGN,
    Signals,
    error_of,
    rigid,
    signals,
)
from benchmarks.worlds.effects import add_mass, editable, rotation_from_tilt

ORDINARY = ("viscous_friction", "coulomb_friction", "armature", "torque_bias")
# What corrected.xml holds already, where it exists.
IN_MODEL = {"payload", "com_shift", "link_inertia", "gravity_tilt"}
NAMES = {
    "viscous_friction": ("damping",),
    "coulomb_friction": ("friction", "coulomb"),
    "armature": ("armature",),
    "torque_bias": ("bias",),
}


@dataclass
class ReportTorque:
    """A report as a predictor of the torque."""

    nominal: Path
    report: dict
    corrected: Path | None = None
    left_out: set[str] = field(default_factory=set)

    def __post_init__(self):
        self.model = m = editable(mujoco.MjModel.from_xml_path(str(self.nominal)))
        self.joints = [m.joint(j).name for j in range(m.njnt)]
        own = m
        if self.corrected and self.corrected.exists():
            own = mujoco.MjModel.from_xml_path(str(self.corrected))
            self._take_bodies(own)
        # By name: corrected.xml may have a second hinge behind a joint, of a soft joint or of play.
        rows = [own.joint(name).dofadr[0] for name in self.joints]
        self.viscous, self.dry = own.dof_damping[rows], own.dof_frictionloss[rows]
        self.rotor, self.bias = own.dof_armature[rows], np.zeros(m.nv)
        self.presliding = np.zeros(m.nv)
        # Joint terms are the report's; springs of the nominal model stay in it.
        m.dof_damping[:] = m.dof_frictionloss[:] = m.dof_armature[:] = 0.0
        if own is m:
            self._edit_bodies()
        self.odd = [
            e for e in self.report["effects"]
            if e["family"] not in ORDINARY and e.get("handed_over", True)
        ]  # fmt: skip
        self._ordinary()

    def _ordinary(self) -> None:
        target = dict(zip(NAMES, (self.viscous, self.dry, self.rotor, self.bias), strict=True))
        for name, terms in self._terms():
            for family, array in target.items():
                value = terms.get(family, {}).get("value")
                if value is not None:
                    array[self.joints.index(name)] = value
            slip = terms.get("coulomb_friction", {}).get("presliding")
            if slip is not None:
                slip = slip["value"] if isinstance(slip, dict) else slip
                self.presliding[self.joints.index(name)] = slip or 0.0
        if "joints" in self.report:
            return
        for e in self.report["effects"]:  # a report of before: effects are changes of the nominal
            if e["family"] in target and not (self.corrected and e["family"] != "torque_bias"):
                joint = self.joints.index(e["location"]["name"])
                target[e["family"]][joint] += number(e, *NAMES[e["family"]])

    def _take_bodies(self, own: mujoco.MjModel) -> None:
        """Bodies and gravity of corrected.xml, joints as the nominal model has them."""
        m = self.model
        names = [[x.body(b).name for b in range(x.nbody)] for x in (m, own)]
        # A body without a name gets one in corrected.xml.
        if m.nbody != own.nbody or any(a not in ("", b) for a, b in zip(*names, strict=True)):
            raise ValueError(f"{self.corrected} has other bodies than {self.nominal}")
        for array in ("body_mass", "body_ipos", "body_iquat", "body_inertia", "body_gravcomp"):
            getattr(m, array)[:] = getattr(own, array)
        m.opt.gravity[:] = own.opt.gravity

    def _edit_bodies(self) -> None:
        m = self.model
        for e in self.report["effects"]:
            if e["family"] not in IN_MODEL:
                continue
            if e["family"] == "gravity_tilt":
                tilt = vector(e, "tilt")
                m.opt.gravity[:] = rotation_from_tilt(tilt[0], tilt[1]) @ m.opt.gravity
                continue
            body = m.body(e["location"]["name"]).id
            if e["family"] == "payload":
                mass = number(e, "mass")
                radius = number(e, "gyration_radius", default=0.0)
                add_mass(m, body, mass, vector(e, "com"), mass * radius**2 * np.eye(3))
            elif e["family"] == "com_shift":
                m.body_ipos[body] += vector(e, "com_shift")
            else:
                m.body_inertia[body] *= number(e, "inertia_scale")

    # -- mechanics

    def needed(self, s: Signals) -> np.ndarray:
        """Torque at the joints (T, n)."""
        q = s.q.copy()
        for e in self.odd:
            if e["family"] == "encoder_offset":
                q[:, self._joint(e)] -= number(e, "offset")
            elif e["family"] == "encoder_scale":
                q[:, self._joint(e)] /= 1.0 + number(e, "scale")
        v, a = s.derived(q) if np.any(q != s.q) else (s.v, s.a)
        motor_v, motor_a = v, a
        soft = [e for e in self.odd if e["family"] == "joint_elasticity"]
        if soft:
            link = rigid(self.model, q, v, a) - self._springs(q)
            for e in soft:
                j = self._joint(e)
                stiffness = number(e, "stiffness", default=np.inf)
                q[:, j] = q[:, j] - s.finish(link[:, j] / stiffness)
            v, a = s.derived(q)
        bodies = rigid(self.model, q, v, a) - self._springs(q) + self._world(s, q, v)
        if "friction" in self.report:
            out = bodies + self.rotor * motor_a - self.bias
            out += self._laws(s, bodies, motor_v, motor_a, out)
            self._coupled(out, bodies, motor_v, motor_a, s.dt)
            return out
        # The load of a gear: what the motor gives, but for the part of friction that is asked for.
        load = bodies + self.viscous * motor_v + self.dry * np.tanh(motor_v / SIGN)
        dry, turn = self._dry(load + self.rotor * motor_a - self.bias, motor_v, s.dt)
        out = bodies + self.viscous * turn + dry + self.rotor * motor_a - self.bias
        self._coupled(out, bodies, motor_v, motor_a, s.dt)
        return out

    def _laws(self, s: Signals, bodies, v, a, needed) -> np.ndarray:
        """Friction of every joint by the report's own law (T, n): `friction`, by docs/effects.md."""
        out = np.zeros_like(v)
        for j, name in enumerate(self.joints):
            terms = self.report["friction"][name]["terms"]
            of = [x[:, j] for x in (bodies, v, a, needed)]
            out[:, j], unknown = law_torque(terms, s.time, *of)
            self.left_out |= unknown
        return out

    def _springs(self, q: np.ndarray) -> np.ndarray:
        """Springs and other torques of the position that act on the joint."""
        out = np.zeros_like(q)
        for e in self.odd:
            if e["family"] == "joint_spring":
                j = self._joint(e)
                rest = number(e, "rest_angle", default=0.0)
                out[:, j] -= number(e, "stiffness") * (q[:, j] - rest)
            elif e["family"] == "cogging":
                j = self._joint(e)
                angle = number(e, "frequency") * q[:, j] + number(e, "phase", default=0.0)
                out[:, j] += number(e, "amplitude") * np.sin(angle)
                twice = 2.0 * (angle - number(e, "phase", default=0.0))
                twice += number(e, "harmonic_phase", default=0.0)
                out[:, j] += number(e, "harmonic", default=0.0) * np.sin(twice)
        return out

    def _dry(self, load: np.ndarray, v: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
        """Dry friction (T, n) with what odd laws change of it, and the motors' speed."""
        v = v.copy()
        for e in self.odd:
            if e["family"] == "joint_coupling" and "ratio" in e["parameters"]:
                v[:, self._joint(e)] += number(e, "ratio") * v[:, self._before(e)]
        level = np.tile(self.dry, (len(v), 1))
        extra = np.zeros_like(v)
        for e in self.odd:
            f = e["family"]
            if f in ("stribeck_friction", "load_friction"):
                # Each states the level of the joint's whole law.
                j = self._joint(e)
                level[:, j] += number(e, "coulomb", default=float(self.dry[j])) - self.dry[j]
                self.dry[j] = number(e, "coulomb", default=float(self.dry[j]))
            if f == "stribeck_friction":
                x = np.abs(v[:, j]) / number(e, "stribeck_velocity")
                fall = np.exp(-(x ** number(e, "exponent", default=2.0)))
                peak = number(e, "stiction", default=np.nan)
                own = number(e, "excess", default=0.0) if np.isnan(peak) else peak - self.dry[j]
                level[:, j] += own * fall
            elif f == "load_friction":
                level[:, j] += number(e, "load_coefficient") * np.abs(load[:, j])
            elif f == "asymmetric_coulomb":
                j = self._joint(e)
                half = 0.5 * (number(e, "positive") - number(e, "negative"))
                mean = 0.5 * (number(e, "positive") + number(e, "negative"))
                level[:, j] += mean - self.dry[j] + np.where(v[:, j] > 0, half, -half)
                self.dry[j] = mean
            elif f in ("quadratic_friction", "quadratic_viscous"):
                j = self._joint(e)
                extra[:, j] += number(e, "coefficient") * np.abs(v[:, j]) * v[:, j]
            elif f == "asymmetric_viscous":
                j = self._joint(e)
                extra[:, j] += 0.5 * number(e, "difference") * np.abs(v[:, j])
            elif f == "friction_drift":
                self.left_out.add(f)
        sign = np.stack([self._way(j, v[:, j], dt) for j in range(v.shape[1])], axis=1)
        return level * sign + extra, v

    def _way(self, j: int, v: np.ndarray, dt: float) -> np.ndarray:
        """What multiplies the level of a joint's dry friction at some speed."""
        slides = self.presliding[j]
        return dahl(v, dt, slides) if slides else np.tanh(v / SIGN)

    def _coupled(
        self, out: np.ndarray, bodies: np.ndarray, v: np.ndarray, a: np.ndarray, dt: float
    ) -> None:
        """A motor that turns with another joint, θ = q + c q_other: its rotor feels both, both feel its output."""
        for e in self.odd:
            if e["family"] != "joint_coupling":
                continue
            j, i = self._joint(e), self._before(e)
            if "ratio" in e["parameters"]:
                c = number(e, "ratio")
                out[:, j] += self.rotor[j] * c * a[:, i]
                out[:, i] -= c * (bodies[:, j] - self.bias[j])
            elif "friction_of_other_speed" in e["parameters"]:
                c, f = number(e, "coefficient"), number(e, "friction_of_other_speed")
                out[:, j] += f * v[:, i] + self.rotor[j] * c * a[:, i]
                turned = self._way(j, v[:, j] + c * v[:, i], dt) - self._way(j, v[:, j], dt)
                out[:, j] += self.dry[j] * turned
                out[:, i] += f * v[:, j] - c * (bodies[:, j] + self.viscous[j] * v[:, j])
            else:
                out[:, j] += number(e, "coefficient") * v[:, i]

    def _world(self, s: Signals, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """−Jᵀ f of forces at bodies."""
        out, m = np.zeros_like(q), self.model
        data, jac = mujoco.MjData(m), np.zeros((3, m.nv))
        for e in self.odd:
            if e["family"] not in ("constant_force", "push", "drag"):
                continue
            body = m.body(e["location"]["name"]).id
            window = push_window(e, s.time) if e["family"] == "push" else np.ones(len(s.time))
            point = vector(e, "point") if "point_x" in e["parameters"] else m.body_ipos[body]
            for k in np.flatnonzero(window):
                data.qpos[:] = q[k]
                mujoco.mj_kinematics(m, data)
                mujoco.mj_comPos(m, data)
                at = data.xpos[body] + data.xmat[body].reshape(3, 3) @ point
                mujoco.mj_jac(m, data, jac, None, at, body)
                if e["family"] == "drag":
                    speed = jac @ v[k]
                    force = -number(e, "coefficient") * np.linalg.norm(speed) * speed
                else:
                    force = window[k] * vector(e, "force")
                out[k] -= jac.T @ force
        return out

    # -- the drive

    def applied(self, s: Signals) -> np.ndarray:
        """What reaches the joints of the logged torque (T, n)."""
        tau = s.tau.copy()
        for e in self.odd:
            if e["location"]["kind"] not in ("global", "joint"):
                continue
            everywhere = e["location"]["kind"] == "global"
            place = list(range(tau.shape[1])) if everywhere else [self._joint(e)]
            if e["family"] == "time_delay":
                late = s.time - number(e, "delay")
                for j in place:
                    tau[:, j] = np.interp(late, s.time, tau[:, j])
            elif e["family"] == "actuator_lag":
                x = s.dt / number(e, "time_constant")
                keep = np.exp(-x)
                # Exact for a torque that is linear between the rows.
                b = [1 - (1 - keep) / x, (1 - keep) / x - keep]
                start = tau[:1, place] * (1 - b[0])
                tau[:, place] = lfilter(b, [1, -keep], tau[:, place], axis=0, zi=start)[0]
            elif e["family"] == "torque_saturation":
                limit = number(e, "limit")
                tau[:, place] = np.clip(tau[:, place], -limit, limit)
        return tau

    def gains(self) -> np.ndarray:
        out = np.ones(len(self.joints))
        whole = {n: t["torque_gain"]["value"] for n, t in self._terms() if "torque_gain" in t}
        if whole:
            return np.array([whole.get(name, 1.0) for name in self.joints])
        for e in self.odd:
            if e["family"] == "torque_gain":
                everywhere = e["location"]["kind"] == "global"
                out[slice(None) if everywhere else self._joint(e)] *= number(e, "gain")
        return out

    def _terms(self):
        return self.report.get("joints", {}).items()

    def error(self, log: dict[str, np.ndarray], held: bool = True) -> dict:
        """The measure of `torque_error`, in units of the logged torque."""
        known = {"torque_gain", "time_delay", "actuator_lag", "torque_saturation", "drag", "push"}
        # Not backlash: who is where in the gap is no function of the log's rows.
        known |= {"encoder_offset", "encoder_scale", "joint_elasticity", "cogging"}
        known |= {"joint_spring", "stribeck_friction", "load_friction", "asymmetric_coulomb"}
        known |= {"quadratic_friction", "quadratic_viscous", "asymmetric_viscous"}
        known |= {"constant_force", "joint_coupling", *IN_MODEL, *ORDINARY}
        if "friction" in self.report:
            known |= LAWS
        self.left_out |= {e["family"] for e in self.odd} - known
        s = signals(self.model, log, held)
        gain = self.gains()
        return error_of(self.model, s, (gain * self.applied(s) - self.needed(s)) / gain)

    def _joint(self, e: dict) -> int:
        return self.joints.index(e["location"]["name"])

    def _before(self, e: dict) -> int:
        other = e["location"].get("other") or e["parameters"].get("other", {}).get("value")
        return self.joints.index(other) if isinstance(other, str) else self._joint(e) - 1


def of_folder(folder: Path, data: Path) -> ReportTorque:
    """Of a folder with report.json (and corrected.xml) about the log in `data`."""
    report = json.loads((folder / "report.json").read_text())
    return ReportTorque(data / "nominal.xml", report, folder / "corrected.xml")
