"""A log from a file, chunk by chunk: a day of it goes through the filter in bounded memory.

for part in Stream(estimator).run(read_chunks("day.parquet", names=robot)):
    print(part.time[-1], part.trace.estimate.pi[-1, 0, 0])
"""

import contextlib
import dataclasses
import os
import time
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import TextIO

import numpy as np

from jax_inertia.logs.as_model import JointNames
from jax_inertia.logs.log import Log, LogError
from jax_inertia.logs.log_files import _log_of, _naming
from jax_inertia.logs.readers import column_plan, columns
from jax_inertia.logs.readers.delimited import More, csv_parts
from jax_inertia.logs.readers.options import Options
from jax_inertia.logs.readers.parquet import parquet_parts
from jax_inertia.logs.readers.stamps import guess

_KINDS = (".csv", ".tsv", ".parquet")
_Part = tuple[column_plan.Plan, Mapping[str, np.ndarray]]


def read_chunks(
    path: str | os.PathLike[str],
    *,
    rows: int = 1 << 16,
    options: Options | None = None,
    names: JointNames | None = None,
    more: More | None = None,
) -> Iterator[Log]:
    """Read a .csv or .parquet file as logs of `rows` samples each, in order; the last has one more or fewer.

    Names, units and every sample are checked as `read_log` does, chunk by chunk, and stamps and `sigma_*` also from
    chunk to chunk; only the first chunk carries notes. Raises `LogError` with one line, where the chunk is reached
    that is at fault: what came before it was sound. A .csv file that is still being written is followed: at its end
    `more` is asked what to go on with (`followed`). Other kinds of files: `jax-inertia convert` makes a .parquet.

    >>> import tempfile
    >>> from pathlib import Path
    >>> from jax_inertia import write_log
    >>> from jax_inertia.logs.chunks import read_chunks
    >>> from jax_inertia.robots.pendulum import swing
    >>> path = Path(tempfile.mkdtemp()) / "swing.csv"
    >>> write_log(swing(seconds=0.5), path)
    >>> [len(chunk.time) for chunk in read_chunks(path, rows=20)]
    [20, 20, 10]
    """
    path, options = Path(path), options or Options()
    if rows < 2:
        raise ValueError(f"rows is {rows}; a chunk holds two samples at least")
    before: Log | None = None
    with _naming(path):
        if not path.is_file():
            raise LogError("no such file")
        if (kind := path.suffix.lower()) not in _KINDS:
            raise LogError(
                f"{kind or 'such a file'} is not read in chunks; {', '.join(_KINDS)} are"
            )
        if kind == ".parquet":
            if more is not None:
                raise LogError("a .parquet file cannot be read while it is written; write a .csv")
            parts = parquet_parts(path, options, rows)
        else:
            parts = csv_parts(path, options, more)
        for plan, table in _recut(parts, rows):
            contents = columns.arrays(plan, table)
            if before is None and options.time_unit is None and not contents.in_seconds:
                # What the first chunk says of the stamps' unit goes for all.
                stamps, *channels = (contents.arrays.get(n) for n in ("time", "qpos", "qvel"))
                unit = None if stamps is None else guess(stamps, *channels)
                options = dataclasses.replace(options, time_unit=unit or "s")
            log = _log_of(contents, options, names, before)
            if before is not None:
                _check_follows(before, log)
                log = dataclasses.replace(log, notes=())
            yield log
            before = log


def followed(path: Path, idle: float, pause: float = 0.05) -> More:
    """`more` of a file that is written, until nothing has come for `idle` seconds.

    A log that is rotated is followed into its successor, whether the old file is renamed and another begun at `path`,
    or copied and cut to nothing: what is there is read first.
    """

    def more(file: TextIO) -> TextIO | None:
        end = time.monotonic() + idle
        while True:
            here = os.fstat(file.fileno())
            read = os.lseek(file.fileno(), 0, os.SEEK_CUR)
            if here.st_size > read:
                return file
            with contextlib.suppress(FileNotFoundError):
                # Cut to nothing is to be seen before it has grown again beyond where it was.
                if here.st_size < read or not os.path.samestat(here, path.stat()):
                    file.close()
                    return open(path, encoding=file.encoding)
            if time.monotonic() > end:
                return None
            time.sleep(pause)

    return more


def _recut(parts: Iterable[_Part], rows: int) -> Iterator[_Part]:
    """Tables of `rows` rows from tables of any; a single row at the end goes with the one before."""
    plan, texts, waiting, count = None, {}, [], 0
    for plan, part in parts:
        texts = {name: x for name, x in part.items() if x.ndim == 0} or texts
        waiting.append({name: x for name, x in part.items() if x.ndim})
        count += len(next(iter(waiting[-1].values()), ()))
        while count >= rows + 2:
            whole = _joined(waiting)
            yield plan, {name: x[:rows] for name, x in whole.items()} | texts
            waiting, count = [{name: x[rows:] for name, x in whole.items()}], count - rows
    if plan is None:
        raise LogError("holds no rows")
    yield plan, _joined(waiting) | texts


def _joined(tables: list[dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    return {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}


def _check_follows(before: Log, log: Log) -> None:
    """What the chunks, each sound, could still contradict each other in."""
    if not log.time[0] > before.time[-1]:
        raise LogError(
            f"time {log.time[0]:.9g} s does not come after {before.time[-1]:.9g} s; stamps must strictly increase"
        )
    for name in ("sigma_qpos", "sigma_tau"):
        one, other = getattr(before, name), getattr(log, name)
        if one is not None and not np.array_equal(one, other):
            raise LogError(f"{name} changes over time; it is one value, repeated")
