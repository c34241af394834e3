"""Messages of ros2_control in CDR: what controllers were asked for, and states by interface.

Definitions of these types changed between ROS releases, by what comes after the fields that are read here. So their
beginnings are read, field by field (OMG DDS-XTypes, plain CDR: numbers aligned to their size from after the header of
four bytes), where a whole definition would refuse the other releases' messages.
"""

import struct
from types import SimpleNamespace

import numpy as np

from jax_inertia.logs.npz import LogError

CONTROLLER = "control_msgs/msg/JointTrajectoryControllerState"
DYNAMIC = "control_msgs/msg/DynamicJointState"
TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
ARRAY = "std_msgs/msg/Float64MultiArray"
_MOST = 10_000
NO_TIME = SimpleNamespace(stamp=SimpleNamespace(sec=0, nanosec=0))


class Cdr:
    """Fields one after the other out of a message in CDR."""

    def __init__(self, data: bytes) -> None:
        if len(data) < 4 or data[1] not in (0, 1):
            raise LogError("not plain CDR")
        self._data, self._at = memoryview(data)[4:], 0
        self._order = "<" if data[1] else ">"

    def _number(self, code: str, size: int) -> float | int:
        self._at += -self._at % size
        (value,) = struct.unpack_from(self._order + code, self._data, self._at)
        self._at += size
        return value

    def whole(self, signed: bool = False) -> int:
        return int(self._number("i" if signed else "I", 4))

    def count(self) -> int:
        count = self.whole()
        if count > _MOST:
            raise LogError(f"a list of {count} entries; at most {_MOST} make sense")
        return count

    def text(self) -> str:
        size = self.whole()
        raw = bytes(self._data[self._at : self._at + size])
        if size == 0 or len(raw) != size:
            raise LogError("a text that is cut off")
        self._at += size
        return raw[:-1].decode("utf-8", "replace")

    def texts(self) -> list[str]:
        return [self.text() for _ in range(self.count())]

    def numbers(self) -> np.ndarray:
        count = self.count()
        return self.doubles(count) if count else np.zeros(0)

    def doubles(self, count: int) -> np.ndarray:
        """So many numbers, whose count the message does not tell."""
        self._at += -self._at % 8
        out = np.frombuffer(self._data, self._order + "f8", count, self._at).astype(float)
        self._at += 8 * count
        return out

    def joint_state(self) -> SimpleNamespace:
        """sensor_msgs/JointState."""
        header, names = self.header(), self.texts()
        return like(header, names, *(self.numbers() for _ in range(3)))

    def header(self) -> SimpleNamespace:
        sec, nanosec = self.whole(signed=True), self.whole()
        self.text()
        return SimpleNamespace(stamp=SimpleNamespace(sec=sec, nanosec=nanosec))

    def point(self) -> SimpleNamespace:
        """trajectory_msgs/JointTrajectoryPoint."""
        position, velocity, _, effort = (self.numbers() for _ in range(4))
        for _ in range(2):
            self.whole()
        return SimpleNamespace(position=position, velocity=velocity, effort=effort)


def decoded(kind: str, data: bytes) -> tuple[SimpleNamespace | None, SimpleNamespace | None]:
    """State and target in one message, each like a sensor_msgs/JointState, or None.

    An array has no names: `name` is empty. Raises LogError for what is cut off, and for a trajectory of several points.
    """
    cdr = Cdr(data)
    try:
        if kind == ARRAY:
            for _ in range(cdr.count()):
                cdr.text()
                cdr.whole()
                cdr.whole()
            cdr.whole()
            return None, like(NO_TIME, [], cdr.numbers())
        header = cdr.header()
        names = cdr.texts()
        if kind == DYNAMIC:
            return _dynamic(cdr, header, names), None
        if kind == TRAJECTORY:
            if (points := cdr.count()) != 1:
                raise LogError(
                    f"a trajectory of {points} points: the target in between is in the controller's state "
                    "(control_msgs/JointTrajectoryControllerState); record that"
                )
            return None, like(header, names, cdr.point().position)
        wanted, measured = cdr.point(), cdr.point()
        state = like(header, names, measured.position, measured.velocity, measured.effort)
        return state, like(header, names, wanted.position)
    except (struct.error, ValueError) as error:
        if isinstance(error, LogError):
            raise
        raise LogError(f"cut off or of another type ({error})") from None


def _dynamic(cdr: Cdr, header: SimpleNamespace, names: list[str]) -> SimpleNamespace:
    """Positions, velocities and efforts by the names of their interfaces; NaN where a joint has none."""
    table = {field: np.full(len(names), np.nan) for field in ("position", "velocity", "effort")}
    for k in range(cdr.count()):
        for interface, value in zip(cdr.texts(), cdr.numbers(), strict=True):
            if interface in table and k < len(names):
                table[interface][k] = value
    given = [x if np.isfinite(x).any() else np.zeros(0) for x in table.values()]
    return like(header, names, *given)


def like(
    header: SimpleNamespace,
    names: list[str],
    position: np.ndarray,
    velocity: np.ndarray | None = None,
    effort: np.ndarray | None = None,
) -> SimpleNamespace:
    """What has the fields of sensor_msgs/JointState."""
    empty = np.zeros(0)
    return SimpleNamespace(
        header=header,
        name=names,
        position=position,
        velocity=empty if velocity is None else velocity,
        effort=empty if effort is None else effort,
    )
