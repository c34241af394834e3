"""A model's file replayed in MuJoCo, by a program that shares no code with the package: what whoever gets it gets.

Targets are held from stamp to stamp and set before each of the model's own steps, at their mean over it. The file's
text `step_law` holds what no attribute can: friction that varies along the motion, and a low-pass of the targets
(equations in docs/position_controlled.md). What the integral of a drive has reached before the first stamp no log has:
it is that by which the replay ends the first 0.2 s where the joint does.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import mujoco
import numpy as np


def replayed(
    file: str | Path,
    names: Sequence[str],
    time: np.ndarray,
    q: np.ndarray,
    target: np.ndarray,
    ratio: np.ndarray | float = 1.0,
) -> np.ndarray:
    """Positions (T, n) at the stamps; `file`: a path, or the text itself; `ratio`: kp of this log over the model's."""
    text = file.read_text(encoding="utf-8") if isinstance(file, Path) else file
    model = mujoco.MjModel.from_xml_string(text)
    law = step_law(model)
    joints = np.array([model.joint(n).id for n in names])
    acts = [_actuators(model, j) for j in joints]
    for each, factor in zip(acts, np.broadcast_to(ratio, len(names)), strict=True):
        model.actuator_gainprm[each, 0] *= factor
        model.actuator_biasprm[each, 1] *= factor
    at, dofs = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
    h, time = float(model.opt.timestep), time - time[0]
    steps = int(np.ceil(time[-1] / h)) + 1
    sent = means(time, filtered(law, names, time, target), h, steps)
    move = partial(_moved, model, law, acts, at, dofs, time, q)
    return move(sent, _wound(model, acts, time, q, sent, move))


def _wound(model, acts, time, q, sent, move) -> dict[int, float]:
    """The force of each integral's actuator at the first stamp."""
    pid = model.actuator_dyntype == mujoco.mjtDyn.mjDYN_PID
    of = {a: j for j, each in enumerate(acts) for a in each.tolist() if pid[a]}
    force, end = dict.fromkeys(of, 0.0), min(0.2, 0.1 * time[-1])
    late = np.flatnonzero((time > 0.5 * end) & (time <= end)) if time[1] <= end else np.array([1])
    head = sent[: int(np.ceil(time[late[-1]] / model.opt.timestep)) + 1]
    for _ in range(4 * bool(of)):
        error = (q - move(head, force))[late].mean(axis=0)
        for a, j in of.items():
            most = model.actuator_actrange[a, 1] * model.actuator_gainprm[a, 0] or np.inf
            main = acts[j][0]
            kp = -model.actuator_biasprm[main, 1] * model.actuator_gear[main, 0]
            force[a] = float(np.clip(force[a] + kp * error[j], -most, most))
    return force


def _moved(model, law, acts, at, dofs, time, q, sent, force) -> np.ndarray:
    """Positions at the stamps, by targets of each step; `force`: of each integral's actuator at the start."""
    data, h, steps = mujoco.MjData(model), float(model.opt.timestep), len(sent)
    data.qpos[at] = q[0]
    head = time <= max(0.05, time[min(4, len(time) - 1)])
    for k, d in enumerate(dofs):
        data.qvel[d] = np.polyfit(time[head], q[head, k], 2)[1]
    _hold(model, data, acts, sent[0])
    for a, f in force.items():
        data.act[model.actuator_actadr[a]] = f / model.actuator_gainprm[a, 0]
    path = np.empty((steps + 1, len(at)))
    path[0] = data.qpos[at]
    for k in range(steps):
        for each, x in zip(acts, sent[k], strict=True):
            data.ctrl[each] = x * model.actuator_gear[each, 0]
        for name, f in law.get("friction", {}).items():
            j = model.joint(name)
            d, p = j.dofadr[0], j.qposadr[0]
            rest = np.exp(-((data.qvel[d] / f["stribeck_velocity"]) ** 2))
            there = f["coulomb"] + f["slope"] * (data.qpos[p] - f["middle"]) + f["stiction"] * rest
            model.dof_frictionloss[d] = max(there + f["load"] * abs(data.qfrc_actuator[d]), 0.0)
        mujoco.mj_step(model, data)
        path[k + 1] = data.qpos[at]
    return np.stack([np.interp(time, np.arange(steps + 1) * h, x) for x in path.T], axis=1)


def step_law(model: mujoco.MjModel) -> dict:
    """What the file says in text; nothing where it says none."""
    k = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_TEXT, "step_law")
    if k >= 0:
        first = model.text_adr[k]
        data = bytes(model.text_data[first : first + model.text_size[k]])
        return json.loads(data.split(b"\0")[0].decode())
    return {}


def filtered(law: dict, names: Sequence[str], time: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Targets behind the law's low-pass."""
    if "low_pass" not in law:
        return target
    out, due = np.array(target, float), np.floor(time / law["low_pass"]["period"] + 1e-6)
    for name, gain in law["low_pass"]["gain"].items():
        j = list(names).index(name)
        y = target[0, j]
        for k in range(len(time)):
            if k == 0 or due[k] > due[k - 1]:
                y += gain * (target[k, j] - y)
            out[k, j] = y
    return out


def means(time: np.ndarray, held: np.ndarray, h: float, steps: int) -> np.ndarray:
    """The mean over each step of what is held from stamp to stamp."""
    edges = np.append(time, time[-1] + np.median(np.diff(time)))
    area = np.vstack([np.zeros(held.shape[1]), np.cumsum(held * np.diff(edges)[:, None], axis=0)])
    at = np.arange(steps + 1) * h
    past = np.maximum(at - edges[-1], 0.0)[:, None] * held[-1]
    return np.diff(np.stack([np.interp(at, edges, a) for a in area.T], 1) + past, axis=0) / h


def _actuators(model: mujoco.MjModel, joint: int) -> np.ndarray:
    """The last actuator on a joint, and those of its dead band and integral, which have the same targets."""
    on = [
        a for a in range(model.nu)
        if model.actuator_trntype[a] == mujoco.mjtTrn.mjTRN_JOINT and model.actuator_trnid[a, 0] == joint
    ]  # fmt: skip
    more = [a for a in on if model.actuator(a).name.endswith(("_dead_band", "_integral"))]
    return np.array([[a for a in on if a not in more][-1], *more])


def _hold(model: mujoco.MjModel, data: mujoco.MjData, acts, first: np.ndarray) -> None:
    """Delays and filters begin as if the first targets had been held."""
    for each, x in zip(acts, first, strict=True):
        for a in each.tolist():
            data.ctrl[a] = x * model.actuator_gear[a, 0]
            if model.actuator_delay[a] > 0:
                past = np.full(model.actuator_history[a, 0], data.ctrl[a])
                mujoco.mj_initCtrlHistory(model, data, a, None, past)
            if model.actuator_dyntype[a] == mujoco.mjtDyn.mjDYN_FILTEREXACT:
                data.act[model.actuator_actadr[a]] = data.ctrl[a]
