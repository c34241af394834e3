"""What each effect changes in a MuJoCo spec: (spec, compiled spec, effect) → (whether attributes say it all, a remark).

A constant torque b is a spring of stiffness ε wound to b/ε. A coupling between motor and link is a second hinge.
"""

from collections.abc import Callable

import mujoco
import numpy as np

from jax_inertia.gap.couplings import backlash, elasticity
from jax_inertia.gap.effect import Effect
from jax_inertia.gap.spec_joints import joint_of, set_first, unit_of
from jax_inertia.model.load import body_pi, set_inertials
from jax_inertia.model.mujoco_types import MjModel, MjSpec

SOFT = 1e-6
"""Stiffness of the spring that makes a constant torque [N m/rad]: it changes by this over a radian."""


def _damping(number: str, *, whole: bool):
    def edit(spec, model, effect: Effect) -> tuple[bool, str]:
        joint = joint_of(spec, effect)
        joint.damping = set_first(joint.damping, joint.damping[0] + effect.values[number])
        return whole, ""

    return edit


def _coulomb(spec, model, effect: Effect) -> tuple[bool, str]:
    joint = joint_of(spec, effect)
    joint.frictionloss = max(joint.frictionloss + effect.values["coulomb"], 0.0)
    return True, ""


def _dry_law(spec, model, effect: Effect) -> tuple[bool, str]:
    """The constant part; the callback writes `dof_frictionloss` at each step."""
    _coulomb(spec, model, effect)
    return False, ""


def _asymmetric(spec, model, effect: Effect) -> tuple[bool, str]:
    """F⁺ and F⁻ are their mean as friction, and half their difference as a constant torque."""
    plus, minus = effect.values["positive"], effect.values["negative"]
    joint = joint_of(spec, effect)
    joint.frictionloss = max(joint.frictionloss + 0.5 * (plus + minus), 0.0)
    _wind(spec, joint, 0.0, 0.0, -0.5 * (plus - minus))
    return True, ""


def _armature(spec, model, effect: Effect) -> tuple[bool, str]:
    joint = joint_of(spec, effect)
    joint.armature = max(joint.armature + effect.values["armature"], 0.0)
    return True, ""


def _spring(spec, model, effect: Effect) -> tuple[bool, str]:
    values = effect.values
    _wind(spec, joint_of(spec, effect), values["stiffness"], values["rest_angle"], 0.0)
    return True, ""


def _bias(spec, model, effect: Effect) -> tuple[bool, str]:
    _wind(spec, joint_of(spec, effect), 0.0, 0.0, effect.values["bias"])
    return True, ""


def _wind(spec, joint, stiffness: float, rest: float, torque: float) -> None:
    """Add −k (q − rest) + torque to a joint's spring."""
    own = float(joint.stiffness[0])
    total = own + stiffness
    moment = own * unit_of(spec, joint) * joint.springref + stiffness * rest + torque
    if abs(total) < SOFT:
        total = SOFT
    joint.stiffness = set_first(joint.stiffness, total)
    joint.springref = moment / total / unit_of(spec, joint)


def _encoder_offset(spec, model, effect: Effect) -> tuple[bool, str]:
    """q_logged = q + o: the position that the model calls its reference moves by o, and so do spring and range."""
    joint = joint_of(spec, effect)
    offset = effect.values["offset"] / unit_of(spec, joint)
    joint.ref += offset
    joint.springref += offset
    joint.range = np.asarray(joint.range) + offset
    return True, ""


def _encoder_scale(spec, model, effect: Effect) -> tuple[bool, str]:
    return False, (
        f"joint {effect.name!r}: positions of corrected.xml are the real ones, "
        f"q = q_logged / {1 + effect.values['scale']:.6g}"
    )


def _tilt(spec, model, effect: Effect) -> tuple[bool, str]:
    turn = np.array([effect.values["tilt_x"], effect.values["tilt_y"], 0.0])
    angle = float(np.linalg.norm(turn))
    if angle > 0:
        quat, gravity = np.zeros(4), np.zeros(3)
        mujoco.mju_axisAngle2Quat(quat, turn / angle, angle)
        mujoco.mju_rotVecQuat(gravity, np.asarray(spec.option.gravity), quat)
        spec.option.gravity = gravity
    return True, ""


def _inertial(change: Callable[[np.ndarray, Effect], np.ndarray]):
    def edit(spec, model, effect: Effect) -> tuple[bool, str]:
        names = [body.name for body in spec.bodies]
        if effect.name not in names:
            raise ValueError(f"the model has no body {effect.name!r}; it has: {', '.join(names)}")
        pi = body_pi(model, model.body(effect.name).id)
        changed = change(pi, effect)
        set_inertials(spec, {effect.name: changed})
        body = spec.body(effect.name)
        if not body.gravcomp:
            return True, ""
        # What lifts a body goes on lifting what the model said it weighs.
        body.gravcomp *= pi[0] / changed[0]
        return True, _LIFTED.format(effect.name)

    return edit


_LIFTED = (
    "body {0!r}: its gravity compensation lifts as much as before, but at the centre of mass found"
)


def _about_origin(m: float, c: np.ndarray, central: np.ndarray) -> np.ndarray:
    """π from mass, centre and the six moments about it."""
    shift = m * (c @ c * np.eye(3) - np.outer(c, c))
    return np.concatenate([[m], m * c, central + shift[np.triu_indices(3)]])


def _parts(pi: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Mass, centre and the six moments about it."""
    m = float(pi[0])
    c = pi[1:4] / max(m, 1e-12)
    return m, c, pi[4:] - _about_origin(m, c, np.zeros(6))[4:]


def _payload(pi: np.ndarray, effect: Effect) -> np.ndarray:
    c = np.array([effect.values[f"com_{k}"] for k in "xyz"])
    m = effect.values["mass"]
    # MuJoCo has no body without rotational inertia; a point on a massless one gets that of a 2 mm ball.
    gyration = effect.values.get("gyration_radius", 0.0 if pi[0] > 0 else 1e-3)
    return pi + _about_origin(m, c, m * gyration**2 * np.array([1.0, 0, 0, 1.0, 0, 1.0]))


def _com_shift(pi: np.ndarray, effect: Effect) -> np.ndarray:
    m, c, central = _parts(pi)
    return _about_origin(m, c + [effect.values[f"com_shift_{k}"] for k in "xyz"], central)


def _link_inertia(pi: np.ndarray, effect: Effect) -> np.ndarray:
    m, c, central = _parts(pi)
    return _about_origin(m, c, effect.values["inertia_scale"] * central)


def _gain(spec, model, effect: Effect) -> tuple[bool, str]:
    for actuator in _actuators(spec, effect):
        gain = effect.values["gain"]
        actuator.gainprm = np.asarray(actuator.gainprm) * gain
        actuator.biasprm = np.asarray(actuator.biasprm) * gain
        actuator.forcerange = np.asarray(actuator.forcerange) * gain
    return False, ""


def _saturation(spec, model, effect: Effect) -> tuple[bool, str]:
    joint = joint_of(spec, effect)
    joint.actfrclimited = mujoco.mjtLimited.mjLIMITED_TRUE
    joint.actfrcrange = np.array([-1.0, 1.0]) * effect.values["limit"]
    return False, ""


def _delay(spec, model, effect: Effect) -> tuple[bool, str]:
    delay = effect.values["delay"]
    for actuator in _actuators(spec, effect):
        actuator.delay = delay
        actuator.nsample = max(2, int(np.ceil(delay / model.opt.timestep)) + 1)
    return False, ""


def _actuators(spec: MjSpec, effect: Effect) -> list:
    """Actuators on the effect's joint, or on every joint."""
    on_joint = [a for a in spec.actuators if a.trntype == mujoco.mjtTrn.mjTRN_JOINT]
    return [a for a in on_joint if effect.kind == "global" or a.target == effect.name]


EDITS: dict[str, Callable[[MjSpec, MjModel, Effect], tuple[bool, str]]] = {
    "viscous_friction": _damping("damping", whole=True),
    "friction_drift": _damping("damping_final", whole=False),
    "coulomb_friction": _coulomb,
    "stribeck_friction": _dry_law,
    "load_friction": _dry_law,
    "asymmetric_coulomb": _asymmetric,
    "armature": _armature,
    "joint_spring": _spring,
    "torque_bias": _bias,
    "torque_gain": _gain,
    "torque_saturation": _saturation,
    "time_delay": _delay,
    "encoder_offset": _encoder_offset,
    "encoder_scale": _encoder_scale,
    "gravity_tilt": _tilt,
    "payload": _inertial(_payload),
    "com_shift": _inertial(_com_shift),
    "link_inertia": _inertial(_link_inertia),
    "joint_elasticity": elasticity,
    "backlash": backlash,
}
