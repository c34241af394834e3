"""What the chain makes of sensor noise, and the whitener that makes one unit of it everywhere.

Replicas of the log with the sensors' noise added once more go through the whole chain; the difference from the log's
own missing torque is the noise of y. An autoregression per row and the covariance of its innovations then whiten: the
energy of a whitened sample reads about one where there is nothing but noise. Residual energy above that is the gap.
"""

import dataclasses

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float
from scipy import linalg

from jax_inertia.logs.log import Log
from jax_inertia.signals.sensor_noise import perturbed
from jax_inertia.signals.torque_residual import Prepared, prepare

ORDER = 3
# The chain's own arithmetic (interpolation, differences) is no better than this share of a row's torque.
FLOOR = 5e-4
# Of a row's innovation, what no others can tell.
LEAST_OWN = 0.05
# The noise's own misfit is known to this factor.
NOISE_ERROR = 1.3
# Where the log does not state its noise and what is left is not at random, a motor may have missed its command by more
# than the log can show.
NOISE_UNSTATED = 4.0


def known_to(known: bool) -> float:
    """The factor to which a log's noise is known, by whether it is stated or found to be what it was taken for."""
    return NOISE_ERROR if known else NOISE_UNSTATED


class Stage(eqx.Module):
    """Autoregression along time, and how its innovations go together across rows."""

    coefficients: Float[np.ndarray, "nv order"]
    covariance: Float[np.ndarray, "nv nv"]


class Whitener(eqx.Module):
    """One stage from the sensors' noise, and a second where a model is worse than its sensors."""

    sigma: Float[np.ndarray, " nv"]
    """Standard deviation of y's noise, before whitening [N m]."""
    stages: tuple[Stage, ...]

    @property
    def of_misses(self) -> bool:
        """Whether what the model misses a robot by is part of the noise."""
        return len(self.stages) > 1

    def over(self, used: Bool[np.ndarray, "R nv"]) -> "Whitening":
        """For torques of which only what is `used` counts."""
        return Whitening(self, used)

    def then(self, left: Float[np.ndarray, "R nv"], used: Bool[np.ndarray, "R nv"]) -> "Whitener":
        """Whiten further, to what is `left` of a log that this whitener and the best fit have been through.

        Where a model misses a robot by far more than the sensors' noise, its misses are the noise that effects and
        tolerances compete against: taken for signal, they buy masses that no robot has.
        """
        return Whitener(self.sigma, (*self.stages, stage_of(left[None], used, quietest=1.0)))


class Whitening:
    """A whitener on one log, where at each moment other rows may count.

    What does not count tells nothing of the others either: at each moment the covariance is that of the rows that do.
    """

    def __init__(self, whitener: Whitener, used: Bool[np.ndarray, "R nv"]):
        patterns, self._which = np.unique(used, axis=0, return_inverse=True)
        self._stages = [
            (s.coefficients, np.stack([_triangle(s.covariance, p) for p in patterns]))
            for s in whitener.stages
        ]

    def __call__(self, x: Float[np.ndarray, "R nv *k"]) -> Float[np.ndarray, "R nv *k"]:
        """Whiten finished torques; zero where they do not count."""
        wide = np.array(x, float).reshape(*x.shape[:2], -1)
        for stage in range(len(self._stages)):
            wide = self._along_and_across(wide, stage)
        return wide.reshape(x.shape)

    def one_row(self, x: Float[np.ndarray, "R k"], row: int) -> Float[np.ndarray, "R nv k"]:
        """`__call__` for columns that are zero on all rows but one."""
        coefficients, triangles = self._stages[0]
        out = _innovations(np.array(x, float), coefficients[row][:, None])
        wide = triangles[self._which, :, row][:, :, None] * out[:, None, :]
        for stage in range(1, len(self._stages)):
            wide = self._along_and_across(wide, stage)
        return wide

    def _along_and_across(self, x: np.ndarray, stage: int) -> np.ndarray:
        coefficients, triangles = self._stages[stage]
        live = x.any(axis=(0, 2))
        out = _innovations(x[:, live], coefficients.T[:, live, None])
        return triangles[:, :, live][self._which] @ out


def with_all_before(used: Bool[np.ndarray, "R nv"]) -> Bool[np.ndarray, "R nv"]:
    """Which samples are used, and so are all those before them that their innovation leans on."""
    out = used.copy()
    for lag in range(1, ORDER + 1):
        out[lag:] &= used[:-lag]
    out[:ORDER] = False
    return out


def _innovations(x: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """x less its prediction from the samples before, coefficients by lag; the first see zeros before them."""
    out = x.copy()
    for lag, c in enumerate(coefficients, start=1):
        out[lag:] -= c * x[:-lag]
    return out


def _triangle(covariance: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Inverse Cholesky factor for the rows that count, zero elsewhere."""
    out = np.zeros_like(covariance)
    at = np.ix_(counts, counts)
    if counts.any():
        out[at] = linalg.inv(linalg.cholesky(covariance[at], lower=True))
    return out


def whitener(
    prepared: Prepared, log: Log, *, replicas: int = 6, seed: int = 0
) -> tuple[Whitener, Float[np.ndarray, "K R nv"], Prepared]:
    """The whitener of a log's missing torque, the noise replicas it was made from, and the last noisy log itself."""
    rng = np.random.default_rng(seed)
    own = prepared.finish_torque(prepared.missing)
    draws, noisy = [], prepared
    for _ in range(replicas):
        noisy = _with_friction_of(
            prepared, prepare(prepared.robot, perturbed(log, rng), prepared.bands, rng)
        )
        draws.append(noisy.finish_torque(noisy.missing) - own)
    noise = np.array(draws)
    noise = noise + arithmetic(prepared, rng, noise.shape)
    sigma = np.sqrt(np.mean(noise**2, axis=(0, 1)))
    everywhere = np.ones(noise.shape[1:], bool)
    return Whitener(sigma, (stage_of(noise, everywhere),)), noise, noisy


def arithmetic(
    prepared: Prepared, rng: np.random.Generator, shape: tuple[int, ...]
) -> Float[np.ndarray, "K R nv"]:
    """Draws of what the chain's own arithmetic adds to finished torques at most [N m]."""
    size = np.sqrt(np.mean(prepared.finish_torque(prepared.inverse) ** 2, axis=0))
    floor = FLOOR * np.maximum(size, 1e-3 * size.max(initial=1e-9)) + 1e-9
    return floor * rng.standard_normal(shape)


def _with_friction_of(own: Prepared, noisy: Prepared) -> Prepared:
    """A noisy log with dry friction as in the log itself: where that turns over is uncertain, but not noise.

    Charged as noise, moments of reversal would count for all the moments between them.
    """
    return dataclasses.replace(
        noisy, inverse=noisy.inverse - noisy.dry + own.dry, dry=own.dry, rest=own.rest
    )


def stage_of(
    noise: Float[np.ndarray, "K R nv"], used: Bool[np.ndarray, "R nv"], quietest: float = 0.0
) -> Stage:
    """The stage that whitens K draws of noise where it counts; no row's innovations are taken below `quietest`."""
    nv = noise.shape[2]
    noise = noise * used
    together = [used[k:] & used[: len(used) - k] for k in range(ORDER + 1)]
    coefficients = np.zeros((nv, ORDER))
    for j in range(nv):
        lags = [
            np.sum(noise[:, k:, j] * noise[:, : noise.shape[1] - k, j]) / max(both[:, j].sum(), 1)
            for k, both in enumerate(together)
        ]
        if lags[0] > 0:
            coefficients[j] = linalg.solve_toeplitz(lags[:-1], lags[1:])
    innovation = _innovations(np.moveaxis(noise, 0, 2), coefficients.T[:, :, None])
    whole = with_all_before(used)
    flat = np.moveaxis(innovation * whole[:, :, None], 2, 0).reshape(-1, nv)
    counts = len(noise) * (whole.T.astype(float) @ whole)
    covariance = flat.T @ flat / np.maximum(counts, 1.0)
    size = np.sqrt(np.diagonal(covariance))
    if quietest:
        # One log says less of how its rows go together than of how large each is.
        correlation = 0.8 * covariance / np.maximum(np.outer(size, size), 1e-300)
        np.fill_diagonal(correlation, 1.0)
        correlation = _definite(correlation)
        size = np.maximum(size, quietest)
        covariance = correlation * np.outer(size, size)
    return Stage(coefficients, covariance)


def _definite(correlation: Float[np.ndarray, "n n"]) -> Float[np.ndarray, "n n"]:
    """A correlation as it is, or the nearest that is one: rows that seldom move together may contradict each other."""
    values, vectors = linalg.eigh(correlation)
    if values[0] > LEAST_OWN:
        return correlation
    mended = (vectors * np.maximum(values, LEAST_OWN)) @ vectors.T
    size = np.sqrt(np.diagonal(mended))
    return mended / np.outer(size, size)
