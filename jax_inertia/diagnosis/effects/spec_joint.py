"""A joint, its spring and its actuators in a MuJoCo spec, in SI units whatever the spec's own."""

import mujoco
import numpy as np

from jax_inertia.diagnosis.effects.identified import Identified
from jax_inertia.model.mujoco_types import MjSpec

SOFT = 1e-3
"""Stiffness of the spring that makes a constant torque, of that torque [1/rad]: so it changes by 0.1 % over a radian,
far less than a log tells, and the spring is wound to 1000 rad."""


def joint_of(spec: MjSpec, effect: Identified):
    """The joint that an effect is at; ValueError with the names there are, where there is none."""
    return joint_named(spec, effect.name)


def joint_named(spec: MjSpec, name: str):
    """The joint of that name; ValueError with the names there are, where there is none."""
    joint = spec.joint(name)
    if joint is None:
        names = ", ".join(j.name for j in spec.joints)
        raise ValueError(f"the model has no joint {name!r}; it has: {names}")
    return joint


def unit_of(spec: MjSpec, joint) -> float:
    """Radians in the unit of a joint's positions in the spec; 1 for metres."""
    hinge = joint.type == mujoco.mjtJoint.mjJNT_HINGE
    return float(np.deg2rad(1.0)) if spec.compiler.degree and hinge else 1.0


def set_first(vector, value: float) -> np.ndarray:
    """A polynomial's linear coefficient set, its others kept."""
    return with_coefficient(vector, 0, value)


def with_coefficient(vector, k: int, value: float) -> np.ndarray:
    """A polynomial's k-th coefficient set, its others kept."""
    out = np.array(vector, float)
    out[k] = value
    return out


def add_damping(joint, value: float, power: int = 0) -> None:
    """Add −value |q̇|^power q̇ to a joint."""
    joint.damping = with_coefficient(joint.damping, power, joint.damping[power] + value)


def add_friction(joint, level: float) -> None:
    """Add a level of dry friction [N m]; none is less than nothing."""
    joint.frictionloss = max(joint.frictionloss + level, 0.0)


def wind(spec: MjSpec, joint, stiffness: float, rest: float, torque: float) -> None:
    """Add −stiffness (q − rest) + torque to a joint's spring; a constant b is ε |b| wound to ±1/ε."""
    own = float(joint.stiffness[0])
    total = own + stiffness
    moment = own * unit_of(spec, joint) * joint.springref + stiffness * rest + torque
    if abs(total) < SOFT * abs(moment):
        total = SOFT * abs(moment)
    joint.stiffness = set_first(joint.stiffness, total)
    joint.springref = moment / total / unit_of(spec, joint) if total else 0.0


def actuators_of(spec: MjSpec, effect: Identified) -> list:
    """Actuators on the effect's joint, or on every joint."""
    on_joint = [a for a in spec.actuators if a.trntype == mujoco.mjtTrn.mjTRN_JOINT]
    return [a for a in on_joint if effect.kind == "global" or a.target == effect.name]
