"""Geometry of a compiled model: rotations, and where its bodies may touch what is around them."""

import itertools
from collections.abc import Iterator

import jax.numpy as jnp
import mujoco
import numpy as np

from jax_inertia.model.mujoco_types import MjModel
from jax_inertia.model.robot import Surface


def rotation_of(quat: np.ndarray) -> np.ndarray:
    """Rotation matrix (3, 3) of a quaternion wxyz, of length one or not."""
    out = np.zeros(9)
    mujoco.mju_quat2Mat(out, quat / np.linalg.norm(quat))
    return out.reshape(3, 3)


def surface_of(model: MjModel, bodies: list[int]) -> Surface:
    """Of the given bodies of a compiled model: spheres and capsules as they are, others by the corners of their box."""
    body, points, radii, pivots = [], [], [], []
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
    return Surface(
        tuple(body),
        jnp.array(np.reshape(points, (-1, 3))),
        jnp.array(radii, float),
        jnp.array(np.reshape(pivots, (-1, 2))),
    )


def _pivot(model: MjModel, geom: int) -> tuple[float, float]:
    """Coefficients of torsional and rolling friction [m] that a geom's contacts have."""
    _, torsional, rolling = model.geom_friction[geom].tolist()
    directions = model.geom_condim[geom]
    return torsional * (directions >= 4), rolling * (directions >= 6)


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
