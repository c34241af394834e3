"""Plans for effects between the joint and its encoder: an offset, a scale, a spring, play."""

import itertools

import numpy as np

from jax_inertia.diagnosis.effects import encoder
from jax_inertia.diagnosis.effects.base import Columns
from jax_inertia.diagnosis.effects.encoder import off_path
from jax_inertia.gap.families.base import Family

# What an encoder misreads does not depend on a load: what does is a joint that yields.
UNLOADED = ("time", "position", "speed")


class EncoderOffset(Family):
    effect = encoder.EncoderOffset()
    size, changes = 1, UNLOADED

    def columns(self, context, place, shape):
        # ID(q + o) − ID(q) to second order in o: of degrees, what is beyond the first order is no noise.
        first = self.effect.columns(context, place, (0.0,)).values
        return Columns(np.concatenate([first, -context.bend(place.index)[..., None]], axis=-1))

    def weights(self, context, place, theta):
        return np.array([theta[0], 0.5 * theta[0] ** 2])

    def starts(self, context, place, free):
        return [np.zeros(1) if free is None else free[:1]]

    def varying(self, context, place, shape, theta, factors):
        return off_path(context, place.index, theta[0] * factors)


class EncoderScale(Family[encoder.EncoderScale]):
    effect = encoder.EncoderScale()
    changes = UNLOADED

    def varying(self, context, place, shape, theta, factors):
        path = self.effect.path(context, place)[:, None]
        return off_path(context, place.index, theta[0] * path * factors)


class TwoMass(Family[encoder.TwoMass]):
    """Motor and link apart: an equation without θ."""

    whole, law_of = 0.2, "coupling"
    # Teeth rattle, resonances decay: not as computed.
    changes = ()

    def noisy(self, context):
        return True

    def prepare(self, context, place, shapes):
        self.effect.prepare(context, place, shapes)

    def band(self, shape):
        return shape[-1]

    def grid(self, context, place):
        return self.effect.grid(context, place)

    def first(self, context, place):
        return self.effect.coarse(context, place)

    def around(self, context, place, shape):
        free = super().around(context, place, shape)[:-2]
        return [*free, *((x, x) for x in shape[-2:])]

    def plain(self, shape):
        return not shape[-2]

    def varying(self, context, place, shape, theta, factors):
        delta = self.effect.path(context, place, shape)[:, None] * factors
        return off_path(context, place.index, delta)

    def physical(self, context, place, shape, theta):
        return True


class JointElasticity(TwoMass):
    effect = encoder.JointElasticity()
    # How a resonance decays is not in the equation.
    free_shape, form_error = 1, 0.3
    # Drives stiffen as they wind up (Tuttle and Seering 1996), which a dead zone draws as well.
    leeway = 0.01


class Backlash(TwoMass):
    effect = encoder.Backlash()
    simpler = ("encoder_offset", "joint_elasticity")
    free_shape, form_error, peaks = 2, 0.5, 2

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
