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
    weight = sigma**-2
    mean = np.sum(weight * x) / np.sum(weight)
    return float(scipy.stats.chi2.sf(np.sum(weight * (x - mean) ** 2), len(x) - 1))


def changing(table: Mapping[Quantity, Sequence[Interval | None]]) -> set[Quantity]:
    """Of which numbers the intervals do not agree, at one false alarm in a hundred tables."""
    p = {
        q: heterogeneity([v for v in row if v is not None])
        for q, row in table.items()
        if sum(v is not None for v in row) > 1
    }
    return {q for q, value in p.items() if value * len(p) < FALSE_ALARM}


def slope(days: Sequence[int | float], values: Sequence[Interval]) -> Interval | None:
    """Weighted least squares of numbers over days, per 30 days; None where they are of one day.

    Where the numbers scatter more than their intervals say, σ grows by √(χ²/(n − 2)) (Birge 1932), and Student's t
    stands for the Gaussian: reports of one robot differ by more than noise.
    """
    x, sigma = _with_width(values)
    t = np.array([d for d, v in zip(days, values, strict=True) if v.sigma > 0])
    if len(x) < 2 or np.ptp(t) == 0:
        return None
    weight = sigma**-2
    t = (t - np.sum(weight * t) / np.sum(weight)) / MONTH
    rate = np.sum(weight * t * x) / np.sum(weight * t**2)
    spread = np.sum(weight * t**2) ** -0.5
    rest = x - np.sum(weight * x) / np.sum(weight) - rate * t
    half = scipy.stats.norm.isf(0.025) * spread
    if len(x) > 2:
        birge = np.sqrt(np.sum(weight * rest**2) / (len(x) - 2))
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
