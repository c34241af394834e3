"""Effects of a transmission that ties joints together: a wrist motor that turns with the joint before it."""

import numpy as np

from jax_inertia.diagnosis.effects.base import Effect, peak_of
from jax_inertia.gap.families.base import Columns, Parameter, Place


class JointCoupling(Effect):
    """The motor of joint j turns by q̇ⱼ + c q̇ᵢ: its torque acts on i too, c τⱼ, and its friction feels i's speed."""

    name, equation, form_error = "joint_coupling", "τᵢ + c τⱼ, friction of j by q̇ⱼ + c q̇ᵢ", 0.05

    def shapes(self, context, place):
        return [(float(row),) for row in context.joint_dofs.values() if row != place.index]

    def columns(self, context, place, shape):
        out = np.zeros((*context.tau.shape, 2))
        other = int(shape[0])
        out[:, other, 0] = context.tau[:, place.index]
        out[:, place.index, 1] = -context.v[:, other]
        return Columns(out)

    def scale(self, context, place, shape):
        return np.array([0.2, 0.05 * peak_of(context, place.index)])

    def numbers(self, context, place, shape, theta):
        return {
            "coefficient": Parameter(float(theta[0]), "1"),
            "friction_of_other_speed": Parameter(float(theta[1]), "N m s/rad"),
        }

    def possible(self, context: object, place: Place, theta: np.ndarray) -> bool:
        return bool(abs(theta[0]) < 2.0)
