"""Units that positions and velocities are logged in instead of rad and m, and how to convert them."""

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from jax_inertia.model.robot import HINGE


class Unit(NamedTuple):
    """A unit, and how many SI units one of it is: rad or m, rad/s or m/s."""

    name: str
    size: float


DEGREES = Unit("degrees", np.pi / 180.0)
POSITIONS = {
    True: (DEGREES, Unit("turns", 2.0 * np.pi), Unit("mrad", 1e-3)),
    False: (Unit("mm", 1e-3), Unit("cm", 1e-2)),
}
"""Units of positions other than SI: of hinges (True), of slides (False)."""
RATES = {
    True: (
        Unit("degrees per second", np.pi / 180.0),
        Unit("turns a minute (rpm)", np.pi / 30.0),
        Unit("turns per second", 2.0 * np.pi),
        Unit("mrad/s", 1e-3),
    ),
    False: (Unit("mm/s", 1e-3), Unit("cm/s", 1e-2)),
}
"""The same of velocities."""
SI = Unit("", 1.0)
# A velocity that is filtered is that much smaller; ratios of units that are closest, 60 and 360/2π, differ by 4.6 %.
_FILTERED = 0.1


def of_ratio(ratio: float, hinge: bool) -> tuple[Unit, Unit] | None:
    """Units of position and velocity (`SI` where one is SI), by the ratio of a logged velocity to dqpos/dt as logged.

    The pair whose ratio is nearest, positions in SI first; None where that is SI for both, or none is near.

    >>> import numpy as np
    >>> from jax_inertia.preflight.units import of_ratio
    >>> of_ratio(30 / np.pi, True)[1].name, of_ratio(2 * np.pi, True)[0].name
    ('turns a minute (rpm)', 'turns')
    """
    pairs = list(itertools.product((SI, *POSITIONS[hinge]), (SI, *RATES[hinge])))
    off = [round(abs(np.log(ratio * rate.size / position.size)), 9) for position, rate in pairs]
    nearest = int(np.argmin(off))
    if off[nearest] > np.log(1.0 + _FILTERED) or pairs[nearest] == (SI, SI):
        return None
    return pairs[nearest]


def conversion(unit: Unit, joints: Sequence[str], of: Sequence[str], kinds: Sequence[str]) -> str:
    """The command that converts positions of some `joints`, of all those of a log with their kinds, to SI."""
    every = set(joints) == set(of)
    if unit == DEGREES and every and set(kinds) == {HINGE}:
        return "jax-inertia convert --degrees"
    return f"jax-inertia convert --position-scale {per_joint(unit.size, joints, of)}"


def per_joint(number: float | int, joints: Sequence[str], of: Sequence[str]) -> str:
    """A number for some joints as options of `convert` take it; one number where they are all.

    >>> from jax_inertia.preflight.units import per_joint
    >>> per_joint(0.001, ["rail"], ["rail", "elbow"])
    'rail=0.001'
    """
    if set(joints) == set(of):
        return f"{number:.8g}"
    return " ".join(f"{name}={number:.8g}" for name in joints)
