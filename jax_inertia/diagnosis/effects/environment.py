"""Effects that belong to no single joint or body: where gravity points, what contact sensors read."""

import numpy as np
from jaxtyping import Float

from jax_inertia.diagnosis.effects import advice
from jax_inertia.diagnosis.effects.base import Columns, Edit, Effect, Parameter

LEVEL = 0.04
"""Standard deviation of how a base that should be level stands [rad]."""
SLOPE = 0.5
"""Angle from which secants start, too [rad]: from there they find their way to a wall."""


def turns(theta: Float[np.ndarray, "2"], gravity: Float[np.ndarray, "3"]) -> np.ndarray:
    """A(θ) of `GravityTilt`: the secant of gravity's change by rotation vectors about world x and y (3, 2)."""
    about = np.array([*theta, 0.0])
    angle = float(np.linalg.norm(about))
    first = np.cross(np.eye(3)[:2], gravity)
    half = 0.5 * np.sinc(angle / (2.0 * np.pi)) ** 2
    return (np.sinc(angle / np.pi) * first + half * np.cross(about, first)).T


def turned(gravity: Float[np.ndarray, "3"], theta: Float[np.ndarray, "2"]) -> np.ndarray:
    """Gravity turned by a rotation vector θ about world x and y: g + A(θ) θ."""
    return gravity + turns(theta, gravity) @ theta


class GravityTilt(Effect):
    """Gravity turned by a rotation vector θ about world x and y, of any angle a = |θ|.

        R(θ) g − g = sin(a)/a (θ × g) + (1 − cos a)/a² θ × (θ × g) = A(θ) θ        (Rodrigues)

    The needed torque is linear in gravity, so the secant at θ is exact.
    """

    name, equation, kind, secant = (
        "gravity_tilt",
        "gravity turned about world x and y",
        "global",
        True,
    )
    source, advice = "a base that is not level, a robot on a wall", advice.TURNED_BASE
    units, loads = {"tilt_x": "rad", "tilt_y": "rad"}, True
    prior = "0.04 rad about either axis, of larger ones as large as they are; at most π"
    mjcf = "option gravity"

    def shapes(self, context, place):
        about = (1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)
        return [(0.0, 0.0), *((SLOPE * x, SLOPE * y) for x, y in about)]

    def columns(self, context, place, shape):
        # The real robot needs more torque for its own gravity; what is missing is what it did not need to give.
        return Columns(-context.gravity_rows @ turns(np.asarray(shape), context.gravity))

    def scale(self, context, place, shape):
        # What is no matter of a level may be turned by anything: as far as it is.
        return np.full(2, max(LEVEL, float(np.linalg.norm(shape))))

    def possible(self, context, place, theta):
        return bool(np.hypot(*theta) < 1.01 * np.pi)

    def numbers(self, context, place, shape, theta):
        return {
            "tilt_x": Parameter(float(theta[0]), "rad"),
            "tilt_y": Parameter(float(theta[1]), "rad"),
        }

    def edit(self, spec, model, found):
        theta = np.array([found.values["tilt_x"], found.values["tilt_y"]])
        spec.option.gravity = turned(np.asarray(spec.option.gravity), theta)
        return Edit(whole=True)


class ContactForceScale(Effect):
    name, equation, kind = "contact_force_scale", "λ_measured = g λ", "contact"
    source, advice = "a foot sensor's calibration", advice.ON_A_SCALE
    units, prior = {"scale": "1"}, "1/g − 1: 0.1, below 0.5"
    mjcf = "none: what a sensor reads is no matter of the model"

    def columns(self, context, place, shape):
        return Columns(context.contact_rows[:, place.index, :, None])

    def scale(self, context, place, shape):
        return np.array([0.1])

    def possible(self, context, place, theta):
        return bool(abs(theta[0]) < 0.5)

    def numbers(self, context, place, shape, theta):
        return {"scale": Parameter(float(1.0 / (1.0 + theta[0])), "1", factor=True)}
