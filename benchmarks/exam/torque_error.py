"""The measure that every tool is judged by: what a model gets wrong of a log's torque [N m].

One chain for both sides: a 40 Hz zero-phase low-pass of positions and torques, derivatives by central differences,
physics in MuJoCo C at 250 Hz at most, then 10 Hz on both sides. Counted are the rows in which a joint moves
(|v| > 0.02 rad/s, at rest dry friction may be anything), without half a second at both ends. `away` counts those alone
that are 0.1 s from any rest: the 10 Hz filter spreads what happens there. Nothing here imports the package under test.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from scipy.signal import butter, sosfiltfilt

BAND, SIGNALS, GRID = 10.0, 40.0, 250.0  # Hz
MOVING, SIGN, EDGE, REACH = 0.02, 0.003, 0.5, 0.1  # rad/s, rad/s, s, s


@dataclass(frozen=True)
class Signals:
    """A log in the model's order, even in time, low-passed at 40 Hz; arrays (T, n)."""

    time: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    tau: np.ndarray
    kept: np.ndarray
    """Which rows count."""

    @property
    def dt(self) -> float:
        return float(self.time[1] - self.time[0])

    def derived(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        v = np.gradient(q, self.dt, axis=0)
        return v, np.gradient(v, self.dt, axis=0)

    def finish(self, x: np.ndarray) -> np.ndarray:
        """The measure's band."""
        return low_pass(x, BAND, 1.0 / self.dt)


def low_pass(x: np.ndarray, cutoff: float, rate: float) -> np.ndarray:
    """Zero phase, along time."""
    return sosfiltfilt(butter(4, min(cutoff, 0.4 * rate), fs=rate, output="sos"), x, axis=0)


def read(path: Path) -> dict[str, np.ndarray]:
    with np.load(path) as file:
        return {name: file[name] for name in file.files}


def signals(model: mujoco.MjModel, log: dict[str, np.ndarray], held: bool = True) -> Signals:
    """`held`: row k's torque acts from there to the next row, so it is centred half a sample later."""
    time = np.asarray(log["time"], float)
    rate = 1.0 / float(np.median(np.diff(time)))
    even = np.arange(time[0], time[-1], 1.0 / rate)
    names = [str(x) for x in log["joint_names"]]
    order = [names.index(model.joint(j).name) for j in range(model.njnt)]
    sampled = lambda x: np.stack([np.interp(even, time, x[:, k]) for k in order], 1)  # noqa: E731
    tau = np.array(log["tau"], float)
    if held:
        tau[1:] = 0.5 * (tau[1:] + tau[:-1])
    q, tau = (low_pass(sampled(x), SIGNALS, rate) for x in (log["qpos"], tau))
    v = np.gradient(q, 1.0 / rate, axis=0)
    a = np.gradient(v, 1.0 / rate, axis=0)
    thin = slice(None, None, max(1, int(rate / GRID + 0.01)))
    kept = np.abs(v) > MOVING
    edge = round(EDGE * rate)
    kept[:edge] = kept[-edge:] = False
    return Signals(even[thin], q[thin], v[thin], a[thin], tau[thin], kept[thin])


def rigid(model: mujoco.MjModel, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Inverse dynamics in MuJoCo C (T, n): bodies, armature, damping, springs; no constraint of any kind."""
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    data, out = mujoco.MjData(model), np.empty_like(v)
    for k in range(len(q)):
        data.qpos[:], data.qvel[:], data.qacc[:] = q[k], v[k], a[k]
        mujoco.mj_inverse(model, data)
        out[k] = data.qfrc_inverse
    return out


def needed(model: mujoco.MjModel, s: Signals) -> np.ndarray:
    """Torque that a model asks for (T, n): its dry friction is F tanh(v / 0.003)."""
    return rigid(model, s.q, s.v, s.a) + model.dof_frictionloss * np.tanh(s.v / SIGN)


Predictor = Callable[[mujoco.MjModel, Signals], np.ndarray]
"""Model and signals to the torque that the log should hold, at the joint and before the measure's band (T, n)."""


def torque_error(
    model: mujoco.MjModel, predictor: Predictor, log: dict[str, np.ndarray], held: bool = True
) -> dict:
    """Of tau − predicted: {"rms": all joints' moving rows together [N m], "per_joint", "rows", "away"}."""
    s = signals(model, log, held)
    return error_of(model, s, s.tau - predictor(model, s))


def error_of(model: mujoco.MjModel, s: Signals, missing: np.ndarray) -> dict:
    """The measure of a residual on the grid of `signals`."""
    e = np.where(s.kept, s.finish(missing), 0.0)
    rows = s.kept.sum(0)
    names = [model.joint(j).name for j in range(model.njnt)]
    per = np.sqrt((e**2).sum(0) / np.maximum(rows, 1))
    away = s.kept & ~near_rest(s)
    return {
        "rms": float(np.sqrt((e**2).sum() / max(rows.sum(), 1))),
        "away": float(np.sqrt((e**2 * away).sum() / max(away.sum(), 1))),
        "per_joint": dict(zip(names, map(float, per), strict=True)),
        "rows": dict(zip(names, map(int, rows), strict=True)),
    }


def near_rest(s: Signals) -> np.ndarray:
    """Rows within 0.1 s of one in which the joint rests (T, n)."""
    window = np.ones(2 * round(REACH / s.dt) + 1)
    rest = np.abs(s.v) <= MOVING
    return np.stack([np.convolve(x, window, "same") > 0.5 for x in rest.T], 1)
