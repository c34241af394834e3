"""Draws hidden effects of the families in the taxonomy: place, and a size log-uniform from below what can be seen.

Sizes of joint effects scale with s, the peak torque of that joint in the motion. Truth holds the numbers a diagnosis
would report, in its names and units.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from world import mechanics as me
from world.describe import Machine, merged

DEGREE = math.pi / 180.0
FRICTION = ("coulomb_friction", "asymmetric_coulomb", "stribeck_friction", "load_friction")
ARM = (
    *FRICTION,
    *("viscous_friction", "friction_drift", "armature", "joint_spring", "cogging"),
    *("torque_gain", "torque_bias", "torque_saturation", "encoder_offset", "encoder_scale"),
    *("joint_elasticity", "backlash", "time_delay", "actuator_lag", "gravity_tilt", "payload"),
    *("com_shift", "link_inertia", "constant_force", "push", "drag"),
)
FLOATING = (*(f for f in ARM if f not in ("drag",)), "contact_force_scale")


@dataclass
class Hidden:
    """One hidden effect: its truth and its mechanics. `lasting`: whether the other motion has it, too."""

    family: str
    kind: str
    name: str
    numbers: dict[str, tuple[float, str]]
    parts: list[me.Part]
    mechanism: str = ""
    lasting: bool = True
    details: dict = field(default_factory=dict)

    def truth(self) -> dict:
        return {
            "family": self.family,
            "mechanism": self.mechanism or self.family,
            "location": {"kind": self.kind, "name": self.name},
            "parameters": {k: {"value": float(v), "unit": u} for k, (v, u) in self.numbers.items()},
            "lasting": self.lasting,
            "details": self.details,
        }


@dataclass
class Scene:
    """What sizes and places depend on: peak and busy (90 %) torques (n), joint range of the motion (2, n)."""

    machine: Machine
    peak: np.ndarray
    busy: np.ndarray
    span: np.ndarray
    duration: float
    rng: np.random.Generator

    def size(self, low: float, high: float) -> float:
        """Log-uniform from a sixth of the least typical size, where few would see it."""
        return float(np.exp(self.rng.uniform(np.log(low / 6.0), np.log(high))))

    def between(self, low: float, high: float) -> float:
        return float(np.exp(self.rng.uniform(np.log(low), np.log(high))))

    def sign(self) -> float:
        return float(self.rng.choice([-1.0, 1.0]))

    def joint(self, skip: tuple[int, ...] = ()) -> tuple[int, str, float]:
        k = int(self.rng.choice([i for i in range(len(self.peak)) if i not in skip]))
        return (
            k,
            self.machine.joints[k],
            max(float(self.peak[k]), 0.02 * float(self.machine.peak[k])),
        )

    def body(self) -> str:
        """A link that moves, not one too light to matter; a third of a floating robot's effects sit on its base."""
        links = self.machine.links
        if self.machine.floating:
            if self.rng.random() < 0.35:
                return links[0].name
            heavy = [x.name for x in links[1:] if x.mass > 0.5 and x.joint]
            return str(self.rng.choice(heavy))
        # A first link about a vertical axis shows an armature and nothing else.
        first = 1 if links[0].axis == "z" else 0
        return str(self.rng.choice([x.name for x in links[first:]]))

    def direction(self) -> np.ndarray:
        x = self.rng.normal(size=3)
        if self.machine.name == "two":
            x[1] *= 0.2
        return x / np.linalg.norm(x)

    def presliding(self) -> float:
        return self.between(1e-4, 2e-3)

    def bristle(self) -> str:
        return str(self.rng.choice(["lugre", "maxwell"]))


def hide(family: str, s: Scene) -> Hidden:
    """One effect of a known family."""
    return globals()[f"_{family}"](s)


def _dry(s, family, k, name, numbers, base, level=None) -> Hidden:
    presliding, kind = s.presliding(), s.bristle()
    part = me.Dry(k, base, presliding, kind, level)
    details = {"presliding": presliding, "bristle": kind}
    return Hidden(family, "joint", name, numbers, [part], details=details)


def _coulomb_friction(s: Scene) -> Hidden:
    k, name, top = s.joint()
    c = top * s.size(0.02, 0.12)
    return _dry(s, "coulomb_friction", k, name, {"coulomb": (c, "N m")}, c)


def _asymmetric_coulomb(s: Scene) -> Hidden:
    k, name, top = s.joint()
    low = top * s.size(0.02, 0.08)
    pair = (low, low * s.between(1.5, 3.0))
    up, down = pair if s.sign() > 0 else pair[::-1]
    numbers = {"positive": (up, "N m"), "negative": (down, "N m")}
    return _dry(s, "asymmetric_coulomb", k, name, numbers, 0.5 * (up + down),
                lambda v, u: up if v > 0 else down)  # fmt: skip


def _stribeck_friction(s: Scene) -> Hidden:
    k, name, top = s.joint()
    c = top * s.size(0.02, 0.12)
    stick, speed = c * s.between(1.3, 2.6), s.between(0.03, 0.2)
    numbers = {
        "coulomb": (c, "N m"),
        "stiction": (stick, "N m"),
        "stribeck_velocity": (speed, "rad/s"),
    }

    def level(v, u):
        return c + (stick - c) * math.exp(-((v / speed) ** 2))

    return _dry(s, "stribeck_friction", k, name, numbers, stick, level)


def _load_friction(s: Scene) -> Hidden:
    k, name, top = s.joint()
    c, mu = top * s.size(0.01, 0.05), s.size(0.03, 0.2)
    numbers = {"coulomb": (c, "N m"), "load_coefficient": (mu, "1")}
    return _dry(s, "load_friction", k, name, numbers, c + 0.3 * mu * top,
                lambda v, u: c + mu * abs(u))  # fmt: skip


def _law(family, k, name, numbers, law, **more) -> Hidden:
    return Hidden(family, "joint", name, numbers, [me.Law(k, law)], **more)


def _viscous_friction(s: Scene) -> Hidden:
    k, name, top = s.joint()
    d = top * s.size(0.02, 0.15)
    numbers = {"damping": (d, "N m s/rad")}
    return _law("viscous_friction", k, name, numbers, lambda t, q, v, u: -d * v[k])


def _friction_drift(s: Scene) -> Hidden:
    k, name, top = s.joint()
    d, time = top * s.size(0.03, 0.15), s.between(2.0, 8.0)
    end = d * float(s.rng.choice([0.0, 0.2, 0.4]))
    numbers = {
        "damping": (d, "N m s/rad"),
        "damping_final": (end, "N m s/rad"),
        "time_constant": (time, "s"),
    }

    def law(t, q, v, u):
        return -(end + (d - end) * math.exp(-max(t, 0.0) / time)) * v[k]

    return _law("friction_drift", k, name, numbers, law)


def _joint_spring(s: Scene) -> Hidden:
    k, name, top = s.joint()
    stiffness = top * s.size(0.02, 0.3)
    rest = float(s.rng.uniform(s.span[0, k] - 0.3, s.span[1, k] + 0.3))
    numbers = {"stiffness": (stiffness, "N m/rad"), "rest_angle": (rest, "rad")}
    return _law("joint_spring", k, name, numbers, lambda t, q, v, u: -stiffness * (q[k] - rest))


def _cogging(s: Scene) -> Hidden:
    k, name, top = s.joint()
    a, n = top * s.size(0.01, 0.08), float(round(s.between(6, 40)))
    phase, second = float(s.rng.uniform(-np.pi, np.pi)), float(s.rng.uniform(0.0, 0.15))
    numbers = {"amplitude": (a, "N m"), "frequency": (n, "1/rad"), "phase": (phase, "rad")}

    def law(t, q, v, u):
        angle = n * q[k] + phase
        return a * (math.sin(angle) + second * math.sin(2 * angle + 1.1))

    return _law("cogging", k, name, numbers, law, details={"second_harmonic": second})


def _armature(s: Scene) -> Hidden:
    k, name, _ = s.joint()
    nominal = float(s.machine.array("armature")[k])
    change = nominal * (s.size(0.3, 1.5) if s.rng.random() < 0.65 else -s.size(0.3, 0.8))

    def edit(m):
        which = m.of_joint(name)
        return m.edited(which, armature=m.links[which].armature + change)

    numbers = {"armature": (change, "kg m²")}
    return Hidden("armature", "joint", name, numbers, [me.Edit(edit)])


def _torque_gain(s: Scene) -> Hidden:
    k, name, _ = s.joint()
    g = 1.0 + s.sign() * s.size(0.03, 0.2)
    return Hidden("torque_gain", "joint", name, {"gain": (g, "1")}, [me.Gain(k, g)])


def _torque_bias(s: Scene) -> Hidden:
    k, name, top = s.joint()
    b = s.sign() * top * s.size(0.01, 0.1)
    return Hidden("torque_bias", "joint", name, {"bias": (b, "N m")}, [me.Bias(k, b)])


def _torque_saturation(s: Scene) -> Hidden:
    """Half of the drives also weaken with speed, and all bend a little before their limit."""
    k, name, top = s.joint()
    # A drive that cannot hold its load for long is a broken robot, not a gap.
    limit = max(top * float(s.rng.uniform(0.55, 0.97)), 1.03 * float(s.busy[k]))
    slope = float(s.rng.uniform(0.05, 0.25)) if s.rng.random() < 0.5 else 0.0
    knee, soft = 0.5 * float(s.machine.speed[k]), float(s.rng.uniform(0.0, 0.04))
    part = me.Limit(k, limit, knee, slope, soft)
    details = {"knee": knee, "slope": slope, "soft": soft}
    return Hidden(
        "torque_saturation", "joint", name, {"limit": (limit, "N m")}, [part], details=details
    )


def _encoder_offset(s: Scene) -> Hidden:
    # Gravity does not see the angle of a vertical first axis.
    skip = (0,) if s.machine.links[0].axis == "z" else ()
    k, name, _ = s.joint(skip)
    o = s.sign() * s.size(1.0, 5.0) * DEGREE
    return Hidden("encoder_offset", "joint", name, {"offset": (o, "rad")}, [me.Encoder(k, o, 0.0)])


def _encoder_scale(s: Scene) -> Hidden:
    k, name, _ = s.joint()
    x = s.sign() * s.size(0.004, 0.02)
    return Hidden("encoder_scale", "joint", name, {"scale": (x, "1")}, [me.Encoder(k, 0.0, x)])


def _joint_elasticity(s: Scene) -> Hidden:
    k, name, top = s.joint()
    stiffness, harder = top / s.size(0.01, 0.05), float(s.rng.choice([0.0, 200.0]))
    at_link = bool(s.rng.random() < 0.5)
    part = me.TwoMass(k, stiffness, 0.05, harder, 0.0, s.presliding(), at_link)
    numbers = {"stiffness": (stiffness, "N m/rad")}
    details = {"hardening": harder, "rubs_at_link": at_link}
    return Hidden("joint_elasticity", "joint", name, numbers, [part], details=details)


def _backlash(s: Scene) -> Hidden:
    k, name, top = s.joint()
    zone, stiffness = s.size(0.1, 2.0) * DEGREE, top / s.between(0.002, 0.008)
    at_link = bool(s.rng.random() < 0.5)
    part = me.TwoMass(k, stiffness, 0.25, 0.0, zone, s.presliding(), at_link)
    numbers = {"dead_zone": (zone, "rad"), "stiffness": (stiffness, "N m/rad")}
    return Hidden("backlash", "joint", name, numbers, [part], details={"rubs_at_link": at_link})


def _drive(s: Scene) -> tuple[str, str, slice]:
    if s.rng.random() < 0.6:
        return "global", "global", slice(None)
    k, name, _ = s.joint()
    return "joint", name, slice(k, k + 1)


def _time_delay(s: Scene) -> Hidden:
    kind, name, which = _drive(s)
    d = s.size(0.002, 0.02)
    return Hidden("time_delay", kind, name, {"delay": (d, "s")}, [me.Delay(which, d)])


def _actuator_lag(s: Scene) -> Hidden:
    kind, name, which = _drive(s)
    lag = s.size(0.003, 0.03)
    return Hidden("actuator_lag", kind, name, {"time_constant": (lag, "s")}, [me.Lag(which, lag)])


def _gravity_tilt(s: Scene) -> Hidden:
    angle, about = s.size(0.5, 4.0) * DEGREE, float(s.rng.uniform(0, 2 * np.pi))
    if s.machine.name == "two":
        about = s.sign() * np.pi / 2 + float(s.rng.normal(0, 0.2))
    x, y = angle * math.cos(about), angle * math.sin(about)
    # Rodrigues' rotation of (0, 0, -g) by the vector (x, y, 0).
    down = 9.81 * np.array(
        [-y / angle * math.sin(angle), x / angle * math.sin(angle), -math.cos(angle)]
    )

    def edit(m: Machine) -> Machine:
        from dataclasses import replace

        return replace(m, gravity=tuple(float(g) for g in down))

    numbers = {"tilt_x": (x, "rad"), "tilt_y": (y, "rad")}
    return Hidden("gravity_tilt", "global", "global", numbers, [me.Edit(edit)])


def _of_body(family: str, body: str, numbers, change) -> Hidden:
    def edit(m: Machine) -> Machine:
        which = m.index(body)
        return m.edited(which, **change(m.links[which]))

    return Hidden(family, "body", body, numbers, [me.Edit(edit)])


def _payload(s: Scene) -> Hidden:
    body = s.body()
    link = s.machine.links[s.machine.index(body)]
    low, high = s.machine.payload
    high = min(high, 1.2 * link.mass) if s.machine.floating else high
    mass = s.between(low, max(high, 2 * low))
    com, side = link.com + s.rng.normal(0.0, 0.04, 3), s.between(0.02, 0.12)
    piece = mass * side**2 / 6.0 * np.eye(3)
    numbers = {
        "mass": (mass, "kg"),
        **{f"com_{a}": (x, "m") for a, x in zip("xyz", com, strict=True)},
    }
    return _of_body("payload", body, numbers, lambda link: merged(link, mass, com, piece))


def _com_shift(s: Scene) -> Hidden:
    body, shift = s.body(), s.size(0.003, 0.04) * s.direction()
    numbers = {f"com_shift_{a}": (x, "m") for a, x in zip("xyz", shift, strict=True)}
    return _of_body("com_shift", body, numbers, lambda link: {"com": link.com + shift})


def _link_inertia(s: Scene) -> Hidden:
    body = s.body()
    scale = 1.0 + (s.size(0.3, 2.0) if s.rng.random() < 0.7 else -s.size(0.25, 0.7))
    numbers = {"inertia_scale": (scale, "1")}
    return _of_body("link_inertia", body, numbers, lambda link: {"inertia": scale * link.inertia})


def _newtons(s: Scene, factor: float) -> np.ndarray:
    low, high = s.machine.force
    return s.between(low, factor * high) * s.direction()


def _constant_force(s: Scene) -> Hidden:
    body, force = s.body(), _newtons(s, 1.0)
    numbers = {f"force_{a}": (x, "N") for a, x in zip("xyz", force, strict=True)}
    part = me.Force(body, lambda t, p, v: force[None])
    return Hidden("constant_force", "body", body, numbers, [part])


def _push(s: Scene) -> Hidden:
    body, force, length = s.body(), _newtons(s, 2.0), s.between(0.1, 2.0)
    start = float(s.rng.uniform(0.6, s.duration - 0.6 - length))
    end, flank = start + length, float(s.rng.uniform(0.1, 0.4)) * length

    def law(t, place, velocity):
        near = min(max(min(t - start, end - t) / flank, 0.0), 1.0)
        return (0.5 - 0.5 * math.cos(math.pi * near)) * force[None]

    numbers = {f"force_{a}": (x, "N") for a, x in zip("xyz", force, strict=True)}
    numbers |= {"start": (start, "s"), "end": (end, "s")}
    return Hidden("push", "body", body, numbers, [me.Force(body, law)], lasting=False)


def _drag(s: Scene) -> Hidden:
    body, c = s.body(), s.size(1.0, 15.0)

    def law(t, place, velocity):
        return -c * math.sqrt(float((velocity * velocity).sum())) * velocity

    return Hidden("drag", "body", body, {"coefficient": (c, "N s²/m²")}, [me.Force(body, law)])


def _contact_force_scale(s: Scene) -> Hidden:
    body, scale = str(s.rng.choice(s.machine.sensed)), 1.0 + s.sign() * s.size(0.02, 0.2)
    column = s.machine.sensed.index(body)

    def change(log):
        log["wrench"][:, column] *= scale

    numbers = {"scale": (scale, "1")}
    return Hidden("contact_force_scale", "contact", body, numbers, [me.Record(change)])
