"""Columns out of a Parquet file by Arrow, here or in a process of its own.

A file of a kilobyte can hold a list of 10⁹ numbers or a text of any length, repeated, and says so only in places that
Arrow cannot be asked about without risk: columns of lists and texts are read by a child with bounded memory, whose end
is no harm. Run as a script, this file is that child, and so it imports nothing of the package.
"""

import contextlib
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

_LONGEST_TEXT = 1000
# No robot has so many joints: a list of more is something else, or made to fill memory.
_WIDEST = 10_000
# What decoding may take on top of the interpreter and Arrow themselves, and for each byte of numbers that is kept.
_ROOM, _COPIES = 512 << 20, 3
_MOST_ROOM = 1 << 30
_OVERHEAD = 2 << 30
# Pools and threads map far more than they use, and what is bounded is what is mapped.
_FRUGAL = {
    "ARROW_DEFAULT_MEMORY_POOL": "system",
    "MALLOC_ARENA_MAX": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "OMP_NUM_THREADS": "1",
}
_PAGES = 1 << 20
_BATCH = 32 << 20


def read(
    path: Path, wanted: Sequence[str], episode: int | None, limit: int
) -> dict[str, np.ndarray]:
    """The wanted columns as float64 (T,) or (T, width), or as distinct texts; rows of one episode where asked for.

    Raises ValueError for what is no number, and for more than `limit` bytes.
    """
    import pyarrow.parquet as parquet

    with opened(parquet, path) as file:
        fields = [
            file.schema_arrow.field(name) for name in wanted if name in file.schema_arrow.names
        ]
    if all(_is_plain(str(field.type)) for field in fields):
        return _here(path, wanted, episode, limit)
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "columns.npz"
        arguments = [path, out, "" if episode is None else episode, limit, *wanted]
        child = subprocess.run(
            [sys.executable, "-P", __file__, *map(str, arguments)],
            capture_output=True,
            check=False,
            env=os.environ | _FRUGAL,
        )
        if child.returncode:
            last = child.stderr.decode("utf-8", "replace").strip().splitlines()[-1:]
            known = last and child.returncode == 3
            raise ValueError(
                last[0] if known else "damaged, or it unfolds to more than there is room for"
            )
        with np.load(out, allow_pickle=False) as arrays:
            names = arrays["names"].tolist()
            return {name: arrays[f"column_{k}"] for k, name in enumerate(names)}


def batches(path: Path, wanted: Sequence[str], rows: int) -> Iterator[dict[str, np.ndarray]]:
    """Columns of plain numbers as float64 (T,), up to so many rows at a time and no row group as a whole.

    Raises ValueError for columns of lists and texts, whose size no number of rows bounds.
    """
    import pyarrow.parquet as parquet

    with opened(parquet, path, buffer_size=_PAGES) as file:
        for name in wanted:
            kind = str(file.schema_arrow.field(name).type)
            if not _is_plain(kind):
                raise ValueError(
                    f"column {name!r} holds {kind[:60]}; only columns of numbers, one a joint, are read in chunks"
                )
        for batch in file.iter_batches(batch_size=rows, columns=list(wanted)):
            yield {name: _values(name, batch.column(name)) for name in wanted}


def _is_plain(kind: str) -> bool:
    """Whether a row of such a column is one number."""
    return _is_number(kind) or kind.startswith("timestamp")


def opened(parquet: Any, path: Path, **how: Any) -> Any:
    """The file, with bounds on what its header may make Arrow allocate."""
    # Buffered beforehand, all of a file would stay in memory until its last row is read.
    return parquet.ParquetFile(
        path,
        pre_buffer=False,
        thrift_string_size_limit=1 << 24,
        thrift_container_size_limit=1 << 22,
        **how,
    )


def joined(name: str, parts: Sequence[np.ndarray]) -> np.ndarray:
    """One column from its parts; a text must be the same everywhere."""
    if len({part.shape[1:] for part in parts}) > 1:
        raise ValueError(f"column {name!r} holds lists of different lengths")
    whole = np.concatenate([np.atleast_1d(part) for part in parts])
    if whole.dtype.kind == "U":
        words = sorted(set(whole.tolist()))
        if len(words) != 1:
            shown = ", ".join(word[:80] for word in words[:3])
            raise ValueError(f"column {name!r} holds {shown}; it is one text, repeated")
        return np.array(words[0])
    return whole


def _here(
    path: Path, wanted: Sequence[str], episode: int | None, limit: int
) -> dict[str, np.ndarray]:
    import pyarrow.parquet as parquet

    out: dict[str, list[np.ndarray]] = {}
    total = 0
    with opened(parquet, path) as file:
        for batch in file.iter_batches(batch_size=_rows(file, wanted), columns=list(wanted)):
            part = {n: _values(n, batch.column(n)) for n in batch.schema.names if n in wanted}
            if episode is not None:
                keep = part["episode_index"] == episode
                part = {n: v if v.dtype.kind == "U" else v[keep] for n, v in part.items()}
            for name, value in part.items():
                total += value.nbytes
                out.setdefault(name, []).append(value)
            if total > limit:
                raise ValueError(f"holds more than the limit of {limit} bytes; cut the log")
    return {name: joined(name, parts) for name, parts in out.items()}


def _rows(file: Any, wanted: Sequence[str]) -> int:
    """How many rows to take at a time, by what the first one holds."""
    plain = all(
        _is_plain(str(file.schema_arrow.field(n).type))
        for n in wanted
        if n in file.schema_arrow.names
    )
    if plain:
        return 1 << 16
    first = next(file.iter_batches(batch_size=1, columns=list(wanted)), None)
    if first is None:
        return 1
    size = sum(_values(n, first.column(n)).nbytes for n in first.schema.names if n in wanted)
    return int(min(max(_BATCH // max(size, 1), 1), 1 << 16))


def _values(name: str, column: Any) -> np.ndarray:
    kind = str(column.type)
    if kind.startswith(("string", "large_string", "dictionary<values=string")):
        words = [str(word or "") for word in column.unique().slice(0, 3).to_pylist()]
        if any(len(word) > _LONGEST_TEXT for word in words):
            raise ValueError(f"column {name!r} holds texts of more than {_LONGEST_TEXT} characters")
        return np.array(words, dtype=np.str_)
    if kind.startswith("timestamp"):
        return column.cast("timestamp[ns]").cast("int64").to_numpy(zero_copy_only=False) * 1e-9
    if kind.startswith(("list", "large_list", "fixed_size_list")):
        if column.null_count:
            raise ValueError(f"column {name!r} has rows without a list")
        rows = len(column)
        lengths = column.value_lengths().to_numpy(zero_copy_only=False) if rows else np.zeros(0)
        if rows and (lengths != lengths[0]).any():
            raise ValueError(f"column {name!r} holds lists of different lengths")
        if rows and lengths[0] > _WIDEST:
            raise ValueError(
                f"column {name!r} holds lists of {lengths[0]} numbers; at most {_WIDEST} make sense"
            )
        flat = column.flatten()
        if not _is_number(str(flat.type)):
            raise ValueError(f"column {name!r} holds lists of {flat.type}; expected numbers")
        width = int(lengths[0]) if rows else 0
        return flat.to_numpy(zero_copy_only=False).astype(float).reshape(rows, width)
    if not _is_number(kind):
        raise ValueError(f"column {name!r} holds {kind[:60]}; expected numbers")
    return column.to_numpy(zero_copy_only=False).astype(float)


def _is_number(kind: str) -> bool:
    return kind.startswith(("int", "uint", "float", "double", "halffloat", "bool"))


def _address_space() -> int:
    """Bytes that this process has mapped by now; what Arrow takes at most where the system does not tell."""
    try:
        with open("/proc/self/statm", encoding="ascii") as file:
            return int(file.read().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError):
        return _OVERHEAD


def _child(path: str, out: str, episode: str, limit: str, *wanted: str) -> int:
    # Not every system knows such a limit; there the child may be ended by the system instead.
    with contextlib.suppress(ImportError, OSError, ValueError):
        import resource

        import pyarrow.parquet

        pyarrow.set_cpu_count(1)
        pyarrow.set_io_thread_count(1)
        more = min(_ROOM + _COPIES * int(limit), _MOST_ROOM)
        room = _address_space() + more
        resource.setrlimit(resource.RLIMIT_AS, (room, room))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    try:
        columns = _here(Path(path), wanted, int(episode) if episode else None, int(limit))
    except ValueError as error:
        print(" ".join(str(error).split()), file=sys.stderr)
        return 3
    arrays = {f"column_{k}": value for k, value in enumerate(columns.values())}
    np.savez(out, allow_pickle=False, names=np.array(list(columns), dtype=np.str_), **arrays)
    return 0


if __name__ == "__main__":
    sys.exit(_child(*sys.argv[1:]))
