"""The nominal model with the numbers of a fit, as MJCF that replays as the fit did; and the same for a policy.

Attributes of corrected.xml: an actuator's gains, bias, force range, delay and time constant; a joint's armature,
damping, friction loss, reference, and the `solimpfriction` with which friction holds at rest; a body's inertial. A dead
band is a second actuator, of the same targets; play is a second joint on the axis. Friction that varies with torque
or speed is its mean in the file, and itself in `varying_friction.callback`.
"""

from typing import Any

import mujoco
import numpy as np

from jax_inertia.diagnosis.effects.environment import turned
from jax_inertia.diagnosis.effects.spec_joint import add_damping, set_first, unit_of, wind
from jax_inertia.diagnosis.result import Verdict
from jax_inertia.model.load import body_pi, set_inertials
from jax_inertia.model.mujoco_types import MjSpec
from jax_inertia.replay.listing import PARAMETERS, size_of, whole
from jax_inertia.replay.loop import TOLERANCES
from jax_inertia.replay.result import Diagnosis
from jax_inertia.replay.simulation.model_edits import change_body, changed_bodies
from jax_inertia.replay.simulation.plant import HOLD
from jax_inertia.replay.simulation.spec_edits import (
    DEAD,
    PLAY,
    PULL,
    actuator_of,
    add_dead_band,
    add_force,
    add_play,
    set_limit,
    with_loop,
)
from jax_inertia.text.closest_names import listed

_FINEST = 5e-4


def corrected(spec: MjSpec, found: Diagnosis) -> tuple[str, ...]:
    """Put what was found into a spec, which is changed; what has no attribute is in the remarks."""
    loop, names, x, was = found.loop, found.names, found.numbers.at_joint.lumped, found.original
    if loop.source != "model":
        with_loop(spec, names, loop)
    for j, name in enumerate(names):
        joint, actuator = spec.joint(name), actuator_of(spec, name)
        if found.verdict is not Verdict.NO_GAP and found.holds:
            joint.solimp_friction = HOLD
        if x.armature[j] != was.armature[j]:
            # Less than none is a loop's hold, which a model's timestep has too.
            joint.armature = max(x.armature[j], 0.0)
        if found.friction[j] != was.dry[j]:
            joint.frictionloss = found.friction[j]
        if (damping := x.damping[j] + x.back[j]) != was.damping[j]:
            joint.damping = set_first(joint.damping, max(damping, 0.0))
        if x.drag[j] != was.drag[j]:
            add_damping(joint, x.drag[j], power=1)
        if x.spring[j] or x.wound[j]:
            wind(spec, joint, x.spring[j], 0.0, x.wound[j])
        step = x.offset[j] / unit_of(spec, joint)
        joint.ref += step
        joint.springref += step
        joint.range = np.asarray(joint.range) + step
        _set_gains(actuator, found, j)
        _set_timing(spec, actuator, x.delay[j], x.lag[j] if x.lag[j] != was.lag[j] else 0.0)
        if x.dead[j] > 0:
            add_dead_band(spec, name, x.dead[j])
            second = [a for a in spec.actuators if a.name == f"{name}{DEAD}"][-1]
            _set_timing(spec, second, x.delay[j], x.lag[j])
            if np.isfinite(x.limit[j]):
                actuator.forcelimited = mujoco.mjtLimited.mjLIMITED_FALSE
                joint.actfrclimited = mujoco.mjtLimited.mjLIMITED_TRUE
                joint.actfrcrange = x.limit[j] * np.array([-1.0, 1.0])
        if x.play[j] > 0:
            add_play(spec, name, x.play[j])
    if x.forces:
        nominal = spec.compile()
        for body, force in x.forces.items():
            add_force(spec, body, nominal.body_ipos[nominal.body(body).id], force)
    for body in changed_bodies(x):
        model = spec.compile()
        change_body(model, body, x)
        set_inertials(spec, {body: body_pi(model, model.body(body).id)})
    spec.option.gravity = turned(np.asarray(spec.option.gravity), x.tilt)
    # Postures of the nominal model are of other references, and have no activations.
    for key in list(spec.keys):
        spec.delete(key)
    spec.compile()
    return _remarks(found)


def _remarks(found: Diagnosis) -> tuple[str, ...]:
    """What the file cannot say of itself."""
    x, out = found.numbers, []

    def where(of: np.ndarray) -> str:
        return listed([n for n, there in zip(found.names, of, strict=True) if there])

    if found.loop.source != "model":
        out.append(
            "corrected.xml has a position actuator at every joint of the log, with its gains, as replayed"
        )
    if (x.delay < 0).any():
        out.append("a negative delay of the targets is not in corrected.xml: their stamps are late")
    if (x.delay > 0).any():
        out.append(
            "targets on their way start at 0 in MuJoCo: after each reset call jax_inertia.replay.late_targets.start("
            "model, data, targets), or mj_initCtrlHistory, with the first targets"
        )
    if (x.dead > 0).any():
        out.append(
            f"the dead band of {where(x.dead > 0)} is a second actuator (NAME{DEAD}): give it the target of the first"
        )
    if (x.play > 0).any():
        out.append(
            f"the play of {where(x.play > 0)} is a second joint (NAME{PLAY}): the encoder is on the motor's side"
        )
    if x.varies:
        out.append(
            f"friction of {where(x.varies_at)} varies with torque, speed or position: corrected.xml has its "
            "mean; jax_inertia.replay.varying_friction.callback(model, report) sets it before each mj_step"
        )
    if (x.behind > 0).any():
        out.append(
            f"the lag of the motor at {where(x.behind > 0)} is in corrected.xml to its second order: targets that lag, "
            "and less kd and armature"
        )
    if x.forces:
        out.append(
            f"the force on {listed(list(x.forces))} is three more actuators, NAME{PULL}_x, _y, _z, without control"
        )
    if (x.drag > 0).any():
        out.append(
            f"the quadratic damping of {where(x.drag > 0)} is in corrected.xml, and MJX does not read it"
        )
    return tuple(out)


def _set_gains(actuator, found: Diagnosis, j: int) -> None:
    x, was, gear = found.numbers.at_joint.lumped, found.original, float(actuator.gear[0])
    ratio = float(x.kp[j] / was.kp[j])
    bias = np.array(actuator.biasprm, float)
    if ratio != 1.0:
        actuator.gainprm = set_first(actuator.gainprm, actuator.gainprm[0] * ratio)
        bias[1] *= ratio
    if x.bias[j] != was.bias[j]:
        bias[0] = x.bias[j] / gear
    if x.kd[j] - x.back[j] != was.kd[j]:
        bias[2] = (x.back[j] - x.kd[j]) / gear**2
    actuator.biasprm = bias
    if x.limit[j] != was.limit[j]:
        set_limit(actuator, x.limit[j] / abs(gear))


def _set_timing(spec: MjSpec, actuator, delay: float, lag: float) -> None:
    if delay < spec.option.timestep:
        # MuJoCo makes a whole step of any part of one.
        delay = round(delay / spec.option.timestep) * spec.option.timestep
    if delay > 0:
        actuator.delay = delay
        # By default longer ones are rounded up to whole steps too; along straight lines they are what they say.
        actuator.interp = 1
        # Enough of the past for whoever steps finer than the model says.
        actuator.nsample = int(np.ceil(delay / min(spec.option.timestep, _FINEST))) + 2
    if lag > 0:
        actuator.dyntype = mujoco.mjtDyn.mjDYN_FILTEREXACT
        actuator.dynprm = set_first(actuator.dynprm, lag)
        actuator.actlimited = mujoco.mjtLimited.mjLIMITED_FALSE


def policy(found: Diagnosis) -> dict[str, Any]:
    """What a simulator for training wants: each joint's numbers and the range to draw them from.

    A range is the number's 95 % interval; of what stayed at the nominal model's value, the interval that the log
    allows, the nominal value included.
    """
    joints: dict[str, dict] = {}
    shared: dict[str, dict] = {}
    fit, everything = found.found, found.everything
    for k, p in enumerate(fit.table):
        if p.family == "torque_lead" or p.family in TOLERANCES:
            # Of the log, not of the robot; and of what every model is off by.
            continue
        number = size_of(fit, k, found.loop)
        ends = [number.low, number.high]
        if fit.sigma[k] == 0 and k < len(everything.table):
            wide = size_of(everything, k, found.loop)
            ends = [min(wide.low, number.value), max(wide.high, number.value)]
        least = whole(p, p.low, found.loop) if np.isfinite(p.low) else -np.inf
        entry = {
            "value": number.value,
            "range": [max(ends[0], least), ends[1]],
            "unit": number.unit,
        }
        if not np.all(np.isfinite([entry["value"], *entry["range"]])):
            continue
        if p.joint >= 0:
            joints.setdefault(found.names[p.joint], {})[_POLICY.get(p.family, p.family)] = entry
        else:
            shared[_shared_name(p.family) + (f".{p.body}" if p.body else "")] = entry
    for j, name in enumerate(found.names):
        gains = joints.setdefault(name, {})
        gains["kp"] = {"value": float(found.loop.kp[j]), "unit": "N m/rad", "scaled_by": "kp_scale"}
        gains["kd"] = {"value": float(found.loop.kd[j]), "unit": "N m s/rad"}
    at_rest = {"friction_at_rest": {"solimpfriction": HOLD.tolist()}} if found.holds else {}
    return {"joints": joints, "all_joints": shared, **at_rest}


_POLICY = {"viscous_friction": "damping", "coulomb_friction": "frictionloss"}


def _shared_name(family: str) -> str:
    if family == "payload":
        return "mass_added"
    return PARAMETERS[family] if family.startswith("target_") else family
