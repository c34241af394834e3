"""One log of a robot on its feet that has an IMU alone: what was hidden beside what was said.

Marked as robots that are told positions (`position_marks`), without a replay: where the base is, no such log says. A
load's mass is compared with what a scale would tell: the load, and what the bodies weigh more than the model says.
"""

from __future__ import annotations

from benchmarks.exam import position_marks
from benchmarks.exam.torque_marks import key

STRATUM = "imu"
ORDINARY = {"armature", "viscous_friction", "coulomb_friction"}
CLOSE = 0.05
"""Of a load's mass: what counts as found."""


def marks(truth: dict, report: dict | None) -> dict:
    """What a row of such a log has beside what every row has; `mass_error` is relative, None where none is told."""
    listed = report["effects"] if report else []
    row = position_marks.of_effects(truth, report, ORDINARY)
    return row | {
        "hidden": position_marks.hidden(truth),
        "sigmas": max((e["visibility"]["sigmas"] for e in truth["effects"]), default=0.0),
        "listed": [list(key(e)) for e in listed],
        "invented": not all(row["there"]),
        "mass_error": _mass_error(truth, listed),
    }


def _mass_error(truth: dict, listed: list[dict]) -> float | None:
    for hidden in truth["effects"]:
        for effect in listed:
            if key(effect) == key(hidden) and "mass" in effect["parameters"]:
                real = hidden["parameters"]["mass"]["value"]
                return effect["parameters"]["mass"]["value"] / real - 1.0
    return None
