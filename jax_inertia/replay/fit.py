"""The numbers of a replay that fits: Gauss–Newton over MuJoCo replays, all columns of a Jacobian in one call.

The cost is the replays' error, joint by joint in units of what remains of it, every sample counting for its share of
an independent one, and a Gaussian prior about the nominal model:

    Σ_j Σ_t (q̂_tj − q_tj)² / (σ_j² T_j)  +  Σ_p ((θ_p − θ⁰_p) / s_p)²

with T_j the integrated autocorrelation time of joint j's error [samples]. Replays of a position-controlled robot
do not drift apart: the whole log is one shot, and no velocities have to be guessed between.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from jax_inertia.replay.loop import Parameter
from jax_inertia.replay.simulate import Plant, Record

ROUNDS = 12
_ENOUGH = 2e-3
_DAMPINGS = (0.0, 1e-2, 0.1, 1.0, 10.0)
_DIFFERENCE = 0.02
# Of the log, for the first look at kp and delay [s].
_LOOK = 12.0
_GUESSED = np.array([-5.0, -4.5, -4.0, -3.5, -3.0, -2.4, -1.8, -1.2, -0.6, 0.0])
_SAID = np.array([-0.8, -0.4, -0.2, 0.0, 0.2])
_DELAYS = (0.0, 0.015, 0.03, 0.06, 0.12)


class Fit(NamedTuple):
    """Numbers that fit, and how well they are known."""

    table: tuple[Parameter, ...]
    theta: Float[np.ndarray, " P"]
    covariance: Float[np.ndarray, "P P"]
    hessian: Float[np.ndarray, "P P"]
    """Half the second derivative of the cost, prior included."""
    samples: float
    """How many independent samples the errors are worth."""
    rms: Float[np.ndarray, " n"]

    @property
    def sigma(self) -> Float[np.ndarray, " P"]:
        """Standard deviations."""
        return np.sqrt(np.diagonal(self.covariance))


class Weights(NamedTuple):
    """What an error of a joint counts: remaining rms σ [rad] and autocorrelation time T [samples]."""

    sigma: Float[np.ndarray, " n"]
    correlated: Float[np.ndarray, " n"]

    @property
    def root(self) -> Float[np.ndarray, " n"]:
        """The square root of one sample's weight."""
        return 1.0 / (self.sigma * np.sqrt(self.correlated))


def errors(
    plant: Plant,
    table: Sequence[Parameter],
    thetas: Float[np.ndarray, "B P"],
    records: Sequence[Record],
) -> Float[np.ndarray, "B N n"]:
    """Replay minus log of every vector, all records one after the other, where they count [rad]."""
    return np.concatenate(
        [(plant.replay(table, thetas, r) - r.q)[:, r.settled] for r in records], axis=1
    )


def weights(error: Float[np.ndarray, "N n"], floor: float) -> Weights:
    """From an error as it is."""
    sigma = np.maximum(np.sqrt(np.mean(error**2, axis=0)), floor)
    return Weights(sigma, np.array([autocorrelation_time(e) for e in error.T]))


def autocorrelation_time(x: Float[np.ndarray, " N"]) -> float:
    """1 + 2 Σ ρ_k up to the first k where ρ is not positive, as in Geyer 1992 [samples]."""
    n = len(x)
    power = np.abs(np.fft.rfft(x, 2 * n)) ** 2
    rho = np.fft.irfft(power)[: n // 2]
    if not rho[0] > 0:
        return 1.0
    rho = rho / rho[0]
    last = int(np.argmax(rho <= 0)) if np.any(rho <= 0) else len(rho)
    return float(1.0 + 2.0 * np.sum(rho[1:last]))


def start(
    plant: Plant, table: Sequence[Parameter], records: Sequence[Record], guessed: bool
) -> Float[np.ndarray, " P"]:
    """The nominal numbers, with the kp of each joint and the delay whose replays of the first seconds err least.

    A least-squares step does not find its way over an order of magnitude of kp, nor over a period of the motion.
    """
    theta = np.array([p.nominal for p in table])
    gains = [k for k, p in enumerate(table) if p.family == "kp_scale"]
    late = next(
        (k for k, p in enumerate(table) if p.family == "target_delay" and p.joint < 0), None
    )
    scales = _GUESSED if guessed else _SAID
    delays = (0.0,) if late is None else _DELAYS
    tries = np.repeat(theta[None], len(scales) * len(delays), axis=0)
    for k, (d, s) in enumerate((d, s) for d in delays for s in scales):
        tries[k, gains] = s
        if late is not None:
            tries[k, late] = d
    short = [r.between(0, int(np.searchsorted(r.time, _LOOK))) for r in records]
    square = np.mean(errors(plant, table, tries, short) ** 2, axis=1).reshape(
        len(delays), len(scales), -1
    )
    # Joints in units of their own best.
    relative = np.log(square + 1e-8)
    best = int(np.argmin(relative.min(axis=1).sum(axis=-1)))
    theta[gains] = scales[np.argmin(relative[best], axis=0)][[table[k].joint for k in gains]]
    if late is not None:
        theta[late] = delays[best]
    return theta


def fit(
    plant: Plant,
    table: Sequence[Parameter],
    records: Sequence[Record],
    theta: Float[np.ndarray, " P"],
    *,
    free: Bool[np.ndarray, " P"] | None = None,
    floor: float = 1e-4,
    rounds: int = ROUNDS,
    progress: Callable[[str], None] = lambda text: None,
) -> Fit:
    """Gauss–Newton from `theta`; numbers that are not free stay where they are."""
    low, high = (np.array([getattr(p, side) for p in table]) for side in ("low", "high"))
    mean, sd = np.array([p.nominal for p in table]), np.array([p.sd for p in table])
    free = np.ones(len(table), bool) if free is None else free
    theta = np.clip(theta, low, high)
    for k in range(rounds):
        progress(f"fitting replays, round {k + 1}")
        error, columns = derivatives(plant, table, records, theta, free)
        w = weights(error, floor)
        hessian, gradient = normal(error, columns, w, theta, mean, sd)
        # What stands at a bound and wants beyond stays there.
        held = ~free | ((theta <= low) & (gradient > 0)) | ((theta >= high) & (gradient < 0))
        go = np.flatnonzero(~held)
        tries = []
        for damping in _DAMPINGS:
            h = hessian[np.ix_(go, go)]
            step = np.zeros(len(table))
            step[go] = -np.linalg.solve(h + damping * np.diag(np.diagonal(h)), gradient[go])
            tries.append(np.clip(theta + step, low, high))
        costs = _cost(errors(plant, table, np.array(tries), records), w, np.array(tries), mean, sd)
        now = _cost(error[None], w, theta[None], mean, sd)[0]
        best = int(np.argmin(costs))
        if not costs[best] < now:
            break
        theta = tries[best]
        if now - costs[best] < _ENOUGH * now:
            break
    return _told(plant, table, records, theta, free, floor)


def _told(plant, table, records, theta, free, floor) -> Fit:
    """How well the numbers are known: the wider, number by number, of two ways to allow for errors that last.

    One counts samples by their autocorrelation; the other is the sandwich H⁻¹ Σ_b g_b g_bᵀ H⁻¹ over blocks b of the
    log, which is a jackknife over them to first order.
    """
    mean, sd = np.array([p.nominal for p in table]), np.array([p.sd for p in table])
    error, columns = derivatives(plant, table, records, theta, free)
    w = weights(error, floor)
    hessian, _ = normal(error, columns, w, theta, mean, sd)
    go = np.flatnonzero(free)
    inverse = np.linalg.inv(hessian[np.ix_(go, go)])
    length = int(max(2.0 * np.max(w.correlated), 1.0 / records[0].period))
    blocks = max(len(error) // length, 1)
    white, rest, scores = columns * w.root, error * w.root, []
    for rows in np.array_split(np.arange(len(error)), blocks):
        scores.append(np.einsum("ptj,tj->p", white[go][:, rows], rest[rows]))
    meat = np.array(scores).T @ np.array(scores)
    sandwich = inverse @ meat @ inverse
    wider = np.sqrt(np.maximum(np.diagonal(sandwich) / np.diagonal(inverse), 1.0))
    covariance = np.zeros((len(table),) * 2)
    covariance[np.ix_(go, go)] = np.minimum(np.outer(wider, wider), 1e6) * inverse
    samples = float(np.sum(len(error) / w.correlated))
    return Fit(
        tuple(table), theta, covariance, hessian, samples, np.sqrt(np.mean(error**2, axis=0))
    )


def derivatives(plant, table, records, theta, free) -> tuple[np.ndarray, np.ndarray]:
    """Error (N, n) and its derivatives (P, N, n), by differences as wide as the encoders can see."""
    steps = np.array([_DIFFERENCE * (p.sd if np.isfinite(p.sd) else 1.0) for p in table])
    steps = np.maximum(
        steps, _DIFFERENCE * np.abs(theta) * np.array([p.family not in _LOG for p in table])
    )
    steps = np.where(theta + steps > np.array([p.high for p in table]), -steps, steps)
    go = np.flatnonzero(free)
    thetas = np.repeat(theta[None], len(go) + 1, axis=0)
    thetas[np.arange(len(go)) + 1, go] += steps[go]
    out = errors(plant, table, thetas, records)
    jacobian = np.zeros((len(table), *out.shape[1:]))
    jacobian[go] = (out[1:] - out[0]) / steps[go, None, None]
    return out[0], jacobian


_LOG = ("kp_scale", "torque_saturation")


def normal(error, jacobian, w: Weights, theta, mean, sd) -> tuple[np.ndarray, np.ndarray]:
    """Half the cost's second derivative, and half its gradient."""
    flat = (jacobian * w.root).reshape(len(theta), -1)
    prior = 1.0 / sd**2
    gradient = flat @ (error * w.root).ravel() + prior * (theta - mean)
    return flat @ flat.T + np.diag(prior), gradient


def _cost(error, w: Weights, thetas, mean, sd) -> np.ndarray:
    return np.sum((error * w.root) ** 2, axis=(1, 2)) + np.sum(((thetas - mean) / sd) ** 2, axis=1)
