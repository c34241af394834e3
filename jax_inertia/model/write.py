"""Models with other numbers, in the form that they came in, and what differs between two of them."""

import os
import re
from collections.abc import Mapping
from html import unescape
from pathlib import Path
from typing import NamedTuple
from xml.sax.saxutils import quoteattr

import mujoco
import numpy as np

from jax_inertia.model.load import (
    ModelError,
    body_pi,
    compile_spec,
    is_urdf,
    load_spec,
    model_path,
    set_inertials,
    write_urdf,
)
from jax_inertia.model.mujoco_types import MjModel
from jax_inertia.model.spec import flatten
from jax_inertia.model.urdf_write import Dynamics
from jax_inertia.text.closest_names import listed


class JointNumbers(NamedTuple):
    """What a calibration adds to the model's own numbers of a joint, and how its torques are read."""

    damping: float
    """[N m s/rad]"""
    frictionloss: float
    """[N m]"""
    armature: float
    """[kg m²]"""
    offset: float
    """Logged torque = model's + this [N m]."""
    gain: float
    """N m per logged unit."""


def write_with_inertials(
    folder: Path,
    stem: str,
    model: Path,
    pi: Mapping[str, np.ndarray],
    *,
    joints: Mapping[str, JointNumbers] | None = None,
    home: Path | None = None,
) -> list[Path]:
    """Write a model with π (10,) of the named bodies replaced: a URDF as URDF, MJCF as MJCF; the files' paths.

    With `joints` also their damping, friction and armature, and in `<custom>` offset and gain of their torques; of a
    URDF, which holds damping and friction of these, an MJCF file is written next to it. `home` is where the files will
    lie, if not in `folder`. Raises ModelError for parameters that no body can have.
    """
    source, written = model_path(model), []
    if is_urdf(source):
        written.append(folder / f"{stem}.urdf")
    spec, out = load_spec(source), folder / f"{stem}.xml"
    set_inertials(spec, pi)
    for name, numbers in (joints or {}).items():
        _add_numbers(spec, name, numbers)
    if written:
        write_urdf(source, written[0], pi, {name: _dynamics(spec, name) for name in joints or {}})
        if joints is None:
            return written
    # What compiling has to balance is written balanced.
    compile_spec(spec, source)
    out.write_text(loadable(spec, source, home or folder), encoding="utf-8")
    return [*written, out]


def _add_numbers(spec: mujoco.MjSpec, name: str, numbers: JointNumbers) -> None:
    joint = spec.joint(name)
    damping = np.array(joint.damping, float)
    damping[0] = max(damping[0] + numbers.damping, 0.0)
    joint.damping = damping
    joint.frictionloss = max(joint.frictionloss + numbers.frictionloss, 0.0)
    joint.armature = max(joint.armature + numbers.armature, 0.0)
    for what, value in (("torque_offset", numbers.offset), ("torque_gain", numbers.gain)):
        spec.add_numeric(name=f"{what}_{name}", data=[value], size=1)


def _dynamics(spec: mujoco.MjSpec, name: str) -> Dynamics:
    joint = spec.joint(name)
    return Dynamics(float(joint.damping[0]), float(joint.frictionloss))


def write_urdf_as(source: Path, out: Path, before: MjModel, after: MjModel) -> str:
    """Write a URDF with what it can hold of a corrected model; a line on what it cannot, "" where that is nothing.

    `before` is the model of the URDF as it stands. No file where nothing that it holds has changed.
    """
    pi, differ = changed_inertials(before, after), changes(before, after)
    rubs = {c.name for c in differ if c.element == "joint" and c.field in _IN_URDF}
    dynamics = {}
    for name in rubs:
        row = after.joint(name).dofadr[0]
        dynamics[name] = Dynamics(float(after.dof_damping[row]), float(after.dof_frictionloss[row]))
    if pi or dynamics:
        write_urdf(source, out, pi, dynamics)
    lost: dict[str, list[str]] = {}
    for c in differ:
        if c.element != "body" and c.field not in _IN_URDF:
            what = f"{c.element} {c.field}" if c.element == "added" else c.field.partition("[")[0]
            lost.setdefault(what, []).append(c.name)
    each = "; ".join(f"{what} of {listed(list(dict.fromkeys(at)))}" for what, at in lost.items())
    return f"a URDF has no place for {each}: corrected.xml has them" if each else ""


_IN_URDF = "damping", "frictionloss"


def changed_inertials(before: MjModel, after: MjModel) -> dict[str, np.ndarray]:
    """π (10,) of each body, by name, that two models both have and that differs by more than rounding."""
    out = {}
    for b in range(1, before.nbody):
        name = before.body(b).name
        other = mujoco.mj_name2id(after, mujoco.mjtObj.mjOBJ_BODY, name)
        if name and other > 0:
            old, new = body_pi(before, b), body_pi(after, other)
            if np.max(np.abs(new - old)) > 1e-9 * (1.0 + np.max(np.abs(old))):
                out[name] = new
    return out


def loadable(spec: mujoco.MjSpec, model: Path, home: Path) -> str:
    """XML that loads in the folder `home`: meshes and textures by their way from there.

    By absolute folders where that way leads through the root: model and results are then not moved together.
    """
    root = (Path(spec.modelfiledir) if spec.modelfiledir else model.parent).resolve()
    if spec.meshes or spec.hfields:
        spec.meshdir = str(root / spec.meshdir)
    if spec.textures:
        spec.texturedir = str(root / spec.texturedir)
    text = spec.to_xml()
    refused = _refusal(text)
    if "balanceinertia" in refused:
        flatten(spec, DIGITS)
        text = spec.to_xml()
        refused = _refusal(text)
    text = as_older_ones_read(text)
    if refused:
        raise ModelError(f"{model}: MuJoCo cannot load what it wrote of this model: {refused}")
    # In the text: MuJoCo opens all files once more before it writes them.
    return re.sub(
        r'(?<= )((?:mesh|texture)dir=)("[^"]*")',
        lambda found: found[1] + quoteattr(_way(home.resolve(), unescape(found[2][1:-1]))),
        text,
    )


def _way(home: Path, folder: str) -> str:
    """A folder as seen from another one; as it is where they share no more than the root, or it is no absolute one."""
    if not os.path.isabs(folder):
        return folder
    try:
        shared = os.path.commonpath([home, folder])
    except ValueError:  # Two drives of Windows.
        return folder
    return (
        folder if shared == Path(folder).anchor else Path(os.path.relpath(folder, home)).as_posix()
    )


_CHARACTER_DATA = re.compile(r'(<text name="[^"]*")><!\[CDATA\[(.*?)\]\]></text>', re.DOTALL)


def as_older_ones_read(text: str) -> str:
    """A model's text as MuJoCo from 3.6 on reads it, where it says the same.

    Texts as attributes: 3.17 writes those with quotes as character data. Actuators without the attribute `input`, which
    names what a control is for (`ctrlspec`) and is written since 3.16, where every one does the same without it.
    """
    text = _CHARACTER_DATA.sub(lambda found: f"{found[1]} data={quoteattr(found[2])}/>", text)
    bare = re.sub(r'(<general [^>]*?) input="(?:pos|vel|ff)"', r"\1", text)
    if bare == text:
        return text
    try:
        whole, less = (mujoco.MjModel.from_xml_string(x) for x in (text, bare))
    except ValueError:
        return text
    same = (
        "gaintype",
        "biastype",
        "dyntype",
        "gainprm",
        "biasprm",
        "dynprm",
        "ctrlnum",
        "ctrlrange",
    )
    fields = [f"actuator_{name}" for name in same if hasattr(whole, f"actuator_{name}")]
    unchanged = whole.nu == less.nu and all(
        np.array_equal(getattr(whole, f), getattr(less, f)) for f in fields
    )
    return bare if unchanged else text


# MuJoCo writes numbers with six digits: up to this share of one is lost.
DIGITS = 5e-6


def _refusal(text: str) -> str:
    """Why MuJoCo does not load a model, in one line; nothing if it does."""
    try:
        mujoco.MjModel.from_xml_string(text)
    except ValueError as error:
        return " ".join(str(error).split())
    return ""


# --- what differs between two models


class Change(NamedTuple):
    """A number of the model that a corrected file changes, both as read back."""

    element: str
    """Of the model: "joint", "actuator", "body", "option" or "added"."""
    name: str
    field: str
    nominal: float
    corrected: float


def changes(nominal: MjModel, model: MjModel) -> tuple[Change, ...]:
    """Every number that differs between two models by more than the six digits of a file, and what is added."""
    out = []
    for kind, fields in _FIELDS.items():
        for k in range(getattr(model, _COUNT[kind])):
            name, other = _twin(nominal, model, kind, k)
            if other < 0:
                out.append(Change("added", name, kind, float("nan"), float("nan")))
                continue
            for field, of in fields.items():
                before, after = (np.ravel(of(m, i)) for m, i in ((nominal, other), (model, k)))
                for i, (x, y) in enumerate(zip(before, after, strict=True)):
                    size = max(float(np.abs(before).max()), float(np.abs(after).max()), 1e-6)
                    if abs(x - y) > _DIGITS * size:
                        label = field if len(before) == 1 else f"{field}[{i}]"
                        out.append(Change(kind, name, label, float(x), float(y)))
    for i, (x, y) in enumerate(zip(nominal.opt.gravity, model.opt.gravity, strict=True)):
        if abs(x - y) > 1e-5:
            out.append(Change("option", "gravity", "xyz"[i], float(x), float(y)))
    return tuple(out)


def _twin(nominal: MjModel, model: MjModel, kind: str, k: int) -> tuple[str, int]:
    """(name, index in the nominal model) of an element; what has no name is called after its joint, or its place."""
    name = getattr(model, kind)(k).name
    if name:
        return name, mujoco.mj_name2id(nominal, _TYPE[kind], name)
    if kind == "actuator" and model.actuator_trntype[k] == int(mujoco.mjtTrn.mjTRN_JOINT):
        name = model.joint(model.actuator_trnid[k, 0]).name
    same = k < getattr(nominal, _COUNT[kind]) and not getattr(nominal, kind)(k).name
    return name or f"{kind} {k}", k if same else -1


_DIGITS = 2e-5
_COUNT = {"joint": "njnt", "actuator": "nu", "body": "nbody"}
_TYPE = {
    "joint": mujoco.mjtObj.mjOBJ_JOINT,
    "actuator": mujoco.mjtObj.mjOBJ_ACTUATOR,
    "body": mujoco.mjtObj.mjOBJ_BODY,
}


def _dof(field: str):
    return lambda m, j: getattr(m, field)[m.jnt_dofadr[j]]


def _own(field: str, part=slice(None)):
    return lambda m, k: np.atleast_1d(getattr(m, field)[k])[part]


def _inertia(m: MjModel, b: int) -> np.ndarray:
    """xx, yy, zz, xy, xz, yz about the centre of mass, in the body's own axes [kg m²]."""
    turn = np.empty(9)
    mujoco.mju_quat2Mat(turn, m.body_iquat[b])
    turn = turn.reshape(3, 3)
    whole = turn @ np.diag(m.body_inertia[b]) @ turn.T
    return np.append(np.diagonal(whole), whole[(0, 0, 1), (1, 2, 2)])


_FIELDS = {
    "joint": {
        "armature": _dof("dof_armature"),
        "damping": _dof("dof_damping"),
        "quadratic damping": lambda m, j: m.dof_dampingpoly[m.jnt_dofadr[j], :1],
        "frictionloss": _dof("dof_frictionloss"),
        "solimpfriction": lambda m, j: m.dof_solimp[m.jnt_dofadr[j], :1],
        "stiffness": _own("jnt_stiffness"),
        "springref": lambda m, j: m.qpos_spring[m.jnt_qposadr[j]] * (m.jnt_stiffness[j] > 0),
        "ref": lambda m, j: m.qpos0[m.jnt_qposadr[j]],
        "actuatorfrcrange": lambda m, j: m.jnt_actfrcrange[j] * m.jnt_actfrclimited[j],
    },
    "actuator": {
        "kp": _own("actuator_gainprm", slice(1)),
        "bias": _own("actuator_biasprm", slice(1)),
        "kv": lambda m, a: -m.actuator_biasprm[a, 2:3],
        "forcerange": lambda m, a: m.actuator_forcerange[a] * m.actuator_forcelimited[a],
        "delay": _own("actuator_delay"),
        "time constant": lambda m, a: m.actuator_dynprm[a, :1] * (m.actuator_dyntype[a] > 0),
    },
    "body": {
        "mass": _own("body_mass"),
        "inertia": _inertia,
        "ipos": _own("body_ipos"),
    },
}
