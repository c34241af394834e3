"""Hidden effects of the joint: friction with a bristle state, springs, cogging.

Dry friction is LuGre's (Canudas de Wit, Olsson, Åström, Lischinsky 1995): a bristle deflection z
with ż = v − σ₀ |v| z / g(v) and the friction torque σ₀ z + σ₁ ż. The level g(v) makes the families;
sliding steadily, the torque is g(v) sign(v). z is integrated exactly over a step at the stage's v
and g.
"""

from __future__ import annotations

import math

import mujoco
import numpy as np

from benchmarks.worlds.effects import Effect


class Bristle:
    """One LuGre contact. `presliding` is g/σ₀ at the level `level` (rad)."""

    def __init__(self, level: float, presliding: float, inertia: float):
        self.sigma0 = level / presliding
        self.sigma1 = 2.0 * 0.4 * math.sqrt(self.sigma0 * inertia)
        self.dt_max = 0.25 / math.sqrt(self.sigma0 / inertia)
        self.z = self.z0 = 0.0
        self.v, self.g = 0.0, level

    def torque(self, v: float, g: float) -> float:
        self.v, self.g = v, g
        rate = v - abs(v) * self.sigma0 / g * self.z
        # σ₁ fades with speed, which keeps LuGre passive and leaves g(v) alone when sliding.
        damping = self.sigma1 * math.exp(-((v / 0.02) ** 2)) if abs(v) < 0.08 else 0.0
        return self.sigma0 * self.z + damping * rate

    def evolve(self, h: float) -> None:
        rate = abs(self.v) * self.sigma0 / self.g * h
        if rate < 1e-9:
            self.z = self.z0 + h * self.v
        else:
            steady = math.copysign(self.g / self.sigma0, self.v)
            self.z = steady + (self.z0 - steady) * math.exp(-rate)

    def commit(self) -> None:
        self.z0 = self.z


def reflected_inertia(model: mujoco.MjModel, dof: int) -> float:
    """What a torque at one joint feels, 1 / (M⁻¹)_jj in the zero configuration."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    unit = np.zeros((1, model.nv))
    unit[0, dof] = 1.0
    out = np.zeros((1, model.nv))
    mujoco.mj_solveM(model, data, out, unit)
    return float(1.0 / out[0, dof])


class KnownFriction(Effect):
    """The model's own friction loss of a joint by a bristle of travel `presliding`: a real joint, and no effect.

    MuJoCo's soft constraint turns its friction about q̈/100 rad/s before the joint does; this does not.
    """

    family, units = "known_friction", {"coulomb": "N m", "presliding": "rad"}

    def edit(self, model):
        model.joint(self.name).frictionloss[:] = 0.0

    def bind(self, model, joints):
        super().bind(model, joints)
        self.inertia = reflected_inertia(model, self.dof)
        self.reset(np.zeros(0), np.zeros(0))

    def reset(self, q, v):
        level, presliding = self.parameters["coulomb"], self.parameters["presliding"]
        self.bristle = Bristle(level, presliding, self.inertia)
        self.dt_max = self.bristle.dt_max

    def load(self, t, data, tau, out):
        v = float(data.qvel[self.dof])
        out[self.dof] -= self.bristle.torque(v, self.parameters["coulomb"])

    def evolve(self, h):
        self.bristle.evolve(h)

    def commit(self):
        self.bristle.commit()


class JointSpring(Effect):
    family, units = "joint_spring", {"stiffness": "N m/rad", "rest_angle": "rad"}

    def load(self, t, data, tau, out):
        p = self.parameters
        out[self.dof] -= p["stiffness"] * (data.qpos[self.adr] - p["rest_angle"])


class Cogging(Effect):
    """A sin(N q + φ) with a second harmonic of a tenth, which no fitted form has."""

    family, units = "cogging", {"amplitude": "N m", "frequency": "1/rad", "phase": "rad"}

    def load(self, t, data, tau, out):
        p = self.parameters
        angle = p["frequency"] * data.qpos[self.adr] + p["phase"]
        out[self.dof] += p["amplitude"] * (math.sin(angle) + 0.1 * math.sin(2 * angle + 0.7))
