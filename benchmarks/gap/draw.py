"""Draws hidden effects: family, place and size, in the ranges of the taxonomy.

Sizes of joint effects scale with s, the peak torque of that joint in the nominal run of the motion.
"""

from __future__ import annotations

import effects as fx
import friction as fr
import numpy as np
import twomass as tm
import unknowns as un
from check import inverse_dynamics
from motions import make_motion
from robots import Robot

DEGREE = np.pi / 180.0


class Draw:
    """One draw of effects for a robot whose motion has peak torques `peak` (n).

    `busy` (n) is the torque exceeded in a tenth of the motion.
    """

    def __init__(self, robot: Robot, rng, peak, busy, span, small=False, slip=1e-3):
        """`span`: joint range of the motion (2, n); `slip`: longest presliding distance, rad."""
        self.robot, self.rng, self.small, self.slip = robot, rng, small, slip
        self.peak, self.busy = np.asarray(peak), np.asarray(busy)
        self.span = span

    def size(self, low: float, high: float) -> float:
        """Log-uniform; `small` keeps to the lower third of the range."""
        top = low * (high / low) ** 0.33 if self.small else high
        return float(np.exp(self.rng.uniform(np.log(low), np.log(top))))

    def sign(self) -> float:
        return float(self.rng.choice([-1.0, 1.0]))

    def direction(self) -> np.ndarray:
        x = self.rng.normal(size=3)
        if self.robot.name == "arm2":
            x[1] *= 0.2  # across the plane of a planar arm nothing shows
        return x / np.linalg.norm(x)

    def joint(self, skip: tuple[str, ...] = ()) -> tuple[str, float]:
        k = int(self.rng.choice([i for i, j in enumerate(self.robot.joints) if j not in skip]))
        return self.robot.joints[k], float(self.peak[k])

    def body(self, skip: tuple[str, ...] = ()) -> str:
        names = [b for b in self.robot.bodies if b not in skip and not b.endswith("_hip")]
        if self.robot.floating:  # a third of the body effects sit on the trunk
            weight = np.where([b == "trunk" for b in names], 0.5 * len(names), 1.0)
            return str(self.rng.choice(names, p=weight / weight.sum()))
        return str(self.rng.choice(names))

    def make(self, family: str) -> fx.Effect:
        return getattr(self, family)()

    # -- friction and other torques of a joint

    def _presliding(self) -> float:
        return float(np.exp(self.rng.uniform(np.log(1e-4), np.log(self.slip))))

    def viscous_friction(self):
        name, s = self.joint()
        return fr.ViscousFriction("joint", name, {"damping": s * self.size(0.02, 0.15)})

    def coulomb_friction(self):
        name, s = self.joint()
        p = {"coulomb": s * self.size(0.02, 0.12), "presliding": self._presliding()}
        return fr.CoulombFriction("joint", name, p)

    def asymmetric_coulomb(self):
        name, s = self.joint()
        low, ratio = s * self.size(0.02, 0.08), float(self.rng.uniform(1.5, 3.0))
        pair = [low, ratio * low] if self.sign() > 0 else [ratio * low, low]
        p = {"positive": pair[0], "negative": pair[1], "presliding": self._presliding()}
        return fr.AsymmetricCoulomb("joint", name, p)

    def stribeck_friction(self):
        name, s = self.joint()
        coulomb = s * self.size(0.02, 0.12)
        p = {
            "coulomb": coulomb,
            "stiction": coulomb * float(self.rng.uniform(1.3, 2.6)),
            "stribeck_velocity": float(np.exp(self.rng.uniform(np.log(0.03), np.log(0.2)))),
            "presliding": self._presliding(),
        }
        return fr.StribeckFriction("joint", name, p)

    def load_friction(self):
        name, s = self.joint()
        p = {
            "coulomb": s * self.size(0.01, 0.05),
            "load_coefficient": self.size(0.03, 0.2),
            "presliding": self._presliding(),
        }
        return fr.LoadFriction("joint", name, p)

    def friction_drift(self):
        name, s = self.joint()
        damping = s * self.size(0.03, 0.15)
        left = float(self.rng.choice([0.0, 0.0, 0.2])) * damping
        p = {"damping": damping, "damping_end": left, "time_constant": self.rng.uniform(2.0, 8.0)}
        return fr.FrictionDrift("joint", name, p)

    def joint_spring(self):
        name, s = self.joint()
        k = self.robot.joints.index(name)
        rest = float(self.rng.uniform(self.span[0][k] - 0.3, self.span[1][k] + 0.3))
        return fr.JointSpring(
            "joint", name, {"stiffness": s * self.size(0.02, 0.3), "rest_angle": rest}
        )

    def cogging(self):
        name, s = self.joint()
        p = {
            "amplitude": s * self.size(0.01, 0.08),
            "frequency": float(round(np.exp(self.rng.uniform(np.log(6), np.log(40))))),
            "phase": float(self.rng.uniform(-np.pi, np.pi)),
        }
        return fr.Cogging("joint", name, p)

    def armature(self):
        name, _ = self.joint()
        nominal = float(self.robot.model().joint(name).armature[0])
        grow = self.rng.random() < 0.65
        change = self.size(0.3, 1.5) if grow else -self.size(0.3, 0.8)
        return fx.Armature("joint", name, {"armature": change * nominal})

    # -- the drive and the encoder

    def torque_gain(self):
        name, _ = self.joint()
        return fx.TorqueGain("joint", name, {"gain": 1.0 + self.sign() * self.size(0.03, 0.2)})

    def torque_bias(self):
        name, s = self.joint()
        return fx.TorqueBias("joint", name, {"bias": self.sign() * s * self.size(0.01, 0.1)})

    def torque_saturation(self):
        name, s = self.joint()
        share = self.rng.uniform(0.75, 0.9) if self.small else self.rng.uniform(0.55, 0.9)
        # A drive that cannot hold its load for long is a broken robot, not a gap.
        busy = 1.02 * float(self.busy[self.robot.joints.index(name)])
        return fx.TorqueSaturation("joint", name, {"limit": max(s * float(share), busy)})

    def _drive(self) -> tuple[str, str]:
        return ("global", "global") if self.rng.random() < 0.6 else ("joint", self.joint()[0])

    def time_delay(self):
        return fx.TimeDelay(*self._drive(), {"delay": self.size(0.002, 0.02)})

    def actuator_lag(self):
        return fx.ActuatorLag(*self._drive(), {"time_constant": self.size(0.003, 0.03)})

    def encoder_offset(self):
        # A vertical first axis: gravity does not see its angle.
        name, _ = self.joint(("joint1",) if self.robot.name == "arm7" else ())
        offset = self.sign() * self.size(1.0, 5.0) * DEGREE
        return fx.EncoderOffset("joint", name, {"offset": offset})

    def encoder_scale(self):
        name, _ = self.joint()
        return fx.EncoderScale("joint", name, {"scale": self.sign() * self.size(0.004, 0.02)})

    def joint_elasticity(self):
        name, s = self.joint()
        return tm.JointElasticity("joint", name, {"stiffness": s / self.size(0.01, 0.05)})

    def backlash(self):
        name, s = self.joint()
        p = {"dead_zone": self.size(0.1, 2.0) * DEGREE, "stiffness": s / 0.005}
        return tm.Backlash("joint", name, p)

    # -- bodies and the world

    def gravity_tilt(self):
        angle = self.size(0.5, 4.0) * DEGREE
        about = self.rng.uniform(0, 2 * np.pi)
        if self.robot.name == "arm2":  # about the plane's normal; the rest is invisible
            about = self.sign() * np.pi / 2 + self.rng.normal(0, 0.2)
        tilt = [float(angle * np.cos(about)), float(angle * np.sin(about))]
        return fx.GravityTilt("global", "global", {"tilt": tilt})

    def _skip(self) -> tuple[str, ...]:
        # The first link of arm7 turns about a vertical axis: all that shows there is an armature.
        return ("link1",) if self.robot.name == "arm7" else ()

    def payload(self):
        name = self.body(self._skip())
        model = self.robot.model()
        low, high = self.robot.payload
        # A leg carries no more than about its own mass.
        own = float(model.body(name).mass[0])
        high = max(1.5 * low, min(high, 1.2 * own)) if self.robot.floating else high
        place = model.body(name).ipos + self.rng.normal(0.0, 0.04, 3)
        p = {
            "mass": self.size(low, high),
            "com": [float(x) for x in place],
            "size": float(self.rng.uniform(0.02, 0.12)),
        }
        return fx.Payload("body", name, p)

    def com_shift(self):
        shift = self.size(0.003, 0.04) * self.direction()
        return fx.ComShift(
            "body", self.body(self._skip()), {"com_shift": [float(x) for x in shift]}
        )

    def link_inertia(self):
        grow = self.rng.random() < 0.7
        scale = 1.0 + (self.size(0.3, 2.0) if grow else -self.size(0.25, 0.7))
        return fx.LinkInertia("body", self.body(), {"inertia_scale": scale})

    def _force(self, factor: float) -> list[float]:
        low, high = self.robot.force
        return [float(x) for x in self.size(low, factor * high) * self.direction()]

    def constant_force(self):
        return fx.ConstantForce("body", self.body(self._skip()), {"force": self._force(1.0)})

    def push(self):
        length = float(np.exp(self.rng.uniform(np.log(0.1), np.log(2.0))))
        start = float(self.rng.uniform(0.8, 6.0 - length))
        p = {"force": self._force(2.0), "start": start, "end": start + length}
        return fx.Push("body", self.body(self._skip()), p)

    def drag(self):
        return fx.Drag("body", self.body(self._skip()), {"coefficient": self.size(1.0, 15.0)})

    def contact_force_scale(self):
        scale = 1.0 + self.sign() * self.size(0.02, 0.2)
        foot = str(self.rng.choice(self.robot.feet))
        return fx.ContactForceScale("contact", foot, {"scale": scale})

    # -- what no library has

    def joint_coupling(self):
        name, s = self.joint()
        return un.JointCoupling("joint", name, {"coefficient": s * self.size(0.03, 0.15)})

    def quadratic_friction(self):
        name, s = self.joint()
        return un.QuadraticFriction("joint", name, {"coefficient": s * self.size(0.03, 0.15)})

    def load_ripple(self):
        name, _ = self.joint()
        p = {
            "coefficient": self.size(0.03, 0.15),
            "frequency": float(self.rng.integers(2, 9)),
            "phase": float(self.rng.uniform(-np.pi, np.pi)),
        }
        return un.LoadRipple("joint", name, p)

    def stop_cushion(self):
        name, s = self.joint()
        k, side = self.robot.joints.index(name), self.sign()
        low, high = self.span[0][k], self.span[1][k]
        depth = float(self.rng.uniform(0.12, 0.3)) * (high - low)
        onset = high - depth if side > 0 else low + depth
        p = {"stiffness": s * self.size(0.15, 0.5) / depth, "onset": onset, "side": side}
        return un.StopCushion("joint", name, p)

    def length_error(self):
        name = self.body((self.robot.bodies[-1],))
        return un.LengthError("body", name, {"extension": self.sign() * self.size(0.01, 0.05)})

    def clock_skew(self):
        return un.ClockSkew("global", "global", {"rate": self.sign() * self.size(3e-4, 2e-3)})


def reference_peaks(robot: Robot, kind: str, seed: list[int], duration: float):
    """Peak and 90 % torques (n) and joint range (2, n) of an arm's reference, nominal model."""
    motion = make_motion(robot, kind, seed)
    q, v, a = (np.array(x) for x in zip(*map(motion, np.arange(0, duration, 0.01)), strict=True))
    tau = np.abs(inverse_dynamics(robot.model(), q, v, a))
    return tau.max(0), np.percentile(tau, 90, axis=0), np.array([q.min(0), q.max(0)])


def equivalents(robot: Robot, effect: fx.Effect) -> list[dict]:
    """Candidates that explain the same log exactly, where theory says so."""
    found: list[tuple[str, str, str]] = []
    place = (effect.family, effect.name)
    first = {("armature", "joint1"), ("link_inertia", "link1")}
    if not robot.floating and place in first:
        others = [("armature", "joint", "joint1"), ("link_inertia", "body", "link1")]
        if robot.name == "arm7":
            others += [("payload", "body", "link1"), ("com_shift", "body", "link1")]
        found = [o for o in others if (o[0], o[2]) != place]
    if robot.name == "arm2":
        if effect.family == "gravity_tilt":
            found.append(("encoder_offset", "joint", "joint1"))
        if place == ("encoder_offset", "joint1"):
            found.append(("gravity_tilt", "global", "global"))
    if robot.floating and effect.kind == "body" and effect.name.endswith("_shank"):
        foot = effect.name.replace("_shank", "_foot")
        if effect.family in ("payload", "com_shift", "link_inertia"):
            found.append((effect.family, "body", foot))
    return [{"family": f, "location": {"kind": k, "name": n}, "kind": "exact"} for f, k, n in found]
