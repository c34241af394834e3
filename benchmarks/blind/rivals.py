"""Two simple diagnoses to stand beside ours, from MuJoCo's inverse dynamics alone.

    python benchmarks/blind/rivals.py LOGS OUT --method coulomb|greedy --jobs 2

`coulomb` says: Coulomb friction, at the joint with the largest residual. `greedy` fits linear columns of families by
ordinary least squares, unwhitened, and adds the best one while Schwarz's criterion falls, three at most. Same layout
of results as `solve.py`; knows the logs and nothing else.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import json
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

import mujoco
import numpy as np
from rich.progress import track
from scipy.signal import butter, sosfiltfilt

CUT, THIN = 10.0, 50.0
METHODS = ("coulomb", "greedy")


@dataclass
class Motion:
    """A log on the model's coordinates, low-passed: q (T, nq), v, a (T, nv), torque applied (T, nv)."""

    model: mujoco.MjModel
    rate: float
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    applied: np.ndarray
    friction: np.ndarray
    dofs: np.ndarray
    joints: list[str]
    jacobians: np.ndarray | None
    wrench: np.ndarray | None
    contacts: list[str]


def read(log: Path, xml: Path) -> Motion:
    """Contacts by their measured wrenches; torques held over a sample, centred."""
    model = mujoco.MjModel.from_xml_path(str(xml))
    friction = model.dof_frictionloss.copy()
    model.dof_frictionloss[:] = 0.0
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    with np.load(log) as file:
        arrays = {k: file[k] for k in file.files}
    joints = [str(x) for x in arrays["joint_names"]]
    count, rate = len(arrays["time"]), 1.0 / float(np.median(np.diff(arrays["time"])))
    sos = butter(2, min(2.5 * CUT, 0.4 * rate), fs=rate, output="sos")
    q = np.zeros((count, model.nq))
    q[:, [int(model.joint(j).qposadr[0]) for j in joints]] = arrays["qpos"]
    if "base_pos" in arrays:
        q[:, :3], q[:, 3:7] = arrays["base_pos"], arrays["base_quat"]
    q = sosfiltfilt(sos, q, axis=0)
    v = np.zeros((count, model.nv))
    for k in range(count):
        before, after = max(k - 1, 0), min(k + 1, count - 1)
        mujoco.mj_differentiatePos(model, v[k], (after - before) / rate, q[before], q[after])
    dofs = np.array([int(model.joint(j).dofadr[0]) for j in joints])
    applied = np.zeros((count, model.nv))
    applied[:, dofs] = _centred(arrays["tau"])
    jacobians = wrench = None
    contacts = [str(x) for x in arrays.get("contact_bodies", [])]
    if contacts:
        wrench = _centred(arrays["contact_wrench"])
        jacobians = _jacobians(model, q, contacts)
        applied += np.einsum("tcij,tci->tj", jacobians, wrench)
    a = np.gradient(v, 1.0 / rate, axis=0)
    return Motion(
        model, rate, q, v, a, applied, friction, dofs, joints, jacobians, wrench, contacts
    )


def _centred(x: np.ndarray) -> np.ndarray:
    out = x.astype(float)
    out[1:] = 0.5 * (out[1:] + out[:-1])
    return out


def _jacobians(model: mujoco.MjModel, q: np.ndarray, bodies: list[str]) -> np.ndarray:
    """(T, C, 6, nv)."""
    data = mujoco.MjData(model)
    out = np.zeros((len(q), len(bodies), 6, model.nv))
    for k, row in enumerate(q):
        data.qpos[:] = row
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        for i, body in enumerate(bodies):
            mujoco.mj_jacBody(model, data, out[k, i, :3], out[k, i, 3:], model.body(body).id)
    return out


def inverse(m: Motion, model: mujoco.MjModel, at: slice = slice(None)) -> np.ndarray:
    """Torque the model asks for, (T, nv), with Coulomb's friction as F sign(q̇)."""
    data = mujoco.MjData(model)
    rows = np.arange(len(m.q))[at]
    out = np.empty((len(rows), model.nv))
    for i, k in enumerate(rows):
        data.qpos[:], data.qvel[:], data.qacc[:] = m.q[k], m.v[k], m.a[k]
        mujoco.mj_inverse(model, data)
        out[i] = data.qfrc_inverse
    return out + m.friction * np.tanh(m.v[at] / 0.003)


def residual(m: Motion) -> np.ndarray:
    """What the nominal model does not explain, applied less asked for, below 10 Hz: (T, nv)."""
    sos = butter(2, CUT, fs=m.rate, output="sos")
    return sosfiltfilt(sos, m.applied - inverse(m, m.model), axis=0)


def largest(m: Motion, r: np.ndarray) -> str:
    """The joint whose residual is largest, in units of its torque."""
    scale = np.sqrt((m.applied[:, m.dofs] ** 2).mean(0)) + 1e-9
    return m.joints[int(np.argmax(np.sqrt((r[:, m.dofs] ** 2).mean(0)) / scale))]


def _columns(m: Motion):
    """(family, kind, name, columns (T, nv, k)) of every linear candidate, on the thinned grid."""
    at = slice(None, None, max(round(m.rate / THIN), 1))
    q, v, a, tau = m.q[at], m.v[at], m.a[at], m.applied[at]
    count, nv = len(q), m.model.nv
    base = inverse(m, m.model, at)
    rate = np.gradient(m.applied, 1.0 / m.rate, axis=0)[at]

    def on_row(dof: int, *signals: np.ndarray) -> np.ndarray:
        out = np.zeros((count, nv, len(signals)))
        for i, signal in enumerate(signals):
            out[:, dof, i] = signal
        return out

    def changed(edit) -> np.ndarray:
        model = mujoco.MjModel.from_xml_string(_xml(m.model))
        model.dof_frictionloss[:] = 0.0
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
        edit(model)
        return inverse(m, model, at) - base

    for name, dof in zip(m.joints, m.dofs.tolist(), strict=True):
        angle = q[:, int(m.model.joint(name).qposadr[0])]
        speed, one = v[:, dof], np.ones(count)
        sign = np.tanh(speed / 0.01)
        yield "viscous_friction", "joint", name, on_row(dof, speed)
        yield "coulomb_friction", "joint", name, on_row(dof, sign)
        yield (
            "asymmetric_coulomb",
            "joint",
            name,
            on_row(dof, np.maximum(sign, 0), np.minimum(sign, 0)),
        )
        yield "load_friction", "joint", name, on_row(dof, sign, np.abs(tau[:, dof]) * sign)
        yield "armature", "joint", name, on_row(dof, a[:, dof])
        yield "joint_spring", "joint", name, on_row(dof, angle, one)
        yield "torque_bias", "joint", name, on_row(dof, one)
        yield "torque_gain", "joint", name, on_row(dof, tau[:, dof])
    delayed = np.zeros((count, nv, 1))
    delayed[:, m.dofs, 0] = rate[:, m.dofs]
    yield "time_delay", "global", "global", delayed
    g = 9.81
    tilt = [
        changed(lambda x, i=i, s=s: x.opt.gravity.__setitem__(i, s * 0.01 * g))
        for i, s in ((1, 1), (0, -1))
    ]
    yield "gravity_tilt", "global", "global", np.stack(tilt, -1)
    for body in range(1, m.model.nbody):
        name = m.model.body(body).name
        if m.model.body_mass[body] <= 0.0 or not name:
            continue
        mass = changed(lambda x, b=body: x.body_mass.__setitem__(b, 1.1 * x.body_mass[b]))
        shift = [
            changed(lambda x, b=body, i=i: x.body_ipos[b].__setitem__(i, x.body_ipos[b, i] + 1e-3))
            for i in range(3)
        ]
        turn = changed(lambda x, b=body: x.body_inertia.__setitem__(b, 1.1 * x.body_inertia[b]))
        yield "payload", "body", name, np.stack([mass, *shift], -1)
        yield "com_shift", "body", name, np.stack(shift, -1)
        yield "link_inertia", "body", name, turn[..., None]
        force = _jacobians(m.model, q, [name])[:, 0, :3]
        yield "constant_force", "body", name, np.swapaxes(force, 1, 2)
    for i, name in enumerate(m.contacts):
        assert m.jacobians is not None
        assert m.wrench is not None
        own = np.einsum("tij,ti->tj", m.jacobians[at, i], m.wrench[at, i])
        yield "contact_force_scale", "contact", name, own[..., None]


_TEXTS: dict[int, str] = {}


def _xml(model: mujoco.MjModel) -> str:
    return _TEXTS[id(model)]


def greedy(m: Motion, r: np.ndarray, most: int = 3) -> list[tuple[str, str, str]]:
    """Forward selection by n ln RSS + p ln n, all rows alike, one column family at a time."""
    at = slice(None, None, max(round(m.rate / THIN), 1))
    edge = round(0.3 * THIN)
    y = r[at][edge:-edge].ravel()
    sos = butter(2, CUT, fs=THIN, output="sos")
    candidates = []
    for family, kind, name, columns in _columns(m):
        smooth = sosfiltfilt(sos, columns, axis=0)[edge:-edge]
        candidates.append(((family, kind, name), smooth.reshape(len(y), -1)))
    n, chosen, used = len(y), [], np.zeros((len(y), 0))
    score = n * np.log(y @ y)
    while len(chosen) < most:
        best = None
        q, _ = np.linalg.qr(used) if used.shape[1] else (used, None)
        left = y - q @ (q.T @ y)
        for which, columns in candidates:
            rest = columns - q @ (q.T @ columns)
            fit, *_ = np.linalg.lstsq(rest, left, rcond=1e-9)
            error = left - rest @ fit
            new = n * np.log(error @ error) + (used.shape[1] + columns.shape[1]) * np.log(n)
            if best is None or new < best[0]:
                best = (new, which, columns)
        if best is None or best[0] >= score:
            break
        score, which, columns = best
        chosen.append(which)
        used = np.hstack([used, columns])
        candidates = [c for c in candidates if c[0] != which]
    return chosen


def diagnose(folder: Path, method: str) -> dict:
    """A report in the contract's form, as far as such a method can fill it."""
    m = read(folder / "log.npz", folder / "nominal.xml")
    _TEXTS[id(m.model)] = (folder / "nominal.xml").read_text()
    r = residual(m)
    power = (r[:, m.dofs] ** 2).mean(0)
    blamed = ("coulomb_friction", "joint", largest(m, r))
    chosen = [blamed] if method == "coulomb" else greedy(m, r)
    return {
        "schema": 1,
        "verdict": "explained" if chosen else "no_gap",
        "confidence": None,
        "gap": {"share": dict(zip(m.joints, (power / power.sum()).tolist(), strict=True))},
        "effects": [
            {"family": f, "location": {"kind": k, "name": n}, "parameters": {}, "probability": None,
             "equivalent": []}
            for f, k, n in chosen
        ],
        "shrink": {},
    }  # fmt: skip


def _write(folder: Path, out: Path, method: str) -> None:
    start = time.perf_counter()
    report = diagnose(folder, method)
    part = out / f".{folder.name}"
    part.mkdir(parents=True, exist_ok=True)
    (part / "report.json").write_text(json.dumps(report))
    run = {"exit": 0, "seconds": time.perf_counter() - start}
    (part / "run.json").write_text(json.dumps(run))
    part.rename(out / folder.name)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("logs", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--method", choices=METHODS, required=True)
    parser.add_argument("--jobs", type=int, default=1)
    args = parser.parse_args()
    out = args.out / "results"
    out.mkdir(parents=True, exist_ok=True)
    todo = [p for p in sorted(args.logs.iterdir()) if not (out / p.name).exists()]
    with ProcessPoolExecutor(args.jobs, mp_context=get_context("spawn")) as pool:
        running = [pool.submit(_write, p, out, args.method) for p in todo]
        for done in track(as_completed(running), args.method, total=len(running)):
            done.result()


if __name__ == "__main__":
    main()
