"""How far the gap truly shrinks on another motion, beside what a diagnosis measures there, for opened sets.

    python benchmarks/blind/without_noise.py ANSWERS LOGS OUT.json

ANSWERS holds NAME.json (truth), LOGS the folder NAME of each. The test motion is made once more, with a drive and
sensors that have no noise but state what they had. Only the effects are missing there, and how friction turns over:

    true share = 1 − after / before

Logs whose nominal model is off are left out: what is owed to it, and what to the effect, would be a matter of taste.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import numpy as np
from world.draw import hide
from world.make import Bench
from world.plan import Setting
from world.unknowns import UNKNOWN, hide_unknown

from jax_inertia import load_model
from jax_inertia.diagnosis.entry import diagnose
from jax_inertia.diagnosis.result import Diagnosis
from jax_inertia.logs.log import Log
from jax_inertia.logs.log_files import read_log


def without_noise(truth: dict, noisy: Log) -> Log:
    """The test motion of a log as it was, by sensors that have no noise and say that they had."""
    plain: dict[str, Any] = {
        k: tuple(x) if isinstance(x, list) else x for k, x in truth["setting"].items()
    }
    bench = Bench(Setting(**plain))
    scene = bench.scene(bench.rng(4, truth["attempt"]))
    hidden = [(hide_unknown if f in UNKNOWN else hide)(f, scene) for f in plain["families"]]
    bench.take(truth["attempt"])
    had = bench.sensors
    bench.sensors = replace(had, ripple=np.zeros_like(had.ripple))
    clean = {k: x[: len(noisy.time)] for k, x in bench.simulate(hidden, 1).items()}
    order = [bench.nominal.joints.index(name) for name in noisy.joint_names]
    return replace(
        noisy,
        qpos=clean["qpos"][:, order],
        qvel=None,
        tau=clean["tau"][:, order],
        sigma_qpos=had.qpos[order],
        sigma_tau=np.hypot(had.tau, had.ripple)[order],
    )


def shares(folder: Path, truth: dict) -> dict[str, float | None]:
    """Foretold, measured on the noisy test log, and true."""
    robot, log = load_model(str(folder / "nominal.xml")), read_log(folder / "log.npz")
    noisy = read_log(folder / "test.npz")
    measured = diagnose(robot, log, test_log=noisy)
    clean = diagnose(robot, log, test_log=without_noise(truth, noisy))
    return {
        "foretold": measured.heldout.share if measured.found else None,
        "measured": _share(measured),
        "true": _share(clean),
    }


def _share(found: Diagnosis) -> float | None:
    return None if found.test is None or not found.found else found.test.share


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    for name in ("answers", "logs", "out"):
        parser.add_argument(name, type=Path)
    args = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
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
