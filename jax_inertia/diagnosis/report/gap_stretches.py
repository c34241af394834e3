"""When a log's torque residual stands out from the rest of it."""

import itertools

import numpy as np
from jaxtyping import Float

from jax_inertia.logs.findings import run_bounds

MEAN_OVER, JOINED, SHORTEST = 0.2, 0.3, 0.05
"""What energies are averaged over, pauses that are none, and stretches that are too short to be one [s]."""
LARGE, OF_LARGEST = 3.0, 0.25
"""Times the sensors' own energy, and share of the largest moment's, from which a moment stands out."""


def gap_stretches(
    time: Float[np.ndarray, " R"], z: Float[np.ndarray, "R n"]
) -> tuple[tuple[float, float], ...]:
    """From when to when [s] a residual stands out; none where it never does. `z`: its rows by what their sensors leave.

    A gap that is there all along has a stretch wherever the robot moves.
    """
    if len(time) < 2:
        return ()
    step = float(time[1] - time[0])
    energy = (z**2).sum(axis=1)
    width = max(1, round(MEAN_OVER / step))
    mean = np.convolve(energy, np.ones(width) / width, mode="same")
    large = mean > max(LARGE * z.shape[1], OF_LARGEST * float(mean.max(initial=0.0)))
    for (_, stop), (start, _) in itertools.pairwise(run_bounds(large)):
        if start - stop < round(JOINED / step):
            large[stop:start] = True
    return tuple(
        (float(time[start]), float(time[min(stop, len(time) - 1)]))
        for start, stop in run_bounds(large)
        if (stop - start) * step > SHORTEST
    )
