"""A joint of a MuJoCo spec, and its numbers in the spec's own units."""

import mujoco
import numpy as np

from jax_inertia.gap.effect import Effect
from jax_inertia.model.mujoco_types import MjSpec


def joint_of(spec: MjSpec, effect: Effect):
    """The joint that an effect is at; ValueError with the names there are, where there is none."""
    joint = spec.joint(effect.name)
    if joint is None:
        names = ", ".join(j.name for j in spec.joints)
        raise ValueError(f"the model has no joint {effect.name!r}; it has: {names}")
    return joint


def unit_of(spec: MjSpec, joint) -> float:
    """Radians in the unit of a joint's positions in the spec; 1 for metres."""
    hinge = joint.type == mujoco.mjtJoint.mjJNT_HINGE
    return float(np.deg2rad(1.0)) if spec.compiler.degree and hinge else 1.0


def set_first(vector, value: float) -> np.ndarray:
    """A polynomial's linear coefficient set, its others kept."""
    out = np.array(vector, float)
    out[0] = value
    return out
