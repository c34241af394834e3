"""Development data: robots that are told positions.

    python benchmarks/replay/generate.py OUT --n 60 --seed 1 [--first 0]

writes OUT/00042/{nominal.xml, log.npz, test.npz, truth.json}; a diagnosis may see the first two. Log 42 depends on the
seed and 42 alone. Shares no code with the package. Every sixth robot is sound, every sixth has ordinary physics
everywhere and nothing else, three have one odd effect besides (or, of every third, one ordinary number alone), one two.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import argparse
import json
from pathlib import Path

import mujoco
import numpy as np
from draw import ALONE, KINDS, ODD, add, ordinary
from plant import Truth, Unstable, simulate, targets
from robots import ROBOTS, Robot

ATTEMPTS = 12
_TOLD = 0.02


def nominal_run(
    robot: Robot, told: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Of the sound robot: torque and speed that it needs at most, typical torque, and inertia of each joint."""
    run = simulate(robot, Truth.sound(robot), told, _TOLD, 1000, 500, 1e-6)
    speed = np.abs(np.gradient(run["qpos"], run["time"], axis=0))
    model = mujoco.MjModel.from_xml_string(robot.xml)
    data, full = mujoco.MjData(model), np.zeros((model.nv, model.nv))
    data.qpos[:] = robot.middle
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, full)
    torque = run["tau"]
    inertia = np.diagonal(full).copy()
    typical = np.sqrt(np.mean(torque**2, axis=0)) + 0.1 * inertia * 20.0
    return (
        np.percentile(np.abs(torque), 99.5, axis=0),
        np.percentile(speed, 99.5, axis=0),
        typical,
        inertia,
    )


def one(number: int, seed: int, out: Path) -> None:
    """Write one folder, unless it is there."""
    folder = out / f"{number:05d}"
    if (folder / "truth.json").exists():
        return
    for attempt in range(ATTEMPTS):
        rng = np.random.default_rng([seed, number, attempt])
        try:
            made = drawn(number, rng)
        except Unstable:
            continue
        folder.mkdir(parents=True, exist_ok=True)
        robot, logs, truth = made
        (folder / "nominal.xml").write_text(robot.xml)
        for name, log in zip(("log", "test"), logs, strict=True):
            np.savez(folder / f"{name}.npz", **log)
        (folder / "truth.json").write_text(json.dumps(truth, indent=1))
        return
    raise Unstable(f"log {number}: every attempt flew off")


def drawn(number: int, rng: np.random.Generator):
    """(robot, log and test log, what is hidden)."""
    kind = KINDS[number % len(KINDS)]
    robot = ROBOTS[("leg", "arm", "quadruped", "rig")[(number // len(KINDS) + number) % 4]]()
    seconds = 8.0 if robot.name == "quadruped" else 14.0
    told = [targets(robot, seconds, rng, _TOLD) for _ in range(2)]
    asked, fastest, typical, inertia = nominal_run(robot, told[0])
    truth, entries = Truth.sound(robot), []
    if kind == "single" and number % 3 == 1 and rng.random() < 0.5:
        truth, entry = add(robot, truth, str(rng.choice(ALONE)), asked, fastest, typical, rng)
        entries.append(entry)
        kind = "alone"
    elif kind != "sound":
        truth = ordinary(robot, truth, typical, inertia, rng)
    count = {"single": 1, "pair": 2}.get(kind, 0)
    families = rng.permutation(ODD)[:count]
    if kind == "single":
        families = [ODD[(number // 2) % len(ODD)]]
    for family in families:
        truth, entry = add(robot, truth, str(family), asked, fastest, typical, rng)
        entries.append(entry)
    loop_hz, log_hz = (
        int(rng.choice([500, 1000])),
        int(rng.choice([200, 500]) if robot.name != "arm" else 100),
    )
    counts = 2 * np.pi / 2 ** (12 if robot.name == "arm" else 14)
    logs = []
    for x in told:
        log = simulate(robot, truth, x, _TOLD, loop_hz, log_hz, counts)
        log = {k: v for k, v in log.items() if k != "tau"} if number % 4 else log
        logs.append(log)
    numbers = {k: v.tolist() for k, v in vars(truth).items() if k != "mass"}
    said = {
        "robot": robot.name, "kind": kind, "loop_hz": loop_hz, "log_hz": log_hz, "effects": entries,
        "numbers": {k: [x if np.isfinite(x) else None for x in v] for k, v in numbers.items()},
    }  # fmt: skip
    return robot, logs, said


def main() -> None:
    """Of the command line."""
    parser = argparse.ArgumentParser()
    parser.add_argument("out", type=Path)
    parser.add_argument("--n", type=int, default=60)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    for number in range(args.first, args.first + args.n):
        one(number, args.seed, args.out)


if __name__ == "__main__":
    main()
