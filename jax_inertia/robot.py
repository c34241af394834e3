"""The `Robot` pytree and its sweeps: the only code that walks over the tree of bodies.

MuJoCo allows several joints on one body, so the tree is kept as *nodes*: one for each joint, and one for each body
without a joint. Every node is a fixed placement in its parent followed by a motion; a body's frame is that of its
last node. Three ideas keep this short to compile and cheap to run:

* Poses compose by pointer doubling: in round r every node multiplies the pose of its ancestor 2^r steps up, so that a
  tree of depth d takes ⌈log2 d⌉ vectorised rounds instead of a loop over bodies.
* With motion axes in world coordinates, velocities and subtree forces are sums along the tree, i.e. products with
  the 0/1 ancestor matrix, in blocks where it is large; nothing else is sequential.
* Everything is relative to the tree's origin (see `spatial`).
"""

import functools
import math
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jax_inertia import spatial
from jax_inertia._names import listed
from jax_inertia._readable import has_numbers, line, table
from jax_inertia._vectors import compose, cross, skew, turn

FREE, BALL, SLIDE, HINGE, WELD = "free", "ball", "slide", "hinge", "weld"
_DOFS = {FREE: 6, BALL: 3, SLIDE: 1, HINGE: 1, WELD: 0}


BLOCK = 48
"""Nodes whose sums along the tree are taken by one product with a 0/1 matrix; with more, its zeros would cost more
than one product after the other."""


@dataclass(frozen=True)
class Block:
    """A run of nodes, their degrees of freedom and bodies, and how they hang on the nodes before them."""

    nodes: slice
    dofs: slice
    bodies: slice
    entries: np.ndarray
    """The nodes before the run on which some of its nodes hang."""
    below: np.ndarray
    """0/1 matrix (nodes of the run, entries): the entry on which each node hangs."""


@dataclass(frozen=True)
class Topology:
    """The static part of a robot: what is connected to what, hashable so that `jit` may specialise on it."""

    parent: tuple[int, ...]  # node → parent node, −1 for the world
    kind: tuple[str, ...]  # node → FREE, BALL, SLIDE, HINGE or WELD
    qpos_adr: tuple[int, ...]  # node → first index in q (0 where it has none)
    body_node: tuple[int, ...]  # body → the node that carries its frame

    @functools.cached_property
    def dof_node(self) -> np.ndarray:
        """Node moved by each degree of freedom (nv,)."""
        return np.repeat(np.arange(len(self.kind)), [_DOFS[k] for k in self.kind])

    @functools.cached_property
    def dof_local(self) -> np.ndarray:
        """Index of each degree of freedom within its joint (nv,)."""
        return np.concatenate([np.arange(_DOFS[k]) for k in self.kind] + [np.zeros(0)]).astype(int)

    @functools.cached_property
    def dof_rotates(self) -> np.ndarray:
        """Whether each degree of freedom is a rotation (nv,)."""
        kind = np.array(self.kind)[self.dof_node]
        return (kind == HINGE) | (kind == BALL) | ((kind == FREE) & (self.dof_local >= 3))

    @functools.cached_property
    def dof_in_world(self) -> np.ndarray:
        """Whether each degree of freedom is along a world axis: the translations of free joints (nv,)."""
        kind = np.array(self.kind)[self.dof_node]
        return (kind == FREE) & (self.dof_local < 3)

    @functools.cached_property
    def dof_scalar(self) -> np.ndarray:
        """Whether each degree of freedom is a joint of its own, a hinge or slide (nv,)."""
        return np.isin(np.array(self.kind)[self.dof_node], (HINGE, SLIDE))

    @functools.cached_property
    def ancestors(self) -> np.ndarray:
        """0/1 matrix (nodes, nodes): entry [i, j] says that j is i or an ancestor of i."""
        n = len(self.parent)
        out = np.zeros((n, n))
        for i, p in enumerate(self.parent):
            if p >= 0:
                out[i] = out[p]
            out[i, i] = 1.0
        return out

    @functools.cached_property
    def node_dof(self) -> np.ndarray:
        """0/1 matrix (nodes, nv): whether the degree of freedom moves the node."""
        return self.ancestors[:, self.dof_node]

    @functools.cached_property
    def body_dof(self) -> np.ndarray:
        """0/1 matrix (nb, nv): whether the degree of freedom moves the body."""
        return self.node_dof[list(self.body_node)]

    @functools.cached_property
    def blocks(self) -> tuple[Block, ...]:
        """The nodes in runs of at most `BLOCK`."""
        hung = list(range(len(self.parent)))
        out = []
        for begin in range(0, len(self.parent), BLOCK):
            end = min(begin + BLOCK, len(self.parent))
            for i in range(begin, end):
                p = self.parent[i]
                hung[i] = hung[p] if p >= begin else p
            entries = np.array(sorted({h for h in hung[begin:end] if h >= 0}), int)
            dofs, bodies = (
                slice(*np.searchsorted(x, (begin, end))) for x in (self.dof_node, self.body_node)
            )
            below = np.array(hung[begin:end])[:, None] == entries
            out.append(Block(slice(begin, end), dofs, bodies, entries, below.astype(float)))
        return tuple(out)

    @functools.cached_property
    def doubling(self) -> tuple[np.ndarray, ...]:
        """For each round of pointer doubling, the ancestor that every node composes with (n = the world)."""
        n = len(self.parent)
        jump = np.array([n if p < 0 else p for p in self.parent] + [n])
        rounds = []
        while np.any(jump[:n] != n):
            rounds.append(jump[:n])
            jump = jump[jump]
        return tuple(rounds)


class Robot(eqx.Module):
    """A rigid-body model in JAX arrays: bodies in MuJoCo's order, without the world and what is fixed to it.

    `pi` (nb, 10) are the inertial parameters of each body about its frame origin [kg, kg m, kg m²]; the other
    arrays are the kinematics (per node) and the joint-side quantities (per degree of freedom). Made by
    `jax_inertia.load_model`; change a leaf with `eqx.tree_at` or `with_pi`.

    >>> from jax_inertia import load_model
    >>> from jax_inertia.robots.pendulum import double_pendulum
    >>> robot = load_model(double_pendulum())
    >>> robot.body_index("lower"), robot.joint_names
    (1, ('shoulder', 'elbow'))
    >>> robot.with_pi((1,), 2 * robot.pi[1:])
    Robot(fixed base, 2 bodies, nq=2, nv=2, 4 kg; joints shoulder, elbow)
    """

    topology: Topology = eqx.field(static=True)
    body_names: tuple[str, ...] = eqx.field(static=True)
    joint_names: tuple[str, ...] = eqx.field(static=True)
    joint_type: tuple[str, ...] = eqx.field(static=True)
    joint_qposadr: tuple[int, ...] = eqx.field(static=True)
    joint_dofadr: tuple[int, ...] = eqx.field(static=True)
    nq: int = eqx.field(static=True)
    nv: int = eqx.field(static=True)

    pi: Float[Array, "nb 10"]
    placement_rotation: Float[Array, "nodes 3 3"]
    placement_position: Float[Array, "nodes 3"]
    joint_position: Float[Array, "nodes 3"]
    joint_axis: Float[Array, "nodes 3"]
    joint_reference: Float[Array, " nodes"]
    armature: Float[Array, " nv"]
    damping: Float[Array, " nv"]
    frictionloss: Float[Array, " nv"]
    stiffness: Float[Array, " nv"]
    spring_reference: Float[Array, " nv"]
    gravity: Float[Array, "3"]

    @property
    def nb(self) -> int:
        """Number of moving bodies."""
        return len(self.body_names)

    @property
    def has_free_base(self) -> bool:
        """Whether the first joint is a free joint."""
        return bool(self.joint_type) and self.joint_type[0] == FREE

    def body_index(self, name: str) -> int:
        """Index of a body by name; ValueError lists the names where there is no such body."""
        return _index(name, self.body_names, "moving body")

    def joint_index(self, name: str) -> int:
        """Index of a joint by name; ValueError lists the names where there is no such joint."""
        return _index(name, self.joint_names, "joint")

    def with_pi(self, bodies: tuple[int, ...], pi: Float[Array, "n 10"]) -> "Robot":
        """The same robot with other inertial parameters for the chosen bodies (by index)."""
        return eqx.tree_at(lambda r: r.pi, self, self.pi.at[jnp.array(bodies)].set(pi))

    def astype(self, dtype: str | type[Any] | np.dtype[Any]) -> "Robot":
        """The same robot with every array in another floating-point type."""
        return jax.tree.map(lambda x: jnp.asarray(x, dtype), self)

    @property
    def _is_plain(self) -> bool:
        """One robot with numbers to show: neither traced nor a batch."""
        return has_numbers(self.pi) and self.pi.ndim == 2

    def __repr__(self) -> str:
        base = "free base" if self.has_free_base else "fixed base"
        mass = f"{float(jnp.sum(self.pi[:, 0])):.4g} kg" if self._is_plain else "traced or batched"
        size = f"{self.nb} bodies, nq={self.nq}, nv={self.nv}, {mass}"
        return f"Robot({base}, {size}; joints {listed(self.joint_names, 12)})"

    def _repr_html_(self) -> str:
        """For notebooks: mass and centre of mass of each body, and the joints that move it."""
        if not self._is_plain:
            return line(repr(self))
        moving = [k for k, kind in enumerate(self.topology.kind) if kind != WELD]
        rows, first, pi = [], 0, np.asarray(self.pi)
        for name, node, (m, *h) in zip(
            self.body_names, self.topology.body_node, pi[:, :4], strict=True
        ):
            # A body's nodes end in its own: those after the last body's are its joints.
            joints = [
                j for j, k in zip(self.joint_names, moving, strict=True) if first <= k <= node
            ]
            com = ", ".join(f"{1e3 * x / m:.1f}" for x in h) if m > 0 else "–"
            rows.append((name, ", ".join(joints) or "(welded)", f"{m:.4g}", com))
            first = int(node) + 1
        head = ("body", "joints", "mass [kg]", "centre of mass [mm]")
        return line(repr(self)) + table(head, rows)


def _index(name: str, names: tuple[str, ...], what: str) -> int:
    if name not in names:
        raise ValueError(f"no {what} named {name!r}; the model has: {', '.join(names)}")
    return names.index(name)


class Kinematics(eqx.Module):
    """Where everything is: node poses relative to the tree's origin, and the motion axes in world coordinates.

    Batch axes, if any, come last (see `_batch_last`), here and in the functions below; those of a robot's arrays too.
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
    for jump in top.doubling:
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
        return jnp.sum(coefficients * basis[:, None], 2)
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
