"""Effects that belong to no single joint or body: where gravity points, what contact sensors read."""

import numpy as np

from jax_inertia.diagnosis.effects.base import Effect
from jax_inertia.gap.families.base import Columns, Parameter


class GravityTilt(Effect):
    name, equation, kind, secant = (
        "gravity_tilt",
        "gravity turned about world x and y",
        "global",
        True,
    )

    def shapes(self, context, place):
        return [(0.0, 0.0)]

    def columns(self, context, place, shape):
        x, y = shape
        tx, ty, txx, txy, tyy = np.moveaxis(context.tilt, -1, 0)
        along_x = tx + 0.5 * x * txx + 0.5 * y * txy
        along_y = ty + 0.5 * x * txy + 0.5 * y * tyy
        return Columns(-np.stack([along_x, along_y], axis=-1))

    def scale(self, context, place, shape):
        return np.full(2, 0.04)

    def possible(self, context, place, theta):
        return bool(np.hypot(*theta) < 0.3)

    def numbers(self, context, place, shape, theta):
        return {
            "tilt_x": Parameter(float(theta[0]), "rad"),
            "tilt_y": Parameter(float(theta[1]), "rad"),
        }


class ContactForceScale(Effect):
    name, equation, kind = "contact_force_scale", "λ_measured = g λ", "contact"

    def columns(self, context, place, shape):
        return Columns(context.contact_rows[:, place.index, :, None])

    def scale(self, context, place, shape):
        return np.array([0.1])

    def possible(self, context, place, theta):
        return bool(abs(theta[0]) < 0.5)

    def numbers(self, context, place, shape, theta):
        return {"scale": Parameter(float(1.0 / (1.0 + theta[0])), "1", factor=True)}
