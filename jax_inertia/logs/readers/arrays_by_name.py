"""HDF5 and MATLAB's .mat: arrays by their names, as columns of lists."""

import contextlib
import functools
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import scipy.io

from jax_inertia.logs.npz import LogError
from jax_inertia.logs.readers import column_plan, columns
from jax_inertia.logs.readers.column_names import suggested
from jax_inertia.logs.readers.options import Contents, Options, required

_OPTIONS = ("columns", "joints", "rate")
_MOST_ARRAYS = 10_000
_HDF5 = b"\x89HDF\r\n\x1a\n"


def read_hdf5(path: Path, options: Options, max_bytes: int) -> Contents:
    """Read arrays (T,) and (T, n) of an HDF5 file, named by their paths: observations/qpos.

    Links and data in other files are not followed. Raises `LogError` for what is missing, and for more than
    `max_bytes` of numbers, as the file declares them.
    """
    return _read(functools.partial(_hdf5, path), "an HDF5 file", options, max_bytes)


def read_mat(path: Path, options: Options, max_bytes: int) -> Contents:
    """Read arrays (T,) and (T, n) of a .mat file by their names; since version 7.3 such a file is HDF5.

    Raises `LogError` as `read_hdf5`.
    """
    with open(path, "rb") as file:
        start = file.read(520)
    hdf5 = start.endswith(_HDF5) or start.startswith(_HDF5)
    found = functools.partial(_hdf5, path, turned=True) if hdf5 else functools.partial(_mat, path)
    return _read(found, "a .mat file", options, max_bytes)


class _Array:
    """What a file declares of an array, and how to read it."""

    def __init__(self, name: str, shape: tuple[int, ...], read: Callable[[], Any]) -> None:
        self.name, self.read = name, read
        # A vector is a row or a column in MATLAB.
        self.shape = tuple(n for n in shape if n != 1) if len(shape) == 2 and 1 in shape else shape


def _read(
    found: Callable[[contextlib.ExitStack], Iterator[_Array]],
    what: str,
    options: Options,
    max_bytes: int,
) -> Contents:
    options.check(what, _OPTIONS)
    with _as_log_errors(what), contextlib.ExitStack() as opened:
        arrays = {one.name: one for one in found(opened)}
        plan = column_plan.plan(list(arrays), options)
        there = {column.array for column in plan.columns.values()}
        needed = ("time",) * (options.rate is None) + ("qpos", "tau")
        if "qpos" not in there:
            lacking = [array for array in needed if array not in there]
            raise LogError(suggested(lacking, list(arrays), lists=True))
        wanted = {heading: arrays[heading] for heading in plan.columns}
        if sum(8 * int(np.prod(one.shape)) for one in wanted.values()) > max_bytes:
            raise LogError(f"needs more than the limit of {max_bytes} bytes; cut the log")
        values = {
            heading: np.asarray(one.read(), float).reshape(one.shape)
            for heading, one in wanted.items()
        }
    lengths = Counter(len(x) for x in values.values() if x.ndim)
    if len(lengths) > 1:
        said = ", ".join(f"{heading} {x.shape}" for heading, x in values.items())
        raise LogError(f"arrays are of different lengths: {said}")
    names = dict.fromkeys(values, options.joints)
    plan, values = columns.spread(plan, values, names)
    return columns.arrays(plan, values, options.joints, options.rate)


@contextlib.contextmanager
def _as_log_errors(what: str) -> Iterator[None]:
    """What the libraries raise of a damaged file, as a LogError: nearly anything."""
    try:
        yield
    except LogError:
        raise
    except Exception as error:
        text = " ".join(str(error).split())[:200]
        raise LogError(f"not a sound file, for {what} ({text or type(error).__name__})") from None


def _hdf5(path: Path, opened: contextlib.ExitStack, turned: bool = False) -> Iterator[_Array]:
    h5py = required("h5py", "HDF5")
    file = opened.enter_context(h5py.File(path, "r"))
    seen: list[tuple[str, Any]] = []

    def see(name: str, one: Any) -> None:
        numbers = isinstance(one, h5py.Dataset) and one.dtype.kind in "fiu"
        if numbers and one.ndim in (1, 2) and one.external is None and not one.is_virtual:
            seen.append((name, one))
        if len(seen) > _MOST_ARRAYS:
            raise LogError(f"holds more than {_MOST_ARRAYS} arrays")

    file.visititems(see)
    for name, one in seen:
        shape = one.shape[::-1] if turned else one.shape
        yield _Array(name, shape, lambda one=one: one[()].T if turned else one[()])


def _mat(path: Path, _: contextlib.ExitStack) -> Iterator[_Array]:
    kinds = ("double", "single", *(f"{u}int{k}" for u in ("", "u") for k in (8, 16, 32, 64)))
    for name, shape, kind in scipy.io.whosmat(path):
        if kind in kinds and len(shape) == 2:
            yield _Array(
                name, shape, lambda name=name: scipy.io.loadmat(path, variable_names=[name])[name]
            )
