"""Tables to the arrays of the log contract: columns by name, units from their headings.

A column is named after the array and what it belongs to:

    time                                       s
    qpos.<joint>  qvel.<joint>  tau.<joint>    rad, rad/s, N m (on slides m, m/s, N)
    tau_command.<joint>  qpos_target.<joint>  qvel_target.<joint>
    sigma_qpos.<joint>  sigma_tau.<joint>      one value, repeated
    kp.<joint>  kd.<joint>                     of the position loop, one value, repeated
    base_pos.{x,y,z}  base_quat.{w,x,y,z}  base_linvel.{x,y,z}  base_angvel.{x,y,z}
    base_linacc.{x,y,z}  imu_pos.{x,y,z}       of an IMU, m/s² and (one value, repeated) m
    contact_wrench.<body>.{fx,fy,fz,mx,my,mz}
    contact_force.<body>  contact_flag.<body>
    imu_body  tau_unit  tau_kind               text, repeated

A heading may end in a unit, `qpos.elbow [deg]`, which is then converted. A column of lists holds a whole array:
`qpos` with one entry a joint.
"""

from collections.abc import Collection, Mapping, Sequence

import numpy as np

from jax_inertia.logs.npz import LogError
from jax_inertia.logs.readers import stamps
from jax_inertia.logs.readers.column_names import suggested
from jax_inertia.logs.readers.column_plan import (
    BASE,
    OF_FOOT,
    PER_JOINT,
    UNIT_TEXTS,
    WRENCH,
    Column,
    Plan,
    is_current,
    spelled,
)
from jax_inertia.logs.readers.options import Contents
from jax_inertia.logs.schema import SHAPES
from jax_inertia.text.closest_names import listed, suggestion

_FASTEST = 1e6  # Hz: a decision, beyond any log of joints
_CONSTANT = tuple(name for name, shape in SHAPES.items() if shape[0] != "T")
_ANGLE = {"rad": 1.0, "deg": np.pi / 180, "°": np.pi / 180, "m": 1.0, "mm": 1e-3}
_ANGLE |= dict.fromkeys(("rev", "turn", "turns"), 2 * np.pi)
_RATE = {f"{unit}/s": factor for unit, factor in _ANGLE.items()} | {"rpm": np.pi / 30}
_LENGTH = {"m": 1.0, "mm": 1e-3}
_UNITS: Mapping[str, Mapping[str, float]] = {
    "time": stamps.UNITS,
    "qpos": _ANGLE,
    "qpos_target": _ANGLE,
    "sigma_qpos": _ANGLE,
    "qvel": _RATE,
    "qvel_target": _RATE,
    "base_pos": _LENGTH,
    "base_quat": {"1": 1.0, "-": 1.0},
    "base_linvel": {f"{unit}/s": factor for unit, factor in _LENGTH.items()},
    "base_angvel": {k: v for k, v in _RATE.items() if k not in ("m/s", "mm/s")},
    "base_linacc": dict.fromkeys(("m/s²", "m/s^2", "m/s2", "m s⁻²"), 1.0) | {"g": 9.80665},
    "imu_pos": _LENGTH,
    "contact_wrench": dict.fromkeys(("N", "N m", "Nm", "N·m", "N*m"), 1.0),
}


def arrays(
    plan: Plan,
    values: Mapping[str, np.ndarray],
    names: Sequence[str] = (),
    rate: float | None = None,
) -> Contents:
    """Put columns, by heading, together into arrays; `names` are the joints of columns that hold lists.

    `rate` [Hz] stands for stamps, where there are none. Joints without position or torque are left out, with a note.
    Raises `LogError` for what is missing.
    """
    if rate is not None:
        plan, values = _timed(plan, values, rate)
    found = _found(plan, values)
    out: dict[str, np.ndarray] = {}
    notes: list[str] = []
    joints, left_out = _joints(found, values, names)
    if left_out:
        driven = "torque" if "tau" in found else "target"
        notes.append(f"left out, without position or without {driven}: {listed(left_out)}")
    for array, parts in found.items():
        scaled = {key: _in_si(plan.columns[h], values[h]) for key, h in parts.items()}
        if array in PER_JOINT:
            lacking = [name for name in joints if (name, "") not in parts]
            if lacking and ("", "") not in parts:
                notes.append(f"{array} is left out: there is none for {listed(lacking)}")
            else:
                out[array] = _by_joint(array, scaled, joints)
        elif array in BASE:
            whole = _components(array, "", BASE[array], scaled)
            out[array] = _constant(array, whole) if array in _CONSTANT else whole
        elif array == "contact_wrench" or array in OF_FOOT:
            out |= _at_contacts(array, scaled, out.get("contact_bodies"))
        else:
            out[array] = scaled["", ""]
    out["joint_names"] = np.array(joints, dtype=np.str_)
    meaning, note = _torque_meaning(plan, found.get("tau", {}).values(), out)
    stated = any(plan.columns[h].unit for h in found["qpos"].values())
    timed = bool(plan.columns[found["time"]["", ""]].unit)
    return Contents(out | meaning, plan.others, notes + note, stated, timed)


def _timed(
    plan: Plan, values: Mapping[str, np.ndarray], rate: float
) -> tuple[Plan, dict[str, np.ndarray]]:
    """The columns with one of stamps."""
    if any(column.array == "time" for column in plan.columns.values()):
        raise LogError("the file has stamps of its own; leave out rate")
    if not 0 < rate < _FASTEST:
        raise LogError(f"a rate of {rate:g} Hz; expected samples a second")
    rows = max((len(x) for x in values.values() if x.ndim), default=0)
    stamps = {"samples at a rate": np.arange(rows) / rate}
    columns = dict.fromkeys(stamps, Column("time", "", "", "s"))
    return plan._replace(columns={**plan.columns, **columns}), {**values, **stamps}


def _at_contacts(
    array: str, values: Mapping[tuple[str, str], np.ndarray], before: np.ndarray | None
) -> dict[str, np.ndarray]:
    """(T, C, 6) or (T, C) of what is measured where the robot touches something, and the bodies it is measured at."""
    own = list(dict.fromkeys(body for body, _ in values))
    bodies = own if before is None else before.tolist()
    if set(own) != set(bodies):
        raise LogError(f"{array} is of {listed(own)}, other contacts are of {listed(bodies)}")
    if array == "contact_wrench":
        parts = [_components(array, body, WRENCH, values) for body in bodies]
    else:
        parts = [values[body, ""] for body in bodies]
    return {array: np.stack(parts, axis=1), "contact_bodies": np.array(bodies)}


def spread(
    plan: Plan, values: Mapping[str, np.ndarray], names: Mapping[str, Sequence[str]]
) -> tuple[Plan, dict[str, np.ndarray]]:
    """Columns of lists as one column a joint, where `names` has as many joints for a heading as its lists have entries.

    Joints of an array are then found by name, whatever the order; names of which no position has any go by the
    positions' order.
    """
    wide = {
        heading: column
        for heading, column in plan.columns.items()
        if column.array in PER_JOINT and not column.of and values[heading].ndim in (1, 2)
    }
    placed = [name for h, c in wide.items() if c.array == "qpos" for name in names.get(h, ())]
    columns, out = dict(plan.columns), dict(values)
    for heading, column in wide.items():
        rows = values[heading]
        joints = list(names.get(heading, ()))
        width = 1 if rows.ndim == 1 else rows.shape[1]
        if not set(joints) & set(placed) and width == len(placed):
            joints = placed
        if width != len(joints) or len(set(joints)) != len(joints):
            return plan, dict(values)
        del columns[heading], out[heading]
        rows = rows.reshape(len(rows), width)
        for k, joint in enumerate(joints):
            columns[f"{heading}[{k}]"] = column._replace(of=joint)
            out[f"{heading}[{k}]"] = rows[:, k]
    return plan._replace(columns=columns), out


def headings_of(arrays: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The columns that hold a log's arrays, each (T,), or of no dimension where one value is repeated."""
    joints = arrays["joint_names"].tolist()
    bodies = arrays["contact_bodies"].tolist() if "contact_bodies" in arrays else []
    out: dict[str, np.ndarray] = {"time": arrays["time"]}
    for name in SHAPES:
        if name == "time" or name not in arrays:
            continue
        value = arrays[name]
        if name in PER_JOINT:
            out |= {f"{name}.{joint}": value[..., k] for k, joint in enumerate(joints)}
        elif name in BASE:
            out |= {f"{name}.{part}": value[..., k] for k, part in enumerate(BASE[name])}
        elif name in OF_FOOT:
            out |= {f"{name}.{body}": value[:, c] for c, body in enumerate(bodies)}
        else:
            out |= {
                f"{name}.{body}.{part}": value[:, c, k]
                for c, body in enumerate(bodies)
                for k, part in enumerate(WRENCH)
            }
    return out | {name: arrays[name] for name in UNIT_TEXTS if name in arrays}


def _found(plan: Plan, values: Mapping[str, np.ndarray]) -> dict[str, dict[tuple[str, str], str]]:
    """Headings by array, and by owner and component; raises `LogError` where these make no log."""
    found: dict[str, dict[tuple[str, str], str]] = {}
    for heading, column in plan.columns.items():
        if heading in values:
            _check_form(heading, column, values[heading])
        parts = found.setdefault(column.array, {})
        if (before := parts.setdefault((column.of, column.part), heading)) != heading:
            raise LogError(
                f"columns {before!r} and {heading!r} both are {spelled(column)}, and nothing names their joints"
            )
    # A position-controlled robot may have no torque, nor one with a force sensor at its wrist.
    driven = {"tau", "qpos_target", "contact_wrench"} & found.keys()
    needed = ("time", "qpos", *(() if driven else ("tau",)))
    if lacking := [array for array in needed if array not in found]:
        raise LogError(suggested(lacking, [*plan.others, *plan.columns]))
    if not any(len(x) for x in values.values() if x.ndim):
        raise LogError("has headings and no rows; expected at least two samples")
    return found


def _check_form(heading: str, column: Column, value: np.ndarray) -> None:
    """Raise `LogError` for text among numbers, numbers for text, and lists for one number."""
    text = column.array in UNIT_TEXTS
    if (value.dtype.kind == "U") != text:
        holds, right = ("numbers", "text") if text else ("text", "numbers")
        raise LogError(f"column {heading!r} holds {holds}; expected {right}")
    if value.ndim > 1 and (column.of or column.part):
        raise LogError(f"column {heading!r} holds lists; expected one number in each row")


def _joints(
    found: Mapping[str, Mapping[tuple[str, str], str]],
    values: Mapping[str, np.ndarray],
    names: Sequence[str],
) -> tuple[list[str], list[str]]:
    """Joints with position and torque in the order of the positions, and those that lack one."""
    lists = {array for array in PER_JOINT if ("", "") in found.get(array, ())}
    if lists:
        single = {array for array in PER_JOINT if array in found} - lists
        if mixed := [array for array in single if array not in _CONSTANT]:
            raise LogError(
                f"{mixed[0]} is one column a joint, {min(lists)} one of lists; use one form"
            )
        if not names:
            width = np.shape(values[found["qpos"]["", ""]])[-1] if "qpos" in lists else "?"
            raise LogError(f"columns hold lists of {width}; name their joints with --joints")
        return list(names), []
    having = {array: [of for of, _ in found[array]] for array in PER_JOINT if array in found}
    drive = next((name for name in ("tau", "qpos_target") if name in having), "qpos")
    placed, driven = set(having["qpos"]), set(having[drive])
    for array, owners in having.items():
        for name in owners:
            if name not in placed:
                hint = suggestion(name, having["qpos"])
                raise LogError(f"{array}.{name} has no qpos.{name} with it; {hint}")
    joints = [name for name in having["qpos"] if name in driven]
    if not joints:
        raise LogError(f"no joint has both a column qpos and a column {drive}")
    return joints, [name for name in having["qpos"] if name not in driven]


# --- values ------------------------------------------------------------------------------------------------------


def _in_si(column: Column, value: np.ndarray) -> np.ndarray:
    if not column.unit or column.array not in _UNITS:
        return value
    units = _UNITS[column.array]
    factor = units.get(column.unit, units.get(column.unit.lower()))
    if factor is None:
        raise LogError(
            f"{spelled(column)} is in {column.unit[:40]!r}; a unit here is one of {', '.join(units)}"
        )
    return value if factor == 1.0 else value * factor


def _by_joint(
    array: str, columns: Mapping[tuple[str, str], np.ndarray], joints: Sequence[str]
) -> np.ndarray:
    """(T, joints), or (joints,) where one value is repeated; of a column of lists or one a joint."""
    if ("", "") in columns:
        value = _rows(array, columns["", ""], len(joints))
    else:
        value = np.stack([columns[name, ""] for name in joints], axis=-1)
    return _constant(array, value) if array in _CONSTANT else value


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


def _torque_meaning(
    plan: Plan, headings: Collection[str], given: Collection[str]
) -> tuple[dict[str, np.ndarray], list[str]]:
    """`tau_unit` and `tau_kind` as the headings of tau tell them, with notes.

    A unit in a heading goes before a column `tau_unit`; a heading that says current goes after those `given`.
    """
    out: dict[str, np.ndarray] = {}
    notes: list[str] = []
    if unit := _one_unit({plan.columns[h].unit for h in headings}):
        out["tau_unit"] = np.array(unit)
    if current := next((h for h in headings if is_current(h)), ""):
        if "tau_kind" not in given:
            out["tau_kind"] = np.array("current")
        if "tau_unit" not in given and not unit:
            out["tau_unit"] = np.array("unknown (a current)")
            notes.append(
                f"{current.partition('[')[0][:60]!r} holds currents, not N m; --tau-unit says in what unit"
            )
    return out, notes


def _one_unit(units: set[str]) -> str:
    """The unit of all torque columns; a force on a slide joint is in N among torques in N m."""
    # Only units that say N m are alike; what is in amperes here and N m there has no one gain.
    given = {unit for unit in units if unit}
    if given and "" in units:
        raise LogError(f"some columns of tau have a unit ({listed(sorted(given))}), some none")
    if given <= {"N", "N m", "Nm", "N·m", "N*m"}:
        return "N m" if given else ""
    if len(given) > 1:
        raise LogError(f"columns of tau are in different units: {listed(sorted(given))}")
    return given.pop()
