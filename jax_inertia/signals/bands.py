"""Rates, filters and edges of a log's analysis: all of them from the log's rate, and here alone.

An analysis is led by one frequency, the cutoff of what it looks at. Where the log is fast enough the cutoff is what the
analysis wants; a slower log sets it, at a share of the rate of the grid that everything is computed on:

    grid = min(wanted, the log's rate),    cutoff = min(wanted, share · grid)

and all other bands are fixed multiples of the cutoff, so that a log of 20 Hz goes through the same filters as one of
100 Hz, five times as slow. Up to a tenth of the grid's rate local regression onto the grid passes a signal within 1 %
(`filtering.resample`), and differences of sixth order (`finite_difference.centred_slopes`) lose (ω h)⁶ / 140 of it,
0.04 %; at a fifth it is 12 % and 2 %. The diagnosis, which looks at the residual of its model, ends at a tenth. The
estimate low-passes before the model, which is not linear: what is cut of the motion is a bias there, what remains of
the noise is only noise, so it ends at a fifth. The grid is never denser than the log: what lies between its samples, a
jump of a held torque or a reversal of friction, is not recovered by any interpolation.
"""

import dataclasses
import math

from jax_inertia.logs.npz import LogError

SLOWEST = 20.0
"""Rate that a log must have [Hz]: ten times `MOTION`."""
MOTION = 2.0
"""Where the motion of most arms ends [Hz]."""
# Clocks are off, and a period is rounded to milliseconds: by less than this share.
_CLOCK = 0.05
_BEFORE_MOST = 0.4


@dataclasses.dataclass(frozen=True)
class Bands:
    """Rates and bands of one log [Hz]."""

    grid: float
    """Rate of the uniform grid on which channels are low-passed, differentiated and put into the model."""
    before: float
    """Low-pass of every channel, before differences and the model."""
    cutoff: float
    """Low-pass of what is looked at, after the model: the band of the analysis."""
    rows: float
    """Rate at which its rows are kept."""
    margin: float
    """Left out at either end, where a zero-phase filter leans on its padding [s]."""


@dataclasses.dataclass(frozen=True)
class Analysis:
    """What an analysis wants of a log: grid and cutoff [Hz], and the rest in multiples of the cutoff."""

    grid: float
    cutoff: float
    share: float
    """Of the grid's rate, which the cutoff is at most."""
    before: float
    """Of the cutoff."""
    rows: float
    """Of the cutoff. Rows whose noise is independent come at 2."""
    periods: float
    """Of the cutoff, left out at either end."""
    margin: float = 0.0
    """And at least this [s]."""

    def at(self, rate: float) -> Bands:
        """The bands of a log of so many samples a second [Hz]; LogError where that is too slow.

        >>> from jax_inertia.signals.bands import DIAGNOSIS
        >>> DIAGNOSIS.at(500.0)
        Bands(grid=250.0, before=40.0, cutoff=10.0, rows=50.0, margin=0.25)
        >>> DIAGNOSIS.at(50.0)
        Bands(grid=50.0, before=20.0, cutoff=5.0, rows=25.0, margin=0.5)
        """
        require_rate(rate)
        return self.on(min(self.grid, rate))

    def on(self, grid: float) -> Bands:
        """The bands on a grid that is given."""
        cutoff = min(self.cutoff, self.share * grid)
        margin = max(self.margin, self.periods / cutoff)
        return Bands(grid, self.before * cutoff, cutoff, self.rows * cutoff, margin)


def holds(grid: float, frequency: float) -> bool:
    """Whether a grid's rate leaves room for a low-pass at a frequency [Hz].

    No channel has anything above `Bands.before`, which is at most 0.4 of the rate.
    """
    return frequency <= _BEFORE_MOST * grid


def smooth_order(rate: float) -> int:
    """Order of differences at which motion is smooth at a log's rate [Hz] and white noise is not: 3 from 100 Hz on.

    The n-th difference has (2 sin(π f / rate))ⁿ of a motion at f, and noise of one sample √C(2n, n) times. A slower log
    takes the order at which motion of 2 Hz counts for no more noise than at 100 Hz.
    """

    def motion(order: int, rate: float) -> float:
        swing = 2.0 * math.sin(math.pi * MOTION / rate)
        return swing**order / math.sqrt(math.comb(2 * order, order))

    orders = range(3, 20)
    usual = motion(3, 100.0)
    return next(n for n in orders if motion(n, rate) <= 1.05 * usual)


def require_rate(rate: float) -> None:
    """LogError for a log of too few samples a second [Hz]."""
    if rate < (1.0 - _CLOCK) * SLOWEST:
        raise LogError(
            f"the log has {rate:.3g} samples a second, and at least {SLOWEST:g} are needed to observe motion up to "
            f"{MOTION:g} Hz; log at {SLOWEST:g} Hz or faster"
        )


ESTIMATE = Analysis(100.0, 10.0, share=0.2, before=1.0, rows=2.0, periods=1.0)
"""10 Hz: above what a joint's position loop follows, below most gear and structure modes. One low-pass is all."""
DIAGNOSIS = Analysis(250.0, 10.0, share=0.1, before=4.0, rows=5.0, periods=2.5, margin=0.25)
"""Columns with corners (sign, clip) are formed on the grid and filtered afterwards: it is dense, and `before` wide."""
DIAGNOSIS_IN_CONTACT = dataclasses.replace(DIAGNOSIS, cutoff=20.0)
"""Feet that are set down are twice as quick."""


def of_estimate(rate: float, grid: float | None = None, cutoff: float | None = None) -> Bands:
    """The bands of `estimate` for a log of so many samples a second [Hz]; what is given is taken as it is.

    >>> from jax_inertia.signals.bands import of_estimate
    >>> of_estimate(333.0).cutoff, of_estimate(20.0).cutoff, of_estimate(333.0, cutoff=4.0).grid
    (10.0, 4.0, 40.0)
    """
    require_rate(rate)
    if cutoff is None:
        return ESTIMATE.at(rate) if grid is None else ESTIMATE.on(grid)
    grid = min(ESTIMATE.grid / ESTIMATE.cutoff * cutoff, rate) if grid is None else grid
    return Bands(grid, ESTIMATE.before * cutoff, cutoff, ESTIMATE.rows * cutoff, 1.0 / cutoff)
