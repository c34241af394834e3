"""Tables to the arrays of the log contract: columns by name, units from their headings.

A column is named after the array and what it belongs to:

    time                                       s
    qpos.<joint>  qvel.<joint>  tau.<joint>    rad, rad/s, N m (on slides m, m/s, N)
    tau_command.<joint>  qpos_target.<joint>
    sigma_qpos.<joint>  sigma_tau.<joint>      one value, repeated
    base_pos.{x,y,z}  base_quat.{w,x,y,z}  base_linvel.{x,y,z}  base_angvel.{x,y,z}
    contact_wrench.<body>.{fx,fy,fz,mx,my,mz}
    tau_unit  tau_kind                         text, repeated

A heading may end in a unit, `qpos.elbow [deg]`, which is then converted. A column of lists holds a whole array:
`qpos` with one entry a joint.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from jax_inertia.logs.npz import LogError
from jax_inertia.logs.readers.options import Contents, Options
from jax_inertia.logs.schema import SHAPES
from jax_inertia.text.closest_names import listed, suggestion

_PER_JOINT = tuple(name for name, shape in SHAPES.items() if shape[-1] == "n")
_CONSTANT = tuple(name for name, shape in SHAPES.items() if shape[0] != "T")
_BASE = {
    "base_pos": "xyz",
    "base_quat": "wxyz",
    "base_linvel": "xyz",
    "base_angvel": "xyz",
}
_WRENCH = ("fx", "fy", "fz", "mx", "my", "mz")
_TEXTS = ("tau_unit", "tau_kind")
_MOST_COLUMNS = 10_000

_ANGLE = {"rad": 1.0, "deg": np.pi / 180, "°": np.pi / 180, "m": 1.0, "mm": 1e-3}
_RATE = {f"{unit}/s": factor for unit, factor in _ANGLE.items()} | {"rpm": np.pi / 30}
_LENGTH = {"m": 1.0, "mm": 1e-3}
_UNITS: Mapping[str, Mapping[str, float]] = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9},
    "qpos": _ANGLE,
    "qpos_target": _ANGLE,
    "sigma_qpos": _ANGLE,
    "qvel": _RATE,
    "base_pos": _LENGTH,
    "base_quat": {"1": 1.0, "-": 1.0},
    "base_linvel": {f"{unit}/s": factor for unit, factor in _LENGTH.items()},
    "base_angvel": {k: v for k, v in _RATE.items() if k not in ("m/s", "mm/s")},
    "contact_wrench": dict.fromkeys(("N", "N m", "Nm", "N·m", "N*m"), 1.0),
}
# What others call the arrays, to guess what a column may be when the contract's name is missing.
_ALIASES = {
    "time": ("t", "stamp", "timestamp", "time_s", "times", "sec", "seconds"),
    "qpos": ("q", "pos", "position", "positions", "angle", "joint_pos", "jointpos", "actual_q"),
    "qvel": ("dq", "qd", "vel", "velocity", "velocities", "joint_vel", "actual_qd"),
    "tau": ("torque", "torques", "effort", "efforts", "trq", "current", "joint_torque", "tau_j"),
}


class Column(NamedTuple):
    """Where one column of the file goes."""

    array: str
    of: str
    """Joint or body, empty where the array has none or the column holds lists."""
    part: str
    """Component: x, fx ..."""
    unit: str


class Plan(NamedTuple):
    """Which columns of a file are read, by the file's own headings, and which are not."""

    columns: Mapping[str, Column]
    others: tuple[str, ...]


def plan(headings: Sequence[str], options: Options) -> Plan:
    """Match headings with the contract's columns; `LogError` where one is ambiguous or has an unknown unit."""
    if len(headings) > _MOST_COLUMNS:
        raise LogError(f"has {len(headings)} columns; at most {_MOST_COLUMNS} make sense")
    columns: dict[str, Column] = {}
    taken: dict[tuple[str, str, str], str] = {}
    asked = _asked(headings, options)
    for heading in headings:
        name, unit = _unit_apart(heading)
        column = asked.get(heading) or _parsed(name, unit)
        if column is None:
            continue
        if (before := taken.setdefault(column[:3], heading)) != heading:
            if heading in asked and before not in asked:
                del columns[before]
            elif before in asked and heading not in asked:
                continue
            else:
                raise LogError(f"columns {before!r} and {heading!r} both are {_spelled(column)}")
            taken[column[:3]] = heading
        columns[heading] = column
    others = tuple(heading for heading in headings if heading not in columns)
    return Plan(columns, others)


def arrays(plan: Plan, values: Mapping[str, np.ndarray], names: Sequence[str] = ()) -> Contents:
    """Put columns, by heading, together into arrays; `names` are the joints of columns that hold lists.

    Joints without position or torque are left out, with a note. Raises `LogError` for what is missing.
    """
    found: dict[str, dict[tuple[str, str], str]] = {}
    for heading, column in plan.columns.items():
        if heading in values and (values[heading].dtype.kind == "U") != (column.array in _TEXTS):
            holds, right = ("numbers", "text") if column.array in _TEXTS else ("text", "numbers")
            raise LogError(f"column {heading!r} holds {holds}; expected {right}")
        if heading in values and values[heading].ndim > 1 and (column.of or column.part):
            raise LogError(f"column {heading!r} holds lists; expected one number in each row")
        found.setdefault(column.array, {})[column.of, column.part] = heading
    for array in ("time", "qpos", "tau"):
        if array not in found:
            raise LogError(_missing(array, [*plan.others, *plan.columns]))
    if not any(len(x) for x in values.values() if x.ndim):
        raise LogError("has headings and no rows; expected at least two samples")
    out: dict[str, np.ndarray] = {}
    notes: list[str] = []
    joints, left_out = _joints(found, values, names)
    if left_out:
        notes.append(f"left out, without position or without torque: {listed(left_out)}")
    units, stated = set(), False
    for array, parts in found.items():
        scaled = {key: _in_si(plan.columns[h], values[h]) for key, h in parts.items()}
        if array in _TEXTS:
            out[array] = values[parts["", ""]]
        elif array in _PER_JOINT:
            lacking = [name for name in joints if (name, "") not in parts]
            if ("", "") in parts:
                out[array] = _rows(array, scaled["", ""], len(names))
            elif lacking:
                notes.append(f"{array} is left out: there is none for {listed(lacking)}")
                continue
            else:
                out[array] = np.stack([scaled[name, ""] for name in joints], axis=-1)
            if array in _CONSTANT:
                out[array] = _constant(array, out[array])
            if array == "tau":
                units |= {plan.columns[h].unit for h in parts.values()}
            stated |= array == "qpos" and any(plan.columns[h].unit for h in parts.values())
        elif array in _BASE:
            out[array] = _components(array, "", _BASE[array], scaled)
        elif array == "contact_wrench":
            bodies = list(dict.fromkeys(body for body, _ in parts))
            wrenches = [_components(array, body, _WRENCH, scaled) for body in bodies]
            out |= {array: np.stack(wrenches, axis=1), "contact_bodies": np.array(bodies)}
        else:
            out[array] = scaled["", ""]
    out["joint_names"] = np.array(joints, dtype=np.str_)
    if unit := _one_unit(units):
        out["tau_unit"] = np.array(unit)
    return Contents(out, plan.others, notes, stated)


def headings_of(arrays: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The columns that hold a log's arrays, each (T,), or of no dimension where one value is repeated."""
    joints = arrays["joint_names"].tolist()
    bodies = arrays["contact_bodies"].tolist() if "contact_bodies" in arrays else []
    out: dict[str, np.ndarray] = {"time": arrays["time"]}
    for name in SHAPES:
        if name == "time" or name not in arrays:
            continue
        value = arrays[name]
        if name in _PER_JOINT:
            out |= {f"{name}.{joint}": value[..., k] for k, joint in enumerate(joints)}
        elif name in _BASE:
            out |= {f"{name}.{part}": value[:, k] for k, part in enumerate(_BASE[name])}
        else:
            out |= {
                f"{name}.{body}.{part}": value[:, c, k]
                for c, body in enumerate(bodies)
                for k, part in enumerate(_WRENCH)
            }
    return out | {name: arrays[name] for name in _TEXTS if name in arrays}


# --- names -------------------------------------------------------------------------------------------------------


def _unit_apart(heading: str) -> tuple[str, str]:
    """`name [unit]` or `name (unit)` in its two parts; no regular expression, which would try every blank."""
    whole = heading.strip()
    opened = max(whole.rfind("["), whole.rfind("("))
    unit = whole[opened + 1 : -1]
    if opened < 0 or whole[-1] not in "])" or "]" in unit or ")" in unit:
        return whole, ""
    return whole[:opened].rstrip(), unit.strip()


def _parsed(name: str, unit: str) -> Column | None:
    """What a name of the contract stands for, None where it is none."""
    array, _, rest = name.partition(".")
    if array in _BASE and rest in tuple(_BASE[array]):
        return Column(array, "", rest, unit)
    if array == "contact_wrench":
        body, _, part = rest.rpartition(".")
        return Column(array, body, part, unit) if body and part in _WRENCH else None
    if array in _PER_JOINT:
        return Column(array, rest, "", unit) if rest or "." not in name else None
    return Column(name, "", "", unit) if name in ("time", *_TEXTS) else None


def _asked(headings: Sequence[str], options: Options) -> dict[str, Column]:
    """The columns that the options name, by heading."""
    out: dict[str, Column] = {}
    bare = {heading: _unit_apart(heading)[0] for heading in headings}
    for target, source in options.columns.items():
        if target.count("*") != source.count("*") or target.count("*") > 1:
            raise LogError(f"column {target}={source}: both sides have one *, or none has")
        before, _, after = source.partition("*")
        hits = 0
        for heading, name in bare.items():
            wanted = target
            if "*" in source:
                inner = len(before) + len(after)
                if not (name.startswith(before) and name.endswith(after) and len(name) > inner):
                    continue
                wanted = target.replace("*", name[len(before) : len(name) - len(after)])
            elif source not in (heading, name):
                continue
            column = _parsed(wanted, _unit_apart(heading)[1])
            if column is None:
                raise LogError(
                    f"column {target}={source}: {wanted!r} is no column of a log; those are time, "
                    "qpos.<joint>, tau.<joint>, qvel.<joint> ..."
                )
            out[heading], hits = column, hits + 1
        if not hits:
            raise LogError(
                f"column {target}={source}: the file has none such; {suggestion(source, headings)}"
            )
    return out


def _spelled(column: Column) -> str:
    return ".".join(part for part in (column.array, column.of, column.part) if part)


def _missing(array: str, headings: Sequence[str]) -> str:
    """What to do about an array that no column is named after."""
    bare = [_unit_apart(heading)[0] for heading in headings[:200]]
    whole = next((name for name in bare if name.lower() in _ALIASES[array]), "")
    if array == "time":
        name, hint = "time", f"time={whole or 'NAME'}"
    elif whole:
        name, hint = array, f"{array}={whole}"
    else:
        starts = (alias + mark for alias in _ALIASES[array] for mark in "._/ -")
        found = (name[: len(s)] for s in starts for name in bare if name.lower().startswith(s))
        name, hint = f"{array}.<joint>", f"{array}.*={next(found, 'PREFIX')}*"
    return (
        f"no column {name}; name the file's with --column '{hint}'; it has {listed(headings, 12)}"
    )


def _joints(
    found: Mapping[str, Mapping[tuple[str, str], str]],
    values: Mapping[str, np.ndarray],
    names: Sequence[str],
) -> tuple[list[str], list[str]]:
    """Joints with position and torque in the order of the positions, and those that lack one."""
    lists = {array for array in _PER_JOINT if ("", "") in found.get(array, ())}
    if lists:
        single = {array for array in _PER_JOINT if array in found} - lists
        if mixed := [array for array in single if array not in _CONSTANT]:
            raise LogError(
                f"{mixed[0]} is one column a joint, {min(lists)} one of lists; use one form"
            )
        if not names:
            width = np.shape(values[found["qpos"]["", ""]])[-1] if "qpos" in lists else "?"
            raise LogError(f"columns hold lists of {width}; name their joints with --joints")
        return list(names), []
    having = {array: [of for of, _ in found[array]] for array in _PER_JOINT if array in found}
    placed, driven = set(having["qpos"]), set(having["tau"])
    for array, owners in having.items():
        for name in owners:
            if name not in placed:
                hint = suggestion(name, having["qpos"])
                raise LogError(f"{array}.{name} has no qpos.{name} beside it; {hint}")
    joints = [name for name in having["qpos"] if name in driven]
    if not joints:
        raise LogError("no joint has both a column qpos and a column tau")
    return joints, [name for name in having["qpos"] if name not in driven]


# --- values ------------------------------------------------------------------------------------------------------


def _in_si(column: Column, value: np.ndarray) -> np.ndarray:
    if not column.unit or column.array not in _UNITS:
        return value
    units = _UNITS[column.array]
    factor = units.get(column.unit, units.get(column.unit.lower()))
    if factor is None:
        raise LogError(
            f"{_spelled(column)} is in {column.unit[:40]!r}; a unit here is one of {', '.join(units)}"
        )
    return value if factor == 1.0 else value * factor


def _rows(array: str, value: np.ndarray, joints: int) -> np.ndarray:
    value = value[:, None] if value.ndim == 1 else value
    if value.shape[1] != joints:
        raise LogError(f"{array} has {value.shape[1]} values in a row for {joints} joints")
    return value


def _constant(array: str, value: np.ndarray) -> np.ndarray:
    if len(value) == 0 or not np.array_equal(value, np.broadcast_to(value[0], value.shape)):
        raise LogError(f"{array} changes over time; it is one value, repeated")
    return value[0]


def _components(
    array: str, of: str, parts: Sequence[str], values: Mapping[tuple[str, str], np.ndarray]
) -> np.ndarray:
    if missing := [part for part in parts if (of, part) not in values]:
        owner = f"{array}.{of}" if of else array
        raise LogError(f"{owner}.{missing[0]} is missing; {owner} has {', '.join(parts)}")
    return np.stack([values[of, part] for part in parts], axis=-1)


def _one_unit(units: set[str]) -> str:
    """The unit of all torque columns; a force on a slide joint is in N beside torques in N m."""
    # Only units that say N m are alike; what is in amperes here and N m there has no one gain.
    given = {unit for unit in units if unit}
    if given and "" in units:
        raise LogError(f"some columns of tau have a unit ({listed(sorted(given))}), some none")
    if given <= {"N", "N m", "Nm", "N·m", "N*m"}:
        return "N m" if given else ""
    if len(given) > 1:
        raise LogError(f"columns of tau are in different units: {listed(sorted(given))}")
    return given.pop()
