"""Numbers of a diagnosis' report.json, each with its place, interval and unit."""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

Z95 = 1.959964


class Quantity(NamedTuple):
    """What a number is of."""

    place: str
    """Joint or body; "" for the whole robot."""
    family: str
    parameter: str
    unit: str


class Interval(NamedTuple):
    """A number with its 95 % interval."""

    value: float
    low: float
    high: float

    @property
    def sigma(self) -> float:
        """Standard deviation that the interval states."""
        return (self.high - self.low) / (2 * Z95)


class Errors(NamedTuple):
    """Error of the run that the report checks itself on: nominal model, corrected model, what sensors leave."""

    before: float
    after: float
    floor: float
    unit: str


def numbers(report: Mapping[str, Any]) -> dict[Quantity, Interval]:
    """Every number of a report that was read: of each joint, of all joints, then of the effects that are none of these.

    A joint's numbers are whole, the model's own included; those of an effect are as the report states them.
    """
    out: dict[Quantity, Interval] = {}
    for joint, own in report.get("joints", {}).items():
        for family, number in own.items():
            _put(out, Quantity(joint, family, "", _unit(number)), number)
    for family, number in report.get("all_joints", {}).items():
        _put(out, Quantity("", family, "", _unit(number)), number)
    known = {(q.place, q.family) for q in out}
    for effect in report.get("effects", []):
        where = effect["location"]
        place = "" if where["kind"] == "global" else where["name"]
        if (place, effect["family"]) in known:
            continue
        several = len(effect["parameters"]) > 1
        for name, number in effect["parameters"].items():
            key = Quantity(place, effect["family"], name if several else "", _unit(number))
            _put(out, key, number)
    return out


def _unit(number: Mapping[str, Any]) -> str:
    unit = str(number.get("unit", "1"))
    return {"1": "", "kg m^2": "kg m²"}.get(unit, unit)


def _put(out: dict[Quantity, Interval], key: Quantity, number: Mapping[str, Any]) -> None:
    ends = number.get("ci95")
    if ends is not None and None not in (number["value"], *ends):
        out.setdefault(key, Interval(float(number["value"]), float(ends[0]), float(ends[1])))


def errors(report: Mapping[str, Any]) -> Errors | None:
    """Of the other run where there is one, else of held-out rows; of a replay [rad]."""
    shrink = report.get("shrink", {})
    for name in ("replay", "test_log", "heldout"):
        if found := shrink.get(name):
            floor = found.get("floor", found.get("noise"))
            before, after, rest = (
                math.nan if x is None else float(x)
                for x in (found["before"], found["after"], floor)
            )
            return Errors(before, after, rest, found.get("unit", "N m"))
    return None


def lacks(report: Mapping[str, Any]) -> list[str]:
    """What the model lacks, as people say it: odd effects first; what is at more than two joints, by their number."""
    places: dict[tuple[bool, str], list[str]] = {}
    for effect in report.get("effects", []):
        where = effect["location"]
        key = bool(effect.get("ordinary")), effect["family"].replace("_", " ")
        places.setdefault(key, []).append("" if where["kind"] == "global" else where["name"])
    out = []
    for (_, name), where in sorted(places.items(), key=lambda item: item[0][0]):
        at = f" at {' and '.join(where)}" if any(where) else ""
        out.append(name + (at if len(where) <= 2 else f" at {len(where)} joints"))
    return out
