"""Effects at a joint's own axis: viscous friction and its forms, springs, rotor inertia, teeth of the motor."""

import numpy as np

from jax_inertia.diagnosis.effects.base import Effect, of_row, peak_of
from jax_inertia.gap.families.base import Parameter


class _AlongTheJoint(Effect):
    """A column of the joint's motion; θ scales with the joint's peak torque by `share`."""

    share = 0.1
    unit = "N m"
    number = ""

    def scale(self, context, place, shape):
        return np.array([self.share * peak_of(context, place.index)])

    def numbers(self, context, place, shape, theta):
        return {self.number: Parameter(float(theta[0]), self.unit)}


class ViscousFriction(_AlongTheJoint):
    name, equation, ordinary, form_error = "viscous_friction", "−d q̇", True, 0.02
    number, unit, share = "damping", "N m s/rad", 0.15

    def columns(self, context, place, shape):
        return of_row(-context.v[:, place.index], place)

    def lower(self, context, place):
        return -float(context.damping[place.index])


class Armature(_AlongTheJoint):
    name, equation, ordinary = "armature", "−I q̈", True
    number, unit = "armature", "kg m²"

    def columns(self, context, place, shape):
        return of_row(-context.acceleration[:, place.index], place)

    def scale(self, context, place, shape):
        top = np.percentile(np.abs(context.acceleration[:, place.index]), 99.5)
        return np.array([0.3 * peak_of(context, place.index) / max(float(top), 1e-6)])

    def lower(self, context, place):
        return -float(context.armature[place.index])


class TorqueBias(_AlongTheJoint):
    name, equation, ordinary = "torque_bias", "+ b", True
    number, unit, share = "bias", "N m", 0.05

    def columns(self, context, place, shape):
        return of_row(np.ones(len(context.time)), place)


class AsymmetricViscous(_AlongTheJoint):
    name, equation, refines = "asymmetric_viscous", "−½ (d⁺ − d⁻) |q̇|", True
    number, unit, share, form_error = "difference", "N m s/rad", 0.05, 0.05

    def columns(self, context, place, shape):
        return of_row(-np.abs(context.v[:, place.index]), place)


class QuadraticViscous(_AlongTheJoint):
    name, equation, refines = "quadratic_viscous", "−c |q̇| q̇", True
    number, unit, share, form_error = "coefficient", "N m s²/rad²", 0.05, 0.05

    def columns(self, context, place, shape):
        v = context.v[:, place.index]
        return of_row(-np.abs(v) * v, place)


class FrictionDrift(_AlongTheJoint):
    name, equation, refines = "friction_drift", "−d₁ exp(−t/T) q̇", True
    number, unit, share, form_error = "damping", "N m s/rad", 0.1, 0.05

    def shapes(self, context, place):
        return [(T,) for T in (1.0, 2.0, 3.0, 5.0, 8.0, 12.0) if 2 * context.time[-1] > T]

    def steps(self, context, place, shape):
        return (0.3 * shape[0],)

    def columns(self, context, place, shape):
        return of_row(-context.v[:, place.index] * np.exp(-context.time / shape[0]), place)

    def numbers(self, context, place, shape, theta):
        return {
            "damping": Parameter(float(theta[0]), "N m s/rad"),
            "damping_final": Parameter(0.0, "N m s/rad"),
            "time_constant": Parameter(shape[0], "s", 0.0),
        }


class JointSpring(_AlongTheJoint):
    name, equation = "joint_spring", "−k (q − q₀)"
    number, unit = "stiffness", "N m/rad"

    def columns(self, context, place, shape):
        q = context.joint_position[:, place.index]
        # Its constant part is an offset of the torque, which every joint has.
        return of_row(-q, place)

    def numbers(self, context, place, shape, theta):
        return {
            "stiffness": Parameter(float(theta[0]), "N m/rad"),
            "rest_angle": Parameter(0.0, "rad"),
        }

    def lower(self, context, place):
        return -float(context.stiffness[place.index])


class Cogging(_AlongTheJoint):
    name, equation, form_error = "cogging", "A sin(N q + φ)", 0.1

    def shapes(self, context, place):
        q, v = context.joint_position[:, place.index], context.v[:, place.index]
        span = max(float(np.ptp(q)), 1e-3)
        # Faster than the analysis band lets through at half the moments, teeth are not seen.
        fastest = 0.7 * context.prepared.bands.cutoff * 2 * np.pi
        highest = min(60.0, fastest / max(float(np.percentile(np.abs(v), 50)), 1e-3))
        lowest = max(4.0, 2 * np.pi / span)
        step = max(0.5, 1.5 / span)
        return [(float(n),) for n in np.arange(lowest, max(highest, lowest), step)]

    def steps(self, context, place, shape):
        return (0.2,)

    def columns(self, context, place, shape):
        q = context.joint_position[:, place.index]
        return of_row(np.stack([np.sin(shape[0] * q), np.cos(shape[0] * q)], 1), place)

    def scale(self, context, place, shape):
        return np.full(2, 0.05 * peak_of(context, place.index))

    def numbers(self, context, place, shape, theta):
        return {
            "amplitude": Parameter(float(np.hypot(*theta)), "N m", 0.0),
            "frequency": Parameter(shape[0], "1/rad", 0.0),
            "phase": Parameter(float(np.arctan2(theta[1], theta[0])), "rad"),
        }

    def possible(self, context, place, theta):
        return bool(np.hypot(*theta) < 0.3 * peak_of(context, place.index))
