"""An effect as numbers alone: what a diagnosis or its report.json says, and what a simulator needs."""

import dataclasses
from collections.abc import Mapping
from typing import Any

GAIN = "torque_gain"
"""The family whose whole number stands in a report's joints, beyond what is listed."""


@dataclasses.dataclass(frozen=True)
class Identified:
    """A family at a place with its parameters, in the units of the contract."""

    family: str
    kind: str
    """'joint', 'body', 'contact' or 'global'."""
    name: str
    values: Mapping[str, float]
    other: str = ""
    """The other joint, of an effect between two."""

    def __str__(self) -> str:
        numbers = ", ".join(f"{key} = {value:.6g}" for key, value in self.values.items())
        other = f" with {self.other}" if self.other else ""
        return f"{self.family} at {self.kind} {self.name}{other}: {numbers}"

    def vector(self, name: str) -> tuple[float, float, float]:
        """Three numbers along x, y and z."""
        x, y, z = (float(self.values[f"{name}_{k}"]) for k in "xyz")
        return x, y, z


def effects_in(report: Mapping[str, Any]) -> tuple[Identified, ...]:
    """The effects of a report.json as parsed, each joint's whole gain with them; ValueError where it is none.

    Those that are named and not handed over are left out.

    >>> from jax_inertia.diagnosis.effects.identified import effects_in
    >>> numbers = {"stiffness": {"value": 5.0}, "rest_angle": {"value": 0.1}}
    >>> place = {"kind": "joint", "name": "elbow"}
    >>> spring = {"family": "joint_spring", "location": place, "parameters": numbers}
    >>> [str(e) for e in effects_in({"effects": [spring]})]
    ['joint_spring at joint elbow: stiffness = 5, rest_angle = 0.1']
    """
    try:
        gains = {
            joint: own[GAIN]["value"]
            for joint, own in report.get("joints", {}).items()
            if GAIN in own
        }
        whole = (Identified(GAIN, "joint", j, {"gain": float(g)}) for j, g in gains.items())
        listed = (
            Identified(
                e["family"],
                e["location"]["kind"],
                e["location"]["name"],
                {k: float(p["value"]) for k, p in e["parameters"].items()},
                e["location"].get("other", ""),
            )
            for e in report["effects"]
            if e.get("handed_over", True) and (not gains or e["family"] != GAIN)
        )
        return (*whole, *listed)
    except (KeyError, TypeError) as error:
        raise ValueError(
            f"no report of a diagnosis: {error!r}; give a parsed report.json"
        ) from None
