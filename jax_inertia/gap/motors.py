"""Torque noise that no sensor shows: a motor misses its command at random, and the log does not say by how much.

A command is exact, and a current is what the drive believes; what the motor makes of it moves the robot. So where a log
states no noise and what effects leave looks like noise, but is louder than the samples say, each motor's share h² of it
is estimated from the energy on each row,

    e_i − s_i = Σ_j G_ij h_j²,   h ≥ 0

s_i what the sensors' own noise leaves there, G_ij what unit torque noise of joint j does, all in the metric in which
effects are judged.
"""

import dataclasses

import numpy as np
import scipy.optimize
from jaxtyping import Float

from jax_inertia.gap.chain import Prepared, prepare
from jax_inertia.gap.evidence import Evidence
from jax_inertia.gap.sensors import sensor_noise
from jax_inertia.log import Log
from jax_inertia.robot import Robot

DRAWS = 3
# Of a joint's usual torque: a unit of noise for joints whose samples show none.
UNIT = 1e-3


def with_motors(log: Log, robot: Robot, hidden: Float[np.ndarray, " nv"]) -> Log:
    """The log, stating torque noise of its samples and what its motors add, by row [N m]."""
    rows = _rows(log, robot)
    stated = None if log.sigma_tau is None else np.asarray(log.sigma_tau, float)
    own = sensor_noise(np.asarray(log.tau, float), stated)
    return dataclasses.replace(log, sigma_tau=np.hypot(own, hidden[rows]))


def hidden_noise(
    evidence: Evidence,
    left: Float[np.ndarray, " n"],
    replicas: Float[np.ndarray, "K R nv"],
    log: Log,
    prepared: Prepared,
    taken: Float[np.ndarray, " nv"],
) -> tuple[Float[np.ndarray, " nv"], float]:
    """Standard deviation of each row's torque noise beyond the samples' own, by what effects leave [N m].

    With it, by which factor the noise of some row becomes louder or quieter, where it was `taken` for so much [N m].
    """
    rows, robot = _rows(log, prepared.robot), prepared.robot

    def energy(x: Float[np.ndarray, " n"]) -> Float[np.ndarray, " nv"]:
        return np.sum(evidence.unflatten(x) ** 2, axis=0)

    tau = np.asarray(log.tau, float)
    unit = UNIT * np.maximum(np.nanstd(tau, axis=0), 1e-9)
    rng = np.random.default_rng(0)
    gain = np.zeros((robot.nv, len(rows)))
    for _ in range(DRAWS):
        noisy = dataclasses.replace(log, tau=tau + unit * rng.standard_normal(tau.shape))
        torque = prepare(robot, noisy, prepared.settings).tau - prepared.tau
        for k, row in enumerate(rows):
            alone = np.zeros_like(torque)
            alone[:, row] = torque[:, row]
            gain[:, k] += energy(evidence.charged(prepared.finish_torque(alone))) / DRAWS
    sensors = np.mean([energy(evidence.charged(x)) for x in replicas], axis=0)
    there = energy(left)
    seen = there > 0
    # Each row's energy is known to about the same share of itself.
    scale = 1.0 / np.maximum(there, sensors)[seen, None]
    shares, _ = scipy.optimize.nnls(
        scale * gain[seen], (scale[:, 0] * np.maximum(there - sensors, 0.0)[seen])
    )
    out = np.zeros(robot.nv)
    out[rows] = unit * np.sqrt(shares)
    before, after = (
        np.maximum(sensors + gain @ h2, 1e-300)[seen] for h2 in ((taken[rows] / unit) ** 2, shares)
    )
    factor = after / before
    return out, float(np.max(np.maximum(factor, 1.0 / factor), initial=1.0))


def _rows(log: Log, robot: Robot) -> list[int]:
    """The row of each of the log's joints."""
    at = dict(zip(robot.joint_names, robot.joint_dofadr, strict=True))
    return [int(at[name]) for name in log.joint_names]
