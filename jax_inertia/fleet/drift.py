"""Whether a number differs between reports, and how fast it drifts over dates."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import scipy.stats

from jax_inertia.fleet.numbers import Interval, Quantity

FALSE_ALARM = 0.01
"""Probability that a table in which nothing changes marks anything (Bonferroni over its numbers)."""
MONTH = 30.0
"""Days to which a drift is referred."""
# Of shares that are summed up less than this is nothing; and the largest number that is squared.
_TOLD, _MOST = 1e-30, 1e150


class Drift(NamedTuple):
    """Change of a number of one robot per 30 days, with its 95 % interval."""

    robot: str
    quantity: Quantity
    first: float
    last: float
    logs: int
    per_month: Interval
    stands_out: bool


def heterogeneity(values: Sequence[Interval]) -> float:
    """p-value of Cochran's Q: that intervals as far apart as these are of one number.

    1 for fewer than two that have a width; one without is a bound, of which nothing follows.

    >>> round(heterogeneity([Interval(1.0, 0.9, 1.1), Interval(1.05, 0.95, 1.15)]), 2)
    0.49
    """
    x, sigma = _with_width(values)
    if len(x) < 2:
        return 1.0
    weight = _weight(sigma)
    mean = np.sum(weight * x) / np.sum(weight)
    return float(scipy.stats.chi2.sf(_size((x - mean) / sigma) ** 2, len(x) - 1))


def changing(table: Mapping[Quantity, Sequence[Interval | None]]) -> set[Quantity]:
    """Of which numbers the intervals do not agree, at one false alarm in a hundred tables."""
    p = {
        q: heterogeneity([v for v in row if v is not None])
        for q, row in table.items()
        if sum(v is not None for v in row) > 1
    }
    return {q for q, value in p.items() if value * len(p) < FALSE_ALARM}


def slope(days: Sequence[int | float], values: Sequence[Interval]) -> Interval | None:
    """Weighted least squares of numbers over days, per 30 days; None where all that counts is of one day.

    Where the numbers scatter more than their intervals say, σ grows by √(χ²/(n − 2)) (Birge 1932), and Student's t
    stands for the Gaussian: reports of one robot differ by more than noise.
    """
    x, sigma = _with_width(values)
    t = np.array([d for d, v in zip(days, values, strict=True) if v.sigma > 0])
    if len(x) < 2 or np.ptp(t) == 0:
        return None
    weight = _weight(sigma)
    t = (t - np.sum(weight * t) / np.sum(weight)) / MONTH
    told = np.sum(weight * t**2)
    if told < _TOLD:
        return None
    rate = np.sum(weight * t * x) / told
    spread = sigma.min() / np.sqrt(told)
    rest = x - np.sum(weight * x) / np.sum(weight) - rate * t
    half = scipy.stats.norm.isf(0.025) * spread
    if len(x) > 2:
        birge = _size(rest / sigma) / np.sqrt(len(x) - 2)
        if birge > 1:
            half = scipy.stats.t.isf(0.025, len(x) - 2) * spread * birge
    return Interval(float(rate), float(rate - half), float(rate + half))


def drifts(
    robot: str, days: Sequence[int | float], reports: Sequence[Mapping[Quantity, Interval]]
) -> list[Drift]:
    """Of every number that at least two dates have, those that stand out first.

    A drift stands out where it is not zero at one false alarm in a hundred tables.
    """
    out = []
    for q in dict.fromkeys(q for report in reports for q in report):
        own = sorted((d, r[q]) for d, r in zip(days, reports, strict=True) if q in r)
        rate = slope(*zip(*own, strict=True))
        if rate is not None:
            out.append(Drift(robot, q, own[0][1].value, own[-1][1].value, len(own), rate, False))
    wide = scipy.stats.norm.isf(0.5 * FALSE_ALARM / max(len(out), 1)) / scipy.stats.norm.isf(0.025)
    marked = [
        d._replace(
            stands_out=bool(
                abs(d.per_month.value) > 0.5 * wide * (d.per_month.high - d.per_month.low)
            )
        )
        for d in out
    ]
    return sorted(marked, key=lambda d: not d.stands_out)


def _with_width(values: Sequence[Interval]) -> tuple[np.ndarray, np.ndarray]:
    rows = [(v.value, v.sigma) for v in values if v.sigma > 0]
    x, sigma = np.array(rows, float).reshape(-1, 2).T
    return x, sigma


def _weight(sigma: np.ndarray) -> np.ndarray:
    """Inverse variances, that of the surest number 1: what a report may hold has no squares else."""
    ratio = sigma.min() / sigma
    return np.where(ratio > _TOLD, ratio, 0.0) ** 2


def _size(x: np.ndarray) -> float:
    """Norm of a vector whose squares may be too large for a number, up to the largest that has one."""
    most = float(np.abs(x).max(initial=0.0))
    return min(most * float(np.linalg.norm(x / most)), _MOST) if most else 0.0
