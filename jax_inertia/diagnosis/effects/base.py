"""The one interface of an effect: equation, source, prior, columns, numbers, MJCF edit, step law, advice on motion.

To add an effect, write one class in one file of this folder and list it in `registry`: nothing else has to know.
"""

import abc
import dataclasses
import functools
from collections.abc import Iterable, Mapping
from types import ModuleType
from typing import Any, ClassVar, NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float, Int

from jax_inertia.diagnosis.effects.advice import WIDE, Advice
from jax_inertia.diagnosis.effects.identified import Identified
from jax_inertia.diagnosis.features.context import Context
from jax_inertia.logs.log import AnyArray
from jax_inertia.model.mujoco_types import MjModel, MjSpec

Shape = tuple[float, ...]


@dataclasses.dataclass(frozen=True)
class Place:
    """Where an effect acts: kind 'joint', 'body', 'contact' or 'global', and the model's own name."""

    kind: str
    name: str
    index: int
    """Row of a joint, index of a body or contact; −1 for global."""
    other: str = ""
    """The other joint, of an effect between two."""


@dataclasses.dataclass(frozen=True)
class Columns:
    """Columns on the fast grid: of one row (T, k), or of all rows (T, nv, k)."""

    values: Any
    """NumPy's array, or JAX's where the context's are."""
    row: int | None = None


@dataclasses.dataclass(frozen=True)
class Parameter:
    """One reported number."""

    value: float
    unit: str
    least: float = -np.inf
    """Less it cannot be, so its interval does not reach below."""
    factor: bool = False
    """Whether it multiplies a number of the model, so that one is none of it."""


@dataclasses.dataclass(frozen=True)
class Interval:
    """A number with its 95 % interval and unit."""

    value: float
    low: float
    high: float
    unit: str
    factor: bool = False
    """Whether it multiplies a number of the model."""
    added_to: float = 0.0
    """The model's own number of it, which this one is added to."""

    @property
    def whole(self) -> "Interval":
        """With the model's own number in it, none of which is below zero.

        >>> Interval(-0.25, -0.75, -0.125, "kg m²", added_to=0.5).whole
        Interval(value=0.25, low=0.0, high=0.375, unit='kg m²', factor=False, added_to=0.0)
        """
        if not self.added_to:
            return self
        value, low, high = (x + self.added_to for x in (self.value, self.low, self.high))
        return Interval(value, max(low, 0.0), high, self.unit, self.factor)

    @property
    def of_model(self) -> str:
        """The model's own number, for a reader of `whole`."""
        return f" (model: {self.added_to:.3g})" if self.added_to else ""


OF_SLIDE = {
    "N m": "N",
    "N m/rad": "N/m",
    "N m s/rad": "N s/m",
    "N m s²/rad²": "N s²/m²",
    "kg m²": "kg",
    "rad": "m",
    "rad/s": "m/s",
    "1/rad": "1/m",
}
"""Units of a hinge's numbers, and of a slide's."""


class Term(NamedTuple):
    """One term of a joint's friction law, see `friction_curve`; its torque is its number times a form of the motion."""

    form: str
    """'bristle', 'slow', 'load', 'by_direction', 'viscous', 'quadratic', 'slope_by_direction' or 'drift'."""
    scale: float = 0.0
    """Displacement of a bristle [rad], speed of 'slow' [rad/s], time constant of 'drift' [s]."""
    kind: float = 0.0
    """1 of a bristle that slips as a straight spring does, of a load that is the motor's; exponent of 'slow'."""


Terms = Mapping[Term, float]
"""Terms of a friction law, and how much of each there is for one unit of a number."""


class Edit(NamedTuple):
    """What attributes of a MuJoCo spec hold of an effect."""

    whole: bool
    """Whether they say it all, for torques given by `qfrc_applied` too."""
    remark: str = ""


class Moment(NamedTuple):
    """What a step law sees: positions, speeds and torques asked for at each row (nv,), time [s], and the bodies."""

    q: Any
    v: Any
    u: Any
    t: Any
    turn: Any
    """Of each body, its axes in the world (nb, 3, 3)."""
    velocity: Any
    """Of each body's centre of mass, in the world (nb, 3)."""


class Applied(NamedTuple):
    """What effects make of a moment."""

    torque: Any
    """On each row (nv,), what was asked for included [N m]."""
    friction: Any
    """Level of each row's dry friction (nv,) [N m]."""
    wrench: Any
    """World force and moment on each body's centre of mass (nb, 6)."""


@dataclasses.dataclass(frozen=True)
class Bound:
    """An identified effect's numbers on a model's rows and bodies."""

    values: Mapping[str, float]
    index: int
    """Row of its joint, index of its body; −1 for every joint."""
    other: int
    """Row of the other joint, of an effect between two."""
    driven: np.ndarray
    """Which rows are a hinge's or a slide's (nv,)."""
    centres: np.ndarray
    """Of mass, of each body in its own frame (nb, 3)."""
    period: float
    """Of a step [s]."""

    @functools.cached_property
    def rows(self) -> np.ndarray:
        """Which rows it acts on, of a joint's or a global effect (nv,)."""
        return self.driven if self.index < 0 else np.arange(len(self.driven)) == self.index

    @functools.cached_property
    def body(self) -> np.ndarray:
        """Which body it acts on, as a column (nb, 1)."""
        return (np.arange(len(self.centres)) == self.index)[:, None]


class Effect(abc.ABC):
    """A torque e = A(shape) θ on the rows of the equations of motion, linear in θ given nonlinear numbers, `shape`.

    The torque residual is y = M q̈ + h − τ: what acts on the joints besides the logged torque, with its sign. Classes
    are abstract (a name that begins with _, or `Effect`) or final.
    """

    name: ClassVar[str]
    equation: ClassVar[str]
    source: ClassVar[str] = ""
    """Of the equation."""
    units: ClassVar[Mapping[str, str]] = {}
    """Of the numbers that are reported, by name; a hinge's."""
    prior: ClassVar[str] = ""
    """Size on real robots, in words: what `scale` computes, and where it comes from."""
    mjcf: ClassVar[str] = ""
    """Its form in MJCF, in words."""
    advice: ClassVar[Advice] = WIDE
    """The motion that shows it."""

    kind: ClassVar[str] = "joint"
    """Of its place: 'joint', 'body', 'contact' or 'global'."""
    ordinary: ClassVar[bool] = False
    """Whether every robot has it."""
    constant: ClassVar[bool] = False
    """Whether its torque is the same at all times."""
    level: ClassVar[str] = ""
    """The ordinary effect that it is one law with: its level, its slope, its offset."""
    level_in: ClassVar[tuple[str, ...]] = ()
    """Those of its own numbers that the ordinary one is a part of."""
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
    misses: ClassVar[float] = 0.0
    """Of what is all there or not at all, its size in the nonlinear numbers: how far it is from its equation, relative.
    θ is one, give or take this. Zero where θ is the size."""
    calibrated: ClassVar[bool] = False
    """Whether its columns need each joint's friction and rotor inertia as found (`Residual.calibrated`)."""
    loads: ClassVar[bool] = False
    """Whether it changes what the links need, so that loads of gears and motors change with it."""
    by_load: ClassVar[bool] = False
    """Whether its columns are of those loads: handed over, they are of the robot with what was found."""
    before_gain: ClassVar[bool] = False
    """Whether it is of the logged torque itself, so that its numbers do not change with the motor's gain."""
    holds: ClassVar[str] = ""
    """Another effect of the same place whose torque its own includes: the two are never chosen together."""
    law: ClassVar[str] = ""
    """What it is one law of, where a place has but one: a torque is late by one law."""

    # --- identification

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

    def at_value(self, shape: Shape, theta: Float[np.ndarray, " k"]) -> Shape:
        """The nonlinear numbers where θ is this, of those that are θ's own: all of a secant's."""
        return tuple(float(x) for x in theta) if self.secant else shape

    def form_error_at(self, context: Context, place: Place, shape: Shape) -> float:
        """`form_error` where that is known better of some nonlinear numbers."""
        return self.form_error

    def within(self, context: Context, place: Place, shape: Shape) -> bool:
        """Whether a search between the grid's points may go there."""
        return True

    many: ClassVar[bool] = False
    """Whether a place may have it more than once, where `apart` says so."""

    def apart(self, context: Context, place: Place, one: Shape, other: Shape) -> bool:
        """Whether a log tells one from another at the same place."""
        return True

    @abc.abstractmethod
    def columns(self, context: Context, place: Place, shape: Shape) -> Columns:
        """A(shape) on the fast grid [N m per unit of θ]."""

    def of_level(self, level: "Effect", context: Context, place: Place, shape: Shape) -> Columns:
        """Columns of the ordinary effect that it is one law with (`level`), where both are fitted at once."""
        return level.columns(context, place, shape)

    @abc.abstractmethod
    def scale(self, context: Context, place: Place, shape: Shape) -> Float[np.ndarray, " k"]:
        """Prior standard deviation of θ: the size that the effect has on real robots, in θ's unit."""

    def mean(self, context: Context, place: Place, shape: Shape) -> Float[np.ndarray, " k"]:
        """Prior mean of θ, in its unit: zero, or one of what is all there or not at all."""
        return np.full(len(self.scale(context, place, shape)), 1.0 if self.misses else 0.0)

    def kinds(self, count: int) -> Int[np.ndarray, " k"]:
        """Of each of `count` numbers, of what kind of which the log says how large they are; −1 where it does not."""
        return np.full(count, -1)

    def of_links(self, theta: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
        """The numbers of θ that change what the links need."""
        return theta

    of_log: ClassVar[bool] = False
    """Whether its numbers are one log's, so that another log has its own."""

    def size_prior(self, shape: Shape) -> tuple[float, float]:
        """For how many measured numbers the stated size of a tolerance counts, and how many times it that may be."""
        return np.inf, 1.0

    @abc.abstractmethod
    def numbers(
        self, context: Context, place: Place, shape: Shape, theta: Float[np.ndarray, " k"]
    ) -> dict[str, Parameter]:
        """What is reported, in SI units; of a joint as of a hinge."""

    def reported(
        self, context: Context, place: Place, shape: Shape, theta: Float[np.ndarray, " k"]
    ) -> dict[str, Parameter]:
        """`numbers`, in newtons and metres of a joint that slides."""
        return slid(self.numbers(context, place, shape, theta), context, place)

    def room(self, context: Context, place: Place, shape: Shape) -> Float[np.ndarray, " T"] | None:
        """Where a row's logged torque does not reach the joint, over how much it may lie [N m]; 0 where it does.

        There the effect says nothing of that torque: it may be anything. None of effects that leave nothing open.
        """
        return None

    def friction_terms(self, context: Context, place: Place, shape: Shape) -> tuple[Terms, ...]:
        """Of each number of θ, the terms of the joint's friction law that it adds to; none of what is no friction."""
        return ()

    def lower(self, context: Context, place: Place) -> float:
        """Least value of the first number of θ that a robot can have."""
        return -np.inf

    def least(
        self, context: Context, place: Place, shape: Shape, count: int
    ) -> Float[np.ndarray, " k"]:
        """Least value of each of `count` numbers of θ that can be handed over, those of its level first.

        Beside `lower` of the first of its own and of its level.
        """
        return np.full(count, -np.inf)

    def possible(self, context: Context, place: Place, theta: Float[np.ndarray, " k"]) -> bool:
        """Whether a robot can have these numbers: of what is there whole or not at all, θ one as far as it is known."""
        if self.misses:
            return bool(abs(theta[0] - 1.0) <= 3.0 * self.misses)
        return bool(theta[0] >= self.lower(context, place) - 1e-12)

    def possible_with(
        self, context: Context, place: Place, level: float, theta: Float[np.ndarray, " k"]
    ) -> bool:
        """Whether a robot can have these numbers together with the ordinary number of the same law."""
        return self.possible(context, place, theta)

    # --- simulation: attributes of a model where MJCF has them (`edit`), and before each step what they cannot hold

    takes_over: ClassVar[bool] = False
    """Whether its edit moves a joint's own numbers elsewhere: then after those of all others."""
    unread_by_mjx: ClassVar[bool] = False
    """Whether MJX does not read the attribute that holds it whole in MuJoCo C: there the step law does it."""
    rubs: ClassVar[bool] = False
    """Whether `step` changes the level of dry friction."""

    def edit(self, spec: MjSpec, model: MjModel, found: Identified) -> Edit | None:
        """Change a spec, of which `model` is the compiled state, as far as attributes hold it; None where none does."""
        return None

    def torque(self, xp: ModuleType, now: Moment, at: Bound) -> Any:
        """Torque that it adds to each row it acts on, by its equation [N m]; `xp` is numpy or jax.numpy."""
        raise NotImplementedError(f"{self.name} has no step law")

    def step(self, xp: ModuleType, now: Moment, at: Bound, applied: Applied) -> Applied:
        """What it makes of a moment, given the effects before it: its `torque` on its rows, if it is no more."""
        return applied._replace(torque=applied.torque + at.rows * self.torque(xp, now, at))

    def memory(self, xp: ModuleType, at: Bound, u: Any) -> Any:
        """State of an effect that makes torques late, as if u had always been asked for; None of all others."""
        return None

    def late(self, xp: ModuleType, at: Bound, state: Any, u: Any) -> tuple[Any, Any]:
        """(state one period on, torque as it arrives), of an effect with a memory."""
        return state, u

    @property
    def by_step(self) -> bool:
        """Whether something is left to do before each step once a model is edited (`torque`, `step`, `late`)."""
        own = type(self)
        return any(
            getattr(own, name) is not getattr(Effect, name) for name in ("torque", "step", "late")
        )

    @property
    def is_friction(self) -> bool:
        """Whether it is a term of a joint's friction law."""
        return type(self).friction_terms is not Effect.friction_terms

    @property
    def acts(self) -> bool:
        """Whether it adds to what acts on rows and bodies, beyond making torques late."""
        own = type(self)
        return own.torque is not Effect.torque or own.step is not Effect.step


def slid(numbers: dict[str, Parameter], context: Context, place: Place) -> dict[str, Parameter]:
    """Numbers in newtons and metres at a joint that slides; a phase is an angle there too."""
    if place.kind != "joint" or context.robot.topology.dof_rotates[place.index]:
        return numbers
    return {
        name: p
        if name.endswith("phase")
        else dataclasses.replace(p, unit=OF_SLIDE.get(p.unit, p.unit))
        for name, p in numbers.items()
    }


def row_of(model: MjModel, kind: str, name: str) -> int:
    """Row of a joint, index of a body, −1 for all; ValueError for a name that the model does not have."""
    if kind not in ("joint", "body"):
        return -1
    object_kind = mujoco.mjtObj.mjOBJ_JOINT if kind == "joint" else mujoco.mjtObj.mjOBJ_BODY
    found = mujoco.mj_name2id(model, object_kind, name)
    if found < 0:
        raise ValueError(f"the model has no {kind} {name!r}")
    return int(model.jnt_dofadr[found]) if kind == "joint" else found


def peak_of(context: Context, row: int) -> float:
    """Peak of a row's torque, logged or needed: the 99.5th percentile of the larger [N m]."""
    both = np.maximum(np.abs(context.tau[:, row]), np.abs(context.inverse[:, row]))
    return max(float(np.percentile(both, 99.5)), 1e-9)


def of_row(values: Float[AnyArray, "T *k"], place: Place) -> Columns:
    """Columns on a joint's own row."""
    return Columns(values.reshape(len(values), -1), place.index)
