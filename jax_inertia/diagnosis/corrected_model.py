"""The nominal model with what was found: inertials, each joint's ordinary physics, odd effects that MJCF holds."""

import dataclasses

import numpy as np

from jax_inertia.diagnosis.result import Diagnosis, Found
from jax_inertia.diagnosis.summary import DRY_FORMS
from jax_inertia.gap.callbacks import HANDLED
from jax_inertia.gap.correct import Correction, corrected
from jax_inertia.gap.edits import EDITS
from jax_inertia.gap.effect import Effect
from jax_inertia.model.load import compile_spec, set_inertials
from jax_inertia.model.mujoco_types import MjSpec
from jax_inertia.model.robot import Robot

NAMES = {
    "viscous_friction": "damping",
    "coulomb_friction": "coulomb",
    "armature": "armature",
    "torque_bias": "bias",
}


def correction(spec: MjSpec, robot: Robot, found: Diagnosis) -> Correction:
    """The spec, which is changed, with the effects added; what no attribute and no callback holds is in the notes."""
    held = [f for f in found.odd if f.family in EDITS or f.family in HANDLED]
    rest = [f for f in found.odd if f not in held]
    if found.inertials:
        set_inertials(spec, {name: np.array(pi) for name, pi in found.inertials.items()})
    compile_spec(spec)
    done = corrected(spec, (*_ordinary(robot, found), *(_effect(f) for f in held)))
    notes = tuple(
        f"{f.family.replace('_', ' ')} at {f.place.name} is in report.json and not in this model"
        for f in rest
    )
    return dataclasses.replace(done, notes=(*done.notes, *notes))


def _effect(f: Found) -> Effect:
    values = {name: p.value for name, p in f.parameters.items()}
    return Effect(f.family, f.place.kind, f.place.name, values)


def _ordinary(robot: Robot, found: Diagnosis) -> list[Effect]:
    """Each joint's numbers as changes of the nominal model's own."""
    own = {
        "viscous_friction": robot.damping,
        "coulomb_friction": robot.frictionloss,
        "armature": robot.armature,
    }
    whole_law = {f.place.name for f in found.found if f.family in DRY_FORMS}
    out = []
    for joint, numbers in found.joints.items():
        dof = robot.joint_dofadr[robot.joint_index(joint)]
        for family, p in numbers.items():
            # A law of several numbers holds the level too.
            if family == "coulomb_friction" and joint in whole_law:
                continue
            nominal = float(own[family][dof]) if family in own else 0.0
            if p.value != nominal:
                out.append(Effect(family, "joint", joint, {NAMES[family]: p.value - nominal}))
    return out
