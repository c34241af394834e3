"""One log of a robot that is told positions: what was hidden beside what was said, and how far the model still errs.

The model that a tool hands back (corrected.xml) is run by MuJoCo C on the test run's targets, by
`replayed.py`; one without actuators gets the loop that the log states. Joint positions are compared with the
log's encoders. Nothing of a tool's own figures is used.
"""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

from benchmarks.exam.replayed import replayed
from benchmarks.exam.torque_error import read
from benchmarks.exam.torque_marks import SEEN, key, keys_of

STRATA = ("position", "position_torque")
SETTLING, LOST = 0.2, 10.0
"""Left out at the start [s]; of a robot that flies off [rad]."""
ORDINARY = {
    "armature", "viscous_friction", "coulomb_friction", "encoder_offset", "kp_scale", "kd_scale", "target_delay",
}  # fmt: skip


def error(model: Path, log: dict[str, np.ndarray]) -> float:
    """Rms over joints and rows after the start [rad]."""
    names, spec = [str(x) for x in log["joint_names"]], mujoco.MjSpec.from_file(str(model))
    text = model.read_text()
    if not spec.actuators:
        for name, kp, kd in zip(names, log["kp"], log["kd"], strict=True):
            servo = spec.add_actuator(name=f"{name}_servo", target=name)
            servo.trntype = mujoco.mjtTrn.mjTRN_JOINT
            servo.set_to_position(kp=float(kp), kv=float(kd))
        spec.compile()
        text = spec.to_xml()
    time, q, target = (np.asarray(log[x], float) for x in ("time", "qpos", "qpos_target"))
    path = replayed(text, names, time, q, target)
    miss = np.clip(np.nan_to_num(path - q, nan=LOST), -LOST, LOST)
    return float(np.sqrt(np.mean(miss[time - time[0] >= SETTLING] ** 2)))


def errors(folder: Path, place: Path) -> dict[str, float]:
    """`nominal`, and `tool`: of the model that it handed back; who hands back none that runs leaves the nominal one."""
    log = read(folder / "test.npz")
    nominal = error(folder / "nominal.xml", log)
    try:
        mended = error(place / "corrected.xml", log)
    except (KeyError, ValueError, OSError):
        mended = nominal
    return {"nominal": nominal, "tool": mended}


def hidden(truth: dict) -> str:
    """In words."""
    odd = ", ".join(f"{e['family']} at {e['location']['name']}" for e in truth["effects"])
    return odd or {"sound": "nothing"}.get(truth["kind"], "ordinary physics")


def of_effects(truth: dict, report: dict | None, ordinary: set[str] = ORDINARY) -> dict:
    """Marks of one report; `named`: of each effect that is asked for, whether it was listed, ties counted.

    `ordinary`: families that every robot hides, but those that are sound otherwise.
    """
    asked = [e for e in truth["effects"] if e["visibility"]["sigmas"] >= SEEN]
    row = {"asked": bool(asked) or not truth["effects"], "named": [False] * len(asked)}
    if report is None:
        return row | {"right": False, "confident_wrong": False, "found": False, "there": []}
    listed = report["effects"]
    named = [any(keys_of(e) & keys_of(h) for e in listed) for h in asked]
    real = set().union(*map(keys_of, truth["effects"])) if truth["effects"] else set()
    usual = ordinary if truth["kind"] not in ("sound", "alone") else set()
    there = [e["family"] in usual or bool(keys_of(e) & real) for e in listed]
    verdict, sure = report["verdict"], report["verdict"] in ("explained", "no_gap")
    if truth["kind"] == "sound":
        right, wrong = verdict == "no_gap", verdict == "explained"
    elif truth["kind"] == "ordinary":
        right = verdict != "no_gap" and all(there)
        wrong = verdict == "no_gap" or (verdict == "explained" and not all(there))
    else:
        right, wrong = all(named), sure and not all(named)
    return row | {
        "named": named, "right": right, "confident_wrong": wrong, "found": bool(named) and all(named), "there": there,
    }  # fmt: skip


def marks(folder: Path, place: Path, truth: dict, report: dict | None) -> dict:
    """What a row of such a log has beside what every row has."""
    sizes = [e["visibility"]["sigmas"] for e in truth["effects"]]
    return {
        "hidden": hidden(truth),
        "sigmas": max(sizes, default=0.0),
        "listed": [list(key(e)) for e in report["effects"]] if report else [],
        "replay": errors(folder, place),
        **of_effects(truth, report),
    }
