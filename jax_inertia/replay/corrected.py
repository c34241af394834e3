"""The nominal model with the numbers of a fit, as MJCF that replays as the fit did; and the same for a policy.

Attributes of corrected.xml: an actuator's kp, kv, bias, force range, delay and time constant; a joint's armature,
damping, friction loss, reference, and the `solimpfriction` with which friction holds at rest; a body's inertial.
"""

from typing import Any

import mujoco
import numpy as np

from jax_inertia.diagnosis.effects.spec_joint import set_first, unit_of
from jax_inertia.diagnosis.result import Verdict
from jax_inertia.model.load import body_pi, set_inertials
from jax_inertia.model.mujoco_types import MjSpec
from jax_inertia.replay.loop import Loop
from jax_inertia.replay.pipeline import size_of, whole
from jax_inertia.replay.result import Diagnosis
from jax_inertia.replay.simulate import HOLD, actuator_of, timing, with_loop

_FINEST = 5e-4


def corrected(spec: MjSpec, found: Diagnosis) -> tuple[str, ...]:
    """Put what was found into a spec, which is changed; what has no attribute is in the remarks."""
    fit, loop, names, notes = found.found, found.loop, found.names, []
    if loop.source != "model":
        with_loop(spec, names, loop)
        notes.append(
            "corrected.xml has a position actuator at every joint of the log, with its gains, as replayed"
        )
    delay, lag, offset = timing(fit.table, fit.theta, len(names))
    if (delay < 0).any():
        notes.append(
            "a negative delay of the targets is not in corrected.xml: their stamps are late"
        )
    for j, name in enumerate(names):
        joint, actuator = spec.joint(name), actuator_of(spec, name)
        if found.verdict is not Verdict.NO_GAP:
            joint.solimp_friction = HOLD
        step = offset[j] / unit_of(spec, joint)
        joint.ref += step
        joint.springref += step
        joint.range = np.asarray(joint.range) + step
        late = actuator.delay + delay[j]
        if late < spec.option.timestep:
            # MuJoCo makes a whole step of any part of one.
            late = round(late / spec.option.timestep) * spec.option.timestep
        if late > 0:
            actuator.delay = late
            # By default longer ones are rounded up to whole steps too; along straight lines they are what they say.
            actuator.interp = 1
            # Enough of the past for whoever steps finer than the model says.
            actuator.nsample = int(np.ceil(late / min(spec.option.timestep, _FINEST))) + 2
        if lag[j] > 0:
            actuator.dyntype = mujoco.mjtDyn.mjDYN_FILTEREXACT
            actuator.dynprm = set_first(actuator.dynprm, lag[j])
            actuator.actlimited = mujoco.mjtLimited.mjLIMITED_FALSE
    for p, x in zip(fit.table, fit.theta, strict=True):
        if p.family == "payload":
            model = spec.compile()
            pi = body_pi(model, model.body(p.body).id)
            set_inertials(spec, {p.body: pi * (pi[0] + x) / pi[0]})
        elif p.joint >= 0:
            _edit(spec, names[p.joint], p, float(x), loop)
    # Postures of the nominal model are of other references, and have no activations.
    for key in list(spec.keys):
        spec.delete(key)
    spec.compile()
    return tuple(notes)


def _edit(spec: MjSpec, name: str, p, x: float, loop: Loop) -> None:
    """One number of a joint or its actuator."""
    joint, actuator = spec.joint(name), actuator_of(spec, name)
    gear = float(actuator.gear[0])
    bias = np.array(actuator.biasprm, float)
    if p.family == "armature":
        joint.armature = x
    elif p.family == "coulomb_friction":
        joint.frictionloss = x
    elif p.family == "viscous_friction":
        kd = min(x, float(loop.kd[p.joint]))
        joint.damping = set_first(joint.damping, x - kd)
        bias[2] = -kd / gear**2
    elif p.family == "kp_scale":
        actuator.gainprm = set_first(actuator.gainprm, actuator.gainprm[0] * np.exp(x))
        bias[1] *= np.exp(x)
    elif p.family == "torque_bias":
        bias[0] += x / gear
    elif p.family == "torque_saturation":
        actuator.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
        actuator.forcerange = np.exp(x) / abs(gear) * np.array([-1.0, 1.0])
    actuator.biasprm = bias


def policy(found: Diagnosis) -> dict[str, Any]:
    """What a simulator for training wants: each joint's numbers and the range to draw them from.

    A range is the number's 95 % interval; of what stayed at the nominal model's value, the interval that the log
    allows, the nominal value included.
    """
    joints: dict[str, dict] = {}
    shared: dict[str, dict] = {}
    fit, everything = found.found, found.everything
    for k, p in enumerate(fit.table):
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
        if p.joint >= 0:
            joints.setdefault(found.names[p.joint], {})[_POLICY.get(p.family, p.family)] = entry
        else:
            shared[f"mass_added.{p.body}" if p.body else "delay"] = entry
    for j, name in enumerate(found.names):
        gains = joints.setdefault(name, {})
        gains["kp"] = {"value": float(found.loop.kp[j]), "unit": "N m/rad", "scaled_by": "kp_scale"}
        gains["kd"] = {"value": float(found.loop.kd[j]), "unit": "N m s/rad"}
    return {
        "joints": joints,
        "all_joints": shared,
        "friction_at_rest": {"solimpfriction": HOLD.tolist()},
    }


_POLICY = {"viscous_friction": "damping", "coulomb_friction": "frictionloss"}
