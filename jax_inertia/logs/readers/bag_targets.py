"""Position targets in a bag: which topic has them, and what was asked for at each joint state."""

import re

import numpy as np

from jax_inertia.logs.npz import LogError
from jax_inertia.logs.readers.streams import Rows, Stream
from jax_inertia.text.closest_names import listed, suggestion

_COMMAND = re.compile(r"command|cmd|target|desired|reference|goal|setpoint", re.IGNORECASE)
_MOST_TOPICS = 50


def is_named_command(topic: str) -> bool:
    """Whether a topic's name says that what comes on it was asked for, not measured."""
    return _COMMAND.search(topic) is not None


class Targets:
    """The targets taken so far, by topic; arrays have no names."""

    def __init__(self, asked: str | None) -> None:
        self.asked = asked
        self.rows: dict[str, tuple[tuple[str, ...], Rows]] = {}

    def place(self, topic: str, names: tuple[str, ...], size: int) -> Rows:
        """Where a topic's rows go; `LogError` where its messages change their joints."""
        known, rows = self.rows.setdefault(topic, (names, Rows()))
        if len(self.rows) > _MOST_TOPICS:
            raise LogError(f"targets come on more than {_MOST_TOPICS} topics")
        if known != names or (names and len(names) != size):
            raise LogError(
                f"targets on {topic} name other joints, or another number, from message to message"
            )
        return rows

    def chosen(self, joints: list[str]) -> str | None:
        """The topic to use: as asked, else the only one that is of these joints; None where there is none.

        Raises `LogError` for one that is not there, and where several would do.
        """
        if self.asked is not None:
            if self.asked not in self.rows:
                hint = suggestion(self.asked, list(self.rows)) if self.rows else "the bag has none"
                raise LogError(f"no targets on topic {self.asked!r}; {hint}")
            return self.asked
        fitting = [
            topic for topic, (names, rows) in self.rows.items() if self._fits(names, rows, joints)
        ]
        if len(fitting) > 1:
            raise LogError(
                f"targets come on several topics, {listed(fitting)}; choose with --topic-targets"
            )
        return fitting[0] if fitting else None

    @staticmethod
    def _fits(names: tuple[str, ...], rows: Rows, joints: list[str]) -> bool:
        return set(joints) <= set(names) if names else rows.width == len(joints)

    def at(self, topic: str, joints: list[str], time_ns: np.ndarray) -> tuple[np.ndarray, str]:
        """The targets (T, n) that hold at the stamps, NaN before the first one, and a note."""
        names, rows = self.rows[topic]
        stream = rows.stream(f"targets on {topic}")
        if names:
            if lacking := [joint for joint in joints if joint not in names]:
                raise LogError(f"the targets on {topic} are not of {listed(lacking)}")
            stream = Stream(stream.time_ns, stream.values[:, [names.index(j) for j in joints]])
        elif stream.values.shape[1] != len(joints):
            raise LogError(
                f"the targets on {topic} are {stream.values.shape[1]} numbers, of {len(joints)} joints "
                f"({listed(joints)}); name theirs in order with --joints"
            )
        index = np.searchsorted(stream.time_ns, time_ns, side="right") - 1
        out = np.where(index[:, None] >= 0, stream.values[np.maximum(index, 0)], np.nan)
        if not np.isfinite(out).any():
            raise LogError(f"targets on {topic} do not overlap in time with the joint states")
        note = f"targets are those of {topic}, each held until the next comes"
        return out, note + f"; they are taken in the order {', '.join(joints)}" * (not names)
