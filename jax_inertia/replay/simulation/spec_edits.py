"""Actuators and joints that a replay puts into a model's spec: position loops, dead bands, play, a base held fast."""

from collections.abc import Sequence

import mujoco
import numpy as np

from jax_inertia.diagnosis.effects.spec_joint import set_first
from jax_inertia.model.mujoco_types import MjSpec
from jax_inertia.replay.loop import Loop

DEAD, INTEGRAL, PLAY, PULL, ACROSS = "_dead_band", "_integral", "_play", "_force", "_spring"
"""What names of added actuators, joints, sites and tendons end in."""
_LIGHT = 1e-6
# Of the ends of play: stiff, and inelastic, at the steps of a replay.
_STOP = np.array([0.004, 1.0]), np.array([0.99, 0.999, 1e-4, 0.5, 2.0])


def with_loop(spec: MjSpec, names: Sequence[str], loop: Loop) -> None:
    """Give every named joint one position actuator with the loop's gains, in place of whatever acts on it.

    Actuators keep the name of the one that they replace; those of other joints stay. Where the spec has MuJoCo's
    default integrator, Euler's, which takes kd explicitly, it gets the one that does not (implicitfast): a stiff loop
    on a light joint diverges else.
    """
    if spec.option.integrator == mujoco.mjtIntegrator.mjINT_EULER:
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    for j, name in enumerate(names):
        old = [
            a for a in spec.actuators if a.trntype == mujoco.mjtTrn.mjTRN_JOINT and a.target == name
        ]
        label = old[0].name if old else ""
        for a in old:
            spec.delete(a)
        new = spec.add_actuator(name=label or f"{name}_position", target=name)
        new.trntype = mujoco.mjtTrn.mjTRN_JOINT
        new.set_to_position(kp=loop.kp[j], kv=loop.kd[j])
        set_limit(new, loop.limit[j])


def set_limit(actuator, limit: float) -> None:
    """Make ± limit the force range of an actuator of a spec; infinity leaves it as it is."""
    if np.isfinite(limit):
        actuator.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
        actuator.forcerange = np.array([-limit, limit])


def fixed_base(spec: MjSpec) -> None:
    """Take the free joints out of a spec, and contacts: of a robot that hangs in the air."""
    free = [j for j in spec.joints if j.type == mujoco.mjtJoint.mjJNT_FREE]
    for joint in free:
        spec.delete(joint)
    for key in list(spec.keys):
        spec.delete(key)
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)


def actuator_of(spec: MjSpec, joint: str):
    """The last actuator on a joint of a spec, dead bands and integral terms left out."""
    on_joint = [
        a
        for a in spec.actuators
        if a.trntype == mujoco.mjtTrn.mjTRN_JOINT
        and a.target == joint
        and not a.name.endswith((DEAD, INTEGRAL))
    ]
    return on_joint[-1]


def add_dead_band(spec: MjSpec, joint: str, width: float = 1e-3) -> None:
    """An actuator that takes the spring of a joint's position actuator back within ± width; of the same targets.

    kp dz(e; b) = kp e − clip(kp e, ± kp b): a second position actuator of gain −kp, with a force range. A torque limit
    has to be the joint's then (`actuatorfrcrange`), of both together.
    """
    main = actuator_of(spec, joint)
    kp, gear = float(main.gainprm[0]), float(main.gear[0])
    new = spec.add_actuator(name=f"{joint}{DEAD}", target=joint)
    new.trntype = mujoco.mjtTrn.mjTRN_JOINT
    new.set_to_position(kp=1.0)
    new.gear, new.ctrllimited, new.ctrlrange = main.gear, main.ctrllimited, main.ctrlrange
    for name in ("gainprm", "biasprm"):
        prm = np.zeros_like(getattr(main, name))
        prm[0 if name == "gainprm" else 1] = -kp if name == "gainprm" else kp
        setattr(new, name, prm)
    new.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
    reach = kp * width * abs(gear)
    new.forcerange = np.array([-reach, reach])


def add_integral(spec: MjSpec, joint: str, gain: float = 1.0, windup: float = np.inf) -> None:
    """An actuator that adds clip(gain ∫(q* − q) dt, ± windup) to a joint's position actuator; of the same targets.

    MuJoCo's PID with nothing but its integral, which stays within its range of activation (by `imax` it would go
    beyond, by up to a step). A torque limit has to be the joint's then (`actuatorfrcrange`), of both together.
    """
    main = actuator_of(spec, joint)
    gear = float(main.gear[0])
    new = spec.add_actuator(name=f"{joint}{INTEGRAL}", target=joint)
    new.trntype = mujoco.mjtTrn.mjTRN_JOINT
    new.set_to_pid(kp=0.0, ki=gain / gear**2, ctrlspec=int(mujoco.mjtCtrlInput.mjINPUT_POS))
    if np.isfinite(windup):
        # Of the integral itself, in units of the actuator's length.
        new.actlimited = mujoco.mjtLimited.mjLIMITED_TRUE
        new.actrange = windup * abs(gear) / gain * np.array([-1.0, 1.0])
    new.gear, new.ctrllimited, new.ctrlrange = main.gear, main.ctrllimited, main.ctrlrange


def without_integral(spec: MjSpec, joint: str) -> tuple[float, float]:
    """Take the integral term of a joint's drive out of a spec: (its gain [N m/(rad s)], its clamp [N m]); 0 of none."""
    gain, windup = 0.0, np.inf
    for a in list(spec.actuators):
        mine = a.trntype == mujoco.mjtTrn.mjTRN_JOINT and a.target == joint
        if not mine or a.dyntype != mujoco.mjtDyn.mjDYN_PID:
            continue
        gear = float(a.gear[0])
        gain += gear**2 * float(a.gainprm[0])
        reach = float(a.dynprm[0]) or np.inf
        if np.any(a.actrange):
            reach = min(reach, float(np.abs(a.actrange).max()))
        windup = min(windup, abs(gear * a.gainprm[0]) * reach)
        if a.name.endswith(INTEGRAL):
            spec.delete(a)
        else:
            bias = np.array(a.biasprm, float)
            a.set_to_position(kp=-bias[1], kv=-bias[2])
            a.biasprm = bias
    return gain, windup


def share_limit(spec: MjSpec, joint: str, limit: float) -> None:
    """Make ± limit that of all actuators on a joint together; infinity leaves theirs as they are."""
    if np.isfinite(limit):
        actuator_of(spec, joint).forcelimited = mujoco.mjtLimited.mjLIMITED_FALSE
        spec.joint(joint).actfrclimited = mujoco.mjtLimited.mjLIMITED_TRUE
        spec.joint(joint).actfrcrange = limit * np.array([-1.0, 1.0])


def add_across(
    spec: MjSpec, before: str, joint: str, numbers: Sequence[float] = (0.0, 0.0, 1.0, 0.0)
) -> None:
    """A spring across two joints: a fixed tendon of length s = q_before + ratio q, −k (s − rest) − d ṡ along it.

    `numbers`: k [N m/rad], d [N m s/rad], ratio, rest [rad].
    """
    stiffness, damping, ratio, rest = (float(x) for x in numbers)
    taken, name = {t.name for t in spec.tendons}, f"{joint}{ACROSS}"
    while name in taken:
        name = f"{name}_more"
    new = spec.add_tendon(name=name, springlength=[rest, rest])
    new.stiffness, new.damping = (
        set_first(new.stiffness, stiffness),
        set_first(new.damping, damping),
    )
    new.wrap_joint(before, 1.0)
    new.wrap_joint(joint, ratio)


def add_force(spec: MjSpec, body: str, at: np.ndarray, force: np.ndarray) -> None:
    """A constant force at a point of a body, along the world's axes, by three actuators that take no control.

    They act on a site of the body, in the axes of one of the world.
    """
    world = f"world{PULL}"
    if world not in {s.name for s in spec.sites}:
        spec.worldbody.add_site(name=world)
    spec.body(body).add_site(name=f"{body}{PULL}", pos=at)
    for axis, size, letter in zip(np.eye(3), force, "xyz", strict=True):
        new = spec.add_actuator(name=f"{body}{PULL}_{letter}", target=f"{body}{PULL}")
        new.trntype, new.refsite = mujoco.mjtTrn.mjTRN_SITE, world
        new.gear = np.concatenate([axis, np.zeros(3)])
        new.gaintype, new.biastype = mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtBias.mjBIAS_AFFINE
        none = np.zeros_like(new.gainprm)
        new.gainprm, new.biasprm = none, np.concatenate([[size], none[1:]])


def add_play(spec: MjSpec, joint: str, width: float = 1e-3) -> None:
    """A second joint on the same axis, free within ± width/2: the link's, where the first is the motor's."""
    main = spec.joint(joint)
    body = main.parent
    new = body.add_joint(name=f"{joint}{PLAY}", type=main.type, axis=main.axis, pos=main.pos)
    new.armature = _LIGHT
    new.limited = mujoco.mjtLimited.mjLIMITED_TRUE
    degrees = spec.compiler.degree and main.type == mujoco.mjtJoint.mjJNT_HINGE
    half = 0.5 * width * (180.0 / np.pi if degrees else 1.0)
    new.range = np.array([-half, half])
    new.solref_limit, new.solimp_limit = _STOP


def without_play(spec: MjSpec) -> None:
    """Take joints of play out of a spec: a log has the motor's side of each, and no other."""
    names = {j.name for j in spec.joints}
    for joint in list(spec.joints):
        if joint.name.endswith(PLAY) and joint.name.removesuffix(PLAY) in names:
            spec.delete(joint)
