"""Loads clamped to the last link of a suspended leg or an arm that is told positions, without torque in the log.

    python benchmarks/replay/loads.py draw DATA --n 12 --seed 5
    python benchmarks/replay/loads.py run DATA

`draw` writes folders of log.npz, test.npz, nominal.xml and truth.json; `run` diagnoses each by the command and prints
the table. A load is a small ball at a point of the link, welded to it, so that its place is not the link's centre of
mass. All else is as `generate.py` has it: ordinary physics at every joint that the model lacks, MuJoCo C at 0.5 ms,
friction by a bristle. Half of the logs are of the leg and half of the arm.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import argparse
import dataclasses
import json
import subprocess
import sys
from pathlib import Path

import mujoco
import numpy as np

sys.path.append(str(Path(__file__).resolve().parents[1]))

from replay.draw import ordinary
from replay.evaluator import replayed
from replay.generate import ATTEMPTS, nominal_run, without_torque
from replay.plant import Truth, Unstable, simulate, targets
from replay.robots import ROBOTS, Robot

_TOLD, _SECONDS = 0.02, 14.0
_RADIUS = 0.02
_OF = {
    "leg": ("shank", (0.15, 0.5), ((-0.01, -0.01, -0.21), (0.02, 0.01, -0.06))),
    "arm": ("jaw_link", (0.05, 0.15), ((0.01, -0.01, -0.02), (0.06, 0.02, 0.02))),
}
"""Of each robot, the link, masses [kg], and corners of where the load is in the link's frame [m]."""


def loaded(robot: Robot, body: str, mass: float, at: np.ndarray) -> Robot:
    """The robot with a ball on one link."""
    spec = mujoco.MjSpec.from_string(robot.xml)
    inertia = np.full(3, 0.4 * mass * _RADIUS**2)
    spec.body(body).add_body(
        name="load", pos=at, mass=mass, inertia=inertia, ipos=np.zeros(3), explicitinertial=True
    )
    return dataclasses.replace(robot, xml=spec.to_xml())


def draw(number: int, seed: int, out: Path) -> None:
    """Write one folder."""
    for attempt in range(ATTEMPTS):
        rng = np.random.default_rng([seed, number, attempt])
        robot = ROBOTS[("leg", "arm")[number % 2]]()
        body, masses, (low, high) = _OF[robot.name]
        told = [targets(robot, _SECONDS, rng, _TOLD) for _ in range(2)]
        _, _, typical, inertia = nominal_run(robot, told[0])
        truth = ordinary(robot, Truth.sound(robot), typical, inertia, rng)
        mass, at = float(rng.uniform(*masses)), rng.uniform(low, high)
        other = loaded(robot, body, mass, at)
        rates = (1000, 500) if robot.name == "leg" else (500, 100)
        counts = 2 * np.pi / 2 ** (14 if robot.name == "leg" else 12)
        try:
            logs = [simulate(other, truth, x, _TOLD, *rates, counts) for x in told]
        except Unstable:
            continue
        folder = out / f"{number:05d}"
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "nominal.xml").write_text(robot.xml)
        for name, log in zip(("log", "test"), logs, strict=True):
            np.savez(folder / f"{name}.npz", **without_torque(log))
        said = {"robot": robot.name, "body": body, "mass": mass, "at": at.tolist()}
        (folder / "truth.json").write_text(json.dumps(said, indent=1))
        return
    raise Unstable(f"log {number}: every attempt flew off")


def diagnosed(folder: Path) -> dict:
    """report.json of the command, which never sees test.npz."""
    command = [sys.executable, "-m", "jax_inertia", "diagnose", "log.npz"]
    command += ["--model", "nominal.xml", "--out", "found"]
    subprocess.run(command, cwd=folder, check=True, capture_output=True)
    return json.loads((folder / "found" / "report.json").read_text())


def error_there(folder: Path) -> float:
    """Rms error of found/corrected.xml replayed along test.npz [rad], by a program without code of the package."""
    with np.load(folder / "test.npz") as log:
        names = [str(name) for name in log["joint_names"]]
        motion = log["time"], log["qpos"], log["qpos_target"]
    return float(
        np.sqrt(
            np.mean((replayed(folder / "found" / "corrected.xml", names, *motion) - motion[1]) ** 2)
        )
    )


def line(truth: dict, report: dict, there: float) -> str:
    """One log's row: where, hidden and found mass [kg], other odd effects listed, errors as stated and of test.npz."""
    odd = [e for e in report["effects"] if not e["ordinary"]]
    right = [e for e in odd if (e["family"], e["location"]["name"]) == ("payload", truth["body"])]
    found = "-"
    if right:
        x = right[0]["parameters"]["mass"]
        found = f"{x['value']:.3f} [{x['ci95'][0]:.3f}, {x['ci95'][1]:.3f}]"
    rest = [f"{e['family']} at {e['location']['name']}" for e in odd if e not in right]
    replay = report["shrink"]["replay"]
    ties = [
        f"{e['family']} at {e['location']['name']}" for e in report["effects"]
        for t in e["equivalent"] if (t["family"], t["location"]["name"]) == ("payload", truth["body"])
    ]  # fmt: skip
    cells = (
        truth["robot"], f"{truth['mass']:.3f}", found, ", ".join(rest) or "-", ", ".join(ties) or "-",
        report["verdict"], f"{1e3 * replay['before']:.1f}", f"{1e3 * replay['after']:.2f}", f"{1e3 * there:.2f}",
    )  # fmt: skip
    return "| " + " | ".join(cells) + " |"


def main() -> None:
    """Of the command line."""
    parser = argparse.ArgumentParser()
    parser.add_argument("what", choices=("draw", "run"))
    parser.add_argument("data", type=Path)
    parser.add_argument("--n", type=int, default=12)
    parser.add_argument("--seed", type=int, default=5)
    args = parser.parse_args()
    if args.what == "draw":
        for number in range(args.n):
            draw(number, args.seed, args.data)
        return
    print(
        "| robot | hidden kg | found kg | other odd effects | a tie of | verdict | before | stated after | test mrad |"
    )
    print("|---|---|---|---|---|---|---|---|---|")
    for folder in sorted(x for x in args.data.iterdir() if x.is_dir()):
        truth = json.loads((folder / "truth.json").read_text())
        report = diagnosed(folder)
        print(line(truth, report, error_there(folder)), flush=True)


if __name__ == "__main__":
    main()
