"""A load on a body of a compiled model: more of the same body, at its own centre of mass or beside it.

With m added at the body's centre c plus r, to a body of mass M and inertia I about c:

    mass M + m,  centre c + m r / (M + m),  inertia (1 + m/M) I + M m / (M + m) (|r|² 1 − r rᵀ)
"""

import mujoco
import numpy as np
from jaxtyping import Float

from jax_inertia.model.mujoco_types import MjModel

_LEAST_SHARE = 0.05
"""Of a body's mass, that is left of it."""


def put(model: MjModel, body: int, added: float, beside: Float[np.ndarray, " 3"] | None) -> None:
    """Add to a body of a model, which is changed; `beside`: r in the body's axes [m], nothing where it is 0."""
    mass = float(model.body_mass[body])
    share = max(1.0 + added / mass, _LEAST_SHARE)
    model.body_mass[body] = mass * share
    model.body_inertia[body] *= share
    if beside is None or not np.any(beside):
        return
    more = mass * (share - 1.0)
    axes = np.zeros(9)
    mujoco.mju_quat2Mat(axes, model.body_iquat[body])
    axes = axes.reshape(3, 3)
    whole = axes @ np.diag(model.body_inertia[body]) @ axes.T
    whole += more / share * (beside @ beside * np.eye(3) - np.outer(beside, beside))
    size, way = np.linalg.eigh(whole)
    way[:, 0] *= np.sign(np.linalg.det(way))
    mujoco.mju_mat2Quat(model.body_iquat[body], way.ravel())
    model.body_inertia[body] = np.maximum(size, 1e-9)
    model.body_ipos[body] += more / (mass * share) * beside
    # Its own frame is its inertia's no longer.
    model.body_sameframe[body] = 0
