"""The effects of a fit as people have them: sizes with intervals, shares, probabilities, ties."""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from jax_inertia.replay import checks
from jax_inertia.replay.fitting.fit import Fit
from jax_inertia.replay.joint_numbers import COORDINATES
from jax_inertia.replay.loop import LOGARITHMIC, ORDINARY, UNITS, Loop, Parameter
from jax_inertia.replay.result import Effect, Size, Tie
from jax_inertia.replay.search import causal
from jax_inertia.replay.search.candidates import Candidate
from jax_inertia.replay.search.elsewhere import Possible
from jax_inertia.replay.search.instead import Instead, Rows
from jax_inertia.replay.search.odd import Odd, Search
from jax_inertia.replay.search.probability import Sure
from jax_inertia.replay.search.ties import IN_PART, effect_of, place_of, ties_of

CHANGES = ("armature", "viscous_friction", "coulomb_friction")
"""Families whose effect is what is added to the model's own number."""
PARAMETERS = {
    "armature": "armature", "viscous_friction": "damping", "coulomb_friction": "coulomb", "encoder_offset": "offset",
    "kp_scale": "scale", "kd_scale": "scale", "target_delay": "delay", "target_lag": "lag", "torque_bias": "bias",
    "target_low_pass": "time_constant", "loop_hold": "hold", "own_steps": "time",
    "actuator_lag": "time_constant", "torque_saturation": "limit", "payload": "mass", "torque_speed": "slope",
    "dead_band": "half_width",
    "backlash": "width", "load_friction": "load_coefficient", "stribeck_friction": "stiction",
    "stribeck_velocity": "stribeck_velocity", "torque_gain": "gain", "position_friction": "slope",
    "payload_x": "x", "payload_y": "y", "payload_z": "z", "torque_lead": "lead",
    "asymmetric_coulomb": "half_difference", "quadratic_viscous": "coefficient", "joint_spring": "stiffness",
    "spring_across": "stiffness", "across_ratio": "ratio", "across_torque": "torque", "across_damping": "damping",
    "drive_integral": "ki", "integral_windup": "windup",
    "spring_torque": "torque", "com_shift_x": "com_shift_x", "com_shift_y": "com_shift_y", "com_shift_z": "com_shift_z",
    "tilt_x": "tilt_x", "tilt_y": "tilt_y", "force_x": "force_x", "force_y": "force_y", "force_z": "force_z",
}  # fmt: skip
"""What the parameter of each family is called."""


def distinct(found: Fit, rows: Rows) -> bool:
    """Whether the interval of an effect's first number leaves the nominal one out; it does where that is none.

    Of coordinates, any one's.
    """
    first = min(rows)
    for k in rows if found.table[first].family in COORDINATES else (first,):
        x, sd = known(found, k)
        if abs(x - found.table[k].nominal) > 1.96 * sd:
            return True
    return False


def known(found: Fit, k: int) -> tuple[float, float]:
    """A number and its deviation, which a clock's phase widens.

    Of the delay of all targets: the motion's, with what its torque does not have.
    """
    rows = list(causal.late(found, k))
    loose = checks.loose(found.table)[k]
    variance = float(found.covariance[np.ix_(rows, rows)].sum())
    variance += float(np.broadcast_to(found.elsewhere, len(found.table))[rows].sum())
    return float(found.theta[rows].sum()), float(np.hypot(np.sqrt(max(variance, 0.0)), loose))


def whole(p: Parameter, x: float, loop: Loop) -> float:
    """A number of the vector as people have it."""
    if p.family in LOGARITHMIC:
        return float(np.exp(x))
    if p.family == "viscous_friction":
        return float(x - loop.kd[p.joint])
    if p.family == "integral_windup":
        return 1.0 / x if x > 0 else np.inf
    return float(x)


def size_of(found: Fit, k: int, loop: Loop) -> Size:
    """A number and its interval, which does not leave what is possible: no friction is negative, and no kd."""
    p, (x, sd) = found.table[k], known(found, k)
    low, high = (float(np.clip(x + s * sd, p.low, p.high)) for s in (-1.96, 1.96))
    value, *ends = (whole(p, y, loop) for y in (x, low, high))
    return Size(value, min(ends), max(ends), UNITS[p.family])


def listed(
    found: Fit,
    search: Search,
    instead: Mapping[Rows, tuple[Instead, ...]],
    shares: Mapping[Rows, float],
    odds: Mapping[Rows, Sure],
    loop: Loop,
    names: Sequence[str],
) -> tuple[Effect, ...]:
    """Effects by the share that each takes; `shares` has those of the rows of each, which are there to be listed.

    `search`: which of them are odd, and what else may be there; `instead`: what would do in each one's place.
    """
    out, added = [], {o.rows: o for o in search.odd}
    for rows, share in sorted(shares.items(), key=lambda x: -x[1]):
        p = found.table[rows[0]]
        sure = odds[rows].own
        if rows in added:
            effect = _odd(found, added[rows], share, sure, loop, names)
            out.append(_with_ties(effect, _instead(instead.get(rows, ()), loop, names)))
            continue
        family, size, nominal = _named(found, rows[0], loop)
        place = place_of(p.joint, p.body, names)
        ties = ties_of(family, place, found, rows[0], loop, names)
        is_ordinary = p.family in ORDINARY
        out.append(
            Effect(family, *place, ((PARAMETERS[family], size),), nominal, min(share, 1.0), sure, is_ordinary, ties)
        )  # fmt: skip
        out[-1] = _with_ties(out[-1], _instead(instead.get(rows, ()), loop, names))
    dropped = [o.candidate for o in search.odd if o.rows not in shares]
    return _with_possible(_with_dropped(out, dropped, names), search.possible, loop, names)


def _with_ties(effect: Effect, more: Sequence[Tie]) -> Effect:
    """With what else would do; of one family and place, what the equation or the replays say comes first."""
    own = (effect.family, effect.kind, effect.name)
    ties: dict[tuple[str, str, str], Tie] = {}
    for t in (*effect.ties, *more):
        ties.setdefault((t.family, t.kind, t.name), t)
    return dataclasses.replace(effect, ties=tuple(t for key, t in ties.items() if key != own))


def _instead(others: Sequence[Instead], loop: Loop, names) -> tuple[Tie, ...]:
    out = []
    for p, x, bound, _ in others:
        size = whole(p, x, loop) - (whole(p, p.nominal, loop) if p.family in CHANGES else 0.0)
        unit = "" if UNITS[p.family] == "1" else f" {UNITS[p.family]}"
        text = f"{size:.3g}{unit} of it instead, the others following, replays this motion as well"
        place = place_of(p.joint, p.body, names)
        out.append(Tie(effect_of(p), *place, bound or text, bool(bound)))
    return tuple(out)


def _with_dropped(effects: Sequence[Effect], dropped: Sequence[Candidate], names) -> list[Effect]:
    """With what the log asked for and the held-out replay does not show, as a tie of what it passes for in part."""
    out = list(effects)
    for c in dropped:
        place = place_of(*c.place, names)
        for family, text in IN_PART.get(c.family, ()):
            for k, e in enumerate(out):
                if (e.family, e.kind, e.name) == (family, *place):
                    out[k] = _with_ties(e, [Tie(c.family, *place, text, False)])
    return out


def _with_possible(
    effects: Sequence[Effect], possible: Sequence[Possible], loop: Loop, names
) -> tuple[Effect, ...]:
    """Each effect that may be there too, listed with the largest at its joint, or else with the largest."""
    out = list(effects)
    for c, _, tried in possible if out else ():
        place = place_of(*c.place, names)
        at = next((k for k, e in enumerate(out) if (e.kind, e.name) == place), 0)
        p, x = c.parameters[0], float(tried.theta[len(tried.table) - len(c.parameters)])
        unit = "" if UNITS[p.family] == "1" else f" {UNITS[p.family]}"
        text = (
            f"{whole(p, x, loop):.3g}{unit} of it may be there too, the others following: its odds are not under 1 in "
            "20; a longer log, or another motion, tells"
        )
        out[at] = _with_ties(out[at], [Tie(c.family, *place, text, False)])
    return tuple(out)


def _named(found: Fit, k: int, loop: Loop) -> tuple[str, Size, float]:
    """Family, size and nominal value of one number.

    A replay knows damping + kd. No joint's damping is negative, so a sum below kd is a kd that is less than stated.
    """
    p = found.table[k]
    size, nominal = size_of(found, k, loop), whole(p, p.nominal, loop)
    if p.family == "viscous_friction" and size.value < 0.0 < loop.kd[p.joint]:
        kd = float(loop.kd[p.joint])
        value, low, high = (1.0 + x / kd for x in (size.value, size.low, size.high))
        return "kd_scale", Size(value, low, high, UNITS["kd_scale"]), 1.0
    if p.family == "viscous_friction":
        # Of the sum, what is below kd is no damping.
        size = Size(max(size.value, 0.0), max(size.low, 0.0), max(size.high, 0.0), size.unit)
    if p.family in CHANGES:
        size = Size(size.value - nominal, size.low - nominal, size.high - nominal, size.unit)
    return p.family, size, nominal


def _odd(found: Fit, odd: Odd, share: float, sure: float, loop: Loop, names) -> Effect:
    family, rows = odd.candidate.family, odd.rows
    if family == "torque_speed" and found.theta[rows[1]] == found.table[rows[1]].nominal:
        # A limit that does not fall.
        family, rows = "torque_saturation", rows[:1]
    sizes = {PARAMETERS[found.table[k].family]: size_of(found, k, loop) for k in rows}
    if family == "drive_integral" and not np.isfinite(sizes["windup"].value):
        del sizes["windup"]
    if family == "torque_speed":
        sizes = _motor(sizes)
    if family in ("joint_spring", "spring_across"):
        sizes = _rest(sizes, found, rows[:2]) | {k: sizes[k] for k in list(sizes)[2:]}
    place = place_of(*odd.candidate.place, names)
    own = {(found.table[k].family, *place) for k in rows}
    ties = [
        t for t in (*ties_of(family, place, found, rows[0], loop, names), *_rivals(odd.rivals, names))
        if t.exact or (t.family, t.kind, t.name) not in own or t.family != family
    ]  # fmt: skip
    nominal = whole(found.table[rows[0]], found.table[rows[0]].nominal, loop)
    return Effect(
        family, *place, tuple(sizes.items()), nominal, min(share, 1.0), sure, False, tuple(ties)
    )  # fmt: skip


def _motor(sizes: dict[str, Size]) -> dict[str, Size]:
    """Stall torque, and no-load speed as stall torque over the slope."""
    stall, slope = sizes["limit"], sizes["slope"]
    free, low, high = (stall.value / max(x, 1e-9) for x in (slope.value, slope.high, slope.low))
    return {"stall": stall, "no_load_speed": Size(free, low, high, "rad/s")}


def _rest(sizes: dict[str, Size], found: Fit, rows: Rows) -> dict[str, Size]:
    """Stiffness k, and the angle at rest T/k, T the torque at the joint's zero; its deviation to first order."""
    k, torque = (float(found.theta[i]) for i in rows)
    if not k:
        return {"stiffness": sizes["stiffness"]}
    slope = np.array([-torque / k**2, 1.0 / k])
    sd = float(np.sqrt(slope @ found.covariance[np.ix_(rows, rows)] @ slope))
    angle = torque / k
    return {
        "stiffness": sizes["stiffness"],
        "rest_angle": Size(angle, angle - 1.96 * sd, angle + 1.96 * sd, "rad"),
    }


def _rivals(rivals: Sequence[Candidate], names) -> tuple[Tie, ...]:
    text = "the replays of this motion are nearly as good with it"
    return tuple(Tie(c.family, *place_of(*c.place, names), text, False) for c in rivals)
