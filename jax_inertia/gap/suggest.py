"""The motion that would tell apart what this log cannot: a sentence and a few numbers for each pair of rivals."""

import dataclasses

import numpy as np

from jax_inertia.gap.finding import Diagnosis, Finding, Tie

_DRY = {"coulomb_friction", "stribeck_friction", "asymmetric_coulomb", "load_friction"}
_LATE = {"time_delay", "actuator_lag"}
_WEIGHT = {"payload", "constant_force", "com_shift", "link_inertia"}
_PATH = {"joint_elasticity", "backlash", "encoder_offset", "encoder_scale"}


@dataclasses.dataclass(frozen=True)
class Suggestion:
    """A motion to record next."""

    between: tuple[str, str]
    where: str
    kind: str
    """A short stable name of the motion."""
    text: str
    numbers: dict[str, float]
    """By name with unit, such as `speed_below_rad_s`."""


def suggestions(found: Diagnosis) -> tuple[Suggestion, ...]:
    """One for each tie that another motion would split, without repeats; none where nothing ties."""
    out: dict[tuple[str, str], Suggestion] = {}
    for finding in found.findings:
        for tie in finding.equivalent:
            if tie.kind != "motion_limited":
                continue
            one = _split(found, finding, tie)
            out.setdefault((one.kind, one.where), one)
    return tuple(out.values())


def _split(found: Diagnosis, finding: Finding, tie: Tie) -> Suggestion:
    pair = (finding.family, tie.family)
    names, where = set(pair), finding.place.name
    if finding.place != tie.place:
        other = tie.place.name
        return Suggestion(
            pair,
            where,
            "one place at a time",
            f"Move so that {where} and {other} work separately: first one with the other held still, then the "
            "other, each over its whole range and through several reversals.",
            {"seconds_each": 10.0, "reversals_each": 6.0},
        )
    top = _peak(found, where)
    if names <= _DRY:
        return Suggestion(
            pair,
            where,
            "slow reversals",
            f"Turn {where} slowly to and fro, well below 0.1 rad/s, and at several loads: dry friction laws differ "
            "only at low speed, in their direction, and with load.",
            {"speed_below_rad_s": 0.05, "reversals": 10.0},
        )
    if names <= _LATE:
        return Suggestion(
            pair,
            where,
            "fast sweep",
            "Sweep the torque from 5 to 25 Hz: a delay and a first-order lag have the same phase when slow, and "
            "part above some ten hertz.",
            {"from_hz": 5.0, "to_hz": 25.0},
        )
    if names <= _WEIGHT:
        return Suggestion(
            pair,
            where,
            "brisk, in many postures",
            "Turn the same body through very different postures, and accelerate it hard in some of them: weight "
            "follows gravity, inertia follows acceleration, a cable's pull follows neither.",
            {"postures": 6.0, "acceleration_rad_s2": 10.0},
        )
    if names & {"torque_saturation"}:
        return Suggestion(
            pair,
            where,
            "small and large torques",
            f"Repeat one motion of {where} at half and at full speed: a limit shows at large torques only, a gain at "
            "all of them.",
            {"peak_torque_share_low": 0.4, "peak_torque_share_high": 1.0},
        )
    if names & _PATH:
        return Suggestion(
            pair,
            where,
            "torque reversals",
            f"Let the torque at {where} change sign often, slowly and quickly, in several postures: play opens at "
            "every reversal, a spring follows the torque, an offset does neither.",
            {"torque_reversals": 20.0},
        )
    return Suggestion(
        pair,
        where,
        "wide and at many speeds",
        f"Move {where} over its whole range at slow, usual and high speed, with reversals at each: the two effects "
        "have the same torque only along this log's path.",
        {"speed_rad_s": round(1.5 * top, 2), "seconds": 20.0},
    )


def _peak(found: Diagnosis, joint: str) -> float:
    """Fastest usual speed of a joint in this log, of all rows where the place is no joint [rad/s]."""
    trace = found.trace
    v = np.abs(trace.v)
    if joint in trace.rows:
        v = v[:, [trace.rows.index(joint)]]
    return float(np.percentile(v, 99))
