"""What the sensors make of a clean log, and the arrays of the contract that a diagnosis gets.

Every number is rounded to a power of two below its noise, as encoders and converters do; that also keeps files small.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from world.describe import Machine

GRAIN = 0.6
"""Converters step by no more than this share of their noise's standard deviation."""


@dataclass
class Sensors:
    """Standard deviations (SI) and habits of one robot's sensors, drawn once for both motions.

    `ripple` is torque noise that the drive adds without reporting it. `law`: normal, laplace or spikes. `drops`: share
    of rows in which one encoder repeats its last sample. `coarse`: encoder step that exceeds its noise (rad), or 0.
    """

    qpos: np.ndarray
    qvel: np.ndarray
    tau: np.ndarray
    ripple: np.ndarray
    base: np.ndarray
    wrench: np.ndarray
    law: str
    drops: float
    coarse: float
    kind: str
    with_qvel: bool
    with_sigma: bool
    with_aim: bool
    order: np.ndarray

    def draw(self, rng: np.random.Generator, *shape: int) -> np.ndarray:
        """Noise of unit standard deviation (spikes: but for one in a thousand)."""
        if self.law == "laplace":
            return rng.laplace(scale=np.sqrt(0.5), size=shape)
        out = rng.normal(size=shape)
        if self.law == "spikes":
            out = np.where(rng.random(shape) < 1e-3, 8.0 * out, out)
        return out


def draw_sensors(
    machine: Machine, peak: np.ndarray, loud: float, rng: np.random.Generator
) -> Sensors:
    """Encoders of 8e-6 to 1e-4 rad, torques of 0.15 to 0.5 % of the motion's peak, times `loud`."""
    n = len(machine.joints)
    qpos = loud * np.exp(rng.uniform(np.log(8e-6), np.log(1e-4))) * np.ones(n)
    coarse = float(2.0 ** rng.integers(-15, -12)) if rng.random() < 0.12 else 0.0
    if coarse:
        qpos = np.full(n, coarse / np.sqrt(12.0))
    tau = loud * rng.uniform(0.0015, 0.005) * np.maximum(peak, 0.05 * machine.peak)
    kind = str(rng.choice(["commanded", "current", "sensor"], p=[0.45, 0.35, 0.2]))
    silent = np.zeros(n)
    order = np.arange(n)
    if rng.random() < 0.2:
        order = rng.permutation(n)
    return Sensors(
        qpos=qpos,
        qvel=qpos * rng.uniform(15.0, 40.0),
        tau=silent if kind == "commanded" else tau,
        ripple=tau if kind == "commanded" else silent,
        base=loud * np.repeat([2e-4, 2e-4, 3e-3, 3e-3], 3) * rng.uniform(0.4, 1.0),
        wrench=loud * np.repeat([0.2, 0.004], 3) * rng.uniform(0.6, 1.5),
        law=str(rng.choice(["normal", "laplace", "spikes"], p=[0.6, 0.25, 0.15])),
        drops=float(rng.uniform(5e-4, 3e-3)) if rng.random() < 0.06 else 0.0,
        coarse=coarse,
        kind=kind,
        with_qvel=bool(not coarse and rng.random() < 0.3),
        with_sigma=bool(rng.random() < 0.6),
        with_aim=bool(rng.random() < 0.1),
        order=order,
    )


def rounded(x: np.ndarray, below: float) -> np.ndarray:
    """To the largest power of two not above `below`, as float32."""
    step = 2.0 ** np.floor(np.log2(below))
    return (np.round(x / step) * step).astype(np.float32)


def to_contract(
    machine: Machine, log: dict, s: Sensors, duration: float, rng: np.random.Generator
) -> dict[str, np.ndarray]:
    """The arrays of one log, always in this order."""
    rate = 1.0 / float(log["time"][1] - log["time"][0])
    rows, n = round(duration * rate), len(machine.joints)
    cut = {k: v[:rows] for k, v in log.items()}
    fine = 0.8 * float(s.qpos.min())
    noise = 0.0 if s.coarse else s.draw(rng, rows, n) * s.qpos
    qpos = cut["qpos"] + noise
    qvel = cut["qvel"] + s.draw(rng, rows, n) * s.qvel
    if s.drops:
        for j in range(n):
            for k in np.flatnonzero(rng.random(rows - 1) < s.drops) + 1:
                qpos[k, j], qvel[k, j] = qpos[k - 1, j], qvel[k - 1, j]
    tau = cut["tau"] + s.draw(rng, rows, n) * s.tau
    step = GRAIN * np.hypot(s.tau, s.ripple)
    tau = np.stack([rounded(x, b) for x, b in zip(tau.T, step, strict=True)], axis=1)
    o = s.order
    out = {
        "time": cut["time"],
        "joint_names": np.array(machine.joints)[o],
        "qpos": rounded(qpos, s.coarse or fine)[:, o],
        "tau": tau[:, o],
        "tau_kind": np.array(s.kind),
    }
    if s.with_qvel:
        out["qvel"] = rounded(qvel, GRAIN * float(s.qvel.min()))[:, o]
    if s.with_aim:
        out["qpos_target"] = rounded(cut["qpos_target"], fine)[:, o]
    if machine.floating:
        base = _noisy_base(cut["base"], s.draw(rng, rows, 12) * s.base)
        out["base_pos"], out["base_quat"] = (
            rounded(base[:, :3], GRAIN * s.base[0]),
            rounded(base[:, 3:7], 0.5 * GRAIN * s.base[3]),
        )
        out["base_linvel"] = rounded(base[:, 7:10], GRAIN * s.base[6])
        out["base_angvel"] = rounded(base[:, 10:], GRAIN * s.base[9])
        wrench = cut["wrench"] + s.draw(rng, rows, len(machine.sensed), 6) * s.wrench
        step = GRAIN * s.wrench
        out["contact_wrench"] = np.stack(
            [rounded(wrench[..., i], float(step[i])) for i in range(6)], axis=-1
        )
        out["contact_bodies"] = np.array(machine.sensed)
    if s.with_sigma:
        out["sigma_qpos"] = np.hypot(s.qpos, 0.0 if s.coarse else fine / np.sqrt(12.0))[o]
        out["sigma_tau"] = np.hypot(s.tau, s.ripple)[o]
    # Columns one after the other compress better.
    return {k: np.asfortranarray(v) if v.ndim > 1 else v for k, v in out.items()}


def _noisy_base(base: np.ndarray, noise: np.ndarray) -> np.ndarray:
    out = base.copy()
    out[:, :3] += noise[:, :3]
    w, x, y, z = base[:, 3:7].T
    dx, dy, dz = 0.5 * noise[:, 3:6].T
    out[:, 3:7] += np.stack(
        [-x * dx - y * dy - z * dz, w * dx + y * dz - z * dy, w * dy + z * dx - x * dz,
         w * dz + x * dy - y * dx], axis=1
    )  # fmt: skip
    out[:, 3:7] /= np.linalg.norm(out[:, 3:7], axis=1, keepdims=True)
    out[:, 7:] += noise[:, 6:]
    return out
