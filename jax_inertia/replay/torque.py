"""The torque of a log as a further output of its replay: what the loop gives at the positions that were measured.

With numbers θ of the loop, over a window of ± `WINDOW` about every sample,

    e_τ = mean(kp dz(q*(t − d) − q) + kd (q̇* − q̇) + τ_ff + b, cut off at the limit) − mean(τ)

At measured positions, not at replayed ones: p(q, τ | q*, θ) is the product over samples of p(τ_t | q up to t, θ) and
p(q_t | τ before t, θ). What friction or masses do to q beyond the model is in the replay's error once, and not in the
torque's again; and torque tells the loop's own numbers whatever the robot does. The mean of q̇ over a window is the
difference of q over it, and an edge of a target that is known to a part of a sample moves a mean by little.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from jax_inertia.replay.joint_numbers import Numbers
from jax_inertia.replay.loop import Parameter
from jax_inertia.replay.plant import Plant
from jax_inertia.replay.record import Record, step_means

WINDOW = 0.01
"""Half of what torques are averaged over [s]: targets of a policy change every 20 ms."""
_FINE = 1e-3
"""Steps in which targets are delayed and lag [s]."""
_SLOPE = 4e-3
"""Half of what a velocity that decides on a limit is taken over [s]."""
_LAW = ("kp", "kd", "bias", "limit", "back", "dead", "delay", "lag")


def misses(
    plant: Plant,
    table: Sequence[Parameter],
    thetas: Float[np.ndarray, "B P"],
    record: Record,
) -> Float[np.ndarray, "B T n"]:
    """Torque that the loop gives minus the one that was logged [N m], means over windows, of every vector."""
    every = [plant.numbers(table, theta, record.loop) for theta in thetas]
    windows = Windows(record.time)
    out = np.empty((len(thetas), *record.q.shape))
    for j in range(record.q.shape[1]):
        # Most numbers of a vector are not the loop's, and most that are, another joint's.
        done: dict[tuple[float, ...], np.ndarray] = {}
        for b, x in enumerate(every):
            own = tuple(float(getattr(x, name)[j]) for name in _LAW)
            if own not in done:
                done[own] = _miss(record, windows, x, j)
            out[b, :, j] = done[own]
    return out


class Windows:
    """Means over windows about the stamps of a log."""

    def __init__(self, time: Float[np.ndarray, " T"]):
        self.time, self.period = time, float(np.median(np.diff(time)))
        self._ends = self.ends(WINDOW)
        self._length = np.diff(time[self._ends], axis=0)[0]

    def ends(self, half: float) -> np.ndarray:
        """First and last row of windows of ± `half` (2, T)."""
        wide = max(round(half / self.period), 1)
        rows = np.arange(len(self.time))
        return np.stack([np.maximum(rows - wide, 0), np.minimum(rows + wide, len(rows) - 1)])

    def mean(self, x: Float[np.ndarray, " T"]) -> Float[np.ndarray, " T"]:
        """By trapezia."""
        parts = 0.5 * (x[1:] + x[:-1]) * np.diff(self.time)
        return np.diff(np.append(0.0, np.cumsum(parts))[self._ends], axis=0)[0] / self._length

    def slope(self, x: Float[np.ndarray, " T"], half: float = WINDOW) -> Float[np.ndarray, " T"]:
        """The mean of the derivative."""
        first, last = self.ends(half)
        return (x[last] - x[first]) / (self.time[last] - self.time[first])


def _miss(record: Record, windows: Windows, x: Numbers, j: int) -> Float[np.ndarray, " T"]:
    q, told = record.q[:, j], record.commanded
    kp, kd, back = x.kp[j], x.kd[j], x.back[j]
    aim = _held(record, told.position[:, j], x, j)
    miss = aim - q
    miss = miss - np.clip(miss, -x.dead[j], x.dead[j])
    asked = kp * miss + x.bias[j]
    if told.velocity is not None:
        asked = asked + kd * _held(record, told.velocity[:, j], x, j)
    if told.torque is not None:
        asked = asked + _held(record, told.torque[:, j], x, j)
    logged = record.velocity is not None
    v = record.velocity[:, j] if logged else windows.slope(q, _SLOPE)
    short = 0.0
    if np.isfinite(x.limit[j]):
        whole = asked - (kd - back) * v
        short = np.clip(whole, -x.limit[j], x.limit[j]) - whole
    mean_v = windows.mean(v) if logged else windows.slope(q)
    return windows.mean(asked + short - record.torque[:, j]) - kd * mean_v


def _held(record: Record, what: Float[np.ndarray, " S"], x: Numbers, j: int) -> np.ndarray:
    """What is commanded as the loop has it: its mean from each stamp to the next, as late as it comes."""
    period = record.period
    h = min(period, _FINE)
    steps = int(np.ceil((record.time[-1] + period) / h)) + 1
    delay, lag = x.delay[j : j + 1], x.lag[j : j + 1]
    fine = step_means(record.commanded.time, what[:, None], h, steps, delay, lag)[:, 0]
    area, edges = np.append(0.0, np.cumsum(fine)) * h, np.arange(steps + 1) * h
    ends = (np.interp(record.time + late, edges, area) for late in (period, 0.0))
    return (next(ends) - next(ends)) / period
