"""Plans for dry friction: what turns with the direction of motion, by one law or another."""

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from jax_inertia.diagnosis.effects import dry_friction
from jax_inertia.diagnosis.effects.base import Columns, Parameter, Place, Shape, of_row
from jax_inertia.diagnosis.effects.dry_friction import BENT, STRAIGHT
from jax_inertia.diagnosis.features.context import Context
from jax_inertia.gap.families.base import Family

# Presliding displacements on the grid [rad]; zero is the sharp sign.
PRESLIDING = (0.0, 2e-4, 5e-4, 1.2e-3, 3e-3)
# Levels at which friction may creep as MuJoCo's does (`Context.creeping`), of the joint's peak torque.
CREEPING = (1.0, 0.3, 0.1, 0.03)
# Of its own, that level is so close.
ITS_OWN = 2.0

# Of friction's levels the lower is at least this share of the higher.
ONE_WAY = 0.1
# What all friction laws that turn with the direction are laws of.
DRY = "dry friction"
# Of Stribeck's curve: Armstrong-Hélouvry's (1991) and Tustin's (1947). Both are in use, what lies between hardly.
EXPONENTS = (2.0, 1.0)


class DryFriction(Family[dry_friction.DryFriction]):
    """Friction whose direction turns over a presliding displacement [rad], the last of its nonlinear numbers.

    Below zero that number is a level [N m]: friction that creeps as MuJoCo's does where all of it is as large. The last
    but one is the way it turns. That and what else is one of a few (`of_few`) is searched at the first, and at the
    others too where that leads.
    """

    law_of = DRY
    free_shape, form_error = 0, 0.1
    of_few: ClassVar[tuple[int, ...]] = (-2,)
    """Which of the nonlinear numbers."""

    def grid(self, context: Context, place: Place) -> tuple[Sequence[float] | np.ndarray, ...]:
        return ((BENT, STRAIGHT), PRESLIDING)

    def shapes(self, context, place):
        # Neither what turns at once nor what creeps turns in a way of its own.
        return [s for s in super().shapes(context, place) if s[-2] == BENT or s[-1] > 0]

    def count(self, context, place):
        return sum(shape[-2] == BENT for shape in self.shapes(context, place))

    def first(self, context, place):
        grid = self.grid(context, place)
        return [
            shape
            for shape in self.shapes(context, place)
            if all(shape[k] == grid[k][0] for k in self.of_few)
        ]

    def around(self, context, place, shape):
        bounds = super().around(context, place, shape)
        for k in self.of_few:
            bounds[k] = (shape[k], shape[k])
        return bounds

    def as_another(self, context, place, shape):
        """Turning round as the other was refined to: between the displacements of its own grid the search of several
        numbers in turn may stop beside the optimum, and a law come out worse than one that it contains."""
        if shape[-1] < 0:
            return ()
        return dict.fromkeys((*own[:-2], *shape[-2:]) for own in self.shapes(context, place))

    def of_effect(self, shape: Shape) -> Shape:
        """The nonlinear numbers in the effect's own order."""
        return (*shape[:-3:-1], *shape[:-2])

    def direction(self, context: Context, place: Place, shape) -> np.ndarray:
        """z in [−1, 1] that multiplies the level (T,)."""
        return self.effect.direction(context, place, self.of_effect(shape))

    def columns(self, context, place, shape):
        # The level, and what the form adds to it.
        z = self.direction(context, place, shape)[:, None]
        more = self.effect.columns(context, place, self.of_effect(shape))
        return Columns(np.concatenate([-z, more.values], axis=1), place.index)

    def parameters(self, context, place, shape, theta):
        return self.effect.numbers(context, place, self.of_effect(shape), theta)

    def turning_over(self, shape: Shape, reach: float) -> Shape:
        """The same friction where it turns round over another displacement."""
        return (*shape[:-2], BENT, reach)

    def level(self, theta: np.ndarray) -> float:
        """How large it is, about [N m]."""
        return float(theta[0])


class LevelFriction(DryFriction):
    """Dry friction of one level each way, which may creep as MuJoCo's does."""

    def grid(self, context, place):
        way, reach = super().grid(context, place)
        return (way, (*(-x * float(context.peak[place.index]) for x in CREEPING), *reach))

    def around(self, context, place, shape):
        way, (low, high) = super().around(context, place, shape)
        return [way, (low, min(high, 0.0)) if shape[-1] < 0 else (max(low, 0.0), high)]

    def creeps_alike(self, context: Context, place: Place, shape, theta: np.ndarray) -> bool:
        """Whether the level that it creeps by is that of the friction found; beside the model's own it does not."""
        if shape[-1] >= 0:
            return True
        alone, level = context.frictionloss[place.index] == 0.0, self.level(theta)
        return bool(alone and level / ITS_OWN < -shape[-1] < level * ITS_OWN)


class CoulombFriction(LevelFriction):
    effect = dry_friction.CoulombFriction()

    def columns(self, context, place, shape):
        return self.effect.columns(context, place, self.of_effect(shape))

    def physical(self, context, place, shape, theta):
        own = context.frictionloss[place.index]
        return theta[0] + own >= -1e-9 and self.creeps_alike(context, place, shape, theta)


class AsymmetricCoulomb(LevelFriction):
    effect = dry_friction.AsymmetricCoulomb()
    simpler = ("coulomb_friction", "torque_bias")
    # From a friction a constant torque sets it apart, and from that a friction: errors of neither equation look so.
    set_apart = 10.0

    def columns(self, context, place, shape):
        s = self.direction(context, place, shape)
        return Columns(-np.stack([np.maximum(s, 0), np.minimum(s, 0)], 1), place.index)

    def physical(self, context, place, shape, theta):
        low, high = np.sort(theta + context.frictionloss[place.index])
        # Friction that acts one way only would be a constant torque beside half of it.
        return low >= ONE_WAY * high - 1e-9 and self.creeps_alike(context, place, shape, theta)

    def level(self, theta):
        return float(np.mean(theta))

    def parameters(self, context, place, shape, theta):
        # Both levels at once, where the effect has half their difference beside the level.
        return {
            "positive": Parameter(theta[0], "N m"),
            "negative": Parameter(theta[1], "N m"),
        }


class StribeckFriction(DryFriction):
    effect = dry_friction.StribeckFriction()
    simpler = ("coulomb_friction",)
    # 99 % of χ² of its three numbers: what one level leaves behind resembles it in nothing but noise.
    set_apart = 12.0

    free_shape, of_few = 1, (1, -2)

    def grid(self, context, place):
        way, _ = super().grid(context, place)
        return (dry_friction.STRIBECK_SPEEDS, EXPONENTS, way, (0.0, 2e-4, 5e-4, 2e-3))

    def physical(self, context, place, shape, theta):
        return theta[0] > 0 and 0 < theta[1] < 4 * theta[0]


# Whose torque loads the teeth: what the link needs, or what its motor gives, that is friction too.
LOADS = (0.0, 1.0)
# How much further friction at a joint's peak torque turns over than unloaded [rad].
FURTHER = (0.0, 4e-4, 2e-3, 8e-3, 3e-2)
# Ways and displacements of the unloaded that this is tried with.
GROWS_FROM = ((BENT, 0.0), (BENT, 5e-4))


class _ByTheLog(dry_friction.LoadFriction):
    """Its friction by torques as they are: friction and rotors of a calibrated model are in what it needs."""

    calibrated = False

    def load(self, context, place, shape):
        torque = context.tau if shape[2] else context.inverse
        return np.abs(torque[:, place.index])

    def columns(self, context, place, shape):
        z = self.direction(context, place, shape)
        return of_row(-z * self.load(context, place, shape), place)


class LoadFriction(DryFriction):
    effect = _ByTheLog()
    simpler, of_few = ("coulomb_friction",), (0, -2)

    def grid(self, context, place):
        peak = max(float(context.peak[place.index]), 1e-9)
        return (LOADS, [x / peak for x in FURTHER], *super().grid(context, place))

    def shapes(self, context, place):
        # What grows does so from little.
        return [s for s in super().shapes(context, place) if s[1] == 0.0 or s[2:] in GROWS_FROM]

    def count(self, context, place):
        return sum(s[1] == 0.0 and s[-2] == BENT for s in self.shapes(context, place))

    def first(self, context, place):
        return [shape for shape in super().first(context, place) if shape[1] == 0.0]

    def turning_over(self, shape, reach):
        return super().turning_over((shape[0], 0.0, *shape[2:]), reach)

    def physical(self, context, place, shape, theta):
        own = context.frictionloss[place.index]
        return theta[0] + own > -0.02 * context.peak[place.index] and 0.005 < theta[1] < 0.6
