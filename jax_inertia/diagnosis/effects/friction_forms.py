"""What a joint's dry friction may be off by, marginalised: mild forms of it, how it turns round at a reversal."""

import itertools

import numpy as np

from jax_inertia.diagnosis.effects.base import Effect, Term, of_row
from jax_inertia.diagnosis.effects.dry_friction import (
    BENT,
    STRAIGHT,
    bristle_of,
    direction,
    ways,
)

FORM_TOLERANCE = 0.05
"""How far from level plus viscous a joint's friction is on ordinary robots, each form, relative to its rms: mild
Stribeck curves and loads of a few per cent are no finding (Armstrong-Hélouvry et al. 1994, sec. 2)."""
MILD_STICTION = 0.2
"""How far stiction is above Coulomb friction on such robots, relative to that: what is there at creep alone is next to
nothing of a motion's rms, however large."""


MILD_LOAD = 0.03
"""How much of the load on a gear is friction on such robots: next to no load says nothing of it, however it fits."""
MILD_SPEEDS = 0.05, 0.2
"""Speeds below which mild stiction is there [rad/s]."""
STATED_SPEEDS = 0.02, 0.05, 0.2
"""The same of a friction that a calibrated model states: what is slower than is seen is a way to turn round, too."""
TURNING_TOLERANCE = 0.5
"""How much of a joint's friction may turn round over another displacement: bristle laws differ in no other way."""


def _other_ways(presliding: float) -> tuple[float, ...]:
    """Displacements below and above one [rad]."""
    base = presliding if presliding > 0 else 1e-4
    return base / 2.5, base * 2.5


def _slow(context, row: int, z: np.ndarray, speeds: tuple[float, ...]) -> list[np.ndarray]:
    """Friction that is there at low speed alone, below each of some speeds [rad/s]."""
    v = context.v[:, row] / context.radian[row]
    return [z * np.exp(-((v / speed) ** 2)) for speed in speeds]


class FrictionTurning(Effect):
    """How a joint's friction turns round after a reversal, marginalised: bristles over other ways.

    Shape: presliding displacement [rad] and way of the friction, and the rms of its torque [N m].
    """

    name, equation, named, marginal = (
        "friction_turning",
        "level (z of another displacement − z)",
        False,
        True,
    )
    form_error = 0.0

    def shapes(self, context, place):
        return []

    def columns(self, context, place, shape):
        z = direction(context, place.index, *shape[:2])
        others = [direction(context, place.index, x) - z for x in _other_ways(shape[0])]
        return of_row(-np.stack(others, 1), place)

    def friction_terms(self, context, place, shape):
        own = bristle_of(*shape[:2])
        return tuple({bristle_of(x): 1.0, own: -1.0} for x in _other_ways(shape[0]))

    def scale(self, context, place, shape):
        return np.full(2, TURNING_TOLERANCE * shape[2])

    def numbers(self, context, place, shape, theta):
        return {}


class FrictionForms(Effect):
    """Mild forms of an ordinary joint's friction, marginalised: Stribeck at two speeds, load, |q̇| q̇, direction.

    Shape: presliding displacement [rad], the rms of the joint's ordinary friction torque and its Coulomb friction
    [N m].
    """

    name, equation, named, marginal = "friction_forms", "level (1 + a mild form)", False, True
    form_error, by_load = 0.0, True

    def shapes(self, context, place):
        return []

    def columns(self, context, place, shape):
        row = place.index
        z, v = direction(context, row, shape[0]), context.v[:, row]
        load = np.abs(context.link_torque[:, row])
        forms = [
            *_slow(context, row, z, MILD_SPEEDS),
            z * load,
            np.abs(v) * v,
            np.abs(z),
            np.abs(v),
            # How it turns round after a reversal.
            *(direction(context, row, x) - z for x in _other_ways(shape[0])),
        ]
        return of_row(-np.stack(forms, 1), place)

    def friction_terms(self, context, place, shape):
        radian, own = float(context.radian[place.index]), bristle_of(shape[0])
        return (
            *({Term("slow", radian * speed, 2.0): 1.0} for speed in MILD_SPEEDS),
            {Term("load"): 1.0},
            {Term("quadratic"): 1.0},
            {Term("by_direction"): 1.0},
            {Term("slope_by_direction"): 2.0},
            *({bristle_of(x): 1.0, own: -1.0} for x in _other_ways(shape[0])),
        )

    def scale(self, context, place, shape):
        size = np.sqrt(np.mean(self.columns(context, place, shape).values ** 2, axis=0))
        out = FORM_TOLERANCE * shape[1] / np.maximum(size, 1e-12)
        if shape[2] > 0:
            out[:2] = np.minimum(out[:2], MILD_STICTION * shape[2])
        out[2] = min(out[2], MILD_LOAD)
        out[6:] = TURNING_TOLERANCE * shape[1]
        return out

    def numbers(self, context, place, shape, theta):
        return {}


STATED_TOLERANCE = 0.1
"""How far a joint's friction is from the form that its model states, relative to that: what is larger at low speed, and
what bends away from the slope at high speed."""


class StatedFriction(Effect):
    """The form of a friction that the model states, marginalised: no model of two numbers states it.

    How it turns round, F (sign(q̇) − z), is θ = 1 where all is a bristle's (Dahl 1968), or a straight spring's that
    slips (Prandtl 1928); with it bristles over other ways, Stribeck's at three speeds and a slope that changes with
    speed. Shape: presliding displacement [rad] and way, as of the joint's dry friction.
    """

    name, named, marginal, form_error = "stated_friction", False, True, 0.25
    equation = "F (sign(q̇) − z) + a mild form of F z + d q̇"

    def places(self, context):
        return [p for p in super().places(context) if context.frictionloss[p.index] > 0]

    def shapes(self, context, place):
        # Its level is known, and so is how fast a soft constraint lets it creep.
        own = -float(context.frictionloss[place.index])
        own_way = (own, BENT)
        return [*itertools.product(ways(context, place), (BENT, STRAIGHT)), own_way]

    def columns(self, context, place, shape):
        row = place.index
        z, v = direction(context, row, *shape), context.v[:, row]
        dry = [
            context.side[:, row] - z,
            *(z - direction(context, row, x) for x in _other_ways(shape[0])),
            *_slow(context, row, z, STATED_SPEEDS),
        ]
        bent = float(context.damping[row]) * np.abs(v) * v / self._top(context, row)
        return of_row(
            np.stack([*(float(context.frictionloss[row]) * x for x in dry), bent], 1), place
        )

    @staticmethod
    def _top(context, row: int) -> float:
        """Usual top speed of a row [rad/s]."""
        return max(float(np.percentile(np.abs(context.v[:, row]), 99)), 1e-9)

    def friction_terms(self, context, place, shape):
        row, own = place.index, bristle_of(*shape)
        level, damping = float(context.frictionloss[row]), float(context.damping[row])
        radian = float(context.radian[row])
        return (
            {bristle_of(0.0): -level, own: level},
            *({own: -level, bristle_of(x): level} for x in _other_ways(shape[0])),
            *({Term("slow", radian * speed, 2.0): -level} for speed in STATED_SPEEDS),
            {Term("quadratic"): -damping / self._top(context, row)},
        )

    def scale(self, context, place, shape):
        turning, form = TURNING_TOLERANCE, STATED_TOLERANCE
        # What happens slower than a joint is seen to move is a way to turn round, too.
        return np.array([1.0, turning, turning, turning, form, form, form])

    def numbers(self, context, place, shape, theta):
        return {}
