"""Generic alternatives: shapes that no named effect has. They compete for the residual, and say what it resembles."""

import abc

import numpy as np
from scipy import signal

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
        z = context.bristle(place.index, context.turns_over(place.index))
        return of_row(-hats.values * z[:, None], place)


class MemoryOfPosition(Effect):
    """Hoses and cables with loss, soft gears that slip: states that turn over far longer ways than dry friction's."""

    named, form_error = False, 0.1
    name, equation = (
        "a torque with a memory of the position",
        "−k q − Σ Fₖ zₖ, zₖ over 0.02 to 0.5 rad",
    )

    def columns(self, context, place, shape):
        radian = float(context.radian[place.index])
        turning = [context.bristle(place.index, radian * travel) for travel in TRAVELS]
        return of_row(-np.stack([context.joint_position[:, place.index], *turning], 1), place)

    def scale(self, context, place, shape):
        return np.full(1 + len(TRAVELS), 0.05 * peak_of(context, place.index))

    def numbers(self, context, place, shape, theta):
        return {}


TRAVELS = (0.02, 0.07, 0.2, 0.5)
"""Ways over which hysteresis turns [rad]."""


class Swinging(Effect):
    """A cover, a tool, a cable drum on a spring; shape: its frequency [Hz]. Its torque: the acceleration, filtered."""

    named, form_error = False, 0.1
    name, equation = "something that swings on the joint", "−J φ̈, φ̈ + 2ζω φ̇ + ω² (φ − q) = 0"

    def shapes(self, context, place):
        return [(f,) for f in SWINGS if f < 0.8 * context.prepared.bands.cutoff]

    def steps(self, context, place, shape):
        return (0.12 * shape[0],)

    def columns(self, context, place, shape):
        step, omega = float(context.time[1] - context.time[0]), 2 * np.pi * shape[0]
        a = context.a[:, place.index]
        # φ − q swings as −q̈ drives it: its position and speed are the torques of spring and damper.
        b, c = signal.bilinear([1.0], [1.0, 2 * SWING_DAMPING * omega, omega**2], 1.0 / step)
        angle = -np.asarray(signal.lfilter(b, c, a))
        return of_row(np.stack([omega**2 * angle, omega * np.gradient(angle, step)], 1), place)

    def scale(self, context, place, shape):
        top = np.percentile(np.abs(context.a[:, place.index]), 99.5)
        return np.full(2, 0.1 * peak_of(context, place.index) / max(float(top), 1e-6))

    def numbers(self, context, place, shape, theta):
        return {}


SWINGS = (1.5, 2.0, 2.6, 3.3, 4.2, 5.2, 6.5)
"""Frequencies searched [Hz]."""
SWING_DAMPING = 0.05
"""Of its critical damping."""


class PathOfTorque(Effect):
    """Of the sign that no soft joint has: a driver that takes off a deflection which its encoder does not see."""

    named, form_error, law = False, 0.1, "coupling"
    name, equation = "a position that is corrected for the torque", "q_logged = q − c τ_link"

    def columns(self, context, place, shape):
        return off_path(context, place.index, -carried(context, place.index))

    def scale(self, context, place, shape):
        return np.array([0.02 / peak_of(context, place.index)])

    def lower(self, context, place):
        return 0.0

    def numbers(self, context, place, shape, theta):
        return {}
