"""Inertial parameters written into the text of a URDF, everything else left as it stands."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Array, Float

from jax_inertia.logs.atomic_files import whole_file
from jax_inertia.model.file_safety import ModelError, Tag, tags
from jax_inertia.model.spec import check_pi

# How bytes that are no UTF-8 stand in a text, to be written again as they were.
_BYTES = "surrogateescape"


def is_urdf(path: str | Path) -> bool:
    """Whether a model file is a URDF: its first tag is `<robot>`."""
    first = next(tags(_read(Path(path)), path), None)
    return first is not None and first.name == "robot"


def write_urdf(
    source: str | Path, out: str | Path, pi: Mapping[str, Float[Array, "10"] | np.ndarray]
) -> None:
    """Copy a URDF with the inertials of the named links replaced by π (10,), about each link's frame origin.

    Only `<inertial>` elements of these links change; the rest is copied byte for byte. Mass, centre of mass and
    inertia about it are written in the link's axes. Raises ModelError for a file that is no URDF, an unknown link, and
    parameters that no body can have.
    """
    text = with_inertials(_read(Path(source)), pi, source)
    with whole_file(Path(out)) as file:
        file.write(text.encode("utf-8", _BYTES))


def with_inertials(
    text: str, pi: Mapping[str, Float[Array, "10"] | np.ndarray], where: str | Path = "model"
) -> str:
    """The text of a URDF with other inertials; see `write_urdf`."""
    found = list(tags(text, where))
    if not found or found[0].name != "robot":
        raise ModelError(f"{where}: not a URDF, which starts with <robot>")
    links = _links(found)
    edits: list[tuple[int, int, str]] = []
    for name, value in pi.items():
        mass, com, inertia = check_pi(name, value, tuple(links))
        edits.append(_edit(text, links[name], _element(mass, com, inertia)))
    for start, end, new in sorted(edits, reverse=True):
        text = text[:start] + new + text[end:]
    return text


def _read(path: Path) -> str:
    """A file as text from which its bytes come back: what is not touched comes out as it went in."""
    raw = path.read_bytes()
    if raw[:2] in (b"\xff\xfe", b"\xfe\xff"):
        raise ModelError(f"{path}: in UTF-16; save it as UTF-8")
    return raw.decode("utf-8", _BYTES)


def _links(found: list[Tag]) -> dict[str, list[Tag]]:
    """The tags of each link of the robot, its own first and last."""
    links: dict[str, list[Tag]] = {}
    path: list[str] = []
    current: list[Tag] | None = None
    for tag in found:
        if tag.closes:
            if path:
                path.pop()
            if current is not None:
                current.append(tag)
            if tag.name == "link" and len(path) == 1:
                current = None
            continue
        if tag.name == "link" and path == ["robot"]:
            current = links.setdefault(
                tag.attributes.get("name", "").encode("utf-8", _BYTES).decode("utf-8", "replace"),
                [],
            )
        if current is not None:
            current.append(tag)
        if tag.empty:
            current = None if path == ["robot"] else current
        else:
            path.append(tag.name)
    return links


def _edit(text: str, link: list[Tag], element: str) -> tuple[int, int, str]:
    """Where in the text the element goes, instead of what."""
    own = link[0]
    line = text[text.rfind("\n", 0, own.start) + 1 : own.start]
    outer = line if not line.strip() else ""
    newline = "\r\n" if "\r\n" in text[: own.end + 200] else "\n"
    inner = newline + outer + "  "
    body = element.replace("\n", inner)
    if own.empty:
        opened = text[own.start : own.end - 2].rstrip() + ">"
        return own.start, own.end, f"{opened}{inner}{body}{newline}{outer}</link>"
    depth = 0
    for k, tag in enumerate(link):
        if tag.name == "inertial" and depth == 1 and not tag.closes:
            end = (
                tag
                if tag.empty
                else next((t for t in link[k:] if t.closes and t.name == "inertial"), tag)
            )
            return tag.start, end.end, body
        depth += -1 if tag.closes else 0 if tag.empty else 1
    return own.end, own.end, inner + body


def _element(mass: float, com: np.ndarray, inertia: np.ndarray) -> str:
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
