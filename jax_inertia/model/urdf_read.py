"""URDFs as they are found: inertials that MuJoCo refuses are repaired, and a root link can be let float."""

import html

import mujoco
import numpy as np

from jax_inertia.model.file_safety import ModelError, Tag, tags
from jax_inertia.model.urdf_text import WORLD
from jax_inertia.text.closest_names import listed

# Far below what any robot weighs, far above what MuJoCo takes for nothing (1e-15).
_MASS, _MOMENT = 1e-9, 1e-12
_EPS = 1e-14


class ModelWarning(UserWarning):
    """A part of a model that the rigid-body dynamics leaves out, or reads otherwise than it stands, by name."""


def repair(spec: mujoco.MjSpec) -> list[str]:
    """Make inertials of a URDF's links such that MuJoCo compiles them; a line for what that changes, with names.

    A moment of inertia that is negative, or below the other two's difference, is raised to the least that a body can
    have. A link without inertial,
    where others have one, has no mass (URDF, link), where MuJoCo would fill its collision shapes with water. Links that
    move and have no mass (three hinges in one place stand for a ball joint) are given a nanogram.
    """
    raised, weightless = [], []
    some = any(body.explicitinertial for body in spec.bodies)
    for body in spec.bodies:
        if some and body.name != "world" and not body.explicitinertial:
            for geom in body.geoms:
                geom.mass = 0.0
        if body.explicitinertial and _without_negative(body):
            raised.append(body.name)
        if body.name == "world" or not body.joints:
            continue
        if not body.explicitinertial and not any(has_mass(geom) for geom in body.geoms):
            body.explicitinertial, body.ipos = True, np.zeros(3)
            body.mass = 0.0
        if body.explicitinertial:
            if body.mass < _MASS:
                weightless.append(body.name)
            body.mass = max(body.mass, _MASS)
        if body.explicitinertial and np.isnan(body.fullinertia[0]):
            body.inertia = np.maximum(body.inertia, _MOMENT)
    told = {
        "moments of inertia that no body has were raised": raised,
        "links that move and have no mass were given a nanogram": weightless,
    }
    return [f"{what}: {listed(names, 20)}" for what, names in told.items() if names]


def _without_negative(body: mujoco.MjsBody) -> bool:
    """Replace an inertia that is not positive definite by its moments and axes; whether a moment had to be raised."""
    if np.isnan(body.fullinertia[0]):
        return False
    xx, yy, zz, xy, xz, yz = body.fullinertia
    moments, axes = np.linalg.eigh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    if not np.isfinite([*moments, *axes.ravel()]).all() or moments[0] >= _EPS:
        return False
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    turn, whole = np.zeros(4), np.zeros(4)
    mujoco.mju_mat2Quat(turn, axes.ravel())
    mujoco.mju_mulQuat(whole, np.asarray(body.iquat), turn)
    before = moments.copy()
    # The least that makes a body of it: no moment is larger than the sum of the others.
    moments = np.maximum(moments, 0.0)
    moments[0] = max(moments[0], moments[2] - moments[1])
    body.iquat, body.inertia = whole, moments
    body.fullinertia = np.full(6, np.nan)
    # No difference of the two: a file's numbers may be as large as numbers are.
    return bool(np.any(moments - 1e-9 * np.abs(before).max() > before))


def has_mass(geom: mujoco.MjsGeom) -> bool:
    """Whether MuJoCo takes mass from a shape."""
    return bool(geom.mass > 0 or (np.isnan(geom.mass) and geom.density > 0))


JOINT = "root_joint"


def _root_link(found: list[Tag]) -> str:
    """The link that is no joint's child. Raises ModelError where there is not one."""
    links: list[str] = []
    path: list[str] = []
    children = set()
    for tag in found:
        if tag.closes:
            path = path[:-1]
            continue
        if tag.name == "link" and path == ["robot"]:
            links.append(tag.attributes.get("name", ""))
        if tag.name == "child" and path == ["robot", "joint"]:
            children.add(tag.attributes.get("link", ""))
        if not tag.empty:
            path.append(tag.name)
    roots = [name for name in links if name not in children]
    if len(roots) != 1:
        raise ModelError(
            f"a URDF has one root link; these are no joint's child: {listed(roots, 20)}"
        )
    return roots[0]


def with_floating_base(text: str) -> str:
    """A URDF whose root link moves freely in the world; as it is where that link is the world or something floats.

    Raises ModelError for a URDF that is not closed or has not one root link.
    """
    found = list(tags(text))
    root = _root_link(found)
    if root == WORLD or any(tag.attributes.get("type") == "floating" for tag in found):
        return text
    ends = [tag.start for tag in found if tag.name == "robot" and tag.closes]
    if not ends:
        raise ModelError("a URDF ends with </robot>; this one does not")
    taken = {tag.attributes.get("name") for tag in found}
    world, joint = _free(WORLD, taken), _free(JOINT, taken)
    # A name is read unescaped: as it stands it could close its quotes, and add what was never checked.
    free = (
        f'<link name="{world}"/><joint name="{joint}" type="floating">'
        f'<parent link="{world}"/><child link="{html.escape(root)}"/></joint>\n'
    )
    return text[: ends[-1]] + free + text[ends[-1] :]


def _free(name: str, taken: set[str | None]) -> str:
    """A name that nothing has yet."""
    while name in taken:
        name += "_"
    return name
