"""Messages in JSON and protocol buffers, as loggers without ROS write them, in the shape of the ROS messages."""

import functools
import json
from collections.abc import Mapping, Sequence
from types import SimpleNamespace
from typing import Any

from jax_inertia.logs.npz import LogError
from jax_inertia.logs.readers.messages import protobuf

PLAIN = ("json", "protobuf")
"""Encodings that this module knows."""

_KINDS = {
    "jointstate": "sensor_msgs/msg/JointState",
    "jointstates": "sensor_msgs/msg/JointState",
    "odometry": "nav_msgs/msg/Odometry",
    "wrenchstamped": "geometry_msgs/msg/WrenchStamped",
}
# Names that loggers use for the fields of a joint state; the first is ROS's.
_FIELDS = {
    "name": ("name", "names", "joint_names", "jointNames"),
    "position": ("position", "positions", "q"),
    "velocity": ("velocity", "velocities", "qd", "dq"),
    "effort": ("effort", "efforts", "torque", "torques", "tau"),
}
_SECONDS = ("sec", "secs", "seconds")
_NANOSECONDS = ("nanosec", "nsec", "nsecs", "nanos", "nanoseconds")
_NO_TIME = SimpleNamespace(sec=0, nanosec=0)


def ros_kind(schema: str) -> str:
    """The ROS message that a schema is named after (JointState, acme.JointState ...), else the name as it is."""
    last = schema.replace("/", ".").rpartition(".")[2]
    return _KINDS.get(last.lower(), schema)


def plain(data: bytes, encoding: str, schema: str, descriptors: bytes) -> Mapping[str, Any]:
    """One message as a dictionary; ValueError where it is none."""
    if encoding == "protobuf":
        return protobuf.decoded(_types(descriptors), schema, data)
    message = json.loads(data)
    if not isinstance(message, dict):
        raise ValueError("a JSON message that is no object")
    return message


@functools.lru_cache(maxsize=64)
def _types(descriptors: bytes) -> protobuf.Types:
    return protobuf.types_of(descriptors)


def joint_state(message: Mapping[str, Any], topic: str) -> SimpleNamespace:
    """A joint state with the fields of sensor_msgs/JointState, from lists or from one object for each joint."""
    if isinstance(joints := message.get("joints"), list) and all(
        isinstance(joint, dict) for joint in joints
    ):
        found = {
            field: [joint[k] for joint in joints for k in names if joint.get(k) is not None]
            for field, names in _FIELDS.items()
        }
    else:
        found = {
            field: next((message[k] for k in names if message.get(k) is not None), [])
            for field, names in _FIELDS.items()
        }
    for field, values in found.items():
        kinds = str if field == "name" else (int, float, type(None))
        if (
            not isinstance(values, Sequence)
            or isinstance(values, str)
            or not all(isinstance(value, kinds) and not isinstance(value, bool) for value in values)
        ):
            raise LogError(f"a joint state on {topic} has a {field} that is no list of them")
    numbers = {
        field: [float("nan") if value is None else float(value) for value in values]
        for field, values in found.items()
        if field != "name"
    }
    return SimpleNamespace(header=header(message), name=found["name"], **numbers)


def header(message: Mapping[str, Any]) -> SimpleNamespace:
    """Stamp and frame, from `header` or from next to the values; a stamp of zero where there is none."""
    inner = message.get("header")
    inner = inner if isinstance(inner, dict) else message
    frame = inner.get("frame_id", "")
    raw = next((inner[k] for k in ("stamp", "timestamp", "time") if k in inner), None)
    return SimpleNamespace(stamp=_stamp(raw), frame_id=frame if isinstance(frame, str) else "")


def _stamp(raw: object) -> SimpleNamespace:
    if isinstance(raw, dict):
        parts = [next((raw[k] for k in names if k in raw), 0) for names in (_SECONDS, _NANOSECONDS)]
        # Zero is left out in protocol buffers, and JSON made of them has whole numbers as texts.
        whole = [int(x) if isinstance(x, int | float | str) and _is_whole(x) else 0 for x in parts]
        return SimpleNamespace(sec=whole[0], nanosec=whole[1])
    if isinstance(raw, int | float) and not isinstance(raw, bool) and 0 < raw < 1e10:
        # Seconds; a whole number of nanoseconds would be far larger.
        return SimpleNamespace(sec=0, nanosec=round(raw * 1e9))
    if isinstance(raw, int) and not isinstance(raw, bool) and 1e15 < raw < 1 << 62:
        return SimpleNamespace(sec=0, nanosec=raw)
    return _NO_TIME


def _is_whole(value: float | int | str) -> bool:
    try:
        return float(value).is_integer() and abs(float(value)) < 1 << 62
    except (ValueError, OverflowError):
        return False


def as_object(value: Any) -> Any:
    """Dictionaries as objects with attributes, as deep as they go."""
    if isinstance(value, dict):
        return SimpleNamespace(**{str(k): as_object(v) for k, v in value.items()})
    return value
