"""Models with other inertials, in the form that they came in."""

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
from jax_inertia.model.spec import flatten


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
    URDF, which has no place for these, an MJCF file is written next to it. `home` is where the files will lie, if not
    in `folder`. Raises ModelError for parameters that no body can have.
    """
    source, written = model_path(model), []
    if is_urdf(source):
        written.append(folder / f"{stem}.urdf")
        write_urdf(source, written[0], pi)
        if joints is None:
            return written
    spec, out = load_spec(source), folder / f"{stem}.xml"
    set_inertials(spec, pi)
    for name, numbers in (joints or {}).items():
        _add_numbers(spec, name, numbers)
    # What compiling has to balance is written balanced.
    compile_spec(spec, source)
    out.write_text(loadable(spec, source, home or folder))
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


def changed_inertials(before: mujoco.MjModel, after: mujoco.MjModel) -> dict[str, np.ndarray]:
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


# MuJoCo writes numbers with six digits: up to this share of one is lost.
DIGITS = 5e-6


def _refusal(text: str) -> str:
    """Why MuJoCo does not load a model, in one line; nothing if it does."""
    try:
        mujoco.MjModel.from_xml_string(text)
    except ValueError as error:
        return " ".join(str(error).split())
    return ""
