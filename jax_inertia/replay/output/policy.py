"""policy.json: what a simulator for training wants of each joint, and the ranges to draw from."""

from typing import Any

import numpy as np

from jax_inertia.replay.listing import PARAMETERS, size_of, whole
from jax_inertia.replay.loop import LOGARITHMIC, TOLERANCES
from jax_inertia.replay.result import Diagnosis
from jax_inertia.replay.simulation.plant import HOLD


def policy(found: Diagnosis) -> dict[str, Any]:
    """What a simulator for training wants: each joint's numbers and the range to draw them from.

    A range is the number's 95 % interval; of what stayed at the nominal model's value, the interval that the log
    allows, the nominal value included.
    """
    joints: dict[str, dict] = {}
    shared: dict[str, dict] = {}
    fit, everything = found.found, found.everything
    for k, p in enumerate(fit.table):
        if p.family == "torque_lead" or p.family in TOLERANCES:
            # Of the log, not of the robot; and of what every model is off by.
            continue
        number = size_of(fit, k, found.loop)
        ends = [number.low, number.high]
        if fit.sigma[k] == 0 and k < len(everything.table):
            wide = size_of(everything, k, found.loop)
            ends = [min(wide.low, number.value), max(wide.high, number.value)]
        # A sum of damping and kd below kd is no damping, and less kd.
        least = whole(p, p.low, found.loop) if np.isfinite(p.low) else -np.inf
        if p.family == "viscous_friction":
            least = 0.0
            number = number._replace(value=max(number.value, 0.0), high=max(number.high, 0.0))
            ends[1] = max(ends[1], 0.0)
        entry = {
            "value": number.value,
            "range": [max(ends[0], least), ends[1]],
            "unit": number.unit,
        }
        if not np.all(np.isfinite([entry["value"], *entry["range"]])):
            continue
        if p.joint >= 0:
            joints.setdefault(found.names[p.joint], {})[_POLICY.get(p.family, p.family)] = entry
        else:
            shared[_shared_name(p.family) + (f".{p.body}" if p.body else "")] = entry
    for j, name in enumerate(found.names):
        gains = joints.setdefault(name, {})
        gains["kp"] = {"value": float(found.loop.kp[j]), "unit": "N m/rad", "scaled_by": "kp_scale"}
        kd = float(found.loop.kd[j])
        if "kd_scale" not in gains:
            # Of a sum of damping and kd below kd, kd is that.
            kd = min(kd, float(found.numbers.kd[j]))
        gains["kd"] = {"value": kd, "unit": "N m s/rad"}
    at_rest = (
        {"friction_at_rest": {"solimpfriction": HOLD.tolist()}} if found.correction.holds else {}
    )
    return {
        "joints": joints,
        "all_joints": shared,
        **at_rest,
        "covariance": _covariance(found),
        "draws": _draws(found),
    }


def _covariance(found: Diagnosis) -> dict[str, Any]:
    """Covariance of the numbers that were changed, in SI units; of a gain or a limit, of its logarithm."""
    fit = found.found
    moved = np.flatnonzero(fit.moved)
    numbers = [
        {
            "family": p.family,
            "joint": found.names[p.joint] if p.joint >= 0 else None,
            "body": p.body or None,
            "logarithm": p.family in LOGARITHMIC,
            "value": float(x),
        }
        for p, x in ((fit.table[k], fit.theta[k]) for k in moved)
    ]
    return {"numbers": numbers, "matrix": fit.covariance[np.ix_(moved, moved)].tolist()}


def _draws(found: Diagnosis) -> dict[str, Any] | None:
    """What draws.npz has, and by how much replays of some of its draws err [rad]; None where there are no draws."""
    fan, r = found.replayed.fan, found.replayed
    if found.draws is None or fan is None:
        return None
    median, worst = np.percentile(fan.errors, (50.0, 95.0))
    run = r.records[r.shown]
    own = np.sqrt(np.mean((r.corrected[r.shown] - run.q)[run.settled] ** 2))
    replay = {"corrected": float(own), "median": float(median), "p95": float(worst), "unit": "rad"}
    return {"file": "draws.npz", "count": len(found.draws.vectors), "replay": replay}


_POLICY = {"viscous_friction": "damping", "coulomb_friction": "frictionloss"}


def _shared_name(family: str) -> str:
    if family == "payload":
        return "mass_added"
    return PARAMETERS[family] if family.startswith("target_") else family
