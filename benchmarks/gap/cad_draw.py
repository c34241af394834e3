"""Draws a robot as it is bought: what every joint has, how wrong the drawing is, and perhaps one odd thing.

Sizes of joint effects scale with s, the peak torque of that joint in the nominal run of the motion, never taken below
a fifth of its rating: a wrist's friction is the gear's, not its light load's.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field

import effects as fx
import friction as fr
import mujoco
import numpy as np
import twomass as tm
import unknowns as un
from cad_plant import (
    HystereticHose,
    JointCoupling,
    Law,
    OddFriction,
    Ordinary,
    Resonance,
    WavyFriction,
    coupled_model,
    loaded,
    stribeck,
)
from check import inverse_dynamics
from motions import make_motion
from own_robot import set_linear
from robots import Robot

DEGREE = np.pi / 180.0
ODD = (
    *("payload", "com_shift", "torque_gain", "time_delay", "gravity_tilt", "joint_elasticity"),
    *("backlash", "encoder_offset", "joint_spring", "cogging", "torque_saturation"),
    *("stribeck_friction", "constant_force", "push", "joint_coupling", "load_friction"),
    "actuator_lag",
)
OUTSIDE = ("position_dependent_friction", "resonance", "hysteretic_hose")
FURTHER = (
    *("torque_dead_band", "cubic_spring", "length_error", "clock_skew", "load_ripple"),
    "stop_cushion",
)
"""More that no library has, of the sealed set."""
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
    inertials = {
        body: {
            "mass": float(truncated(rng, TOLERANCE["mass"])),
            "com": [float(x) for x in truncated(rng, TOLERANCE["com"], 3)],
            "inertia": float(truncated(rng, TOLERANCE["inertia"])),
        }
        for body in robot.bodies
    }
    return Hidden(law, presliding, armature, bias, inertials, scale=s)


class DrawOdd:
    """One odd effect of a family, set into `hidden`."""

    def __init__(self, robot: Robot, run: Motion, hidden: Hidden, rng, duration: float):
        self.robot, self.run, self.hidden, self.rng = robot, run, hidden, rng
        self.duration = duration

    def make(self, family: str) -> None:
        self.hidden.odd = getattr(self, family)()

    def size(self, low: float, high: float) -> float:
        return float(log_uniform(self.rng, low, high))

    def sign(self) -> float:
        return float(self.rng.choice([-1.0, 1.0]))

    def joint(self, first: int = 0) -> tuple[int, str, float]:
        k = int(self.rng.integers(first, len(self.robot.joints)))
        return k, self.robot.joints[k], float(self.hidden.scale[k])

    def _first_turning(self) -> int:
        """1 where the first axis is vertical: gravity sees neither its angle nor its link's load."""
        return int(turns_upright(self.robot) and len(self.robot.joints) > 1)

    def body(self) -> str:
        return str(self.rng.choice(self.robot.bodies[self._first_turning() :]))

    def direction(self) -> list[float]:
        x = self.rng.normal(size=3)
        if (normal := plane(self.robot)) is not None:
            x -= 0.8 * (x @ normal) * normal  # across the plane of a planar arm nothing shows
        return x / np.linalg.norm(x)

    def payload(self):
        body = self.body()
        place = self.robot.model().body(body).ipos + self.rng.normal(0.0, 0.05, 3)
        p = {
            "mass": self.size(*self.robot.payload),
            "com": [float(x) for x in place],
            "size": float(self.rng.uniform(0.03, 0.12)),
        }
        return fx.Payload("body", body, p)

    def com_shift(self):
        shift = self.size(0.005, 0.04) * self.direction()
        return fx.ComShift("body", self.body(), {"com_shift": [float(x) for x in shift]})

    def torque_gain(self):
        _, name, _ = self.joint()
        return fx.TorqueGain("joint", name, {"gain": 1.0 + self.sign() * self.size(0.04, 0.2)})

    def time_delay(self):
        return fx.TimeDelay("global", "global", {"delay": self.size(0.003, 0.02)})

    def actuator_lag(self):
        return fx.ActuatorLag("global", "global", {"time_constant": self.size(0.003, 0.02)})

    def gravity_tilt(self):
        angle, about = self.size(1.0, 4.0) * DEGREE, self.rng.uniform(0, 2 * np.pi)
        normal = plane(self.robot)
        if normal is not None and abs(normal[2]) < 0.5:
            # About the plane's normal; the rest is invisible.
            turned = 0.0 if self.sign() > 0 else np.pi
            about = np.arctan2(normal[1], normal[0]) + turned + self.rng.normal(0, 0.2)
        tilt = [float(angle * np.cos(about)), float(angle * np.sin(about))]
        return fx.GravityTilt("global", "global", {"tilt": tilt})

    def joint_elasticity(self):
        _, name, s = self.joint()
        return tm.JointElasticity("joint", name, {"stiffness": s / self.size(0.01, 0.05)})

    def backlash(self):
        _, name, s = self.joint()
        p = {"dead_zone": self.size(0.2, 2.0) * DEGREE, "stiffness": s / 0.006}
        return tm.Backlash("joint", name, p)

    def encoder_offset(self):
        _, name, _ = self.joint(self._first_turning())
        offset = self.sign() * self.size(1.0, 5.0) * DEGREE
        return fx.EncoderOffset("joint", name, {"offset": offset})

    def joint_spring(self):
        k, name, s = self.joint()
        rest = float(self.rng.uniform(self.run.span[0][k] - 0.2, self.run.span[1][k] + 0.2))
        p = {"stiffness": s * self.size(0.03, 0.3), "rest_angle": rest}
        return fr.JointSpring("joint", name, p)

    def cogging(self):
        _, name, s = self.joint()
        p = {
            "amplitude": s * self.size(0.015, 0.08),
            "frequency": float(round(self.size(4, 24))),
            "phase": float(self.rng.uniform(-np.pi, np.pi)),
        }
        return fr.Cogging("joint", name, p)

    def torque_saturation(self):
        """At 60 to 90 % of what the real joint needs, never below what it needs a tenth of the time."""
        k, name, _ = self.joint()
        h = self.hidden
        rub = h.law.coulomb[k] + h.law.viscous[k]
        need = float(self.run.peak[k] * (1.0 + 0.3 * h.armature[k] / self.run.inertia[k]) + rub)
        busy = float(self.run.busy[k] + rub)
        share = float(self.rng.uniform(0.6, 0.9))
        return fx.TorqueSaturation("joint", name, {"limit": max(share * need, 1.02 * busy)})

    def constant_force(self):
        force = self.size(*self.robot.force) * self.direction()
        return fx.ConstantForce("body", self.body(), {"force": [float(x) for x in force]})

    def push(self):
        length = self.size(0.2, 2.0)
        start = float(self.rng.uniform(1.0, self.duration - 1.0 - length))
        low, high = self.robot.force
        force = self.size(2.0 * low, 1.5 * high) * self.direction()
        p = {"force": [float(x) for x in force], "start": start, "end": start + length}
        return fx.Push("body", self.body(), p)

    def joint_coupling(self):
        k, name, _ = self.joint(max(1, len(self.robot.joints) - 3))
        return JointCoupling(name, self.robot.joints[k - 1], self.sign() * self.size(0.05, 0.5))

    def stribeck_friction(self):
        k, name, _ = self.joint()
        excess, velocity = float(self.rng.uniform(0.5, 1.6)), self.size(0.05, 0.25)
        self.hidden.odd_law = stribeck(self.hidden.law, k, excess, velocity)
        coulomb = float(self.hidden.law.coulomb[k])
        p = {
            "coulomb": coulomb,
            "stiction": coulomb * (1.0 + excess),
            "stribeck_velocity": velocity,
        }
        units = {"coulomb": "N m", "stiction": "N m", "stribeck_velocity": "rad/s"}
        return OddFriction("stribeck_friction", units, name, p)

    def load_friction(self):
        k, name, _ = self.joint()
        coefficient = self.size(0.04, 0.2)
        self.hidden.odd_law = loaded(self.hidden.law, k, coefficient)
        p = {"coulomb": float(self.hidden.law.coulomb[k]), "load_coefficient": coefficient}
        return OddFriction("load_friction", {"coulomb": "N m", "load_coefficient": "1"}, name, p)

    # -- outside the library

    def position_dependent_friction(self):
        k, name, _ = self.joint()
        p = {
            "depth": float(self.rng.uniform(0.5, 0.9)),
            "frequency": float(self.rng.uniform(1.5, 4.0)),
            "phase": float(self.rng.uniform(-np.pi, np.pi)),
        }
        self.hidden.wave = (k, p["depth"], p["frequency"], p["phase"])
        return WavyFriction("joint", name, p)

    def resonance(self):
        k, name, _ = self.joint()
        p = {
            "inertia": float(self.run.inertia[k]) * self.size(0.15, 0.5),
            "frequency_hz": self.size(2.0, 5.0),
            "damping_ratio": float(self.rng.uniform(0.02, 0.08)),
        }
        return Resonance("joint", name, p)

    def hysteretic_hose(self):
        k, name, s = self.joint()
        travel = self.size(0.1, 0.4)
        p = {
            "stiffness": s * self.size(0.06, 0.2) / travel,
            "rest_angle": float(self.rng.uniform(*self.run.span[:, k])),
            "travel": travel,
            "elastic": float(self.rng.uniform(0.0, 0.1)),
        }
        return HystereticHose("joint", name, p)

    def torque_dead_band(self):
        _, name, s = self.joint()
        return un.TorqueDeadBand("joint", name, {"half_width": s * self.size(0.04, 0.25)})

    def cubic_spring(self):
        k, name, s = self.joint()
        low, high = self.run.span[:, k]
        half = max(0.5 * float(high - low), 1e-3)
        p = {"stiffness": s * self.size(0.03, 0.4) / half**3, "rest_angle": float(low + high) / 2}
        return un.CubicSpring("joint", name, p)

    def length_error(self):
        model = self.robot.model()
        parents = [model.body(int(model.body_parentid[b])).name for b in range(2, model.nbody)]
        far = np.linalg.norm(model.body_pos[2:], axis=1)
        held = [p for p, x in zip(parents, far, strict=True) if p in self.robot.bodies and x > 0]
        if not held:
            return self.cubic_spring()
        k = int(self.rng.integers(len(held)))
        reach = float(far[parents.index(held[k])])
        extension = self.sign() * reach * self.size(0.03, 0.15)
        return un.LengthError("body", held[k], {"extension": extension})

    def clock_skew(self):
        return un.ClockSkew("global", "global", {"rate": self.sign() * self.size(1e-3, 8e-3)})

    def load_ripple(self):
        _, name, _ = self.joint()
        p = {
            "coefficient": self.size(0.03, 0.15),
            "frequency": float(round(self.size(4, 16))),
            "phase": float(self.rng.uniform(-np.pi, np.pi)),
        }
        return un.LoadRipple("joint", name, p)

    def stop_cushion(self):
        k, name, s = self.joint()
        low, high = map(float, self.run.span[:, k])
        side, depth = self.sign(), float(self.rng.uniform(0.1, 0.35)) * (high - low)
        p = {
            "stiffness": s * self.size(0.02, 0.4) / depth,
            "onset": high - depth if side > 0 else low + depth,
            "side": side,
        }
        return un.StopCushion("joint", name, p)


def equivalents(robot: Robot, odd: fx.Effect) -> list[dict]:
    """What explains the same log, exactly or within this motion, where theory says so."""
    out: list[tuple[str, str, str, str]] = []
    if odd.family == "time_delay":
        out = [("actuator_lag", "global", "global", "motion_limited")]
    if odd.family == "actuator_lag":
        out = [("time_delay", "global", "global", "motion_limited")]
    if isinstance(odd, JointCoupling):
        out = [("joint_coupling", "joint", odd.before, "exact")]
    normal, first = plane(robot), robot.joints[0]
    swings = normal is not None and abs(normal[2]) < 0.5
    if swings and odd.family == "gravity_tilt":
        out = [("encoder_offset", "joint", first, "exact")]
    if swings and (odd.family, odd.name) == ("encoder_offset", first):
        out = [("gravity_tilt", "global", "global", "exact")]
    if odd.family == "payload":
        out = [("com_shift", "body", odd.name, "motion_limited")]
    return [{"family": f, "location": {"kind": k, "name": n}, "kind": tie} for f, k, n, tie in out]
