"""One fit's cost and the steps that lower it.

The cost is the replays' error, output by output in units of what remains of it, every sample counting for its share of
an independent one, and a Gaussian prior about the nominal model:

    Σ_j Σ_t (q̂_tj − q_tj)² / (σ_j² T_j)  +  Σ_j Σ_t (τ̂_tj − τ_tj)² / (σ'_j² T'_j)  +  Σ_p ((θ_p − θ⁰_p) / s_p)²

with T_j the integrated autocorrelation time of joint j's error [samples]; torques τ where they are logged, τ̂ what the
loop gives at the measured positions (`simulate.py`).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from jax_inertia.replay.fitting.errors import Weights, replay_errors, weights
from jax_inertia.replay.loop import Parameter
from jax_inertia.replay.record import Record
from jax_inertia.replay.simulation.plant import Plant

ENOUGH = 2e-3
"""Of the cost, what a step that is worth its replays takes at least."""
_DAMPINGS = (0.0, 0.1), (1e-2, 1.0, 10.0)
"""Of steps: those that are tried first, and the others where these keep less of what they promise than `_KEPT`."""
_KEPT = 0.25
_PROBED = 0.1
"""Of a step, what the bend is taken over."""
_PARTS = np.array([1.0, 0.5, 0.25, 0.1])
"""Of a step along a bent valley that are tried."""


class Step(NamedTuple):
    """Where a step leads."""

    theta: Float[np.ndarray, " P"]
    error: Float[np.ndarray, "N m"]
    gain: float
    """By what share the cost falls."""


class Problem(NamedTuple):
    """What is fitted to what."""

    plant: Plant
    table: tuple[Parameter, ...]
    records: Sequence[Record]
    floor: float | Float[np.ndarray, " m"]
    """Of what remains of each output."""
    free: Bool[np.ndarray, " P"]

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Of each number."""
        return np.array([p.low for p in self.table]), np.array([p.high for p in self.table])

    @property
    def prior(self) -> tuple[np.ndarray, np.ndarray]:
        """Mean and standard deviation of each number; those that stand still have none."""
        mean = np.array([p.mean for p in self.table])
        return mean, np.array([p.sd for p in self.table])

    def errors(self, thetas: Float[np.ndarray, "B P"]) -> Float[np.ndarray, "B N m"]:
        """Of replays."""
        return replay_errors(self.plant, self.table, thetas, self.records)

    def quadratic(self, theta, error, columns) -> "Quadratic":
        """The cost about `theta`."""
        low, high = self.bounds
        w = weights(error, self.floor)
        hessian, gradient = normal(error, columns, w, theta, *self.prior)
        # What stands at a bound and wants beyond stays there.
        held = ~self.free | ((theta <= low) & (gradient > 0)) | ((theta >= high) & (gradient < 0))
        return Quadratic(w, hessian, gradient, np.flatnonzero(~held))

    def gains(self, w: Weights, now: Step, thetas, found) -> Float[np.ndarray, " B"]:
        """By what share of it the cost is less than at `now`."""
        mean, sd = (x[self.free] for x in self.prior)
        before = self._cost(w, now.theta, now.error)
        return (before - _cost(found, w, thetas[:, self.free], mean, sd)) / before

    def step(self, theta, error, columns) -> Step:
        """The best of a few damped steps."""
        about = self.quadratic(theta, error, columns)
        own = about.gradient[about.go]
        h = about.hessian[np.ix_(about.go, about.go)]
        promised = float(own @ np.linalg.solve(h, own)) / self._cost(about.weights, theta, error)
        now = best = Step(theta, error, -np.inf)
        for dampings in _DAMPINGS:
            tries = np.repeat(theta[None], len(dampings), axis=0)
            for new, damping in zip(tries, dampings, strict=True):
                new[about.go] -= np.linalg.solve(h + damping * np.diag(np.diagonal(h)), own)
            best = self._best(about.weights, now, tries, best)
            if best.gain > _KEPT * promised or promised < ENOUGH:
                break
        return best

    def bent_step(self, theta, error, columns) -> Step:
        """The best of some parts of an undamped step that bends as its valley does; none where it promises little.

        v = −H⁻¹ g and, with r_vv the error's second derivative along v, a = −H⁻¹ Jᵀ W r_vv: θ + s v + s² a / 2
        (geodesic acceleration; Transtrum and Sethna 2012). `columns` have to be exact where numbers are hardly known.
        """
        about = self.quadratic(theta, error, columns)
        inverse = np.linalg.inv(about.hessian[np.ix_(about.go, about.go)])
        v, a = np.zeros((2, len(theta)))
        v[about.go] = -inverse @ about.gradient[about.go]
        promised = -float(about.gradient @ v) / self._cost(about.weights, theta, error)
        now = Step(theta, error, 0.0)
        if promised < ENOUGH:
            return now
        sides = self.errors(theta + _PROBED * np.stack([v, -v]))
        bend = (sides[0] - 2.0 * error + sides[1]) / _PROBED**2
        flat = (columns * about.weights.root).reshape(len(theta), -1)
        a[about.go] = -inverse @ (flat @ (bend * about.weights.root).ravel())[about.go]
        tries = theta + _PARTS[:, None] * v + 0.5 * _PARTS[:, None] ** 2 * a
        return self._best(about.weights, now, tries, now)

    def _cost(self, w: Weights, theta, error) -> float:
        mean, sd = (x[self.free] for x in self.prior)
        return float(_cost(error[None], w, theta[None, self.free], mean, sd)[0])

    def _best(self, w: Weights, now: Step, tries, best: Step) -> Step:
        """Of some vectors, within their bounds, and of one that is known."""
        tries = np.clip(tries, *self.bounds)
        found = self.errors(tries)
        gains = self.gains(w, now, tries, found)
        k = int(np.argmax(gains))
        return Step(tries[k], found[k], float(gains[k])) if gains[k] > best.gain else best


class Quadratic(NamedTuple):
    """The cost about some numbers: half its second derivative and gradient, and which numbers may move."""

    weights: Weights
    hessian: Float[np.ndarray, "P P"]
    gradient: Float[np.ndarray, " P"]
    go: np.ndarray


def normal(error, jacobian, w: Weights, theta, mean, sd) -> tuple[np.ndarray, np.ndarray]:
    """Half the cost's second derivative, and half its gradient."""
    flat = (jacobian * w.root).reshape(len(theta), -1)
    prior = 1.0 / sd**2
    away = np.where(np.isfinite(theta), theta - mean, 0.0)
    gradient = flat @ (error * w.root).ravel() + prior * away
    return flat @ flat.T + np.diag(prior), gradient


def _cost(error, w: Weights, thetas, mean, sd) -> np.ndarray:
    return np.sum((error * w.root) ** 2, axis=(1, 2)) + np.sum(((thetas - mean) / sd) ** 2, axis=1)
