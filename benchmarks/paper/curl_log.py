"""The curls' sensors as a log, for `jax-inertia diagnose`: what does the robot's model lack of the "hardware"?

    python -m benchmarks.paper.curl_log FOLDER [--seed 0]

Writes FOLDER/curl.npz (the log contract: 333 Hz, the measured torques, base and foot wrenches of the curls themselves)
and FOLDER/model.xml, the robot as its estimator knows it.
"""

import argparse
from pathlib import Path

import jax
import numpy as np

from benchmarks.paper import curl
from benchmarks.paper.brain import FEET, foot_wrenches
from benchmarks.paper.plant import Fleet, mjcf
from jax_inertia import load_model
from jax_inertia.model.robot import Robot


def sensed(fleet: Fleet) -> dict[str, np.ndarray]:
    """The last millisecond's samples of every sensor, one row a robot."""
    return {
        "q": fleet.q_window[:, -1],
        "v": fleet.v_window[:, -1],
        "tau": fleet.tau_window[:, -1],
        "force": fleet.force_window[:, -1].reshape(fleet.size, -1),
    }


def contract(
    robot: Robot, time: np.ndarray, series: dict[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """One robot's series (T, …) as the arrays of a log."""
    q, v, tau = (np.asarray(series[name], float) for name in ("q", "v", "tau"))
    force = np.asarray(series["force"], float).reshape(len(q), 8, 3)
    wrench = jax.jit(jax.vmap(lambda q, f: foot_wrenches(robot, q, f)))(q, force)
    return {
        "time": time,
        "joint_names": np.array(robot.joint_names[1:]),
        "qpos": q[:, 7:],
        "qvel": v[:, 6:],
        "tau": tau[:, 6:],
        "tau_kind": np.array("sensor"),
        "tau_unit": np.array("N m"),
        "base_pos": q[:, :3],
        "base_quat": q[:, 3:7],
        "base_linvel": v[:, :3],
        "base_angvel": v[:, 3:6],
        "contact_wrench": np.asarray(wrench),
        "contact_bodies": np.array(FEET),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    found = curl.run(np.array([options.seed]), (1,), watch_also=sensed)
    on = found.time >= curl.CURL
    series = {name: found.series[name][on, 0] for name in ("q", "v", "tau", "force")}
    options.folder.mkdir(parents=True, exist_ok=True)
    (options.folder / "model.xml").write_text(mjcf())
    arrays = contract(load_model(curl.model()), found.time[on], series)
    np.savez(options.folder / "curl.npz", **arrays)  # pyright: ignore[reportArgumentType]


if __name__ == "__main__":
    main()
