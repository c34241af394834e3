"""What is never exact of forces of the ground, marginalised: feet that give, friction at rest, stamps of wrenches.

Where no contact wrench is measured, legs' torques and feet say what the ground does (`signals.ground.support`).
"""

import dataclasses

import numpy as np
from jaxtyping import Bool, Float

from jax_inertia.diagnosis.effects.base import Columns, Effect, Place, of_row
from jax_inertia.diagnosis.features.context import Context
from jax_inertia.maths.finite_difference import derivative
from jax_inertia.signals.ground.support import BASE
from jax_inertia.signals.torque_residual import needed_torques, without_friction


class _Ground(Effect):
    named, marginal, form_error = False, True, 0.0

    def of_links(self, theta):
        # They say how a log is read.
        return np.zeros_like(theta)

    def numbers(self, context, place, shape, theta):
        return {}


GIVES = 0.05
"""Share of a base's acceleration that feet hide, or feign, which give under the load that it is: 0.01 to 0.06 in trots
of two simulated robots, with contacts of 8 and 12 ms."""


class GivingFeet(_Ground):
    """An acceleration of the base that its feet do not show, along each axis."""

    name, equation, kind = "giving_feet", "M κ a, a of the base by its feet", "global"

    def places(self, context):
        return super().places(context) if context.prepared.by_feet else []

    def columns(self, context, place, shape):
        return Columns(_moved(context, GIVES * context.a[:, :3]))

    def scale(self, context, place, shape):
        return np.ones(3)


MISSES, APART = 15.0, 0.5
"""One standard deviation of an IMU's gain per second of the log's period, and of when it samples, of that
period: of what is between two samples it says nothing. Samples of 200 Hz that fall on a walking robot's new targets, at
which its acceleration jumps, showed 1.06 of it below 20 Hz, 1.7 ms too early; those between targets 0.99 and 0.4."""


class SampledAcceleration(_Ground):
    """A base's acceleration that its IMU shows too large or too small, or early or late, along and about each axis.

    Shape: the log's period [s].
    """

    name, equation, kind = (
        "sampled_acceleration",
        "M (κ a + δt ȧ), a of the base by its IMU",
        "global",
    )

    def places(self, context):
        prepared = context.prepared
        return super().places(context) if not (prepared.knows_velocity or prepared.by_feet) else []

    def columns(self, context, place, shape):
        a = context.a[:, :BASE]
        size, late = MISSES * shape[0] * a, APART * shape[0] * derivative(context.time, a)
        return Columns(np.concatenate([_moved(context, x) for x in (size, late)], axis=2))

    def scale(self, context, place, shape):
        return np.ones(2 * BASE)


def _moved(context: Context, by: Float[np.ndarray, "T k"]) -> Float[np.ndarray, "T nv k"]:
    """Torque of a base that accelerates so much more along each of its first axes [N m]."""
    observation = context.prepared.observation
    bare = without_friction(context.robot)
    own, columns = needed_torques(bare, observation), []
    for axis in range(by.shape[1]):
        a = np.array(observation.a)
        a[:, axis] += by[:, axis]
        columns.append(needed_torques(bare, dataclasses.replace(observation, a=a)) - own)
    return np.stack(columns, axis=2)


CHANGES, MOST = 0.05, 400
"""Friction at rest under a foot may change within this time [s], or as fast as this many numbers in all can tell."""


class HeldFriction(_Ground):
    """Whatever friction balances in a leg at rest whose torque tells what the ground gives: hats in time."""

    name, equation = "held_friction", "F w(t), |w| about 1, of a joint at rest"
    of_log = True

    def places(self, context):
        held = _held(context)
        return [p for p in super().places(context) if held[:, p.index].any()]

    def columns(self, context, place, shape):
        held, row = _held(context), place.index
        every = max(CHANGES, float(held.sum()) / context.prepared.rate / MOST)
        nodes = np.arange(0.0, context.time[-1] + every, every)
        hats = np.maximum(1.0 - np.abs(context.time[:, None] - nodes) / every, 0.0)
        own = hats * held[:, [row]]
        return of_row(context.frictionloss[row] * own[:, own.any(axis=0)], place)

    def scale(self, context, place, shape):
        return np.ones(self.columns(context, place, shape).values.shape[1])


def _held(context: Context) -> Bool[np.ndarray, "T nv"]:
    """Where friction that the model states holds a joint of a leg on forces that are not measured."""
    support = context.prepared.support
    if support is None:
        return np.zeros_like(context.at_rest)
    return context.at_rest & support.used_up & (context.frictionloss > 0)


SAMPLED, FARTHEST = 0.25, 0.5
"""Of the log's period, when within it a wrench acted: one standard deviation, and by how much at most."""


class WrenchTiming(_Ground):
    """Measured wrenches a part of a sample early or late: a foot that is set down adds tens of weights a second.

    Shape: the log's period [s].
    """

    name, equation, kind = "wrench_timing", "Σ Jᵀ (δt λ̇ + ½ δt² λ̈)", "global"

    def places(self, context):
        measured = context.wrench is not None and context.prepared.support is None
        return super().places(context) if measured else []

    def columns(self, context, place, shape):
        late, most = SAMPLED * shape[0], FARTHEST * shape[0]
        assert context.wrench is not None
        slope = derivative(context.time, context.wrench)
        shifts = late * slope, 0.5 * late * most * derivative(context.time, slope)
        return Columns(np.stack([context.contact_torques(x).sum(axis=1) for x in shifts], axis=2))

    def scale(self, context, place, shape):
        return np.ones(2)


def places_of_ground(context: Context, period: float) -> list[tuple[Effect, Place, tuple]]:
    """Each of these effects at each of its places, with its shape, on a log of a `period` [s]."""
    shapes = (
        (GivingFeet(), ()),
        (SampledAcceleration(), (period,)),
        (HeldFriction(), ()),
        (WrenchTiming(), (period,)),
    )
    return [(effect, place, shape) for effect, shape in shapes for place in effect.places(context)]
