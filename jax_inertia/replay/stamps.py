"""When targets act, and when the log says so: what its stamps and torques leave open, in words and rows of a fit."""

import numpy as np

from jax_inertia.replay import checks
from jax_inertia.replay.fit import Fit
from jax_inertia.replay.loop import ALL, Loop


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
