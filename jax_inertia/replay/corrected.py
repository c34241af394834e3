"""The nominal model with the numbers of a fit, as MJCF that replays as the fit did.

Attributes of corrected.xml: an actuator's gains, bias, force range, delay and time constant; a joint's armature,
damping, friction loss, reference, and the `solimpfriction` with which friction holds at rest; a body's inertial. A dead
band is a second actuator, of the same targets; play is a second joint on the axis. Friction that varies with torque
or speed is its mean there, and itself in the law that the file carries (`step_law.py`), as is a low-pass of targets.
"""

from collections.abc import Sequence

import mujoco
import numpy as np

from jax_inertia.diagnosis.effects.environment import turned
from jax_inertia.diagnosis.effects.spec_joint import add_damping, set_first, unit_of, wind
from jax_inertia.model.load import body_pi, set_inertials
from jax_inertia.model.mujoco_types import MjSpec
from jax_inertia.replay import step_law
from jax_inertia.replay.joint_numbers import Numbers
from jax_inertia.replay.result import Correction
from jax_inertia.replay.simulation.model_edits import (
    change_body,
    changed_bodies,
    lightened,
    sprung,
)
from jax_inertia.replay.simulation.plant import HOLD
from jax_inertia.replay.simulation.spec_edits import (
    DEAD,
    INTEGRAL,
    PLAY,
    PULL,
    actuator_of,
    add_across,
    add_dead_band,
    add_force,
    add_integral,
    add_play,
    set_limit,
    share_limit,
    with_loop,
    without_integral,
)
from jax_inertia.text.closest_names import listed

_FINEST = 5e-4


def corrected(spec: MjSpec, found: Correction) -> tuple[str, ...]:
    """Put what was found into a spec, which is changed; what has no attribute is in the remarks."""
    loop, names, was = found.loop, found.names, found.original.at_joint
    if loop.source != "model":
        with_loop(spec, names, loop)
    x = found.in_file
    for j, name in enumerate(names):
        without_integral(spec, name)
        joint, actuator = spec.joint(name), actuator_of(spec, name)
        if found.holds:
            joint.solimp_friction = HOLD
        if x.armature[j] != was.armature[j]:
            joint.armature = max(x.armature[j], 0.0)
        if found.friction[j] != was.dry[j]:
            joint.frictionloss = found.friction[j]
        if (damping := x.damping[j] + x.back[j]) != was.damping[j]:
            joint.damping = set_first(joint.damping, max(damping, 0.0))
        if x.drag[j] != was.drag[j]:
            add_damping(joint, x.drag[j], power=1)
        if x.spring[j] or x.wound[j]:
            wind(spec, joint, x.spring[j], 0.0, x.wound[j])
        if x.offset[j]:
            step = x.offset[j] / unit_of(spec, joint)
            joint.ref += step
            joint.springref += step
            joint.range = np.asarray(joint.range) + step
        _set_gains(actuator, found, j)
        late = (x.delay[j], x.lag[j]) != (was.delay[j], was.lag[j])
        if late:
            set_timing(spec, actuator, x.delay[j], x.lag[j])
        if x.dead[j] > 0:
            add_dead_band(spec, name, x.dead[j])
            second = [a for a in spec.actuators if a.name == f"{name}{DEAD}"][-1]
            if late:
                set_timing(spec, second, x.delay[j], x.lag[j])
        if x.integral[j] > 0:
            add_integral(spec, name, x.integral[j], x.windup[j])
            second = [a for a in spec.actuators if a.name == f"{name}{INTEGRAL}"][-1]
            # Of a lag, the integral has the delay: ∫y = ∫x − T y.
            set_delay(spec, second, x.delay[j] + x.lag[j])
        if x.shares_limit[j]:
            share_limit(spec, name, x.limit[j])
        if x.play[j] > 0:
            add_play(spec, name, x.play[j])
    for before, j in found.pairs:
        if x.has_across[j]:
            stiffness, rest = sprung(x.across[j], x.across_torque[j])
            rest += float(x.offset[before] + x.ratio[j] * x.offset[j])
            own = stiffness, x.across_damping[j], x.ratio[j], rest
            add_across(spec, names[before], names[j], own)
    _set_bodies(spec, names, x)
    step_law.write(spec, names, found.numbers)
    # Postures of the nominal model are of other references, and have no activations.
    for key in list(spec.keys):
        spec.delete(key)
    spec.compile()
    return _remarks(spec, found)


def _set_bodies(spec: MjSpec, names: Sequence[str], x: Numbers) -> None:
    if x.forces:
        nominal = spec.compile()
        for body, force in x.forces.items():
            add_force(spec, body, nominal.body_ipos[nominal.body(body).id], force)
    for body in changed_bodies(x):
        model = spec.compile()
        change_body(model, body, x)
        set_inertials(spec, {body: body_pi(model, model.body(body).id)})
    if (x.armature < 0).any():
        model = spec.compile()
        light = lightened(model, np.array([model.joint(n).dofadr[0] for n in names]), x)
        set_inertials(spec, {body: body_pi(model, model.body(body).id) for body in light})
    if x.tilt.any():
        spec.option.gravity = turned(np.asarray(spec.option.gravity), x.tilt)


def _remarks(spec: MjSpec, found: Correction) -> tuple[str, ...]:
    """What the file cannot say of itself."""
    x, was, out = found.numbers.at_joint, found.original.at_joint, []

    def where(of: np.ndarray) -> str:
        return listed([n for n, there in zip(found.names, of, strict=True) if there])

    if found.loop.source != "model":
        out.append(
            "corrected.xml has a position actuator at every joint of the log, with its gains, as replayed"
        )
    if (x.delay != was.delay).any() or (x.lag != was.lag).any():
        out.append(
            "targets on their way, and filters, start at 0 in MuJoCo: after each reset call "
            "jax_inertia.replay.step_law.StepLaw(model).start(data, targets)"
        )
    buffered = [a.name or a.target for a in spec.actuators if a.delay > 0]
    if buffered:
        steps = max(a.delay for a in spec.actuators) / spec.option.timestep
        out.append(
            f"MJX steps an actuator's delay as if it had none: there, delay the targets of {listed(buffered)} yourself "
            f"(up to {steps:.2g} of the model's steps)"
        )
    if x.low_pass.any():
        said = next(iter(step_law.law(found.names, x)["low_pass"]["gain"].values()))
        period = float(x.low_pass_period[0])
        out.append(
            f"targets go through y ← y + {said:.3g} (x − y) once every {1e3 * period:.3g} ms, which no attribute of a "
            "model does: jax_inertia.replay.step_law.StepLaw(model).set(data, targets) does it before each mj_step"
        )
    if (x.dead > 0).any():
        out.append(
            f"the dead band of {where(x.dead > 0)} is a second actuator (NAME{DEAD}): give it the target of the first"
        )
    if (x.play > 0).any():
        out.append(
            f"the play of {where(x.play > 0)} is a second joint (NAME{PLAY}): the encoder is on the motor's side"
        )
    if (x.integral > 0).any():
        out.append(
            f"the integral of the drive at {where(x.integral > 0)} is a second actuator (NAME{INTEGRAL}, MuJoCo's PID, "
            "which MJX and older MuJoCo do not have): give it the target of the first; it starts at 0 unless "
            "StepLaw(model).start gets what it has reached"
        )
    if x.varies:
        out.append(
            f"friction of {where(x.varies_at)} varies with torque, speed or position: corrected.xml has its "
            "mean; jax_inertia.replay.step_law.StepLaw(model).set(data, targets) sets it before each mj_step"
        )
    if (x.behind > 0).any():
        out.append(
            f"the lag of the motor at {where(x.behind > 0)} is in corrected.xml as targets that lag, with the kd and "
            "armature that replay most like it"
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


def _set_gains(actuator, found: Correction, j: int) -> None:
    x, was, gear = found.in_file, found.original.at_joint, float(actuator.gear[0])
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


def set_delay(spec: MjSpec, actuator, delay: float) -> None:
    """Give an actuator of a spec a delay [s]; none below a step, of which MuJoCo would make a whole one."""
    h = float(spec.option.timestep)
    actuator.delay, actuator.nsample = 0.0, 0
    if delay >= h:
        actuator.delay = delay
        # By default longer ones are rounded up to whole steps too; along straight lines they are what they say.
        actuator.interp = 1
        # Enough of the past for whoever steps finer than the model says.
        actuator.nsample = int(np.ceil(delay / min(h, _FINEST))) + 2


def set_timing(spec: MjSpec, actuator, delay: float, lag: float) -> None:
    """Give an actuator of a spec a delay and a first-order lag [s] that are those of the plant in the model's own
    steps.

    MuJoCo makes a whole step H of any part of one; a filter that acts at once (`actearly`), y ← y + (1 − a)(x − y) with
    a = exp(−H/T), is late by H a / (1 − a), however little that is.
    """
    h = float(spec.option.timestep)
    if delay < h:
        late = delay + (h / np.expm1(h / lag) if lag > 0 else 0.0)
        lag, delay = (h / np.log1p(h / late) if late > 0 else 0.0), 0.0
    set_delay(spec, actuator, delay)
    actuator.dyntype = mujoco.mjtDyn.mjDYN_NONE
    if lag > 0:
        actuator.dyntype, actuator.actearly = mujoco.mjtDyn.mjDYN_FILTEREXACT, True
        actuator.dynprm = set_first(actuator.dynprm, lag)
        actuator.actlimited = mujoco.mjtLimited.mjLIMITED_FALSE
