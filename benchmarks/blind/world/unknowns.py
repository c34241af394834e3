"""Effects that no library has: the honest answer is `unknown`, still with the place."""

from __future__ import annotations

import math

import numpy as np
from scipy.interpolate import CubicSpline

from world import mechanics as me
from world.draw import DEGREE, Hidden, Scene

UNKNOWN = (
    *("joint_coupling", "quadratic_friction", "load_ripple", "stop_cushion", "length_error"),
    *("clock_skew", "human_hand", "hysteretic_hose", "encoder_eccentricity"),
)


def hide_unknown(mechanism: str, s: Scene) -> Hidden:
    """One effect that has no family."""
    hidden = globals()[f"_{mechanism}"](s)
    hidden.family, hidden.mechanism = "unknown", mechanism
    return hidden


def _on_joint(k, name, numbers, law) -> Hidden:
    return Hidden("unknown", "joint", name, numbers, [me.Law(k, law)])


def _joint_coupling(s: Scene) -> Hidden:
    """A belt past a neighbour: −c q̇ − k q of the neighbour acts on this joint."""
    k, name, top = s.joint()
    other = k - 1 if k > 0 else 1
    c, spring = top * s.size(0.03, 0.15), top * s.size(0.03, 0.15)
    middle = float(s.span[:, other].mean())
    numbers = {"damping": (c, "N m s/rad"), "stiffness": (spring, "N m/rad")}
    return _on_joint(
        k, name, numbers, lambda t, q, v, u: -c * v[other] - spring * (q[other] - middle)
    )


def _quadratic_friction(s: Scene) -> Hidden:
    """Churning oil: −c |q̇| q̇."""
    k, name, top = s.joint()
    c = top * s.size(0.03, 0.15)
    numbers = {"coefficient": (c, "N m s²/rad²")}
    return _on_joint(k, name, numbers, lambda t, q, v, u: -c * abs(v[k]) * v[k])


def _load_ripple(s: Scene) -> Hidden:
    """An eccentric gear: a ripple over the angle, in proportion to the load."""
    k, name, _ = s.joint()
    c, n = s.size(0.03, 0.2), float(s.rng.integers(2, 12))
    phase = float(s.rng.uniform(-np.pi, np.pi))
    numbers = {"coefficient": (c, "1"), "frequency": (n, "1/rad"), "phase": (phase, "rad")}
    return _on_joint(
        k, name, numbers, lambda t, q, v, u: c * abs(u[k]) * math.sin(n * q[k] + phase)
    )


def _stop_cushion(s: Scene) -> Hidden:
    """Rubber before one hard stop: progressive, with losses."""
    k, name, top = s.joint()
    side, (low, high) = s.sign(), s.span[:, k]
    depth = float(s.rng.uniform(0.15, 0.35)) * (high - low)
    onset = high - depth if side > 0 else low + depth
    stiffness = top * s.size(0.15, 0.5) / max(depth, 0.05)
    numbers = {"stiffness": (stiffness, "N m/rad"), "onset": (float(onset), "rad")}

    def law(t, q, v, u):
        x = side * (q[k] - onset)
        if x <= 0.0:
            return 0.0
        return -side * stiffness * x * (1.0 + 3.0 * x) * (1.0 + 0.2 * math.tanh(side * v[k] / 0.3))

    return _on_joint(k, name, numbers, law)


def _hysteretic_hose(s: Scene) -> Hidden:
    """A hose that springs and yields: Dahl's hysteresis over half a radian, far from any presliding."""
    k, name, top = s.joint()
    level, reach = top * s.size(0.03, 0.2), s.between(0.15, 0.8)
    part = me.Dry(k, level, reach, "lugre")
    numbers = {"level": (level, "N m"), "reach": (reach, "rad")}
    return Hidden("unknown", "joint", name, numbers, [part])


def _encoder_eccentricity(s: Scene) -> Hidden:
    """The encoder's disk sits off its axis: q_logged = q + A sin(q + φ), or twice a turn."""
    k, name, _ = s.joint()
    a, n = s.size(0.3, 1.5) * DEGREE, float(s.rng.integers(1, 3))
    phase = float(s.rng.uniform(-np.pi, np.pi))

    class Disk(me.Part):
        def sense(self, t, q, v):
            v[k] *= 1.0 + a * n * math.cos(n * q[k] + phase)
            q[k] += a * math.sin(n * q[k] + phase)

    numbers = {"amplitude": (a, "rad"), "harmonic": (n, "1/rad"), "phase": (phase, "rad")}
    return Hidden("unknown", "joint", name, numbers, [Disk()])


def _length_error(s: Scene) -> Hidden:
    """A link is longer than modelled: what it carries sits further out; masses stay."""
    links = s.machine.links
    carried = [
        i for i, x in enumerate(links) if x.parent >= 0 and x.axis and np.linalg.norm(x.pos) > 0.08
    ]
    which = int(s.rng.choice(carried))
    grow = s.sign() * s.size(0.01, 0.05)
    body = links[links[which].parent].name

    def edit(m):
        pos = np.array(m.links[which].pos)
        return m.edited(which, pos=tuple(pos * (1.0 + grow / np.linalg.norm(pos))))

    return Hidden("unknown", "body", body, {"extension": (grow, "m")}, [me.Edit(edit)])


def _clock_skew(s: Scene) -> Hidden:
    """The encoders' clock runs at (1 + r) of the drives': row t holds q((1 + r) t)."""
    rate = s.sign() * s.size(3e-4, 2e-3)

    def change(log):
        time = log["time"]
        seen = np.clip((1.0 + rate) * time, time[0], time[-1])
        for name in ("qpos", "qvel"):
            log[name] = CubicSpline(time, log[name])(seen)

    return Hidden("unknown", "global", "global", {"rate": (rate, "1")}, [me.Record(change)])


def _human_hand(s: Scene) -> Hidden:
    """Someone holds a link for a while and works against it: a wandering force, unmeasured."""
    body, length = s.body(), float(s.rng.uniform(1.0, 3.0))
    start = float(s.rng.uniform(0.6, s.duration - 0.6 - length))
    low, high = s.machine.force
    size = s.between(low, 2.0 * high)
    omega = 2 * np.pi * s.rng.uniform(0.4, 2.5, (4, 3))
    phase = s.rng.uniform(0, 2 * np.pi, (4, 3))
    steady, loss = 0.4 * s.direction(), 0.3 * size

    def law(t, place, velocity):
        near = min(max(min(t - start, start + length - t) / 0.25, 0.0), 1.0)
        if near == 0.0:
            return np.zeros((1, 3))
        wave = steady + 0.45 * np.sin(omega * t + phase).sum(0)
        return (near * near * (3 - 2 * near)) * (size * wave[None] - loss * velocity)

    numbers = {"force": (size, "N"), "start": (start, "s"), "end": (start + length, "s")}
    return Hidden("unknown", "body", body, numbers, [me.Force(body, law)], lasting=False)
