"""A base that floats, for URDFs: they hang their root link in the world and leave it to each program to let it go."""

import html

from jax_inertia.model.file_safety import ModelError, Tag, tags

# A root link of this name is the world itself: a robot that says so is fixed to it.
WORLD = "world"
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
            f"a URDF has one root link; these are no joint's child: {', '.join(roots)}"
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
