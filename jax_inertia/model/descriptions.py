"""Models by name, from the cache of the package robot_descriptions, and never from the network."""

import contextlib
import importlib
import os
from collections.abc import Iterator
from pathlib import Path

from jax_inertia.model.file_safety import ModelError
from jax_inertia.text.closest_names import suggestion

PREFIX = "robot_descriptions:"


def description(name: str) -> Path:
    """The MJCF or URDF file of a description that is on this machine already.

    Raises ModelError where the package is missing, the name unknown, or the description not in the cache: then with
    the command that fetches it.
    """
    try:
        package = importlib.import_module("robot_descriptions")
        cache = importlib.import_module("robot_descriptions._cache")
        repositories = importlib.import_module("robot_descriptions._repositories").REPOSITORIES
    except ImportError as error:
        raise ModelError(
            f"{PREFIX}{name} needs robot_descriptions: pip install robot_descriptions ({error})"
        ) from None
    known = sorted(package.DESCRIPTIONS)
    if name not in known:
        # People know the robot's name; descriptions have an ending after it.
        near = [other for other in known if name and name in other]
        hint = f"did you mean {' or '.join(near[:4])}?" if near else suggestion(name, known)
        raise ModelError(f"robot_descriptions has no {name!r}; {hint}")

    def cached(repository: str, commit: str | None = None) -> str:
        folder = repositories[repository].cache_path
        root = os.environ.get("ROBOT_DESCRIPTIONS_CACHE", "~/.cache/robot_descriptions")
        if commit is not None:
            folder = f"{folder}-{commit}/{folder}"
        path = Path(root).expanduser() / folder
        if not path.is_dir():
            raise ModelError(
                f"{name} is not on this machine, and nothing is fetched unasked; "
                f"fetch it with: python -m robot_descriptions pull {name}"
            )
        return str(path)

    with _instead(cache, "clone_to_cache", cached):
        module = importlib.import_module(f"robot_descriptions.{name}")
    path = getattr(module, "MJCF_PATH", None) or getattr(module, "URDF_PATH", None)
    if path is None:
        raise ModelError(f"{PREFIX}{name} comes as xacro; expand it to a URDF first")
    return Path(path)


@contextlib.contextmanager
def _instead(module, attribute: str, value) -> Iterator[None]:
    """Put another function in a module's place while the block runs: its descriptions clone when imported."""
    usual = getattr(module, attribute)
    setattr(module, attribute, value)
    try:
        yield
    finally:
        setattr(module, attribute, usual)
