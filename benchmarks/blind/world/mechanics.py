"""Between the drive and the rigid bodies: what a joint's torque goes through, in both engines alike.

A part may `edit` the robot, change the drive's torque (`drive`), add torque at a stage of the integrator (`load`),
carry states of its own (`rate`), act on bodies (`pull`), or change what the encoders and the log show (`sense`,
`record`).
"""

from __future__ import annotations

import math

import numpy as np

from world.bristles import BRISTLES, LuGre, Maxwell
from world.describe import Machine
from world.engines import Pull


class Part:
    """One piece of mechanics. `k` is its joint, where it has one; `path` is q since the last commit."""

    k = -1

    def edit(self, machine: Machine) -> Machine:
        return machine

    def bind(self, machine: Machine, inertia: np.ndarray) -> None:
        """`inertia` (n): what a torque on each joint feels."""

    def reset(self, q: np.ndarray, v: np.ndarray) -> None: ...

    def drive(self, t: float, h: float, u: np.ndarray, v: np.ndarray) -> None: ...

    def load(self, t: float, q, v, path, u, out) -> None: ...

    def commit(self, path, v, u) -> None: ...

    def sense(self, t: float, q: np.ndarray, v: np.ndarray) -> None: ...

    def record(self, log: dict[str, np.ndarray]) -> None: ...

    def pulls(self, machine: Machine) -> list[Pull]:
        return []

    def step_limit(self) -> float:
        """Longest step (s) that resolves it."""
        return math.inf


def limit_of(stiffness: float, inertia: float) -> float:
    """A quarter of a radian of the fastest oscillation."""
    return 0.25 / math.sqrt(stiffness / inertia)


class Damping(Part):
    """The nominal viscous friction of all joints."""

    def __init__(self, damping: np.ndarray):
        self.damping = damping.copy()

    def load(self, t, q, v, path, u, out):
        out -= self.damping * v


class KnownDry(Part):
    """The nominal dry friction of all joints, as real joints have it: bristles (LuGre, see `bristles`)."""

    def __init__(self, friction: np.ndarray, presliding: float):
        self.k_all = np.flatnonzero(friction)
        self.level, self.presliding = friction[self.k_all], presliding

    def bind(self, machine, inertia):
        self.stiffness = self.level / self.presliding
        self.loss = 0.6 * np.sqrt(self.stiffness * inertia[self.k_all])
        self.shortest = min(map(limit_of, self.stiffness, inertia[self.k_all]))

    def reset(self, q, v):
        self.z = np.zeros(len(self.k_all))

    def _after(self, path: np.ndarray) -> np.ndarray:
        steady = np.sign(path) * self.presliding
        return steady + (self.z - steady) * np.exp(-np.abs(path) / self.presliding)

    def load(self, t, q, v, path, u, out):
        z, speed = self._after(path[self.k_all]), v[self.k_all]
        rate = (speed - np.abs(speed) * z / self.presliding) * np.exp(-((speed / 0.015) ** 2))
        out[self.k_all] -= self.stiffness * z + self.loss * rate

    def commit(self, path, v, u):
        self.z = self._after(path[self.k_all])

    def step_limit(self):
        return self.shortest


class Dry(Part):
    """Dry friction at one joint. `level(speed, drive torque)` is what it slides with."""

    def __init__(self, k: int, base: float, presliding: float, kind: str, level=None):
        self.k, self.base, self.presliding, self.kind = k, base, presliding, kind
        self.level = level or (lambda speed, torque: base)

    def bind(self, machine, inertia):
        self.inertia = float(inertia[self.k])
        self.reset(None, None)

    def reset(self, q, v):
        self.bristle: LuGre | Maxwell = BRISTLES[self.kind](
            self.base, self.presliding, self.inertia
        )

    def load(self, t, q, v, path, u, out):
        k, speed = self.k, float(v[self.k])
        out[k] -= self.bristle.torque(float(path[k]), speed, self.level(speed, float(u[k])))

    def commit(self, path, v, u):
        self.bristle.commit(float(path[self.k]), self.level(float(v[self.k]), float(u[self.k])))

    def step_limit(self):
        return limit_of(self.bristle.stiffness, self.inertia)


class Law(Part):
    """A torque on one joint that is a plain function of time, angles and speeds."""

    def __init__(self, k: int, law):
        self.k, self.law = k, law

    def load(self, t, q, v, path, u, out):
        out[self.k] += self.law(t, q, v, u)


class Gain(Part):
    def __init__(self, k: int, gain: float):
        self.k, self.gain = k, gain

    def drive(self, t, h, u, v):
        u[self.k] *= self.gain


class Bias(Part):
    def __init__(self, k: int, bias: float):
        self.k, self.bias = k, bias

    def drive(self, t, h, u, v):
        u[self.k] += self.bias


class Limit(Part):
    """The drive gives at most `limit`, less above the `knee` speed, and bends softly into its limit."""

    def __init__(self, k: int, limit: float, knee: float, slope: float, soft: float):
        self.k, self.limit, self.knee, self.slope, self.soft = k, limit, knee, slope, soft

    def drive(self, t, h, u, v):
        k = self.k
        over = max(abs(v[k]) - self.knee, 0.0) if u[k] * v[k] > 0 else 0.0
        most = self.limit * max(1.0 - self.slope * over, 0.3)
        bend = self.soft * most
        excess = abs(u[k]) - (most - bend)
        if excess > 0:
            u[k] = math.copysign(most - bend * math.exp(-excess / max(bend, 1e-9)), u[k])


class Delay(Part):
    """Torque acts `delay` later, on the integration grid with a fraction (the command is held)."""

    def __init__(self, which: slice, delay: float):
        self.which, self.delay = which, delay

    def reset(self, q, v):
        self.past: list[np.ndarray] = []

    def drive(self, t, h, u, v):
        whole = self.delay / h
        shift, share = int(whole), whole - int(whole)
        self.past.insert(0, u[self.which].copy())
        del self.past[shift + 2 :]
        last = len(self.past) - 1
        near, far = self.past[min(shift, last)], self.past[min(shift + 1, last)]
        u[self.which] = (1.0 - share) * near + share * far


class Lag(Part):
    """First-order lag: the mean over each step of the exact response to a held input."""

    def __init__(self, which: slice, time_constant: float):
        self.which, self.time_constant = which, time_constant

    def reset(self, q, v):
        self.state = None

    def drive(self, t, h, u, v):
        new = u[self.which].copy()
        if self.state is None:
            self.state = new
        x = h / self.time_constant
        u[self.which] = new + (self.state - new) * (1.0 - math.exp(-x)) / x
        self.state = new + (self.state - new) * math.exp(-x)


class TwoMass(Part):
    """A motor behind a spring, with play if `dead_zone`: J θ̈ = u − d θ̇ − friction − s, the link feels s.

    s = K g (1 + h g²) + c ġ over the gap g = θ − q outside the play, never pulling inside it. Nominal armature,
    damping and friction of the joint move to the motor, and so does the encoder; with `rubs_at_link`, damping and
    friction stay: those of bearings and seals behind the gear.
    """

    def __init__(
        self, k, stiffness, ratio, hardening=0.0, dead_zone=0.0, presliding=3e-4, rubs_at_link=False
    ):
        self.k, self.stiffness, self.ratio = k, stiffness, ratio
        self.hardening, self.half, self.presliding = hardening, 0.5 * dead_zone, presliding
        self.rubs_at_link = rubs_at_link

    def edit(self, machine):
        which = machine.of_joint(machine.joints[self.k])
        link = machine.links[which]
        self.armature, self.damping, self.friction = link.armature, 0.0, 0.0
        if self.rubs_at_link:
            return machine.edited(which, armature=0.0)
        self.damping, self.friction = link.damping, link.friction
        return machine.edited(which, armature=0.0, damping=0.0, friction=0.0)

    def bind(self, machine, inertia):
        link = float(inertia[self.k])
        self.reduced = link * self.armature / (link + self.armature)
        self.loss = 2.0 * self.ratio * math.sqrt(self.stiffness * self.reduced)

    def reset(self, q, v):
        self.x = np.array([q[self.k], v[self.k]])
        self.rub = LuGre(self.friction, self.presliding, self.armature) if self.friction else None
        self.committed = self.x[0]

    def transmitted(self, gap: float, rate: float) -> float:
        sign = 1.0 if gap >= 0 else -1.0
        over = abs(gap) - self.half
        if self.half and over <= 0:
            return 0.0
        twist = sign * over if self.half else gap
        force = self.stiffness * twist * (1.0 + self.hardening * twist * twist) + self.loss * rate
        return force if not self.half else sign * max(sign * force, 0.0)

    def load(self, t, q, v, path, u, out):
        k, (angle, speed) = self.k, self.stage
        force = self.transmitted(angle - q[k], speed - v[k])
        out[k] += force - u[k]
        net = u[k] - force - self.damping * speed
        if self.rub:
            net -= self.rub.torque(angle - self.committed, speed, self.friction)
        self.rate = np.array([speed, net / self.armature])

    def commit(self, path, v, u):
        if self.rub:
            self.rub.commit(self.x[0] - self.committed, self.friction)
        self.committed = self.x[0]

    def sense(self, t, q, v):
        q[self.k], v[self.k] = self.x

    def step_limit(self):
        out = limit_of(2.0 * self.stiffness, self.reduced)
        return min(out, limit_of(self.rub.stiffness, self.armature)) if self.rub else out


class Encoder(Part):
    """q_logged = (1 + scale) q + offset, of the true joint angle."""

    def __init__(self, k: int, offset: float, scale: float):
        self.k, self.offset, self.scale = k, offset, scale

    def sense(self, t, q, v):
        q[self.k] = (1.0 + self.scale) * q[self.k] + self.offset
        v[self.k] *= 1.0 + self.scale


class Edit(Part):
    """A change of the rigid bodies."""

    def __init__(self, change):
        self.change = change

    def edit(self, machine):
        return self.change(machine)


class Force(Part):
    """A force at a body's centre of mass, in world axes."""

    def __init__(self, body: str, law):
        self.body, self.law = body, law

    def pulls(self, machine):
        com = np.asarray(machine.links[machine.index(self.body)].com)
        return [Pull((self.body,), com[None], self.law)]


class Record(Part):
    """A change of the finished log."""

    def __init__(self, change):
        self.change = change

    def record(self, log):
        self.change(log)
