"""A log from a file of any kind that people have, and into one: `read_log`, `write_log`.

What is structurally wrong raises `LogError`, in one line that names the file.
"""

import contextlib
import dataclasses
import os
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import numpy as np

from jax_inertia.logs.as_model import JointNames, as_model
from jax_inertia.logs.atomic_files import check_target, whole_file
from jax_inertia.logs.log import Log
from jax_inertia.logs.npz import LogError, read_npz
from jax_inertia.logs.plain_file import require_content
from jax_inertia.logs.readers.arrays_by_name import read_hdf5, read_mat
from jax_inertia.logs.readers.bag import bag_parts, read_bag
from jax_inertia.logs.readers.bag_messages import kind_of
from jax_inertia.logs.readers.delimited import read_csv
from jax_inertia.logs.readers.export import write_table
from jax_inertia.logs.readers.options import Contents, Options, applied
from jax_inertia.logs.readers.parquet import read_dataset, read_parquet
from jax_inertia.logs.readers.registers import spread
from jax_inertia.logs.schema import SHAPES, TEXTS, check_declared, check_time, fields_of
from jax_inertia.text.closest_names import listed

# A name in a file may be of any length: characters of a message that quotes it, a decision.
_LONGEST = 1000


def read_log(
    path: str | os.PathLike[str],
    *,
    options: Options | None = None,
    names: JointNames | None = None,
    max_bytes: int = 4 << 30,
) -> Log:
    """Read a log of any kind that people have: .npz, .csv, .parquet, .hdf5, .mat, .bag, .mcap, .db3, or the folder of a
    ROS 2 bag or of a LeRobot dataset. `options` say what the file does not; see `jax_inertia.logs.readers`.

    With `names` (a `Robot`), joints that the robot does not have are left out where all those that it needs are
    there, as is a prefix that the file has before each of them. Angles of hinges wrapped at a turn are laid end to
    end. Nothing in the file is trusted: no pickles, no memory beyond `max_bytes`. Raises `LogError` with one line
    (what, where, what would be right) for a file that is not a sound log: missing or misshapen arrays, other dtypes,
    repeated names, stamps that do not increase. Samples may be NaN (a sensor that dropped out); stamps and noise may
    not. What is outside the contract is left alone and named in `Log.notes`.

    >>> import tempfile
    >>> from pathlib import Path
    >>> from jax_inertia import read_log, write_log
    >>> from jax_inertia.robots.pendulum import swing
    >>> path = Path(tempfile.mkdtemp()) / "swing.csv"
    >>> write_log(swing(seconds=0.5), path)
    >>> read_log(path)
    Log(0.49 s at 100 Hz, 50 samples; joints shoulder, elbow; qpos, tau, qvel; torque sensor in N m)
    """
    path, options = Path(path), options or Options()
    with _naming(path):
        contents = _evenly(_reader(path)(path, options, max_bytes))
        return _log_of(contents, options, names)


def _evenly(contents: Contents) -> Contents:
    """The contents with stamps that were rounded spread; of a whole log, for a chunk does not know its neighbours."""
    if "time" not in contents.arrays:
        return contents
    time, note = spread(contents.arrays["time"])
    if not note:
        return contents
    arrays = {**contents.arrays, "time": time}
    return dataclasses.replace(contents, arrays=arrays, notes=[*contents.notes, note])


def _log_of(
    contents: Contents, options: Options, names: JointNames | None, before: Log | None = None
) -> Log:
    """What a reader found as a log, checked, which goes on from what came `before`; raises LogError as `read_log`."""
    last: dict[str, float] = {}
    if before is not None:
        last = dict(zip(before.joint_names, np.asarray(before.qpos)[-1].tolist(), strict=True))
    contents = applied(contents, options)
    log = Log(**as_model(fields_of(contents.arrays, contents.others, contents.notes), names, last))
    return log if names is None else _of_robot(log, names)


@contextlib.contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Turn what goes wrong with a file into one printable line that names the file."""
    try:
        yield
    except (LogError, OSError) as error:
        # Names from the file are quoted in messages; they may hold line breaks or move the terminal's cursor.
        text = " ".join(f"{path}: {str(error)[:_LONGEST]}".split())
        raise LogError("".join(c if c.isprintable() else "?" for c in text)) from None


def _of_robot(log: Log, names: JointNames) -> Log:
    """Leave out what the robot has no joint for, where all of its joints are there: else it may be misspelt."""
    kinds = zip(names.joint_names, names.joint_type, strict=True)
    wanted = {name for name, kind in kinds if kind != "free"}
    extra = [name for name in log.joint_names if name not in wanted]
    if not extra or not wanted <= set(log.joint_names):
        return log
    note = f"left out, not in the model: {listed(extra)}"
    kept = log.select([name for name in log.joint_names if name in wanted])
    return dataclasses.replace(kept, notes=(*log.notes, note))


def _check_spread(time: np.ndarray) -> None:
    """Raise `LogError` for stamps that are no time, once those that repeat are spread."""
    check_time(spread(time)[0])


def _npz(path: Path, options: Options, max_bytes: int) -> Contents:
    options.check("an .npz file", ())
    # What is wrong with names and stamps is known before the channels are unfolded; of seconds by default.
    first = {} if options.time_unit else {"time": _check_spread}
    arrays, others = read_npz(
        path, (*SHAPES, *TEXTS), max_bytes, declared=check_declared, first=first
    )
    return Contents(arrays, others)


# A reader yields the contract's arrays by name (numbers float64, text str) and the names of all others.
_READERS: Mapping[str, Callable[[Path, Options, int], Contents]] = {
    ".npz": _npz,
    ".csv": read_csv,
    ".tsv": read_csv,
    ".parquet": read_parquet,
    ".h5": read_hdf5,
    ".hdf5": read_hdf5,
    ".mat": read_mat,
    ".bag": read_bag,
    ".mcap": read_bag,
    ".db3": read_bag,
}


_PICKLES = (".pkl", ".pickle", ".joblib", ".pt", ".pth")


def _reader(path: Path) -> Callable[[Path, Options, int], Contents]:
    if path.is_dir():
        if (path / "meta" / "info.json").is_file():
            return read_dataset
        if bag_parts(path):
            return read_bag
        raise LogError("no such file, but a folder without a ROS 2 bag or a LeRobot dataset in it")
    if not path.is_file():
        raise LogError("no such file")
    require_content(path)
    if (kind := kind_of(path)) in _PICKLES:
        raise LogError(
            "a pickle is a program that runs when it is read, so it is not; in yours: numpy.savez('log.npz', time=..., "
            "qpos=..., tau=..., joint_names=...)"
        )
    if kind not in _READERS:
        raise LogError(f"unknown kind of log {path.suffix!r}; expected {', '.join(_READERS)}")
    return _READERS[kind]


def write_log(log: Log, path: str | os.PathLike[str]) -> None:
    """Write a log that `read_log` reads back, as .npz, .csv or .parquet: whole or not at all (a temporary file takes
    the name at the end). Raises ValueError for another suffix, and for a folder that is not there.

    >>> import tempfile
    >>> from pathlib import Path
    >>> from jax_inertia import read_log, write_log
    >>> from jax_inertia.robots.pendulum import swing
    >>> path = Path(tempfile.mkdtemp()) / "swing.csv"
    >>> write_log(swing(seconds=0.5), path)
    >>> path.read_text().splitlines()[0]
    'time,qpos.shoulder,qpos.elbow,tau.shoulder,tau.elbow,qvel.shoulder,qvel.elbow,tau_unit,tau_kind'
    """
    path = Path(path)
    check_target(path)
    arrays = {
        name: np.asarray(value) for name in SHAPES if (value := getattr(log, name)) is not None
    }
    arrays |= {
        "joint_names": np.array(log.joint_names),
    }
    if log.tau is not None:
        arrays |= {
            "tau_kind": np.array(str(log.tau_kind)),
            "tau_unit": np.array(log.tau_unit_text),
        }
    if log.contact_bodies:
        arrays["contact_bodies"] = np.array(log.contact_bodies)
    if log.imu_body:
        arrays["imu_body"] = np.array(log.imu_body)
    if path.suffix.lower() == ".npz":
        with whole_file(path) as file:
            np.savez_compressed(file, allow_pickle=False, **arrays)
    else:
        write_table(arrays, path)
