"""What a nominal model may be off by, marginalised: each number of each body's inertia, and when a torque acts."""

import numpy as np
from jaxtyping import Float, Int

from jax_inertia.diagnosis.effects.base import Columns, Effect, Place, Shape, Term, of_row
from jax_inertia.diagnosis.effects.inertial import steiner
from jax_inertia.diagnosis.features.context import Context
from jax_inertia.signals.held import HOLD_ERROR, lateness, put_off

TIMING = -3
"""First of a log's columns among its tolerances: it says when torques act."""


class InertialTolerances(Effect):
    """y = Y Σ (one standard deviation of each number) z.

    Shape: standard deviations of a mass (relative), a centre of mass [m], an inertia (relative), and of when within its
    period a torque acted, of the period; how many measured numbers these tolerances count for; the log's period [s];
    how many times as large as stated the first three may be; by how much of the period a torque acted early or late at
    most.
    """

    name, equation, kind = "tolerances", "Y δπ, δπ within the model's tolerance", "global"
    named, marginal, form_error, loads = False, True, 0.0, True

    def columns(self, context, place, shape):
        every, robot = context.regressor, context.robot
        out = [
            every[:, :, robot.body_index(name)] @ change
            for change, name, _ in inertial_changes(context, shape)
        ]
        out.append(_timing(context, shape[3], shape[5], shape[7]))
        out.append(_loop_lateness(context, shape[5])[..., None])
        return Columns(np.concatenate(out, axis=-1))

    def scale(self, context, place, shape):
        return np.ones(sum(c.shape[1] for c, _, _ in inertial_changes(context, shape)) + 3)

    def kinds(self, count: int) -> Int[np.ndarray, " k"]:
        """Of each of `count` columns: 0 a mass, 1 a centre of mass, 2 an inertia, −1 the timings."""
        return np.append(np.tile([0, 1, 1, 1, *[2] * 6], (count - 3) // 10), [-1, -1, -1])

    def of_links(self, theta):
        # Timings are of the log.
        return np.concatenate([theta[:TIMING], np.zeros(-TIMING)])

    def size_prior(self, shape):
        return shape[4], shape[6]

    def numbers(self, context, place, shape, theta):
        return {}


def _timing(
    context: Context, error: float, period: float, most: float
) -> Float[np.ndarray, "T nv 2"]:
    """Torque of one standard deviation of when it acted [N m]; a position loop's law is better.

    A straight and a bent part, which together are exact for a torque that came earlier or later by `most`.
    """
    size = np.full(context.v.shape[1], error * period)
    if (loop := context.prepared.loop) is not None:
        of_loop = np.array(context.prepared.driven)[loop.kp > 0]
        size[of_loop] = np.minimum(size[of_loop], HOLD_ERROR * period)
    farthest = most * period
    samples = farthest / (context.time[1] - context.time[0])
    early, late = put_off(context.tau, -samples), put_off(context.tau, samples)
    parts = np.stack([early - late, early + late - 2.0 * context.tau], axis=-1)
    return size[:, None] * parts / (2.0 * farthest)


STATED = ("viscous_friction", "coulomb_friction", "armature")
"""Families whose number a model states of a joint."""


class StatedNumbers(Effect):
    """Errors of the friction and rotor inertia that the model states of a joint, relative to them; marginalised.

    Shape: standard deviation of the two of friction and of the rotor's, and for how many measured numbers they count.
    Friction changes with temperature and wear, a rotor does not.
    """

    name, equation = "stated_numbers", "−δd q̇ − δF sign(q̇) − δI q̈"
    named, marginal, form_error = False, True, 0.0

    def kinds(self, count):
        return np.arange(count)

    def size_prior(self, shape):
        return shape[2], 1.0

    def places(self, context):
        return [p for p in super().places(context) if self.own(context, p).any()]

    def columns(self, context, place, shape):
        row, own = place.index, self.own(context, place)
        motion = context.v[:, row], context.side[:, row], context.a[:, row]
        return of_row(-self.relative(shape) * np.stack(motion, 1) * own, place)

    def friction_terms(self, context, place, shape):
        damping, dry, _ = self.relative(shape) * self.own(context, place)
        return ({Term("viscous"): damping}, {Term("bristle"): dry}, {})

    @staticmethod
    def relative(shape: Shape) -> Float[np.ndarray, "3"]:
        """Standard deviation of each, relative to the model's."""
        friction, rotor, _ = shape
        return np.array([friction, friction, rotor])

    @staticmethod
    def own(context: Context, place: Place) -> Float[np.ndarray, "3"]:
        """The joint's numbers in the model, in the order of `STATED`."""
        every = context.damping, context.frictionloss, context.armature
        return np.array([float(x[place.index]) for x in every])

    def scale(self, context, place, shape):
        return np.ones(3)

    def numbers(self, context, place, shape, theta):
        return {}


def _loop_lateness(context: Context, period: float) -> Float[np.ndarray, "T nv"]:
    """Torque of one standard deviation of how late a position loop is, of the joints that have one [N m]."""
    out = np.zeros_like(context.v)
    if (loop := context.prepared.loop) is not None:
        rows = list(context.prepared.driven)
        out[:, rows] = lateness(loop, 1.0 / period, context.v[:, rows], context.a[:, rows])
    return out


def inertial_changes(
    context: Context, shape: tuple[float, ...]
) -> list[tuple[Float[np.ndarray, "10 k"], str, Float[np.ndarray, "10"]]]:
    """Of each body with mass: changes of π by one standard deviation of each number, its name, its π."""
    out = []
    for name, pi in zip(context.robot.body_names, context.pi, strict=True):
        m = float(pi[0])
        if m <= 0:
            continue
        c = pi[1:4] / m
        central = pi[4:] - steiner(m, c)
        change = [shape[0] * pi]
        for axis in np.eye(3):
            # The exact derivative: I about the origin moves with the centre of mass.
            turn = m * (2 * c @ axis * np.eye(3) - np.outer(c, axis) - np.outer(axis, c))
            moved = np.concatenate([[0.0], m * axis, turn[np.triu_indices(3)]])
            change.append(shape[1] * moved)
        size = shape[2] * max(float(central[[0, 3, 5]].max()), 1e-9)
        change += [np.concatenate([np.zeros(4), size * e]) for e in np.eye(6)]
        out.append((np.array(change).T, name, pi))
    return out
