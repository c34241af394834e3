"""MuJoCo models to `Robot`, and inertial parameters back into a model.

MuJoCo's own loader reads MJCF and URDF. What the rigid-body model cannot represent is refused (`ModelError`) or named
in a `ModelWarning`, element by element, never dropped in silence.
"""

import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path

import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Float

from jax_inertia.robot import BALL, FREE, HINGE, SLIDE, WELD, Robot, Topology

_KIND = {
    mujoco.mjtJoint.mjJNT_FREE: FREE,
    mujoco.mjtJoint.mjJNT_BALL: BALL,
    mujoco.mjtJoint.mjJNT_SLIDE: SLIDE,
    mujoco.mjtJoint.mjJNT_HINGE: HINGE,
}


class ModelError(ValueError):
    """A model that cannot be used: one line that says what, where, and what would be right."""


class ModelWarning(UserWarning):
    """A part of a model that the rigid-body dynamics leaves out, by name."""


def load_model(model: str | Path | mujoco.MjModel) -> Robot:
    """Read an MJCF or URDF file (or take a compiled `MjModel`) as a `Robot`.

    Meshes may be missing where every body has explicit inertials. Bodies fixed to the world are left out, bodies
    welded to a moving one are kept. Raises ModelError for a file that cannot be used; warns (ModelWarning) of what
    the model has and rigid-body dynamics does not: tendon forces, equality constraints, fluid, gravity
    compensation.
    """
    if not isinstance(model, mujoco.MjModel):
        model = compile_spec(load_spec(model))
    for line in _left_out(model):
        warnings.warn(line, ModelWarning, stacklevel=2)
    return _to_robot(model)


def load_spec(path: str | Path) -> mujoco.MjSpec:
    """Parse an MJCF or URDF file into an editable spec that compiles, meshes or not; ModelError if it cannot."""
    path = Path(path)
    if not path.is_file():
        raise ModelError(f"{path}: no such model file")
    try:
        spec = mujoco.MjSpec.from_file(str(path))
    except (ValueError, mujoco.FatalError) as error:
        raise ModelError(f"{path}: {_one_line(error)}") from None
    # A welded link must stay a body of its own: its parameters may be what is asked for.
    spec.compiler.fusestatic = False
    _drop_missing_meshes(spec, path)
    return spec


def compile_spec(spec: mujoco.MjSpec) -> mujoco.MjModel:
    """Compile a spec; inertias that break the triangle inequality are balanced, with a warning that names them."""
    try:
        return spec.compile()
    except (ValueError, mujoco.FatalError) as error:
        if "balanceinertia" not in str(error):
            raise ModelError(f"model {spec.modelname!r}: {_one_line(error)}") from None
    names = [b.name for b in spec.bodies if b.explicitinertial and not _triangle(b)]
    warnings.warn(
        "inertia breaks the triangle inequality and was balanced by MuJoCo: "
        + (", ".join(names) or "some body"),
        ModelWarning,
        stacklevel=3,
    )
    spec.compiler.balanceinertia = True
    try:
        return spec.compile()
    except (ValueError, mujoco.FatalError) as error:
        raise ModelError(f"model {spec.modelname!r}: {_one_line(error)}") from None


def set_inertials(spec: mujoco.MjSpec, pi: Mapping[str, Float[Array, "10"] | np.ndarray]) -> None:
    """Write inertial parameters of named bodies into a spec, as MuJoCo's mass, ipos and full inertia about the CoM.

    Raises ModelError for an unknown body or parameters that no body can have.
    """
    known = {b.name: b for b in spec.bodies}
    for name, value in pi.items():
        if name not in known:
            raise ModelError(f"no body named {name!r}; the model has: {', '.join(known)}")
        m, h, i = _split(np.asarray(value, float))
        if not m > 0:
            raise ModelError(f"body {name!r}: mass {m:.4g} kg; it must be positive")
        c = h / m
        ic = i - m * (c @ c * np.eye(3) - np.outer(c, c))
        body = known[name]
        body.explicitinertial = True
        body.mass, body.ipos = m, c
        moments, axes = np.linalg.eigh(ic)
        if moments[0] <= 0 or moments[2] > (moments[0] + moments[1]) * (1 + 1e-9):
            raise ModelError(f"body {name!r}: principal moments {moments} kg m² are not physical")
        axes[:, 2] *= np.sign(np.linalg.det(axes))
        quat = np.zeros(4)
        mujoco.mju_mat2Quat(quat, axes.ravel())
        body.iquat, body.inertia = quat, moments
        body.fullinertia = np.full(6, np.nan)
        body.ialt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT


def body_pi(model: mujoco.MjModel, body: int) -> np.ndarray:
    """π (10,) of one body of a compiled model, about its frame origin."""
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, model.body_iquat[body])
    r = rotation.reshape(3, 3)
    m, c = model.body_mass[body], model.body_ipos[body]
    i = r @ np.diag(model.body_inertia[body]) @ r.T + m * (c @ c * np.eye(3) - np.outer(c, c))
    return np.array([m, *(m * c), i[0, 0], i[0, 1], i[0, 2], i[1, 1], i[1, 2], i[2, 2]])


# --- from a compiled model to arrays -----------------------------------------------------------------------------


def _to_robot(model: mujoco.MjModel) -> Robot:
    parent, kind, qpos_adr, body_node, bodies = [], [], [], [], []
    place_r, place_p, anchor, axis, reference = [], [], [], [], []
    # Last node of each MuJoCo body (−1: fixed to the world), and the pose of fixed ones in the world.
    node_of = np.full(model.nbody, -1)
    fixed = {0: (np.eye(3), np.zeros(3))}

    def add(parent_node, kind_, rotation, position, qadr=0, at=None, along=None, ref=0.0):
        parent.append(int(parent_node))
        kind.append(kind_)
        qpos_adr.append(int(qadr))
        place_r.append(rotation)
        place_p.append(position)
        anchor.append(np.zeros(3) if at is None else at)
        axis.append(np.array([0.0, 0.0, 1.0]) if along is None else along)
        reference.append(ref)
        return len(parent) - 1

    for b in range(1, model.nbody):
        up = model.body_parentid[b]
        rotation, position = _matrix(model.body_quat[b]), model.body_pos[b].copy()
        if up in fixed:
            base_r, base_p = fixed[up]
            rotation, position = base_r @ rotation, base_p + base_r @ position
        node, joints = node_of[up], model.body_jntadr[b] + np.arange(model.body_jntnum[b])
        if len(joints) == 0 and up in fixed:
            fixed[b] = (rotation, position)
            continue
        for j in joints:
            type_ = _KIND[mujoco.mjtJoint(model.jnt_type[j])]
            adr = model.jnt_qposadr[j]
            if type_ == FREE:
                node = add(node, FREE, np.eye(3), np.zeros(3), adr)
            else:
                scalar = type_ in (HINGE, SLIDE)
                ref = model.qpos0[adr] if scalar else 0.0
                at = model.jnt_pos[j].copy()
                along = model.jnt_axis[j].copy() if scalar else None
                node = add(node, type_, rotation, position, adr, at, along, ref)
            rotation, position = np.eye(3), np.zeros(3)
        if len(joints) == 0:
            node = add(node, WELD, rotation, position)
        node_of[b] = node
        body_node.append(int(node))
        bodies.append(b)

    joints = range(model.njnt)
    dof_joint = model.dof_jntid
    scalar = np.isin(model.jnt_type[dof_joint], (2, 3))
    spring = np.where(scalar, model.qpos_spring[model.jnt_qposadr[dof_joint]], 0.0)
    stacked = {
        "pi": np.array([body_pi(model, b) for b in bodies]).reshape(-1, 10),
        "placement_rotation": np.array(place_r).reshape(-1, 3, 3),
        "placement_position": np.array(place_p).reshape(-1, 3),
        "joint_position": np.array(anchor).reshape(-1, 3),
        "joint_axis": np.array(axis).reshape(-1, 3),
        "joint_reference": np.array(reference),
        "armature": model.dof_armature.copy(),
        "damping": model.dof_damping.copy(),
        "frictionloss": model.dof_frictionloss.copy(),
        "stiffness": np.where(scalar, model.jnt_stiffness[dof_joint], 0.0),
        "spring_reference": spring,
        "gravity": model.opt.gravity.copy(),
    }
    return Robot(
        topology=Topology(tuple(parent), tuple(kind), tuple(qpos_adr), tuple(body_node)),
        body_names=tuple(model.body(b).name or f"body_{b}" for b in bodies),
        joint_names=tuple(model.joint(j).name or f"joint_{j}" for j in joints),
        joint_type=tuple(_KIND[mujoco.mjtJoint(model.jnt_type[j])] for j in joints),
        joint_qposadr=tuple(int(i) for i in model.jnt_qposadr),
        joint_dofadr=tuple(int(i) for i in model.jnt_dofadr),
        nq=model.nq,
        nv=model.nv,
        **{name: jnp.asarray(value) for name, value in stacked.items()},
    )


def _left_out(model: mujoco.MjModel) -> Iterator[str]:
    """One line for each element whose force the rigid-body dynamics does not have."""
    if model.nflex:
        raise ModelError(f"{model.nflex} flex element(s): deformable bodies cannot be represented")
    for i in np.flatnonzero(model.eq_active0):
        equality = model.equality(i)
        kind = mujoco.mjtEq(model.eq_type[i]).name.removeprefix("mjEQ_").lower()
        yield f"{kind} equality {equality.name or i!r}: its constraint force is left out"
    for i in range(model.ntendon):
        tendon = model.tendon(i)
        acts = (model.tendon_stiffness[i], model.tendon_damping[i], model.tendon_frictionloss[i])
        if any(acts) or model.tendon_armature[i]:
            yield f"tendon {tendon.name or i!r}: its spring, damping, friction or armature is left out"
    for j in range(model.njnt):
        name = model.joint(j).name or str(j)
        d = model.jnt_dofadr[j]
        if model.jnt_stiffness[j] and model.jnt_type[j] in (0, 1):
            yield f"joint {name!r}: the spring of a free or ball joint is left out"
        if np.any(model.jnt_stiffnesspoly[j]) or np.any(model.dof_dampingpoly[d]):
            yield f"joint {name!r}: the nonlinear terms of its spring or damping are left out"
    for b in np.flatnonzero(model.body_gravcomp):
        yield f"body {model.body(b).name!r}: gravity compensation is left out"
    if model.opt.density or model.opt.viscosity:
        yield "fluid forces (option density, viscosity) are left out"


def _drop_missing_meshes(spec: mujoco.MjSpec, path: Path) -> None:
    """Remove geoms whose mesh file is absent, unless a body's inertia would have come from it."""
    folder = Path(spec.modelfiledir or path.parent)
    missing = {m.name for m in spec.meshes if m.file and not _mesh_file(folder, spec, m).is_file()}
    if not missing:
        return
    for geom in list(spec.geoms):
        if geom.meshname not in missing:
            continue
        if not geom.parent.explicitinertial and geom.parent.name != "world":
            raise ModelError(
                f"{path}: mesh {geom.meshname!r} is absent and body {geom.parent.name!r} has no inertial; "
                "give the mesh file or an explicit inertial"
            )
        spec.delete(geom)
    for mesh in list(spec.meshes):
        if mesh.name in missing:
            spec.delete(mesh)


def _mesh_file(folder: Path, spec: mujoco.MjSpec, mesh) -> Path:
    name = mesh.file.split("://", 1)[-1]
    return folder / (spec.meshdir or "") / (Path(name).name if spec.strippath else name)


def _triangle(body) -> bool:
    if not np.isnan(body.fullinertia[0]):
        xx, yy, zz, xy, xz, yz = body.fullinertia
        moments = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    else:
        moments = np.sort(body.inertia)
    return moments[0] + moments[1] >= moments[2]


def _split(pi: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    m, hx, hy, hz, xx, xy, xz, yy, yz, zz = pi
    return m, np.array([hx, hy, hz]), np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _matrix(quat: np.ndarray) -> np.ndarray:
    out = np.zeros(9)
    mujoco.mju_quat2Mat(out, quat / np.linalg.norm(quat))
    return out.reshape(3, 3)


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())
