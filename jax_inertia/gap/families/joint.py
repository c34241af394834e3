"""Effects at a joint's own axis: friction, springs, rotor inertia."""

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from jax_inertia.gap.context import Context
from jax_inertia.gap.families.base import Columns, Family, Parameter, Place

# Presliding displacements on the grid [rad]; zero is the sharp sign.
PRESLIDING = (0.0, 2e-4, 5e-4, 1.2e-3, 3e-3)
# Levels at which friction may creep as MuJoCo's does (`Context.creeping`), of the joint's peak torque.
CREEPING = (1.0, 0.3, 0.1, 0.03)
# Of its own, that level is so close.
ITS_OWN = 2.0

# What all friction laws that turn with the direction are laws of.
DRY = "dry friction"
# Of Stribeck's curve: Armstrong-Hélouvry's (1991) and Tustin's (1947). Both are in use, what lies between hardly.
EXPONENTS = (2.0, 1.0)


class Joint(Family):
    kind = "joint"


def turned_round(context: Context, row: int, over: float) -> np.ndarray:
    """z in [−1, 1] of friction that turns round over a displacement [rad]; below zero, creeping at a level [N m]."""
    if over < 0:
        return context.creeping(row, -over)
    return context.bristle(row, over) if over else context.side[:, row]


class DryFriction(Joint):
    """Friction whose direction turns over a presliding displacement [rad], the last of its nonlinear numbers.

    Below zero that number is a level [N m]: friction that creeps as MuJoCo's does where all of it is as large.
    """

    def grid(self, context: Context, place: Place) -> tuple[Sequence[float] | np.ndarray, ...]:
        return (PRESLIDING,)

    free_shape = 0
    form_error = 0.1
    law_of = DRY

    def direction(self, context: Context, place: Place, shape) -> np.ndarray:
        """z in [−1, 1] that multiplies the level (T,)."""
        return turned_round(context, place.index, float(shape[-1]))

    def level(self, theta: np.ndarray) -> float:
        """How large it is, about [N m]."""
        return float(theta[0])


class LevelFriction(DryFriction):
    """Dry friction of one level each way, which may creep as MuJoCo's does."""

    def grid(self, context, place):
        return ((*(-x * float(context.peak[place.index]) for x in CREEPING), *PRESLIDING),)

    def around(self, context, place, shape):
        [(low, high)] = super().around(context, place, shape)
        return [(low, min(high, 0.0)) if shape[-1] < 0 else (max(low, 0.0), high)]

    def creeps_alike(self, context: Context, place: Place, shape, theta: np.ndarray) -> bool:
        """Whether the level that it creeps by is that of the friction found; beside the model's own it does not."""
        if shape[-1] >= 0:
            return True
        alone, level = context.frictionloss[place.index] == 0.0, self.level(theta)
        return bool(alone and level / ITS_OWN < -shape[-1] < level * ITS_OWN)


class ViscousFriction(Joint):
    name, equation = "viscous_friction", "−d q̇"
    form_error = 0.03

    def columns(self, context, place, shape):
        return Columns(-context.v[:, place.index, None], place.index)

    def physical(self, context, place, shape, theta):
        return theta[0] + context.damping[place.index] >= -1e-9

    def parameters(self, context, place, shape, theta):
        return {"damping": Parameter(theta[0], "N m s/rad")}


class CoulombFriction(LevelFriction):
    name, equation = "coulomb_friction", "−F sign(q̇)"

    def columns(self, context, place, shape):
        return Columns(-self.direction(context, place, shape)[:, None], place.index)

    def physical(self, context, place, shape, theta):
        own = context.frictionloss[place.index]
        return theta[0] + own >= -1e-9 and self.creeps_alike(context, place, shape, theta)

    def parameters(self, context, place, shape, theta):
        return {"coulomb": Parameter(theta[0], "N m")}


class AsymmetricCoulomb(LevelFriction):
    name, equation = "asymmetric_coulomb", "−F⁺ (q̇ > 0), +F⁻ (q̇ < 0)"
    simpler = ("coulomb_friction", "torque_bias")
    # From a friction a constant torque sets it apart, and from that a friction: errors of neither equation look so.
    set_apart = 10.0

    def columns(self, context, place, shape):
        s = self.direction(context, place, shape)
        return Columns(-np.stack([np.maximum(s, 0), np.minimum(s, 0)], 1), place.index)

    def physical(self, context, place, shape, theta):
        own = context.frictionloss[place.index]
        return min(theta) + own >= -1e-9 and self.creeps_alike(context, place, shape, theta)

    def level(self, theta):
        return float(np.mean(theta))

    def parameters(self, context, place, shape, theta):
        return {
            "positive": Parameter(theta[0], "N m"),
            "negative": Parameter(theta[1], "N m"),
        }


class OfTwoLaws(DryFriction):
    """Dry friction by either of two laws: searched by the first, and by the other too where that leads."""

    law: ClassVar[int]
    """Which of the nonlinear numbers tells them apart."""

    def first(self, context, place):
        usual = self.grid(context, place)[self.law][0]
        return [shape for shape in self.shapes(context, place) if shape[self.law] == usual]

    def around(self, context, place, shape):
        bounds = super().around(context, place, shape)
        bounds[self.law] = (shape[self.law], shape[self.law])
        return bounds


class StribeckFriction(OfTwoLaws):
    name, equation = "stribeck_friction", "−(Fc + (Fs − Fc) exp(−|q̇/vs|^δ)) sign(q̇)"
    simpler = ("coulomb_friction",)
    # 99 % of χ² of its three numbers: what one level leaves behind resembles it in nothing but noise.
    set_apart = 12.0

    free_shape, law = 1, 1

    def grid(self, context, place):
        return ((0.02, 0.035, 0.06, 0.1, 0.17, 0.3), EXPONENTS, (0.0, 2e-4, 5e-4, 2e-3))

    def columns(self, context, place, shape):
        s = self.direction(context, place, shape)
        slow = np.exp(-(np.abs(context.v[:, place.index] / shape[0]) ** shape[1]))
        return Columns(-np.stack([s, s * slow], 1), place.index)

    def physical(self, context, place, shape, theta):
        return theta[0] > 0 and 0 < theta[1] < 4 * theta[0]

    def parameters(self, context, place, shape, theta):
        return {
            "coulomb": Parameter(theta[0], "N m"),
            "stiction": Parameter(theta[0] + theta[1], "N m"),
            "stribeck_velocity": Parameter(shape[0], "rad/s"),
            "exponent": Parameter(shape[1], "1"),
        }


# Whose torque loads the teeth: what the link needs, or what its motor gives, that is friction too.
LOADS = (0.0, 1.0)


class LoadFriction(OfTwoLaws):
    name, equation = "load_friction", "−(F₀ + μ|τ|) sign(q̇), τ of the link or of its motor"
    simpler, law = ("coulomb_friction",), 0

    def grid(self, context, place):
        return (LOADS, *super().grid(context, place))

    def columns(self, context, place, shape):
        s = self.direction(context, place, shape)
        torque = context.tau if shape[0] else context.inverse
        return Columns(-np.stack([s, s * np.abs(torque[:, place.index])], 1), place.index)

    def physical(self, context, place, shape, theta):
        own = context.frictionloss[place.index]
        return theta[0] + own > -0.02 * context.peak[place.index] and 0.005 < theta[1] < 0.6

    def parameters(self, context, place, shape, theta):
        return {
            "coulomb": Parameter(theta[0], "N m"),
            "load_coefficient": Parameter(theta[1], "1"),
            "of_motor": Parameter(shape[0], "1"),
        }


class FrictionDrift(Joint):
    name, equation = "friction_drift", "−(d∞ + d₁ e^{−t/T}) q̇"
    simpler = ("viscous_friction",)
    form_error = 0.05

    def grid(self, context, place):
        longest = context.time[-1]
        return ([T for T in (1.0, 2.0, 3.0, 5.0, 8.0, 12.0, 18.0) if 2 * longest > T],)

    def columns(self, context, place, shape):
        v = context.v[:, place.index]
        return Columns(-np.stack([v, v * np.exp(-context.time / shape[0])], 1), place.index)

    def physical(self, context, place, shape, theta):
        own = context.damping[place.index]
        return theta[1] > 0 and theta[0] + own > -0.3 * theta[1]

    def parameters(self, context, place, shape, theta):
        return {
            "damping": Parameter(theta[0] + theta[1], "N m s/rad"),
            "damping_final": Parameter(theta[0], "N m s/rad"),
            "time_constant": Parameter(shape[0], "s"),
        }


class Armature(Joint):
    name, equation = "armature", "−I_a q̈"
    slow = True

    def columns(self, context, place, shape):
        return Columns(-context.acceleration[:, place.index, None], place.index)

    def physical(self, context, place, shape, theta):
        own = context.armature[place.index]
        # Exactly minus the model's own would be a motor that is not connected.
        return theta[0] > -0.95 * own - 1e-9

    def parameters(self, context, place, shape, theta):
        return {"armature": Parameter(theta[0], "kg m²")}


class JointSpring(Joint):
    name, equation = "joint_spring", "−k (q − q₀)"
    simpler = ("torque_bias",)

    def columns(self, context, place, shape):
        q = context.joint_position[:, place.index]
        return Columns(np.stack([-q, np.ones_like(q)], 1), place.index)

    def physical(self, context, place, shape, theta):
        return theta[0] + context.stiffness[place.index] > 0

    def parameters(self, context, place, shape, theta):
        return {
            "stiffness": Parameter(theta[0], "N m/rad"),
            "rest_angle": Parameter(theta[1] / theta[0] if theta[0] else 0.0, "rad"),
        }


class Cogging(Joint):
    name, equation = "cogging", "A sin(N q + φ)"
    simpler = ("joint_spring",)
    form_error = 0.1

    def grid(self, context, place):
        q = context.joint_position[:, place.index]
        span = max(np.ptp(q), 1e-3)
        fastest = 0.7 * context.prepared.settings.after * 2 * np.pi
        speed = max(np.percentile(np.abs(context.v[:, place.index]), 50), 1e-3)
        highest = min(120.0, fastest / speed)
        # One or more periods over the motion (half of one is a spring), a quarter of a period apart.
        return (np.arange(max(4.0, 2 * np.pi / span), highest, max(0.5, 1.5 / span)),)

    def columns(self, context, place, shape):
        q = context.joint_position[:, place.index]
        return Columns(np.stack([np.sin(shape[0] * q), np.cos(shape[0] * q)], 1), place.index)

    def physical(self, context, place, shape, theta):
        return np.hypot(*theta) < 0.3 * context.peak[place.index]

    def parameters(self, context, place, shape, theta):
        return {
            "amplitude": Parameter(float(np.hypot(*theta)), "N m"),
            "frequency": Parameter(shape[0], "1/rad"),
            "phase": Parameter(float(np.arctan2(theta[1], theta[0])), "rad"),
        }
