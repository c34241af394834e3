"""Which column of a table is which: names of the log contract, as options or headings say them."""

import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from jax_inertia.logs.npz import LogError
from jax_inertia.logs.readers.options import Options
from jax_inertia.logs.schema import SHAPES
from jax_inertia.text.closest_names import suggestion

PER_JOINT = tuple(name for name, shape in SHAPES.items() if shape[-1] == "n")
BASE = {
    "base_pos": "xyz",
    "base_quat": "wxyz",
    "base_linvel": "xyz",
    "base_angvel": "xyz",
    "base_linacc": "xyz",
    "imu_pos": "xyz",
}
WRENCH = ("fx", "fy", "fz", "mx", "my", "mz")
OF_FOOT = ("contact_force", "contact_flag")
UNIT_TEXTS = ("imu_body", "tau_unit", "tau_kind")
_MOST_COLUMNS = 10_000


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
        name, unit = unit_apart(heading)
        column = asked.get(heading) or _parsed(name, unit)
        if column is None:
            continue
        if (before := taken.setdefault(column[:3], heading)) != heading:
            if _together(column, options, before, heading):
                columns[heading] = column
                continue
            if heading in asked and before not in asked:
                del columns[before]
            elif before in asked and heading not in asked:
                continue
            else:
                raise LogError(f"columns {before!r} and {heading!r} both are {spelled(column)}")
            taken[column[:3]] = heading
        columns[heading] = column
    others = tuple(heading for heading in headings if heading not in columns)
    return Plan(columns, others)


def unit_apart(heading: str) -> tuple[str, str]:
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
    if array in BASE and rest in tuple(BASE[array]):
        return Column(array, "", rest, unit)
    if array == "contact_wrench":
        body, _, part = rest.rpartition(".")
        return Column(array, body, part, unit) if body and part in WRENCH else None
    if array in OF_FOOT:
        return Column(array, rest, "", unit) if rest else None
    if array in PER_JOINT:
        return Column(array, rest, "", unit) if rest or "." not in name else None
    return Column(name, "", "", unit) if name in ("time", *UNIT_TEXTS) else None


def _asked(headings: Sequence[str], options: Options) -> dict[str, Column]:
    """The columns that the options name, by heading."""
    out: dict[str, Column] = {}
    starred: set[str] = set()
    bare = {heading: unit_apart(heading)[0] for heading in headings}
    pairs = [
        (target, source)
        for target, given in options.columns.items()
        for source in ((given,) if isinstance(given, str) else given)
    ]
    # What says more of a heading counts.
    for target, source in sorted(pairs, key=lambda pair: len(pair[1])):
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
            column = _parsed(wanted, unit_apart(heading)[1])
            if column is None:
                raise LogError(
                    f"column {target}={source}: {wanted!r} is no column of a log; those are time, "
                    "qpos.<joint>, tau.<joint>, qvel.<joint> ..."
                )
            out[heading], hits = column, hits + 1
            if "*" in source:
                starred.add(heading)
        if not hits:
            raise LogError(
                f"column {target}={source}: the file has none such; {suggestion(source, headings)}"
            )
    return _of_joints(out, starred)


def _of_joints(columns: dict[str, Column], starred: set[str]) -> dict[str, Column]:
    """Columns without those that a star hits besides: of what has no position, where others of its array have one."""
    placed = {column.of for column in columns.values() if column.array == "qpos"}
    having = {column.array for column in columns.values() if column.of in placed}
    return {
        heading: column
        for heading, column in columns.items()
        if heading not in starred or column.of in placed or column.array not in having
    }


def _together(column: Column, options: Options, *headings: str) -> bool:
    """Whether columns of lists are asked for as parts of one array."""
    given = options.columns.get(column.array, "")
    whole = column.array in PER_JOINT and not column.of
    return whole and not isinstance(given, str) and set(headings) <= set(given)


def is_current(heading: str) -> bool:
    """Whether a torque's column is named after a current; as an adjective of another quantity it is none."""
    words = re.split(r"[^a-z]+", heading[:200].lower())
    other = ("torque", "effort", "tau", "force", "load", "pwm")
    return any(w in ("current", "currents", "amps", "ampere") for w in words) and not any(
        word in other for word in words
    )


def spelled(column: Column) -> str:
    return ".".join(part for part in (column.array, column.of, column.part) if part)
