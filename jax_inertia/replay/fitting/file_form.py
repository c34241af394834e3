"""Numbers as a file holds them: a motor whose torque lags as targets that lag, less damping and less inertia.

No file has a filter between a loop and its joint. To the second order in the lag T (`Numbers.lumped`) its joint is one
with a filter before the loop, which files have. With kp 20 N m/rad, kd 0.7 N m s/rad and T 20 ms that replayed to
7 mrad (28 mrad without it). So these three numbers are fitted, from there, to the same rows, all others as they are:
0.2 mrad (`tests/test_replay_actuator_lag.py`).
"""

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float

from jax_inertia.replay.fitting.fit import Fit, fit
from jax_inertia.replay.joint_numbers import Numbers
from jax_inertia.replay.loop import Parameter
from jax_inertia.replay.record import Record
from jax_inertia.replay.simulation.plant import Plant

_ROUNDS = 6
"""Of Gauss–Newton: twice as many as where a fit starts from its own numbers (`pipeline._on_all`)."""
_HELD = "lag", "kd", "damping", "armature"
"""Numbers of a joint that differ in the file."""
_FITTED = "target_lag", "viscous_friction", "armature"
"""Families of the table that are fitted for it."""

InFile = Callable[[Numbers], Numbers]
"""From a plant's numbers to those of its file."""


def file_form(
    plant: Plant, found: Fit, records: Sequence[Record], floor: Float[np.ndarray, " m"]
) -> InFile:
    """Numbers as the file holds them, of numbers near those of a fit; `floor`: what remains of each output at least."""
    first = plant.numbers(found.table, found.theta, None)
    lagging = np.flatnonzero(first.behind > 0).tolist()
    if not lagging:
        return lambda x: x.at_joint.lumped
    table, theta = _in_place(found, first, lagging)
    free = np.array([p.family in _FITTED and p.joint in lagging for p in table])
    best = fit(plant, table, records, theta, free=free, floor=floor, rounds=_ROUNDS, exact=True)
    held, lumped = plant.numbers(table, best.theta, None).at_joint, first.at_joint.lumped
    more = {name: getattr(held, name) - getattr(lumped, name) for name in _HELD}

    def in_file(x: Numbers) -> Numbers:
        near = x.at_joint.lumped
        return near._replace(**{name: getattr(near, name) + y for name, y in more.items()})

    return in_file


def _in_place(
    found: Fit, x: Numbers, lagging: Sequence[int]
) -> tuple[tuple[Parameter, ...], Float[np.ndarray, " P"]]:
    """The table with lags of targets for those of motors, and numbers where the others start."""
    own = {n: getattr(x.at_joint.lumped, n) - getattr(x.at_joint, n) for n in ("kd", "armature")}
    change = {"viscous_friction": own["kd"], "armature": own["armature"]}
    table, theta = [], found.theta.copy()
    for k, p in enumerate(found.table):
        if p.joint in lagging and p.family in change:
            theta[k] = max(theta[k] + change[p.family][p.joint], p.low)
        table.append(p._replace(family="target_lag") if p.family == "actuator_lag" else p)
    return tuple(table), theta
