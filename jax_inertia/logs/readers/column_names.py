"""What columns of a table may be, by words that people use: one command that names all of them."""

import itertools
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

from jax_inertia.logs.readers.column_plan import unit_apart
from jax_inertia.text.closest_names import listed

_MOST, _LONGEST = 400, 80
# What others call the arrays.
_TIME = (
    *("t", "time", "stamp", "timestamp", "time_s", "t_s", "times", "sec", "seconds", "ros_time", "zeit"),
    *("__time", "datetime", "date", "stamp_ns", "timestamp_ns", "time_ns", "timestamp_ms", "time_ms", "timestamp_us"),
)  # fmt: skip
_WORDS: Mapping[str, tuple[str, ...]] = {
    "qpos": (
        *("q", "qpos", "pos", "position", "positions", "angle", "angles", "theta", "th", "encoder"),
        *("joint", "axis"),
    ),
    "tau": (
        *("tau", "torque", "torques", "trq", "effort", "efforts", "eff", "moment", "load"),
        *("current", "currents", "amps", "i", "iq", "cur"),
    ),
    "qvel": ("qvel", "dq", "qd", "qdot", "vel", "velocity", "velocities", "speed", "speeds", "omega"),
}  # fmt: skip
_CURRENTS = ("current", "currents", "amps", "i", "iq", "cur")
# Of positions where nothing else of the heading says what it is.
_BARE = ("joint", "axis")
_ASKED = (
    "target",
    "d",
    "cmd",
    "command",
    "commanded",
    "des",
    "desired",
    "ref",
    "reference",
    "goal",
    "setpoint",
    "action",
)
# Words that say nothing more of what a column holds.
_MORE = (
    *("actual", "act", "measured", "meas", "present", "state", "states", "observation", "feedback", "fb", "filtered"),
    *("raw", "value", "val", "estimate", "estimated", "est", "msr", "sensor", "joints", "motor", "j", "link", "out"),
    *("control", "field", *_BARE),
)  # fmt: skip


_WORD = re.compile(r"[A-Za-z]+?(?=[A-Z][a-z]|[^A-Za-z]|$)|\d+")


class _Pattern(NamedTuple):
    """Headings of one form, and what stands for the joint in each."""

    before: str
    after: str
    rank: int
    """Place of its word in the list: the first are the most usual."""
    joints: tuple[str, ...]
    current: bool

    def __str__(self) -> str:
        return f"{self.before}*{self.after}"


def suggested(lacking: Sequence[str], headings: Sequence[str], lists: bool = False) -> str:
    """What to do about arrays (`time`, `qpos`, `tau` ...) that no columns are named after, in one line.

    `lists`: a column holds an array of all joints.

    >>> from jax_inertia.logs.readers.column_names import suggested
    >>> line = suggested(("time", "qpos", "tau"), ("t", "J1_pos", "J2_pos", "J1_cur", "J2_cur"))
    >>> line[line.index("convert") : line.index(")")]
    "convert IN OUT --column 'time=t' --column 'qpos.*=*_pos' --column 'tau.*=*_cur' --tau-unit A"
    """
    bare = [unit_apart(heading)[0][:_LONGEST] for heading in headings[:_MOST]]
    positions = _best("qpos", bare) if "qpos" in lacking else None
    joints = positions.joints if positions else ()
    measured = _best("tau", bare, joints)
    found = {
        "qpos": positions,
        "tau": measured or _best("tau", bare, joints, asked=True),
        "qvel": _best("qvel", bare, joints),
        "qpos_target": _best("qpos", bare, joints, asked=True),
    }
    if found["tau"] is None and found["qpos_target"] is not None:
        # A robot that is sent positions needs no torque.
        lacking = [array for array in lacking if array != "tau"]
    ways = []
    for array in [*lacking, *(x for x in found if x not in lacking and "qpos" in lacking)]:
        words = _TIME if array == "time" else _ASKED if array == "qpos_target" else _WORDS[array]
        whole = next((x for word in words for x in bare if _last(x) == word), "")
        if array == "time":
            ways.append(f"time={whole or 'NAME'}")
        elif whole and (lists or not found[array]):
            ways.append(f"{array}={whole}")
        elif array in lacking or (found[array] and not lists):
            ways.append(f"{array}.*={found[array] or 'PREFIX*'}")
    text = " ".join(f"--column '{way}'" for way in ways)
    text += " --joints NAMES" * lists
    if "tau" in lacking and found["tau"] is not None:
        text += " --tau-unit A" * found["tau"].current
        text += " --tau-kind commanded" * (measured is None)
    unstamped = "; where it has no stamps: --rate HZ" * ("time=NAME" in ways)
    names = ", ".join("time" if array == "time" else f"{array}.<joint>" for array in lacking)
    way = f"name the file's (jax-inertia convert IN OUT {text})"
    return f"no column {names}; {way}; it has {listed(headings, 12)}{unstamped}"


def _last(heading: str) -> str:
    """The last part of a path, in small letters."""
    return heading.lower().rpartition("/")[2]


def _best(
    array: str, headings: Sequence[str], joints: Sequence[str] = (), asked: bool = False
) -> _Pattern | None:
    """The form of headings that most joints have, of `joints` where there are any; then the most usual word."""
    found: dict[tuple[str, str, int, bool], list[str]] = {}
    for heading in headings:
        for before, joint, after, rank, current in _forms(array, heading, asked):
            found.setdefault((before, after, rank, current), []).append(joint)
    patterns = []
    for (before, after, rank, current), own in found.items():
        shared = _shared(own)
        folder = shared[: max(shared.rfind("/"), shared.rfind(".")) + 1]
        before, own = before + folder, [x[len(folder) :] for x in own]
        patterns.append(_Pattern(before, after, rank, tuple(own), current))
        # Of J1, J2 ... the numbers alone may be what other columns have.
        if start := _shared(own):
            rest = tuple(x[len(start) :] for x in own)
            if all(rest):
                patterns.append(_Pattern(before + start, after, rank, rest, current))

    def fits(one: _Pattern) -> tuple[int, int, int]:
        shared = len(set(one.joints) & set(joints)) if joints else len(one.joints)
        return shared, -one.rank, -len(one.before)

    best = max(patterns, key=fits, default=None)
    return None if best is None or fits(best)[0] == 0 else best


def _shared(names: Sequence[str]) -> str:
    """What several names begin with."""
    if len(names) < 2:
        return ""
    alike = itertools.takewhile(lambda x: len(set(x)) == 1, zip(*names, strict=False))
    return "".join(x[0] for x in alike)


def _forms(array: str, heading: str, asked: bool) -> Iterator[tuple[str, str, str, int, bool]]:
    """(before, joint, after, rank of the word, whether it is a current) for each way to read a heading."""
    words = [
        (m[0].lower(), m.start(), m.end())
        for m in re.finditer(r"[A-Za-z]+?(?=[A-Z][a-z]|[^A-Za-z]|$)|\d+", heading)
    ]
    said = [word in _ASKED for word, _, _ in words]
    if len(words) < 2 or any(said) != asked:
        return
    own = _WORDS[array]
    plain = [word in own or word in _MORE or word in _ASKED for word, _, _ in words]
    others = {word for of, every in _WORDS.items() for word in every if of != array} - set(_BARE)
    named = {word for word, _, _ in words} & ((others | set(own)) - set(_BARE))
    for k, (word, _, _) in enumerate(words):
        if word not in own or (word in _BARE and named):
            continue
        first, last = k, k
        while first > 0 and plain[first - 1]:
            first -= 1
        while last + 1 < len(words) and plain[last + 1]:
            last += 1
        rank, current = own.index(word), word in _CURRENTS
        if first == 0 and last + 1 < len(words):
            at = words[last + 1][1]
            yield heading[:at], heading[at:], "", rank, current
        if last == len(words) - 1 and first > 0:
            at = words[first - 1][2]
            yield "", heading[:at], heading[at:], rank, current
