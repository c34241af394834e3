"""In which short stretches of time the gap lies."""

import itertools

import numpy as np
from jaxtyping import Bool, Float

from jax_inertia.gap.evidence import Evidence
from jax_inertia.logs.findings import run_bounds

# Of energies summed over rows, the mean over the median: near one for many rows, 2.2 for a single one.
MEAN = 1.2


def windows(
    evidence: Evidence,
    residual: Float[np.ndarray, " n"],
    floor: float,
    *,
    longest: float = 3.0,
    shortest: float = 0.06,
) -> tuple[tuple[float, float], ...]:
    """Short stretches [s] that hold most of the excess energy of a residual, widened to where it ends.

    A single stretch must hold half of it: backlash that rattles at every reversal is no push.
    """
    time = times(evidence)
    step = time[1] - time[0]
    total = (evidence.unflatten(residual) ** 2).sum(axis=1)
    told = np.any(evidence.used, axis=1)
    # Noise that is stated too large hides nothing that is short: it is no louder than half of the log.
    usual = min(floor / len(total), MEAN * float(np.median(total[told])) if told.any() else np.inf)
    excess = total.sum() - usual * len(total)
    if excess < 20:
        return ()
    width = max(1, round(0.08 / step))
    smooth = np.convolve(total, np.ones(width) / width, mode="same")
    # What noise of as many samples hardly ever reaches.
    least = usual * (1.0 + 5.0 * np.sqrt(2.0 / (width * evidence.used.shape[1])))
    found = set()
    # Above the noise, for what is faint; below the peak, for what is loud and echoes.
    levels = [least, *(k * usual for k in (3.0, 8.0, 20.0, 60.0, 200.0))]
    levels += [k * float(smooth.max()) for k in (0.03, 0.1, 0.3)]
    for level in levels:
        for start, stop in run_bounds(
            _closed(smooth > max(level, least), round(0.15 / step), told)
        ):
            inside = total[start:stop].sum() - usual * (stop - start)
            if shortest < (stop - start) * step < longest and inside > 0.5 * excess:
                found.add((time[start] - 0.04, time[min(stop, len(time) - 1)] + 0.04))
    return tuple(sorted(found))


def times(evidence: Evidence) -> Float[np.ndarray, " R"]:
    """Of its samples, from the log's first [s]."""
    time = evidence.prepared.time[evidence.prepared.kept]
    return time - evidence.prepared.time[0]


def _closed(
    mask: Bool[np.ndarray, " R"], gap: int, told: Bool[np.ndarray, " R"]
) -> Bool[np.ndarray, " R"]:
    """Fill gaps of fewer than `gap` samples that tell anything between loud stretches: joints at rest do not."""
    out = mask.copy()
    for (_, stop), (start, _) in itertools.pairwise(run_bounds(mask)):
        if np.sum(told[stop:start]) < gap:
            out[stop:start] = True
    return out
