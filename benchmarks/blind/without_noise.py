"""How far the gap truly shrinks on another motion, beside what a diagnosis states of its log, for opened sets.

    python benchmarks/blind/without_noise.py ANSWERS LOGS OUT.json

ANSWERS holds NAME.json (truth), LOGS the folder NAME of each. Each log is diagnosed once, by the command, which never
gets the test motion; its files are computed again there by `../gap/report_torque.py`. The test motion is made once
more, with a drive and sensors that have no noise. Only the effects are missing there, and how friction turns over:

    true share = 1 − after / before

Logs whose nominal model is off are left out: what is owed to it, and what to the effect, would be a matter of taste.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

sys.path.append(str(Path(__file__).resolve().parents[1] / "gap"))

import mujoco
import numpy as np
from report_torque import of_folder
from torque_error import needed, read, torque_error
from world.draw import hide
from world.make import Bench
from world.plan import Setting
from world.unknowns import UNKNOWN, hide_unknown


def without_noise(truth: dict, noisy: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The test motion of a log as it was, by sensors without noise."""
    plain: dict[str, Any] = {
        k: tuple(x) if isinstance(x, list) else x for k, x in truth["setting"].items()
    }
    bench = Bench(Setting(**plain))
    scene = bench.scene(bench.rng(4, truth["attempt"]))
    hidden = [(hide_unknown if f in UNKNOWN else hide)(f, scene) for f in plain["families"]]
    bench.take(truth["attempt"])
    had = bench.sensors
    bench.sensors = replace(had, ripple=np.zeros_like(had.ripple))
    clean = {k: x[: len(noisy["time"])] for k, x in bench.simulate(hidden, 1).items()}
    order = [bench.nominal.joints.index(str(name)) for name in noisy["joint_names"]]
    kept = {name: noisy[name] for name in ("time", "joint_names")}
    return kept | {"qpos": clean["qpos"][:, order], "tau": clean["tau"][:, order]}


def shares(folder: Path, truth: dict) -> dict[str, float | None]:
    """By how much the torque error shrinks: foretold on held-out rows, on the noisy test log, and truly."""
    noisy = read(folder / "test.npz")
    model = mujoco.MjModel.from_xml_path(str(folder / "nominal.xml"))
    with tempfile.TemporaryDirectory() as place:
        out = Path(place)
        command = [sys.executable, "-m", "jax_inertia", "diagnose", str(folder / "log.npz")]
        command += ["--model", str(folder / "nominal.xml"), "--out", str(out)]
        subprocess.run(command, check=True, capture_output=True)
        report = json.loads((out / "report.json").read_text())
        told = of_folder(out, folder)

        def share(log: dict[str, np.ndarray]) -> float | None:
            after = told.error(log)["rms"]
            return None if told.left_out else 1.0 - after / torque_error(model, needed, log)["rms"]

        stated = report["shrink"]["heldout"]
        return {
            "foretold": 1.0 - stated["after"] / stated["before"],
            "measured": share(noisy),
            "true": share(without_noise(truth, noisy)),
        }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    for name in ("answers", "logs", "out"):
        parser.add_argument(name, type=Path)
    args = parser.parse_args()
    out: dict[str, dict] = {}
    for file in sorted(args.answers.glob("*.json")):
        truth = json.loads(file.read_text())["truth"]
        arm = truth["setting"]["robot"] in ("two", "six", "seven")
        if arm and truth["effects"] and not truth["setting"]["wrong"]:
            out[file.stem] = shares(args.logs / file.stem, truth)
            print(file.stem, out[file.stem], flush=True)
    args.out.write_text(json.dumps(out, indent=1) + "\n")


if __name__ == "__main__":
    main()
