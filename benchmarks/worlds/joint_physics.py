"""What every real joint has: LuGre friction with Stribeck's and load's part, rotor inertia, a torque offset.

One effect holds all joints. Sliding steadily at the motor's speed w under the drive's torque τ, joint j rubs with

    g(w, τ) sign(w) + d |w|^p sign(w),   g = F (1 + s exp(−(w/vs)²)) + μ |τ|,

and at rest with a bristle (LuGre) of deflection z: ż = w − σ₀ |w| z / g. None of this is a form that one would fit
(viscous d·w, Coulomb F sign w): `truth` states what such forms come nearest to over the motion.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import mujoco
import numpy as np

from benchmarks.worlds.effects import Effect
from benchmarks.worlds.friction import reflected_inertia
from benchmarks.worlds.two_mass import TwoMass

STEP = 5e-4  # s: explicit midpoint; bristles and soft joints ask for less where they are stiffer


@dataclass(frozen=True)
class Law:
    """Friction of all joints; arrays (n)."""

    coulomb: np.ndarray  # F, N m
    excess: np.ndarray  # s, 1
    stribeck_velocity: np.ndarray  # vs, rad/s
    load: np.ndarray  # μ, 1
    viscous: np.ndarray  # d, N m (s/rad)^p
    exponent: np.ndarray  # p

    def level(self, w: np.ndarray, tau: np.ndarray) -> np.ndarray:
        """Dry friction sliding at w under torque τ [N m]."""
        x = w / self.stribeck_velocity
        return self.coulomb * (1.0 + self.excess * np.exp(-x * x)) + self.load * np.abs(tau)

    def sliding(self, w: np.ndarray, tau: np.ndarray) -> np.ndarray:
        """All friction, steadily sliding [N m]."""
        size = self.viscous * np.abs(w) ** self.exponent
        return self.level(w, tau) * np.tanh(w / 0.003) + size * np.sign(w)


class Ordinary(Effect):
    """Friction, rotor inertia and offset of every joint; `odd` replaces the law where a joint's friction is odd.

    `wave` (joint, depth, N, φ): dry friction times 1 + depth sin(N q + φ), which no library has. Comes first in the
    list of effects: a two-mass joint or a coupling after it tells it at which speed a motor turns.
    """

    family = "ordinary"

    def __init__(
        self,
        law: Law,
        presliding: np.ndarray,
        armature: np.ndarray,
        bias: np.ndarray,
        odd: Law | None = None,
        wave: tuple[int, float, float, float] | None = None,
    ):
        super().__init__("global", "global", {})
        self.law, self.odd, self.wave = law, odd or law, wave
        self.presliding, self.armature, self.bias = presliding, armature, bias
        self.soft: TwoMass | None = None
        self.coupling: JointCoupling | None = None

    def edit(self, model):
        model.dof_armature[:] = self.armature

    def bind(self, model, joints):
        super().bind(model, joints)
        inertia = np.array([reflected_inertia(model, k) for k in range(model.nv)])
        # A soft joint's or a coupled motor's bristle feels its rotor alone.
        inertia = np.maximum(np.where(model.dof_armature > 0, inertia, self.armature), 1e-4)
        self.sigma0 = self.law.coulomb / self.presliding
        self.sigma1 = 0.8 * np.sqrt(self.sigma0 * inertia)
        self.dt_max = float(0.5 / np.sqrt(self.sigma0 / inertia).max())

    def reset(self, q, v):
        n = len(self.bias)
        self.z0, self.z = np.zeros(n), np.zeros(n)
        self.w, self.g, self.drive = np.zeros(n), self.law.coulomb, np.zeros(n)
        self.rows: list[np.ndarray] = []

    def _speeds(self, v: np.ndarray) -> np.ndarray:
        w = v.copy()
        if self.soft is not None:
            w[self.soft.joint] = self.soft.speed
        if self.coupling is not None:
            w[self.coupling.joint] += self.coupling.ratio * v[self.coupling.other]
        return w

    def _level(self, q: np.ndarray, w: np.ndarray) -> np.ndarray:
        """Steady dry friction of each motor at its speed [N m], kept with that."""
        g = self.odd.level(w, self.drive)
        if self.wave is not None:
            j, depth, frequency, phase = self.wave
            g[j] *= 1.0 + depth * np.sin(frequency * q[j] + phase)
        self.w, self.g = w, g
        return g

    def _torque(self, q: np.ndarray, w: np.ndarray) -> np.ndarray:
        law, g = self.odd, self._level(q, w)
        size = np.abs(w)
        rate = w - size * self.sigma0 / g * self.z
        damping = self.sigma1 * np.exp(-((w / 0.02) ** 2))
        return self.sigma0 * self.z + damping * rate + law.viscous * size**law.exponent * np.sign(w)

    def load(self, t, data, tau, out):
        self.drive = tau
        f = self._torque(data.qpos, self._speeds(data.qvel))
        out += self.bias
        if self.soft is not None:
            self.soft.rubbing = float(f[self.soft.joint])
            f[self.soft.joint] = 0.0
        if self.coupling is not None:
            out[self.coupling.other] -= self.coupling.ratio * f[self.coupling.joint]
        out -= f

    def evolve(self, h):
        rate = np.abs(self.w) * self.sigma0 / self.g * h + 1e-12
        decay = np.exp(-rate)
        self.z = self.z0 * decay + self.w * h * (1.0 - decay) / rate

    def commit(self):
        self.z0 = self.z

    def sense(self, q, v):
        """Keeps the ordinary part of the friction at each row, for the truth."""
        w = self._speeds(v)
        f = self._torque(q, w)
        dry = self.law.level(w, self.drive) / self.g
        smooth = self.law.viscous * np.abs(w) ** self.law.exponent * np.sign(w)
        if self.coupling is not None:
            j = self.coupling.joint
            f[j], dry[j] = self.law.sliding(v, self.drive)[j], 1.0
        self.rows.append((f - smooth) * dry + smooth)

    def record(self, log):
        log["friction"] = np.array(self.rows[-len(log["time"]) :])


def stribeck(law: Law, joint: int, excess: float, velocity: float) -> Law:
    """The law with a strong Stribeck effect at one joint."""
    return _at(_at(law, "excess", joint, excess), "stribeck_velocity", joint, velocity)


def loaded(law: Law, joint: int, coefficient: float) -> Law:
    """The law with friction that grows with load at one joint."""
    return _at(law, "load", joint, coefficient)


def _at(law: Law, name: str, joint: int, value: float) -> Law:
    x = getattr(law, name).copy()
    x[joint] = value
    return dataclasses.replace(law, **{name: x})


class OddFriction(Effect):
    """States a friction that `Ordinary` carries out."""

    def __init__(self, family, units, joint, parameters):
        super().__init__("joint", joint, parameters)
        self.family, self.units = family, units


class JointCoupling(Effect):
    """The motor of a joint turns with the joint before it: θ = q + ratio q_before.

    Its torque, friction and rotor act on both: Aᵀ with A = [1, ratio]. The rotor's inertia is a tendon's armature.
    """

    family = "joint_coupling"
    units = {"ratio": "1", "other": ""}  # noqa: RUF012

    def __init__(self, joint: str, before: str, ratio: float):
        super().__init__("joint", joint, {"ratio": ratio})
        self.before, self.ratio = before, ratio

    def edit(self, model):
        model.joint(self.name).armature[:] = 0.0  # it is the tendon's

    def bind(self, model, joints):
        super().bind(model, joints)
        self.other = joints.index(self.before)

    def load(self, t, data, tau, out):
        out[self.other] += self.ratio * tau[self.joint]

    def truth(self):
        entry = super().truth()
        entry["parameters"]["other"] = {"value": self.before, "unit": ""}
        return entry


def coupled_model(spec: mujoco.MjSpec, coupling: JointCoupling, armature: float) -> mujoco.MjSpec:
    """The spec with the rotor of the coupled motor on a fixed tendon over both joints."""
    tendon = spec.add_tendon(name="coupled_rotor", armature=armature)
    tendon.wrap_joint(coupling.name, 1.0)
    tendon.wrap_joint(coupling.before, coupling.ratio)
    return spec
