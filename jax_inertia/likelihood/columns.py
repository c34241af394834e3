"""Torque columns of numbers along a motion: effects of joints and bodies from the one library, drives by their law."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jax_inertia.diagnosis.effects import dry_friction, environment, inertial, joint
from jax_inertia.diagnosis.effects.base import Effect, Place
from jax_inertia.diagnosis.features.context import Context
from jax_inertia.likelihood.drive import FAMILIES as OF_DRIVE
from jax_inertia.likelihood.drive import FINITE
from jax_inertia.likelihood.motion import Along
from jax_inertia.logs.log import AnyArray
from jax_inertia.maths.argument_checks import known

ALL = -1
"""In place of a joint: all of them."""


class Number(NamedTuple):
    """One number that a model may be off by; 0 where it is not."""

    family: str
    joint: int = ALL
    """Row among the log's joints, or `ALL`."""
    body: str = ""
    sd: float = 1.0
    """Of the prior."""
    low: float = -np.inf
    high: float = np.inf
    odds: float = 0.0
    """Logarithm of the prior odds that a robot has it [nats]; of an effect of several numbers, of its first."""
    effect: str = ""
    """The effect that it is a part of, where this has several numbers."""
    always: bool = False
    """Whether it is in every hypothesis: a tolerance of every model."""
    shape: float | None = None
    """Of an effect that the torque is not linear in, where it is compared with none: a size, a speed [rad/s], or which
    of several starts. Effects that differ by it alone stand in for each other."""
    size: float | None = None
    """Where it is compared with none, if `shape` is not that."""
    beside: float = 0.0
    """Of a number that does nothing alone, the other number of its effect where it is compared with none."""

    @property
    def compared(self) -> float:
        """At which size it is compared with none."""
        return float(self.shape or 0.0) if self.size is None else self.size

    @property
    def place(self) -> tuple[str, int, str]:
        """Which effect it is of, and where."""
        return (self.effect or self.family, self.joint, self.body)

    @property
    def key(self) -> tuple[str, int, str, float | None]:
        """What numbers of one effect share."""
        return (*self.place, self.shape)


class Seen(NamedTuple):
    """All that columns are made of, at numbers of the drive."""

    along: Along | Context
    drive: Mapping[str, AnyArray]
    """Derivatives of the drive's torque (K, n) by its numbers, family by family."""
    stiffness: Float[AnyArray, "K n n"]
    """∂needed/∂q, of the model."""
    rows: tuple[int, ...]
    """Dof of each of the log's joints."""
    finite: Mapping[Number, AnyArray] = {}
    """Torque (K, n) of one of each number of the drive that has a shape."""


def of_effect(effect: Effect, x: Seen, place: Place, shape: tuple[float, ...]) -> AnyArray:
    """Columns of an effect of the library on the rows of the log's joints (K, n, k)."""
    found = effect.columns(x.along, place, shape)  # pyright: ignore[reportArgumentType]
    rows = np.array(x.rows)
    if found.row is None:
        return found.values[:, rows]
    return found.values[:, None] * (rows == found.row)[None, :, None]


_ON_AXIS: Mapping[str, tuple[Effect, tuple[float, ...], int]] = {
    "viscous_friction": (joint.ViscousFriction(), (), 0),
    "armature": (joint.Armature(), (), 0),
    "coulomb_friction": (dry_friction.CoulombFriction(), (0.0, dry_friction.BENT), 0),
    "quadratic_viscous": (joint.QuadraticViscous(), (), 0),
    "spring_torque": (joint.JointSpring(), (), 0),
    "joint_spring": (joint.JointSpring(), (), 1),
}
"""Family: effect, its shape, and which of its columns."""


def _on_axis(number: Number, x: Seen) -> AnyArray:
    effect, shape, k = _ON_AXIS[number.family]
    place = Place("joint", "", x.rows[number.joint])
    return of_effect(effect, x, place, shape)[:, :, k]


def _of_drive(number: Number, x: Seen) -> AnyArray:
    if number.shape is not None:
        return x.finite[number]
    every = x.drive[number.family]
    return every if number.joint == ALL else every * (np.arange(len(x.rows)) == number.joint)


FRICTION_FORMS: Mapping[str, Callable[[AnyArray, AnyArray, AnyArray, float], AnyArray]] = {
    "load_friction": lambda q, v, tau, _: np.abs(tau),
    "stribeck_friction": lambda q, v, tau, speed: np.exp(-((v / speed) ** 2)),
    "position_friction": lambda q, v, tau, middle: q - middle,
}
"""Family: what one of it adds to the level of a joint's dry friction, of position, velocity, the drive's torque and the
number's shape."""


def _of_level(number: Number, x: Seen) -> AnyArray:
    assert isinstance(x.along, Context), "forms of friction are sought in single logs"
    rows, of = np.array(x.rows), x.along
    seen = of.joint_position[:, rows], of.v[:, rows], of.tau[:, rows]
    level = FRICTION_FORMS[number.family](*seen, number.shape or 0.0)
    mine = np.isin(np.arange(len(rows)), number.joint) | (number.joint == ALL)
    return -level * of.side[:, rows] * mine


def _offset(number: Number, x: Seen) -> AnyArray:
    # The model at q − o needs less torque by ∂needed/∂q o.
    return x.stiffness[:, :, number.joint]


_CHANGES: Mapping[str, Callable[[Any], AnyArray]] = {
    "mass_share": lambda pi: pi,
    "inertia_share": lambda pi: inertial.inertia_change(pi, 1.0),
    "payload": lambda pi: pi / pi[0],
    **{
        f"{name}_{axis}": lambda pi, k=k: _shifted(pi, k)
        for name in ("centre", "com_shift")
        for k, axis in enumerate("xyz")
    },
    **{f"moment_{axis}": lambda pi, k=k: _moment(pi, k) for k, axis in enumerate("xyz")},
}
"""Family: δπ of a body by one of its number, at none of it."""


def _shifted(pi: np.ndarray, k: int) -> np.ndarray:
    small = 1e-6
    return inertial.shift_change(pi, small * np.eye(3)[k]) / small


def _moment(pi: np.ndarray, k: int) -> np.ndarray:
    """Of a load's first moment about the body's centre of mass, at no mass [kg m]."""
    c, axis = pi[1:4] / pi[0], np.eye(3)[k]
    turn = 2.0 * (c @ axis) * np.eye(3) - np.outer(c, axis) - np.outer(axis, c)
    return np.concatenate([[0.0], axis, turn[np.triu_indices(3)]])


def _of_body(number: Number, x: Seen) -> AnyArray:
    robot = x.along.robot
    index = robot.body_index(number.body)
    pi = known(robot.pi)
    change = _CHANGES[number.family](robot.pi[index] if pi is None else pi[index])
    return -(x.along.regressor[:, np.array(x.rows), index] @ change)


def _tilt(number: Number, x: Seen) -> AnyArray:
    place = Place("global", "global", -1)
    every = of_effect(environment.GravityTilt(), x, place, (0.0, 0.0))
    return every[:, :, "xy".index(number.family[-1])]


def _force(number: Number, x: Seen) -> AnyArray:
    assert isinstance(x.along, Context), "forces are sought in single logs"
    index = x.along.robot.body_index(number.body)
    return x.along.force_rows[:, index, :, "xyz".index(number.family[-1])][:, np.array(x.rows)]


_LAWS: Mapping[str, Callable[[Number, Seen], AnyArray]] = {
    **dict.fromkeys(_ON_AXIS, _on_axis),
    **dict.fromkeys((*OF_DRIVE, *FINITE), _of_drive),
    **dict.fromkeys(FRICTION_FORMS, _of_level),
    "encoder_offset": _offset,
    **dict.fromkeys(_CHANGES, _of_body),
    **dict.fromkeys(("tilt_x", "tilt_y"), _tilt),
    **dict.fromkeys(("force_x", "force_y", "force_z"), _force),
}
FAMILIES = frozenset(_LAWS)
"""Families that have columns."""


def columns(numbers: Sequence[Number], x: Seen) -> Float[AnyArray, "K n c"]:
    """Torque of one of each number [N m], on the log's joints: NumPy's of a log, traced in a batch."""
    every = [_LAWS[number.family](number, x) for number in numbers]
    known = all(isinstance(c, np.ndarray) for c in every)
    return (np if known else jnp).stack(every, axis=-1)
