"""Plans for effects that belong to no single joint or body: where gravity points, what contact sensors read."""

import numpy as np

from jax_inertia.diagnosis.effects import environment
from jax_inertia.diagnosis.effects.base import Columns
from jax_inertia.gap.families.base import Family


class GravityTilt(Family):
    effect = environment.GravityTilt()
    size = 2

    def columns(self, context, place, shape):
        return Columns(-context.gravity_rows)

    def weights(self, context, place, theta):
        return environment.turns(theta, context.gravity) @ theta

    def starts(self, context, place, free):
        if free is None:
            return [np.zeros(2)]
        # The rotation that takes the model's gravity to where the three numbers of themselves have it.
        before, after = context.gravity, context.gravity + free
        axis = np.cross(before, after)[:2]
        angle = np.arctan2(np.linalg.norm(np.cross(before, after)), before @ after)
        return [angle * axis / max(float(np.hypot(*axis)), 1e-12)]

    def physical(self, context, place, shape, theta):
        return np.hypot(*theta) < 1.01 * np.pi


class ContactForceScale(Family):
    effect = environment.ContactForceScale()
