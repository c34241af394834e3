"""Effects at a joint's own axis: viscous friction, springs, rotor inertia, teeth of the motor."""

import numpy as np

from jax_inertia.gap.families.base import Columns, Family, Parameter


class Joint(Family):
    kind = "joint"


class ViscousFriction(Joint):
    name, equation = "viscous_friction", "−d q̇"
    form_error = 0.03

    def columns(self, context, place, shape):
        return Columns(-context.v[:, place.index, None], place.index)

    def physical(self, context, place, shape, theta):
        return theta[0] + context.damping[place.index] >= -1e-9

    def parameters(self, context, place, shape, theta):
        return {"damping": Parameter(theta[0], "N m s/rad")}


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
            "time_constant": Parameter(shape[0], "s", 0.0),
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

    def sized(self, context, place, size):
        # About where the joint mostly is: a constant torque is no spring.
        return [size * np.array([1.0, np.mean(context.joint_position[:, place.index])])]

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
        fastest = 0.7 * context.prepared.bands.cutoff * 2 * np.pi
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
            "amplitude": Parameter(float(np.hypot(*theta)), "N m", 0.0),
            "frequency": Parameter(shape[0], "1/rad", 0.0),
            "phase": Parameter(float(np.arctan2(theta[1], theta[0])), "rad"),
        }
