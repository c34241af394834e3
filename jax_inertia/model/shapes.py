"""Shapes that MuJoCo refuses, where dynamics do not need them: a robot loads without."""

import re
import warnings
from collections.abc import Iterator
from pathlib import Path

import mujoco
import numpy as np

from jax_inertia.model.file_safety import ModelError
from jax_inertia.model.mujoco_types import MjSpec
from jax_inertia.model.mujoco_warnings import mujoco_warnings
from jax_inertia.model.urdf_read import has_mass
from jax_inertia.text.closest_names import listed

_TOLD = 8
_REFUSALS = ValueError, RuntimeError, MemoryError, mujoco.FatalError
_ELEMENT = re.compile(r"Element name '(.*?)', id (\d+)", re.DOTALL)
# Of a mesh: what says which it is and how large.
_OF_MESH = ("file", "scale", "refpos", "refquat", "inertia", "content_type", "maxhullvert")
_OF_MESH_ITSELF = ("uservert", "usernormal", "userface", "usertexcoord")


def without_refused_shapes(spec: MjSpec, path: Path) -> list[str]:
    """Take out of a spec the shapes, meshes and textures that MuJoCo refuses; a line for those that were there.

    Meshes whose files are absent go without a word. Raises ModelError, with the body's name, for a shape from which a
    body that moves would have its mass.
    """
    absent = {
        mesh.name: "its file is absent" for mesh in spec.meshes if _is_absent(spec, mesh, path)
    }
    _delete(spec, path, absent, {})
    if _refusal(spec) is None:
        return []
    meshes = {mesh.name: why for mesh in spec.meshes if (why := _refused_mesh(spec, mesh))}
    shapes = {
        i: why
        for i, geom in enumerate(spec.geoms)
        if not geom.meshname and (why := _refused_shape(geom))
    }
    bodies = {name: listed(sorted(_bodies_of(spec, name)), 3) for name in meshes}
    told = [f"mesh {name!r} of {bodies[name]} ({why})" for name, why in meshes.items()]
    told += [f"a shape of {spec.geoms[i].parent.name} ({why})" for i, why in shapes.items()]
    _delete(spec, path, meshes, shapes)
    told += _without_textures(spec)
    what = "left out, for MuJoCo refuses it and dynamics do not need it"
    more = f"; and {len(told) - _TOLD} more" * (len(told) > _TOLD)
    return [f"{what}: {'; '.join(told[:_TOLD])}{more}"] if told else []


def named(spec: MjSpec, error: str) -> str:
    """MuJoCo's message, with the body of an element that has no name of its own."""
    match = _ELEMENT.search(error)
    if match is None or match.group(1):
        return error
    index = int(match.group(2))
    for kind, all_of in (("geom", spec.geoms), ("joint", spec.joints), ("site", spec.sites)):
        if kind in error[: match.start()] and index < len(all_of):
            return f"{error} (of body {all_of[index].parent.name!r})"
    return error


def _refusal(spec: MjSpec) -> str | None:
    """Why a spec does not compile, in MuJoCo's words; None if it does."""
    # What it warns of is said when the model is compiled for use.
    with mujoco_warnings(), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            spec.compile()
        except _REFUSALS as error:
            return _reason(error)
    return None


def _reason(error: BaseException) -> str:
    """The first line of MuJoCo's message, files by their names."""
    first = str(error).splitlines()[0].removeprefix("Error: ")
    return re.sub(r"'[^']*/([^'/]*)'", r"'\1'", first).strip()


def _bodies_of(spec: MjSpec, mesh: str) -> set[str]:
    return {geom.parent.name for geom in spec.geoms if geom.meshname == mesh}


def _refused_mesh(spec: MjSpec, mesh: mujoco.MjsMesh) -> str | None:
    """Why MuJoCo does not take a mesh, tried by itself."""
    alone = _empty(spec)
    name = mesh.name or "mesh"
    copy = alone.add_mesh(name=name)
    for attribute in (*_OF_MESH, *_OF_MESH_ITSELF):
        value = getattr(mesh, attribute)
        if attribute in _OF_MESH or np.size(value):
            setattr(copy, attribute, value)
    alone.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name)
    return _refusal(alone)


def _refused_shape(geom: mujoco.MjsGeom) -> str | None:
    """Why MuJoCo does not take a shape of its own, tried by itself."""
    if geom.type in (
        mujoco.mjtGeom.mjGEOM_MESH,
        mujoco.mjtGeom.mjGEOM_HFIELD,
        mujoco.mjtGeom.mjGEOM_SDF,
    ):
        return None
    alone = mujoco.MjSpec()
    copy = alone.worldbody.add_geom(type=geom.type)
    copy.size, copy.fromto = geom.size, geom.fromto
    return _refusal(alone)


def _without_textures(spec: MjSpec) -> Iterator[str]:
    """Take out textures that MuJoCo refuses, and the materials that show them."""
    refused = {}
    for texture in spec.textures:
        alone = _empty(spec)
        copy = alone.add_texture(name="texture")
        for name in (
            "type",
            "builtin",
            "file",
            "cubefiles",
            "width",
            "height",
            "nchannel",
            "gridsize",
            "gridlayout",
        ):
            value = getattr(texture, name)
            if np.size(value):
                setattr(copy, name, value)
        if why := _refusal(alone):
            refused[texture.name] = why
    if not refused:
        return
    bare = set()
    for material in list(spec.materials):
        if refused.keys() & set(material.textures):
            bare.add(material.name)
            spec.delete(material)
    for geom in spec.geoms:
        if geom.material in bare:
            geom.material = ""
    for texture in list(spec.textures):
        if texture.name in refused:
            spec.delete(texture)
    yield from (f"texture {name!r} ({why})" for name, why in refused.items())


def _empty(spec: MjSpec) -> MjSpec:
    """A spec of nothing that looks for files where another does."""
    alone = mujoco.MjSpec()
    alone.modelfiledir = spec.modelfiledir
    alone.strippath = spec.strippath
    alone.meshdir, alone.texturedir = spec.meshdir, spec.texturedir
    return alone


def _delete(spec: MjSpec, path: Path, meshes: dict[str, str], shapes: dict[int, str]) -> None:
    """Take out shapes, by index, and meshes with all shapes of theirs; ModelError where one is a body's mass."""
    if not (meshes or shapes):
        return
    for i, geom in enumerate(list(spec.geoms)):
        why = meshes.get(geom.meshname) if geom.meshname else shapes.get(i)
        if why is None:
            continue
        body = geom.parent
        if not body.explicitinertial and _moves(body) and has_mass(geom):
            what = f"mesh {geom.meshname!r}" if geom.meshname else "the shape"
            raise ModelError(
                f"{path}: {what} of body {body.name!r}: {why}, and the body has no inertial to do without it; "
                "correct it or give an explicit inertial"
            )
        spec.delete(geom)
    for mesh in list(spec.meshes):
        if mesh.name in meshes:
            spec.delete(mesh)


def _moves(body: mujoco.MjsBody) -> bool:
    """Whether a joint stands between the body and the world; what is fixed there needs no inertia."""
    while body.name != "world":
        if body.joints:
            return True
        body = body.parent
    return False


def _is_absent(spec: MjSpec, mesh: mujoco.MjsMesh, path: Path) -> bool:
    folder = Path(spec.modelfiledir or path.parent)
    name = mesh.file.split("://", 1)[-1]
    file = folder / (spec.meshdir or "") / (Path(name).name if spec.strippath else name)
    return bool(mesh.file) and not file.is_file()
