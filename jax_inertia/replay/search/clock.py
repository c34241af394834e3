"""The clock of a robot's loop: numbers of all joints that no model says, and whether there is anything else.

When a target is taken, after its stamp and within a period of the loop, how old what the loop acts on is on average
(`Numbers.hold`), and its velocity more than its position, differ between a robot and a simulation, whose own steps do
something to its inertia besides (`Numbers.steps`); and a torque is logged some part of a period before or after it
acts. All are fitted, with priors of about a millisecond; what then remains is judged against encoders. A robot of
which nothing remains has no gap.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from jax_inertia.diagnosis.verdict import FLOORS
from jax_inertia.replay import checks
from jax_inertia.replay.fitting.errors import replay_errors, weights
from jax_inertia.replay.fitting.fit import Fit, fit
from jax_inertia.replay.loop import ALL, CLOCK, HALF_PERIOD, Parameter
from jax_inertia.replay.record import Record
from jax_inertia.replay.result import rms
from jax_inertia.replay.search.parsimony import nominal
from jax_inertia.replay.search.tries import AS_GOOD
from jax_inertia.replay.simulation.plant import Plant

_ROUNDS = 6
_LONGEST = 3.0
"""Of a clock's prior deviation, what is still a clock's."""
_TORQUE_FLOORS = 2.0
"""Of what encoders and clocks leave of a torque, up to which it is as said."""


class Timed(NamedTuple):
    """The nominal model with a clock that is fitted."""

    plant: Plant
    """Whose dry friction does at rest what the robot's does, as far as this tells."""
    found: Fit
    """Of the clock's numbers; the nominal ones where these replay as well."""
    steps: Float[np.ndarray, " n"]
    """What the simulation's own steps leave of the error of each joint's position, rms [rad]."""
    quiet: bool
    """Whether nothing else shows at any joint."""


def fitted(plants: Sequence[Plant], table: Sequence[Parameter], records: Sequence[Record]) -> Timed:
    """Of the likelier plant, friction that holds or that creeps.

    `table`: all ordinary numbers; `records`: whatever is no test.
    """
    own = [_of_a_clock(p) for p in table if p.family in CLOCK and p.joint == ALL]
    theta = np.array([p.nominal for p in own])
    errors = [replay_errors(plant, own, theta[None], records)[0] for plant in plants]
    n, least = len(plants[0].names), checks.least(records, plants[0].loop)
    sizes = [np.maximum(rms(e), least) for e in errors]
    samples = len(errors[0]) / weights(errors[0], least).correlated
    # Friction as MuJoCo has it, unless the log says that joints hold.
    best = 0 if 2.0 * float(np.sum(samples * np.log(sizes[1] / sizes[0]))) > AS_GOOD else 1
    plant = plants[best]
    found = fit(plant, own, records, theta, floor=least, rounds=_ROUNDS if own else 0)
    bare = found._replace(theta=theta, error=errors[best])
    steps = checks.step_error(plant, found, records)[:n]
    # A number each is paid for, as by any other effect.
    price = len(own) * float(np.log(max(found.samples, 2.0))) + AS_GOOD
    saved = _cost(bare, found) - _cost(found, found)
    found = found if saved > price else bare
    return Timed(plant, found, steps, _quiet(plant, found, records, steps))


def _of_a_clock(p: Parameter) -> Parameter:
    """A number with what a clock leaves of it: half a period of the loop."""
    if p.family == "own_steps":
        return p
    return p._replace(sd=HALF_PERIOD, high=min(p.high, _LONGEST * HALF_PERIOD))


def _cost(of: Fit, by: Fit) -> float:
    """−2 ln p of a fit's error and numbers, at another fit's weights."""
    sd = np.array([p.sd for p in of.table])
    white = of.error * by.weights.root
    return float(np.sum(white**2) + np.sum(((of.theta - nominal(of)) / sd) ** 2))


def _quiet(plant: Plant, found: Fit, records: Sequence[Record], steps: np.ndarray) -> bool:
    n = len(plant.names)
    size = rms(found.error)
    stated = checks.discrepancy(plant.numbers(found.table, found.theta, None), records, steps)
    quiet: Bool[np.ndarray, " n"] = size[:n] <= FLOORS * np.hypot(checks.floor(records), stated)
    quiet |= ~checks.moving(records)
    if records[0].torque is None:
        return bool(np.all(quiet))
    torque = size[n:] <= _TORQUE_FLOORS * checks.torque_floor(records, plant.loop)
    return bool(np.all(quiet) and np.all(torque))


def within(found: Fit, timed: Timed) -> Fit:
    """A fit of all ordinary numbers with the nominal model's, and the clock's as timed."""
    theta = nominal(found)
    for p, x in zip(timed.found.table, timed.found.theta, strict=True):
        for k, other in enumerate(found.table):
            if (p.family, p.joint) == (other.family, other.joint):
                theta[k] = x
    return found._replace(theta=theta)
