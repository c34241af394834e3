"""The one interface of an effect: its equation, where it can be, its columns, its prior, and its numbers in words.

To add an effect, write one class in one file of this folder and list it in `registry`: nothing else has to know.
"""

import abc
from collections.abc import Iterable
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from jax_inertia.gap.context import Context
from jax_inertia.gap.families.base import Columns, Parameter, Place

Shape = tuple[float, ...]


class Effect(abc.ABC):
    """A torque e = A(shape) θ on the rows of the equations of motion, linear in θ given nonlinear numbers, `shape`.

    The missing torque is y = M q̈ + h − τ: what acts on the joints besides the logged torque, with its sign.
    """

    name: ClassVar[str]
    equation: ClassVar[str]
    kind: ClassVar[str] = "joint"
    """Of its place: 'joint', 'body', 'contact' or 'global'."""
    ordinary: ClassVar[bool] = False
    """Whether every robot has it."""
    refines: ClassVar[bool] = False
    """Whether it is another form of an ordinary effect."""
    named: ClassVar[bool] = True
    """False for a generic alternative, which competes and is not reported as a cause."""
    marginal: ClassVar[bool] = False
    """Whether it is a tolerance: in every hypothesis, integrated out, never asked whether it is there."""
    form_error: ClassVar[float] = 0.01
    """Relative error of its equation on real robots, one standard deviation."""
    secant: ClassVar[bool] = False
    """Whether the shape is the value of θ about which the columns are the secant: e(θ) = A(θ) θ exactly."""

    calibrated: ClassVar[bool] = False
    """Whether its columns need each joint's friction and rotor inertia as found (`Residual.calibrated`)."""
    law: ClassVar[str] = ""
    """What it is one law of, where a place has but one: a torque is late by one law."""

    def places(self, context: Context) -> list[Place]:
        """Everywhere it can be."""
        if self.kind == "joint":
            return [Place("joint", name, row) for name, row in context.joint_dofs.items()]
        if self.kind == "body":
            return [Place("body", n, i) for i, n in enumerate(context.robot.body_names)]
        if self.kind == "contact":
            return [Place("contact", n, i) for i, n in enumerate(context.contacts)]
        return [Place("global", "global", -1)]

    def shapes(self, context: Context, place: Place) -> Iterable[Shape]:
        """Grid of the nonlinear numbers; one empty shape where there are none."""
        return [()]

    def steps(self, context: Context, place: Place, shape: Shape) -> Shape:
        """First step of a search between the grid's points, for each nonlinear number; 0 where it stays."""
        return ()

    @abc.abstractmethod
    def columns(self, context: Context, place: Place, shape: Shape) -> Columns:
        """A(shape) on the fast grid [N m per unit of θ]."""

    @abc.abstractmethod
    def scale(self, context: Context, place: Place, shape: Shape) -> Float[np.ndarray, " k"]:
        """Prior standard deviation of θ: the size that the effect has on real robots, in θ's unit."""

    @abc.abstractmethod
    def numbers(
        self, context: Context, place: Place, shape: Shape, theta: Float[np.ndarray, " k"]
    ) -> dict[str, Parameter]:
        """What is reported, in SI units."""

    def lower(self, context: Context, place: Place) -> float:
        """Least value of the first number of θ that a robot can have."""
        return -np.inf

    def possible(self, context: Context, place: Place, theta: Float[np.ndarray, " k"]) -> bool:
        """Whether a robot can have these numbers."""
        return bool(theta[0] >= self.lower(context, place) - 1e-12)


def peak_of(context: Context, row: int) -> float:
    """Peak of a row's torque, logged or needed: the 99.5th percentile of the larger [N m]."""
    both = np.maximum(np.abs(context.tau[:, row]), np.abs(context.inverse[:, row]))
    return max(float(np.percentile(both, 99.5)), 1e-9)


def of_row(values: Float[np.ndarray, "T *k"], place: Place) -> Columns:
    """Columns on a joint's own row."""
    return Columns(values.reshape(len(values), -1), place.index)
