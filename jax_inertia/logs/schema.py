"""The log contract: which arrays a log holds, their shapes, their units, and what their values must satisfy."""

import math
import re
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from enum import StrEnum
from typing import Any

import numpy as np

from jax_inertia.logs.npz import LogError

SHAPES: Mapping[str, tuple[str | int, ...]] = {
    "time": ("T",),
    "qpos": ("T", "n"),
    "tau": ("T", "n"),
    "qvel": ("T", "n"),
    "tau_command": ("T", "n"),
    "qpos_target": ("T", "n"),
    "qvel_target": ("T", "n"),
    "kp": ("n",),
    "kd": ("n",),
    "sigma_qpos": ("n",),
    "sigma_tau": ("n",),
    "base_pos": ("T", 3),
    "base_quat": ("T", 4),
    "base_linvel": ("T", 3),
    "base_angvel": ("T", 3),
    "base_linacc": ("T", 3),
    "imu_pos": (3,),
    "contact_wrench": ("T", "C", 6),
    "contact_force": ("T", "C"),
    "contact_flag": ("T", "C"),
}
_REQUIRED = ("time", "joint_names", "qpos")
_DRIVEN = ("tau", "qpos_target", "contact_wrench")
"""What a joint did must be known, and what made it do so: its torque, its position target, or a force sensor's
wrench."""
_PER_JOINT = ("sigma_qpos", "sigma_tau", "kp", "kd")
TEXTS = ("joint_names", "contact_bodies", "imu_body", "tau_kind", "tau_unit")
CHANNELS = tuple(name for name, shape in SHAPES.items() if shape[0] == "T" and name != "time")

_UNIT_END = r"(?=$|\s*[\[(,;:])"
_UNITS = (
    (r"n(?:ewtons?)?[\s·⋅∙*._-]*m(?:et(?:re|er)s?)?", "N m"),
    (r"a(?:mp(?:ere)?s?)?(?:\s*(?:rms|peak))?", "A"),
    (r"m\s?a(?:\s*(?:rms|peak))?|milliamp(?:ere)?s?", "mA"),
)


class TorqueUnit(StrEnum):
    """What `Log.tau` is measured in; anything but N m means an unknown drive gain per joint."""

    NEWTON_METRE = "N m"
    AMPERE = "A"
    MILLIAMPERE = "mA"
    PWM = "PWM"
    UNKNOWN = "unknown"

    @classmethod
    def parse(cls, text: str) -> "TorqueUnit":
        """Read a unit at the start of free text: `"Nm (joint torque sensor)"`, `"A, measured"`,
        `"PWM counts"`.

        What follows the unit must be a remark (bracket, comma, semicolon, colon), so that `"Nm/A"`
        stays unknown.
        """
        head = text.strip().lower()
        if bracketed := re.fullmatch(r"[\[(]([^\])]*)[\])]", head):
            head = bracketed.group(1).strip()
        for pattern, unit in _UNITS:
            if re.match(f"(?:{pattern}){_UNIT_END}", head):
                return cls(unit)
        return cls.PWM if re.match(r"[^(,;:]*\bpwm\b", head) else cls.UNKNOWN


class TorqueKind(StrEnum):
    """Where `Log.tau` comes from."""

    COMMANDED = "commanded"
    CURRENT = "current"
    SENSOR = "sensor"
    UNKNOWN = "unknown"


def check_structure(fields: Mapping) -> None:
    """Raise `LogError` where names or shapes of a log's fields do not fit together."""
    names, bodies = fields["joint_names"], fields.get("contact_bodies", ())
    name, times = Counter(names).most_common(1)[0] if names else ("", 0)
    if times > 1:
        raise LogError(f"joint_names holds {name!r} {times} times; each joint has one column")
    given = {name: np.shape(x) for name in SHAPES if (x := fields.get(name)) is not None}
    _check_shapes(given, len(names), len(bodies))


def check_declared(shapes: Mapping[str, tuple[int, ...]]) -> None:
    """Raise `LogError` where the shapes that a file claims, before it is unfolded, are of no one log."""
    _require_all(shapes)
    for name in ("joint_names", "contact_bodies"):
        if name in shapes:
            _require_list(name, shapes[name])
    _require_times(shapes["time"])
    # One sigma for all joints, and the empty wrenches of who touches nothing, are read as what they stand for.
    plain = {
        name: shape
        for name, shape in shapes.items()
        if math.prod(shape) and not (shape == () and SHAPES.get(name) == ("n",))
    }
    _check_shapes(plain, shapes["joint_names"][0], shapes.get("contact_bodies", (0,))[0])


def _require_all(names: Collection[str]) -> None:
    for name in _REQUIRED:
        if name not in names:
            raise LogError(f"array '{name}' is missing; a log holds {', '.join(_REQUIRED)}, tau")
    if not any(name in names for name in _DRIVEN):
        raise LogError(
            f"array 'tau' is missing; a log holds {', '.join(_REQUIRED)}, tau (or qpos_target, of a "
            "position-controlled robot)"
        )


def _check_shapes(shapes: Mapping[str, tuple[int, ...]], joints: int, contacts: int) -> None:
    if not joints:
        raise LogError("joint_names is empty; name one joint per column of qpos")
    for name, spec in SHAPES.items():
        if "C" in spec and name in shapes and not contacts:
            raise LogError(f"{name} comes without contact_bodies; name the body of each of its C")
    sizes = {"T": shapes["time"][:1], "n": (joints,), "C": (contacts,)}
    for name, spec in SHAPES.items():
        if (shape := shapes.get(name)) is None:
            continue
        right = tuple(x for s in spec for x in (sizes[s] if isinstance(s, str) else (s,)))
        if len(right) != len(spec) or shape != right:
            meaning = ", ".join(str(s) for s in spec)
            raise LogError(
                f"{name} has shape {shape}; expected ({meaning}) = {right}, "
                "T samples of time, n joint_names, C contact_bodies"
            )


def fields_of(
    arrays: Mapping[str, np.ndarray], others: Sequence[str], notes: Sequence[str] = ()
) -> dict[str, Any]:
    """Check a reader's arrays (numbers float64, text str) and turn them into the fields of a
    `Log`.
    """
    _require_all(arrays)
    for name, value in arrays.items():
        if (value.dtype.kind == "U") != (name in TEXTS):
            is_, right = ("text", "numbers") if value.dtype.kind == "U" else ("numbers", "text")
            raise LogError(f"array '{name}' holds {is_}; expected {right}")
    fields: dict[str, Any] = {name: value for name, value in arrays.items() if name in SHAPES}
    fields["joint_names"] = _names("joint_names", arrays["joint_names"])
    if "contact_bodies" in arrays:
        fields["contact_bodies"] = _names("contact_bodies", arrays["contact_bodies"])
    for name in _PER_JOINT:
        if name in fields and fields[name].shape == ():
            fields[name] = np.full(len(fields["joint_names"]), fields[name])
    unit = _word("tau_unit", arrays, "N m")
    kind = _word("tau_kind", arrays, "unknown").lower()
    if kind not in list(TorqueKind):
        raise LogError(f"tau_kind is {kind[:60]!r}; expected commanded, current or sensor")
    if fields.get("contact_bodies") == ():
        # A writer for many robots gives an empty array to the one that touches nothing.
        fields = {k: x for k, x in fields.items() if "C" not in SHAPES.get(k, ()) or x.size}
    fields["imu_body"] = _word("imu_body", arrays, "")
    fields |= {
        "tau_kind": TorqueKind(kind),
        "tau_unit": TorqueUnit.parse(unit),
        "tau_unit_text": unit,
        "notes": (*notes, *_notes(arrays, others)),
    }
    check_time(fields["time"])
    check_structure(fields)
    for name in _PER_JOINT:
        if name in fields:
            _check_size(name, fields[name])
    if "imu_pos" in fields and not np.isfinite(fields["imu_pos"]).all():
        raise LogError(f"imu_pos is {fields['imu_pos']}; expected where the IMU is [m]")
    return fields


def _require_list(array: str, shape: tuple[int, ...]) -> None:
    if len(shape) != 1:
        raise LogError(f"{array} has shape {shape}; expected one dimension of names")


def _names(array: str, value: np.ndarray) -> tuple[str, ...]:
    _require_list(array, value.shape)
    for k, name in enumerate(value.tolist()):
        if not name or not name.isprintable():
            raise LogError(f"{array}[{k}] is {name[:60]!r}; expected a printable name")
    return tuple(value.tolist())


def _word(array: str, arrays: Mapping[str, np.ndarray], default: str) -> str:
    value = arrays.get(array, np.array(default))
    if value.size != 1:
        raise LogError(f"{array} has shape {value.shape}; expected one text")
    return " ".join(str(value.item()).split())


def _check_size(array: str, value: np.ndarray) -> None:
    if (bad := ~(np.isfinite(value) & (value >= 0))).any():
        what = "gain" if array in ("kp", "kd") else "standard deviation"
        raise LogError(f"{array} holds {value[bad][0]}; a {what} is finite and not negative")


def _require_times(shape: tuple[int, ...]) -> None:
    if len(shape) != 1 or shape[0] < 2:
        raise LogError(f"time has shape {shape}; expected (T,) with at least two samples")


def check_time(time: np.ndarray) -> None:
    """Raise `LogError` naming the first stamp that is no second, or does not come after the one before."""
    _require_times(time.shape)
    if time.dtype.kind not in "fiu":
        raise LogError("time holds text; expected seconds")
    # The bound leaves room for Unix time in seconds and none for milliseconds or less.
    _check_stamps(time, np.abs(time) < 1e11)
    if back := np.flatnonzero(~(np.diff(time) > 0)).tolist():
        k = back[0]
        raise LogError(
            f"time[{k + 1}] = {time[k + 1]:.9g} s does not come after time[{k}] = {time[k]:.9g} s "
            f"({len(back)} such); stamps must strictly increase"
        )


def check_finite(time: np.ndarray) -> None:
    """Raise `LogError` naming the first stamp that is not finite."""
    _check_stamps(time, np.isfinite(time))


def _check_stamps(time: np.ndarray, good: np.ndarray) -> None:
    if bad := np.flatnonzero(~good).tolist():
        raise LogError(f"time[{bad[0]}] is {time[bad[0]]} ({len(bad)} such); expected seconds")


def _notes(arrays: Mapping[str, np.ndarray], others: Sequence[str]) -> tuple[str, ...]:
    notes = []
    if others:
        shown = ", ".join(repr(name[:60]) for name in others[:20])
        more = f" and {len(others) - 20} more" if len(others) > 20 else ""
        notes.append(f"ignored, not part of the log contract: {shown}{more}")
    if "tau" not in arrays:
        return tuple(notes)
    if "tau_kind" not in arrays:
        notes.append("tau_kind is missing: whether torque was commanded or measured is not known")
    if "tau_unit" not in arrays:
        notes.append("tau_unit is missing: torque is taken to be in N m")
    return tuple(notes)
