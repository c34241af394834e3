"""Sweeps over a robot's tree: the only code that walks over it.

Three ideas keep them short to compile and cheap to run:

* Poses compose by pointer doubling: in round r every node multiplies the pose of its ancestor 2^r steps up, so that a
  tree of depth d takes ⌈log2 d⌉ vectorised rounds instead of a loop over bodies.
* With motion axes in world coordinates, velocities and subtree forces are sums along the tree, i.e. products with
  the 0/1 ancestor matrix, in blocks where it is large; nothing else is sequential.
* Everything is relative to the tree's origin (see `spatial`).
"""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jax_inertia.maths import spatial
from jax_inertia.maths.batch_last import compose, cross, skew, total, turn
from jax_inertia.maths.scalar.trace import one_thread
from jax_inertia.model.robot import BALL, FREE, HINGE, SLIDE, Robot


class Kinematics(eqx.Module):
    """Where everything is: node poses relative to the tree's origin, and the motion axes in world coordinates.

    Batch axes, if any, come last (see `batch_last`), here and in the functions below; those of a robot's arrays too.
    """

    rotation: Float[Array, "nodes 3 3 ..."]
    position: Float[Array, "nodes 3 ..."]
    axes: Float[Array, "nv 6 ..."]


def forward_kinematics(robot: Robot, q: Float[Array, "nq ..."]) -> Kinematics:
    """Poses of all nodes and motion axes of all degrees of freedom at configuration q."""
    top, robot = robot.topology, _one_batch(robot)
    rotation, position = _local_poses(robot, q)
    batch = position.shape[2:]
    world = jnp.eye(3, dtype=q.dtype).reshape(3, 3, *(1 for _ in batch))
    world = jnp.broadcast_to(world[None], (1, 3, 3, *batch))
    for jump in top.one_by_one if one_thread.get() else top.doubling:
        up_r = jnp.concatenate([rotation, world])[jump]
        up_p = jnp.concatenate([position, jnp.zeros_like(position, shape=(1, 3, *batch))])[jump]
        position = up_p + turn(up_r, position)
        rotation = compose(up_r, rotation)

    node, local = top.dof_node, top.dof_local
    joint = top.dof_scalar[:, None]
    columns = np.eye(3, dtype=q.dtype)[local % 3]
    own = robot.joint_axis[node]
    own = jnp.where(_over(joint, own), own, _over(columns, own))
    axis = turn(rotation[node], own)
    axis = jnp.where(_over(top.dof_in_world[:, None], axis), _over(columns, axis), axis)
    anchor = position[node] + turn(rotation[node], robot.joint_position[node])
    rotates = _over(top.dof_rotates[:, None], axis)
    axes = jnp.concatenate(
        [jnp.where(rotates, axis, 0.0), jnp.where(rotates, cross(anchor, axis), axis)], 1
    )
    return Kinematics(rotation, position, axes)


def _one_batch(robot: Robot) -> Robot:
    """The same robot, with batch axes of one length on all that the kinematics is made of."""
    leaves = {
        "placement_rotation": 3,
        "placement_position": 2,
        "joint_position": 2,
        "joint_axis": 2,
        "joint_reference": 1,
    }
    arrays = {name: getattr(robot, name) for name in leaves}
    batch = jnp.broadcast_shapes(*(x.shape[leaves[name] :] for name, x in arrays.items()))
    wide = [jnp.broadcast_to(x, (*x.shape[: leaves[name]], *batch)) for name, x in arrays.items()]
    return eqx.tree_at(lambda r: [getattr(r, name) for name in leaves], robot, wide)


def _over(constant: np.ndarray, like: Array) -> np.ndarray:
    """A constant of a list's first axes, made to broadcast over the others."""
    return constant.reshape(*constant.shape, *(1 for _ in range(like.ndim - constant.ndim)))


def _local_poses(
    robot: Robot, q: Float[Array, "nq ..."]
) -> tuple[Float[Array, "nodes 3 3 ..."], Float[Array, "nodes 3 ..."]]:
    """Pose of every node in its parent; free joints at their tree's origin.

    The pose of a hinge is affine in (1, sin, 1 − cos) of its angle, that of a slide in (1, travel), so that all come
    from one product with constants.
    """
    top = robot.topology
    kind = np.array(top.kind)
    scalar = np.isin(kind, (HINGE, SLIDE))
    adr = np.where(scalar, top.qpos_adr, 0).astype(int)
    travel = q[adr] - robot.joint_reference
    angle = jnp.where(_over(kind == HINGE, travel), travel, 0.0)
    # 2 sin²(angle/2) rather than 1 − cos: no cancellation near zero in float32.
    basis = [jnp.ones_like(angle), jnp.sin(angle), 2.0 * jnp.sin(0.5 * angle) ** 2]
    basis += [jnp.where(_over(kind == SLIDE, travel), travel, 0.0)]
    pose = _times(_pose_coefficients(robot), jnp.stack(basis, 1))
    batch = pose.shape[2:]
    rotation, position = pose[:, :9].reshape(len(kind), 3, 3, *batch), pose[:, 9:]

    turned = np.flatnonzero(np.isin(kind, (BALL, FREE)))
    if len(turned):
        begin = np.array([top.qpos_adr[i] + (3 if kind[i] == FREE else 0) for i in turned])
        motion = _quaternion_matrices(q[begin[:, None] + np.arange(4)])
        anchor, placement = robot.joint_position[turned], robot.placement_rotation[turned]
        offset = robot.placement_position[turned] + turn(placement, anchor - turn(motion, anchor))
        # Not by `.at[].set`, for a scatter is slow.
        at = np.arange(len(kind))
        at[turned] = len(kind) + np.arange(len(turned))
        rotation = jnp.concatenate([rotation, compose(placement, motion)])[at]
        position = jnp.concatenate([position, offset])[at]
    return rotation, position


def _pose_coefficients(robot: Robot) -> Float[Array, "nodes 12 4 ..."]:
    """Rotation (9) and position (3) of a scalar joint by (1, sin, 1 − cos, travel): Rodrigues about the anchor."""
    placement, axis, anchor = robot.placement_rotation, robot.joint_axis, robot.joint_position
    once = compose(placement, skew(axis))
    twice = compose(once, skew(axis))
    rotation = jnp.stack([placement, once, twice, jnp.zeros_like(once)], 3)
    position = [robot.placement_position, -turn(once, anchor), -turn(twice, anchor)]
    position = jnp.stack([*position, turn(placement, axis)], 2)
    return jnp.concatenate([rotation.reshape(len(axis), 9, 4, *axis.shape[2:]), position], 1)


def _times(
    coefficients: Float[Array, "n i k ..."], basis: Float[Array, "n k ..."]
) -> Float[Array, "n i ..."]:
    """Σ_k C_nik x_nk; as a product of matrices where only the basis has batches, which keeps XLA from computing sines
    once for every i."""
    n, i, k, *batch = coefficients.shape
    if math.prod(batch) > 1:
        return total(coefficients * basis[:, None], 2)
    flat = basis.reshape(n, k, math.prod(basis.shape[2:]))
    out = jnp.matmul(coefficients.reshape(n, i, k), flat, precision=jax.lax.Precision.HIGHEST)
    return out.reshape(n, i, *basis.shape[2:])


def _quaternion_matrices(quat: Float[Array, "n 4 ..."]) -> Float[Array, "n 3 3 ..."]:
    return jnp.moveaxis(spatial.quat_to_matrix(jnp.moveaxis(quat, 1, -1)), (-2, -1), (1, 2))


def tree_origin(robot: Robot, q: Float[Array, " nq"]) -> Float[Array, "nodes 3"]:
    """World position [m] of the origin that each node's kinematics is relative to."""
    top = robot.topology
    root = np.argmax(top.ancestors, axis=1) if top.parent else np.zeros(0, int)
    free = np.array(top.kind)[root] == FREE
    index = np.array(top.qpos_adr, int)[root][:, None] + np.arange(3)
    return jnp.where(free[:, None], q[np.where(free[:, None], index, 0)], 0.0)


def accumulate_outward(robot: Robot, x: Float[Array, "nv k ..."]) -> Float[Array, "nodes k ..."]:
    """For every node, the sum of x over the degrees of freedom that move it."""
    top = robot.topology
    out: Array = jnp.zeros_like(x[:0])
    for block in top.blocks:
        which = np.hstack([top.node_dof[block.nodes, block.dofs], block.below])
        sums = _sums(which, jnp.concatenate([x[block.dofs], out[block.entries]]))
        out = jnp.concatenate([out, sums])
    return out


def accumulate_inward(robot: Robot, f: Float[Array, "nb k ..."]) -> Float[Array, "nv k ..."]:
    """For every degree of freedom, the sum of f over the bodies that it moves."""
    top = robot.topology
    if len(top.blocks) == 1:
        return _sums(top.body_dof.T, f)
    at, parent = np.array(top.body_node, int), np.array(top.parent, int)
    out: Array = jnp.zeros_like(f[:0])
    for block in top.blocks[::-1]:
        # What hangs on this block and was summed before.
        later = block.nodes.stop + np.arange(len(out))
        roots = later[(parent[later] >= block.nodes.start) & (parent[later] < block.nodes.stop)]
        below = np.concatenate([at[block.bodies], parent[roots]])
        which = top.ancestors[below, block.nodes].T
        added = jnp.concatenate([f[block.bodies], out[roots - block.nodes.stop]])
        out = jnp.concatenate([_sums(which, added), out])
    return out[top.dof_node]


def _sums(which: np.ndarray, x: Float[Array, "n k ..."]) -> Float[Array, "m k ..."]:
    out = jnp.matmul(
        jnp.asarray(which, x.dtype),
        x.reshape(x.shape[0], math.prod(x.shape[1:])),
        precision=jax.lax.Precision.HIGHEST,
    )
    return out.reshape(len(which), *x.shape[1:])
