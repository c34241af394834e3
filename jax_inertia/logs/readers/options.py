"""What the user states about a file because the file does not say it."""

import dataclasses
import importlib
import os
from collections.abc import Mapping, Sequence
from enum import StrEnum
from typing import Any

import numpy as np

from jax_inertia.logs.npz import LogError
from jax_inertia.logs.readers.stamps import in_seconds


class WrenchAxes(StrEnum):
    """Axes in which the messages of a force sensor are written."""

    WORLD = "world"
    BODY = "body"


@dataclasses.dataclass(frozen=True)
class Options:
    """How to read a log that is not in the contract's own form; every field has a sensible default.

    `columns` (CSV, Parquet) maps a column of the contract to the file's, one `*` standing for the joint on both
    sides: `{"qpos.*": "q_*"}`; parts of one array in several columns of lists are given together:
    `{"tau": ("torque.left", "torque.right")}`. `joints` names the entries of list columns. `episode` picks one of a
    dataset, whose positions normalised to ±100 need the JSON file of the motors' ranges as `calibration`.
    `topic_joints` (one or several), `topic_base`, `topic_imu` and `topic_wrenches` (body → topic) are for bags;
    `wrench_axes` says in which axes the wrenches are, and `flip_wrenches` that they are the robot's on its
    surroundings. `rename` maps joints as the file calls them to the model's names; `degrees` says that positions and
    velocities are in degrees; `time_unit` is that of the stamps: s, ms, us, ns (without it s, or what is unmistakable,
    see `stamps.guess`);
    `tau_unit` and `tau_kind` are as in the log contract and win over what the file says.
    """

    columns: Mapping[str, str | Sequence[str]] = dataclasses.field(default_factory=dict)
    joints: Sequence[str] = ()
    episode: int | None = None
    calibration: str | os.PathLike[str] | None = None
    topic_joints: str | Sequence[str] | None = None
    topic_base: str | None = None
    topic_imu: str | None = None
    topic_wrenches: Mapping[str, str] = dataclasses.field(default_factory=dict)
    wrench_axes: WrenchAxes = WrenchAxes.WORLD
    flip_wrenches: bool = False
    rename: Mapping[str, str] = dataclasses.field(default_factory=dict)
    degrees: bool = False
    time_unit: str | None = None
    tau_unit: str | None = None
    tau_kind: str | None = None

    @property
    def joint_topics(self) -> tuple[str, ...]:
        """Topics that joint states are asked of; none: all."""
        given = self.topic_joints or ()
        return (given,) if isinstance(given, str) else tuple(given)

    def check(self, kind: str, used: Sequence[str]) -> None:
        """Raise `LogError` where an option is set that this kind of file has no use for."""
        for field in dataclasses.fields(self):
            given = getattr(self, field.name)
            default = field.default if field.default is not dataclasses.MISSING else {}
            if field.name not in (*used, *_ALWAYS) and given != default:
                raise LogError(f"the option {field.name} does not apply to {kind}")


_ALWAYS = ("rename", "degrees", "time_unit", "tau_unit", "tau_kind")


@dataclasses.dataclass
class Contents:
    """What a reader found: arrays by the contract's names (numbers float64, text str), and remarks."""

    arrays: dict[str, np.ndarray]
    others: Sequence[str] = ()
    """What the file holds besides, by name."""
    notes: Sequence[str] = ()
    in_radians: bool = False
    """The file itself states the unit of positions, which has been seen to."""
    in_seconds: bool = False
    """The file itself states the unit of its stamps, which has been seen to."""


def applied(contents: Contents, options: Options) -> Contents:
    """The contents with the options that every kind of file knows."""
    arrays = dict(contents.arrays)
    notes = list(contents.notes)
    if options.rename and "joint_names" in arrays:
        names = arrays["joint_names"].tolist()
        for name in options.rename:
            if name not in names:
                raise LogError(f"no joint {name!r} to rename; the file has {', '.join(names)}")
        arrays["joint_names"] = np.array([options.rename.get(n, n) for n in names], dtype=np.str_)
    if options.degrees and contents.in_radians:
        raise LogError("the file states the unit of its positions itself; leave out degrees")
    if options.degrees:
        for name in ("qpos", "qvel", "qpos_target", "qvel_target"):
            if name in arrays:
                arrays[name] = np.deg2rad(arrays[name])
        notes.append("positions and velocities were turned from degrees into radians")
    if options.time_unit is not None and contents.in_seconds:
        raise LogError("the file states the unit of its stamps itself; leave out time_unit")
    if "time" in arrays and arrays["time"].dtype.kind == "f" and not contents.in_seconds:
        channels = (arrays.get(name) for name in ("qpos", "qvel"))
        arrays["time"], note = in_seconds(arrays["time"], options.time_unit, *channels)
        notes += [note] * bool(note)
    for name in ("tau_unit", "tau_kind"):
        if (value := getattr(options, name)) is not None:
            arrays[name] = np.array(value)
    return dataclasses.replace(contents, arrays=arrays, notes=notes)


def required(module: str, what: str) -> Any:
    """Import a library of the extra `readers`; `LogError` with the command to install it where it is not there."""
    try:
        return importlib.import_module(module)
    except ImportError:
        package = module.partition(".")[0]
        raise LogError(
            f"reading {what} needs {package}: pip install 'jax-inertia[readers]'"
        ) from None
