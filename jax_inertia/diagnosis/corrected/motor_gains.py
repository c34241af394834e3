"""What each joint's motor gives of its logged torque: the whole gain, and the joint's numbers after it.

With τ the logged torque, g a motor's gain, N what the nominal model needs and F what else a joint takes,

    g τ = N + F,  so  y = N − τ = (1 − 1/g) N − F/g:

the rows show F/g, torques as they are logged, and what is at the joint is g times that.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jax_inertia.diagnosis.effects.actuator import TorqueGain
from jax_inertia.diagnosis.effects.base import Interval, Place
from jax_inertia.diagnosis.hypothesis import Hypothesis
from jax_inertia.diagnosis.search.evidence import Posterior
from jax_inertia.diagnosis.search.selection import Selection
from jax_inertia.diagnosis.settings import Settings


class Gain(NamedTuple):
    """A joint's gain at the posterior mean, that of all motors and its own together."""

    value: float
    """Torque at the joint over the logged one."""
    slope: Float[np.ndarray, " p"]
    """Its change with each number of the posterior, in units of their scales."""


def gain_at(selection: Selection, name: str, row: int) -> Gain | None:
    """The gain of a joint; None where none was asked for: a torque that was measured, and no gain found."""
    now = selection.posterior
    of_theta = np.zeros(len(now.mean))
    effect = None
    for h, part in _gains(now):
        if h.place.kind == "global" or h.place.index == row:
            of_theta[part] += h.scale
            effect = h.effect
    if effect is None:
        return None
    place, theta = Place("joint", name, row), float(of_theta @ now.mean)

    def value(x: float) -> float:
        return effect.numbers(selection.residual.context, place, (), np.array([x]))["gain"].value

    step = 1e-4
    return Gain(value(theta), (value(theta + step) - value(theta - step)) / (2 * step) * of_theta)


def after_gain(
    selection: Selection, h, numbers: Float[np.ndarray, "k p"]
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, "k p"]]:
    """(mean, slopes) of a hypothesis' numbers at the joint; `numbers`: those of the rows, linear in the posterior's."""
    mean = numbers @ selection.posterior.mean
    if selection.residual.loaded:
        # Columns of a gain are then of all that its joint needs, and every other number is at the joint.
        return mean, numbers
    if h.place.kind != "joint" or h.effect.before_gain:
        return mean, numbers
    support = selection.residual.prepared.support
    if support is not None and support.bears(h.place.index):
        return mean, numbers
    gain = gain_at(selection, h.place.name, h.place.index)
    if gain is None:
        return mean, numbers
    return gain.value * mean, gain.value * numbers + np.outer(mean, gain.slope)


def motor_gains(selection: Selection) -> dict[str, Interval]:
    """Every joint's whole gain with its 95 % interval, of joints that have one."""
    covariance = selection.posterior.covariance + selection.spread
    out = {}
    for name, row in selection.residual.context.joint_dofs.items():
        gain = gain_at(selection, name, row)
        if gain is not None:
            half = 1.96 * float(np.sqrt(max(gain.slope @ covariance @ gain.slope, 0.0)))
            low = max(gain.value - half, 0.0)
            out[name] = Interval(gain.value, low, gain.value + half, "1", factor=True)
    return out


def _gains(now: Posterior) -> Iterator[tuple]:
    for h, part in zip(now.chosen, now.slices, strict=True):
        if isinstance(h.effect, TorqueGain):
            yield h, part


def distinct(now: Posterior, h: Hypothesis, settings: Settings) -> bool:
    """Whether a gain is another than the one that the log's torques were computed with."""
    mean, covariance = now.of(h)
    return bool(abs(mean[0]) > settings.distinct * np.sqrt(covariance[0, 0]))
