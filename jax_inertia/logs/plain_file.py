"""Files that somebody names, opened only where they are plain files: a pipe or a device has no end."""

import stat
from pathlib import Path

_POINTER = b"version https://git-lfs.github.com/spec"


def require_plain(path: Path) -> None:
    """Raise OSError, with the path, for what is not there, and for a folder, pipe or device."""
    mode = path.stat().st_mode
    if not stat.S_ISREG(mode):
        what = "a folder" if stat.S_ISDIR(mode) else "a pipe or device"
        raise OSError(f"{path}: {what}, not a file")


def require_content(path: Path) -> None:
    """Raise OSError, with the path, for a pointer that Git LFS keeps in place of a file."""
    with open(path, "rb") as file:
        if file.read(len(_POINTER)) == _POINTER:
            raise OSError(
                f"{path}: a pointer of Git LFS, not the file itself; in its folder: git lfs pull"
            )


def read_plain(path: Path, most: int) -> bytes:
    """The bytes of a plain file of at most so many; OSError as `require_plain` raises it, and for a larger one."""
    require_plain(path)
    with open(path, "rb") as file:
        raw = file.read(most + 1)
    if len(raw) > most:
        raise OSError(f"{path}: larger than {most} bytes")
    return raw


def require_replaceable(path: Path) -> None:
    """Raise ValueError for a name that is taken by what is no plain file, and that a file would replace."""
    if path.exists() and not path.is_file():
        raise ValueError(
            f"cannot write {path}: it is a folder, a pipe or a device; give another name"
        )
