"""Plans for effects at a joint's own axis: viscous friction, springs, rotor inertia, teeth of the motor."""

import numpy as np

from jax_inertia.diagnosis.effects import joint
from jax_inertia.diagnosis.effects.base import Columns
from jax_inertia.gap.families.base import Family


class ViscousFriction(Family):
    effect = joint.ViscousFriction()
    form_error = 0.03

    def physical(self, context, place, shape, theta):
        return theta[0] + context.damping[place.index] >= -1e-9


class FrictionDrift(Family):
    effect = joint.FrictionDrift()
    simpler = ("viscous_friction",)
    form_error = 0.05

    def grid(self, context, place):
        longest = context.time[-1]
        return ([T for T in (1.0, 2.0, 3.0, 5.0, 8.0, 12.0, 18.0) if 2 * longest > T],)

    def columns(self, context, place, shape):
        v = context.v[:, place.index, None]
        more = self.effect.columns(context, place, shape)
        return Columns(np.concatenate([-v, more.values], axis=1), place.index)

    def physical(self, context, place, shape, theta):
        own = context.damping[place.index]
        return theta[1] > 0 and theta[0] + own > -0.3 * theta[1]


class Armature(Family):
    effect = joint.Armature()
    slow = True

    def physical(self, context, place, shape, theta):
        own = context.armature[place.index]
        # Exactly minus the model's own would be a motor that is not connected.
        return theta[0] > -0.95 * own - 1e-9


class JointSpring(Family):
    effect = joint.JointSpring()
    simpler = ("torque_bias",)

    def sized(self, context, place, size):
        # About where the joint mostly is: a constant torque is no spring.
        return [size * np.array([np.mean(context.joint_position[:, place.index]), 1.0])]

    def physical(self, context, place, shape, theta):
        return theta[1] + context.stiffness[place.index] > 0


class Cogging(Family):
    effect = joint.Cogging()
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
        # The wave alone: what this search adds to it, it adds as an effect.
        both = self.effect.columns(context, place, shape)
        return Columns(both.values[:, :2], both.row)

    def parameters(self, context, place, shape, theta):
        found = self.effect.numbers(context, place, shape, np.array([*theta, 0.0, 0.0]))
        return {name: found[name] for name in ("amplitude", "frequency", "phase")}

    def physical(self, context, place, shape, theta):
        return np.hypot(*theta) < 0.3 * context.peak[place.index]


class TorqueBias(Family):
    effect = joint.TorqueBias()

    def physical(self, context, place, shape, theta):
        return abs(theta[0]) < 0.6 * context.peak[place.index] + 1e-9
