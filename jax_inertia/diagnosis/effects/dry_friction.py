"""Dry friction at a joint: its level, and how that depends on direction, speed and load.

All act through one direction state z in [−1, 1], which turns over a presliding displacement after a reversal (Dahl
1968), the first nonlinear number [rad]; below zero it is the level [N m] at which MuJoCo's friction loss creeps. The
second is the way it turns. Extra forms are columns next to the constant level, so that levels add; a search that fits
both at once has the level before them.
"""

import itertools
from typing import Any

import numpy as np

from jax_inertia.diagnosis.effects import advice
from jax_inertia.diagnosis.effects.base import (
    Edit,
    Effect,
    Parameter,
    Shape,
    Term,
    of_row,
    peak_of,
)
from jax_inertia.diagnosis.effects.joint import ARMSTRONG
from jax_inertia.diagnosis.effects.spec_joint import add_friction, joint_of, wind

PRESLIDING = (0.0, 5e-5, 1e-4, 2e-4, 4e-4, 8e-4, 1.6e-3, 3e-3, 6e-3)
"""Displacements searched [rad]: 1e-4 to 3e-3 in geared joints (Armstrong-Hélouvry et al. 1994)."""
STRIBECK_SPEEDS = (0.02, 0.035, 0.06, 0.1, 0.17, 0.3)
"""Speeds searched [rad/s]."""
BENT, STRAIGHT = 0.0, 1.0
"""How friction turns over a displacement: as Dahl's bristles bend, or as a straight spring slips."""


def direction(context, row: int, presliding: float, way: float = BENT) -> Any:
    """z(t) of a joint (T,)."""
    if presliding < 0:
        return context.creeping(row, -presliding)
    if not presliding:
        return context.side[:, row]
    return context.bristle(row, presliding, straight=way == STRAIGHT)


def bristle_of(presliding: float, way: float = BENT) -> Term:
    """The term of a friction law whose direction is `direction`'s; of a creeping one the level stands for it."""
    return Term("bristle", float(presliding), float(way))


def sizes(context, place, every: tuple[float, ...]) -> list[float]:
    """Of a joint's friction [rad, rad/s], of a slide's [m, m/s]: of its drive, and of ways and seals as they are."""
    units = float(context.radian[place.index]), 1.0
    return sorted({unit * x for unit in units for x in every})


def ways(context, place) -> list[float]:
    """Presliding displacements that are searched at a joint [rad, of a slide m]."""
    return sizes(context, place, PRESLIDING)


def turnings(context, place) -> list[Shape]:
    """How a joint's dry friction may turn round: presliding and way; the levels that MuJoCo's creeps at."""
    peak = peak_of(context, place.index)
    return [(x, BENT) for x in (*ways(context, place), *(-peak * s for s in (0.3, 0.1, 0.03)))]


class DryFriction(Effect):
    """A form of a joint's dry friction; its nonlinear numbers begin with presliding displacement [rad] and way."""

    form_error, source, advice = 0.03, ARMSTRONG, advice.SLOW_REVERSALS

    def shapes(self, context, place) -> list[Shape]:
        return turnings(context, place)

    def steps(self, context, place, shape):
        # Where its own; a form of a friction that is there turns round as that does.
        return (0.3 * abs(float(shape[0])), *[0.0] * (len(shape) - 1))

    def direction(self, context, place, shape) -> Any:
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

    def friction_terms(self, context, place, shape):
        return ({bristle_of(*shape[:2]): 1.0},)

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
    level, level_in = "coulomb_friction", ("positive", "negative")
    holds = "torque_bias"
    units = {"positive": "N m", "negative": "N m"}
    prior = "half the difference: 0.03 of the joint's peak torque"
    mjcf = "joint frictionloss for the mean, stiffness and springref for half the difference"

    def columns(self, context, place, shape):
        return of_row(-np.abs(self.direction(context, place, shape)), place)

    def friction_terms(self, context, place, shape):
        return ({Term("by_direction"): 1.0},)

    def scale(self, context, place, shape):
        return np.array([0.03 * peak_of(context, place.index)])

    def numbers(self, context, place, shape, theta):
        *level, half = (float(x) for x in theta)
        return {
            "positive": Parameter(sum(level) + half, "N m"),
            "negative": Parameter(sum(level) - half, "N m"),
        }

    def possible_with(self, context, place, level, theta):
        # Friction that acts one way only would be a constant torque with half of it.
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

    name, refines, rubs = "stribeck_friction", True, True
    level, level_in = "coulomb_friction", ("coulomb", "stiction")
    equation = "−(Fc + (Fs − Fc) exp(−|q̇/vs|^δ)) z"
    source = "Stribeck 1902; δ = 2: Armstrong-Hélouvry 1991, δ = 1: Tustin 1947"
    units = {
        "coulomb": "N m",
        "stiction": "N m",
        "stribeck_velocity": "rad/s",
        "exponent": "1",
    }
    prior = "Fs − Fc: 0.08 of the joint's peak torque, not below zero; vs from 0.02 to 0.3 rad/s, 0.002 to 0.3 m/s"
    mjcf = "joint frictionloss for Fc; the rest by step law"

    def shapes(self, context, place) -> list[Shape]:
        speeds = sizes(context, place, STRIBECK_SPEEDS)
        return [(*x, v, 2.0) for x in super().shapes(context, place) for v in speeds]

    def steps(self, context, place, shape):
        return (*super().steps(context, place, shape[:2]), 0.3 * shape[2], 0.0)

    def within(self, context, place, shape):
        slowest, *_, fastest = sizes(context, place, STRIBECK_SPEEDS)
        return bool(slowest <= shape[2] <= fastest)

    def columns(self, context, place, shape):
        z = self.direction(context, place, shape)
        slow = np.exp(-(np.abs(context.v[:, place.index] / shape[2]) ** shape[3]))
        return of_row(-z * slow, place)

    def friction_terms(self, context, place, shape):
        return ({Term("slow", float(shape[2]), float(shape[3])): 1.0},)

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


GROWS_FROM = 4e-4
"""Unloaded displacement [rad] up to which it is asked whether load makes it longer: what grows does so from little."""
FURTHER = (4e-4, 2e-3, 8e-3)
"""How much further friction at a joint's peak torque turns over than unloaded [rad]."""


MOST_LOAD = 0.6
"""Largest friction under load, of the load: a worm gear that holds itself."""


def _raised(mu: float, side: np.ndarray) -> np.ndarray:
    """1 / (1 − μ z sign τ) (T,): by how much friction under load raises its motor's torque."""
    return 1.0 / (1.0 - np.clip(mu, 0.0, MOST_LOAD) * side)


class LoadFriction(DryFriction):
    """Friction that grows with the load on the teeth.

    Behind presliding and way: whether the load is the motor's torque (1) or the link's (0), which has neither
    friction nor the rotor's part in it; by how much more it turns over with load [rad/(N m)], since teeth need not be
    stiffer where they are loaded; μ, θ's own. Where friction is a good part of the torque, the two are zero at other
    moments, so both are asked. The motor's has this friction in it:

        τ = (τ₀ + F₀ z) / (1 − μ z sign τ)

    τ₀ is what it needs else, of the calibrated model, so columns need the joint's own friction and rotor inertia; the
    logged torque tells the sign alone, since it would explain itself.
    """

    name, refines, rubs = "load_friction", True, True
    level, level_in = "coulomb_friction", ("coulomb",)
    equation = "−(F₀ + μ |τ|) z, τ of the link or of its motor"
    source = "Hamon, Gautier and Garrec, IROS 2010"
    units = {"coulomb": "N m", "load_coefficient": "1", "of_motor": "1"}
    prior = "μ: 0.1, not below zero, not above 0.6"
    mjcf = "joint frictionloss for F₀; the rest by step law"
    calibrated = True

    def shapes(self, context, place) -> list[Shape]:
        turning, peak = super().shapes(context, place), peak_of(context, place.index)
        bending = [x for x in turning if 0.0 <= x[0] <= GROWS_FROM]
        further = itertools.product(bending, (f / peak for f in FURTHER))
        ways = [*((x, 0.0) for x in turning), *further]
        return [(*x, side, f, 0.0) for side in (1.0, 0.0) for x, f in ways]

    def steps(self, context, place, shape):
        further = max(0.5 * shape[3], 0.5 * FURTHER[0] / peak_of(context, place.index))
        return (*super().steps(context, place, shape[:3]), further, 0.0)

    def within(self, context, place, shape):
        return shape[3] >= 0.0

    def at_value(self, shape, theta):
        return (*shape[:4], float(theta[-1]))

    def load(self, context, place, shape) -> np.ndarray:
        """|τ| (T,), of the motor without this friction."""
        torque = context.inverse if shape[2] else context.link_torque
        return np.abs(torque[:, place.index])

    def direction(self, context, place, shape):
        if shape[3] == 0.0:
            return super().direction(context, place, shape)
        reach = np.maximum(shape[0] + shape[3] * self.load(context, place, shape), 1e-9)
        return context.bristle_of_any(place.index, reach, shape[1] == STRAIGHT)

    def columns(self, context, place, shape):
        z = self.direction(context, place, shape)
        if not shape[2]:
            return of_row(-z * self.load(context, place, shape), place)
        side, needed = (np.sign(context.tau[:, place.index]), context.inverse[:, place.index])
        return of_row(-z * side * needed * _raised(shape[4], z * side), place)

    def of_level(self, level, context, place, shape):
        # The same bristles carry both, and the level loads the motor too.
        z = self.direction(context, place, shape)
        side = np.sign(context.tau[:, place.index])
        return of_row(-z * (_raised(shape[4], z * side) if shape[2] else 1.0), place)

    def possible(self, context, place, theta):
        return bool(-1e-12 <= theta[0] <= MOST_LOAD)

    def friction_terms(self, context, place, shape):
        return ({Term("load", 0.0, float(shape[2])): 1.0},)

    def scale(self, context, place, shape):
        return np.array([0.1])

    def numbers(self, context, place, shape, theta):
        *level, coefficient = (float(x) for x in theta)
        return {
            "coulomb": Parameter(float(sum(level)), "N m"),
            "load_coefficient": Parameter(coefficient, "1"),
            "of_motor": Parameter(shape[2], "1"),
        }

    def step(self, xp, now, at, applied):
        mu, friction = at.values["load_coefficient"], applied.friction
        # What the link gets is the motor's less the friction itself.
        driven = 0.0 if at.values["of_motor"] else mu * xp.sign(now.u * now.v)
        loaded = (friction + mu * xp.abs(now.u)) / (1.0 + driven)
        return applied._replace(friction=xp.where(at.rows, loaded, friction))
