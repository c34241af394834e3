"""Dry friction at a joint: its level, and how that depends on direction, speed and load.

All act through one direction state z in [−1, 1], which turns over a presliding displacement after a reversal (Dahl
1968), the first nonlinear number [rad]; below zero it is the level [N m] at which MuJoCo's friction loss creeps. The
second is the way it turns. Extra forms are columns beside the constant level, so that levels add; a search that fits
both at once has the level before them.
"""

import numpy as np

from jax_inertia.diagnosis.effects import advice
from jax_inertia.diagnosis.effects.base import Edit, Effect, Parameter, Shape, of_row, peak_of
from jax_inertia.diagnosis.effects.joint import ARMSTRONG
from jax_inertia.diagnosis.effects.spec_joint import add_friction, joint_of, wind

PRESLIDING = (0.0, 5e-5, 1e-4, 2e-4, 4e-4, 8e-4, 1.6e-3, 3e-3, 6e-3)
"""Displacements searched [rad]: 1e-4 to 3e-3 in geared joints (Armstrong-Hélouvry et al. 1994)."""
STRIBECK_SPEEDS = (0.02, 0.035, 0.06, 0.1, 0.17, 0.3)
"""Speeds searched [rad/s]."""
BENT, STRAIGHT = 0.0, 1.0
"""How friction turns over a displacement: as Dahl's bristles bend, or as a straight spring slips."""


def direction(context, row: int, presliding: float, way: float = BENT) -> np.ndarray:
    """z(t) of a joint (T,)."""
    if presliding < 0:
        return context.creeping(row, -presliding)
    if not presliding:
        return context.side[:, row]
    return context.bristle(row, presliding, straight=way == STRAIGHT)


def turnings(context, place) -> list[Shape]:
    """How a joint's dry friction may turn round: presliding and way; the levels that MuJoCo's creeps at."""
    peak = peak_of(context, place.index)
    return [(x, BENT) for x in (*PRESLIDING, *(-peak * s for s in (0.3, 0.1, 0.03)))]


class DryFriction(Effect):
    """A form of a joint's dry friction; its nonlinear numbers begin with presliding displacement [rad] and way."""

    form_error, source, advice = 0.03, ARMSTRONG, advice.SLOW_REVERSALS

    def shapes(self, context, place) -> list[Shape]:
        return turnings(context, place)

    def direction(self, context, place, shape) -> np.ndarray:
        """z in [−1, 1] that multiplies the level (T,)."""
        return direction(context, place.index, float(shape[0]), shape[1])

    def edit(self, spec, model, found):
        # The level; what varies about it is written to `dof_frictionloss` at each step.
        add_friction(joint_of(spec, found), found.values["coulomb"])
        return Edit(whole=False)


class CoulombFriction(DryFriction):
    name, equation, ordinary = "coulomb_friction", "−F z, z → sign(q̇)", True
    source = "Coulomb 1785; presliding: Dahl 1968"
    units = {"coulomb": "N m"}
    prior = "0.15 of the joint's peak torque; not below minus the model's own"
    mjcf = "joint frictionloss"

    def columns(self, context, place, shape):
        return of_row(-self.direction(context, place, shape), place)

    def scale(self, context, place, shape):
        return np.array([0.15 * peak_of(context, place.index)])

    def numbers(self, context, place, shape, theta):
        return {"coulomb": Parameter(float(theta[0]), "N m")}

    def lower(self, context, place):
        return -float(context.frictionloss[place.index])

    def edit(self, spec, model, found):
        add_friction(joint_of(spec, found), found.values["coulomb"])
        return Edit(whole=True)


ONE_WAY = 0.82
"""Half the difference of friction's two levels over their mean, at most: the lower is a tenth of the higher."""


class AsymmetricCoulomb(DryFriction):
    name, equation, refines = "asymmetric_coulomb", "−F⁺ z (z > 0), −F⁻ z (z < 0)", True
    level = "coulomb_friction"
    units = {"positive": "N m", "negative": "N m"}
    prior = "half the difference: 0.03 of the joint's peak torque"
    mjcf = "joint frictionloss for the mean, stiffness and springref for half the difference"

    def columns(self, context, place, shape):
        return of_row(-np.abs(self.direction(context, place, shape)), place)

    def scale(self, context, place, shape):
        return np.array([0.03 * peak_of(context, place.index)])

    def numbers(self, context, place, shape, theta):
        *level, half = (float(x) for x in theta)
        return {
            "positive": Parameter(sum(level) + half, "N m"),
            "negative": Parameter(sum(level) - half, "N m"),
        }

    def possible_with(self, context, place, level, theta):
        # Friction that acts one way only would be a constant torque beside half of it.
        whole = level + float(context.frictionloss[place.index])
        return bool(abs(theta[0]) <= ONE_WAY * whole + 1e-9)

    def edit(self, spec, model, found):
        plus, minus = found.values["positive"], found.values["negative"]
        joint = joint_of(spec, found)
        add_friction(joint, 0.5 * (plus + minus))
        wind(spec, joint, 0.0, 0.0, -0.5 * (plus - minus))
        return Edit(whole=True)


class StribeckFriction(DryFriction):
    """Behind presliding and way: Stribeck's speed [rad/s] and exponent."""

    name, refines, rubs, level = "stribeck_friction", True, True, "coulomb_friction"
    equation = "−(Fc + (Fs − Fc) exp(−|q̇/vs|^δ)) z"
    source = "Stribeck 1902; δ = 2: Armstrong-Hélouvry 1991, δ = 1: Tustin 1947"
    units = {
        "coulomb": "N m",
        "stiction": "N m",
        "stribeck_velocity": "rad/s",
        "exponent": "1",
    }
    prior = "Fs − Fc: 0.08 of the joint's peak torque, not below zero; vs from 0.02 to 0.3 rad/s"
    mjcf = "joint frictionloss for Fc; the rest by step law"

    def shapes(self, context, place) -> list[Shape]:
        return [(*x, v, 2.0) for x in super().shapes(context, place) for v in STRIBECK_SPEEDS]

    def steps(self, context, place, shape):
        return (0.0, 0.0, 0.3 * shape[2], 0.0)

    def within(self, shape):
        return STRIBECK_SPEEDS[0] <= shape[2] <= STRIBECK_SPEEDS[-1]

    def columns(self, context, place, shape):
        z = self.direction(context, place, shape)
        slow = np.exp(-(np.abs(context.v[:, place.index] / shape[2]) ** shape[3]))
        return of_row(-z * slow, place)

    def scale(self, context, place, shape):
        return np.array([0.08 * peak_of(context, place.index)])

    def numbers(self, context, place, shape, theta):
        *level, more = (float(x) for x in theta)
        coulomb = float(sum(level))
        return {
            "coulomb": Parameter(coulomb, "N m"),
            "stiction": Parameter(coulomb + more, "N m", coulomb if level else -np.inf),
            "stribeck_velocity": Parameter(shape[2], "rad/s", 0.0),
            "exponent": Parameter(shape[3], "1"),
        }

    def lower(self, context, place):
        return 0.0

    def step(self, xp, now, at, applied):
        values = at.values
        slow = xp.exp(-(xp.abs(now.v / values["stribeck_velocity"]) ** values["exponent"]))
        more = at.rows * (values["stiction"] - values["coulomb"]) * slow
        return applied._replace(friction=applied.friction + more)


class LoadFriction(DryFriction):
    """Friction that grows with the load on the teeth.

    Behind presliding and way: whether the load is the motor's torque (1) or the link's (0), and by how much more it
    turns over with load [rad/(N m)]: teeth need not be stiffer where they are loaded. Where friction is a good part of
    the torque, the two are zero at other moments, so both are asked; what the motor gives needs the joint's own
    friction and rotor inertia, so columns are of the calibrated model.
    """

    name, refines, rubs, level = "load_friction", True, True, "coulomb_friction"
    equation = "−(F₀ + μ |τ|) z, τ of the link or of its motor"
    source = "Hamon, Gautier and Garrec, IROS 2010"
    units = {"coulomb": "N m", "load_coefficient": "1", "of_motor": "1"}
    prior = "μ: 0.1, not below zero"
    mjcf = "joint frictionloss for F₀; the rest by step law"
    calibrated = True

    def shapes(self, context, place) -> list[Shape]:
        turning = super().shapes(context, place)
        return [(*x, side, 0.0) for side in (1.0, 0.0) for x in turning]

    def load(self, context, place, shape) -> np.ndarray:
        """|τ| (T,)."""
        torque = context.inverse if shape[2] else context.link_torque
        return np.abs(torque[:, place.index])

    def direction(self, context, place, shape):
        if shape[3] == 0.0:
            return super().direction(context, place, shape)
        reach = np.maximum(shape[0] + shape[3] * self.load(context, place, shape), 1e-9)
        return context.bristle_of_any(place.index, reach, shape[1] == STRAIGHT)

    def columns(self, context, place, shape):
        z = self.direction(context, place, shape)
        return of_row(-z * self.load(context, place, shape), place)

    def scale(self, context, place, shape):
        return np.array([0.1])

    def numbers(self, context, place, shape, theta):
        *level, coefficient = (float(x) for x in theta)
        return {
            "coulomb": Parameter(float(sum(level)), "N m"),
            "load_coefficient": Parameter(coefficient, "1"),
            "of_motor": Parameter(shape[2], "1"),
        }

    def lower(self, context, place):
        return 0.0

    def step(self, xp, now, at, applied):
        mu, friction = at.values["load_coefficient"], applied.friction
        # What the link gets is the motor's less the friction itself.
        driven = 0.0 if at.values["of_motor"] else mu * xp.sign(now.u * now.v)
        loaded = (friction + mu * xp.abs(now.u)) / (1.0 + driven)
        return applied._replace(friction=xp.where(at.rows, loaded, friction))


FORM_TOLERANCE = 0.05
"""How far from level plus viscous a joint's friction is on ordinary robots, each form, relative to its rms: mild
Stribeck curves and loads of a few per cent are no finding (Armstrong-Hélouvry et al. 1994, sec. 2)."""


TURNING_TOLERANCE = 0.5
"""How much of a joint's friction may turn round over another displacement: bristle laws differ in no other way."""


def _beside(presliding: float) -> tuple[float, ...]:
    """Displacements below and above one [rad]."""
    base = presliding if presliding > 0 else 1e-4
    return base / 2.5, base * 2.5


class FrictionForms(Effect):
    """Mild forms of an ordinary joint's friction, marginalised: Stribeck at two speeds, load, |q̇| q̇, direction.

    Shape: presliding displacement [rad], and the rms of the joint's ordinary friction torque [N m].
    """

    name, equation, named, marginal = "friction_forms", "level (1 + a mild form)", False, True
    form_error = 0.0

    def shapes(self, context, place):
        return []

    def columns(self, context, place, shape):
        row = place.index
        z, v = direction(context, row, shape[0]), context.v[:, row]
        load = np.abs(context.inverse[:, row])
        forms = [
            *(z * np.exp(-((v / speed) ** 2)) for speed in (0.05, 0.2)),
            z * load,
            np.abs(v) * v,
            np.abs(z),
            np.abs(v),
            # How it turns round after a reversal.
            *(direction(context, row, x) - z for x in _beside(shape[0])),
        ]
        return of_row(-np.stack(forms, 1), place)

    def scale(self, context, place, shape):
        size = np.sqrt(np.mean(self.columns(context, place, shape).values ** 2, axis=0))
        out = FORM_TOLERANCE * shape[1] / np.maximum(size, 1e-12)
        out[6:] = TURNING_TOLERANCE * shape[1]
        return out

    def numbers(self, context, place, shape, theta):
        return {}


STATED_TOLERANCE = 0.1
"""How far a joint's friction is from the form that its model states, relative to that: what is larger at low speed, and
what bends away from the slope at high speed."""


class StatedFriction(Effect):
    """The form of a friction that the model states, marginalised: no model of two numbers states it.

    How it turns round, F (sign(q̇) − z), is θ = 1 where all of it is a bristle's (Dahl 1968); beside it bristles over
    other ways, Stribeck's at two speeds and a slope that changes with speed. Shape: presliding displacement [rad] and
    way, as of the joint's dry friction.
    """

    name, named, marginal, form_error = "stated_friction", False, True, 0.0
    equation = "F (sign(q̇) − z) + a mild form of F z + d q̇"

    def places(self, context):
        return [p for p in super().places(context) if context.frictionloss[p.index] > 0]

    def shapes(self, context, place):
        return turnings(context, place)

    def columns(self, context, place, shape):
        row = place.index
        z, v = direction(context, row, *shape), context.v[:, row]
        dry = [
            context.side[:, row] - z,
            *(z - direction(context, row, x) for x in _beside(shape[0])),
            *(z * np.exp(-((v / speed) ** 2)) for speed in (0.05, 0.2)),
        ]
        top = max(float(np.percentile(np.abs(v), 99)), 1e-9)
        bent = float(context.damping[row]) * np.abs(v) * v / top
        return of_row(
            np.stack([*(float(context.frictionloss[row]) * x for x in dry), bent], 1), place
        )

    def scale(self, context, place, shape):
        turning, form = TURNING_TOLERANCE, STATED_TOLERANCE
        return np.array([1.0, turning, turning, form, form, form])

    def numbers(self, context, place, shape, theta):
        return {}
