"""Effects between a joint and its encoder: the model was moved along a wrong path, q_logged = q + δ(t).

What the model needed was taken at q + δ, so the missing torque is its derivative along δ on every row that the joint
carries: y = ∂ID/∂q δ + ∂ID/∂q̇ δ̇ + ∂ID/∂q̈ δ̈.
"""

import numpy as np

from jax_inertia.diagnosis.effects.base import Effect
from jax_inertia.gap.families.base import Columns, Parameter
from jax_inertia.gap.families.encoder import Backlash as Play
from jax_inertia.gap.families.encoder import JointElasticity as SoftJoint
from jax_inertia.gap.families.encoder import TwoMass, off_path


class EncoderOffset(Effect):
    name, equation, secant = "encoder_offset", "q_logged = q + o", True

    def shapes(self, context, place):
        return [(0.0,)]

    def columns(self, context, place, shape):
        first = off_path(context, place.index, np.ones((len(context.time), 1))).values
        if shape[0]:
            # ID(q) − ID(q − o) to second order in o.
            first = first - 0.5 * shape[0] * context.bend(place.index)[..., None]
        return Columns(first)

    def scale(self, context, place, shape):
        return np.array([0.03])

    def possible(self, context, place, theta):
        return bool(abs(theta[0]) < 0.3)

    def numbers(self, context, place, shape, theta):
        return {"offset": Parameter(float(theta[0]), "rad")}


class EncoderScale(Effect):
    name, equation = "encoder_scale", "q_logged = (1 + κ) q"

    def columns(self, context, place, shape):
        q = context.joint_position[:, [place.index]]
        return off_path(context, place.index, q)

    def scale(self, context, place, shape):
        return np.array([0.01])

    def possible(self, context, place, theta):
        return bool(abs(theta[0]) < 0.05)

    def numbers(self, context, place, shape, theta):
        return {"scale": Parameter(float(theta[0] / (1 - theta[0])), "1")}


def carried(context, row: int) -> np.ndarray:
    """Torque that the joint's coupling carries: what its link needs, in the analysis band (T, 1)."""
    return context.below(context.prepared.bands.cutoff, context.link_torque[:, [row]])


class _TwoMass(Effect):
    """Motor and link apart, by the two-mass observer: the whole effect of one set of couplings, θ near one.

    What the coupling carries is the logged torque less what the motor takes for itself, so the joint's own friction and
    rotor inertia have to be known: columns are of the calibrated model.
    """

    calibrated = True
    family: TwoMass

    def shapes(self, context, place):
        own = list(self.family.first(context, place))
        self.family.prepare(context, place, own)
        return [tuple(float(x) for x in shape) for shape in own]

    def columns(self, context, place, shape):
        return self.family.columns(context, place, shape)

    def scale(self, context, place, shape):
        return np.array([1.0])

    def possible(self, context, place, theta):
        return bool(0.6 < theta[0] < 1.6)

    def numbers(self, context, place, shape, theta):
        return self.family.parameters(context, place, shape, theta)


class JointElasticity(_TwoMass):
    name, equation, form_error = "joint_elasticity", "q_motor = q + τ_link/K", 0.1
    family = SoftJoint()

    def steps(self, context, place, shape):
        return (0.2 * shape[0], 0.0, 0.0, 0.0)


class Backlash(_TwoMass):
    name, equation, form_error = "backlash", "nothing transmitted while |q_motor − q| < b/2", 0.3
    family = Play()

    def steps(self, context, place, shape):
        return (0.3 * shape[0], 0.3 * shape[1], 0.0, 0.0, 0.0, 0.0)
