"""Shares with Wilson's bounds (Wilson 1927), medians and confidence with bootstrap ones."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

Z, DRAWS = 1.959964, 2000
Bounded = tuple[float | None, float | None, float | None]
"""A number and its 95 % interval; None of nothing."""


@dataclass(frozen=True)
class Share:
    """k of n."""

    k: int
    n: int

    @property
    def rate(self) -> float | None:
        return self.k / self.n if self.n else None

    @property
    def bounds(self) -> tuple[float, float]:
        """Wilson's 95 % interval; (0, 1) of nothing."""
        if not self.n:
            return 0.0, 1.0
        p, n = self.k / self.n, self.n
        centre = (p + Z * Z / (2 * n)) / (1 + Z * Z / n)
        half = Z * math.sqrt(p * (1 - p) / n + Z * Z / (4 * n * n)) / (1 + Z * Z / n)
        return max(centre - half, 0.0), min(centre + half, 1.0)

    def __str__(self) -> str:
        if not self.n:
            return "–"
        low, high = self.bounds
        return f"{self.k / self.n:.3f} [{low:.2f}, {high:.2f}] ({self.k}/{self.n})"


def count(values: Iterable[bool | None]) -> Share:
    """True among what is not None."""
    asked = [bool(v) for v in values if v is not None]
    return Share(sum(asked), len(asked))


def median(values: Iterable[float]) -> Bounded:
    x = np.array(list(values))
    if not len(x):
        return None, None, None
    rng = np.random.default_rng(0)
    draws = np.median(rng.choice(x, (DRAWS, len(x))), axis=1)
    low, high = np.percentile(draws, [2.5, 97.5])
    return float(np.median(x)), float(low), float(high)


def tenths(told: np.ndarray) -> list[tuple[float, float, int]]:
    """(mean stated, share right, logs) of each tenth of confidence; `told`: (stated, right) of each log (N, 2)."""
    tenth = np.minimum((10 * told[:, 0]).astype(int), 9)
    parts = [told[tenth == k] for k in range(10)]
    return [(*map(float, some.mean(0)), len(some)) for some in parts if len(some)]


def confidence_error(told: np.ndarray) -> Bounded:
    """Mean |stated − observed| over tenths, weighted by their logs."""
    if not len(told):
        return None, None, None

    def mean(some: np.ndarray) -> float:
        return sum(abs(s - r) * n for s, r, n in tenths(some)) / len(some)

    rng = np.random.default_rng(0)
    draws = [mean(told[rng.integers(len(told), size=len(told))]) for _ in range(DRAWS)]
    low, high = np.percentile(draws, [2.5, 97.5])
    return mean(told), float(low), float(high)


def worded(number: Bounded) -> str:
    """With its interval, or a dash."""
    return "–" if number[0] is None else "{:.3g} [{:.3g}, {:.3g}]".format(*number)
