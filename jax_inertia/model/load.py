"""MuJoCo models to `Robot`, and inertial parameters back into a model.

MuJoCo's own loader reads MJCF and URDF. What the rigid-body model cannot represent is refused (`ModelError`) or named
in a `ModelWarning`, element by element, never dropped in silence.
"""

import warnings
from collections.abc import Iterator
from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from jax_inertia.model.file_safety import ModelError
from jax_inertia.model.finite_numbers import require_finite, require_finite_robot
from jax_inertia.model.geometry import rotation_of, surface_of
from jax_inertia.model.model_errors import errors_in
from jax_inertia.model.mujoco_types import MjModel
from jax_inertia.model.robot import BALL, FREE, HINGE, SLIDE, WELD, Driven, Robot, Topology
from jax_inertia.model.spec import compile_spec, load_spec, model_path, set_inertials
from jax_inertia.model.urdf_read import ModelWarning
from jax_inertia.model.urdf_write import is_urdf, write_urdf

__all__ = [
    "ModelError",
    "ModelWarning",
    "body_pi",
    "compile_spec",
    "is_urdf",
    "load_model",
    "load_spec",
    "model_path",
    "set_inertials",
    "write_urdf",
]

_KIND = {
    mujoco.mjtJoint.mjJNT_FREE: FREE,
    mujoco.mjtJoint.mjJNT_BALL: BALL,
    mujoco.mjtJoint.mjJNT_SLIDE: SLIDE,
    mujoco.mjtJoint.mjJNT_HINGE: HINGE,
}
_SCALAR = (int(mujoco.mjtJoint.mjJNT_SLIDE), int(mujoco.mjtJoint.mjJNT_HINGE))
_ON_JOINT = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
_DISABLE = mujoco.mjtDisableBit


def load_model(model: str | Path | MjModel, *, floating_base: bool = False) -> Robot:
    """Read an MJCF or URDF file (or take a compiled `MjModel`) as a `Robot`.

    `floating_base` lets the root link of a URDF move freely, which the file has no usual way to say (unless that link
    is called "world"); an MJCF and an `MjModel` say so themselves.

    `robot_descriptions:NAME` is a model of that package, where it is on this machine already: nothing is fetched.
    Meshes may be missing where every body has explicit inertials. Bodies fixed to the world are left out, bodies
    welded to a moving one are kept. Raises ModelError for what cannot be used, and for a number that is not finite, by
    its element; warns (ModelWarning) of what the model has and rigid-body dynamics does not: tendon forces, equality
    constraints, fluid. Forces that the model's own flags disable are not there.

    >>> from jax_inertia import load_model
    >>> from jax_inertia.robots.pendulum import double_pendulum
    >>> load_model(double_pendulum())  # or load_model("arm.urdf")
    Robot(fixed base, 2 bodies, nq=2, nv=2, 3 kg; joints shoulder, elbow)
    """
    _check_kind(model, floating_base)
    if isinstance(model, str | Path):
        where = model
        compiled = compile_spec(load_spec(model, floating_base=floating_base), model)
    else:
        where, compiled = "MjModel", model
    if not compiled.nv:
        raise ModelError(
            f"{where}: nothing in it moves; a robot has joints (and a xacro file is expanded first)"
        )
    require_finite(compiled, where)
    for line in _left_out(compiled):
        warnings.warn(line, ModelWarning, stacklevel=2)
    # What overflows, or comes of a quaternion of no length, is named below.
    with np.errstate(all="ignore"):
        robot = _to_robot(compiled)
    require_finite_robot(robot, where)
    return robot


def body_pi(model: MjModel, body: int) -> np.ndarray:
    """π (10,) of one body of a compiled model, about its frame origin.

    >>> from jax_inertia.model.load import body_pi
    >>> from jax_inertia.robots.pendulum import double_pendulum
    >>> model = double_pendulum()
    >>> body_pi(model, model.body("lower").id).round(3) + 0.0
    array([ 1.  ,  0.  ,  0.  , -0.5 ,  0.27,  0.  ,  0.  ,  0.27,  0.  ,
            0.01])
    """
    r = rotation_of(model.body_iquat[body])
    m, c = model.body_mass[body], model.body_ipos[body]
    i = r @ np.diag(model.body_inertia[body]) @ r.T + m * (c @ c * np.eye(3) - np.outer(c, c))
    return np.array([m, *(m * c), i[0, 0], i[0, 1], i[0, 2], i[1, 1], i[1, 2], i[2, 2]])


def _check_kind(model: object, floating_base: bool) -> None:
    """Raise `ModelError` for what cannot be loaded, whatever it holds."""
    if isinstance(model, str) and model.lstrip().startswith("<"):
        raise ModelError(
            f"{model.strip()[:60]!r} is a model's text, not its file; save it, or give "
            "mujoco.MjModel.from_xml_string(text)"
        )
    if isinstance(model, mujoco.MjSpec):
        raise ModelError(
            "a model is a file or a compiled MjModel, not an MjSpec; give spec.compile()"
        )
    if not isinstance(model, str | Path | mujoco.MjModel):
        raise ModelError(f"a model is a file or a compiled MjModel, not {type(model).__name__}")
    if floating_base and isinstance(model, mujoco.MjModel):
        raise ModelError(
            "an MjModel says itself whether its base floats; give its base a <freejoint/>"
        )


# --- from a compiled model to arrays -----------------------------------------------------------------------------


class _Tree:
    """The nodes of a model's kinematic tree, one for each joint and each welded body that moves, parents first."""

    def __init__(self) -> None:
        self.parent: list[int] = []
        self.kind: list[str] = []
        self.qpos_adr: list[int] = []
        self.rotation: list[np.ndarray] = []
        self.position: list[np.ndarray] = []
        self.anchor: list[np.ndarray] = []
        self.axis: list[np.ndarray] = []
        self.reference: list[float] = []
        self.bodies: list[int] = []
        """Bodies that move, in the model's order, and the last node of each."""
        self.body_node: list[int] = []

    def add(
        self,
        parent: int,
        kind: str,
        pose: tuple[np.ndarray, np.ndarray],
        qpos_adr: int = 0,
        anchor: np.ndarray | None = None,
        axis: np.ndarray | None = None,
        reference: float = 0.0,
    ) -> int:
        """Append a node at a pose in its parent; its index."""
        self.parent.append(parent)
        self.kind.append(kind)
        self.qpos_adr.append(qpos_adr)
        self.rotation.append(pose[0])
        self.position.append(pose[1])
        self.anchor.append(np.zeros(3) if anchor is None else anchor)
        self.axis.append(np.array([0.0, 0.0, 1.0]) if axis is None else axis)
        self.reference.append(reference)
        return len(self.parent) - 1

    def add_joint(
        self, model: MjModel, j: int, parent: int, pose: tuple[np.ndarray, np.ndarray]
    ) -> int:
        """Append a joint's node; its index."""
        kind, adr = _KIND[mujoco.mjtJoint(model.jnt_type[j])], int(model.jnt_qposadr[j])
        if kind == FREE:
            return self.add(parent, FREE, _HERE, adr)
        scalar = kind in (HINGE, SLIDE)
        axis = model.jnt_axis[j].copy() if scalar else None
        reference = model.qpos0[adr] if scalar else 0.0
        return self.add(parent, kind, pose, adr, model.jnt_pos[j].copy(), axis, reference)


_HERE = np.eye(3), np.zeros(3)


def _tree(model: MjModel) -> _Tree:
    tree = _Tree()
    # Last node of each MuJoCo body (−1: fixed to the world), and the pose of fixed ones in the world.
    node_of = np.full(model.nbody, -1)
    fixed = {0: _HERE}
    for b in range(1, model.nbody):
        up = model.body_parentid[b]
        pose = rotation_of(model.body_quat[b]), model.body_pos[b].copy()
        if up in fixed:
            base_r, base_p = fixed[up]
            pose = base_r @ pose[0], base_p + base_r @ pose[1]
        node, joints = int(node_of[up]), model.body_jntadr[b] + np.arange(model.body_jntnum[b])
        if len(joints) == 0 and up in fixed:
            fixed[b] = pose
            continue
        for j in joints:
            node = tree.add_joint(model, int(j), node, pose)
            pose = _HERE
        if len(joints) == 0:
            node = tree.add(node, WELD, pose)
        node_of[b] = node
        tree.body_node.append(node)
        tree.bodies.append(b)
    return tree


def _to_robot(model: MjModel) -> Robot:
    tree = _tree(model)
    bodies = tree.bodies
    joints = range(model.njnt)
    dof_joint = model.dof_jntid
    scalar = np.isin(model.jnt_type[dof_joint], _SCALAR)
    armature, damping = _joint_side(model)
    spring = np.where(scalar, model.qpos_spring[model.jnt_qposadr[dof_joint]], 0.0)
    stacked = {
        "pi": np.array([body_pi(model, b) for b in bodies]).reshape(-1, 10),
        "placement_rotation": np.array(tree.rotation).reshape(-1, 3, 3),
        "placement_position": np.array(tree.position).reshape(-1, 3),
        "joint_position": np.array(tree.anchor).reshape(-1, 3),
        "joint_axis": np.array(tree.axis).reshape(-1, 3),
        "joint_reference": np.array(tree.reference),
        "armature": armature,
        "damping": damping * _enabled(model, _DISABLE.mjDSBL_DAMPER),
        "frictionloss": model.dof_frictionloss * _enabled(model, _DISABLE.mjDSBL_FRICTIONLOSS),
        "stiffness": np.where(scalar, model.jnt_stiffness[dof_joint], 0.0)
        * _enabled(model, _DISABLE.mjDSBL_SPRING),
        "spring_reference": spring,
        "gravity": model.opt.gravity * _enabled(model, _DISABLE.mjDSBL_GRAVITY),
    }
    body_names = tuple(model.body(b).name or f"body_{b}" for b in bodies)
    joint_names = tuple(model.joint(j).name or f"joint_{j}" for j in joints)
    rows = dict(zip(joint_names, model.jnt_dofadr.tolist(), strict=True))
    scalars = {name: d for name, d in rows.items() if scalar[d]}
    return Robot(
        topology=Topology(
            tuple(tree.parent), tuple(tree.kind), tuple(tree.qpos_adr), tuple(tree.body_node)
        ),
        body_names=body_names,
        joint_names=joint_names,
        joint_type=tuple(_KIND[mujoco.mjtJoint(model.jnt_type[j])] for j in joints),
        joint_qposadr=tuple(int(i) for i in model.jnt_qposadr),
        joint_dofadr=tuple(int(i) for i in model.jnt_dofadr),
        joint_range=tuple(_range_of(model, j) for j in joints),
        nq=model.nq,
        nv=model.nv,
        surface=surface_of(model, bodies),
        compensated=_compensated(model, bodies),
        loops=tuple(_loops(model)),
        driven=tuple(_driven(model)),
        errors=errors_in(model, body_names, scalars, model.nv),
        **{name: jnp.asarray(value) for name, value in stacked.items()},
    )


def _range_of(model: MjModel, j: int) -> tuple[float, float]:
    """Least and greatest position of a hinge or slide that is limited [rad, m]; infinite for any other joint."""
    if not model.jnt_limited[j] or model.jnt_type[j] not in _SCALAR:
        return -np.inf, np.inf
    low, high = model.jnt_range[j]
    return float(low), float(high)


def _active(model: MjModel) -> np.ndarray:
    return np.flatnonzero(model.eq_active0 * _enabled(model, _DISABLE.mjDSBL_EQUALITY))


def _loops(model: MjModel) -> Iterator[str]:
    """Constraints that close a chain, as they are called; those between joints on a straight line are `_driven`."""
    for i in _active(model):
        if not _is_straight(model, int(i)):
            kind = mujoco.mjtEq(model.eq_type[i]).name.removeprefix("mjEQ_").lower()
            yield f"{kind} {model.equality(i).name or int(i)!r}"


def _is_straight(model: MjModel, i: int) -> bool:
    joint = model.eq_type[i] == mujoco.mjtEq.mjEQ_JOINT
    return bool(joint and not np.any(model.eq_data[i, 2:5]))


def _driven(model: MjModel) -> Iterator[Driven]:
    """Joints that a joint equality has follow another, on a straight line, or keeps in place."""
    for i in _active(model):
        if not _is_straight(model, int(i)):
            continue
        slave, master = int(model.eq_obj1id[i]), int(model.eq_obj2id[i])
        # Of MuJoCo's polynomial, which is in positions from their references.
        start, factor = (float(x) for x in model.eq_data[i, :2])
        start += float(model.qpos0[model.jnt_qposadr[slave]])
        one = model.joint(slave).name or f"joint_{slave}"
        if master < 0:
            yield Driven(one, "", 0.0, start)
        else:
            other = model.joint(master).name or f"joint_{master}"
            offset = start - factor * float(model.qpos0[model.jnt_qposadr[master]])
            yield Driven(one, other, factor, offset)


def _compensated(model: MjModel, bodies: list[int]) -> jax.Array | None:
    """What of each body's mass and first moment gravity compensation lifts; None where it lifts nothing."""
    share = model.body_gravcomp[bodies]
    if not share.any():
        return None
    return jnp.asarray(share[:, None] * np.array([body_pi(model, b)[:4] for b in bodies]))


def _enabled(model: MjModel, flag: mujoco.mjtDisableBit) -> bool:
    return not model.opt.disableflags & int(flag)


def _reflected(model: MjModel) -> np.ndarray:
    """Whether each actuator's armature and damping are those of one degree of freedom (nu,)."""
    on_joint = np.isin(model.actuator_trntype, _ON_JOINT)
    joint = np.where(on_joint, model.actuator_trnid[:, 0], 0)
    return on_joint & np.isin(model.jnt_type[joint], _SCALAR)


def _joint_side(model: MjModel) -> tuple[np.ndarray, np.ndarray]:
    """Armature and damping of every degree of freedom, its actuators' included: gear² times theirs."""
    armature, damping = model.dof_armature.copy(), model.dof_damping.copy()
    for u in np.flatnonzero(_reflected(model)):
        d, gear = model.jnt_dofadr[model.actuator_trnid[u, 0]], model.actuator_gear[u, 0]
        armature[d] += gear**2 * model.actuator_armature[u]
        damping[d] += gear**2 * model.actuator_damping[u]
    return armature, damping


def _left_out(model: MjModel) -> Iterator[str]:
    """One line for each element whose force the rigid-body dynamics does not have."""
    if model.nflex:
        raise ModelError(f"{model.nflex} flex element(s): deformable bodies cannot be represented")
    for i in _active(model):
        equality = model.equality(i)
        kind = mujoco.mjtEq(model.eq_type[i]).name.removeprefix("mjEQ_").lower()
        yield f"{kind} equality {equality.name or int(i)!r}: its constraint force is left out"
    for i in range(model.ntendon):
        tendon = model.tendon(i)
        acts = (model.tendon_stiffness[i], model.tendon_damping[i], model.tendon_frictionloss[i])
        if any(acts) or model.tendon_armature[i]:
            yield f"tendon {tendon.name or i!r}: its spring, damping, friction or armature is left out"
    for j in range(model.njnt):
        name = model.joint(j).name or str(j)
        d = model.jnt_dofadr[j]
        if model.jnt_stiffness[j] and model.jnt_type[j] not in _SCALAR:
            yield f"joint {name!r}: the spring of a free or ball joint is left out"
        if np.any(model.jnt_stiffnesspoly[j]) or np.any(model.dof_dampingpoly[d]):
            yield f"joint {name!r}: the nonlinear terms of its spring or damping are left out"
    for u in np.flatnonzero(~_reflected(model)):
        if model.actuator_armature[u] or model.actuator_damping[u]:
            yield f"actuator {model.actuator(u).name or int(u)!r}: its armature or damping is left out"
    for u in np.flatnonzero(np.any(model.actuator_dampingpoly, axis=1)):
        yield f"actuator {model.actuator(u).name or int(u)!r}: its nonlinear damping is left out"
    if model.opt.density or model.opt.viscosity:
        yield "fluid forces (option density, viscosity) are left out"
