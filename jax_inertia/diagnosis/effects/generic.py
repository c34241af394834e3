"""Generic alternatives: shapes that no named effect has. They compete for the residual, and say what it resembles."""

import abc

import numpy as np

from jax_inertia.diagnosis.effects.base import Effect, of_row, peak_of
from jax_inertia.diagnosis.effects.encoder import carried, off_path

HATS = 8


class _Free(Effect):
    named, form_error = False, 0.1

    @abc.abstractmethod
    def signal(self, context, place) -> np.ndarray:
        """What the torque is a free function of (T,)."""

    def columns(self, context, place, shape):
        x = self.signal(context, place)
        low, high = np.percentile(x, [0.5, 99.5])
        knots = np.linspace(low, high, HATS)
        width = max((high - low) / (HATS - 1), 1e-9)
        hats = np.maximum(1.0 - np.abs(np.clip(x, low, high)[:, None] - knots) / width, 0.0)
        return of_row(hats, place)

    def scale(self, context, place, shape):
        return np.full(HATS, 0.04 * peak_of(context, place.index))

    def numbers(self, context, place, shape, theta):
        return {}


class OfPosition(_Free):
    name, equation = "a torque that depends on position", "f(q)"

    def signal(self, context, place):
        return context.joint_position[:, place.index]


class OfSpeed(_Free):
    name, equation = "a torque that depends on speed", "f(q̇)"

    def signal(self, context, place):
        return context.v[:, place.index]


class OfTime(_Free):
    name, equation = "a torque that drifts over time", "f(t)"

    def signal(self, context, place):
        return context.time


class FrictionOfPosition(_Free):
    name, equation = "a friction that depends on position", "−f(q) sign(q̇)"

    def signal(self, context, place):
        return context.joint_position[:, place.index]

    def columns(self, context, place, shape):
        hats = super().columns(context, place, shape)
        z = context.bristle(place.index, 3e-4)
        return of_row(-hats.values * z[:, None], place)


class PathOfTorque(Effect):
    """Of the sign that no soft joint has: a driver that takes off a deflection which its encoder does not see."""

    named, form_error = False, 0.1
    name, equation = "a position that is corrected for the torque", "q_logged = q − c τ_link"

    def columns(self, context, place, shape):
        return off_path(context, place.index, -carried(context, place.index))

    def scale(self, context, place, shape):
        return np.array([0.02 / peak_of(context, place.index)])

    def lower(self, context, place):
        return 0.0

    def numbers(self, context, place, shape, theta):
        return {}
