"""How large a log's sensor noise is, as it states or as its samples show, and the log with as much of it once more."""

import dataclasses
import math
from functools import partial

import numpy as np
from jaxtyping import Float

from jax_inertia.logs.log import AnyArray, Log
from jax_inertia.signals.bands import smooth_order


def stated(log: Log) -> bool:
    """Whether the log says how large its sensors' noise is."""
    return log.sigma_tau is not None and log.sigma_qpos is not None


# Of the usual third difference: what is beyond is an impact.
IMPACT = 6.0


def sensor_noise(
    x: Float[np.ndarray, "T n"], stated: AnyArray | None = None, order: int = 3
) -> Float[np.ndarray, " n"]:
    """Standard deviation of one sample of each channel: as stated, or from its differences and its steps.

    Motion is smooth at the log's rate, white noise is not: Δ³ has variance 20 σ². A slow log needs another `order`
    (`bands.smooth_order`), whose variance is C(2n, n) σ². Impacts, beyond `IMPACT` of what most
    samples show, do not count; heavier tails than a Gaussian's, which a median would miss, do. A converter's steps of
    width s are a noise of s/√12 at least, also where motion is so slow that most samples repeat the one before.
    """
    if stated is not None:
        return np.broadcast_to(np.asarray(stated, float), x.shape[1:])
    x = np.asarray(x, float)
    high = np.abs(np.diff(x, n=order, axis=0))
    usual = np.nanmedian(np.where(np.isfinite(high), high, np.nan), axis=0) / 0.6745
    counted = high <= IMPACT * usual
    rough = np.sqrt(
        (high**2).sum(axis=0, where=counted)
        / np.maximum(counted.sum(axis=0), 1)
        / math.comb(2 * order, order)
    )
    steps = np.array([resolution(channel) for channel in x.T])
    return np.maximum(rough, steps / np.sqrt(12.0))


# Samples of a stretch, and what the third differences of a lower quartile of them show of Gaussian noise's spread.
STRETCH, LOWER = 25, 0.84


def quiet_noise(x: Float[np.ndarray, "T n"]) -> Float[np.ndarray, " n"]:
    """`sensor_noise` of forces that set in and ring for a good part of the time: as quiet as a quarter of a log shows.

    Stretches that repeat one value say nothing: a foot is in the air.
    """
    everywhere = sensor_noise(x)
    third = np.diff(np.asarray(x, float), n=3, axis=0)
    count = len(third) // STRETCH
    stretches = third[: count * STRETCH].reshape(count, STRETCH, -1)
    loud = np.sqrt(np.mean(stretches**2, axis=1) / 20.0)
    telling = np.all(stretches != 0.0, axis=1)
    out = everywhere.copy()
    for k in np.flatnonzero(telling.sum(axis=0) >= 4):
        quiet = np.quantile(loud[telling[:, k], k], 0.25) / LOWER
        # Of a foot that is in the air most of the time, most samples show nothing.
        out[k] = min(quiet, everywhere[k] or quiet)
    return out


def resolution(x: Float[np.ndarray, " T"]) -> float:
    """The step of a channel whose values are multiples of one; zero where they are not."""
    apart = np.diff(np.unique(x[np.isfinite(x)]))
    if len(apart) < LEVELS:
        return 0.0
    step = float(apart.min())
    multiples = apart / step
    return step if np.median(np.abs(multiples - np.round(multiples))) < ON_STEP else 0.0


# Fewer values than this are a signal that hardly moves. How far from a multiple of a step the values usually lie.
LEVELS, ON_STEP = 8, 0.02


def perturbed(log: Log, rng: np.random.Generator) -> Log:
    """The log with its sensors' noise added once more."""

    order = smooth_order(log.rate)

    def more(x, of=None):
        x = np.asarray(x, float)
        flat = x.reshape(len(x), -1)
        sigma = sensor_noise(flat, order=order) if of is None else of(flat)
        return (flat + sigma * rng.standard_normal(flat.shape)).reshape(x.shape)

    changes = {
        "qpos": more(log.qpos, partial(sensor_noise, stated=log.sigma_qpos, order=order)),
        "tau": more(log.tau, partial(sensor_noise, stated=log.sigma_tau, order=order)),
    }
    for name in ("base_pos", "base_quat", "base_linvel", "base_angvel", "base_linacc"):
        if (value := getattr(log, name)) is not None:
            changes[name] = more(value)
    if log.contact_wrench is not None:
        changes["contact_wrench"] = more(log.contact_wrench, quiet_noise)
    return dataclasses.replace(log, **changes)
