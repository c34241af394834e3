"""Names and numbers as people read them."""

from typing import Protocol, runtime_checkable

import numpy as np


@runtime_checkable
class Placed(Protocol):
    """A place: what kind, its name in the model, and another name where it is between two."""

    @property
    def kind(self) -> str: ...
    @property
    def name(self) -> str: ...
    @property
    def other(self) -> str: ...


def plain(name: str) -> str:
    """A name of the library without underscores."""
    return name.replace("_", " ")


def where(place: Placed) -> str:
    """Its name, and the other's of a place between two."""
    return f"{place.name} with {place.other}" if place.other else place.name


def at(place: Placed) -> str:
    """Where; nothing for what is everywhere."""
    return "" if place.kind == "global" else f" at {where(place)}"


def named(family: str, place: Placed) -> str:
    """An effect and where it is."""
    return plain(family) + at(place)


def unit(text: str) -> str:
    """A unit to stand behind a number."""
    return "" if text == "1" else f" {text}"


def percent(x: float) -> str:
    """A share."""
    return f"{100 * x:.0f} %"


def chance(x: float) -> str:
    """A probability; nothing is certain."""
    return "> 99 %" if x > 0.99 else percent(x)


def number(x: float) -> str:
    """Three digits that mean something, without an exponent where one can do without."""
    if x is None or not np.isfinite(x):
        return "–"
    if x == 0 or 1e-3 <= abs(x) < 1e4:
        return f"{x:.3g}" if abs(x) < 1000 else f"{x:.0f}"
    return f"{x:.2g}"
