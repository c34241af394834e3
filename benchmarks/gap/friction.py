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
from effects import Effect


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


class _DryFriction(Effect):
    """Coulomb's friction through a bristle; subclasses give the level g(v, τ)."""

    def bind(self, model, joints):
        super().bind(model, joints)
        self.inertia = reflected_inertia(model, self.dof)
        self.reset(np.zeros(0), np.zeros(0))

    def reset(self, q, v):
        self.bristle = Bristle(self.base_level(), self.parameters["presliding"], self.inertia)
        self.dt_max = self.bristle.dt_max

    def base_level(self) -> float:
        return self.parameters["coulomb"]

    def level(self, v: float, tau: float) -> float:
        return self.parameters["coulomb"]

    def load(self, t, data, tau, out):
        v = float(data.qvel[self.dof])
        out[self.dof] -= self.bristle.torque(v, self.level(v, float(tau[self.joint])))

    def evolve(self, h):
        self.bristle.evolve(h)

    def commit(self):
        self.bristle.commit()


_COULOMB = {"coulomb": "N m", "presliding": "rad"}


class CoulombFriction(_DryFriction):
    family, units = "coulomb_friction", _COULOMB


class KnownFriction(CoulombFriction):
    """The nominal model's own friction loss, realised by a bristle: no effect, but a real joint.

    MuJoCo's soft constraint turns its friction about q̈/100 rad/s before the joint does; this
    does not.
    """

    def edit(self, model):
        model.joint(self.name).frictionloss[:] = 0.0


class AsymmetricCoulomb(_DryFriction):
    family = "asymmetric_coulomb"
    units = {"positive": "N m", "negative": "N m", "presliding": "rad"}  # noqa: RUF012

    def base_level(self):
        return 0.5 * (self.parameters["positive"] + self.parameters["negative"])

    def level(self, v, tau):
        return self.parameters["positive" if v > 0 else "negative"]


class StribeckFriction(_DryFriction):
    """g(v) = Fc + (Fs − Fc) exp(−(v/vs)²); `coulomb` is Fc, `stiction` is Fs."""

    family = "stribeck_friction"
    units = _COULOMB | {"stiction": "N m", "stribeck_velocity": "rad/s"}

    def level(self, v, tau):
        p = self.parameters
        ratio = v / p["stribeck_velocity"]
        return p["coulomb"] + (p["stiction"] - p["coulomb"]) * math.exp(-(ratio * ratio))


class LoadFriction(_DryFriction):
    """g = F₀ + μ |τ| with the drive's torque τ; `coulomb` is F₀, `load_coefficient` is μ."""

    family = "load_friction"
    units = _COULOMB | {"load_coefficient": "1"}

    def level(self, v, tau):
        return self.parameters["coulomb"] + self.parameters["load_coefficient"] * abs(tau)


class ViscousFriction(Effect):
    family, units = "viscous_friction", {"damping": "N m s/rad"}

    def load(self, t, data, tau, out):
        out[self.dof] -= self.parameters["damping"] * data.qvel[self.dof]


class FrictionDrift(Effect):
    """Viscous friction of a warming gear: d(t) = d_end + (d − d_end) exp(−t/T), `damping` = d."""

    family = "friction_drift"
    units = {"damping": "N m s/rad", "damping_end": "N m s/rad", "time_constant": "s"}  # noqa: RUF012

    def load(self, t, data, tau, out):
        p = self.parameters
        warm = math.exp(-max(t, 0.0) / p["time_constant"])
        damping = p["damping_end"] + (p["damping"] - p["damping_end"]) * warm
        out[self.dof] -= damping * data.qvel[self.dof]


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
