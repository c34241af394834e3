"""Derivatives of replays' errors by their numbers, of replays in long steps (`Plant.quick`)."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from jax_inertia.replay.fitting.errors import replay_errors
from jax_inertia.replay.loop import LOGARITHMIC, Parameter
from jax_inertia.replay.record import Record
from jax_inertia.replay.simulation.plant import Plant
from jax_inertia.replay.simulation.simulate import LOST

_DIFFERENCE = 0.02
_MANY = 0.25
"""Of replays near one that is well, that are lost."""


def wide(
    plant: Plant,
    table: Sequence[Parameter],
    records: Sequence[Record],
    theta: Float[np.ndarray, " P"],
    free: Bool[np.ndarray, " P"],
) -> Float[np.ndarray, "P N m"]:
    """By one difference each, as wide as to be of use far from the best numbers."""
    steps = _widest(table)
    linear = np.array([p.family not in LOGARITHMIC for p in table])
    steps = np.maximum(steps, _DIFFERENCE * np.abs(np.where(linear, theta, 0.0)))
    steps = np.where(theta + steps > np.array([p.high for p in table]), -steps, steps)
    return _differences(plant, table, records, theta, free, np.stack([steps, np.zeros_like(steps)]))


def narrow(
    plant: Plant,
    table: Sequence[Parameter],
    records: Sequence[Record],
    theta: Float[np.ndarray, " P"],
    free: Bool[np.ndarray, " P"],
    bend: Float[np.ndarray, " P"],
) -> Float[np.ndarray, "P N m"]:
    """By differences to both sides, as wide as one number alone is known: 1 / √bend, half its second derivative.

    What several numbers do together, a log may hardly tell: such sums of columns are small, and an error of a column,
    of the bend over a wide difference, passes for knowledge of them. A load of 0.25 kg at the end of a link of two was
    known to 0.0014 kg by `wide` columns, by these to 0.02 kg, and it was 0.08 kg off.
    """
    steps = np.minimum(1.0 / np.sqrt(np.maximum(bend, 1e-300)), _widest(table))
    low, high = (np.array([getattr(p, side) for p in table]) for side in ("low", "high"))
    up, down = np.minimum(theta + steps, high) - theta, np.maximum(theta - steps, low) - theta
    return _differences(plant, table, records, theta, free, np.stack([up, down]))


def _widest(table: Sequence[Parameter]) -> Float[np.ndarray, " P"]:
    return _DIFFERENCE * np.array([p.sd if np.isfinite(p.sd) else 1.0 for p in table])


def _differences(plant, table, records, theta, free, offs: Float[np.ndarray, "2 P"]) -> np.ndarray:
    """Between replays at two offsets of each number; those of separate trees of joints share replays."""
    go = np.flatnonzero(free)
    rows = np.array(together([plant.tree_of(table[k]) for k in go]), int)
    count = rows.max(initial=-1) + 1
    one_sided = not offs[1].any()
    thetas = np.repeat(theta[None], count + (1 if one_sided else count), axis=0)
    thetas[rows, go] += offs[0, go]
    other = np.full_like(rows, count) if one_sided else count + rows
    thetas[other, go] += offs[1, go]
    out = replay_errors(plant.quick, table, thetas, records)
    # Steps that long lose a robot whose inertia is small in some posture.
    while np.mean(_lost(out)) > _MANY and plant.quick.halve():
        out = replay_errors(plant.quick, table, thetas, records)
    columns = np.zeros((len(table), *out.shape[1:]))
    width = (offs[0] - offs[1])[go, None, None]
    columns[go] = (out[rows] - out[other]) / width
    return columns * touches(plant, table, out.shape[-1])[:, None]


def _lost(errors: Float[np.ndarray, "B N m"]) -> Bool[np.ndarray, " B"]:
    return np.any(np.abs(errors - LOST) < 1e-6, axis=(1, 2))


def mend(plant: Plant, table, columns, step, change) -> np.ndarray:
    """Derivatives that say of the last step what it did (Broyden), each joint's by the numbers of its tree."""
    step = np.nan_to_num(step)
    scaled = step / np.array([p.sd for p in table])
    share = scaled[:, None] * touches(plant, table, change.shape[-1])
    lacking = change - np.einsum("p,pnj->nj", step, columns)
    size = np.maximum(np.sum(share**2, axis=0), 1e-300)
    by = share / size / np.array([p.sd for p in table])[:, None]
    return columns + by[:, None] * lacking


def touches(plant: Plant, table: Sequence[Parameter], outputs: int) -> Bool[np.ndarray, "P m"]:
    """Which outputs each number can change: positions, and perhaps torques, of the joints of its tree."""
    trees = [plant.tree_of(p) for p in table]
    joints = [np.ones_like(plant.trees, bool) if t is None else plant.trees == t for t in trees]
    return np.tile(np.array(joints), outputs // len(plant.trees))


def together(trees: Sequence[int | None]) -> list[int]:
    """A replay's number for each change: those of separate trees share one, those of all joints have their own."""
    out, used = [], dict.fromkeys({t for t in trees if t is not None}, 0)
    for t in trees:
        out.append(-1 if t is None else used[t])
        if t is not None:
            used[t] += 1
    shared = max(used.values(), default=0)
    alone = iter(range(shared, shared + len(trees)))
    return [next(alone) if row < 0 else row for row in out]
