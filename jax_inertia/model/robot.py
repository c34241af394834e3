"""The `Robot` pytree and the shape of its tree.

MuJoCo allows several joints on one body, so the tree is kept as *nodes*: one for each joint, and one for each body
without a joint. Every node is a fixed placement in its parent followed by a motion; a body's frame is that of its
last node. `kinematics` walks over it.
"""

import functools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jax_inertia.maths.argument_checks import known
from jax_inertia.model.model_errors import ModelErrors
from jax_inertia.text.closest_names import listed
from jax_inertia.text.notebook_page import has_numbers, line, table

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


PINION = 0.1
"""What a slide moves by in a radian of its drive [m]: radius of a pulley or pinion."""


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
    def dof_radian(self) -> np.ndarray:
        """What of each degree of freedom counts for as much as a radian of a hinge: of a slide `PINION` (nv,)."""
        return np.where(self.dof_rotates, 1.0, PINION)

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

    def welded(self, one: int, other: int) -> bool:
        """Whether two bodies, by index, move as one."""
        return bool(np.array_equal(self.body_dof[one], self.body_dof[other]))

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

    @functools.cached_property
    def one_by_one(self) -> tuple[np.ndarray, ...]:
        """The same for the poses of one generation after the other: more rounds, but each node composes once."""
        n = len(self.parent)
        depth = self.ancestors.sum(axis=1).astype(int)
        parent = np.where(np.array(self.parent) < 0, n, self.parent)
        return tuple(np.where(depth == d, parent, n) for d in range(2, depth.max(initial=0) + 1))


class Driven(NamedTuple):
    """A joint that follows another: `factor` · its position, plus `offset` [rad, m]."""

    joint: str
    master: str
    """Empty where the joint is kept at `offset`."""
    factor: float
    offset: float


class Surface(eqx.Module):
    """Balls that reach as far as the colliding geoms of a robot's bodies, in body frames."""

    body: tuple[int, ...] = eqx.field(static=True)
    """Whose each ball is (index among the robot's bodies)."""
    point: Float[Array, "p 3"]
    """m."""
    radius: Float[Array, " p"]
    """m."""
    pivot: Float[Array, "p 2"]
    """Moment that a contact may bear about its normal, and about what lies in the ground, per force on it [m]."""
    soft: Float[Array, "p 9"]
    """Its contact with the floor: stiffness [1/s²], damping [1/s], `solimp`, inverse mass [1/kg], margin [m]."""


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
    joint_range: tuple[tuple[float, float], ...] = eqx.field(static=True)
    """Least and greatest position of each joint [rad, m]; infinite where the model has no limit."""
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
    surface: Surface
    compensated: Float[Array, "nb 4"] | None = None
    """Mass and first moment of each body that MuJoCo's `gravcomp` lifts [kg, kg m]; None where it lifts nothing."""
    errors: ModelErrors | None = None
    """How far the numbers may be from the robot's, where the model says so: one that a diagnosis has corrected."""
    loops: tuple[str, ...] = eqx.field(static=True, default=())
    """Constraints that close a chain (connect, weld, ...), by name: their forces are not in the dynamics."""
    driven: tuple[Driven, ...] = eqx.field(static=True, default=())
    """Joints that follow another (URDF mimic, MJCF joint equality)."""

    @property
    def nb(self) -> int:
        """Number of moving bodies."""
        return len(self.body_names)

    @property
    def joint_kinds(self) -> dict[str, str]:
        """What each joint is (hinge, slide, ball, free), by name."""
        return dict(zip(self.joint_names, self.joint_type, strict=True))

    @property
    def has_free_base(self) -> bool:
        """Whether the first joint is a free joint."""
        return bool(self.joint_type) and self.joint_type[0] == FREE

    def body_index(self, body: int | str) -> int:
        """Index of a body by name, or by itself; ValueError where there is no such body, with the names there are."""
        if isinstance(body, str):
            return _index(body, self.body_names, "moving body")
        if isinstance(body, bool | np.bool_) or not isinstance(body, int | np.integer):
            raise ValueError(f"body {body!r} is neither a name nor an index")
        if not 0 <= body < self.nb:
            raise ValueError(f"body index {body} is out of range: the model has {self.nb} bodies")
        return int(body)

    def body_indices(
        self, bodies: Sequence[int | str], *, distinct: bool = True
    ) -> tuple[int, ...]:
        """`body_index` of several, or of one name alone.

        Raises ValueError for what is no list, a body that is not there, and, if they are to be `distinct`, one named
        twice.
        """
        bodies = [bodies] if isinstance(bodies, str) else bodies
        if not isinstance(bodies, Iterable):
            raise ValueError(f"bodies is {bodies!r}; give names or indices, in a list")
        out = tuple(self.body_index(body) for body in bodies)
        if distinct and len(set(out)) < len(out):
            raise ValueError(f"a body is named twice in {list(bodies)}")
        return out

    def rigid_with(self, body: int | str) -> tuple[str, ...]:
        """Other bodies that no joint parts from a body: no torque tells which of them a mass is on."""
        index, topology = self.body_index(body), self.topology

        def carrier(node: int) -> int:
            while node >= 0 and topology.kind[node] == WELD:
                node = topology.parent[node]
            return node

        own = carrier(topology.body_node[index])
        return tuple(
            name
            for k, name in enumerate(self.body_names)
            if k != index and carrier(topology.body_node[k]) == own
        )

    def joint_index(self, name: str) -> int:
        """Index of a joint by name; ValueError lists the names where there is no such joint."""
        return _index(name, self.joint_names, "joint")

    def with_pi(self, bodies: Sequence[int | str], pi: Float[Array, "n 10"]) -> "Robot":
        """The same robot with other inertial parameters for the chosen bodies (by name or index).

        Raises ValueError for a body that the robot does not have, one named twice, parameters that are not 10 numbers
        each, and a negative mass.
        """
        chosen = self.body_indices(bodies)
        if jnp.shape(pi) != (len(chosen), 10):
            raise ValueError(
                f"pi has shape {jnp.shape(pi)}; expected ({len(chosen)}, 10), a row for each body"
            )
        masses = known(jnp.asarray(pi)[:, 0])
        if masses is not None and np.any(masses < 0):
            row = int(np.argmax(masses < 0))
            name = self.body_names[chosen[row]]
            raise ValueError(f"body {name!r}: mass {masses[row]:.4g} kg; it cannot be negative")
        return self.believed(chosen, pi)

    def believed(self, bodies: tuple[int, ...], pi: Float[Array, "n 10"]) -> "Robot":
        """`with_pi` by index, unchecked: in a chart that reaches them, a belief's mass may be negative."""
        return eqx.tree_at(lambda r: r.pi, self, self.pi.at[np.array(bodies, int)].set(pi))

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
