"""What a fit is worth once the ordinary numbers that it does not need are given up.

Twenty ordinary numbers, each a little off, pass for one payload. Fits of different effects are compared by

    S = cost at the best numbers + ln N · (ordinary numbers that are kept)

least over which of them are kept (BIC, N independent samples): an effect is worth what it saves besides what it fits.
Who is given up is on the cost's parabola: given up one by one, the others following, the one first that costs least.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from jax_inertia.replay import checks
from jax_inertia.replay.fitting.fit import Fit
from jax_inertia.replay.joint_numbers import COORDINATES
from jax_inertia.replay.loop import ALL, ORDINARY, Parameter


class Simplest(NamedTuple):
    """Which of some numbers are kept, and where all of them are then."""

    kept: Bool[np.ndarray, " P"]
    off: Float[np.ndarray, " P"]
    """From the nominal model's numbers; 0 where they were given up."""
    price: float
    """What the cost has risen by, and ln N for each that is kept."""


def simplest(
    covariance: Float[np.ndarray, "P P"],
    off: Float[np.ndarray, " P"],
    may_go: Bool[np.ndarray, " P"],
    each: float,
) -> Simplest:
    """Backwards: the number whose return to 0 costs least is given up for as long as that costs less than `each`.

    `covariance` of the numbers at the cost's least is the inverse of half its second derivative. A number k costs
    off_k² / C_kk; the others follow by C_ik / C_kk off_k, and C loses C_ik C_kj / C_kk.
    """
    c, off, left = covariance.copy(), off.copy(), may_go.copy()
    risen = 0.0
    while left.any():
        rows = np.flatnonzero(left)
        costs = off[rows] ** 2 / np.maximum(np.diagonal(c)[rows], 1e-300)
        k = rows[int(np.argmin(costs))]
        if costs.min() > each:
            break
        risen += float(costs.min())
        column = c[:, k] / max(c[k, k], 1e-300)
        off -= column * off[k]
        c -= np.outer(column, c[k])
        off[k], left[k] = 0.0, False
    kept = left | ~may_go
    return Simplest(kept, off, risen + each * float(left.sum()))


def needed(found: Fit, rows: Sequence[int]) -> list[int]:
    """Which of the numbers in `rows` differ from the nominal model's for a reason, the surest first."""
    free, chosen = found.free, np.isin(np.arange(len(found.table)), rows)
    go = np.flatnonzero(free)
    covariance = np.linalg.inv(found.hessian[np.ix_(go, go)])
    covariance += np.diag(within(found.table)[go] ** 2)
    off = (found.theta - nominal(found))[go]
    least = simplest(covariance, off, chosen[go], float(np.log(max(found.samples, 2.0))))
    kept = [i for i in np.flatnonzero(least.kept & chosen[go]) if off[i] != 0]
    kept.sort(key=lambda i: -abs(off[i]) / np.sqrt(covariance[i, i]))
    return go[kept].tolist()


def within(table: Sequence[Parameter]) -> Float[np.ndarray, " P"]:
    """By how much numbers that are given up are off, deviations: what those of a right model are, and by a clock."""
    return np.hypot(checks.loose(table), [p.own for p in table])


def nominal(found: Fit) -> Float[np.ndarray, " P"]:
    """The nominal model's numbers; where that has none (no limit), the prior's."""
    own = np.array([p.nominal for p in found.table])
    return np.where(np.isfinite(own), own, found.theta)


def _may_go(p: Parameter) -> bool:
    if p.given:
        return False
    # A load may be off its body's centre along one axis alone, and a spring rest at the model's zero.
    if p.family in COORDINATES:
        return True
    # A delay of one joint's own targets is an odd one.
    return p.family in ORDINARY and (p.family != "target_delay" or p.joint == ALL)


class Worth(NamedTuple):
    """S, how many ordinary numbers are kept there, and where all free ones are, from the nominal model's."""

    total: float
    kept: int
    off: Float[np.ndarray, " F"]


class Parabola:
    """S as a function of a replay's error, the numbers of a fit following on the cost's parabola about it."""

    def __init__(self, found: Fit, samples: float, weights=None):
        w = found.weights if weights is None else weights
        self.found, self.root, self.go = found, w.root, np.flatnonzero(found.free)
        self.flat = (found.columns[self.go] * w.root).reshape(len(self.go), -1)
        mean, sd = (np.array([getattr(p, k) for p in found.table])[self.go] for k in ("mean", "sd"))
        self.hessian = self.flat @ self.flat.T + np.diag(1.0 / sd**2)
        self.inverse = np.linalg.inv(self.hessian)
        self.pull = (found.theta[self.go] - mean) / sd**2
        self.prior = float(np.sum(((found.theta[self.go] - mean) / sd) ** 2))
        self.off = (found.theta - nominal(found))[self.go]
        self.loose = np.diag(within(found.table)[self.go] ** 2)
        self.may_go = np.array([_may_go(found.table[k]) for k in self.go], bool)
        self.each = float(np.log(max(samples, 2.0)))

    def worth(self, error: Float[np.ndarray, "N n"] | None = None) -> Worth:
        """Of an error; without one, of the fit's own."""
        white = ((self.found.error if error is None else error) * self.root).ravel()
        gradient = self.flat @ white + self.pull
        step = self.inverse @ gradient
        least = simplest(self.inverse + self.loose, self.off - step, self.may_go, self.each)
        total = float(white @ white + self.prior - gradient @ step) + least.price
        return Worth(total, int(np.sum(least.kept & self.may_go)), least.off)

    def scaled(
        self, parameters: Sequence[Parameter], changes: Float[np.ndarray, "K N n"]
    ) -> tuple[Worth, Float[np.ndarray, " K"]]:
        """(S, numbers) where some more numbers are at their best, within their priors and bounds.

        `changes`: of the error by one of each.
        """
        more = (changes * self.root).reshape(len(changes), -1)
        white = (self.found.error * self.root).ravel()
        sd, low, high = (
            np.array([getattr(p, k) for p in parameters]) for k in ("sd", "low", "high")
        )
        across, own = self.flat @ more.T, more @ more.T + np.diag(sd**-2.0)
        gradient = np.append(self.flat @ white + self.pull, more @ white)
        inverse = np.linalg.inv(np.block([[self.hessian, across], [across.T, own]]))
        step = -inverse @ gradient
        k = len(self.go)
        if np.any((step[k:] < low) | (step[k:] > high)):
            sizes = np.clip(step[k:], low, high)
            whole = self.worth(self.found.error + np.tensordot(sizes, changes, 1))
            return whole._replace(total=whole.total + float(np.sum((sizes / sd) ** 2))), sizes
        loose = np.zeros_like(inverse)
        loose[:k, :k] = self.loose
        off = np.append(self.off, np.zeros(len(sd))) + step
        may_go = np.append(self.may_go, [_may_go(p) for p in parameters])
        least = simplest(inverse + loose, off, may_go, self.each)
        sizes = np.clip(least.off[k:], low, high)
        total = float(white @ white + self.prior + gradient @ step) + least.price
        kept = int(np.sum(least.kept[:k] & self.may_go))
        return Worth(total, kept, least.off[:k]), sizes
