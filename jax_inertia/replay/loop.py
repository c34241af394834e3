"""The position loop of a robot, and what a replay may change about loop and joints, as one vector of numbers.

The torque at a joint is what its loop gives, within its limit:

    τ = clip(kp (q*(t − d) − q) + kd (q̇* − q̇) + τ_ff + b, ± L) − v q̇

From positions at one setting of kd alone nothing tells kd and viscous friction v apart: their sum is one number.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float

from jax_inertia.diagnosis.settings import Settings
from jax_inertia.logs.log import Log, LogError
from jax_inertia.model.mujoco_types import MjModel
from jax_inertia.text.closest_names import listed


class Loop(NamedTuple):
    """kp [N m/rad], kd [N m s/rad] and torque limit [N m, inf where none] of each of the log's joints."""

    kp: Float[np.ndarray, " n"]
    kd: Float[np.ndarray, " n"]
    limit: Float[np.ndarray, " n"]
    source: str
    """Where kp is from: "log", "option" or "model"."""


def actuators_on(model: MjModel, joint: int) -> list[int]:
    """The actuators that act on one joint of a compiled model."""
    on_joint = model.actuator_trntype == int(mujoco.mjtTrn.mjTRN_JOINT)
    return np.flatnonzero(on_joint & (model.actuator_trnid[:, 0] == joint)).tolist()


def position_loop(
    log: Log,
    model: MjModel,
    kp: Sequence[float] | None = None,
    kd: Sequence[float] | None = None,
    *,
    model_first: bool = False,
) -> Loop:
    """The loop of each joint of a log: as given, else as logged, else of the model's position actuators.

    `model_first`: a model that has position actuators everywhere is taken at its word before the log is. Raises
    `LogError` naming the joints whose kp nobody says.
    """
    n = len(log.joint_names)
    own = np.full((n, 2), np.nan)
    limit = np.full(n, np.inf)
    for j, name in enumerate(log.joint_names):
        joint = model.joint(name).id
        if model.jnt_actfrclimited[joint]:
            limit[j] = np.abs(model.jnt_actfrcrange[joint]).max()
        for a in actuators_on(model, joint):
            gear = model.actuator_gear[a, 0]
            if model.actuator_forcelimited[a]:
                limit[j] = min(limit[j], abs(gear) * np.abs(model.actuator_forcerange[a]).max())
            affine = model.actuator_biastype[a] == int(mujoco.mjtBias.mjBIAS_AFFINE)
            # Of an integrated-velocity actuator the control is a velocity.
            affine &= model.actuator_dyntype[a] != int(mujoco.mjtDyn.mjDYN_INTEGRATOR)
            if affine and model.actuator_biasprm[a, 1] < 0:
                # Control is the joint's position where the gear is 1; with another one it is the motor's.
                own[j] = -(gear**2) * model.actuator_biasprm[a, 1:3]
    given = one_each("--kp", kp, n), one_each("--kd", kd, n)
    whole = model_first and bool(np.all(own[:, 0] > 0))
    logged = (None, None) if whole else (log.kp, log.kd)
    source = "model" if given[0] is None and logged[0] is None else "log"
    source = source if given[0] is None else "option"
    gains = []
    for k in range(2):
        said = given[k] if given[k] is not None else logged[k]
        gains.append(own[:, k] if said is None else np.asarray(said, float))
    if lacking := [x for x, g in zip(log.joint_names, gains[0], strict=True) if not g > 0]:
        raise LogError(
            f"kp of {listed(lacking)} is not known: the log holds no kp and the model has no position actuator there; "
            "give --kp (N m/rad, one for all joints or one each) and --kd"
        )
    return Loop(gains[0], np.nan_to_num(np.maximum(gains[1], 0.0)), limit, source)


def one_each(name: str, values: Sequence[float] | None, n: int) -> np.ndarray | None:
    """Values of an option or array `name`, one for each of n joints (n,); ValueError for another number, or below 0."""
    if values is None:
        return None
    out = np.asarray(values, float).ravel()
    if out.size not in (1, n) or not np.all(np.isfinite(out) & (out >= 0)):
        raise ValueError(
            f"{name} has {out.size} values; expected one, or one for each of {n} joints, none below 0"
        )
    return np.broadcast_to(out, (n,)).copy()


ALL, NO_JOINT = -1, -2
"""In place of a joint: all of them; of a body."""


class Parameter(NamedTuple):
    """One number that a replay depends on: where the nominal model has it, how far off it may well be, its bounds."""

    family: str
    joint: int
    """Place among the log's joints, or `ALL`."""
    nominal: float
    sd: float
    """Of the prior, about `mean`."""
    low: float
    high: float
    body: str = ""
    centre: float | None = None
    """Of the prior, where that is not the nominal value: of what is not there in the nominal model at all."""
    given: bool = False
    """Whether the model's own number is kept, and is off by what such numbers are off by alone."""
    own: float = 0.0
    """By how much the number of a model that is right is off, standard deviation; 0 of what is there or is not."""

    @property
    def is_tolerance(self) -> bool:
        """Whether it is what every nominal model is off by: fitted, and no effect."""
        return self.given or self.family in TOLERANCES

    @property
    def mean(self) -> float:
        """The prior's."""
        return self.nominal if self.centre is None else self.centre


UNITS: Mapping[str, str] = {
    "armature": "kg m^2",
    "viscous_friction": "N m s/rad",
    "coulomb_friction": "N m",
    "encoder_offset": "rad",
    "kp_scale": "1",
    "target_delay": "s",
    "loop_hold": "s",
    "own_steps": "s",
    "torque_bias": "N m",
    "torque_saturation": "N m",
    "target_lag": "s",
    "target_low_pass": "s",
    "actuator_lag": "s",
    "payload": "kg",
    "payload_x": "m",
    "payload_y": "m",
    "payload_z": "m",
    "kd_scale": "1",
    "torque_speed": "N m s/rad",
    "dead_band": "rad",
    "backlash": "rad",
    "load_friction": "1",
    "stribeck_friction": "N m",
    "stribeck_velocity": "rad/s",
    "torque_gain": "1",
    "position_friction": "N m/rad",
    "torque_lead": "s",
    "asymmetric_coulomb": "N m",
    "quadratic_viscous": "N m s²/rad²",
    "drive_integral": "N m/(rad s)",
    "integral_windup": "N m",
    "joint_spring": "N m/rad",
    "spring_across": "N m/rad",
    "across_ratio": "1",
    "across_torque": "N m",
    "across_damping": "N m s/rad",
    "spring_torque": "N m",
    "com_shift_x": "m",
    "com_shift_y": "m",
    "com_shift_z": "m",
    "tilt_x": "rad",
    "tilt_y": "rad",
    **dict.fromkeys(("force_x", "force_y", "force_z"), "N"),
    **dict.fromkeys(("mass_share", "inertia_share"), "1"),
    **dict.fromkeys(("centre_x", "centre_y", "centre_z"), "m"),
}
LOGARITHMIC = ("kp_scale", "kd_scale", "torque_saturation", "torque_gain")
"""Families whose number in the vector is a logarithm: of a gain over the one that is said, of the limit in N m."""
ORDINARY = (
    "armature",
    "viscous_friction",
    "coulomb_friction",
    "encoder_offset",
    "kp_scale",
    "kd_scale",
    "target_delay",
    "torque_lead",
)
CLOCK = "target_delay", "loop_hold", "own_steps", "torque_lead"
"""Families of all joints alike that clocks have: when a loop takes a target, how old what it acts on is, by how much
its velocity is older than its position and less than a model's own steps make it, and when its torque is logged."""
OFF = "centre_x", "centre_y", "centre_z"
SHARES = "mass_share", "inertia_share"
TOLERANCES = *SHARES, *OFF, "loop_hold", "own_steps"
"""Families of what every nominal model is off by: bodies' masses, inertias, centres, and how long its loop holds a
torque. Always fitted and never listed."""
COMMAND = (
    "kp_scale", "kd_scale", "target_delay", "target_lag", "torque_bias", "torque_saturation", "torque_speed",
    "dead_band", "torque_lead", "loop_hold", "own_steps", "target_low_pass", "drive_integral", "integral_windup",
)  # fmt: skip
"""Families between what a joint is commanded and its torque; the others are between torque and motion."""
# How far off what is said may be: kp of a robot's own settings, and of a model that somebody made up.
_KP_SAID, _KP_GUESSED = 0.3, 2.0
_OFFSET, _DELAY = 0.05, 0.02
_LONGEST_DELAY = 0.3
# A model without friction or rotor is still one of a joint that has them.
_DRY_SHARE = 0.3
HALF_PERIOD = 1e-3
"""Of a position loop [s]: of 500 Hz. What it acts on is older by as much on average, and a clock's phase is so
uncertain."""
_LONGEST_HOLD = 0.01
# Settings of kd that part kd from viscous friction differ by so much of it.
_APART = 0.05


def ordinary(
    loop: Loop,
    armature: Float[np.ndarray, " n"],
    damping: Float[np.ndarray, " n"],
    friction: Float[np.ndarray, " n"],
    inertia: Float[np.ndarray, " n"],
    heaviest: Float[np.ndarray, " n"],
    torque: Float[np.ndarray, " n"],
    settings: Sequence[Loop] = (),
    *,
    torque_logged: bool = False,
    commanded: bool = False,
    early: float = 0.0,
) -> tuple[Parameter, ...]:
    """What every robot of this kind has: five numbers a joint, one delay of the targets, and how long the loop holds.

    A joint whose kd differs between `settings`, the loops of the logs, has a number for kd too, and every joint has
    where torque is logged, which says what the loop's part of damping is; the rest is the joint's, and not negative.

    `inertia`: typical of each joint, rotor included; `torque`: typical of its motion; they say how large what the
    model lacks may be. Motors of a robot differ less than its links, and a light link may be a small part of what its
    rotor is: a rotor is of the order of the geometric mean of its joint's inertia and `heaviest`, the largest of the
    joints of its kind. No file holds a delay below 0. Torques that are `commanded` are
    what software made of targets, and nothing says that it was made of them when they got to the robot: how much
    later motion has them, `torque_lead`, is a number too. A torque that was measured is the one that acted, within a
    clock's phase. A model's own steps add up to `early` [s] of damping and kd to its inertia.
    """
    out = []
    said = _KP_GUESSED if loop.source == "model" else _KP_SAID
    own = Settings.ordinary_tolerance / 2.0
    # Gains that the log or the user says are taken at their word.
    gains = Settings.gain_tolerance if loop.source == "model" else 0.0
    rotor = 0.5 * np.sqrt(inertia * heaviest)
    for j in range(len(loop.kp)):
        viscous = loop.kd[j] + damping[j]
        # Critical damping is what a designer aims at.
        typical = max(viscous, 0.5 * float(np.sqrt(loop.kp[j] * inertia[j])))
        dry = max(friction[j], _DRY_SHARE * torque[j])
        # Torque knows what is kd and what is damping.
        least = loop.kd[j] if torque_logged else 0.0
        rub = float(np.hypot(own * damping[j], gains * loop.kd[j]))
        off = Settings.inertia_tolerance * armature[j], rub, own * friction[j], gains
        rows = (
            Parameter("armature", j, armature[j], max(armature[j], rotor[j]), 0.0, np.inf),
            Parameter("viscous_friction", j, viscous, typical, least, np.inf),
            Parameter("coulomb_friction", j, friction[j], 2.0 * dry, 0.0, np.inf),
            Parameter("kp_scale", j, 0.0, said, -6.0, 3.0),
        )
        rows = [p._replace(own=float(x)) for p, x in zip(rows, off, strict=True)]
        out += [*rows[:3], Parameter("encoder_offset", j, 0.0, _OFFSET, -1.0, 1.0), rows[3]]
        varies = any(abs(x.kd[j] - loop.kd[j]) > _APART * loop.kd[j] for x in settings)
        if varies or (torque_logged and loop.kd[j] > 0):
            out.append(Parameter("kd_scale", j, 0.0, said, -6.0, 3.0, own=gains))
    out.append(Parameter("target_delay", ALL, 0.0, _DELAY, 0.0, _LONGEST_DELAY))
    out.append(Parameter("loop_hold", ALL, 0.0, HALF_PERIOD, -early, _LONGEST_HOLD))
    whole = float(np.hypot(early, HALF_PERIOD))
    out.append(Parameter("own_steps", ALL, 0.0, whole, -HALF_PERIOD, early + HALF_PERIOD))
    if torque_logged:
        late = (
            (_DELAY, 0.0, _LONGEST_DELAY) if commanded else (HALF_PERIOD, 0.0, early + HALF_PERIOD)
        )
        out.append(Parameter("torque_lead", ALL, 0.0, *late))
    return tuple(out)
