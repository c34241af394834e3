"""Files that appear whole or not at all."""

import contextlib
import os
import secrets
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO


@contextlib.contextmanager
def whole_file(path: Path) -> Iterator[BinaryIO]:
    """A file to write to that takes its name only when all went well; what was there stays until then."""
    part = path.with_name(f".{path.name}.{secrets.token_hex(4)}.part")
    try:
        with open(part, "xb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)


def check_target(path: Path) -> None:
    """Raise ValueError where a log cannot be written: another suffix, or a folder that is not there."""
    if path.suffix.lower() not in (".npz", ".csv", ".parquet"):
        raise ValueError(f"cannot write {path}: a log is written as .npz, .csv or .parquet")
    if not path.parent.is_dir():
        raise ValueError(f"cannot write {path}: there is no folder {path.parent}; make it first")
