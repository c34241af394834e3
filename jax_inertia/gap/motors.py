"""Torque noise that a log does not state, as it shows in what effects leave.

The roughness of a torque's samples does not tell it. A command is exact, and what the motor makes of it moves the
robot: a motor that misses it at random makes more noise than the samples show. A controller writes its encoders' noise
into its commands: that moves the robot too, and is no noise of the torque at all. So where a log states none, each
joint's share h² is estimated from the energy on each row in each of a few bands of frequency,

    e_i − s_i = Σ_j G_ij h_j²,   h ≥ 0

s_i what the other sensors' noise leaves there, G_ij what unit torque noise of joint j does, all in the metric in which
effects are judged. An encoder is heard by its second difference, where it is fast; a torque also where the motion is.

What a log states is the least there is: it is of the sensor. A command that changes between two samples of the log,
as a loop's does that is quicker than its log, acts as the robot's torque and is not in it; such noise is no louder than
the samples are rough.
"""

import dataclasses

import numpy as np
import scipy.optimize
from jaxtyping import Float

from jax_inertia.gap.evidence import Evidence
from jax_inertia.gap.noise import arithmetic
from jax_inertia.logs.log import Log
from jax_inertia.model.robot import Robot
from jax_inertia.signals.bands import smooth_order
from jax_inertia.signals.sensor_noise import sensor_noise
from jax_inertia.signals.torque_residual import Prepared, prepare

DRAWS = 3
# Of a joint's usual torque: a unit of noise for joints whose samples show none.
UNIT = 1e-3
# How well the energy of noise is known on a row where chance says nothing, as a share of it.
EXACT = 0.1
# How often the energies that are expected, which the fit is weighted by, are computed again.
TURNS = 3


def by_samples(log: Log, robot: Robot) -> Float[np.ndarray, " nv"]:
    """Standard deviation of each row's torque noise as the log states it or its samples show it [N m]."""
    stated = None if log.sigma_tau is None else np.asarray(log.sigma_tau, float)
    out = np.zeros(robot.nv)
    out[_rows(log, robot)] = sensor_noise(
        np.asarray(log.tau, float), stated, smooth_order(log.rate)
    )
    return out


def with_torque_noise(log: Log, robot: Robot, noise: Float[np.ndarray, " nv"] | None) -> Log:
    """The log, stating `noise` of each row's torque [N m]; as it is where nothing was learned of it (None).

    What the log states itself is believed: it is no less than that.
    """
    if noise is None:
        return log
    own = noise[_rows(log, robot)]
    if log.sigma_tau is not None:
        own = np.maximum(own, np.asarray(log.sigma_tau, float))
    return dataclasses.replace(log, sigma_tau=own)


def torque_noise(
    evidence: Evidence,
    left: Float[np.ndarray, " n"],
    replicas: Float[np.ndarray, "K R nv"],
    log: Log,
    prepared: Prepared,
    taken: Float[np.ndarray, " nv"],
    *,
    louder: bool,
) -> tuple[Float[np.ndarray, " nv"], float]:
    """Standard deviation of each row's torque noise, by what effects leave [N m].

    With it, by which factor the noise of some row becomes louder, or quieter where the log states none of its torques:
    they were `taken` for so much in `replicas` [N m]. `louder`: whether what is left may be all noise; else it only
    says how loud that is at most.
    """
    rows, robot = _rows(log, prepared.robot), prepared.robot

    tau = np.asarray(log.tau, float)
    unit = UNIT * np.maximum(np.nanstd(tau, axis=0), 1e-9)
    rng = np.random.default_rng(0)

    def energies(torque: Float[np.ndarray, "R nv"]) -> Float[np.ndarray, " i"]:
        return evidence.by_band(evidence.charged(torque)).ravel()

    def mean(draws: Float[np.ndarray, "K R nv"]) -> Float[np.ndarray, " i"]:
        return np.mean([energies(x) for x in draws], axis=0)

    there = evidence.by_band(left).ravel()
    gain = np.zeros((len(there), len(rows)))
    for _ in range(DRAWS):
        noisy = dataclasses.replace(log, tau=tau + unit * rng.standard_normal(tau.shape))
        torque = prepare(robot, noisy, prepared.bands).tau - prepared.tau
        for k, row in enumerate(rows):
            alone = np.zeros_like(torque)
            alone[:, row] = torque[:, row]
            gain[:, k] += energies(prepared.finish_torque(alone)) / DRAWS
    now = mean(replicas)
    chain = mean(arithmetic(prepared, rng, replicas.shape))
    before = (taken[rows] / unit) ** 2
    # The chain's arithmetic is seldom as bad as it is taken for.
    others = np.maximum(now - chain - gain @ before, 0.0)
    seen = (there > 0) & (now > 0)
    # Each energy is known to a share of itself: what chance leaves of so many cosines, about one unit each, and the
    # chain's own errors.
    share = np.sqrt(EXACT**2 + 2.0 / np.maximum(now[seen], 1.0))
    target = np.maximum(there - others, 0.0)[seen]
    least, most = 0.0, np.inf if louder else np.maximum(before, 1e-12)
    if log.sigma_tau is not None:
        least = (sensor_noise(tau, log.sigma_tau) / unit) ** 2
        rough = (sensor_noise(tau, order=smooth_order(log.rate)) / unit) ** 2
        most = np.maximum(np.minimum(most, rough), (1.0 + 1e-6) * least + 1e-12)

    def solved(expected: Float[np.ndarray, " i"]) -> Float[np.ndarray, " j"]:
        scale = 1.0 / (np.maximum(expected, 1e-300) * share)
        scaled = scale[:, None] * gain[seen]
        return scipy.optimize.lsq_linear(scaled, scale * target, (least, most)).x

    shares = solved(np.maximum(there, others)[seen])
    for _ in range(TURNS):
        # By chance some are low: weighted by what was seen they would count for more.
        shares = solved((others + gain @ shares)[seen])
    out = np.zeros(robot.nv)
    out[rows] = unit * np.sqrt(shares)
    # In one band alone the model's own misses may be louder than noise.
    then, now = (x.reshape(-1, robot.nv).sum(axis=0) for x in (others + chain + gain @ shares, now))
    factor = then[now > 0] / now[now > 0]
    quieter = 1.0 / factor if log.sigma_tau is None else 0.0
    return out, float(np.max(np.maximum(factor, quieter), initial=1.0))


def _rows(log: Log, robot: Robot) -> list[int]:
    """The row of each of the log's joints."""
    at = dict(zip(robot.joint_names, robot.joint_dofadr, strict=True))
    return [int(at[name]) for name in log.joint_names]
