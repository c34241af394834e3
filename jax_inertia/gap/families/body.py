"""Plans for effects on a body's inertial parameters, which stay on the manifold of bodies that can exist."""

import numpy as np

from jax_inertia.diagnosis.effects import inertial
from jax_inertia.diagnosis.effects.base import Columns, Parameter
from jax_inertia.diagnosis.effects.inertial import (
    ROUND,
    inertia_change,
    load_change,
    shift_change,
)
from jax_inertia.gap.families.base import Family


class Inertial(Family):
    """e = −Y δπ(θ), δπ the weights."""

    alike, slow = "−Y", True

    def columns(self, context, place, shape):
        return Columns(-context.regressor[:, :, place.index, :])

    def pi(self, context, place) -> np.ndarray:
        return context.pi[place.index]


# On a robot of usual size (`Context.scale`): how far from its body's frame a load is carried, and a centre of mass from
# where it should be [m].
FARTHEST, OFF_CENTRE = 1.0, 0.15


class Load(Inertial):
    """A mass more, at a point c of the body."""

    effect = inertial.Payload()
    rigid = True
    # A real load is neither a point nor a ball: some of its own inertia is left.
    form_error = 0.05
    bends = ("mass", "centre of mass", "inertia")

    def starts(self, context, place, free):
        scale = max(float(self.pi(context, place)[0]), 0.1)
        out = [np.concatenate([[m * scale], np.zeros(3)]) for m in (0.05, 0.3, 1.0)]
        if free is not None and free[0] > 0:
            out.append(np.concatenate([free[:1], free[1:4] / free[0]]))
        return out

    def weights(self, context, place, theta):
        return load_change(theta[0], theta[1:4])

    def physical(self, context, place, shape, theta):
        return bool(theta[0] > 0 and np.linalg.norm(theta[1:4]) < FARTHEST * context.scale)

    def sized(self, context, place, size):
        pi = self.pi(context, place)
        return [np.array([size, *(pi[1:4] / pi[0] if pi[0] > 0 else np.zeros(3))])]

    def parameters(self, context, place, shape, theta):
        return {
            "mass": Parameter(theta[0], "kg", 0.0),
            **{f"com_{k}": Parameter(x, "m") for k, x in zip("xyz", theta[1:4], strict=True)},
        }


class LoadOfSomeSize(Load):
    size = 5
    simpler = ("payload",)

    def starts(self, context, place, free):
        size = SIZE * context.scale
        return [np.append(theta, size**2) for theta in super().starts(context, place, free)]

    def weights(self, context, place, theta):
        return super().weights(context, place, theta) + theta[0] * max(theta[4], 0.0) * ROUND

    def tightness(self, context):
        return np.array([0.0, 0.0, 0.0, 0.0, 1.0 / (SIZE * context.scale) ** 2])

    def physical(self, context, place, shape, theta):
        widest = WIDEST * context.scale
        return super().physical(context, place, shape, theta) and 0 < theta[4] < widest**2

    def parameters(self, context, place, shape, theta):
        own = {"gyration_radius": Parameter(float(np.sqrt(theta[4])), "m", 0.0)}
        return super().parameters(context, place, shape, theta) | own


# Radius of gyration of what is carried, and of the widest of that, likewise [m].
SIZE, WIDEST = 0.07, 0.3


class Payload(Load):
    size, freer = 4, LoadOfSomeSize()


class ComShift(Inertial):
    effect = inertial.ComShift()
    size = 3

    def sized(self, context, place, size):
        return [*(size * np.eye(3))]

    def weights(self, context, place, theta):
        return shift_change(self.pi(context, place), theta[:3])

    def physical(self, context, place, shape, theta):
        return bool(np.linalg.norm(theta) < OFF_CENTRE * context.scale)


# No link has so many times more rotational inertia than its model, or less: a motor about its own axis may.
MOST = 10.0


class LinkInertia(Inertial):
    effect = inertial.LinkInertia()
    size = 1

    def starts(self, context, place, free):
        return [np.array([0.1])]

    def sized(self, context, place, size):
        return [np.array([size])]

    def weights(self, context, place, theta):
        return inertia_change(self.pi(context, place), theta[0])

    def physical(self, context, place, shape, theta):
        return bool(1.0 / MOST < 1.0 + theta[0] < MOST)
