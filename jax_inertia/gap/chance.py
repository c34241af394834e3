"""Whether what effects leave looks like noise, all of it or all but what happens once.

Where a log does not state its noise, a motor may have missed its command at random by more than the log can show; that
is no gap that a model could close.
"""

import numpy as np
from jaxtyping import Bool, Float

from jax_inertia.gap import locate
from jax_inertia.gap.evidence import Evidence

# Noise is forgotten after this [s]; what a motion brings about lasts longer, or returns.
FORGOTTEN, RETURNS = 0.15, 0.4
MEMORY = 0.02
# Fourth moment over the second squared: 3 of a Gaussian, which filters make of any noise; more of what comes in bursts.
BURSTS = 4.5


def at_random(evidence: Evidence, left: Float[np.ndarray, " n"]) -> bool:
    """Whether what is left looks like noise: forgotten within 0.15 to 0.4 s, and as loud throughout."""
    rows, period = evidence.unflatten(left), 1.0 / evidence.prepared.bands.rows
    energy = np.sum(rows**2, axis=0)
    lags = np.arange(round(FORGOTTEN / period), round(RETURNS / period) + 1)
    products = np.array([np.sum(rows[k:] * rows[:-k], axis=0) for k in lags])
    # Chance alone leaves 1/n in each squared correlation.
    squares = (products / np.maximum(energy, 1e-300)) ** 2 - 1.0 / len(rows)
    counts = np.sum(rows != 0.0, axis=0)
    kurtosis = counts * np.sum(rows**4, axis=0) / np.maximum(energy, 1e-100) ** 2
    share = energy / max(float(energy.sum()), 1e-300)
    return float(squares.mean(axis=0) @ share) < MEMORY and float(kurtosis @ share) < BURSTS


def noise_in(
    evidence: Evidence, left: Float[np.ndarray, " n"]
) -> tuple[Evidence, Float[np.ndarray, " u"]] | None:
    """What looks like noise of what is left, and the samples it is of: all, or all but what happens once; else none."""
    if at_random(evidence, left):
        return evidence, left
    usual = ~_once(evidence, left)
    if usual.all():
        return None
    rest = evidence.among(evidence.used & usual[:, None])
    left = evidence.unflatten(left)[rest.used]
    return (rest, left) if at_random(rest, left) else None


def _once(evidence: Evidence, left: Float[np.ndarray, " n"]) -> Bool[np.ndarray, " R"]:
    """Samples of a stretch of time that stands out of the rest of the log, however loud that is."""
    time = locate.times(evidence)
    out = np.zeros(len(time), bool)
    for start, stop in locate.windows(evidence, left, np.inf):
        out |= (start <= time) & (time <= stop)
    return out
