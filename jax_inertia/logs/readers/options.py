"""What the user states about a file because the file does not say it."""

import dataclasses
import importlib
import os
from collections.abc import Mapping, Sequence
from enum import StrEnum
from typing import Any

import numpy as np
from jaxtyping import Float

from jax_inertia.logs.joint_names import Affixes
from jax_inertia.logs.npz import LogError
from jax_inertia.logs.readers.registers import signed
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
    `{"tau": ("torque.left", "torque.right")}`. `joints` names the entries of list columns, and `rate` [Hz] stands for
    stamps that a table lacks. `episode` picks one of a dataset, whose positions normalised to ±100 need the JSON file
    of the motors' ranges as `calibration`.
    `topic_joints` (one or several), `topic_targets` (whose joints `joints` names, where messages do not), `topic_base`,
    `topic_imu` and `topic_wrenches` (body → topic) are for bags; `wrench_axes` says in which axes the wrenches are, and
    `flip_wrenches` that they are the robot's on its surroundings. `rename` maps joints as the file calls them to the
    model's names, with one `*` on both sides for what they share; `degrees` says that positions and velocities are in
    degrees. Positions, and targets with them, are `position_scale` · (value − `position_zero`), and targets then
    `target_offset` + `target_scale` · value, of a joint by its name or of all (""), counted from the position where
    they are `relative_targets`. `time_unit` is that of the stamps: s, ms, us, ns (without it s, or what is
    unmistakable, see `stamps.guess`);
    `tau_unit` and `tau_kind` are as in the log contract and win over what the file says.
    """

    columns: Mapping[str, str | Sequence[str]] = dataclasses.field(default_factory=dict)
    joints: Sequence[str] = ()
    rate: float | None = None
    episode: int | None = None
    calibration: str | os.PathLike[str] | None = None
    topic_joints: str | Sequence[str] | None = None
    topic_targets: str | None = None
    topic_base: str | None = None
    topic_imu: str | None = None
    topic_wrenches: Mapping[str, str] = dataclasses.field(default_factory=dict)
    wrench_axes: WrenchAxes = WrenchAxes.WORLD
    flip_wrenches: bool = False
    rename: Mapping[str, str] = dataclasses.field(default_factory=dict)
    degrees: bool = False
    position_scale: Mapping[str, float | int] = dataclasses.field(default_factory=dict)
    position_zero: Mapping[str, float | int] = dataclasses.field(default_factory=dict)
    target_scale: Mapping[str, float | int] = dataclasses.field(default_factory=dict)
    target_offset: Mapping[str, float | int] = dataclasses.field(default_factory=dict)
    relative_targets: bool = False
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


# Velocities are compared with differences of positions over so many samples, and agree within this factor.
_WIDE, _NEAR = 8, 1.5
_ALWAYS = (
    "rename",
    "degrees",
    "time_unit",
    "tau_unit",
    "tau_kind",
    "position_scale",
    "position_zero",
    "target_scale",
    "target_offset",
    "relative_targets",
)


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
        new = _renamed(names, options.rename)
        arrays["joint_names"] = np.array([new.get(n, n) for n in names], dtype=np.str_)
    if options.degrees and contents.in_radians:
        raise LogError("the file states the unit of its positions itself; leave out degrees")
    if options.degrees:
        for name in ("qpos", "qvel", "qpos_target", "qvel_target"):
            if name in arrays:
                arrays[name] = np.deg2rad(arrays[name])
        notes.append("positions and velocities were turned from degrees into radians")
    scale, more = _scaled(arrays, options)
    notes += more
    if options.time_unit is not None and contents.in_seconds:
        raise LogError("the file states the unit of its stamps itself; leave out time_unit")
    if "time" in arrays and arrays["time"].dtype.kind == "f" and not contents.in_seconds:
        channels = (arrays.get(name) for name in ("qpos", "qvel"))
        arrays["time"], note = in_seconds(arrays["time"], options.time_unit, *channels)
        notes += [note] * bool(note)
    notes += _rates_in_si(arrays, np.deg2rad(scale) if options.degrees else scale)
    notes += signed(arrays)
    for name in ("tau_unit", "tau_kind"):
        if (value := getattr(options, name)) is not None:
            arrays[name] = np.array(value)
    return dataclasses.replace(contents, arrays=arrays, notes=notes)


def _renamed(names: Sequence[str], rename: Mapping[str, str]) -> dict[str, str]:
    """New names of joints; a * on both sides stands for what the names share."""
    out: dict[str, str] = {}
    for file, model in rename.items():
        if file.count("*") != model.count("*") or file.count("*") > 1:
            raise LogError(f"rename {file}={model}: both sides have one *, or none has")
        if "*" in file:
            sides = tuple((x.partition("*")[0], x.partition("*")[2]) for x in (file, model))
            affixes = Affixes(*sides)
            found = {x: new for x in names if (new := affixes.of_model(x)) is not None}
        else:
            found = {file: model} if file in names else {}
        if not found:
            raise LogError(f"no joint {file!r} to rename; the file has {', '.join(names)}")
        out |= found
    return out


def _scaled(
    arrays: dict[str, np.ndarray], options: Options
) -> tuple[Float[np.ndarray, " n"], list[str]]:
    """Turn positions, and targets, of joints ("": of all) into SI, in place, velocities along; factors, and notes."""
    names = [str(x) for x in np.ravel(arrays.get("joint_names", ()))]
    given = [
        options.position_scale,
        options.position_zero,
        options.target_scale,
        options.target_offset,
    ]
    for name in {key for one in given for key in one} - {"", *names}:
        raise LogError(f"no joint {name!r} to scale; the file has {', '.join(names)}")
    if (any(given[2:]) or options.relative_targets) and "qpos_target" not in arrays:
        raise LogError("the file has no targets (qpos_target) to scale")
    scale, zero, gain, offset = (
        np.array([one.get(name, one.get("", usual)) for name in names])
        for one, usual in zip(given, (1.0, 0.0, 1.0, 0.0), strict=True)
    )
    notes = []
    if any(given[:2]):
        for name in ("qpos", "qpos_target"):
            if name in arrays:
                arrays[name] = (arrays[name] - zero) * scale
        for name in ("qvel", "qvel_target"):
            if name in arrays:
                arrays[name] = arrays[name] * scale
        notes.append("positions and velocities were scaled as requested")
    if any(given[2:]):
        arrays["qpos_target"] = offset + gain * arrays["qpos_target"]
        notes.append("targets were scaled as requested")
    if options.relative_targets:
        arrays["qpos_target"] = arrays["qpos"] + arrays["qpos_target"]
        notes.append("targets were counted from positions, as requested")
    return scale, notes


def _rates_in_si(arrays: dict[str, np.ndarray], scale: Float[np.ndarray, " n"]) -> list[str]:
    """Undo what scaling did to velocities that were dqpos/dt in SI before it, in place; a note."""
    time, q, v = (arrays.get(name) for name in ("time", "qpos", "qvel"))
    if v is None or q is None or time is None or np.all(scale == 1.0):
        return []
    wide = min(_WIDE, len(time) - 1)
    lasts = time[wide:] - time[:-wide]
    if q.shape != v.shape or wide < 1 or not np.all(lasts > 0):
        return []
    slope = np.nanmedian(np.abs(q[wide:] - q[:-wide]) / lasts[:, None], axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.nanmedian(np.abs(v), axis=0) / slope
        already = (scale != 1.0) & (np.abs(np.log(ratio / scale)) < np.log(_NEAR))
    if not already.any():
        return []
    for name in ("qvel", "qvel_target"):
        if name in arrays:
            arrays[name] = arrays[name] / np.where(already, scale, 1.0)
    names = [str(x) for x in np.ravel(arrays["joint_names"])]
    told = ", ".join(name for name, one in zip(names, already, strict=True) if one)
    return [f"velocities of {told} were dqpos/dt in rad/s (m/s) already, and were not scaled"]


def required(module: str, what: str) -> Any:
    """Import a library of the extra `readers`; `LogError` with the command to install it where it is not there."""
    try:
        return importlib.import_module(module)
    except ImportError:
        package = module.partition(".")[0]
        raise LogError(
            f"reading {what} needs {package}: pip install {package}, or all readers from jax_inertia's folder: "
            "pip install '.[readers]'"
        ) from None
