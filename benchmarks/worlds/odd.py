"""Draws one odd effect of a robot as it is bought: of a family that a diagnosis knows, or of none."""

from __future__ import annotations

import numpy as np

from benchmarks.worlds import effects as fx
from benchmarks.worlds import friction as fr
from benchmarks.worlds import outside as un
from benchmarks.worlds import two_mass as tm
from benchmarks.worlds.hidden import Hidden, Motion, log_uniform, plane, turns_upright
from benchmarks.worlds.joint_physics import JointCoupling, OddFriction, loaded, stribeck
from benchmarks.worlds.outside import HystereticHose, Resonance, WavyFriction
from benchmarks.worlds.robots import Robot

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
