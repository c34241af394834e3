"""The humanoid and random states of it."""

import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Float

from jax_inertia.robots import HumanoidOptions, humanoid_mjcf

BODIES = ("torso_link", "left_elbow_pitch_link")
"""The paper's two estimated bodies: 20 states."""
States = tuple[Float[Array, "b nq"], Float[Array, "b nv"], Float[Array, "b nv"]]


def humanoid() -> mujoco.MjModel:
    """The paper's humanoid without its looks."""
    return mujoco.MjModel.from_xml_string(humanoid_mjcf(HumanoidOptions(visual=False)))


def states(model: mujoco.MjModel, count: int, dtype: object = np.float64) -> States:
    """So many random (q, v, a): quaternions of unit length, velocities of 2 and accelerations of 5 in SI units."""
    rng = np.random.default_rng(0)
    q = rng.normal(size=(count, model.nq))
    for j in np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE):
        at = model.jnt_qposadr[j] + 3
        q[:, at : at + 4] /= np.linalg.norm(q[:, at : at + 4], axis=1, keepdims=True)
    v, a = rng.normal(size=(2, count, model.nv))
    return tuple(jnp.asarray(x, dtype) for x in (q, 2.0 * v, 5.0 * a))
