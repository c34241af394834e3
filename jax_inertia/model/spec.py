"""MuJoCo specs: read from a file, compiled with clear errors, and given inertial parameters."""

import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import mujoco
import numpy as np
from jaxtyping import Array, Float

from jax_inertia.logs.plain_file import require_content
from jax_inertia.model.descriptions import PREFIX, description
from jax_inertia.model.file_safety import ModelError, check_model
from jax_inertia.model.mujoco_types import MjModel, MjSpec
from jax_inertia.model.mujoco_warnings import mujoco_warnings
from jax_inertia.model.shapes import named, without_refused_shapes
from jax_inertia.model.urdf_read import ModelWarning, repair, with_floating_base
from jax_inertia.model.urdf_text import for_mujoco, part_at
from jax_inertia.text.closest_names import listed

# What MuJoCo raises of a model; RuntimeError is what it makes of memory that ran out.
_REFUSALS = ValueError, RuntimeError, MemoryError, mujoco.FatalError
_FREE = mujoco.mjtJoint.mjJNT_FREE


def model_path(model: str | Path) -> Path:
    """The file of a model: a path, or `robot_descriptions:NAME` for one of that package's, if it is here already."""
    name = str(model)
    return description(name.removeprefix(PREFIX)) if name.startswith(PREFIX) else Path(model)


def load_spec(path: str | Path, *, floating_base: bool = False) -> MjSpec:
    """Parse an MJCF or URDF file into an editable spec that compiles, meshes or not; ModelError if it cannot.

    What the file asks for is checked first: it may come from anywhere. `floating_base` as of `load_model`.

    >>> import tempfile, pathlib
    >>> from jax_inertia.model.spec import load_spec
    >>> file = pathlib.Path(tempfile.mkdtemp()) / "ball.xml"
    >>> body = '<body name="ball"><freejoint/><geom size="0.1" mass="2"/></body>'
    >>> _ = file.write_text(f"<mujoco><worldbody>{body}</worldbody></mujoco>")
    >>> load_spec(file).compile().nv
    6
    """
    path = model_path(path)
    if path.is_dir():
        raise ModelError(f"{path}: a folder; name the MJCF or URDF file in it")
    if not path.is_file():
        raise ModelError(f"{path}: no such model file")
    try:
        require_content(path)
    except OSError as error:
        raise ModelError(str(error)) from None
    root = check_model(path).root
    if floating_base and root != "robot":
        raise ModelError(
            f"{path}: MJCF says itself whether its base floats; give its base a <freejoint/>"
        )
    with mujoco_warnings() as said:
        try:
            if root == "robot":
                spec, lines = _urdf(path, floating_base)
            else:
                spec, lines = mujoco.MjSpec.from_file(str(path)), []
            # A welded link must stay a body of its own: its parameters may be what is asked for.
            spec.compiler.fusestatic = False
            # Before the spec is compiled once: where that fails, MuJoCo refuses to show parts of it, too.
            lines += repair(spec) if root == "robot" else without_loose_bodies(spec)
            lines += without_refused_shapes(spec, path)
        except ModelError:
            raise
        except _REFUSALS as error:
            raise ModelError(f"{path}: {error}") from None
    for line in (*_worth(said), *lines):
        warnings.warn(f"{path}: {line}", ModelWarning, stacklevel=3)
    return spec


def _urdf(path: Path, floating_base: bool) -> tuple[MjSpec, list[str]]:
    """The spec of a URDF, its root link free to move if asked, and what was read otherwise than it stands."""
    text, lines = for_mujoco(path.read_bytes().decode("utf-8", "replace"))
    try:
        spec = mujoco.MjSpec.from_string(with_floating_base(text) if floating_base else text)
    except ModelError as error:
        raise ModelError(f"{path}: {error}") from None
    except _REFUSALS as error:
        line = re.search(r"line (\d+)", str(error))
        inside = part_at(text, int(line.group(1))) if line else ""
        raise ModelError(f"{path}: {error}" + f" ({inside})" * bool(inside)) from None
    # Meshes lie next to the file, whatever was read.
    spec.modelfiledir = str(path.parent)
    return spec, lines


def without_loose_bodies(spec: MjSpec) -> list[str]:
    """Remove floating bodies without other joints from a scene in which another tree has some; a line that names them.

    Keyframes go with them, since they are of all positions.

    >>> import mujoco
    >>> from jax_inertia.model.spec import without_loose_bodies
    >>> arm = '<body name="arm"><joint/><geom size="0.1"/></body>'
    >>> cube = '<body name="cube"><freejoint/><geom size="0.1"/></body>'
    >>> spec = mujoco.MjSpec.from_string(f"<mujoco><worldbody>{cube}{arm}</worldbody></mujoco>")
    >>> without_loose_bodies(spec), spec.compile().nv
    (["left out, floats and has no joints, so is not the robot: 'cube'"], 1)
    """
    trees = list(spec.worldbody.bodies)
    joints = {tree.name or f"body {k}": list(_joints(tree)) for k, tree in enumerate(trees)}
    loose = [kinds == [_FREE] for kinds in joints.values()]
    if not any(loose) or not any(set(kinds) - {_FREE} for kinds in joints.values()):
        return []
    for key in list(spec.keys):
        spec.delete(key)
    for tree, one in zip(trees, loose, strict=True):
        if one:
            spec.delete(tree)
    names = [name for name, one in zip(joints, loose, strict=True) if one]
    return [
        f"left out, floats and has no joints, so is not the robot: {listed([repr(name) for name in names])}"
    ]


def _joints(body: mujoco.MjsBody) -> Iterator[mujoco.mjtJoint]:
    """Kinds of the joints of a body and of those below it."""
    for joint in body.joints:
        yield joint.type
    for child in body.bodies:
        yield from _joints(child)


def compile_spec(spec: MjSpec, where: str | Path = "model") -> MjModel:
    """Compile a spec; `where` says in errors what it came from.

    Inertias that break the triangle inequality are balanced, with a warning that names them.
    """
    with mujoco_warnings() as said:
        model = _compiled(spec, where, said)
        if model is None:
            bodies = [
                (i, b) for i, b in enumerate(spec.bodies) if b.explicitinertial and not _triangle(b)
            ]
            names = [b.name or f"body_{i}" for i, b in bodies]
            spec.compiler.balanceinertia = True
            model = _compiled(spec, where, said)
            said.append(
                "inertia breaks the triangle inequality and was balanced by MuJoCo: "
                + (", ".join(names) or "some body")
            )
    for line in _worth(said):
        warnings.warn(f"{where}: {line}", ModelWarning, stacklevel=3)
    return model


def _compiled(spec: MjSpec, where: str | Path, said: list[str]) -> MjModel | None:
    """The compiled model; None where all that is wrong is an inertia that MuJoCo can balance.

    What `compile` warns of in Python goes to `said`, with what MuJoCo says elsewhere.
    """
    try:
        with warnings.catch_warnings(record=True) as raised:
            warnings.simplefilter("always")
            model = spec.compile()
        said += [" ".join(str(one.message).split()) for one in raised]
        return model
    except _REFUSALS as error:
        if "balanceinertia" in str(error) and not spec.compiler.balanceinertia:
            return None
        raise ModelError(f"{where}: {named(spec, str(error))}") from None


def _worth(said: Sequence[str]) -> list[str]:
    """What is to be passed on of MuJoCo's warnings: `load_model` names the element of a NaN that matters."""
    return [line for line in said if "contains a 'NaN'" not in line]


def set_inertials(spec: MjSpec, pi: Mapping[str, Float[Array, "10"] | np.ndarray]) -> None:
    """Write inertial parameters of named bodies into a spec, as mass, centre and principal moments.

    Raises ModelError for an unknown body, for parameters that no body can have, and where the
    compiler would change what is written.

    >>> import jax.numpy as jnp, mujoco
    >>> from jax_inertia.maths.inertial_parameters import from_com
    >>> from jax_inertia.model.spec import set_inertials
    >>> body = '<body name="ball"><freejoint/><geom size="0.1" mass="2"/></body>'
    >>> spec = mujoco.MjSpec.from_string(f"<mujoco><worldbody>{body}</worldbody></mujoco>")
    >>> set_inertials(spec, {"ball": from_com(jnp.array(3.0), jnp.zeros(3), 0.02 * jnp.eye(3))})
    >>> float(spec.compile().body("ball").mass[0])
    3.0
    """
    known = {b.name: b for b in spec.bodies if b.name != "world"}
    if spec.compiler.settotalmass > 0:
        raise ModelError(
            "compiler settotalmass rescales every mass: remove it before setting inertials"
        )
    inertials = {name: _inertial(name, known, value) for name, value in pi.items()}
    if spec.compiler.inertiafromgeom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE:
        # It ignores every inertial that is written out, the ones about to be written among them.
        for body in spec.bodies:
            body.explicitinertial, body.ipos = False, np.full(3, np.nan)
        spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_AUTO
    for name, (mass, com, moments, quat) in inertials.items():
        body = known[name]
        body.explicitinertial = True
        body.mass, body.ipos = mass, com
        _set_moments(body, moments, quat)


def flatten(spec: MjSpec, rounding: float) -> None:
    """Lessen the largest moment of bodies that are all but flat, so that A + B ≥ C outlives `rounding` of each."""
    model = spec.compile()
    for body in spec.bodies:
        moments = model.body_inertia[body.id].copy()
        large = int(np.argmax(moments))
        most = (moments.sum() - moments[large]) * (1.0 - 3.0 * rounding)
        if not body.explicitinertial or moments[large] <= most:
            continue
        moments[large] = most
        _set_moments(body, moments, model.body_iquat[body.id])


def _set_moments(body: mujoco.MjsBody, moments: np.ndarray, quat: np.ndarray) -> None:
    """Principal moments about axes turned by `quat`, in place of whatever form of inertia was written."""
    body.inertia, body.iquat = moments, quat
    body.fullinertia = np.full(6, np.nan)
    body.ialt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT


def check_pi(
    name: str, pi: Float[Array, "10"] | np.ndarray, known: Sequence[str]
) -> tuple[float, np.ndarray, np.ndarray]:
    """Mass, centre of mass (3,) and inertia about it (3, 3) of π, in the body's axes.

    Raises ModelError for a name that is not known, and for parameters that no body can have.
    """
    if name not in known:
        raise ModelError(f"no body named {name!r}; the model has: {', '.join(known)}")
    pi = np.asarray(pi, float)
    if pi.shape != (10,):
        raise ModelError(
            f"body {name!r}: parameters have the shape {pi.shape}; they are 10 numbers"
        )
    if not np.all(np.isfinite(pi)):
        raise ModelError(f"body {name!r}: parameters are not finite: {pi}")
    m, h, i = _split(pi)
    if m <= 0:
        raise ModelError(f"body {name!r}: mass {m:.4g} kg; it must be positive")
    c = h / m
    inertia = i - m * (c @ c * np.eye(3) - np.outer(c, c))
    moments = np.linalg.eigvalsh(inertia)
    if moments[0] <= 0 or moments[2] > (moments[0] + moments[1]) * (1 + 1e-9):
        raise ModelError(f"body {name!r}: principal moments {moments} kg m² are not physical")
    return m, c, inertia


def _inertial(
    name: str, known: Mapping[str, mujoco.MjsBody], pi
) -> tuple[float, np.ndarray, np.ndarray, np.ndarray]:
    """Mass, centre of mass, principal moments and the quaternion of their axes; ModelError if there are none."""
    m, c, inertia = check_pi(name, pi, tuple(known))
    moments, axes = np.linalg.eigh(inertia)
    # A plate has the equality, which rounding must not turn into an error of MuJoCo's.
    moments[2] = min(moments[2], moments[0] + moments[1])
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, axes.ravel())
    return m, c, moments, quat


def _triangle(body) -> bool:
    if not np.isnan(body.fullinertia[0]):
        xx, yy, zz, xy, xz, yz = body.fullinertia
        moments = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    else:
        moments = np.sort(body.inertia)
    return bool(moments[0] + moments[1] >= moments[2])


def _split(pi: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    m, hx, hy, hz, xx, xy, xz, yy, yz, zz = pi
    return m, np.array([hx, hy, hz]), np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
