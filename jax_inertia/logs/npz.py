"""Arrays out of an .npz file that nobody vouches for.

An .npz is a zip of .npy members: a short text header (dtype, memory order, shape), then raw bytes.
``numpy.load`` takes memory for whatever shape the header claims and can run pickles. Here the
header is matched against a narrow pattern, its claim is checked against what the file can hold
before any memory is taken, and only plain numbers and text are ever built: there is no road to a
pickle, so none has to be closed.
"""

import math
import re
import zipfile
import zlib
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

_MAX_HEADER = 4096
_MAX_TEXT = 1 << 20
# Deflate cannot expand by more than 1032 : 1 (a 258-byte match takes at least two bits).
_MAX_DEFLATE_RATIO = 1032
_CHUNK = 1 << 20

_DTYPE = re.compile(r"'descr'\s*:\s*'([<>|=]?)([A-Za-z])(\d{0,9})'")
_ORDER = re.compile(r"'fortran_order'\s*:\s*(True|False)\b")
_SHAPE = re.compile(r"'shape'\s*:\s*\(([\d,\s]*)\)")
_SIZES = {"f": (2, 4, 8), "i": (1, 2, 4, 8), "u": (1, 2, 4, 8)}


class LogError(ValueError):
    """A log that cannot be used; the message is one line: what, where, what would be right."""


class _Header(NamedTuple):
    dtype: np.dtype
    fortran_order: bool
    shape: tuple[int, ...]
    length: int

    @property
    def nbytes(self) -> int:
        return math.prod(self.shape) * self.dtype.itemsize


def read_npz(
    path: Path,
    wanted: Collection[str],
    max_bytes: int,
    *,
    declared: Callable[[Mapping[str, tuple[int, ...]]], None] = lambda shapes: None,
    first: Mapping[str, Callable[[np.ndarray], None]] | None = None,
) -> tuple[dict[str, np.ndarray], tuple[str, ...]]:
    """Read the wanted arrays and name the others, whose contents are never touched.

    Numbers come back as float64, text as NumPy strings. `declared` looks at the shapes that the
    headers claim before anything is unfolded; those of `first` are then read before the others, and
    looked at. Raises `LogError` for whatever is not a sound .npz, holds other dtypes, would need
    more than `max_bytes` of memory (checked before memory is taken), or does not please those two.
    """
    first = first or {}
    try:
        with zipfile.ZipFile(path) as archive:
            members, others = _members(archive, wanted)
            headers = {name: _header(archive, name, info) for name, info in members.items()}
            _check_budget(headers, max_bytes)
            declared({name: header.shape for name, header in headers.items()})
            arrays = {}
            for name in sorted(members, key=lambda name: name not in first):
                arrays[name] = _array(archive, name, members[name], headers[name])
                if name in first:
                    first[name](arrays[name])
    except LogError:
        raise
    except (zipfile.BadZipFile, zlib.error, EOFError) as error:
        raise LogError(f"not a sound .npz (zip) file: {_one_line(error)}; write it again") from None
    except MemoryError:
        raise LogError(
            f"needs more memory than there is; read it with max_bytes below {max_bytes}"
        ) from None
    except (OSError, ValueError, NotImplementedError, RuntimeError, OverflowError) as error:
        # zipfile raises all of these on corrupt directories; RuntimeError is an encrypted member.
        raise LogError(f"cannot be read as .npz: {_one_line(error)}; write it again") from None
    return arrays, others


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())[:200] or type(error).__name__


def _members(
    archive: zipfile.ZipFile, wanted: Collection[str]
) -> tuple[dict[str, zipfile.ZipInfo], tuple[str, ...]]:
    members: dict[str, zipfile.ZipInfo] = {}
    others: list[str] = []
    for info in archive.infolist():
        name = info.filename.removesuffix(".npy")
        if name not in wanted or name == info.filename:
            others.append(name)
        elif name in members:
            raise LogError(f"array '{name}' is stored twice; keep one")
        elif info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise LogError(f"array '{name}' uses an unusual compression; write it with numpy.savez")
        else:
            members[name] = info
    return members, tuple(others)


def _header(archive: zipfile.ZipFile, name: str, info: zipfile.ZipInfo) -> _Header:
    with archive.open(info) as member:
        start = member.read(8)
        if len(start) < 8 or start[:6] != b"\x93NUMPY" or start[6] not in (1, 2, 3):
            raise LogError(f"array '{name}' is not in .npy format; write it with numpy.savez")
        width = 2 if start[6] == 1 else 4
        length = int.from_bytes(member.read(width), "little")
        if length > _MAX_HEADER:
            raise LogError(f"array '{name}' has a header of {length} bytes; write plain arrays")
        text = member.read(length).decode("latin-1")
    dtype, order, shape = _DTYPE.search(text), _ORDER.search(text), _SHAPE.search(text)
    if dtype is None or order is None or shape is None:
        raise LogError(
            f"array '{name}' has an unreadable header or a structured dtype; "
            "write a plain array of float64 or text"
        )
    header = _Header(
        _dtype(name, *dtype.groups()),
        order.group(1) == "True",
        tuple(int(size) for size in shape.group(1).replace(" ", "").split(",") if size.strip()),
        8 + width + length,
    )
    held = info.file_size - header.length
    if info.compress_type == zipfile.ZIP_DEFLATED:
        held = min(held, _MAX_DEFLATE_RATIO * info.compress_size - header.length)
    else:
        held = min(held, info.compress_size - header.length)
    if header.nbytes > max(held, 0):
        claim = " x ".join(str(size) for size in header.shape) or "one"
        raise LogError(
            f"array '{name}' declares {claim} values ({header.nbytes} bytes) but the file "
            f"holds at most {max(held, 0)}: truncated or forged"
        )
    return header


def _dtype(name: str, order: str, kind: str, size: str) -> np.dtype:
    if kind in _SIZES and size and int(size) in _SIZES[kind]:
        return np.dtype(f"{'<' if order in '|=' else order}{kind}{int(size)}")
    if kind in "US" and size and int(size) > 0:
        return np.dtype(f"{'<' if order in '|=' else order}{kind}{int(size)}")
    what = "Python objects (pickles)" if kind == "O" else f"dtype '{kind}{size}'"
    raise LogError(f"array '{name}' holds {what}; write float64 numbers or text")


def _check_budget(headers: dict[str, _Header], max_bytes: int) -> None:
    total = 0
    for name, header in headers.items():
        if header.dtype.kind in "US" and header.nbytes > _MAX_TEXT:
            raise LogError(
                f"array '{name}' declares {header.nbytes} bytes of text; "
                f"at most {_MAX_TEXT} make sense"
            )
        # Numbers end as float64, whatever they were stored as.
        total += max(header.nbytes, 8 * math.prod(header.shape))
        if total > max_bytes:
            raise LogError(
                f"array '{name}' brings the log to {total} bytes of memory, above the "
                f"limit of {max_bytes}; cut the log or raise max_bytes"
            )


def _array(
    archive: zipfile.ZipFile, name: str, info: zipfile.ZipInfo, header: _Header
) -> np.ndarray:
    raw = np.empty(header.nbytes, np.uint8)
    with archive.open(info) as member:
        member.read(header.length)
        got = _fill(member.read, raw)
        # Reading past the end is what makes zipfile compare the checksum.
        surplus = len(member.read(1))
    if got < header.nbytes or surplus:
        raise LogError(
            f"array '{name}' does not hold the {header.nbytes} bytes that its header "
            "declares: truncated or forged"
        )
    if header.dtype.kind in "US":
        return _text(name, raw, header)
    # A second copy only where the file holds another type.
    flat = raw.view(header.dtype).astype(np.float64, copy=False)
    return flat.reshape(header.shape, order="F" if header.fortran_order else "C")


def _fill(read: Callable[[int], bytes], target: np.ndarray) -> int:
    got = 0
    while got < target.size:
        chunk = read(min(_CHUNK, target.size - got))
        if not chunk:
            break
        target[got : got + len(chunk)] = np.frombuffer(chunk, np.uint8)
        got += len(chunk)
    return got


def _text(name: str, raw: np.ndarray, header: _Header) -> np.ndarray:
    """Decode by hand: NumPy builds strings of impossible code points and fails later."""
    codec = ("utf-32-le" if header.dtype.byteorder in "=<" else "utf-32-be", "utf-8")
    size = header.dtype.itemsize
    cells = [raw[k : k + size].tobytes() for k in range(0, raw.size, size)]
    try:
        words = [cell.decode(codec[header.dtype.kind == "S"]).rstrip("\0") for cell in cells]
    except UnicodeDecodeError:
        raise LogError(f"array '{name}' holds bytes that are not text; write str values") from None
    return np.array(words, dtype=np.str_).reshape(header.shape)
