"""Fits whose delays a model can have."""

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float

from jax_inertia.replay import checks
from jax_inertia.replay import fit as fitting
from jax_inertia.replay.fit import Fit
from jax_inertia.replay.plant import Plant
from jax_inertia.replay.record import Record


def fitted(
    plant: Plant,
    everything: Fit,
    records: Sequence[Record],
    least: float | Float[np.ndarray, " m"],
    progress: Callable[[str], None],
) -> Fit:
    """The fit without a negative delay of all targets, which no model can have: found again with none.

    What stamps may be off by stays: forced to 0 it would be in friction and damping. How little a log tells of a delay
    is no excuse: smooth motion takes -14 ms and more damping as well as none, and steps then come before their targets.
    """
    early = np.array([p.family == "target_delay" for p in everything.table]) & (
        everything.theta < -2.0 * checks.LOOSE_TIME
    )
    if not early.any():
        return everything
    start = np.where(early, 0.0, everything.theta)
    return fitting.fit(
        plant, everything.table, records, start, free=~early, floor=least, rounds=6, progress=progress
    )  # fmt: skip


def with_variance(fit: Fit, stamps: Fit) -> Fit:
    """A fit whose delay was set to none: how well it is known is what the log said of it, and not perfectly."""
    covariance = fit.covariance.copy()
    for k in range(len(stamps.table)):
        if covariance[k, k] == 0:
            covariance[k, k] = stamps.covariance[k, k]
    return fit._replace(covariance=covariance)
