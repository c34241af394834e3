"""The `Robot` pytree and its sweeps: the only code that walks over the tree of bodies.

MuJoCo allows several joints on one body, so the tree is kept as *nodes*: one for each joint, and one for each body
without a joint. Every node is a fixed placement in its parent followed by a motion; a body's frame is that of its
last node. Three ideas keep this short to compile and cheap to run:

* Poses compose by pointer doubling: in round r every node multiplies the pose of its ancestor 2^r steps up, so that a
  tree of depth d takes ⌈log2 d⌉ vectorised rounds instead of a loop over bodies.
* With motion axes in world coordinates, velocities and subtree forces are sums along the tree, i.e. products with
  the 0/1 ancestor matrix; nothing else is sequential.
* Everything is relative to the tree's origin (see `spatial`).
"""

import functools
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jax_inertia import spatial

FREE, BALL, SLIDE, HINGE, WELD = "free", "ball", "slide", "hinge", "weld"
_DOFS = {FREE: 6, BALL: 3, SLIDE: 1, HINGE: 1, WELD: 0}


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

    def astype(self, dtype) -> "Robot":
        """The same robot with every array in another floating-point type."""
        return jax.tree.map(lambda x: jnp.asarray(x, dtype), self)

    def __repr__(self) -> str:
        base = "free base" if self.has_free_base else "fixed base"
        mass = float(jnp.sum(self.pi[:, 0]))
        return f"Robot({base}, {self.nb} bodies, nq={self.nq}, nv={self.nv}, {mass:.4g} kg)"


def _index(name: str, names: tuple[str, ...], what: str) -> int:
    if name not in names:
        raise ValueError(f"no {what} named {name!r}; the model has: {', '.join(names)}")
    return names.index(name)


class Kinematics(eqx.Module):
    """Where everything is: node poses relative to the tree's origin, and the motion axes in world coordinates."""

    rotation: Float[Array, "nodes 3 3"]
    position: Float[Array, "nodes 3"]
    axes: Float[Array, "nv 6"]


def forward_kinematics(robot: Robot, q: Float[Array, " nq"]) -> Kinematics:
    """Poses of all nodes and motion axes of all degrees of freedom at configuration q."""
    top = robot.topology
    rotation, position = _local_poses(robot, q)
    eye = jnp.eye(3, dtype=rotation.dtype)
    for jump in top.doubling:
        up_r = jnp.concatenate([rotation, eye[None]])[jump]
        up_p = jnp.concatenate([position, jnp.zeros((1, 3), position.dtype)])[jump]
        position = up_p + spatial.matvec(up_r, position)
        rotation = spatial.matmul(up_r, rotation)

    node = top.dof_node
    in_world, rotates = top.dof_in_world[:, None], top.dof_rotates[:, None]
    world = eye[top.dof_local % 3]
    joint = np.isin(np.array(top.kind)[node], (HINGE, SLIDE))[:, None]
    local = jnp.where(joint, robot.joint_axis[node], world)
    axis = jnp.where(in_world, local, spatial.matvec(rotation[node], local))
    anchor = position[node] + spatial.matvec(rotation[node], robot.joint_position[node])
    axes = jnp.concatenate(
        [jnp.where(rotates, axis, 0.0), jnp.where(rotates, spatial.cross(anchor, axis), axis)], -1
    )
    return Kinematics(rotation, position, axes)


def _local_poses(
    robot: Robot, q: Float[Array, " nq"]
) -> tuple[Float[Array, "nodes 3 3"], Float[Array, "nodes 3"]]:
    """Pose of every node in its parent; free joints at their tree's origin."""
    top = robot.topology
    kind = np.array(top.kind)
    scalar = np.isin(kind, (HINGE, SLIDE))
    adr = np.where(scalar, top.qpos_adr, 0).astype(int)
    travel = jnp.where(scalar, q[adr] - robot.joint_reference, 0.0)
    turn, shift = jnp.where(kind == HINGE, travel, 0.0), jnp.where(kind == SLIDE, travel, 0.0)
    motion = spatial.axis_angle_to_matrix(robot.joint_axis, turn)
    for i in np.flatnonzero(np.isin(kind, (BALL, FREE))):
        start = top.qpos_adr[i] + (3 if kind[i] == FREE else 0)
        motion = motion.at[i].set(spatial.quat_to_matrix(q[start : start + 4]))
    # A rotation turns about the joint's anchor, not about the frame origin.
    offset = robot.joint_position - spatial.matvec(motion, robot.joint_position)
    offset = offset + robot.joint_axis * shift[:, None]
    rotation = spatial.matmul(robot.placement_rotation, motion)
    position = robot.placement_position + spatial.matvec(robot.placement_rotation, offset)
    return rotation, position


def tree_origin(robot: Robot, q: Float[Array, " nq"]) -> Float[Array, "nodes 3"]:
    """World position [m] of the origin that each node's kinematics is relative to."""
    top = robot.topology
    root = np.argmax(top.ancestors, axis=1) if top.parent else np.zeros(0, int)
    free = np.array(top.kind)[root] == FREE
    index = np.array(top.qpos_adr, int)[root][:, None] + np.arange(3)
    return jnp.where(free[:, None], q[np.where(free[:, None], index, 0)], 0.0)


def accumulate_outward(robot: Robot, x: Float[Array, "nv k"]) -> Float[Array, "nodes k"]:
    """For every node, the sum of x over the degrees of freedom that move it."""
    return jnp.asarray(robot.topology.node_dof, x.dtype) @ x


def accumulate_inward(robot: Robot, f: Float[Array, "nb k"]) -> Float[Array, "nv k"]:
    """For every degree of freedom, the sum of f over the bodies that it moves."""
    return jnp.asarray(robot.topology.body_dof.T, f.dtype) @ f
