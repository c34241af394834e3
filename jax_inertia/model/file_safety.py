"""What a model file says, looked at before MuJoCo acts on it.

MuJoCo expands, allocates and opens whatever MJCF asks for. A line of text can ask for a million bodies, a texture of
terabytes or a file that never ends, and includes can reach anywhere. This reads tags as text, as tolerantly as MuJoCo
does, and refuses what no robot needs.
"""

import contextlib
import os
import re
import shlex
import stat
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import NamedTuple

MOST_BODIES, MOST_LINKS = 3000, 1000
_MOST_BYTES, _MOST_FILES, _MOST_TAGS = 64 << 20, 200, 1_000_000
_MOST_COPIES = 2000
# MuJoCo compares the names of elements of one kind pair by pair: ten times as many take it a minute.
_MOST_OF_A_KIND, _MOST_KEYS = 20_000, 10_000
# Products of these attributes are sizes that MuJoCo allocates or builds.
_PRODUCTS: Mapping[str, tuple[tuple[str, ...], int]] = {
    "hfield": (("nrow", "ncol"), 1 << 24),
    "texture": (("width", "height"), 1 << 26),
    "flexcomp": (("count",), 20_000),
    "composite": (("count",), _MOST_COPIES),
}
_MOST_SIZE = 1_000_000
_FILES = (
    "file",
    "filename",
    *(f"file{s}" for s in ("right", "left", "up", "down", "front", "back")),
)
_FOLDERS = ("meshdir", "texturedir", "assetdir")

_ELSE = {
    "sdf": "an SDF world",
    "COLLADA": "a mesh",
    "boost_serialization": "an archive of Pinocchio's: give the URDF that its model was built from",
}

# What `_text` puts where bytes are no UTF-8.
_NO_LETTER = "\ufffd"

_COMMENT = re.compile(r"<!--.*?(?:-->|\Z)|<!\[CDATA\[.*?(?:\]\]>|\Z)|<\?.*?(?:\?>|\Z)", re.DOTALL)
# Possessive throughout, so that each letter is looked at a bounded number of times whatever the text. What fits but
# for its end is no tag, and the search goes on behind it: MuJoCo refuses such a text as a whole.
_TAG = re.compile(r"<(/?)([A-Za-z_][\w:.-]*+)((?:[^<>\"']++|\"[^\"]*+\"|'[^']*+')*+)(>?)")
_ATTRIBUTE = re.compile(r"([A-Za-z_][\w:.-]*+)(?:\s*+=\s*+(\"[^\"]*+\"|'[^']*+'))?")
_REFERENCE = re.compile(r"&(?:#(?:0*(\d{1,7})|[xX]0*([0-9a-fA-F]{1,6}))|(amp|lt|gt|quot|apos));")
_TOO_LARGE = re.compile(r"&#(?:0*+\d{8}|[xX]0*+[0-9a-fA-F]{7})")
_NAMED = {"amp": "&", "lt": "<", "gt": ">", "quot": '"', "apos": "'"}


class ModelError(ValueError):
    """A model that cannot be used: one line that says what, where, and what would be right."""

    def __init__(self, message: str) -> None:
        # Names from the file are quoted in messages, by MuJoCo too; they may hold line breaks or move a cursor.
        text = " ".join(message.split())
        super().__init__("".join(c if c.isprintable() else "?" for c in text))


class Tag(NamedTuple):
    """One tag in a text, and where it stands."""

    name: str
    attributes: Mapping[str, str]
    closes: bool
    """`</name>`."""
    empty: bool
    """`<name/>`."""
    start: int
    end: int


def tags(text: str, where: str | Path = "model") -> Iterator[Tag]:
    """The tags of a model's text in order, comments left out.

    Raises `ModelError` for a reference to a character that there is not; `where` says in it what the text is of.
    """
    # Blanks in their place keep every position.
    bare = _COMMENT.sub(lambda match: " " * len(match.group()), text)
    for match in _TAG.finditer(bare):
        closing, name, rest, end = match.groups()
        if not end:
            continue
        found = {
            key: _unescaped(value[1:-1], where) for key, value in _ATTRIBUTE.findall(rest) if value
        }
        yield Tag(name, found, bool(closing), rest.endswith("/"), *match.span())


def _unescaped(value: str, where: str | Path) -> str:
    """A value with its references replaced, by the five names and the numbers that XML has and MuJoCo reads."""
    if "&" not in value:
        return value
    if match := _TOO_LARGE.search(value):
        raise ModelError(f"{where}: {match.group()[:40]}... refers to no character; take it out")
    return _REFERENCE.sub(partial(_character, where), value)


def _character(where: str | Path, match: re.Match[str]) -> str:
    decimal, hexadecimal, name = match.groups()
    if name:
        return _NAMED[name]
    code = int(decimal) if decimal else int(hexadecimal, 16)
    if not 0 < code < 0x110000 or 0xD800 <= code < 0xE000:
        raise ModelError(f"{where}: {match.group()[:40]} refers to no character; take it out")
    return chr(code)


class Checked(NamedTuple):
    """What a model file is, and what it consists of."""

    root: str
    """Its first tag: `mujoco`, or `robot` for a URDF."""
    files: tuple[Path, ...]
    """Itself, what it includes, and the meshes, height fields and textures that are there."""


# Folders below which models may include files, besides their own.
_roots: list[Path] = []


@contextlib.contextmanager
def includes_below(root: Path | None) -> Iterator[None]:
    """Let models include files from below this folder while the block runs; without one, from their own alone.

    Raises `ModelError` for what is no folder.
    """
    if root is None:
        yield
        return
    if not root.is_dir():
        raise ModelError(f"{root}: no such folder, below which a model could include files")
    _roots.append(root.resolve())
    try:
        yield
    finally:
        _roots.pop()


def check_model(path: Path) -> Checked:
    """What a model file is and consists of.

    Raises `ModelError` for a file, or one that it includes, that asks for what no robot needs.
    """
    root, first = path.resolve().parent, ""
    seen: dict[Path, None] = {}
    folders: dict[str, None] = {".": None}
    named: dict[str, None] = {}
    bodies, copies = 0, 1
    waiting = [path.resolve()]
    while waiting:
        file = waiting.pop()
        if file in seen:
            continue
        seen[file] = None
        if len(seen) > _MOST_FILES:
            raise ModelError(f"{path}: includes more than {_MOST_FILES} files")
        text = _text(path, file)
        found = list(tags(text, f"{path}: {file.name}" if file != path.resolve() else path))
        first = first or (found[0].name if found else "-")
        _check_letters(path, found)
        if first == "robot":
            _check_twice(path, found)
        more, most = _check_tags(path, found)
        # An include inside <replicate> multiplies what its file copies.
        bodies, copies = bodies + more, copies * most
        if copies > _MOST_COPIES:
            raise ModelError(f"{path}: <replicate> makes {copies} copies; at most {_MOST_COPIES}")
        folders |= {t.attributes[f]: None for t in found for f in _FOLDERS if f in t.attributes}
        tags_with_files = (t.attributes for t in found if not t.closes)
        named |= {a[key]: None for a in tags_with_files for key in _FILES if a.get(key)}
        for tag in found:
            if tag.name in ("include", "model") and not tag.closes and "file" in tag.attributes:
                waiting += _included(path, root, file.parent, tag.attributes["file"])
    if bodies > MOST_BODIES:
        raise ModelError(f"{path}: has {bodies} bodies; at most {MOST_BODIES} make sense")
    if first in _ELSE:
        raise ModelError(f"{path}: {_ELSE[first]}; a model is MJCF or URDF")
    parts = _plain_files(path, root, list(folders)[:20], named)
    return Checked(first, tuple(dict.fromkeys((*seen, *parts))))


def _text(path: Path, file: Path) -> str:
    with open(file, "rb") as opened:
        raw = opened.read(_MOST_BYTES + 1)
    if len(raw) > _MOST_BYTES:
        raise ModelError(f"{path}: {file.name} is larger than {_MOST_BYTES} bytes: is it a model?")
    text = raw.decode("utf-8", "replace")
    if re.search(r"<!(DOCTYPE|ENTITY)", text, re.IGNORECASE):
        raise ModelError(
            f"{path}: {file.name} declares a document type or entities; take out <!DOCTYPE ...>"
        )
    if text.count("<") > _MOST_TAGS:
        raise ModelError(f"{path}: {file.name} holds more than {_MOST_TAGS} tags: is it a model?")
    return text


def _check_twice(path: Path, found: list[Tag]) -> None:
    """Refuse two links or joints of one name, of which MuJoCo may take one."""
    depth, seen = 0, set()
    for tag in found:
        if tag.closes:
            depth -= 1
            continue
        if depth == 1 and tag.name in ("link", "joint"):
            key = tag.name, tag.attributes.get("name", "")
            if key in seen:
                raise ModelError(
                    f"{path}: repeated name {key[1][:80]!r} of <{tag.name}>; rename one"
                )
            seen.add(key)
        depth += not tag.empty


def _check_letters(path: Path, found: list[Tag]) -> None:
    """Refuse names that are not in UTF-8: MuJoCo takes them, and cannot hand them on. Comments may be in anything."""
    for tag in found:
        for key, value in tag.attributes.items():
            if _NO_LETTER in value:
                raise ModelError(
                    f"{path}: {key}={value[:80]!r} of <{tag.name}> is not in UTF-8; save the file as UTF-8"
                )


def _check_tags(path: Path, found: list[Tag]) -> tuple[int, int]:
    """Refuse sizes that cannot be meant; the number of bodies, and how often the most copied is there."""
    bodies, copies, most_copied, links = 0, [1], 1, 0
    kinds: Counter[str] = Counter()
    for tag in found:
        if tag.name == "replicate" and tag.closes and len(copies) > 1:
            copies.pop()
        if tag.closes:
            continue
        if tag.name == "replicate" and not tag.empty:
            copies.append(copies[-1] * max(_whole(tag.attributes.get("count", "1")), 1))
            most_copied = max(most_copied, copies[-1])
        bodies += copies[-1] if tag.name == "body" else 0
        kinds[tag.name] += min(copies[-1], _MOST_COPIES)
        links += tag.name == "link"
        if tag.name in _PRODUCTS:
            names, most = _PRODUCTS[tag.name]
            product = 1
            for word in " ".join(tag.attributes.get(name, "1") for name in names).split():
                product *= max(_whole(word), 1)
            if product > most:
                raise ModelError(
                    f"{path}: <{tag.name}> asks for {' x '.join(names)} = {product}; at most {most} make sense"
                )
        if tag.name == "size":
            for name, value in tag.attributes.items():
                most = (
                    _MOST_KEYS if name == "nkey" else _MOST_SIZE // (1000 if "user" in name else 1)
                )
                if name != "memory" and _whole(value) > most:
                    raise ModelError(
                        f"{path}: <size {name}={value[:40]!r}> is more than makes sense"
                    )
    # Bodies have a bound of their own.
    del kinds["body"], kinds["link"]
    if kinds and (worst := kinds.most_common(1)[0])[1] > _MOST_OF_A_KIND:
        raise ModelError(
            f"{path}: has {worst[1]} <{worst[0]}>; at most {_MOST_OF_A_KIND} make sense"
        )
    if links > MOST_LINKS:
        raise ModelError(f"{path}: has {links} links; at most {MOST_LINKS} make sense")
    return bodies, most_copied


def _whole(text: str) -> int:
    match = re.match(r"\s*(\d{1,18})", text)
    return int(match.group(1)) if match else 0


def _plain_files(
    path: Path, root: Path, folders: Iterable[str], named: Iterable[str]
) -> Iterator[Path]:
    """The files that names may mean and that are there; refused is what is no plain file: a pipe has no end."""
    for value in named:
        bare = value.split("://", 1)[-1]
        for folder in folders:
            for candidate in (root / folder / bare, root / folder / Path(bare).name):
                if _is_special(candidate):
                    raise ModelError(f"{path}: {value[:200]!r} is a device or a pipe, not a file")
                if _is_file(candidate):
                    yield candidate


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def _is_special(path: Path) -> bool:
    try:
        mode = path.stat().st_mode
    except (OSError, ValueError):
        return False
    return not (stat.S_ISREG(mode) or stat.S_ISDIR(mode))


def _included(path: Path, root: Path, beside: Path, name: str) -> Iterator[Path]:
    """The files that an include may mean: MuJoCo looks from the main file, and from the including one."""
    for folder in dict.fromkeys((root, beside)):
        try:
            file = (folder / name).resolve()
            there = file.is_file()
        except (OSError, ValueError, RuntimeError):
            continue
        if not any(file.is_relative_to(allowed) for allowed in (root, *_roots)):
            shared = Path(os.path.commonpath([root, file]))
            way = f", or, if you trust it, --include-root {shlex.quote(str(shared))}"
            raise ModelError(
                f"{path}: includes {name[:200]!r}, which is outside the model's folder; copy it there"
                + way * (shared != Path(shared.anchor))
            )
        if there:
            yield file
