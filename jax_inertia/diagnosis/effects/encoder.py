"""Effects between a joint and its encoder: the model was moved along a wrong path, q_logged = q + δ(t).

What the model needed was taken at q + δ, so the torque residual is its derivative along δ on every row that the joint
carries: y = ∂ID/∂q δ + ∂ID/∂q̇ δ̇ + ∂ID/∂q̈ δ̈.
"""

import abc
import itertools

import numpy as np
from jaxtyping import Float

from jax_inertia.diagnosis.effects import advice
from jax_inertia.diagnosis.effects.base import Columns, Edit, Effect, Parameter, Place, Shape
from jax_inertia.diagnosis.effects.couplings import backlash, elasticity
from jax_inertia.diagnosis.effects.spec_joint import joint_of, unit_of
from jax_inertia.diagnosis.features.context import Context
from jax_inertia.diagnosis.features.two_mass import Coupling
from jax_inertia.maths.finite_difference import derivative


def off_path(
    context: Context,
    row: int,
    delta: Float[np.ndarray, "T k"],
    rotor: tuple[float, float] = (0.0, 0.0),
) -> Columns:
    """What each error δ of a joint's logged path does to the torque residual.

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


class EncoderOffset(Effect):
    name, equation, secant = "encoder_offset", "q_logged = q + o", True
    source, advice = "a home position that was set by eye", advice.TORQUE_REVERSALS
    units, prior = {"offset": "rad"}, "0.03 rad, below 0.3 rad"
    mjcf = "joint ref, springref and range"

    def shapes(self, context, place):
        return [(0.0,)]

    def columns(self, context, place, shape):
        first = off_path(context, place.index, np.ones((len(context.time), 1))).values
        if shape[0]:
            # ID(q) − ID(q − o) to second order in o.
            first = first - 0.5 * shape[0] * context.bend(place.index)[..., None]
        return Columns(first)

    def scale(self, context, place, shape):
        return np.array([0.03])

    def possible(self, context, place, theta):
        return bool(abs(theta[0]) < 0.3)

    def numbers(self, context, place, shape, theta):
        return {"offset": Parameter(float(theta[0]), "rad")}

    def edit(self, spec, model, found):
        # The position that the model calls its reference moves, and so do spring and range.
        joint = joint_of(spec, found)
        offset = found.values["offset"] / unit_of(spec, joint)
        joint.ref += offset
        joint.springref += offset
        joint.range = np.asarray(joint.range) + offset
        return Edit(whole=True)


class EncoderScale(Effect):
    name, equation = "encoder_scale", "q_logged = (1 + κ) q"
    source, advice = "a wrong gear ratio, a linear encoder's pitch", advice.TORQUE_REVERSALS
    units, prior = {"scale": "1"}, "0.01, below 0.05"
    mjcf = "none: positions of corrected.xml are the real ones"

    def path(self, context: Context, place: Place) -> Float[np.ndarray, " T"]:
        """δ for θ = 1."""
        return context.joint_position[:, place.index]

    def columns(self, context, place, shape):
        return off_path(context, place.index, self.path(context, place)[:, None])

    def scale(self, context, place, shape):
        return np.array([0.01])

    def possible(self, context, place, theta):
        return bool(abs(theta[0]) < 0.05)

    def numbers(self, context, place, shape, theta):
        return {"scale": Parameter(float(theta[0] / (1 - theta[0])), "1")}

    def edit(self, spec, model, found):
        remark = (
            f"joint {found.name!r}: positions of corrected.xml are the real ones, "
            f"q = q_logged / {1 + found.values['scale']:.6g}"
        )
        return Edit(whole=False, remark=remark)


def carried(context, row: int) -> np.ndarray:
    """Torque that the joint's coupling carries: what its link needs, in the analysis band (T, 1)."""
    return context.below(context.prepared.bands.cutoff, context.link_torque[:, [row]])


ALL = 1e3
"""A frequency [Hz] that is above all others."""


MISSES = 0.2
"""How far a joint's motion apart is from what is computed of it, relative: teeth rattle at other moments."""


LEAST_PLAY, MOST_PLAY = 2e-4, 0.05
"""Of a precision gear, half a minute of arc: less is a soft joint; of a worn one, three degrees [rad]."""
LEAST_DAMPING, MOST_DAMPING = 0.005, 0.6
"""Damping ratios of springs and teeth."""


class TwoMass(Effect):
    """Motor and link apart, by the two-mass observer: the whole effect of one set of couplings, θ near one.

    What the coupling carries is the logged torque less what the motor takes for itself, so the joint's own friction and
    rotor inertia have to be known: columns are of the calibrated model.

    The last nonlinear number is the frequency [Hz] up to which it counts: the motion's band, or all. Teeth rattle at
    other moments than computed, resonances ring by the encoder's own noise: then the computed effect is worse than none
    above the motion's band. Which of the two is no number of the robot's, so what brings more decides. The last but one
    says whether the joint's own friction, as the model has it, is the motor's or the link's.
    """

    calibrated, misses, advice = True, MISSES, advice.TORQUE_REVERSALS
    law = "coupling"

    @abc.abstractmethod
    def coupling(self, shape: Shape) -> Coupling:
        """(K, ζ, b, o, h) of a shape, see `features.two_mass`."""

    @staticmethod
    def rubs_link(shape: Shape) -> bool:
        """Whether the joint's own friction, as the model has it, is the link's."""
        return bool(shape[-2])

    @abc.abstractmethod
    def grid(self, context: Context, place: Place) -> tuple[np.ndarray | tuple[float, ...], ...]:
        """Every value of each nonlinear number."""

    @abc.abstractmethod
    def coarse(self, context: Context, place: Place) -> itertools.product:
        """The shapes of that grid which a log is searched with first."""

    def prepare(self, context: Context, place: Place, shapes: list[Shape]) -> None:
        """Compute at once what the columns of many shapes need."""
        context.driven_link(place.index).separate([self.coupling(shape) for shape in shapes])

    def shapes(self, context, place):
        own = [tuple(float(x) for x in shape) for shape in self.coarse(context, place)]
        self.prepare(context, place, own)
        return own

    def path(self, context: Context, place: Place, shape: Shape) -> Float[np.ndarray, " T"]:
        """δ(t): how far the motor is ahead of the link."""
        return context.driven_link(place.index).separation(self.coupling(shape))

    def columns(self, context, place, shape):
        row, on_link, band = place.index, *shape[-2:]
        rotor = context.armature[row], (1.0 - on_link) * context.damping[row]
        every = off_path(context, row, self.path(context, place, shape)[:, None], rotor).values
        if on_link:
            rubbing = context.driven_link(row).rubbing(self.coupling(shape))
            every[:, row, 0] += context.prepared.dry[:, row] - rubbing
        return Columns(every if band == ALL else context.below(band, every))

    def scale(self, context, place, shape):
        return np.array([MISSES])


def sides(context: Context, place: Place) -> tuple[float, ...]:
    """Where the joint's own friction may be: zero on the motor, one on the link."""
    return (0.0, 1.0) if context.rubs(place.index) else (0.0,)


def stiffnesses(context: Context, place: Place, n: int) -> Float[np.ndarray, " n"]:
    """From 0.12 rad at the joint's peak torque, as a series-elastic drive has it, to 0.0003 rad [N m/rad]."""
    peak = context.link_peak[place.index] + 1e-6
    return peak / np.geomspace(0.12, 3e-4, n)


def _a_coupling(context: Context, place: Place, stiffness: float, ratio: float) -> bool:
    """Whether a spring or teeth may be as stiff and as damped."""
    softest, stiffest = stiffnesses(context, place, 2)
    return LEAST_DAMPING <= ratio <= MOST_DAMPING and bool(softest <= stiffness <= stiffest)


def on_link(shape: Shape) -> dict[str, Parameter]:
    """That the joint's own friction is the link's, where it is."""
    return {"friction_on_link": Parameter(1.0, "1")} if shape[-2] else {}


LEAST_PULL = 0.02
"""Share of a joint's peak torque: a constant torque that is less moves a link through its play as none does."""


def pulled(context: Context, place: Place) -> tuple[float, ...]:
    """Where a constant torque may be: zero on the motor, one on the link."""
    pull = abs(float(context.offset[place.index]))
    if pull < LEAST_PULL * context.link_peak[place.index]:
        return (1.0,) if pull else (0.0,)
    return (1.0, 0.0)


class JointElasticity(TwoMass):
    name, equation, form_error = "joint_elasticity", "q_motor = q + δ, K δ + D δ̇ transmitted", 0.1
    source = "Spong, J. Dyn. Syst. 109(4), 1987"
    units = {"stiffness": "N m/rad"}
    prior = "0.0003 to 0.12 rad at the joint's peak torque"
    mjcf = "a second hinge in line with the first, stiffness between"

    def grid(self, context, place):
        dampings, bands = (0.01, 0.03, 0.08, 0.25), (context.slow_band, ALL)
        return (stiffnesses(context, place, 31), dampings, sides(context, place), bands)

    def coarse(self, context, place):
        stiffness, damping, side, bands = self.grid(context, place)
        return itertools.product(stiffness[1::3], damping[1::2], side[:1], bands)

    def steps(self, context, place, shape):
        return (0.2 * shape[0], 0.4 * shape[1], 0.0, 0.0)

    def within(self, context, place, shape):
        return _a_coupling(context, place, *shape[:2])

    def coupling(self, shape):
        # A constant torque winds it up by a constant, whatever side it is of.
        return shape[0], shape[1], 0.0, 0.0, shape[2]

    def numbers(self, context, place, shape, theta):
        return {"stiffness": Parameter(shape[0], "N m/rad", 0.0), **on_link(shape)}

    def edit(self, spec, model, found):
        return Edit(*elasticity(spec, model, found))


class Backlash(TwoMass):
    name, equation, form_error = (
        "backlash",
        "q_motor = q + δ, nothing transmitted while |δ| < b/2",
        0.3,
    )
    source = "Nordin and Gutman, Automatica 38(10), 2002"
    units = {"dead_zone": "rad", "stiffness": "N m/rad"}
    prior = "b from 0.0002 to 0.05 rad, teeth as stiff as an elastic joint's spring"
    mjcf = "a second hinge in line with the first, whose range is the play"

    def grid(self, context, place):
        gaps, bands = np.geomspace(LEAST_PLAY, MOST_PLAY, 13), (context.slow_band, ALL)
        # Stiffnesses so close that between two of them the effect is hardly larger or smaller.
        stiffness = stiffnesses(context, place, 19)
        of_link = pulled(context, place), sides(context, place)
        return (gaps, stiffness, (0.15,), *of_link, bands)

    def coarse(self, context, place):
        gap, stiffness, *others = self.grid(context, place)
        return itertools.product(gap[::2], stiffness[2::6], *others)

    def form_error_at(self, context, place, shape):
        # What teeth do in their play is known worse than what their spring does: each has its share of the path.
        play = 0.5 * shape[0]
        wound = float(np.std(context.link_torque[:, place.index])) / shape[1]
        loose = play**2 / (play**2 + wound**2)
        spring = JointElasticity.form_error
        return float(np.sqrt(spring**2 + loose * (self.form_error**2 - spring**2)))

    def steps(self, context, place, shape):
        return (0.3 * shape[0], 0.3 * shape[1], 0.4 * shape[2], 0.0, 0.0, 0.0)

    def within(self, context, place, shape):
        return LEAST_PLAY <= shape[0] <= MOST_PLAY and _a_coupling(context, place, *shape[1:3])

    def coupling(self, shape):
        return shape[1], shape[2], shape[0], shape[3], shape[4]

    def numbers(self, context, place, shape, theta):
        return {
            "dead_zone": Parameter(shape[0], "rad", 0.0),
            "stiffness": Parameter(shape[1], "N m/rad", 0.0),
            **on_link(shape),
            **({"offset_on_link": Parameter(1.0, "1")} if shape[3] else {}),
        }

    def edit(self, spec, model, found):
        return Edit(*backlash(spec, model, found))
