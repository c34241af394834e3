"""Effects between the joint and its encoder: the model was moved along a wrong path.

Each is a small error δ(t) = q_logged − q of one joint. The needed torque was taken at q + δ, so the missing torque is
its derivative along δ: y = ∂ID/∂q δ + ∂ID/∂v δ̇ + ∂ID/∂a δ̈, on every row that the joint carries.
"""

import abc
import itertools

import numpy as np
from jaxtyping import Float

from jax_inertia.gap.context import Context
from jax_inertia.gap.families.base import Columns, Family, Parameter, Place, Shape
from jax_inertia.gap.twomass import Coupling
from jax_inertia.maths.finite_difference import derivative


def off_path(
    context: Context,
    row: int,
    delta: Float[np.ndarray, "T k"],
    rotor: tuple[float, float] = (0.0, 0.0),
) -> Columns:
    """What each error δ of a joint's logged path does to the missing torque.

    `rotor`: inertia and damping that turn with what the encoder saw, so that they felt no error.
    """
    at, *slopes = context.along(row)
    dq, dv, da = (x[:, :, None] for x in slopes)
    own = (at == row)[:, None]
    rate = derivative(context.time, delta)
    twice = derivative(context.time, rate)
    out = np.zeros((len(delta), context.robot.nv, delta.shape[1]))
    out[:, at] = (
        dq * delta[:, None]
        + (dv - rotor[1] * own) * rate[:, None]
        + (da - rotor[0] * own) * twice[:, None]
    )
    return Columns(out)


class Encoder(Family):
    kind = "joint"
    # What an encoder misreads does not depend on a load: what does is a joint that yields.
    changes = ("time", "position", "speed")

    @abc.abstractmethod
    def path(self, context, place, shape) -> np.ndarray:
        """δ(t) for θ = 1 (T,)."""

    def columns(self, context, place, shape):
        return off_path(context, place.index, self.path(context, place, shape)[:, None])

    def varying(self, context, place, shape, theta, factors):
        size = float(self.weights(context, place, theta)[0])
        delta = size * self.path(context, place, shape)[:, None] * factors
        return off_path(context, place.index, delta)


class EncoderOffset(Encoder):
    name, equation, size = "encoder_offset", "q_logged = q + o", 1

    def path(self, context, place, shape):
        return np.ones(len(context.time))

    def columns(self, context, place, shape):
        # ID(q + o) − ID(q) to second order in o: of degrees, what is beyond the first order is no noise.
        first = super().columns(context, place, shape).values
        return Columns(np.concatenate([first, -context.bend(place.index)[..., None]], axis=-1))

    def weights(self, context, place, theta):
        return np.array([theta[0], 0.5 * theta[0] ** 2])

    def starts(self, context, place, free):
        return [np.zeros(1) if free is None else free[:1]]

    def physical(self, context, place, shape, theta):
        return abs(theta[0]) < 0.3

    def parameters(self, context, place, shape, theta):
        return {"offset": Parameter(theta[0], "rad")}


class EncoderScale(Encoder):
    name, equation = "encoder_scale", "q_logged = (1 + κ) q"

    def path(self, context, place, shape):
        return context.joint_position[:, place.index]

    def physical(self, context, place, shape, theta):
        return abs(theta[0]) < 0.05

    def parameters(self, context, place, shape, theta):
        return {"scale": Parameter(theta[0] / (1 - theta[0]), "1")}


ALL = 1e3
"""A frequency [Hz] that is above all others."""


class TwoMass(Encoder):
    """Motor and link apart: the path is `context.separation`.

    The last shape is the frequency [Hz] up to which it counts: the motion's band, or all. Teeth rattle at other moments
    than computed, resonances ring by the encoder's own noise: then the computed effect is worse than none above the
    motion's band. Which of the two is no number of the robot's, so what brings more decides. The last but one says
    whether the joint's own friction, as the model has it, is the motor's or the link's.
    """

    whole, law_of = 0.2, "coupling"
    # Teeth rattle, resonances decay: not as computed.
    changes = ()

    def noisy(self, context):
        return True

    @abc.abstractmethod
    def coupling(self, shape: Shape) -> Coupling:
        """(K, ζ, b, s) of a shape, see `twomass`."""

    def prepare(self, context, place, shapes):
        context.driven_link(place.index).separate([self.coupling(shape) for shape in shapes])

    def path(self, context, place, shape):
        return context.driven_link(place.index).separation(self.coupling(shape))

    def band(self, shape):
        return shape[-1]

    def columns(self, context, place, shape):
        row, on_link, band = place.index, *shape[-2:]
        rotor = context.armature[row], (1.0 - on_link) * context.damping[row]
        every = off_path(context, row, self.path(context, place, shape)[:, None], rotor).values
        if on_link:
            rubbing = context.driven_link(row).rubbing(self.coupling(shape))
            every[:, row, 0] += context.prepared.dry[:, row] - rubbing
        return Columns(every if band == ALL else context.below(band, every))

    def around(self, context, place, shape):
        free = super().around(context, place, shape)[:-2]
        return [*free, *((x, x) for x in shape[-2:])]

    def sides(self, context: Context, place: Place) -> tuple[float, ...]:
        """Where the joint's own friction may be: zero on the motor, one on the link."""
        return (0.0, 1.0) if context.rubs(place.index) else (0.0,)

    def plain(self, shape):
        return not shape[-2]

    def where(self, shape: Shape) -> dict[str, Parameter]:
        """That the joint's own friction is the link's, where it is."""
        return {"friction_on_link": Parameter(1.0, "1")} if shape[-2] else {}

    def stiffnesses(self, context: Context, place: Place, n: int) -> np.ndarray:
        """From 0.12 rad at the joint's peak torque, as a series-elastic drive has it, to 0.0003 rad."""
        peak = np.percentile(np.abs(context.link_torque[:, place.index]), 99.5) + 1e-6
        return peak / np.geomspace(0.12, 3e-4, n)

    def physical(self, context, place, shape, theta):
        return True


class JointElasticity(TwoMass):
    name, equation = "joint_elasticity", "q_motor = q + δ, K δ + D δ̇ transmitted"
    # How a resonance decays is not in the equation.
    free_shape, form_error = 1, 0.3
    # Drives stiffen as they wind up (Tuttle and Seering 1996), which a dead zone draws as well.
    leeway = 0.01

    def grid(self, context, place):
        dampings = (0.01, 0.03, 0.08, 0.25)
        bands = (context.slow_band, ALL)
        return (self.stiffnesses(context, place, 31), dampings, self.sides(context, place), bands)

    def first(self, context, place):
        stiffness, damping, sides, bands = self.grid(context, place)
        return itertools.product(stiffness[1::3], damping[1::2], sides[:1], bands)

    def coupling(self, shape):
        return shape[0], shape[1], 0.0, 0.0, shape[2]

    def parameters(self, context, place, shape, theta):
        return {"stiffness": Parameter(shape[0], "N m/rad", 0.0), **self.where(shape)}


class Backlash(TwoMass):
    name, equation = "backlash", "q_motor = q + δ, nothing transmitted while |δ| < b/2"
    simpler = ("encoder_offset", "joint_elasticity")
    free_shape, form_error, peaks = 2, 0.5, 2

    def grid(self, context, place):
        # From a precision gear's half a minute of arc.
        gaps = np.geomspace(2e-4, 0.05, 13)
        bands = (context.slow_band, ALL)
        # Stiffnesses so close that between two of them the effect is not larger or smaller than `whole` allows.
        sides = self.sides(context, place)
        return (gaps, self.stiffnesses(context, place, 19), (0.15,), (0.0,), sides, bands)

    def first(self, context, place):
        gap, stiffness, *others = self.grid(context, place)
        return itertools.product(gap[::2], stiffness[2::6], *others)

    def around(self, context, place, shape):
        bounds = super().around(context, place, shape)
        # Where in its play the link is when the log begins.
        bounds[3] = (0.0, 0.0) if context.driven_link(place.index).leans else (-1.0, 1.0)
        return bounds

    def restarts(self, context, place, shape):
        if context.driven_link(place.index).leans:
            return ()
        _, stiffness, *_, sides, bands = self.grid(context, place)
        return itertools.product(shape[:1], stiffness[::2], shape[2:3], (-1.0, 1.0), sides, bands)

    def coupling(self, shape):
        return shape[1], shape[2], shape[0], shape[3], shape[4]

    def parameters(self, context, place, shape, theta):
        return {
            "dead_zone": Parameter(shape[0], "rad", 0.0),
            "stiffness": Parameter(shape[1], "N m/rad", 0.0),
            **self.where(shape),
        }
