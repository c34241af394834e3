"""Plans for effects that belong to no single joint or body: where gravity points, what contact sensors read."""

import numpy as np

from jax_inertia.diagnosis.effects import environment
from jax_inertia.diagnosis.effects.base import Columns
from jax_inertia.gap.families.base import Family


class GravityTilt(Family):
    effect = environment.GravityTilt()
    size = 2

    def columns(self, context, place, shape):
        # All five of the second order, weighed at once.
        return Columns(-context.tilt)

    def weights(self, context, place, theta):
        x, y = theta
        return np.array([x, y, 0.5 * x * x, x * y, 0.5 * y * y])

    def starts(self, context, place, free):
        return [np.zeros(2) if free is None else free[:2]]

    def physical(self, context, place, shape, theta):
        return np.hypot(*theta) < 0.25


class ContactForceScale(Family):
    effect = environment.ContactForceScale()
