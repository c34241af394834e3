"""Single samples that stick out from both neighbours, and the resolution of a sensor."""

import numpy as np
from jaxtyping import Bool, Float

from jax_inertia.logs.log import Log

# In spreads of the changes from sample to sample, in the channel's range, and in steps of the sensor.
_SPREADS, _SHARE_OF_RANGE, _QUANTA = 15.0, 0.1, 10


def torque_spikes(log: Log) -> Bool[np.ndarray, "T n"]:
    """Single samples of torque that no motor makes, and that `preflight` warns of; none next to what is not finite."""
    tau = np.asarray(log.tau, float)
    out = np.zeros(tau.shape, bool)
    for told, x in zip(out.T, tau.T, strict=True):
        off, enough = off_neighbours(x)
        told[:] = off > enough
    return out


def off_neighbours(x: Float[np.ndarray, " T"]) -> tuple[Float[np.ndarray, " T"], float]:
    """How far each sample is off both neighbours, to the same side, and from where on that is a spike."""
    left, right = x[1:-1] - x[:-2], x[1:-1] - x[2:]
    off = np.zeros_like(x)
    off[1:-1] = np.nan_to_num(np.minimum(np.abs(left), np.abs(right)) * (left * right > 0))
    changes, finite = np.abs(np.diff(x)), x[np.isfinite(x)]
    changes = changes[np.isfinite(changes)]
    if not changes.size:
        return off, np.inf
    low, high = np.percentile(finite, [0.5, 99.5])
    enough = max(
        _SPREADS * np.percentile(changes, 75),
        _SHARE_OF_RANGE * (high - low),
        _QUANTA * quantum(finite),
    )
    return off, float(enough)


def quantum(x: np.ndarray) -> float:
    """The sensor's resolution: the smallest change from sample to sample that is one."""
    change = np.abs(np.diff(x))
    change = change[change > 1e-9 * np.abs(x).max()]
    return float(change.min()) if change.size else 0.0
