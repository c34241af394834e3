"""Smallest sizes that a log would have shown, as rows of a table: best and worst place of each family."""

import dataclasses
from collections.abc import Sequence
from itertools import groupby

from jax_inertia.diagnosis.effects.base import Parameter, Place
from jax_inertia.text.words import number, unit


@dataclasses.dataclass(frozen=True)
class Unseen:
    """What of one family could have hidden in this log."""

    family: str
    low: str
    high: str
    worst: str
    places: list[tuple[str, str]]


def _far(p: Parameter) -> float:
    """How far a number is from where it does nothing: from one, of a factor."""
    return abs(p.value - 1.0) if p.factor else abs(p.value)


def _size(p: Parameter) -> str:
    return f"{'1 ± ' if p.factor else ''}{number(_far(p))}{unit(p.unit)}"


def by_family(sizes_found: Sequence[tuple[str, Place, Parameter]]) -> list[Unseen]:
    """What could have hidden, a row for each family; those of one family stand together."""
    out = []
    for family, group in groupby(sizes_found, key=lambda x: x[0]):
        every = sorted(group, key=lambda x: _far(x[2]))
        sizes = [(place.name, _size(p)) for _, place, p in every]
        out.append(Unseen(family, sizes[0][1], sizes[-1][1], sizes[-1][0], sizes))
    return out
