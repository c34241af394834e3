"""A robot some of whose joints are held: their bodies stay, welded to what carries them."""

import dataclasses
from collections.abc import Mapping

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jax_inertia.model.robot import HINGE, SLIDE, WELD, Robot, Topology
from jax_inertia.text.closest_names import suggestion

_OF_DOFS = ("armature", "damping", "frictionloss", "stiffness", "spring_reference")


def locked(robot: Robot, positions: Mapping[str, float]) -> Robot:
    """The robot with hinges and slides held at positions [rad, m], which are its joints no longer.

    Raises ValueError for a joint that it does not have, or that is no hinge or slide, and for a position that is no
    finite number.

    >>> from jax_inertia import load_model
    >>> from jax_inertia.model.lock import locked
    >>> from jax_inertia.robots.pendulum import double_pendulum
    >>> locked(load_model(double_pendulum()), {"elbow": 0.5})
    Robot(fixed base, 2 bodies, nq=1, nv=1, 3 kg; joints shoulder)
    """
    kinds = dict(zip(robot.joint_names, robot.joint_type, strict=True))
    scalar = [name for name, kind in kinds.items() if kind in (HINGE, SLIDE)]
    for name, value in positions.items():
        if name not in scalar:
            raise ValueError(
                f"the model has no hinge or slide {name!r} to hold; {suggestion(name, scalar)}"
            )
        if not np.isfinite(value):
            raise ValueError(f"joint {name!r} is to be held at {value}; give a finite number")
    if not positions:
        return robot
    if not set(kinds) - set(positions):
        raise ValueError("every joint of the model is to be held; one has to move")
    return _without(robot, positions)


def _without(robot: Robot, positions: Mapping[str, float]) -> Robot:
    top = robot.topology
    held = np.isin(robot.joint_names, list(positions))
    dofs = np.array([robot.joint_dofadr[j] for j in np.flatnonzero(held)])
    places = np.array([robot.joint_qposadr[j] for j in np.flatnonzero(held)])
    rotation, position = (np.array(x) for x in (robot.placement_rotation, robot.placement_position))
    kind = list(top.kind)
    for j in np.flatnonzero(held):
        node = int(top.dof_node[robot.joint_dofadr[j]])
        travel = positions[robot.joint_names[j]] - float(robot.joint_reference[node])
        turned, moved = _motion(robot, node, travel)
        position[node] = position[node] + rotation[node] @ moved
        rotation[node] = rotation[node] @ turned
        kind[node] = WELD
    kept = np.setdiff1d(np.arange(robot.nv), dofs)

    def earlier(address: int, of: np.ndarray) -> int:
        return int(address - np.sum(of < address))

    names = [(k, name) for k, name in enumerate(robot.joint_names) if not held[k]]
    return dataclasses.replace(
        robot,
        topology=Topology(
            top.parent,
            tuple(kind),
            tuple(
                0 if kind[i] == WELD else earlier(adr, places) for i, adr in enumerate(top.qpos_adr)
            ),
            top.body_node,
        ),
        joint_names=tuple(name for _, name in names),
        joint_type=tuple(robot.joint_type[k] for k, _ in names),
        joint_range=tuple(robot.joint_range[k] for k, _ in names),
        joint_qposadr=tuple(earlier(robot.joint_qposadr[k], places) for k, _ in names),
        joint_dofadr=tuple(earlier(robot.joint_dofadr[k], dofs) for k, _ in names),
        nq=robot.nq - len(places),
        nv=robot.nv - len(dofs),
        placement_rotation=jnp.asarray(rotation),
        placement_position=jnp.asarray(position),
        driven=tuple(d for d in robot.driven if not {d.joint, d.master} & set(positions)),
        **{name: getattr(robot, name)[kept] for name in _OF_DOFS},
    )


def _motion(
    robot: Robot, node: int, travel: float
) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, " 3"]]:
    """Rotation and shift of a joint that has travelled [rad, m] from its reference."""
    axis, anchor = (np.asarray(x[node]) for x in (robot.joint_axis, robot.joint_position))
    if robot.topology.kind[node] == SLIDE:
        return np.eye(3), travel * axis
    return hinge_motion(axis, anchor, travel)


def hinge_motion(
    axis: Float[np.ndarray, " 3"], anchor: Float[np.ndarray, " 3"], angle: float
) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, " 3"]]:
    """Rotation (Rodrigues) by an angle [rad] about an axis of length 1, and what it shifts the origin by [m]."""
    x, y, z = axis
    k = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    turned = np.eye(3) + np.sin(angle) * k + (1.0 - np.cos(angle)) * k @ k
    return turned, anchor - turned @ anchor
