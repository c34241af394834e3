"""Effects between the joint and its encoder: the model was moved along a wrong path.

Each is a small error δ(t) = q_logged − q of one joint. The needed torque was taken at q + δ, so the missing torque is
its derivative along δ: y = ∂ID/∂q δ + ∂ID/∂v δ̇ + ∂ID/∂a δ̈, on every row that the joint carries.
"""

import numpy as np

from jax_inertia.gap.families.base import Columns, Family, Parameter
from jax_inertia.gap.families.joint import sign


def derivative(x: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Central difference along time."""
    return np.gradient(x, time, axis=0)


class Encoder(Family):
    kind = "joint"
    motor_side = False
    """Whether the rotor turns with what the encoder saw, so that its inertia felt no error."""

    def path(self, context, place, shape) -> np.ndarray:
        """δ(t) for θ = 1 (T,)."""
        raise NotImplementedError

    def columns(self, context, place, shape):
        dq, dv, da = context.sensitivity
        j = place.index
        delta = self.path(context, place, shape)
        rate = derivative(delta, context.time)
        twice = derivative(rate, context.time)
        mass = da[:, :, j].copy()
        drag = dv[:, :, j].copy()
        if self.motor_side:
            mass[:, j] -= float(context.robot.armature[j])
            drag[:, j] -= float(context.robot.damping[j])
        e = dq[:, :, j] * delta[:, None] + drag * rate[:, None] + mass * twice[:, None]
        return Columns(e[:, :, None])


class EncoderOffset(Encoder):
    name, equation = "encoder_offset", "q_logged = q + o"

    def path(self, context, place, shape):
        return np.ones(len(context.time))

    def physical(self, context, place, shape, theta):
        return abs(theta[0]) < 0.3

    def parameters(self, context, place, shape, theta):
        return {"offset": Parameter(theta[0], "rad")}


class EncoderScale(Encoder):
    name, equation = "encoder_scale", "q_logged = (1 + κ) q"

    def path(self, context, place, shape):
        return context.joint_position[:, place.index]

    def physical(self, context, place, shape, theta):
        return abs(theta[0]) < 0.1

    def parameters(self, context, place, shape, theta):
        return {"scale": Parameter(theta[0] / (1 - theta[0]), "1")}


def transmitted(context, row: int) -> np.ndarray:
    """Torque through the gear (T,): what the model needs less what the rotor's side takes for itself.

    A model has one inertia, damping and friction per joint; those of a geared joint sit on the motor.
    """
    r = context.robot
    own = float(r.armature[row]) * context.a[:, row] + float(r.damping[row]) * context.v[:, row]
    own = own + float(r.frictionloss[row]) * sign(context.v[:, row])
    return context.inverse[:, row] - own


class JointElasticity(Encoder):
    name, equation = "joint_elasticity", "q_motor = q + τ/K"
    motor_side = True

    def path(self, context, place, shape):
        return transmitted(context, place.index)

    def physical(self, context, place, shape, theta):
        return 0 < theta[0] * context.peak[place.index] < 0.2

    def parameters(self, context, place, shape, theta):
        return {"stiffness": Parameter(1.0 / theta[0] if theta[0] else np.inf, "N m/rad")}


class Backlash(Encoder):
    name, equation = "backlash", "q_motor = q + b/2 sign(τ)"
    motor_side = True
    simpler = ("encoder_offset", "joint_elasticity")

    def path(self, context, place, shape):
        tau = transmitted(context, place.index)
        return 0.5 * np.tanh(tau / (0.02 * context.peak[place.index] + 1e-12))

    def physical(self, context, place, shape, theta):
        return 0 < theta[0] < 0.1

    def parameters(self, context, place, shape, theta):
        return {"dead_zone": Parameter(theta[0], "rad")}
