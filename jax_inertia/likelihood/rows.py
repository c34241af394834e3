"""A linear model of what replays err by, of any likelihood: rows, what they weigh, and sums over them."""

import abc
from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jax_inertia.likelihood.columns import Number
from jax_inertia.likelihood.evidence import Normal
from jax_inertia.maths.sample_weight import autocorrelation_time


class Weights(NamedTuple):
    """What an error of each joint counts: rms σ of noise and discrepancy [rad], and its correlation time [samples]."""

    sigma: Float[np.ndarray, " n"]
    correlated: Float[np.ndarray, " n"]

    @property
    def root(self) -> Float[np.ndarray, " n"]:
        """Square root of one sample's weight."""
        return 1.0 / (self.sigma * np.sqrt(self.correlated))


class Rows(NamedTuple):
    """A linear model of the errors of all runs about θ, and its sums over the samples that count, joint by joint."""

    theta: Float[np.ndarray, " P"]
    error: list[Float[np.ndarray, "T n"]]
    columns: list[Float[np.ndarray, "T n P"]]
    counts: list[Float[np.ndarray, "T n"]]
    information: Float[np.ndarray, "n P P"]
    """Σ D Dᵀ."""

    @staticmethod
    def of(
        theta: Float[np.ndarray, " P"],
        error: Sequence[Float[np.ndarray, "T n"]],
        columns: list[Float[np.ndarray, "T n P"]],
        counts: list[Float[np.ndarray, "T n"]],
    ) -> "Rows":
        """With their sums."""
        information = np.zeros((counts[0].shape[1], len(theta), len(theta)))
        for d, c in zip(columns, counts, strict=True):
            for j in range(d.shape[1]):
                own = d[:, j] * c[:, j, None]
                # Most numbers move no other leg.
                live = np.flatnonzero(own.any(axis=0))
                information[j][np.ix_(live, live)] += own[:, live].T @ own[:, live]
        return Rows(theta, list(error), columns, counts, information)

    def left(self, theta: Float[np.ndarray, " P"]) -> list[np.ndarray]:
        """The errors at other numbers."""
        change = theta - self.theta
        return [e - d @ change for e, d in zip(self.error, self.columns, strict=True)]

    def normal(
        self, weights: "Weights", error: Sequence[Float[np.ndarray, "T n"]] | None = None
    ) -> Normal:
        """Normal equations of numbers measured from zero: of r + D θ, with `error` in place of the rows' own."""
        square, pull = np.zeros(len(weights.root)), np.zeros(self.information.shape[:2])
        for e, d, c in zip(error or self.error, self.columns, self.counts, strict=True):
            pull += np.einsum("tj,tjp->jp", e * c, d, optimize=True)
            square += np.sum(e * e * c, axis=0)
        w = weights.root**2
        about = self.information @ self.theta
        square = square + 2.0 * pull @ self.theta + about @ self.theta
        return Normal(np.tensordot(w, self.information, 1), w @ (pull + about), float(w @ square))


class Likelihood(abc.ABC):
    """Runs of a robot, numbers that its model may be off by, and a simulator.

    `floor` is what encoders leave of each output's error, rms; `counts` has 1 for each sample that counts, run by run.
    """

    def __init__(
        self,
        numbers: Sequence[Number],
        floor: Float[np.ndarray, " n"],
        counts: Sequence[Float[np.ndarray, "T n"]],
    ):
        self.numbers, self.floor, self.counts = tuple(numbers), np.asarray(floor), [*counts]

    @abc.abstractmethod
    def errors(self, thetas: Float[np.ndarray, "B P"]) -> list[Float[np.ndarray, "B T n"]]:
        """Measured minus replayed of every vector, run by run."""

    @abc.abstractmethod
    def rows(
        self,
        theta: Float[np.ndarray, " P"],
        errors: Sequence[Float[np.ndarray, "T n"]],
        *,
        along_replay: bool = False,
        asked: Collection[int] | None = None,
    ) -> Rows:
        """The errors' linear model about θ; where some numbers are `asked` about, columns of all others are 0."""

    @abc.abstractmethod
    def delayed(self, delays: Sequence[float]) -> list[list[Float[np.ndarray, "T n"]]]:
        """What targets later by each of some delays do, about the last `rows`; for each, run by run."""

    def squares(
        self, errors: Sequence[Float[np.ndarray, "B T n"]], weights: Weights
    ) -> Float[np.ndarray, " B"]:
        """Σ of weighted squares of errors, of every vector."""
        parts = [
            np.sum(((e * weights.root) ** 2) * c, axis=(1, 2))
            for e, c in zip(errors, self.counts, strict=True)
        ]
        return np.sum(parts, axis=0)

    def rms(self, errors: Sequence[Float[np.ndarray, "T n"]]) -> Float[np.ndarray, " n"]:
        """Of each joint, over samples that count [rad]."""
        square = sum(np.sum(e**2 * c, axis=0) for e, c in zip(errors, self.counts, strict=True))
        count = sum(c.sum(axis=0) for c in self.counts)
        return np.sqrt(square / np.maximum(count, 1.0))

    def weights(self, errors: Sequence[Float[np.ndarray, "T n"]]) -> Weights:
        """From errors that remain: encoders' floor and discrepancy as they show together."""
        sigma = np.maximum(self.rms(errors), self.floor)
        times = np.ones(len(sigma))
        for j in range(len(sigma)):
            series = [e[c[:, j] > 0, j] for e, c in zip(errors, self.counts, strict=True)]
            times[j] = max((autocorrelation_time(x) for x in series if len(x) > 8), default=1.0)
        return Weights(sigma, times)
