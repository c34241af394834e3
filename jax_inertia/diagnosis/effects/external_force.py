"""Forces on a body: for good, of the air, and for a short time."""

from types import ModuleType

import numpy as np

from jax_inertia.diagnosis.effects import advice
from jax_inertia.diagnosis.effects.base import Applied, Bound, Columns, Effect, Moment, Parameter
from jax_inertia.maths.batch_last import cross

SHORTEST, LONGEST = 0.1, 3.0
"""Of a push [s]: a period of the band in which it is looked for; what lasts longer is no push."""


def weight_of(context) -> float:
    """Of the robot [N]."""
    return 9.81 * float(context.pi[:, 0].sum())


def usual_force(context) -> float:
    """Standard deviation of a force on a robot [N]: 10 N, more on one of over 40 kg."""
    return max(10.0, 0.025 * weight_of(context))


REACH = 0.06
"""Standard deviation of a load's lever on links of 0.15 to 1 m whose centre of mass is at the joint [m]."""


def lever_on(context, place) -> float:
    """Standard deviation of a lever on a body [m]: as far from the joint as its own centre of mass, and `REACH`."""
    pi = context.pi[place.index]
    own = float(np.linalg.norm(pi[1:4])) / max(float(pi[0]), 1e-9)
    return float(np.hypot(REACH * context.scale, own))


def push_window(xp: ModuleType, time, start: float, end: float, flank: float, skew: float):
    """w(t): flat between two flanks (Tukey's window; Harris 1978), and skewed, since nobody pushes symmetrically.

    `xp` is numpy or jax.numpy.
    """
    phase = xp.clip((time - start) / (end - start), 0.0, 1.0)
    near = xp.minimum(xp.minimum(phase, 1 - phase) / flank, 1.0)
    return (0.5 - 0.5 * xp.cos(np.pi * near)) * (1.0 + skew * xp.sin(2 * np.pi * phase))


def components(theta) -> dict[str, Parameter]:
    """A force's numbers."""
    return {f"force_{k}": Parameter(float(x), "N") for k, x in zip("xyz", theta, strict=True)}


def wrench_at(xp: ModuleType, now: Moment, at: Bound):
    """World force and moment about a body's centre of mass of a force there, or at a point of the body."""
    force = xp.asarray([at.values[f"force_{k}"] for k in "xyz"])
    if "point_x" not in at.values:
        return xp.concatenate([force, xp.zeros(3)])
    point = np.array([at.values[f"point_{k}"] for k in "xyz"])
    lever = now.turn[at.index] @ (point - at.centres[at.index])
    return xp.concatenate([force, cross(lever[None], force[None])[0]])


class _Force(Effect):
    kind = "body"
    mjcf = "none: step law (xfrc_applied)"


class ConstantForce(_Force):
    """θ = [f, p], p from the centre of mass along the body's axes; bilinear, the secant at θ."""

    name, equation, secant = "constant_force", "J(p)ᵀ f, f fixed in the world, p on the body", True
    loads = True
    source, advice = "a cable, a hoist, a balancer", advice.BRISK
    units = {f"force_{k}": "N" for k in "xyz"} | {f"point_{k}": "m" for k in "xyz"}
    prior = "10 N along each axis, at most the robot's weight, more above 40 kg; at the centre of mass, within a link"

    def shapes(self, context, place):
        return [(0.0,) * 6]

    def columns(self, context, place, shape):
        moved = context.lever_rows(place.index) @ np.asarray(shape[:3])
        return Columns(np.concatenate([context.force_rows[:, place.index], moved], axis=-1))

    def scale(self, context, place, shape):
        lever = lever_on(context, place)
        # Motors that carry a small robot would not move it against more for long.
        size = min(usual_force(context), weight_of(context))
        return np.append(np.full(3, size), np.full(3, lever))

    def numbers(self, context, place, shape, theta):
        pi = context.pi[place.index]
        own = pi[1:4] / pi[0] if pi[0] > 0 else np.zeros(3)
        point = zip("xyz", own + theta[3:], strict=True)
        return components(theta[:3]) | {f"point_{k}": Parameter(float(x), "m") for k, x in point}

    def step(self, xp, now, at, applied: Applied) -> Applied:
        return applied._replace(wrench=applied.wrench + at.body * wrench_at(xp, now, at))


class Drag(_Force):
    name, equation, form_error = "drag", "−c |v| v at the centre of mass", 0.05
    source, advice = "air, water: Newton's quadratic drag", advice.WIDE
    units, prior = {"coefficient": "N s²/m²"}, "6 N s²/m² on a robot of usual size, not below zero"

    def places(self, context):
        # Where only changes of the base's velocity are known, a drag is anything that changes as slowly.
        return super().places(context) if context.prepared.knows_velocity else []

    def columns(self, context, place, shape):
        v = context.com_velocity[:, place.index]
        f = -np.linalg.norm(v, axis=1, keepdims=True) * v
        return Columns(np.einsum("tjc,tc->tj", context.force_rows[:, place.index], f)[:, :, None])

    def scale(self, context, place, shape):
        return np.array([6.0 * context.scale**2])

    def lower(self, context, place):
        return 0.0

    def numbers(self, context, place, shape, theta):
        return {"coefficient": Parameter(float(theta[0]), "N s²/m²", 0.0)}

    def step(self, xp, now, at, applied: Applied) -> Applied:
        speed = xp.sqrt(xp.sum(now.velocity**2, axis=1, keepdims=True) + 1e-12)
        drag = at.values["coefficient"] * speed * now.velocity
        wrench = applied.wrench - xp.concatenate([at.body * drag, 0 * drag], axis=1)
        return applied._replace(wrench=wrench)


class Push(_Force):
    """A force for a short time."""

    name, form_error = "push", 0.1
    equation = (
        "Jᵀ f w(t), w = ½ (1 − cos πn)(1 + skew sin 2πp), p = (t − start)/(end − start) within [0, 1], "
        "n = min(p/flank, (1 − p)/flank, 1)"
    )
    source, advice = "a hand, a collision; w: Tukey's window (Harris 1978)", advice.AGAIN
    units = {
        **{f"force_{k}": "N" for k in "xyz"},
        "start": "s",
        "end": "s",
        "flank": "1",
        "skew": "1",
    }
    prior = "40 N along each axis, more on a robot of over 40 kg"

    def shapes(self, context, place):
        # Of what happens once, the search finds when.
        return []

    def steps(self, context, place, shape):
        return (0.1, 0.1, 0.1, 0.3)

    many = True

    def apart(self, context, place, one, other):
        # What overlaps in time is one push of another form.
        return one[1] <= other[0] or other[1] <= one[0]

    def within(self, context, place, shape):
        start, end, flank, skew = shape
        return SHORTEST <= end - start <= LONGEST and 0.05 <= flank <= 0.5 and abs(skew) <= 1.0

    def columns(self, context, place, shape):
        window = push_window(np, context.time, *shape)
        return Columns(context.force_rows[:, place.index] * window[:, None, None])

    def scale(self, context, place, shape):
        return np.full(3, 4 * usual_force(context))

    def numbers(self, context, place, shape, theta):
        start, end, flank, skew = shape
        return components(theta) | {
            "start": Parameter(start, "s"),
            "end": Parameter(end, "s"),
            "flank": Parameter(flank, "1", 0.0),
            "skew": Parameter(skew, "1"),
        }

    def step(self, xp, now, at, applied: Applied) -> Applied:
        shape = (at.values[name] for name in ("start", "end", "flank", "skew"))
        window = push_window(xp, now.t, *shape)
        return applied._replace(wrench=applied.wrench + at.body * wrench_at(xp, now, at) * window)
