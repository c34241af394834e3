"""Inertia and ranges of a compiled model's joints, and loads on its bodies."""

from collections.abc import Sequence

import mujoco
import numpy as np
from jaxtyping import Float, Int

from jax_inertia.model.mujoco_types import MjModel

_LEAST_SHARE = 0.05
"""Of a body's mass, that is left of it."""
_TAKEN = 0.75
"""Of the inertia about an axis that a body can lose and still exist. A decision: what remains is no thin sheet."""


def mass_matrix(
    model: MjModel, q: Float[np.ndarray, " n"], at: Int[np.ndarray, " n"]
) -> Float[np.ndarray, "v v"]:
    """M at a posture, q where `at` says and the model's reference elsewhere."""
    data, full = mujoco.MjData(model), np.zeros((model.nv, model.nv))
    data.qpos[at] = q
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, full)
    return full


def put_load(
    model: MjModel, body: int, added: float, offset: Float[np.ndarray, " 3"] | None
) -> None:
    """Add a load to a body of a model, which is changed: more of the same body, or a compact one off its centre.

    With m added at r (body's axes, m) from the centre c of a body of mass M and inertia I about c:

        mass M + m,  centre c + m r / (M + m),  inertia I + M m / (M + m) (|r|² 1 − r rᵀ)

    and (1 + m/M) I where there is no r. What is at one end of a link is not as long as the link.
    """
    mass = float(model.body_mass[body])
    share = max(1.0 + added / mass, _LEAST_SHARE)
    model.body_mass[body] = mass * share
    if offset is None or not np.any(offset):
        model.body_inertia[body] *= share
        return
    more = mass * (share - 1.0)
    about = offset @ offset * np.eye(3) - np.outer(offset, offset)
    _put_inertia(model, body, _inertia(model, body) + more / share * about)
    model.body_ipos[body] += more / (mass * share) * offset


def lighten(model: MjModel, joint: int, by: float) -> None:
    """Take inertia about a hinge's axis a [kg m²] from the body that it moves, in a model, which is changed.

    I − by a aᵀ about the body's centre of mass. A body that exists has Σ = tr(I)/2 1 − I ⪰ 0 (Traversaro et al.,
    IROS 2016), and so at most three quarters are taken of what leaves Σ − by/2 (1 − a aᵀ) so.
    """
    if by <= 0.0 or model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_HINGE:
        return
    body, axis = int(model.jnt_bodyid[joint]), np.array(model.jnt_axis[joint])
    whole = _inertia(model, body)
    spread = 0.5 * np.trace(whole) * np.eye(3) - whole
    across = 0.5 * (np.eye(3) - np.outer(axis, axis))
    most = 1.0 / float(np.linalg.eigvals(np.linalg.solve(spread, across)).real.max())
    _put_inertia(model, body, whole - min(by, _TAKEN * most) * np.outer(axis, axis))


def _inertia(model: MjModel, body: int) -> Float[np.ndarray, "3 3"]:
    """About the centre of mass, in the body's axes."""
    axes = np.zeros(9)
    mujoco.mju_quat2Mat(axes, model.body_iquat[body])
    axes = axes.reshape(3, 3)
    return axes @ np.diag(model.body_inertia[body]) @ axes.T


def _put_inertia(model: MjModel, body: int, whole: Float[np.ndarray, "3 3"]) -> None:
    size, way = np.linalg.eigh(whole)
    way[:, 0] *= np.sign(np.linalg.det(way))
    mujoco.mju_mat2Quat(model.body_iquat[body], way.ravel())
    model.body_inertia[body] = np.maximum(size, 1e-9)
    # Its own frame is its inertia's no longer.
    model.body_sameframe[body] = 0


def moved_bodies(model: MjModel) -> list[int]:
    """Named bodies with a mass that joints move."""
    there = (model.body_mass > 0) & (model.body_weldid > 0)
    return [b for b in np.flatnonzero(there).tolist() if model.body(b).name]


def bodies_off_their_axes(model: MjModel) -> list[int]:
    """Of those, the ones whose centre of mass matters to the joints."""
    return [b for b in moved_bodies(model) if not model.body_simple[b]]


def shift_centre(model: MjModel, body: int, shift: Float[np.ndarray, " 3"]) -> None:
    """Move a body's centre of mass by `shift` (body's axes, m) in a model, which is changed; mass and inertia stay."""
    model.body_ipos[body] += shift
    model.body_sameframe[body] = 0


def middles(model: MjModel, names: Sequence[str]) -> Float[np.ndarray, " n"]:
    """Middle of each joint's range, 0 where it has none."""
    ranges = [
        model.joint(n).range if model.jnt_limited[model.joint(n).id] else (0, 0) for n in names
    ]
    return np.mean(np.asarray(ranges, float), axis=1)


def without_contacts(model: MjModel) -> bool:
    """Whether nothing of it can touch anything."""
    off = model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    return bool(off) or not np.any((model.geom_contype > 0) | (model.geom_conaffinity > 0))
