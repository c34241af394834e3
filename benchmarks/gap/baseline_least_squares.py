"""Plain least squares, what an engineer writes in an hour: four terms a joint and the bodies' masses.

    python benchmarks/gap/baseline_least_squares.py MODEL LOG OTHER

tau − model = d v + F sign v + I_a a + b at every joint, and a factor of every body's mass, by least squares of the
moving rows; each joint's rows are weighted by what is left of them in a first pass. Prints the error of OTHER's
torques before and after. NumPy, SciPy's filters and MuJoCo's inverse dynamics.
"""

from __future__ import annotations

import sys
from pathlib import Path

import mujoco
import numpy as np
from torque_error import SIGN, Predictor, Signals, needed, read, rigid, signals, torque_error


def columns(model: mujoco.MjModel, s: Signals) -> np.ndarray:
    """(T, n, 4 n + B), before the measure's band."""
    rows, n = s.v.shape
    own = np.zeros((rows, n, n, 4))
    for j in range(n):
        own[:, j, j] = np.stack([s.v[:, j], np.tanh(s.v[:, j] / SIGN), s.a[:, j], np.ones(rows)], 1)
    plain, masses = rigid(model, s.q, s.v, s.a), []
    for body in range(1, model.nbody):
        if model.body_weldid[body] != 0 and model.body_mass[body] > 0:
            size = model.body_mass[body].copy(), model.body_inertia[body].copy()
            model.body_mass[body], model.body_inertia[body] = 2 * size[0], 2 * size[1]
            masses.append(rigid(model, s.q, s.v, s.a) - plain)
            model.body_mass[body], model.body_inertia[body] = size
    return np.concatenate([own.reshape(rows, n, -1), np.stack(masses, -1)], axis=2)


def fit(model: mujoco.MjModel, log: dict[str, np.ndarray], held: bool = True) -> Predictor:
    """The fitted model as a predictor; `numbers` holds (n, 4): damping, friction, armature, offset."""
    s = signals(model, log, held)
    x, y = s.finish(columns(model, s)), s.finish(s.tau - needed(model, s))
    weight = s.kept / np.sqrt((y**2).mean(0) + 1e-12)
    for _ in range(2):
        a = (x * weight[:, :, None]).reshape(-1, x.shape[2])
        scale = np.sqrt((a**2).mean(0)) + 1e-300
        theta = np.linalg.lstsq(a / scale, (y * weight).ravel(), rcond=1e-9)[0] / scale
        left = np.where(s.kept, y - x @ theta, 0.0)
        weight = s.kept / np.sqrt((left**2).sum(0) / np.maximum(s.kept.sum(0), 1) + 1e-12)

    def predict(model: mujoco.MjModel, s: Signals) -> np.ndarray:
        return needed(model, s) + columns(model, s) @ theta

    predict.numbers = theta[: 4 * model.nv].reshape(-1, 4)
    return predict


def before_and_after(model: mujoco.MjModel, log: dict, other: dict, held: bool = True) -> dict:
    """The measure on another log, without and with the fit."""
    predict = fit(model, log, held)
    return {
        "before": torque_error(model, needed, other, held),
        "after": torque_error(model, predict, other, held),
        "numbers": predict.numbers.tolist(),
    }


if __name__ == "__main__":
    model = mujoco.MjModel.from_xml_path(sys.argv[1])
    result = before_and_after(model, read(Path(sys.argv[2])), read(Path(sys.argv[3])))
    for name in result["before"]["per_joint"]:
        pair = (result[k]["per_joint"][name] for k in ("before", "after"))
        print("{:20s} {:8.4f} -> {:8.4f} N m".format(name, *pair))
    print(f"all {result['before']['rms']:.4f} -> {result['after']['rms']:.4f} N m")
