"""Delays: fits with those that a model can have, and what is to be said of them and of the log's stamps."""

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float

from jax_inertia.replay import checks
from jax_inertia.replay.fitting.fit import Fit, fit
from jax_inertia.replay.loop import ALL, Loop
from jax_inertia.replay.record import Record
from jax_inertia.replay.simulation.plant import Plant


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
    return fit(
        plant, everything.table, records, start, free=~early, floor=least, rounds=6, exact=True, progress=progress
    )  # fmt: skip


def with_variance(found: Fit, stamps: Fit) -> Fit:
    """A fit whose delay was set to none: how well it is known is what the log said of it, and not perfectly."""
    covariance = found.covariance.copy()
    for k in range(len(stamps.table)):
        if covariance[k, k] == 0:
            covariance[k, k] = stamps.covariance[k, k]
    return found._replace(covariance=covariance)


def late(found: Fit, k: int) -> tuple[int, ...]:
    """Rows of the effect that a number is of: a delay of all targets is what torques have of it, and their lead."""
    p = found.table[k]
    if p.family != "target_delay" or p.joint != ALL:
        return (k,)
    return (k, *(i for i, other in enumerate(found.table) if other.family == "torque_lead"))


def notes(everything: Fit, found: Fit, loop: Loop, torque_logged: bool) -> list[str]:
    """What is to be said of stamps and gains; `everything`: all ordinary numbers, `found`: those that are needed."""
    out = []
    shared = [p.family == "target_delay" and p.joint == ALL for p in everything.table]
    for delay, sd in zip(everything.theta[shared], everything.sigma[shared], strict=True):
        if delay < -2.0 * np.hypot(sd, checks.LOOSE_TIME):
            out.append(
                f"positions lead their targets by {-1e3 * delay:.1f} ms: are the stamps of targets late? "
                "No model can hold that; other numbers take it up"
            )
    for p, lead in zip(found.table, found.theta, strict=True):
        if p.family == "torque_lead" and lead > 0.0:
            out.append(
                "the torques that were commanded are made of the targets "
                f"{1e3 * lead:.1f} ms before these act, as the motion has it: measured torques would tell"
            )
    if loop.source == "model" and not torque_logged:
        out.append(
            "kp is the model's: the log does not say it, and what a replay finds of it has a wide prior"
        )
    return out
