"""Effects between a joint and its encoder: the model was moved along a wrong path, q_logged = q + δ(t).

What the model needed was taken at q + δ, so the missing torque is its derivative along δ on every row that the joint
carries: y = ∂ID/∂q δ + ∂ID/∂q̇ δ̇ + ∂ID/∂q̈ δ̈.
"""

import numpy as np

from jax_inertia.diagnosis.effects.base import Effect, peak_of
from jax_inertia.gap.families.base import Columns, Parameter
from jax_inertia.gap.families.encoder import off_path


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


class JointElasticity(Effect):
    name, equation, form_error = "joint_elasticity", "q_motor = q + τ_link/K", 0.1

    def columns(self, context, place, shape):
        return off_path(context, place.index, carried(context, place.index))

    def scale(self, context, place, shape):
        return np.array([0.02 / peak_of(context, place.index)])

    def lower(self, context, place):
        return 0.0

    def numbers(self, context, place, shape, theta):
        return {"stiffness": Parameter(1.0 / max(float(theta[0]), 1e-9), "N m/rad", 0.0)}


class Backlash(Effect):
    name, equation, form_error = "backlash", "q_motor = q + ½ b sign(τ_link)", 0.3

    def columns(self, context, place, shape):
        torque = carried(context, place.index)
        half = 0.5 * np.tanh(torque / (0.03 * np.percentile(np.abs(torque), 99.5) + 1e-9))
        return off_path(context, place.index, half)

    def scale(self, context, place, shape):
        return np.array([0.02])

    def lower(self, context, place):
        return 0.0

    def possible(self, context, place, theta):
        return bool(0.0 <= theta[0] < 0.1)

    def numbers(self, context, place, shape, theta):
        return {"dead_zone": Parameter(float(theta[0]), "rad", 0.0)}
