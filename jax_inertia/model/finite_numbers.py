"""Numbers of a model that are none: MuJoCo reads and compiles NaN and infinities, and results then say nothing."""

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from jax_inertia.model.file_safety import ModelError
from jax_inertia.model.mujoco_types import MjModel
from jax_inertia.model.robot import WELD, Robot

_BODY = {
    "pos": "pos",
    "quat": "quat",
    "mass": "mass",
    "ipos": "pos of its inertial",
    "iquat": "axes of its inertial",
    "inertia": "principal moments",
    "gravcomp": "gravcomp",
}
_JOINT = {"pos": "pos", "axis": "axis", "stiffness": "stiffness"}
_DOF = {"armature": "armature", "damping": "damping", "frictionloss": "frictionloss"}
_GEOM = {"pos": "pos", "quat": "quat", "size": "size", "aabb": "size"}
_ACTUATOR = {"gear": "gear", "armature": "armature", "damping": "damping"}


def require_finite(model: MjModel, where: str | Path) -> None:
    """ModelError naming the first element of a compiled model with a number that a `Robot` takes and that is none."""
    for element, attribute, value in _numbers(model):
        if not np.all(np.isfinite(value)):
            shown = " ".join(f"{x:g}" for x in np.atleast_1d(value)[:6])
            raise ModelError(f"{where}: {attribute} of {element} is {shown}; give finite numbers")


def _numbers(model: MjModel) -> Iterator[tuple[str, str, np.ndarray]]:
    """Element, attribute in MJCF's words, and value of all that a `Robot` is made from."""

    def named(kind: str, i: int) -> str:
        return f"{kind} {getattr(model, kind)(i).name or f'{kind}_{i}'!r}"

    def arrays(
        prefix: str, names: dict[str, str], owner: Callable[[int], str]
    ) -> Iterator[tuple[str, str, np.ndarray]]:
        for name, attribute in names.items():
            values = getattr(model, f"{prefix}_{name}")
            for i in _rows_without_numbers(values):
                yield owner(i), attribute, values[i]

    yield "option", "gravity", model.opt.gravity
    yield from arrays("body", _BODY, lambda i: named("body", i))
    yield from arrays("jnt", _JOINT, lambda i: named("joint", i))
    yield from arrays("dof", _DOF, lambda d: named("joint", int(model.dof_jntid[d])))
    sizes = np.diff([*model.jnt_qposadr, model.nq]) if model.njnt else []
    owners = np.repeat(np.arange(model.njnt), sizes)
    for name, attribute in (("qpos0", "ref"), ("qpos_spring", "springref")):
        for k in np.flatnonzero(~np.isfinite(getattr(model, name))).tolist():
            yield named("joint", int(owners[k])), attribute, getattr(model, name)[k]
    yield from arrays("geom", _GEOM, lambda i: named("geom", i))
    yield from arrays("actuator", _ACTUATOR, lambda i: named("actuator", i))


def require_finite_robot(robot: Robot, where: str | Path) -> None:
    """ModelError naming the body or joint of a robot's first number that is none, as products of finite ones may be.

    In single precision, too, which ends at 3·10³⁸.
    """
    nodes, dofs = _names_of_nodes(robot), _names_of_dofs(robot)
    bodies = [f"body {name!r}" for name in robot.body_names]
    moved = [nodes[k][1] for k in range(len(nodes))]
    placed = [nodes[k][0] for k in range(len(nodes))]
    owned = {
        "inertial parameters": (robot.pi, bodies),
        "orientation": (robot.placement_rotation, placed),
        "position": (robot.placement_position, placed),
        "pos": (robot.joint_position, moved),
        "axis": (robot.joint_axis, moved),
        "ref": (robot.joint_reference, moved),
        "armature": (robot.armature, dofs),
        "damping": (robot.damping, dofs),
        "frictionloss": (robot.frictionloss, dofs),
        "stiffness": (robot.stiffness, dofs),
        "springref": (robot.spring_reference, dofs),
        "gravity": (robot.gravity, ["option"] * 3),
        "gravcomp": (robot.compensated, bodies),
        "place of a geom": (robot.surface.point, [bodies[b] for b in robot.surface.body]),
        "contact law": (robot.surface.soft, [bodies[b] for b in robot.surface.body]),
        "size of a geom": (robot.surface.radius, [bodies[b] for b in robot.surface.body]),
    }
    for what, (value, owners) in owned.items():
        if value is None:
            continue
        x = np.asarray(value)
        if bad := _rows_without_numbers(x):
            raise ModelError(
                f"{where}: {what} of {owners[bad[0]]} cannot be held in {x.dtype}; give numbers of a robot's size"
            )


def _rows_without_numbers(x: np.ndarray) -> list[int]:
    return np.flatnonzero(~np.isfinite(x).all(axis=tuple(range(1, x.ndim)))).tolist()


def _names_of_nodes(robot: Robot) -> list[tuple[str, str]]:
    """Body and joint (else body) that each node belongs to."""
    joints, out, first = iter(robot.joint_names), [], 0
    for name, last in zip(robot.body_names, robot.topology.body_node, strict=True):
        for k in range(first, int(last) + 1):
            body = f"body {name!r}"
            moves = robot.topology.kind[k] != WELD
            out.append((body, f"joint {next(joints)!r}" if moves else body))
        first = int(last) + 1
    return out


def _names_of_dofs(robot: Robot) -> list[str]:
    sizes = np.diff([*robot.joint_dofadr, robot.nv]).tolist()
    return [
        f"joint {n!r}"
        for n, size in zip(robot.joint_names, sizes, strict=True)
        for _ in range(size)
    ]
