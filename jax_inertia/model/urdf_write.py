"""Inertial parameters and joint friction written into the text of a URDF, everything else left as it stands."""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple
from xml.sax.saxutils import quoteattr

import numpy as np
from jaxtyping import Array, Float

from jax_inertia.logs.atomic_files import whole_file
from jax_inertia.model.file_safety import ModelError, Tag, tags
from jax_inertia.model.spec import check_pi
from jax_inertia.text.closest_names import suggestion


class Dynamics(NamedTuple):
    """What `<dynamics>` of a URDF's joint says."""

    damping: float
    """[N m s/rad], of a prismatic joint [N s/m]."""
    friction: float
    """Dry friction [N m], of a prismatic joint [N]."""


# How bytes that are no UTF-8 stand in a text, to be written again as they were.
_BYTES = "surrogateescape"


def is_urdf(path: str | Path) -> bool:
    """Whether a model file is a URDF: its first tag is `<robot>`."""
    first = next(tags(_read(Path(path)), path), None)
    return first is not None and first.name == "robot"


def write_urdf(
    source: str | Path,
    out: str | Path,
    pi: Mapping[str, Float[Array, "10"] | np.ndarray],
    dynamics: Mapping[str, Dynamics] | None = None,
) -> None:
    """Copy a URDF with the inertials of the named links replaced by π (10,), about each link's frame origin.

    With `dynamics` also damping and dry friction of the named joints. Only `<inertial>` elements of these links and
    `<dynamics>` of these joints change; the rest is copied byte for byte. Mass, centre of mass and inertia about it are
    written in the link's axes. Raises ModelError for a file that is no URDF, an unknown link or joint, parameters that
    no body can have, and friction below zero.

    >>> import pathlib, tempfile
    >>> import jax.numpy as jnp
    >>> from jax_inertia.maths.inertial_parameters import from_com
    >>> from jax_inertia.model.urdf_write import write_urdf
    >>> folder = pathlib.Path(tempfile.mkdtemp())
    >>> inertia = '<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>'
    >>> link = f'<link name="hand"><inertial><mass value="1"/>{inertia}</inertial></link>'
    >>> _ = (folder / "a.urdf").write_text(f'<robot name="arm">{link}</robot>')
    >>> pi = from_com(jnp.array(3.0), jnp.zeros(3), 0.02 * jnp.eye(3))
    >>> write_urdf(folder / "a.urdf", folder / "b.urdf", {"hand": pi})
    >>> '<mass value="3' in (folder / "b.urdf").read_text()
    True
    """
    text = with_numbers(_read(Path(source)), pi, dynamics or {}, source)
    with whole_file(Path(out)) as file:
        file.write(text.encode("utf-8", _BYTES))


def with_numbers(
    text: str,
    pi: Mapping[str, Float[Array, "10"] | np.ndarray],
    dynamics: Mapping[str, Dynamics],
    where: str | Path = "model",
) -> str:
    """The text of a URDF with other inertials and joint friction; see `write_urdf`."""
    found = list(tags(text, where))
    if not found or found[0].name != "robot":
        raise ModelError(f"{where}: not a URDF, which starts with <robot>")
    links, joints = (_elements(found, kind) for kind in ("link", "joint"))
    edits: list[tuple[int, int, str]] = []
    for name, value in pi.items():
        mass, com, inertia = check_pi(name, value, tuple(links))
        edits.append(_edit(text, links[name], "inertial", _inertial(mass, com, inertia)))
    for name, value in dynamics.items():
        if name not in joints:
            raise ModelError(f"no joint {name!r} in {where}; {suggestion(name, tuple(joints))}")
        if not (0.0 <= value.damping < np.inf and 0.0 <= value.friction < np.inf):
            raise ModelError(f"joint {name!r}: {value}; friction is finite and not below zero")
        edits.append(_edit(text, joints[name], "dynamics", _dynamics(joints[name], value)))
    for start, end, new in sorted(edits, reverse=True):
        text = text[:start] + new + text[end:]
    return text


def _read(path: Path) -> str:
    """A file as text from which its bytes come back: what is not touched comes out as it went in."""
    raw = path.read_bytes()
    if raw[:2] in (b"\xff\xfe", b"\xfe\xff"):
        raise ModelError(f"{path}: in UTF-16; save it as UTF-8")
    return raw.decode("utf-8", _BYTES)


def _elements(found: list[Tag], kind: str) -> dict[str, list[Tag]]:
    """The tags of each link or joint of the robot, its own first and last."""
    elements: dict[str, list[Tag]] = {}
    path: list[str] = []
    current: list[Tag] | None = None
    for tag in found:
        if tag.closes:
            if path:
                path.pop()
            if current is not None:
                current.append(tag)
            if tag.name == kind and len(path) == 1:
                current = None
            continue
        if tag.name == kind and path == ["robot"]:
            current = elements.setdefault(
                tag.attributes.get("name", "").encode("utf-8", _BYTES).decode("utf-8", "replace"),
                [],
            )
        if current is not None:
            current.append(tag)
        if tag.empty:
            current = None if path == ["robot"] else current
        else:
            path.append(tag.name)
    return elements


def _edit(text: str, outside: list[Tag], name: str, element: str) -> tuple[int, int, str]:
    """Where in the text of a link or joint its element of a name goes, instead of what."""
    own = outside[0]
    line = text[text.rfind("\n", 0, own.start) + 1 : own.start]
    outer = line if not line.strip() else ""
    newline = "\r\n" if "\r\n" in text[: own.end + 200] else "\n"
    inner = newline + outer + "  "
    body = element.replace("\n", inner)
    if own.empty:
        opened = text[own.start : own.end - 2].rstrip() + ">"
        return own.start, own.end, f"{opened}{inner}{body}{newline}{outer}</{own.name}>"
    depth = 0
    for k, tag in enumerate(outside):
        if tag.name == name and depth == 1 and not tag.closes:
            end = (
                tag
                if tag.empty
                else next((t for t in outside[k:] if t.closes and t.name == name), tag)
            )
            return tag.start, end.end, body
        depth += -1 if tag.closes else 0 if tag.empty else 1
    return own.end, own.end, inner + body


def _dynamics(joint: list[Tag], value: Dynamics) -> str:
    """The joint's element with these two; what others it has (a simulator's own) stay."""
    own = next((tag for tag in joint if tag.name == "dynamics" and not tag.closes), None)
    every = {} if own is None else dict(own.attributes)
    every |= {"damping": _number(value.damping), "friction": _number(value.friction)}
    return f"<dynamics {' '.join(f'{n}={quoteattr(x)}' for n, x in every.items())}/>"


def _inertial(mass: float, com: np.ndarray, inertia: np.ndarray) -> str:
    xyz = " ".join(_number(x) for x in com)
    names = {
        "ixx": (0, 0),
        "ixy": (0, 1),
        "ixz": (0, 2),
        "iyy": (1, 1),
        "iyz": (1, 2),
        "izz": (2, 2),
    }
    values = " ".join(f'{name}="{_number(inertia[ij])}"' for name, ij in names.items())
    return (
        f'<inertial>\n  <origin xyz="{xyz}" rpy="0 0 0"/>\n  <mass value="{_number(mass)}"/>\n'
        f"  <inertia {values}/>\n</inertial>"
    )


def _number(value: float) -> str:
    return repr(float(value) + 0.0)
