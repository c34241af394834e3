"""A spring or play between a joint's motor and its link, put into a MuJoCo spec as a second hinge."""

import mujoco
import numpy as np

from jax_inertia.diagnosis.effects.identified import Identified
from jax_inertia.diagnosis.effects.spec_joint import joint_of, set_first, unit_of
from jax_inertia.model.mujoco_types import MjModel, MjSpec

DEFLECTION = "_deflection"
"""Added to a joint's name for the hinge between motor and link."""
LINK = "_link"
"""Added to a joint's name for the tendon by which its friction or its spring acts on the link."""
DAMPING_RATIO = 0.06
"""Of a coupling between motor and link, of the link alone: a log says little of it."""


def elasticity(spec, model, effect: Identified) -> tuple[bool, str]:
    """A spring between, slightly damped."""
    stiffness = effect.values["stiffness"]
    hinge, link = _between(spec, model, effect)
    if hinge is None:
        return False, _CROWDED.format(effect.name)
    hinge.stiffness = set_first(hinge.stiffness, stiffness)
    hinge.damping = set_first(hinge.damping, 2 * DAMPING_RATIO * np.sqrt(stiffness * link))
    return True, _two(effect)


def backlash(spec, model, effect: Identified) -> tuple[bool, str]:
    """The dead zone as a range whose limit is a spring.

    With a direct `solref` and an impedance d → 0, MuJoCo's limit is a₁ = a₀ − K' r − B' ṙ, a spring of K' over the
    inverse inertia A that the limit meets (Computation, *Constraint model*).
    """
    stiffness, half = effect.values["stiffness"], 0.5 * effect.values["dead_zone"]
    hinge, link = _between(spec, model, effect)
    if hinge is None:
        return False, _CROWDED.format(effect.name)
    whole = spec.compile()
    inverse = whole.dof_invweight0[whole.joint(hinge.name).dofadr[0]]
    hinge.limited = mujoco.mjtLimited.mjLIMITED_TRUE
    hinge.range = np.array([-1.0, 1.0]) * half / unit_of(spec, hinge)
    damping = 2 * DAMPING_RATIO * np.sqrt(stiffness * link)
    hinge.solref_limit = [-stiffness * inverse, -damping * inverse]
    hinge.solimp_limit = [1e-4, 1e-4, 1e-3, 0.5, 2]
    return True, _two(effect)


def _two(effect: Identified) -> str:
    """How a joint in two parts is to be read."""
    joint = effect.name
    text = (
        f"joint {joint!r} is its motor's side, where the encoder is; {joint}{DEFLECTION} is between motor and link, at "
        "zero where nothing is transmitted"
    )
    own = [what for what, of_link in ON_LINK.items() if effect.values.get(of_link)]
    if own:
        acts = "acts" if len(own) == 1 else "act"
        text += f"; {' and '.join(own)} {acts} on the link, by the tendon {joint}{LINK}"
    return text


_CROWDED = (
    "joint {0!r} is followed by another on the same body: its coupling is not in corrected.xml"
)


def _between(spec: MjSpec, model: MjModel, effect: Identified):
    """A second hinge in line with the joint, and the link's inertia about it; (None, 0) where there is no room."""
    joint = joint_of(spec, effect)
    body = joint.parent
    if body.joints[-1].name != joint.name:
        return None, 0.0
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    dof = model.joint(effect.name).dofadr[0]
    data.qvel[:], data.qacc[:] = 0.0, 0.0
    still, moved = np.zeros(model.nv), np.zeros(model.nv)
    mujoco.mj_rne(model, data, 1, still)
    data.qacc[dof] = 1.0
    mujoco.mj_rne(model, data, 1, moved)
    # mj_rne knows no armature: this is the link alone.
    link = max(float(moved[dof] - still[dof]), 1e-6)
    if joint.armature <= 0:
        # A motor without inertia behind a spring has no equation of motion.
        joint.armature = 0.05 * link
    hinge = body.add_joint(
        name=f"{effect.name}{DEFLECTION}", type=joint.type, axis=joint.axis, pos=joint.pos
    )
    # What its default class may give to other joints.
    hinge.armature, hinge.frictionloss, hinge.ref, hinge.springref = 0.0, 0.0, 0.0, 0.0
    hinge.damping, hinge.stiffness = np.zeros(3), np.zeros(3)
    hinge.limited = mujoco.mjtLimited.mjLIMITED_FALSE
    if any(effect.values.get(of_link) for of_link in ON_LINK.values()):
        _to_link(spec, effect, joint, hinge)
    return hinge, link


ON_LINK = {"friction": "friction_on_link", "constant torque": "offset_on_link"}
"""What of a joint may be its link's, and the number that says so."""


def _to_link(spec: MjSpec, effect: Identified, joint, hinge) -> None:
    """A joint's friction, or its spring, from its motor to its link, which turns by the sum of both: a tendon's."""
    tendon = spec.add_tendon(name=f"{joint.name}{LINK}")
    for side in (joint, hinge):
        tendon.wrap_joint(side.name, 1.0)
    if effect.values.get("friction_on_link"):
        tendon.damping, tendon.frictionloss = joint.damping, joint.frictionloss
        joint.damping, joint.frictionloss = np.zeros(3), 0.0
    if effect.values.get("offset_on_link"):
        # A constant torque is a soft spring, wound up.
        tendon.stiffness = joint.stiffness
        rest = joint.springref * unit_of(spec, joint)
        tendon.springlength = [rest, rest]
        joint.stiffness, joint.springref = np.zeros(3), 0.0
