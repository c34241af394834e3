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
import sys
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

# Under its package's name: beside other benchmarks `plant` and `robots` are others.
sys.path.append(str(Path(__file__).resolve().parents[1]))

from replay.draw import ALONE, KINDS, ODD, add, ordinary
from replay.plant import Truth, Unstable, simulate, targets
from replay.robots import ROBOTS, Robot

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


@dataclass
class Drawn:
    """A robot with all that is hidden in it, and what it is told."""

    robot: Robot
    kind: str
    truths: list[Truth]
    """Before the first odd effect, and after each."""
    entries: list[dict]
    """The odd effects, as truth.json has them."""
    told: tuple[np.ndarray, np.ndarray]
    loop_hz: int
    log_hz: int
    counts: float

    def log(self, which: int, effects: int | None = None) -> dict[str, np.ndarray]:
        """The log of motion 0 or 1, of the robot with its first `effects` odd effects, else all; `Unstable`."""
        return self.run(self.truths[-1 if effects is None else effects], which)

    def run(self, truth: Truth, which: int, seconds: float = np.inf) -> dict[str, np.ndarray]:
        """The same of any robot, the first `seconds` of it; `Unstable`."""
        told = self.told[which]
        told = told[: int(min(seconds / _TOLD, len(told) - 1)) + 1]
        rates = self.loop_hz, self.log_hz
        return simulate(self.robot, truth, told, _TOLD, *rates, self.counts)

    def said(self) -> dict:
        """What truth.json holds."""
        numbers = {k: v.tolist() for k, v in vars(self.truths[-1]).items() if k != "mass"}
        return {
            "robot": self.robot.name, "kind": self.kind, "loop_hz": self.loop_hz, "log_hz": self.log_hz,
            "effects": self.entries,
            "numbers": {k: [x if np.isfinite(x) else None for x in v] for k, v in numbers.items()},
        }  # fmt: skip


def without_torque(log: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The log of a drive that says none."""
    return {k: v for k, v in log.items() if k != "tau"}


def one(number: int, seed: int, out: Path) -> None:
    """Write one folder, unless it is there."""
    folder = out / f"{number:05d}"
    if (folder / "truth.json").exists():
        return
    for attempt in range(ATTEMPTS):
        rng = np.random.default_rng([seed, number, attempt])
        try:
            made = drawn(number, rng)
            logs = [made.log(which) for which in (0, 1)]
        except Unstable:
            continue
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "nominal.xml").write_text(made.robot.xml)
        for name, log in zip(("log", "test"), logs, strict=True):
            np.savez(folder / f"{name}.npz", **(without_torque(log) if number % 4 else log))
        (folder / "truth.json").write_text(json.dumps(made.said(), indent=1))
        return
    raise Unstable(f"log {number}: every attempt flew off")


def drawn(
    number: int, rng: np.random.Generator, robot: Robot | None = None, seconds: float | None = None
) -> Drawn:
    """What log `number` holds, on the robot whose turn it is, or on another; as long as usual, or `seconds`."""
    kind = KINDS[number % len(KINDS)]
    if robot is None:
        turn = (number // len(KINDS) + number) % 4
        robot = ROBOTS[("leg", "arm", "quadruped", "rig")[turn]]()
    seconds = seconds or (8.0 if len(robot.joints) > 7 else 14.0)
    told = targets(robot, seconds, rng, _TOLD), targets(robot, seconds, rng, _TOLD)
    asked, fastest, typical, inertia = nominal_run(robot, told[0])
    truth, effects = Truth.sound(robot), []
    if kind == "single" and number % 3 == 1 and rng.random() < 0.5:
        effects = [str(rng.choice(ALONE))]
        kind = "alone"
    else:
        if kind != "sound":
            truth = ordinary(robot, truth, typical, inertia, rng)
        effects = [str(x) for x in rng.permutation(ODD)[: {"single": 1, "pair": 2}.get(kind, 0)]]
        if kind == "single":
            effects = [ODD[(number // 2) % len(ODD)]]
    truths, entries = [truth], []
    for family in effects:
        truth, entry = add(robot, truths[-1], family, asked, fastest, typical, rng)
        truths.append(truth)
        entries.append(entry)
    if kind == "alone":
        rng.permutation(ODD)  # As of every other log: what is drawn after it keeps its place.
    loop_hz = int(rng.choice([500, 1000]))
    log_hz = int(rng.choice([200, 500]) if robot.name != "arm" else 100)
    counts = 2 * np.pi / 2 ** (12 if robot.name == "arm" else 14)
    return Drawn(robot, kind, truths, entries, told, loop_hz, log_hz, counts)


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
