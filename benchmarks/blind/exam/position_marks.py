"""One log of a robot that is told positions: what was hidden beside what was said, and how far the model still errs.

The model that a tool hands back (corrected.xml) is run by MuJoCo C on the other motion: each actuator gets the targets
of its joint, late by its own delay; a model without actuators gets the loop that the log states. Joint positions are
compared with the log's encoders. Nothing of a tool's own figures is used.
"""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
from evaluate_cad import SEEN, key, keys_of
from mujoco import rollout

STRATA = ("position", "position_torque")
STEP, FINER = 1e-3, 4
"""Of the replay [s], and moments in one that a target is averaged over."""
SETTLING, LOST = 0.2, 10.0
ORDINARY = {
    "armature", "viscous_friction", "coulomb_friction", "encoder_offset", "kp_scale", "kd_scale", "target_delay",
}  # fmt: skip
_STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS
Log = dict[str, np.ndarray]


def replay(spec: mujoco.MjSpec, log: Log) -> np.ndarray:
    """Positions (T, n) at the log's stamps of a model that is told the log's targets [rad]."""
    names = [str(x) for x in log["joint_names"]]
    if not spec.actuators:
        for name, kp, kd in zip(names, log["kp"], log["kd"], strict=True):
            servo = spec.add_actuator(name=f"{name}_servo", target=name)
            servo.trntype = mujoco.mjtTrn.mjTRN_JOINT
            servo.set_to_position(kp=float(kp), kv=float(kd))
    late = np.array([float(a.delay) for a in spec.actuators])
    for a in spec.actuators:
        # Here, so that what was commanded before the log began is its first target.
        a.delay, a.nsample = 0.0, 0
    m = spec.compile()
    m.opt.timestep, m.opt.integrator = STEP, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    column = [names.index(m.joint(int(m.actuator_trnid[a, 0])).name) for a in range(m.nu)]
    time, told = np.asarray(log["time"]) - log["time"][0], log["qpos_target"]
    steps = int(np.ceil(time[-1] / STEP))
    control = np.zeros((steps, m.nu))
    for part in (np.arange(FINER) + 0.5) / FINER:
        for a, j in enumerate(column):
            at = (np.arange(steps) + part) * STEP - late[a]
            rows = np.clip(np.searchsorted(time, at, side="right") - 1, 0, len(time) - 1)
            control[:, a] += told[rows, j] / FINER
    d = mujoco.MjData(m)
    adr = [m.joint(x).qposadr[0] for x in names]
    d.qpos[adr] = log["qpos"][0]
    if m.na:
        d.act[:] = control[0, m.actuator_actadr >= 0]
    state = np.zeros(mujoco.mj_stateSize(m, _STATE))
    mujoco.mj_getState(m, d, state, _STATE)
    path = rollout.rollout(m, d, state[None], control[None])[0][0][:, 1 + np.array(adr)]
    path = np.concatenate([log["qpos"][:1], path])
    grid = np.arange(steps + 1) * STEP
    return np.stack([np.interp(time, grid, x) for x in path.T], axis=1)


def error(model: Path, log: Log) -> float:
    """Rms over joints and rows after the start [rad]; a robot that flies off is `LOST` from where it should be."""
    path = replay(mujoco.MjSpec.from_file(str(model)), log)
    miss = np.clip(np.nan_to_num(path - log["qpos"], nan=LOST), -LOST, LOST)
    moving = log["time"] - log["time"][0] >= SETTLING
    return float(np.sqrt(np.mean(miss[moving] ** 2)))


def errors(folder: Path, place: Path) -> dict[str, float]:
    """`nominal`, and `tool`: of the model that it handed back; who hands back none that runs leaves the nominal one."""
    with np.load(folder / "test.npz") as file:
        log = {k: file[k] for k in file.files}
    nominal = error(folder / "nominal.xml", log)
    try:
        mended = error(place / "corrected.xml", log)
    except (KeyError, ValueError):
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
