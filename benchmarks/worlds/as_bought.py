"""Robots as they are bought, with every joint's friction and rotor missing in the model.

    python -m benchmarks.worlds.as_bought OUT --n 60 --seed 1 [--first 0] [--jobs 1]

writes OUT/00042/{nominal.xml, log.npz, test.npz, truth.json}; a diagnosis may see all but the last two. Log 42 depends
on the seed and 42 alone; a second call skips what is complete. Shares no code with the package.

Of ten robots six have one odd effect of the library (`odd.ODD`), one has an effect no library has, three have
nothing but the ordinary: friction (LuGre), rotor inertia and small torque offsets at every joint, masses 2 %, centres
1 mm, inertias 5 % off the drawing (1 sigma).
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
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from benchmarks.worlds import truth as nearest_truth
from benchmarks.worlds.effects import Effect
from benchmarks.worlds.hidden import Hidden, as_drawn, draw_ordinary, good_model, nominal_run
from benchmarks.worlds.joint_physics import STEP
from benchmarks.worlds.motions import make_motion
from benchmarks.worlds.odd import ODD, OUTSIDE, DrawOdd, equivalents
from benchmarks.worlds.plant import Noise, Plant, Unstable
from benchmarks.worlds.setting import (
    NUMBER,
    PINOCCHIO,
    JointLoop,
    Setting,
    draw_noise,
    draw_setting,
)

ATTEMPTS, FURTHER = 10, 5


def draw_kind(seed: int, index: int) -> str:
    """Family of the odd effect, mechanism of one outside the library, or nothing."""
    rng = np.random.default_rng([seed, NUMBER, index, 2])
    order = np.random.default_rng([seed, NUMBER, 1]).permutation(ODD)
    chance = rng.random()
    if chance < 0.6:  # round the list, so that every family comes
        before = sum(
            np.random.default_rng([seed, NUMBER, i, 2]).random() < 0.6 for i in range(index)
        )
        return str(order[before % len(order)])
    return str(rng.choice(OUTSIDE)) if chance < 0.7 else ""


def _plant(s: Setting, hidden: Hidden) -> Plant:
    model = hidden.model(s.real)
    if s.engine == PINOCCHIO:
        from benchmarks.worlds.pinocchio_plant import (  # Pinocchio, which most logs do without.
            PinocchioPlant,
            Slips,
        )

        return PinocchioPlant(s.robot, model, hidden.effects(Slips))
    plant = Plant(s.robot, model, hidden.effects())
    plant.finest = STEP
    return plant


def simulate(s: Setting, hidden: Hidden, which: int, noise: Noise, preroll: float = 1.0) -> dict:
    """One clean log (with the noise beside it) of motion 0 (log), 1 (test) or 2 (validation)."""
    plant = _plant(s, hidden)
    kind = (*s.kinds, "exciting")[which]
    motion = make_motion(s.robot, kind, [*s.seed, 3, which])
    duration = (s.duration, s.test_duration, s.test_duration)[which]
    run = nominal_run(s.robot, kind, [*s.seed, 3, which], 4.0)
    loop = JointLoop(s, run.inertia + hidden.armature, hidden.law)
    rng = np.random.default_rng([*s.seed, 4, which])
    start = motion(-preroll)[:2]
    log = plant.run(loop, motion, start, s.rate, duration, noise, rng, preroll)
    rows = round(duration * s.rate)
    log["noise"] = {k: x[:rows] for k, x in log["noise"].items()}
    return {k: x[:rows] if k != "noise" else x for k, x in log.items()}


def to_contract(s: Setting, log: dict, noise: Noise) -> dict[str, np.ndarray]:
    """The log as a diagnosis gets it."""
    order = np.arange(len(s.robot.joints))
    if s.options["shuffle"]:
        order = np.random.default_rng([*s.seed, 5]).permutation(order)
    q = log["qpos"] + log["noise"]["qpos"]
    step = 2 * np.pi / s.counts if s.counts else 0.0
    out = {
        "time": log["time"],
        "qpos": (np.round(q / step) * step if step else q)[:, order],
        "tau": (log["tau"] + log["noise"]["tau"])[:, order],
    }
    if s.options["qvel"]:
        out["qvel"] = (log["qvel"] + log["noise"]["qvel"])[:, order]
    out = {name: np.ascontiguousarray(x) for name, x in out.items()}
    out["joint_names"] = np.array(s.robot.joints)[order]
    out["tau_kind"] = np.array(s.options["tau_kind"])
    if s.options["sigma"]:
        out["sigma_qpos"] = np.hypot(noise.qpos, step / np.sqrt(12))[order]
        out["sigma_tau"] = np.hypot(noise.tau, noise.ripple)[order]
    return out


def draw_hidden(s: Setting, kind: str, attempt: int) -> Hidden:
    rng = np.random.default_rng([*s.seed, 6, attempt])
    run = nominal_run(s.robot, s.kinds[0], [*s.seed, 3, 0], s.duration)
    hidden = draw_ordinary(s.robot, run, rng)
    if s.good:
        hidden = as_drawn(hidden)
    if kind:
        DrawOdd(s.robot, run, hidden, rng, s.duration).make(kind)
    return hidden


@dataclass
class Made:
    """One robot's log and other motion, the model a diagnosis gets, and the truth; perhaps a third run."""

    log: dict[str, np.ndarray]
    test: dict[str, np.ndarray]
    nominal: str
    truth: dict
    validation: dict[str, np.ndarray] | None = None


def make(seed: int, index: int) -> Made:
    return simulated(draw_setting(seed, index), draw_kind(seed, index))


def simulated(s: Setting, kind: str) -> Made:
    """Both logs with one odd effect, or none where `kind` is empty; drawn again where the loop loses the motion."""
    reason = "never tried"
    for attempt in range(ATTEMPTS):
        hidden = draw_hidden(s, kind, attempt)
        noise = draw_noise(s, hidden.scale)
        try:
            log = simulate(s, hidden, 0, noise)
            seen = nearest_truth.judge(s.real, hidden, log, noise, s.rate)
            if kind and s.window and attempt < FURTHER:
                low, high = s.window
                if not low <= seen["visibility"]["sigmas"] <= high:
                    continue
            test, *more = (simulate(s, hidden, k, noise) for k in (1, 2)[: 1 + s.validation])
        except Unstable as error:
            reason = str(error)
            s.bandwidth = max(0.8 * s.bandwidth, 6.0)
            continue
        truth = describe(s, hidden, seen, noise, test, attempt)
        nominal = s.robot.xml
        if s.good:
            nominal = good_model(s.robot, hidden, np.random.default_rng([*s.seed, 7]))
        logs = to_contract(s, log, noise), to_contract(s, test, noise)
        return Made(*logs, nominal, truth, *(to_contract(s, x, noise) for x in more))
    raise RuntimeError(f"log {s.seed[-1]}: {kind or 'none'} on {s.robot.name}: {reason}")


def describe(s: Setting, hidden: Hidden, seen: dict, noise: Noise, test, attempt: int) -> dict:
    """truth.json; `seen`: `truth.judge` of the log."""
    other = nearest_truth.judge(s.real, hidden, test, noise, s.rate)
    odd: Effect | None = hidden.odd
    entry = None
    if odd is not None:
        entry = odd.truth() | {
            "equivalent": equivalents(s.robot, odd),
            "visibility": seen["visibility"],
            "visibility_on_test": other["visibility"],
        }
    law = {
        k: dict(zip(s.robot.joints, map(float, v), strict=True))
        for k, v in vars(hidden.law).items()
    }
    # True and small at ordinary joints: a tool that lists them has invented nothing.
    present = [
        {"family": family, "location": {"kind": "joint", "name": j}}
        for family, key in (("stribeck_friction", "excess"), ("load_friction", "load"))
        for j, size in law[key].items()
        if size > 0
    ]
    return {
        "schema": 1,
        "stratum": "cad",
        "robot": s.robot.name,
        "engine": s.engine,
        "joints": nearest_truth.joint_terms(s.real, hidden, seen, other),
        "odd": entry,
        "present": present,
        "ordinary_visibility": seen["visibility"] if odd is None else None,
        "law": law
        | {"presliding": dict(zip(s.robot.joints, map(float, hidden.presliding), strict=True))},
        "inertials": hidden.inertials,
        "scale": dict(zip(s.robot.joints, map(float, hidden.scale), strict=True)),
        "motion": {"log": s.kinds[0], "test": s.kinds[1]},
        "rate_hz": s.rate,
        "duration_s": s.duration,
        "test_duration_s": s.test_duration,
        "bandwidth_rad_s": s.bandwidth,
        "encoder_counts": s.counts,
        "noise": {k: np.asarray(v).tolist() for k, v in vars(noise).items()},
        "options": s.options,
        "seed": s.seed,
        "attempt": attempt,
    }


def write(out: Path, seed: int, index: int) -> str:
    """One log on disk, whole or not at all."""
    begun, folder = time.time(), out / f"{index:05d}"
    if (folder / "truth.json").exists():
        return "there already"
    made = make(seed, index)
    truth = made.truth
    texts = {"nominal.xml": made.nominal, "truth.json": json.dumps(truth, indent=1)}
    write_folder(folder, made.log, made.test, texts)
    odd = truth["odd"]
    told = (
        f"{odd.get('mechanism', odd['family'])}@{odd['location']['name']} "
        f"{odd['visibility']['sigmas']:.1f} sigma"
        if odd
        else "none"
    )
    return f"{truth['robot']} {truth['rate_hz']} Hz {told} ({time.time() - begun:.1f} s)"


def write_folder(
    folder: Path, log: dict, test: dict, texts: dict[str, str], validation: dict | None = None
) -> None:
    """log.npz, test.npz, perhaps validation.npz, and files of text, by name."""
    part = folder.with_name(f".{folder.name}.{os.getpid()}")
    part.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(part / "log.npz", allow_pickle=False, **log)
    np.savez_compressed(part / "test.npz", allow_pickle=False, **test)
    if validation:
        np.savez_compressed(part / "validation.npz", allow_pickle=False, **validation)
    for name, text in texts.items():
        (part / name).write_text(text)
    if folder.exists():
        shutil.rmtree(folder)
    part.rename(folder)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--n", type=int, default=60, help="number of logs")
    parser.add_argument("--first", type=int, default=0, help="index of the first log")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=1)
    args = parser.parse_args()
    failed = 0
    with ProcessPoolExecutor(args.jobs, mp_context=get_context("spawn")) as pool:
        indices = range(args.first, args.first + args.n)
        jobs = {pool.submit(write, args.out, args.seed, k): k for k in indices}
        for done, job in enumerate(as_completed(jobs), start=1):
            try:
                line = job.result()
            except RuntimeError as error:
                failed, line = failed + 1, f"skipped: {error}"
            print(f"[{done}/{args.n}] {jobs[job]:05d} {line}", flush=True)
    if failed:
        raise SystemExit(f"{failed} of {args.n} logs could not be drawn")


if __name__ == "__main__":
    main()
