"""Files that appear whole or not at all."""

import contextlib
import os
import re
import secrets
import time
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any, BinaryIO

from jax_inertia.logs.plain_file import require_replaceable

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None

# A part younger than this [s] is left alone.
_NEW = 10.0


@contextlib.contextmanager
def whole_file(path: Path) -> Iterator[BinaryIO]:
    """A file to write to that takes its name only when all went well; what was there stays until then.

    What a process that was killed left of the same file is removed.
    Raises ValueError for the name of what is no plain file: a pipe, a device, a folder.
    """
    require_replaceable(path)
    _remove_orphans(path)
    part = path.with_name(f".{path.name}.{secrets.token_hex(4)}.part")
    try:
        with open(part, "xb") as file:
            held(file)
            yield file
            file.flush()
            os.fsync(file.fileno())
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)


def held(file: IO[Any]) -> bool | None:
    """Lock an open file until it is closed, by a kill too; False where another process holds it.

    None where the system, or the file system, has no such locks.
    """
    if fcntl is None:
        return None
    try:
        fcntl.flock(file.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return None
    return True


def _remove_orphans(path: Path) -> None:
    """Remove parts of a file whose writers are gone: those that nobody holds."""
    ours = re.compile(re.escape(f".{path.name}.") + r"[0-9a-f]{8}\.part")
    with contextlib.suppress(OSError):
        for part in path.parent.iterdir():
            # Between its making and its lock, and between its end and its renaming, a part is nobody's.
            if not ours.fullmatch(part.name) or time.time() - part.stat().st_mtime < _NEW:
                continue
            with contextlib.suppress(OSError), open(part, "r+b") as file:
                if held(file):
                    part.unlink()


def check_target(path: Path) -> None:
    """Raise ValueError where a log cannot be written: another suffix, or a folder that is not there."""
    if path.suffix.lower() not in (".npz", ".csv", ".parquet"):
        raise ValueError(f"cannot write {path}: a log is written as .npz, .csv or .parquet")
    if not path.parent.is_dir():
        raise ValueError(f"cannot write {path}: there is no folder {path.parent}; make it first")
