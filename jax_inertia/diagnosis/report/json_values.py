"""Parts of a report.json that every diagnosis has: places, rollouts, motions to record, plain numbers."""

import math
from typing import Any

import numpy as np

from jax_inertia.diagnosis.effects.base import Place
from jax_inertia.diagnosis.report.next_motion import Suggestion
from jax_inertia.diagnosis.simulate.rollout import Rollouts


def rollout_values(r: Rollouts) -> dict[str, Any]:
    """How far simulation and log part, before and after."""
    return {
        "horizon_s": r.horizon,
        "before": r.before,
        "after": r.after,
        "floor": r.floor,
        "unit": r.unit,
        "windows": len(r.starts),
        "notes": list(r.notes),
    }


def motion_values(wanted: tuple[Suggestion, ...]) -> dict[str, Any]:
    """The first suggestion, and all others; empty where nothing ties."""
    if not wanted:
        return {}
    every = [
        {
            "between": list(s.between),
            "joint": s.where,
            "kind": s.kind,
            "text": s.text,
            "numbers": s.numbers,
        }
        for s in wanted
    ]
    return {**every[0], "others": every[1:]}


def located(place: Place) -> dict[str, Any]:
    """A place as the contract writes it."""
    other = {"other": place.other} if place.other else {}
    return {"kind": place.kind, "name": place.name, **other}


def clean(x):
    """Plain floats; what is not finite becomes null, which JSON has."""
    if isinstance(x, dict):
        return {k: clean(v) for k, v in x.items()}
    if isinstance(x, list):
        return [clean(v) for v in x]
    if isinstance(x, float | np.generic):
        value = float(x)
        return value if math.isfinite(value) else None
    return x
