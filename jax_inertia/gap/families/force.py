"""Plans for forces on a body: for good, for a while, or of the air."""

import abc

import numpy as np

from jax_inertia.diagnosis.effects import external_force
from jax_inertia.diagnosis.effects.base import Columns, Parameter, Place
from jax_inertia.diagnosis.effects.external_force import components, push_window
from jax_inertia.diagnosis.features.context import Context
from jax_inertia.gap.families.base import Family

# What holds a robot up, or weighs it down: so many times its weight, and a hand's pull beside it [N].
HARDEST_HOIST, HAND = 3.0, 50.0
# As many standard deviations as the hardest is.
UNLIKELY = 3.0


def hardest(context: Context) -> float:
    """More than any force on a robot for good [N]."""
    return HARDEST_HOIST * _weight(context) + HAND


def _weight(context: Context) -> float:
    """Of the whole robot [N]."""
    return float(context.pi[:, 0].sum() * np.linalg.norm(np.asarray(context.robot.gravity)))


class Force(Family):
    """Jᵀ f, f fixed in the world, on a body's centre of mass."""

    vector = True

    @abc.abstractmethod
    def hardest(self, context: Context) -> float:
        """More than this it cannot be [N]."""

    def rows(self, context: Context, place: Place) -> np.ndarray:
        """Torque of unit weights (T, nv, k)."""
        return context.force_rows[:, place.index]

    def physical(self, context, place, shape, theta):
        return bool(np.linalg.norm(theta) < self.hardest(context))

    def tightness(self, context):
        # In passing, joints may stand so that a force along a limb is told by next to nothing.
        return np.full(3, UNLIKELY / self.hardest(context))

    def parameters(self, context, place, shape, theta):
        return components(theta)


class AtAPoint(Force):
    """The same on any point of the body: e = Jᵀ f + Σ rᵢ ∂Jᵀ/∂pᵢ f, r from the centre of mass; θ = [f, r]."""

    size, doubt, vector = 6, 30.0, False

    def rows(self, context, place):
        levers = context.lever_rows(place.index)
        flat = levers.reshape(*levers.shape[:2], 9)
        return np.concatenate([super().rows(context, place), flat], axis=2)

    def weights(self, context, place, theta):
        return np.concatenate([theta[:3], np.outer(theta[3:], theta[:3]).ravel()])

    def starts(self, context, place, free):
        if free is None or not free[:3].any():
            return [np.zeros(6)]
        f = free[:3]
        r = free[3:].reshape(3, 3) @ f / (f @ f)
        origin = -_centre(context, place)
        return [
            np.concatenate([f, x])
            for x in (np.zeros(3), origin, _within(r, _extent(context, place)))
        ]

    def tightness(self, context):
        # Along a joint's axis a point may lie anywhere: there the force acts alike, on the links at either side too.
        return np.array([0.0, 0.0, 0.0, *3 * [1.0 / (REACH * context.scale)]])

    def physical(self, context, place, shape, theta):
        return super().physical(context, place, shape, theta[:3]) and bool(
            np.linalg.norm(theta[3:]) < _extent(context, place)
        )

    def parameters(self, context, place, shape, theta):
        point = _centre(context, place) + theta[3:]
        names = zip("xyz", point, strict=True)
        return super().parameters(context, place, shape, theta[:3]) | {
            f"point_{k}": Parameter(x, "m") for k, x in names
        }


# How far from a body's centre of mass something mostly pulls at it, on a robot of usual size (`Context.scale`) [m].
REACH = 0.1
# Of a body's radius of gyration: a rod ends at 1.7 of them, and a grip or a hook reaches beyond, likewise [m].
ENDS, BEYOND = 3.0, 0.1


def _extent(context: Context, place: Place) -> float:
    """How far from its centre of mass a body may be pulled at [m]."""
    pi, c = context.pi[place.index], _centre(context, place)
    if pi[0] <= 0:
        return BEYOND * context.scale
    # Σ moments = 2 ∫ r² dm, about the body's frame.
    about_centre = 0.5 * (pi[4] + pi[7] + pi[9]) / pi[0] - float(c @ c)
    return ENDS * float(np.sqrt(max(about_centre, 0.0))) + BEYOND * context.scale


def _within(r: np.ndarray, most: float) -> np.ndarray:
    """r, no longer than half of what is allowed."""
    return r * min(1.0, 0.5 * most / max(float(np.linalg.norm(r)), 1e-9))


def _centre(context: Context, place: Place) -> np.ndarray:
    """A body's centre of mass in its own frame."""
    m, h = context.pi[place.index][0], context.pi[place.index][1:4]
    return h / m if m > 0 else np.zeros(3)


class Lasting(Force):
    """A force for good."""

    effect = external_force.ConstantForce()

    def hardest(self, context):
        return hardest(context)

    def columns(self, context, place, shape):
        return Columns(self.rows(context, place))


class ConstantForceAtAPoint(Lasting, AtAPoint):
    simpler = ("constant_force",)


class ConstantForce(Lasting):
    freer = ConstantForceAtAPoint()
    # A force has a point, and a centre of mass that is off by a millimetre is not it. What a hard force at the wrong
    # point leaves would be taken for another force on the next link.
    leeway = 0.0


# Drag grows with the area [N s²/m²]; water is 800 times as dense as air.
DENSEST = 200.0


class Drag(Family):
    effect = external_force.Drag()
    form_error = 0.05

    def places(self, context):
        # Where only changes of the base's velocity are known, a drag is anything that changes as slowly.
        return super().places(context) if context.prepared.knows_velocity else []

    def physical(self, context, place, shape, theta):
        return bool(0 < theta[0] < DENSEST * context.scale**2)


# A person, or a light collision [N]; what passes by a machine of tonnes, in its weights.
HARDEST_PUSH, HARDEST_BLOW = 700.0, 0.3


class Passing(Force):
    """A force for a while, f w(t)."""

    effect = external_force.Push()
    passing, smooth, form_error = True, True, 0.1
    # Where its torque changes sign midway, the louder half alone is a peak too.
    peaks = 2

    def hardest(self, context):
        return max(HARDEST_PUSH, HARDEST_BLOW * _weight(context))

    # A shape is when the force is at its half, rising and falling, the share of the whole that either flank takes, and
    # by how much more it is in the first half: so that each hardly moves the others.
    def shapes(self, context, place):
        return [(*window, 0.3, 0.0) for window in context.windows]

    def again(self, context, place, shape, theta):
        columns = self.columns(context, place, shape)
        # One for each component of the force.
        units = [np.concatenate([e, theta[3:]]) for e in np.eye(3)]
        forces = np.stack([self.weights(context, place, unit) for unit in units], axis=1)
        return Columns(columns.values @ forces)

    def around(self, context, place, shape):
        # The chain's low-pass smears a push by a tenth of a second.
        rise, fall, *_ = shape
        middle = 0.5 * (rise + fall)
        return [
            (max(rise - 0.1, 0.0), min(rise + 0.15, middle - 0.02)),
            (max(fall - 0.15, middle + 0.02), min(fall + 0.1, context.time[-1])),
            (0.02, 0.5),
            (-0.7, 0.7),
        ]

    def columns(self, context, place, shape):
        window = push_window(np, context.time, *_whole(shape), *shape[2:])
        return Columns(self.rows(context, place) * window[:, None, None])

    def parameters(self, context, place, shape, theta):
        window = self.effect.numbers(context, place, (*_whole(shape), *shape[2:]), theta[:3])
        return super().parameters(context, place, shape, theta) | {
            name: p for name, p in window.items() if not name.startswith("force")
        }


class PushAtAPoint(Passing, AtAPoint):
    simpler = ("push",)


class Push(Passing):
    freer = PushAtAPoint()


def _whole(shape) -> tuple[float, float]:
    """When a push begins and ends."""
    rise, fall, flank, _ = shape
    half = 0.5 * flank * (fall - rise) / (1.0 - flank)
    return rise - half, fall + half
