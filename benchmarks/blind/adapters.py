"""What an engineer tries without a diagnosis, as tools of the protocol: a report.json for every log.

    python -m benchmarks.blind.adapters LOGS OUT --tool least_squares|pace_like|mujoco_sysid [--jobs 2]

`least_squares`: viscous and dry friction, rotor inertia and offset of every joint and every body's mass at once
(`exam/least_squares.py`); a term that carries a hundredth of what the fit explains is listed. `mujoco_sysid`:
MuJoCo's own, told to fit all of these but the offset (`sysid_fit.py`). `pace_like`: the fit of closed-loop replays
(`pace_positions.py`), of logs of targets alone. Floating bases are refused, and logs without torque by
`least_squares`. All are `explained` where they list anything.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import json
import shutil
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path

import mujoco
import numpy as np

from benchmarks.blind import pace_positions, sysid_fit
from benchmarks.exam.least_squares import columns
from benchmarks.exam.torque_error import needed, read, signals
from benchmarks.worlds.truth import TERMS

CARRIES = 0.01


def least_squares(folder: Path) -> tuple[dict, str]:
    """Every joint's four terms as a report, and the model with its bodies' masses as fitted."""
    spec = mujoco.MjSpec.from_file(str(folder / "nominal.xml"))
    model = spec.compile()
    s = signals(model, read(folder / "log.npz"))
    n = model.nv
    x, y = s.finish(columns(model, s)), s.finish(s.tau - needed(model, s))
    weight = s.kept / np.sqrt((y**2).mean(0) + 1e-12)
    a = (x * weight[:, :, None]).reshape(-1, x.shape[2])
    scale = np.sqrt((a**2).mean(0)) + 1e-300
    theta = np.linalg.lstsq(a / scale, (y * weight).ravel(), rcond=1e-9)[0] / scale
    for body, factor in zip(bodies_of(model), theta[4 * n :], strict=True):
        one = spec.body(model.body(body).name)
        one.mass, one.inertia = one.mass * (1 + factor), np.array(one.inertia) * (1 + factor)
        one.fullinertia = np.array(one.fullinertia) * (1 + factor)
    carried = ((a[:, : 4 * n] * theta[: 4 * n]) ** 2).sum(0)
    return _as_report(model, theta[: 4 * n].reshape(n, 4), carried.reshape(n, 4)), spec.to_xml()


def mujoco_sysid(folder: Path) -> tuple[dict, str]:
    """As `least_squares`; of a log without torque the model is the whole robot."""
    spec, log = mujoco.MjSpec.from_file(str(folder / "nominal.xml")), read(folder / "log.npz")
    plain = spec.compile()
    lacking, carried = sysid_fit.fit(spec, log)
    report = _as_report(plain, lacking, carried)
    if "tau" in log:
        # A report of torques states its joints' numbers itself.
        for joint in spec.joints:
            j = plain.joint(joint.name).dofadr[0]
            joint.armature, joint.frictionloss = plain.dof_armature[j], plain.dof_frictionloss[j]
            joint.damping = np.array([plain.dof_damping[j], *joint.damping[1:]])
    spec.compile()
    return report, spec.to_xml()


FITS = {"least_squares": least_squares, "mujoco_sysid": mujoco_sysid}


def bodies_of(model: mujoco.MjModel) -> list[int]:
    """Those that `columns` has a factor of."""
    return [
        b for b in range(1, model.nbody) if model.body_weldid[b] != 0 and model.body_mass[b] > 0
    ]


def _as_report(model: mujoco.MjModel, theta: np.ndarray, carried: np.ndarray) -> dict:
    """`theta`: what each joint's four numbers lack in the model; a report states them whole."""
    own = model.dof_damping, model.dof_frictionloss, model.dof_armature, np.zeros(model.nv)
    joints: dict[str, dict] = {}
    effects = []
    for j in range(model.nv):
        name = model.joint(j).name
        for k, (family, parameter, unit) in enumerate(TERMS):
            lacking = -float(theta[j, k]) if family == "torque_bias" else float(theta[j, k])
            whole = {"parameter": parameter, "value": float(own[k][j]) + lacking, "unit": unit}
            joints.setdefault(name, {})[family] = whole
            if carried[j, k] > CARRIES * carried.sum():
                value = {parameter: {"value": lacking, "unit": unit}}
                place = {"kind": "joint", "name": name}
                effects.append({"family": family, "location": place, "parameters": value})
    return {"effects": effects, "joints": joints}


def report(folder: Path, tool: str) -> tuple[dict, str | None]:
    """report.json, and corrected.xml where the tool has one."""
    corrected = None
    log = read(folder / "log.npz")
    if "base_quat" in log:
        raise ValueError("the base floats; expected a fixed one")
    if tool == "pace_like":
        if "tau" in log:
            raise ValueError("the log has torques; expected targets alone")
        made, corrected = pace_positions.answer(folder, log)
    elif "tau" not in log and tool != "mujoco_sysid":
        raise ValueError("the log has no torque")
    else:
        made, corrected = FITS[tool](folder)
    for effect in made["effects"]:
        effect.setdefault("equivalent", [])
    verdict = "explained" if made["effects"] else "no_gap"
    return made | {"verdict": verdict, "confidence": None}, corrected


def answer(folder: Path, out: Path, tool: str) -> None:
    """One report, whole or not at all."""
    place = out / "results" / folder.name
    if place.exists():
        return
    begun, part = time.perf_counter(), out / "parts" / folder.name
    shutil.rmtree(part, ignore_errors=True)
    part.mkdir(parents=True)
    run: dict = {"exit": 0}
    try:
        said, corrected = report(folder, tool)
        (part / "report.json").write_text(json.dumps(said, indent=1))
        if corrected is not None:
            (part / "corrected.xml").write_text(corrected)
    except (ValueError, np.linalg.LinAlgError) as error:
        run = {"exit": 1, "error": str(error)}
    run["seconds"] = time.perf_counter() - begun
    (part / "run.json").write_text(json.dumps(run))
    place.parent.mkdir(parents=True, exist_ok=True)
    part.rename(place)


def answer_all(folders: list[Path], out: Path, tool: str, jobs: int) -> None:
    """A report for every log that has none yet."""
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        running = [pool.submit(answer, f, out, tool) for f in folders]
        for done in as_completed(running):
            done.result()
    shutil.rmtree(out / "parts", ignore_errors=True)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("logs", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--tool", required=True, choices=["pace_like", *FITS])
    parser.add_argument("--jobs", type=int, default=1)
    args = parser.parse_args()
    folders = sorted(p for p in args.logs.iterdir() if (p / "log.npz").exists())
    answer_all(folders, args.out, args.tool, args.jobs)


if __name__ == "__main__":
    main()
