"""States and commands of robots' own drivers, which name no joints: Unitree's motors, and Franka's arm.

Messages whose fields are all of one size have each number at one place. What is read of the others stands at their
beginning (OMG DDS-XTypes, plain CDR: numbers are aligned to their size; ROS 1 aligns nothing).
"""

import functools
import struct
from collections.abc import Sequence
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np

from jax_inertia.logs.npz import LogError
from jax_inertia.logs.readers.messages.control import NO_TIME, Cdr, like

GO2 = tuple(
    f"{leg}_{part}_joint" for leg in ("FR", "FL", "RR", "RL") for part in ("hip", "thigh", "calf")
)
"""Unitree's motors 0 to 11 of four-legged robots (its developer pages, joint sequence number)."""
_FRANKA = "franka_msgs/msg/FrankaState"
_FRANKA_2 = "franka_msgs/msg/FrankaRobotState"
_PANDA = tuple(f"panda_joint{k}" for k in range(1, 8))


class _Motors(NamedTuple):
    """A message of so many motors: fields before them, of an IMU, and of one motor; codes as `struct` has them."""

    before: str
    imu: str
    motor: str
    motors: int
    after: str
    fields: tuple[int, ...]
    """Places of position, velocity and effort, or of the target, among a motor's fields."""
    names: tuple[str, ...] = ()


# unitree_ros2: cyclonedds_ws/src/unitree, packages unitree_go and unitree_hg. What comes after is not read.
_MOTORS = {
    "unitree_go/msg/LowState": _Motors("BBBBIIIIH", "13fb", "B7fbIII", 20, "", (1, 2, 4), GO2),
    "unitree_hg/msg/LowState": _Motors("IIBBI", "13fh", "B4fhhf7I", 35, "", (1, 2, 4)),
    "unitree_go/msg/LowCmd": _Motors("BBBBIIIIH", "", "B5fIII", 20, "", (1,), GO2),
    "unitree_hg/msg/LowCmd": _Motors("BB", "", "B5fI", 35, "IIIII", (1,)),
}
KINDS = (*_MOTORS, _FRANKA, _FRANKA_2)
"""Types that are known, as ROS 2 spells them."""
COMMANDS = tuple(kind for kind, one in _MOTORS.items() if len(one.fields) == 1)


NO_HEADER = SimpleNamespace(stamp=NO_TIME.stamp, frame_id="")


class Found(NamedTuple):
    """What one message holds: like sensor_msgs/JointState each, and of an IMU (wxyz, rad/s, m/s²)."""

    state: SimpleNamespace | None
    target: SimpleNamespace | None
    imu: np.ndarray | None = None


def decoded(kind: str, encoding: str, data: bytes, joints: Sequence[str]) -> Found:
    """The content of one message; `joints` names its motors in order.

    Raises LogError for what is cut off or of another version, and where nobody names the motors.
    """
    try:
        if kind == _FRANKA_2:
            return _franka_2(data)
        if kind == _FRANKA:
            return _franka(data, encoding, tuple(joints) or _PANDA)
        return _of_motors(kind, data, joints)
    except (struct.error, ValueError, IndexError) as error:
        if isinstance(error, LogError):
            raise
        raise LogError(f"cut off or of another version ({error})") from None


@functools.cache
def _places(kind: str) -> tuple[np.ndarray, np.ndarray, int, int]:
    """Where an IMU's ten numbers and motors' fields lie, in steps of 4 bytes; where the motors end; the length."""
    one, at = _MOTORS[kind], 0

    def walked(codes: str) -> list[int]:
        nonlocal at
        out = []
        for code in _expanded(codes):
            size = struct.calcsize(code)
            at += -at % size
            out.append(at)
            at += size
        return out

    walked(one.before)
    imu = walked(one.imu)[:10] if one.imu else []
    motors = [walked(one.motor) for _ in range(one.motors)]
    end = at
    if one.after:
        walked(one.after)
    fields = np.array([[motor[k] for k in one.fields] for motor in motors])
    return np.array(imu, int) // 4, fields // 4, end, at


def _expanded(codes: str) -> list[str]:
    """Codes with their counts written out: 2fb is f, f, b."""
    out, count = [], ""
    for code in codes:
        if code.isdigit():
            count += code
            continue
        out += [code] * int(count or 1)
        count = ""
    return out


def _of_motors(kind: str, data: bytes, joints: Sequence[str]) -> Found:
    one = _MOTORS[kind]
    names = list(joints or one.names)
    if not names:
        raise LogError(
            f"its {one.motors} motors have no names; name those that are joints in the order of motors, with --joints"
        )
    if len(names) > one.motors:
        raise LogError(f"--joints names {len(names)} joints of {one.motors} motors")
    if len(data) < 4 or data[1] not in (0, 1):
        raise LogError("not plain CDR")
    imu, fields, end, length = _places(kind)
    body = data[4:]
    # Where all of it is known, its length shows whether it is this version; CDR may fill up to four bytes.
    if len(body) < end or (one.after and not 0 <= len(body) - length < 4):
        raise LogError(
            f"{len(body)} bytes, where {length} are expected: cut off or of another version"
        )
    numbers = np.frombuffer(body, "<f4" if data[1] else ">f4", end // 4)
    values = numbers[fields[: len(names)]].astype(float)
    if kind in COMMANDS:
        return Found(None, like(NO_TIME, names, values[:, 0]))
    return Found(like(NO_TIME, names, *values.T), None, numbers[imu].astype(float))


def _franka_2(data: bytes) -> Found:
    """Header, 26 collision indicators, then joint states: measured, and desired."""
    cdr = Cdr(data)
    cdr.header()
    cdr.doubles(26)
    measured, desired = cdr.joint_state(), cdr.joint_state()
    return Found(measured, like(desired.header, desired.name, desired.position))


def _franka(data: bytes, encoding: str, names: tuple[str, ...]) -> Found:
    """Of ROS 1: header, two times 6 indicators, q, q_d, dq, dq_d, theta, dtheta, tau_J [7 each]."""
    if encoding != "ros1":
        raise LogError(f"encoded as {encoding[:20]!r}; expected ros1")
    if len(names) != 7:
        raise LogError(f"--joints names {len(names)} joints of 7")
    _, sec, nanosec, size = struct.unpack_from("<IIII", data)
    at = 16 + size
    x = np.frombuffer(data, "<f8", 12 + 7 * 7, at)[12:].reshape(7, 7)
    header = SimpleNamespace(stamp=SimpleNamespace(sec=sec, nanosec=nanosec))
    return Found(like(header, list(names), x[0], x[2], x[6]), like(header, list(names), x[1]))
