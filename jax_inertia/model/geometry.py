"""Geometry of a compiled model: rotations, and where its bodies may touch what is around them."""

import itertools
from collections.abc import Iterator

import jax.numpy as jnp
import mujoco
import numpy as np

from jax_inertia.model.mujoco_types import MjModel
from jax_inertia.model.robot import Surface

_MIDDLE = 1e-3, 1.0 - 1e-3
"""Where `solimp` may have its middle."""


def rotation_of(quat: np.ndarray) -> np.ndarray:
    """Rotation matrix (3, 3) of a quaternion wxyz, of length one or not."""
    out = np.zeros(9)
    mujoco.mju_quat2Mat(out, quat / np.linalg.norm(quat))
    return out.reshape(3, 3)


def surface_of(model: MjModel, bodies: list[int]) -> Surface:
    """Of the given bodies of a compiled model: spheres and capsules as they are, others by the corners of their box."""
    body, points, radii, pivots, soft = [], [], [], [], []
    for index, b in enumerate(bodies):
        for geom in (model.body_geomadr[b] + np.arange(model.body_geomnum[b])).tolist():
            if not (model.geom_contype[geom] or model.geom_conaffinity[geom]):
                continue
            rotation = rotation_of(model.geom_quat[geom])
            for point, radius in _balls(model, geom):
                body.append(index)
                points.append(model.geom_pos[geom] + rotation @ point)
                radii.append(radius)
                pivots.append(_pivot(model, geom))
                soft.append(_softness(model, geom))
    return Surface(
        tuple(body),
        jnp.array(np.reshape(points, (-1, 3))),
        jnp.array(radii, float),
        jnp.array(np.reshape(pivots, (-1, 2))),
        jnp.array(np.reshape(soft, (-1, 9))),
    )


def _pivot(model: MjModel, geom: int) -> tuple[float, float]:
    """Coefficients of torsional and rolling friction [m] that a geom's contacts have."""
    _, torsional, rolling = model.geom_friction[geom].tolist()
    directions = model.geom_condim[geom]
    return torsional * (directions >= 4), rolling * (directions >= 6)


def _softness(model: MjModel, geom: int) -> list[float]:
    """`Surface.soft` of a geom on the floor, mixed of both as MuJoCo does (`priority`, `solmix`)."""
    ref, imp, margin = model.geom_solref[geom], model.geom_solimp[geom], model.geom_margin[geom]
    planes = np.flatnonzero(
        (model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE) & (model.geom_bodyid == 0)
    )
    if len(planes):
        floor = planes[0]
        above = int(model.geom_priority[floor]) - int(model.geom_priority[geom])
        own, other = model.geom_solmix[geom], model.geom_solmix[floor]
        share = 0.0 if above < 0 else 1.0 if above > 0 else other / max(own + other, 1e-12)
        mixed = (1 - share) * ref + share * model.geom_solref[floor]
        # Stiffness and damping as such are not mixed: the smaller, that is, the larger in size.
        direct = above == 0 and min(ref[0], model.geom_solref[floor][0]) <= 0
        ref = np.minimum(ref, model.geom_solref[floor]) if direct else mixed
        imp = (1 - share) * imp + share * model.geom_solimp[floor]
        margin = margin + model.geom_margin[floor]
    low, high = np.clip(imp[:2], mujoco.mjMINIMP, mujoco.mjMAXIMP)
    width, middle, power = max(imp[2], 1e-6), np.clip(imp[3], *_MIDDLE), max(imp[4], 1.0)
    if ref[0] > 0:
        time, ratio = ref[0], max(ref[1], 1e-6)
        stiff, damping = 1 / (high * time * ratio) ** 2, 2 / (high * time)
    else:
        stiff, damping = -ref[0] / high**2, -ref[1] / high
    inverse = model.body_invweight0[model.geom_bodyid[geom], 0]
    numbers = (stiff, damping, low, high, width, middle, power, inverse, margin)
    return [float(x) for x in numbers]


def _balls(model: MjModel, geom: int) -> Iterator[tuple[np.ndarray, float]]:
    """Points of a geom in its own frame, and the radius about each."""
    kind, size = model.geom_type[geom], model.geom_size[geom]
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        yield np.zeros(3), float(size[0])
    elif kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        yield from ((np.array([0.0, 0.0, side * size[1]]), float(size[0])) for side in (-1, 1))
    else:
        centre, half = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
        yield from ((centre + half * sign, 0.0) for sign in itertools.product((-1, 1), repeat=3))
