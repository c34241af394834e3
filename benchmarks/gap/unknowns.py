"""Effects that no library of the diagnosis has: the right answer is `unknown`, with its place."""

from __future__ import annotations

import math

import numpy as np
from effects import Effect
from scipy.interpolate import CubicSpline


class _Unknown(Effect):
    family = "unknown"
    mechanism = ""

    def truth(self) -> dict:
        return super().truth() | {"mechanism": self.mechanism}


class JointCoupling(_Unknown):
    """A belt that drags on the neighbour: −c q̇ of the other joint acts on this one."""

    mechanism, units = "joint_coupling", {"coefficient": "N m s/rad"}

    def bind(self, model, joints):
        super().bind(model, joints)
        other = joints[self.joint - 1] if self.joint > 0 else joints[1]
        self.other = int(model.joint(other).dofadr[0])

    def load(self, t, data, tau, out):
        out[self.dof] -= self.parameters["coefficient"] * data.qvel[self.other]


class QuadraticFriction(_Unknown):
    """Churning losses: −c |q̇| q̇."""

    mechanism, units = "quadratic_friction", {"coefficient": "N m s^2/rad^2"}

    def load(self, t, data, tau, out):
        v = data.qvel[self.dof]
        out[self.dof] -= self.parameters["coefficient"] * abs(v) * v


class LoadRipple(_Unknown):
    """An eccentric gear: the torque ripples with the angle, in proportion to the load."""

    mechanism = "load_ripple"
    units = {"coefficient": "1", "frequency": "1/rad", "phase": "rad"}  # noqa: RUF012

    def load(self, t, data, tau, out):
        p = self.parameters
        wave = math.sin(p["frequency"] * data.qpos[self.adr] + p["phase"])
        out[self.dof] += p["coefficient"] * abs(tau[self.joint]) * wave


class StopCushion(_Unknown):
    """A rubber cushion before one hard stop: progressive, with losses, on one side only."""

    mechanism = "stop_cushion"
    units = {"stiffness": "N m/rad", "onset": "rad", "side": "1"}  # noqa: RUF012

    def load(self, t, data, tau, out):
        p = self.parameters
        depth = p["side"] * (data.qpos[self.adr] - p["onset"])
        if depth > 0.0:
            speed = p["side"] * float(data.qvel[self.dof])
            push = p["stiffness"] * depth * (1.0 + 2.0 * depth) * (1.0 + 0.15 * math.tanh(speed))
            out[self.dof] -= p["side"] * push


class TorqueDeadBand(_Unknown):
    """A drive that gives nothing of small torques: u less ± half its width, and zero between."""

    mechanism, units = "torque_dead_band", {"half_width": "N m"}

    def actuate(self, t, dt, u):
        x, w = u[self.joint], self.parameters["half_width"]
        u[self.joint] = math.copysign(max(abs(x) - w, 0.0), x)


class CubicSpring(_Unknown):
    """A hose or a bellows that stiffens: −k (q − q₀)³."""

    mechanism = "cubic_spring"
    units = {"stiffness": "N m/rad^3", "rest_angle": "rad"}  # noqa: RUF012

    def load(self, t, data, tau, out):
        p = self.parameters
        out[self.dof] -= p["stiffness"] * (data.qpos[self.adr] - p["rest_angle"]) ** 3


class LengthError(_Unknown):
    """A link is longer than the model says: its child sits further out; masses stay."""

    mechanism, units = "length_error", {"extension": "m"}

    def edit(self, model):
        body = int(np.flatnonzero(model.body_parentid == model.body(self.name).id)[0])
        along = model.body_pos[body] / np.linalg.norm(model.body_pos[body])
        model.body_pos[body] += self.parameters["extension"] * along


class ClockSkew(_Unknown):
    """The encoders' clock runs at (1 + rate) of the drives': row t holds q((1 + rate) t)."""

    mechanism, units = "clock_skew", {"rate": "1"}

    def record(self, log):
        time = log["time"]
        seen = np.clip((1.0 + self.parameters["rate"]) * time, time[0], time[-1])
        for name in ("qpos", "qvel"):
            log[name] = CubicSpline(time, log[name])(seen)
