"""What positions alone cannot tell an effect from: by the equation, in part, and by a fit's correlations."""

from collections.abc import Mapping, Sequence

from jax_inertia.replay.fitting.fit import Fit
from jax_inertia.replay.joint_numbers import ACROSS, CENTRE, FORCE, SHIFT, TILT
from jax_inertia.replay.loop import ALL, Loop, Parameter
from jax_inertia.replay.result import Tie

_TIED = 0.9
_EFFECTS = {
    **dict.fromkeys(CENTRE, "payload"), **dict.fromkeys(SHIFT, "com_shift"), **dict.fromkeys(TILT, "gravity_tilt"),
    **dict.fromkeys(FORCE, "constant_force"), "spring_torque": "joint_spring", "stribeck_velocity": "stribeck_friction",
    "integral_windup": "drive_integral", **dict.fromkeys(ACROSS, "spring_across"),
}  # fmt: skip
_LEANS = "near one posture bias = offset · slope of gravity's torque; postures far apart distinguish them"
_SUM = "a replay shows only the sum of kd and damping; torque distinguishes them, or a second setting of kd"
_FACTOR = "gains, frictions and all masses by one factor are the same motion, and the log does not state the gains"
_SCALED = {"kp_scale": "payload", "kd_scale": "payload", "payload": "kp_scale"}
"""What a common factor of gains and masses makes of each other."""
_EXACT: Mapping[str, tuple[tuple[str, str], ...]] = {
    "kp_scale": (("torque_gain", "only the product of kp, torque gain and voltage shows; torque distinguishes them"),),
    "viscous_friction": (("kd_scale", _SUM),),
    "torque_bias": (("asymmetric_coulomb", "dry friction F + d one way and F − d the other is F and a torque of −d; "
                     "torque distinguishes them"),),
    "torque_saturation": (("torque_gain", "limit and torque gain: torque distinguishes them"),),
    "torque_speed": (("torque_gain", "stall torque and torque gain: torque distinguishes them"),),
}  # fmt: skip
IN_PART: Mapping[str, tuple[tuple[str, str], ...]] = {
    "dead_band": (("coulomb_friction", "friction stops a joint within F / kp of its target too; slow motion and "
                   "loads held at rest distinguish them"),),
    "backlash": (("dead_band", "both leave a joint within a width of its target"),),
    "load_friction": (("coulomb_friction", "where the load hardly changes F + μ |τ| is one number; other loads or "
                       "postures distinguish them"),),
    "stribeck_friction": (("coulomb_friction", "at one speed one number; slow and fast motion distinguish them"),),
    "position_friction": (("coulomb_friction", "near one posture it is one number; motion over the whole range "
                           "distinguishes them"),),
    "torque_speed": (("torque_saturation", "a limit alone, where the joint is never fast when it is at it"),),
    "quadratic_viscous": (("viscous_friction", "at one speed one number; slow and fast motion distinguish them"),),
    "asymmetric_coulomb": (("joint_spring", "a far spring is a torque too; wide motion distinguishes them"),),
    "spring_across": (("joint_spring", "where both joints move together it is a spring of each; either one moved alone "
                       "distinguishes them"),),
    "drive_integral": (("torque_bias", "a slow integral takes up what is always the same, as a constant torque does; "
                        "a longer log distinguishes them"),),
    "encoder_offset": (("torque_bias", _LEANS),),
    "torque_bias": (("encoder_offset", _LEANS),),
    "torque_saturation": (("torque_speed", "a limit that falls with speed, where the joint is always as fast there"),),
}  # fmt: skip
"""What an effect is like in part, by its family: family, and what distinguishes them."""


def effect_of(p: Parameter) -> str:
    """The family of effects that a number is of."""
    return _EFFECTS.get(p.family, p.family)


def place_of(joint: int, body: str, names: Sequence[str]) -> tuple[str, str]:
    """Kind and name of a place."""
    if body:
        return "body", body
    return ("global", "global") if joint == ALL else ("joint", names[joint])


def ties_of(
    family: str, place: tuple[str, str], found: Fit, k: int, loop: Loop, names
) -> tuple[Tie, ...]:
    """What else would do as well: by the equation always, and on this motion by the fit's correlations."""
    p = found.table[k]
    # Torque tells a loop from a motor, and kd from damping.
    untold = found.error.shape[1] == len(names)
    exact = _EXACT.get(family, ()) if untold else ()
    if (family, p.family) == ("kd_scale", "viscous_friction"):
        exact = (("viscous_friction", _SUM),)
    out = [Tie(tie, *place, text, True) for tie, text in exact]
    if family == "target_delay" and len(names) == 1:
        own = ("joint", names[0]) if p.joint == ALL else ("global", "global")
        out.append(Tie(family, *own, "of one joint, its own delay is that of all", True))
    out += [Tie(tie, *place, text, False) for tie, text in IN_PART.get(family, ())]
    if untold and loop.source == "model" and family in _SCALED:
        out.append(Tie(_SCALED[family], "global", "global", _FACTOR, False))
    sigma = found.sigma
    for i, other in enumerate(found.table):
        known = sigma[i] > 0 and sigma[k] > 0
        if i == k or not known or other.is_tolerance:
            continue
        commanded = {(t.family, t.kind, t.name) for t in out}
        named = (effect_of(other), *place_of(other.joint, other.body, names))
        if named in commanded or named == (family, *place):
            continue
        if abs(found.covariance[i, k]) > _TIED * sigma[i] * sigma[k]:
            slope = found.covariance[i, k] / sigma[k] ** 2
            text = f"one more here is {slope:.3g} there"
            out.append(Tie(*named, text, False))
    if family in _LATE:
        damps = (
            f"1 ms of delay damps like kp · 1 ms = {1e-3 * loop.kp[max(p.joint, 0)]:.3g} N m s/rad"
        )
        out.append(Tie(_LATE[family], *place, f"in part: {damps}; fast and slow motion tell which", False))  # fmt: skip
    return tuple(out)


_LATE = {
    "target_delay": "viscous_friction", "viscous_friction": "target_delay", "target_lag": "target_delay",
    "target_low_pass": "target_lag",
    "actuator_lag": "target_lag",
    "kd_scale": "target_delay",
}  # fmt: skip
