"""Models with other inertials, in the form that they came in."""

from collections.abc import Mapping
from pathlib import Path

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


def write_with_inertials(
    folder: Path, stem: str, model: Path, pi: Mapping[str, np.ndarray]
) -> Path:
    """Write a model with π (10,) of the named bodies replaced: a URDF as URDF, MJCF as MJCF; the file's path.

    Raises ModelError for parameters that no body can have.
    """
    source = model_path(model)
    if is_urdf(source):
        out = folder / f"{stem}.urdf"
        write_urdf(source, out, pi)
        return out
    spec, out = load_spec(source), folder / f"{stem}.xml"
    set_inertials(spec, pi)
    # What compiling has to balance is written balanced.
    compile_spec(spec, source)
    out.write_text(loadable(spec, source))
    return out


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


def loadable(spec: mujoco.MjSpec, model: Path) -> str:
    """XML that loads from anywhere on this machine: files by absolute folder, else without meshes."""
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
    return text


# MuJoCo writes numbers with six digits: up to this share of one is lost.
DIGITS = 5e-6


def _refusal(text: str) -> str:
    """Why MuJoCo does not load a model, in one line; nothing if it does."""
    try:
        mujoco.MjModel.from_xml_string(text)
    except ValueError as error:
        return " ".join(str(error).split())
    return ""
