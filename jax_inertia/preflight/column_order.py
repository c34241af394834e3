"""Columns of a log in another order than its joints: of the torques, of the positions, or of both (wrong names)."""

import itertools
from collections.abc import Iterator

import numpy as np

from jax_inertia.preflight.compared import Compared
from jax_inertia.preflight.other_readings import FITS, Reading, error
from jax_inertia.preflight.torque_parts import Parts

# Of so many joints every order is tried, of more every exchange of two: 4! − 1 = 23 orders, 7 · 6 / 2 = 21 exchanges.
_FEW = 4


def order(c: Compared) -> Iterator[Reading]:
    """The order of columns that fits best, of each kind, with a load at the robot's end as in every reading."""
    names = c.parts.names
    same = tuple(range(len(names)))
    others = _orders(len(names))
    if not others:
        return
    kinds = {
        "tau": [(same, other) for other in others],
        "qpos": [(other, same) for other in others],
        "names": [(other, other) for other in others],
    }
    for kind, candidates in kinds.items():
        best = min(candidates, key=lambda pair: _unlike(c.parts.reordered(*pair)))
        read = c.reordered(*best)
        left = read.missed(read.carried(read.tau - read.needed))
        taken = best[0] if kind == "qpos" else best[1]
        moved = [j for j, k in enumerate(taken) if j != k]
        if np.any(left[moved] > FITS):
            continue
        says, option = _WORDS[kind]
        what = "; ".join(says.format(names[taken[j]], names[j]) for j in moved)
        options = " ".join(option.format(names[taken[j]], names[j]) for j in moved)
        message = (
            f"{what}: columns go in the order of joint_names; jax-inertia convert IN OUT {options}"
        )
        if kind != "names":
            message += " corrects a table (.csv, .parquet)"
        yield Reading(read.left(read.needed), error("order", message), searched=True)


# What a column of the log is, and the option of `convert` that mends it: its name, and the joint's that it belongs to.
_WORDS = {
    "tau": ("tau of {0!r} is what {1!r} needs", "--column tau.{1}=tau.{0}"),
    "qpos": (
        "qpos of {0!r} (and qvel, where it is logged) is how {1!r} moves",
        "--column qpos.{1}=qpos.{0}",
    ),
    "names": (
        "{0!r} is what the model calls {1!r}, by its positions and its torques",
        "--rename {0}={1}",
    ),
}


def _orders(joints: int) -> list[tuple[int, ...]]:
    """Orders of so many columns other than the one they have."""
    same = tuple(range(joints))
    if joints <= _FEW:
        return [x for x in itertools.permutations(same) if x != same]
    out = []
    for i, j in itertools.combinations(same, 2):
        other = list(same)
        other[i], other[j] = j, i
        out.append(tuple(other))
    return out


def _unlike(parts: Parts) -> float:
    """Mean of 1 − ρ² over the joints, ρ the correlation of logged and needed torque: what a load changes least."""
    count = len(parts.names)
    needed = parts.moved(np.ones(count), np.zeros(count))
    tau = parts.logged(np.zeros(count, int))
    both = np.sum(needed**2, axis=0) * np.sum(tau**2, axis=0)
    return float(np.mean(1.0 - np.sum(needed * tau, axis=0) ** 2 / np.maximum(both, 1e-300)))
