"""Plain least squares, what an engineer writes in an hour: four terms a joint and the bodies' masses.

    python -m benchmarks.exam.least_squares MODEL LOG OTHER

tau − model = d v + F sign v + I_a a + b at every joint, and a factor of every body's mass, by least squares of the
moving rows; each joint's rows are weighted by what is left of them in a first pass. Prints the error of OTHER's
torques before and after. NumPy, SciPy's filters and MuJoCo's inverse dynamics.
"""

from __future__ import annotations

import sys
from pathlib import Path

import mujoco
import numpy as np

from benchmarks.exam.torque_error import (
    SIGN,
    Predictor,
    Signals,
    needed,
    read,
    rigid,
    signals,
    torque_error,
)


def columns(model: mujoco.MjModel, s: Signals, free_gain: bool = False) -> np.ndarray:
    """(T, n, 4 n + B), or (T, n, 5 n) with a gain of each joint's own torque, before the measure's band."""
    rows, n = s.v.shape
    plain = rigid(model, s.q, s.v, s.a)
    own = np.zeros((rows, n, n, 5))
    for j in range(n):
        terms = s.v[:, j], np.tanh(s.v[:, j] / SIGN), s.a[:, j], np.ones(rows), plain[:, j]
        own[:, j, j] = np.stack(terms, 1)
    if free_gain:
        return own.reshape(rows, n, -1)
    masses = []
    for body in range(1, model.nbody):
        if model.body_weldid[body] != 0 and model.body_mass[body] > 0:
            size = model.body_mass[body].copy(), model.body_inertia[body].copy()
            model.body_mass[body], model.body_inertia[body] = 2 * size[0], 2 * size[1]
            masses.append(rigid(model, s.q, s.v, s.a) - plain)
            model.body_mass[body], model.body_inertia[body] = size
    return np.concatenate([own[..., :4].reshape(rows, n, -1), np.stack(masses, -1)], axis=2)


def fit(model: mujoco.MjModel, log: dict, held: bool = True, free_gain: bool = False) -> Predictor:
    """The fitted model as a predictor.

    `free_gain`: the log holds currents or volts, so each joint's torque has a gain, and masses stay.
    """
    s = signals(model, log, held)
    known = (lambda s: 0.0) if free_gain else lambda s: needed(model, s)
    x, y = s.finish(columns(model, s, free_gain)), s.finish(s.tau - known(s))
    weight = s.kept / np.sqrt((y**2).mean(0) + 1e-12)
    for _ in range(2):
        a = (x * weight[:, :, None]).reshape(-1, x.shape[2])
        scale = np.sqrt((a**2).mean(0)) + 1e-300
        theta = np.linalg.lstsq(a / scale, (y * weight).ravel(), rcond=1e-9)[0] / scale
        left = np.where(s.kept, y - x @ theta, 0.0)
        weight = s.kept / np.sqrt((left**2).sum(0) / np.maximum(s.kept.sum(0), 1) + 1e-12)
    return lambda model, s: known(s) + columns(model, s, free_gain) @ theta


if __name__ == "__main__":
    model = mujoco.MjModel.from_xml_path(sys.argv[1])
    log, other = read(Path(sys.argv[2])), read(Path(sys.argv[3]))
    before, after = (torque_error(model, p, other) for p in (needed, fit(model, log)))
    for name, error in before["per_joint"].items():
        print(f"{name:20s} {error:8.4f} -> {after['per_joint'][name]:8.4f} N m")
    print(f"all {before['rms']:.4f} -> {after['rms']:.4f} N m")
