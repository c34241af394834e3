"""An effect as numbers alone: what a diagnosis or its report.json says, and what a simulator needs."""

import dataclasses
from collections.abc import Mapping
from typing import Any

from jax_inertia.gap.finding import Diagnosis


@dataclasses.dataclass(frozen=True)
class Effect:
    """A family at a place with its parameters, in the units of the contract."""

    family: str
    kind: str
    """'joint', 'body', 'contact' or 'global'."""
    name: str
    values: Mapping[str, float]

    def __str__(self) -> str:
        numbers = ", ".join(f"{key} = {value:.6g}" for key, value in self.values.items())
        return f"{self.family} at {self.kind} {self.name}: {numbers}"


def effects_of(found: Diagnosis) -> tuple[Effect, ...]:
    """The findings of a diagnosis, the most important first."""
    return tuple(
        Effect(f.family, f.place.kind, f.place.name, {k: p.value for k, p in f.parameters.items()})
        for f in found.findings
    )


def effects_in(report: Mapping[str, Any]) -> tuple[Effect, ...]:
    """The effects of a report.json as parsed; raises ValueError where it is none."""
    try:
        return tuple(
            Effect(
                e["family"],
                e["location"]["kind"],
                e["location"]["name"],
                {k: float(p["value"]) for k, p in e["parameters"].items()},
            )
            for e in report["effects"]
        )
    except (KeyError, TypeError) as error:
        raise ValueError(
            f"no report of a diagnosis: {error!r}; give a parsed report.json"
        ) from None
