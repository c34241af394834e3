"""Effects that no library of the diagnosis has: the right answer is `unknown`, with its place."""

from __future__ import annotations

import math

import numpy as np
from scipy.interpolate import CubicSpline

from benchmarks.worlds.effects import Effect


class Outside(Effect):
    family = "unknown"
    mechanism = ""

    def truth(self) -> dict:
        return super().truth() | {"mechanism": self.mechanism}


class LoadRipple(Outside):
    """An eccentric gear: the torque ripples with the angle, in proportion to the load."""

    mechanism = "load_ripple"
    units = {"coefficient": "1", "frequency": "1/rad", "phase": "rad"}  # noqa: RUF012

    def load(self, t, data, tau, out):
        p = self.parameters
        wave = math.sin(p["frequency"] * data.qpos[self.adr] + p["phase"])
        out[self.dof] += p["coefficient"] * abs(tau[self.joint]) * wave


class StopCushion(Outside):
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


class TorqueDeadBand(Outside):
    """A drive that gives nothing of small torques: u less ± half its width, and zero between."""

    mechanism, units = "torque_dead_band", {"half_width": "N m"}

    def actuate(self, t, dt, u):
        x, w = u[self.joint], self.parameters["half_width"]
        u[self.joint] = math.copysign(max(abs(x) - w, 0.0), x)


class CubicSpring(Outside):
    """A hose or a bellows that stiffens: −k (q − q₀)³."""

    mechanism = "cubic_spring"
    units = {"stiffness": "N m/rad^3", "rest_angle": "rad"}  # noqa: RUF012

    def load(self, t, data, tau, out):
        p = self.parameters
        out[self.dof] -= p["stiffness"] * (data.qpos[self.adr] - p["rest_angle"]) ** 3


class LengthError(Outside):
    """A link is longer than the model says: its child sits further out; masses stay."""

    mechanism, units = "length_error", {"extension": "m"}

    def edit(self, model):
        body = int(np.flatnonzero(model.body_parentid == model.body(self.name).id)[0])
        along = model.body_pos[body] / np.linalg.norm(model.body_pos[body])
        model.body_pos[body] += self.parameters["extension"] * along


class ClockSkew(Outside):
    """The encoders' clock runs at (1 + rate) of the drives': row t holds q((1 + rate) t)."""

    mechanism, units = "clock_skew", {"rate": "1"}

    def record(self, log):
        time = log["time"]
        seen = np.clip((1.0 + self.parameters["rate"]) * time, time[0], time[-1])
        for name in ("qpos", "qvel"):
            log[name] = CubicSpline(time, log[name])(seen)


class WavyFriction(Outside):
    """Dry friction that depends on the position (an eccentric gear, a worn stretch); `Ordinary` carries it out."""

    mechanism = "position_dependent_friction"
    units = {"depth": "1", "frequency": "1/rad", "phase": "rad"}  # noqa: RUF012


class Resonance(Outside):
    """Something that swings about the joint's axis on a spring: cover, tool, cable drum."""

    mechanism = "resonance"
    units = {"inertia": "kg m^2", "frequency_hz": "Hz", "damping_ratio": "1"}  # noqa: RUF012

    def reset(self, q, v):
        p = self.parameters
        omega = 2 * np.pi * p["frequency_hz"]
        self.stiffness = p["inertia"] * omega**2
        self.damper = 2 * p["damping_ratio"] * omega * p["inertia"]
        self.angle = self.angle0 = float(q[self.joint])
        self.speed = self.speed0 = float(v[self.joint])

    def load(self, t, data, tau, out):
        q, v = data.qpos[self.adr], data.qvel[self.dof]
        torque = self.stiffness * (self.angle - q) + self.damper * (self.speed - v)
        out[self.dof] += torque
        self.rates = (self.speed, -torque / self.parameters["inertia"])

    def evolve(self, h):
        self.angle, self.speed = self.angle0 + h * self.rates[0], self.speed0 + h * self.rates[1]

    def commit(self):
        self.angle0, self.speed0 = self.angle, self.speed


class HystereticHose(Outside):
    """A hose with loss along the arm (Bouc–Wen): k (a (q − q₀) + (1 − a) z), ż = v (1 − |z/x|ⁿ…) with travel x."""

    mechanism = "hysteretic_hose"
    units = {"stiffness": "N m/rad", "rest_angle": "rad", "travel": "rad", "elastic": "1"}  # noqa: RUF012

    def reset(self, q, v):
        self.z = self.z0 = 0.0
        self.v = 0.0

    def load(self, t, data, tau, out):
        p = self.parameters
        self.v = float(data.qvel[self.dof])
        bend = p["elastic"] * (data.qpos[self.adr] - p["rest_angle"])
        out[self.dof] -= p["stiffness"] * (bend + (1.0 - p["elastic"]) * self.z)

    def evolve(self, h):
        # ż = v − |v| z / travel, exactly over the step.
        travel = self.parameters["travel"]
        rate = abs(self.v) * h / travel
        self.z = self.z0 * np.exp(-rate) + np.sign(self.v) * travel * (1.0 - np.exp(-rate))

    def commit(self):
        self.z0 = self.z
