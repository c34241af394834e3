"""Effects that belong to no single joint or body: where gravity points, what contact sensors read."""

import numpy as np

from jax_inertia.gap.families.base import Columns, Family, Parameter


class GravityTilt(Family):
    name, equation, kind = "gravity_tilt", "gravity turned about world x and y", "global"
    size = 2

    def columns(self, context, place, shape):
        # The real robot needs more torque for its own gravity; what is missing is what it did not need to give.
        return Columns(-context.tilt)

    def weights(self, context, place, theta):
        x, y = theta
        return np.array([x, y, 0.5 * x * x, x * y, 0.5 * y * y])

    def starts(self, context, place, free):
        return [np.zeros(2) if free is None else free[:2]]

    def physical(self, context, place, shape, theta):
        return np.hypot(*theta) < 0.25

    def parameters(self, context, place, shape, theta):
        return {
            "tilt_x": Parameter(theta[0], "rad"),
            "tilt_y": Parameter(theta[1], "rad"),
        }


class ContactForceScale(Family):
    name, equation, kind = "contact_force_scale", "λ_measured = g λ", "contact"

    def columns(self, context, place, shape):
        return Columns(context.contact_rows[:, place.index, :, None])

    def physical(self, context, place, shape, theta):
        return abs(theta[0]) < 0.5

    def parameters(self, context, place, shape, theta):
        return {"scale": Parameter(1.0 / (1.0 + theta[0]), "1", factor=True)}
