"""Delays: which numbers are one effect, and what is to be said of them and of the log's gains."""

from jax_inertia.replay.fitting.fit import Fit
from jax_inertia.replay.loop import ALL, HALF_PERIOD, Loop


def late(found: Fit, k: int) -> tuple[int, ...]:
    """Rows of the effect that a number is of: a delay of all targets is what torques have of it, and their lead."""
    p = found.table[k]
    if p.family != "target_delay" or p.joint != ALL:
        return (k,)
    return (k, *(i for i, other in enumerate(found.table) if other.family == "torque_lead"))


def notes(found: Fit, loop: Loop, torque_logged: bool) -> list[str]:
    """What is to be said of stamps and gains."""
    out = []
    for p, lead in zip(found.table, found.theta, strict=True):
        if p.family == "torque_lead" and lead > 0.0 and p.sd > HALF_PERIOD:
            out.append(
                "the torques that were commanded are made of the targets "
                f"{1e3 * lead:.1f} ms before these act, as the motion has it: measured torques would tell"
            )
    if loop.source == "model" and not torque_logged:
        out.append(
            "kp is the model's: the log does not say it, and what a replay finds of it has a wide prior; gains, "
            "frictions and masses all larger by one factor are the same motion: give the drives' gains (--kp, --kd)"
        )
    return out
