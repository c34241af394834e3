"""Names and numbers as people read them."""

import math
from collections.abc import Mapping
from typing import Protocol, runtime_checkable

import numpy as np

EPOCH = 1e6
"""Stamps from which on an axis counts from the first one: no log lasts 11 days [s]."""


@runtime_checkable
class Placed(Protocol):
    """A place: what kind, its name in the model, and another name where it is between two."""

    @property
    def kind(self) -> str: ...
    @property
    def name(self) -> str: ...
    @property
    def other(self) -> str: ...


@runtime_checkable
class Valued(Protocol):
    """A number of an effect."""

    @property
    def value(self) -> float: ...


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


def length(parameters: Mapping[str, Valued]) -> float | None:
    """Of the vector that the first numbers of an effect are, along x, y (and z); None of what is none."""
    stem, _, axis = next(iter(parameters)).rpartition("_")
    along = [parameters[f"{stem}_{k}"].value for k in "xyz" if f"{stem}_{k}" in parameters]
    return math.hypot(*along) if axis == "x" and len(along) > 1 else None


def unit(text: str) -> str:
    """A unit to stand behind a number."""
    return "" if text == "1" else f" {text}"


def from_start(time: np.ndarray) -> tuple[np.ndarray, str]:
    """Times to draw and the label of their axis: stamps of an epoch count from the first one."""
    first = float(time[0]) if len(time) else 0.0
    if abs(first) < EPOCH:
        return time, "time [s]"
    return time - first, f"time [s] after {first:.3f} s"


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


def interval(value: float, low: float, high: float) -> str:
    """A number and its interval, in the digits that the interval leaves it: 0.898 [0.826, 0.970].

    Two digits of the interval's half-width; with no width, or none that is finite, the number alone.
    """
    value_to, half = digits(value, low, high)
    if half is None:
        return value_to
    ends = [digits(x, low, high)[0] for x in (low, high)]
    return f"{value_to} [{ends[0]}, {ends[1]}]"


def plus_minus(value: float, low: float, high: float) -> str:
    """A number ± half of its interval's width, in the digits that the interval leaves it."""
    value_to, half = digits(value, low, high)
    return value_to if half is None else f"{value_to} ± {half}"


def digits(value: float, low: float, high: float) -> tuple[str, str | None]:
    """The number and half the width of its interval [low, high], to two digits of that half-width.

    None for the half-width where it is none; `number` where decimals would be too many or none to write.
    """
    half = 0.5 * (high - low)
    if not (np.isfinite(half) and half > 0 and np.isfinite(value)):
        return number(value), None
    decimals = 1 - int(np.floor(np.log10(half)))
    if half >= 1000 or decimals > 6:
        return number(value), number(half)
    shown = max(decimals, 0)
    # Never "-0.00".
    return f"{round(value, shown) + 0.0:.{shown}f}", f"{half:.{shown}f}"
