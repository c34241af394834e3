"""How the search for single effects looks for each: its grids, its preferences, and fits with more numbers at once.

What an effect *is* (equation, columns, numbers, edits, step law) is its class in `diagnosis.effects`; a family is a
plan of search for one. On the fast grid a family gives columns A(shape), so that the torque is e = A(shape) θ: linear
in θ, given a few nonlinear numbers, `shape`. A body's change of inertial parameters is nonlinear in another way,
e = −Y δπ(θ), and some equations have no θ at all (a delay).
"""

import abc
import itertools
from collections.abc import Iterable, Sequence
from typing import ClassVar, Generic, TypeVar

import numpy as np
from jaxtyping import Float

from jax_inertia.diagnosis.effects.base import Columns, Effect, Parameter, Place, Shape, slid
from jax_inertia.diagnosis.features.context import Context

E = TypeVar("E", bound=Effect)


class Family(abc.ABC, Generic[E]):
    """A plan of search for an effect."""

    effect: E

    @property
    def name(self) -> str:
        """Of the effect."""
        return self.effect.name

    @property
    def equation(self) -> str:
        """Of the effect."""
        return self.effect.equation

    @property
    def kind(self) -> str:
        """Of its place."""
        return self.effect.kind

    law_of: ClassVar[str] = ""
    """What it is one law of, where a place has but one: a joint has one dry friction, a torque is late by one law."""
    simpler: ClassVar[tuple[str, ...]] = ()
    """Families at the same place that this one contains: preferred where they fit nearly as well."""
    set_apart: ClassVar[float] = 30.0
    """Misfit, against the noise's, that they must leave more of for that not to be so."""
    leeway: ClassVar[float] = 5e-4
    """Share of what such a family explains that it may be behind: its own equation is not exact either."""
    freer: ClassVar["Family | None"] = None
    """The same cause with more numbers, tried only where this one leads."""
    smooth: ClassVar[bool] = False
    """Whether its torque is smooth in all nonlinear numbers (`refine`)."""
    peaks: ClassVar[int] = 1
    """How many peaks its grid may show in a band, of which the highest grid point need not be on the highest."""
    passing: ClassVar[bool] = False
    """Whether the effect lasts for a stretch of time only, found beforehand (`Context.windows`)."""
    form_error: float = 0.01
    """How far the equation may be from a real robot's, as a share (rms) of the effect: real teeth rattle, friction
    creeps. What is left within it is no further effect, and no reason to call the cause unknown."""
    slow: ClassVar[bool] = False
    """Whether only the motion's own band is evidence. Above it, a column of accelerations meets its own noise in y; and
    a controller that feeds encoder noise back correlates the torque it asks for with that noise."""
    alike: ClassVar[str] = ""
    """Families that name the same have the same columns at a place, and differ in their weights."""
    bends: ClassVar[tuple[str, ...]] = ()
    """Kinds of numbers at its place that the effect changes beyond its equation: they may be off as well."""
    changes: ClassVar[tuple[str, ...]] = ("time", "position", "load", "speed")
    """With what the size of another cause that resembles this one may change; its own does not (`constancy`)."""
    rigid: ClassVar[bool] = False
    """Whether bodies welded to each other show it alike."""
    whole: ClassVar[float | None] = None
    """For equations without θ, e = A(shape): how far from one a size let free may come out. None for all others."""
    vector: ClassVar[bool] = False
    """Whether θ is a vector in space: before any data no axis has more of it than another."""
    size: ClassVar[int | None] = None
    """Numbers in θ where the effect is not linear in it (`weights`); None where it is."""

    def places(self, context: Context) -> list[Place]:
        """Everywhere the effect can be in this log."""
        return self.effect.places(context)

    def grid(self, context: Context, place: Place) -> tuple[Sequence[float] | np.ndarray, ...]:
        """Grid of each nonlinear number; none where the effect is linear."""
        return ()

    def shapes(self, context: Context, place: Place) -> Iterable[Shape]:
        """Where the nonlinear numbers are tried first: everywhere on the grid."""
        return itertools.product(*self.grid(context, place))

    def first(self, context: Context, place: Place) -> Iterable[Shape]:
        """Those of `shapes` that every log is searched with; the others only where these lead."""
        return self.shapes(context, place)

    def count(self, context: Context, place: Place) -> int:
        """Among how many shapes the best is picked, details apart: what a search among many costs."""
        return sum(1 for _ in self.shapes(context, place))

    def around(self, context: Context, place: Place, shape: Shape) -> list[tuple[float, float]]:
        """Where each nonlinear number may move when a candidate is refined: up to the grid points beside it."""
        out = []
        for points, x in zip(self.grid(context, place), shape, strict=True):
            points = np.asarray(points, float)
            at = int(np.argmin(np.abs(points - x)))
            out.append((points[max(at - 1, 0)], points[min(at + 1, len(points) - 1)]))
        return out

    def as_another(self, context: Context, place: Place, shape: Shape) -> Iterable[Shape]:
        """Shapes to try besides, once another of what its place has but one of (`law_of`) is refined to a shape."""
        return ()

    def restarts(self, context: Context, place: Place, shape: Shape) -> Iterable[Shape]:
        """Shapes of which the best is refined as well, once it is refined to one: where a number has several optima."""
        return ()

    def band(self, shape: Shape) -> float:
        """Frequency [Hz] up to which a shape counts, for families that may be judged in one of several, else 0."""
        return 0.0

    def plain(self, shape: Shape) -> bool:
        """Whether a shape leaves where the model has what it has; others are taken where they do better by far."""
        return True

    free_shape: ClassVar[int | None] = None
    """How many of the nonlinear numbers count as found (the rest are detail, such as presliding); None: all."""

    def columns(self, context: Context, place: Place, shape: Shape) -> Columns:
        """A(shape)."""
        return self.effect.columns(context, place, shape)

    def physical(self, context: Context, place: Place, shape: Shape, theta: np.ndarray) -> bool:
        """Whether the numbers are ones that a real robot can have."""
        return self.effect.possible(context, place, theta)

    def parameters(
        self, context: Context, place: Place, shape: Shape, theta: np.ndarray
    ) -> dict[str, Parameter]:
        """What is reported, in the field's own terms; of a joint as of a hinge."""
        return self.effect.numbers(context, place, shape, theta)

    def reported(
        self, context: Context, place: Place, shape: Shape, theta: np.ndarray
    ) -> dict[str, Parameter]:
        """`parameters`, in newtons and metres of a joint that slides."""
        return slid(self.parameters(context, place, shape, theta), context, place)

    def weights(self, context: Context, place: Place, theta: np.ndarray) -> Float[np.ndarray, " k"]:
        """What the columns are multiplied by, e = A(shape) w(θ): θ itself, or δπ(θ) of a body whose columns are −Y."""
        return np.ones(1) if self.whole is not None else theta

    def sized(self, context: Context, place: Place, size: float) -> list[Float[np.ndarray, " p"]]:
        """θ of the effect at a size, of a vector along each axis; nothing where no one number is its size."""
        if self.size is not None:
            return []
        return [*(size * np.eye(3))] if self.vector else [np.array([size])]

    doubt: ClassVar[float] = 0.0
    """Score that it costs beyond its numbers, where it draws much that it is not."""

    def tightness(self, context: Context) -> Float[np.ndarray, " p"] | None:
        """One over the standard deviation of each number of θ before any data, about zero; None where none is known."""
        return None

    def varying(
        self,
        context: Context,
        place: Place,
        shape: Shape,
        theta: np.ndarray,
        factors: Float[np.ndarray, "T k"],
    ) -> Columns:
        """The effect's torque with its size times each of some functions of time."""
        columns = self.columns(context, place, shape)
        torque = columns.values @ self.weights(context, place, theta)
        return Columns(
            torque[..., None] * factors[(slice(None), *[None] * (torque.ndim - 1))], columns.row
        )

    def again(self, context: Context, place: Place, shape: Shape, theta: np.ndarray) -> Columns:
        """Of what happens in passing: columns for the same at its place at another time, as large as it may be."""
        raise NotImplementedError(f"{self.name} does not happen in passing")

    def noisy(self, context: Context) -> bool:
        """Whether the columns carry noise of the sensors that matters (`candidate`).

        On a floating base they do: it is what every wrench is turned by.
        """
        return context.robot.has_free_base

    def starts(
        self, context: Context, place: Place, free: np.ndarray | None
    ) -> list[Float[np.ndarray, " size"]]:
        """Where a search over θ begins where w(θ) is not linear; `free` is w fitted as if it were."""
        return [np.zeros(self.size or 0)]

    def prepare(self, context: Context, place: Place, shapes: list[Shape]) -> None:
        """Compute at once what the columns of many shapes need."""


class Plain(Family[Effect]):
    """An effect as it is, searched on its own grid: a user's own, or one that needs no plan."""

    def __init__(self, effect: Effect):
        self.effect = effect
        self.form_error = effect.form_error

    def shapes(self, context, place):
        return [tuple(float(x) for x in shape) for shape in self.effect.shapes(context, place)]

    def around(self, context, place, shape):
        steps = self.effect.steps(context, place, shape) or (0.0,) * len(shape)
        return [(x - step, x + step) for x, step in zip(shape, steps, strict=True)]
