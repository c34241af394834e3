"""The nominal model with what was found: inertials, each joint's ordinary physics, odd effects that MJCF holds."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from jax_inertia.diagnosis.effects.base import Effect
from jax_inertia.diagnosis.effects.identified import GAIN, Identified
from jax_inertia.diagnosis.effects.registry import LEVEL_OF, known
from jax_inertia.diagnosis.result import Diagnosis, Found
from jax_inertia.diagnosis.simulate.corrected import Correction, corrected
from jax_inertia.diagnosis.simulate.plant import CREEPS
from jax_inertia.model.load import compile_spec, set_inertials
from jax_inertia.model.mujoco_types import MjSpec
from jax_inertia.model.robot import Robot


def correction(
    spec: MjSpec, robot: Robot, found: Diagnosis, extra: Sequence[Effect] = ()
) -> Correction:
    """The spec, which is changed, with the effects added; what no attribute and no step law holds is in the notes."""
    if found.inertials:
        set_inertials(spec, {name: np.array(pi) for name, pi in found.inertials.items()})
    found.errors.add_to(spec)
    compile_spec(spec)
    # Whole gains and ordinary numbers, joint by joint, in the place of what is listed of them.
    odd = (
        _identified(f)
        for f in found.odd
        if f.handed_over
        and (f.family != GAIN or not found.gains)
        and f.family not in found.joints.get(f.place.name, {})
    )
    gains = (
        Identified(GAIN, "joint", joint, {"gain": p.value}) for joint, p in found.gains.items()
    )
    done = corrected(spec, (*_ordinary(robot, found), *gains, *odd), extra)
    notes = tuple(
        f"{f.family.replace('_', ' ')} at {f.name} is in report.json and not in this model"
        for f in done.outside
    )
    return dataclasses.replace(done, notes=(*done.notes, *notes))


def turning_of(found: Diagnosis, robot: Robot) -> Float[np.ndarray, " nv"]:
    """Displacement over which each row's dry friction turns round [rad], or `CREEPS`, for rollouts."""
    turning = np.zeros(robot.nv)
    for joint, reach in found.presliding.items():
        row = robot.joint_dofadr[robot.joint_index(joint)]
        turning[row] = reach if reach >= 0 else CREEPS
    return turning


def _identified(f: Found) -> Identified:
    values = {name: p.value for name, p in f.parameters.items()}
    return Identified(f.family, f.place.kind, f.place.name, values, f.place.other)


def _ordinary(robot: Robot, found: Diagnosis) -> list[Identified]:
    """Each joint's numbers as changes of the nominal model's own."""
    own = {
        "viscous_friction": robot.damping,
        "coulomb_friction": robot.frictionloss,
        "armature": robot.armature,
    }
    held = {(LEVEL_OF.get(f.family), f.place.name) for f in found.found if f.handed_over}
    out = []
    for joint, numbers in found.joints.items():
        dof = robot.joint_dofadr[robot.joint_index(joint)]
        for family, p in numbers.items():
            # A law of several numbers holds the level too.
            if (family, joint) in held:
                continue
            nominal = float(own[family][dof]) if family in own else 0.0
            if p.value != nominal:
                effect = known(family)
                assert effect is not None
                (number,) = effect.units
                out.append(Identified(family, "joint", joint, {number: p.value - nominal}))
        if c := found.friction[joint].quadratic:
            out.append(Identified("quadratic_viscous", "joint", joint, {"coefficient": c}))
    return out
