"""Draws a robot as it is bought: what every joint has, and how wrong the drawing is.

Sizes of joint effects scale with s, the peak torque of that joint in the nominal run of the motion, never taken below
a fifth of its rating: a wrist's friction is the gear's, not its light load's.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np

from benchmarks.worlds import effects as fx
from benchmarks.worlds import two_mass as tm
from benchmarks.worlds.dynamics import inverse_dynamics
from benchmarks.worlds.joint_physics import JointCoupling, Law, Ordinary, coupled_model
from benchmarks.worlds.motions import make_motion
from benchmarks.worlds.own_robot import set_linear
from benchmarks.worlds.robots import Robot

TOLERANCE = {"mass": 0.02, "com": 1e-3, "inertia": 0.05}  # 1 sigma: share, m, share


@dataclass
class Hidden:
    """Everything the nominal model does not say. `odd`: what was drawn beyond the ordinary, if anything."""

    law: Law
    presliding: np.ndarray
    armature: np.ndarray
    bias: np.ndarray
    inertials: dict[str, dict]
    odd: fx.Effect | None = None
    odd_law: Law | None = None
    wave: tuple[int, float, float, float] | None = None
    scale: np.ndarray = field(default_factory=lambda: np.zeros(0))
    """s of each joint [N m]."""

    def model(self, robot: Robot, with_odd: bool = True) -> mujoco.MjModel:
        """The real bodies (with the rotor of a coupled motor where it belongs); no friction."""
        if with_odd and isinstance(self.odd, JointCoupling):
            spec = mujoco.MjSpec.from_string(robot.xml)
            joint = robot.joints.index(self.odd.name)
            model = fx.editable(coupled_model(spec, self.odd, self.armature[joint]).compile())
        else:
            model = robot.model()
        for name, error in self.inertials.items():
            body = model.body(name).id
            model.body_mass[body] *= 1.0 + error["mass"]
            model.body_inertia[body] *= (1.0 + error["mass"]) * (1.0 + error["inertia"])
            model.body_ipos[body] += error["com"]
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
        return model

    def effects(self, kind: type[Ordinary] = Ordinary) -> list[fx.Effect]:
        """For the plant, the ordinary ones first, by the friction of class `kind`."""
        ordinary = kind(
            self.law, self.presliding, self.armature, self.bias, self.odd_law, self.wave
        )
        if isinstance(self.odd, tm.TwoMass):
            ordinary.soft = self.odd
        if isinstance(self.odd, JointCoupling):
            ordinary.coupling = self.odd
        return [ordinary, *([self.odd] if self.odd else [])]


def axes(robot: Robot) -> np.ndarray:
    """World axes of the joints in the reference posture (n, 3)."""
    model = robot.model()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return data.xaxis.copy()


def plane(robot: Robot) -> np.ndarray | None:
    """Normal of the plane that all joints turn in; None where they do not share one."""
    every = axes(robot)
    hinges = robot.model().jnt_type == mujoco.mjtJoint.mjJNT_HINGE
    same = bool(hinges.all()) and np.all(np.abs(every @ every[0]) > 1.0 - 1e-6)
    return every[0] if same else None


def turns_upright(robot: Robot) -> bool:
    """Whether the first joint turns about the vertical."""
    return bool(abs(axes(robot)[0, 2]) > 0.99)


def truncated(rng, sigma: float, size=None):
    """Normal within two sigma: a drawing that is further off is a wrong drawing."""
    x = rng.normal(size=size)
    while np.any(far := np.abs(x) > 2.0):
        x = np.where(far, rng.normal(size=size), x)
    return sigma * x


def inertials_off(rng, bodies: Sequence[str], share: float = 1.0) -> dict[str, dict[str, Any]]:
    """By how much the inertials of some bodies are off the model's, `share`: of `TOLERANCE`."""
    sigma = {k: share * x for k, x in TOLERANCE.items()}
    return {
        body: {
            "mass": float(truncated(rng, sigma["mass"])),
            "com": [float(x) for x in truncated(rng, sigma["com"], 3)],
            "inertia": float(truncated(rng, sigma["inertia"])),
        }
        for body in bodies
    }


def log_uniform(rng, low, high, size=None):
    return np.exp(rng.uniform(np.log(low), np.log(high), size))


@dataclass
class Motion:
    """The nominal run of the motion: peak torque (n), the torque exceeded a tenth of the time, range, link inertia."""

    peak: np.ndarray
    busy: np.ndarray
    span: np.ndarray
    inertia: np.ndarray


def nominal_run(robot: Robot, kind: str, seed: list[int], duration: float) -> Motion:
    motion = make_motion(robot, kind, seed)
    q, v, a = (np.array(x) for x in zip(*map(motion, np.arange(0, duration, 0.02)), strict=True))
    model = robot.model()
    tau = np.abs(inverse_dynamics(model, q, v, a))
    data, full, seen = mujoco.MjData(model), np.zeros((model.nv, model.nv)), []
    for pose in q[::20]:
        data.qpos[:] = pose
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, full)
        seen.append(full.diagonal().copy())
    span = np.array([q.min(0), q.max(0)])
    return Motion(tau.max(0), np.percentile(tau, 90, axis=0), span, np.mean(seen, axis=0))


def as_drawn(hidden: Hidden) -> Hidden:
    """The same robot with friction in the drawing's own forms and half of its errors: what a good model can say."""
    zero = np.zeros_like(hidden.bias)
    law = dataclasses.replace(hidden.law, excess=zero, load=zero, exponent=zero + 1.0)
    half = lambda x: [0.5 * k for k in x] if isinstance(x, list) else 0.5 * x  # noqa: E731
    inertials = {b: {k: half(x) for k, x in e.items()} for b, e in hidden.inertials.items()}
    return dataclasses.replace(hidden, law=law, bias=zero, inertials=inertials)


def good_model(robot: Robot, hidden: Hidden, rng) -> str:
    """The drawing with every joint's friction and rotor in it; dampings are up to 7 % off."""
    spec = mujoco.MjSpec.from_string(robot.xml)
    for k, name in enumerate(robot.joints):
        joint = spec.joint(name)
        set_linear(
            joint, "damping", float(hidden.law.viscous[k] * (1.0 + rng.uniform(-0.07, 0.07)))
        )
        joint.frictionloss = float(hidden.law.coulomb[k])
        joint.armature = float(hidden.armature[k])
    spec.compile()
    return spec.to_xml()


def draw_ordinary(robot: Robot, run: Motion, rng) -> Hidden:
    """Friction, rotors and offsets of every joint, and the errors of the drawing."""
    n = len(robot.joints)
    s = np.maximum(run.peak, 0.2 * robot.peak)
    law = Law(
        coulomb=s * log_uniform(rng, 0.02, 0.12, n),
        excess=np.where(rng.random(n) < 0.6, rng.uniform(0.0, 0.2, n), 0.0),
        stribeck_velocity=log_uniform(rng, 0.01, 0.05, n),
        load=np.where(rng.random(n) < 0.4, rng.uniform(0.0, 0.015, n), 0.0),
        viscous=s * log_uniform(rng, 0.01, 0.10, n),
        exponent=rng.uniform(0.88, 1.0, n),
    )
    # A joint is small where it sees little of the arm: gears of small joints have the larger share.
    small = run.inertia < 0.3 * run.inertia.max()
    share = np.where(small, log_uniform(rng, 0.3, 2.0, n), log_uniform(rng, 0.1, 0.8, n))
    armature = share * run.inertia
    # Bristles of 10⁻⁴ to 2·10⁻³ rad, and no stiffer than the step of integration allows.
    least = law.coulomb / (np.maximum(run.inertia, 1e-4) * (1 + share)) / 900.0**2
    presliding = np.maximum(log_uniform(rng, 1e-4, 2e-3, n), least)
    bias = s * rng.uniform(0.0, 0.02, n) * rng.choice([-1.0, 1.0], n)
    bias = np.where(rng.random(n) < 0.25, 0.0, bias)
    return Hidden(law, presliding, armature, bias, inertials_off(rng, robot.bodies), scale=s)
