"""What is wanted of a bag's messages, taken out one by one."""

import dataclasses
import functools
from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np

from jax_inertia.logs.npz import LogError
from jax_inertia.logs.readers.bag_messages import Message
from jax_inertia.logs.readers.bag_targets import Targets, is_named_command
from jax_inertia.logs.readers.messages import robots
from jax_inertia.logs.readers.messages.control import (
    ARRAY,
    CONTROLLER,
    DYNAMIC,
    TRAJECTORY,
    decoded,
)
from jax_inertia.logs.readers.messages.plain import PLAIN, as_object, header, joint_state, plain
from jax_inertia.logs.readers.options import Options, WrenchAxes, required
from jax_inertia.logs.readers.streams import Rows
from jax_inertia.text.closest_names import listed

JOINTS = "sensor_msgs/msg/JointState"
WRENCH = "geometry_msgs/msg/WrenchStamped"
ODOMETRY = "nav_msgs/msg/Odometry"
IMU = "sensor_msgs/msg/Imu"
_CONTROL = (ARRAY, CONTROLLER, DYNAMIC, TRAJECTORY)
FIELDS = ("position", "velocity", "effort")
"""Of a joint state, in the order in which every joint's three columns lie in a row."""

_WORLD = ("world", "map", "odom")
_MOST_TOPICS, _MOST_JOINTS, _MOST_PUBLISHERS = 10_000, 1000, 100


@functools.cache
def _typestores() -> tuple[Any, Any]:
    """The types of ROS 1 and ROS 2 as we know them, never those that a bag brings along: from those, code would be
    made.
    """
    rosbags = required("rosbags.typesys", "ROS bags")
    known = rosbags.Stores.ROS1_NOETIC, rosbags.Stores.ROS2_HUMBLE
    return rosbags.get_typestore(known[0]), rosbags.get_typestore(known[1])


@dataclasses.dataclass
class Publisher:
    """Joint states that name the same joints on the same topic."""

    topic: str
    names: tuple[str, ...]
    rows: Rows = dataclasses.field(default_factory=Rows)
    given: set[str] = dataclasses.field(default_factory=set)
    """Fields that any of its messages had values of."""

    @property
    def size(self) -> int:
        """How many numbers it gave."""
        return len(self.rows) * len(self.names)

    def has(self, *fields: str) -> bool:
        """Whether it gave any value of each of the fields."""
        return self.given.issuperset(fields)

    def lacking(self) -> str:
        """What a log needs and it did not give, in words."""
        return " and no ".join(f for f in ("position", "effort") if f not in self.given)


class Collected:
    """The rows taken so far, and which topics there are."""

    def __init__(self, options: Options, max_bytes: int) -> None:
        self._ros1, self._ros2 = _typestores()
        self._options, self._max_bytes, self._bytes = options, max_bytes, 0
        self._topics = options.joint_topics
        self._bodies = {topic: body for body, topic in options.topic_wrenches.items()}
        self.seen: Counter[tuple[str, str]] = Counter()
        """How many messages of which topic and type."""
        self.publishers: dict[tuple[str, frozenset[str], bool], Publisher] = {}
        self.base = Rows()
        self.base_frames: set[tuple[str, str]] = set()
        self.imu = Rows()
        self.imu_frames: set[str] = set()
        self.own_imu: set[str] = set()
        """Topics of joint states that hold an IMU's readings, too."""
        self.wrenches: dict[str, Rows] = {body: Rows() for body in options.topic_wrenches}
        self.targets = Targets(options.topic_targets)
        self.unstamped = 0

    def take(self, message: Message) -> None:
        """Keep what is wanted of one message; `LogError` where it is not sound."""
        topic, kind = message.topic, self._kind(message)
        self.seen[topic, kind] += 1
        if len(self.seen) > _MOST_TOPICS:
            raise LogError(f"holds more than {_MOST_TOPICS} topics")
        if kind in _CONTROL and message.encoding == "cdr":
            self._control(message, kind)
            return
        if kind in robots.KINDS:
            self._robot(message, kind)
            return
        if kind == JOINTS and self._is_command(topic):
            read = self._target
        elif kind == JOINTS and (not self._topics or topic in self._topics):
            read = self._joint_state
        elif kind == ODOMETRY and topic == self._options.topic_base:
            read = self._odometry
        elif kind == IMU and topic == self._options.topic_imu:
            read = self._imu
        elif kind == WRENCH and topic in self._bodies:
            read = self._wrench
        else:
            return
        try:
            read(message, self._decoded(message, kind))
        except (AttributeError, TypeError) as error:
            # What is not ROS's own may lack any field.
            raise LogError(
                f"a message on {topic} is not like {kind}: {' '.join(str(error).split())[:100]}"
            ) from None

    def _is_command(self, topic: str) -> bool:
        """Whether joint states on a topic are targets: asked for, or by the topic's name."""
        asked = topic == self._options.topic_targets
        return asked or (topic not in self._topics and is_named_command(topic))

    def _control(self, message: Message, kind: str) -> None:
        """What a message of ros2_control says of the state, and what of the targets."""
        topic = message.topic
        if kind == ARRAY and topic != self._options.topic_targets and not is_named_command(topic):
            return
        if self._topics and topic not in self._topics and kind == DYNAMIC:
            return
        try:
            state, target = decoded(kind, message.data)
        except LogError as error:
            raise LogError(f"a message on {topic} is not like {kind}: {error}") from None
        if state is not None and (not self._topics or topic in self._topics):
            self._joint_state(message, state)
        if target is not None:
            self._target(message, target)

    def _robot(self, message: Message, kind: str) -> None:
        """What a message of a robot's own driver says of the state, of the targets and of an IMU in the base."""
        topic, commands = message.topic, kind in robots.COMMANDS
        if self._topics and topic not in self._topics and not commands:
            return
        joints = self._options.joints
        try:
            found = robots.decoded(kind, message.encoding, message.data, joints)
        except LogError as error:
            raise LogError(f"a message on {topic} ({kind}): {error}") from None
        if found.state is not None:
            self._joint_state(message, found.state)
        if found.target is not None:
            self._target(message, found.target)
        if found.imu is not None and self._options.topic_imu is None:
            self.own_imu.add(topic)
            if len(self.own_imu) == 1:
                self._add(self.imu, message, robots.NO_HEADER, found.imu)

    def _target(self, message: Message, target: Any) -> None:
        names = tuple(target.name)
        if len(target.position) > _MOST_JOINTS:
            raise LogError(f"targets on {message.topic} are of {len(target.position)} joints")
        rows = self.targets.place(message.topic, names, len(target.position))
        if rows.width not in (0, len(target.position)):
            raise LogError(
                f"targets on {message.topic} change their number from message to message"
            )
        self._add(rows, message, target.header, target.position)

    def _kind(self, message: Message) -> str:
        """The ROS type of a message; what is not ROS's and is asked for by topic may have any name."""
        topic = message.topic
        if message.encoding in PLAIN and message.kind not in (JOINTS, ODOMETRY, IMU, WRENCH):
            asked = dict.fromkeys(self._topics, JOINTS) | dict.fromkeys(self._bodies, WRENCH)
            asked |= {self._options.topic_base: ODOMETRY, self._options.topic_imu: IMU}
            return asked.get(topic, message.kind)
        return message.kind

    def uses(self, topic: str) -> bool:
        """Whether anything of this topic was wanted."""
        joints = any(one.topic == topic for one in self.publishers.values())
        based = topic in (self._options.topic_base, self._options.topic_imu)
        return joints or topic in self._bodies or based or topic in self.targets.rows

    def _decoded(self, message: Message, kind: str) -> Any:
        try:
            if message.encoding == "json" or (message.encoding == "protobuf" and message.schema[1]):
                found = plain(message.data, message.encoding, *message.schema)
                if kind == JOINTS:
                    return joint_state(found, message.topic)
                return as_object({**found, "header": vars(header(found))})
            if message.encoding == "ros1":
                return self._ros1.deserialize_ros1(message.data, message.kind)
            if message.encoding == "cdr":
                return self._ros2.deserialize_cdr(message.data, message.kind)
        except LogError:
            raise
        except Exception as error:
            text = " ".join(str(error).split())[:200]
            raise LogError(f"a message on {message.topic} cannot be decoded: {text}") from None
        raise LogError(
            f"messages on {message.topic} are encoded as {message.encoding[:20]!r}; "
            "expected cdr, ros1, json or protobuf"
        )

    def _add(
        self, rows: Rows, message: Message, header: Any, values: Sequence[float] | np.ndarray
    ) -> None:
        stamp = int(header.stamp.sec) * 10**9 + int(header.stamp.nanosec)
        if stamp == 0:
            self.unstamped += 1
            stamp = int(message.received_ns)
        rows.add(stamp, np.asarray(values, dtype=float))
        self._bytes += 8 * len(values) + 8
        if self._bytes > self._max_bytes:
            raise LogError(f"holds more than the limit of {self._max_bytes} bytes; cut the bag")

    def _joint_state(self, message: Message, state: Any) -> None:
        names, topic = tuple(state.name), message.topic
        # Two nodes may write to one topic, one of them without effort.
        key = topic, frozenset(names), len(state.effort) > 0
        if len(names) > _MOST_JOINTS or len(key[1]) != len(names):
            raise LogError(
                f"a joint state on {topic} names {len(names)} joints, too many or one twice"
            )
        row = np.full((len(names), len(FIELDS)), np.nan)
        for k, field in enumerate(FIELDS):
            values = getattr(state, field)
            if len(values) not in (0, len(names)):
                raise LogError(
                    f"a joint state on {topic} has {len(names)} names but {len(values)} values of {field}"
                )
            if len(values):
                row[:, k] = values
        known = self.publishers.setdefault(key, Publisher(topic, names))
        if len(self.publishers) > _MOST_PUBLISHERS:
            raise LogError(f"joint states on {topic} name other joints again and again")
        known.given |= {field for field in FIELDS if len(getattr(state, field))}
        if known.names != names:
            row = row[[names.index(name) for name in known.names]]
        self._add(known.rows, message, state.header, row.ravel())

    def _odometry(self, message: Message, odometry: Any) -> None:
        self.base_frames.add((odometry.header.frame_id, odometry.child_frame_id))
        if len(self.base_frames) > 1:
            frames = [f"{child!r} in {parent!r}" for parent, child in sorted(self.base_frames)]
            raise LogError(f"odometry on {message.topic} is of several frames: {listed(frames)}")
        p, o = odometry.pose.pose.position, odometry.pose.pose.orientation
        v, w = odometry.twist.twist.linear, odometry.twist.twist.angular
        values = [p.x, p.y, p.z, o.w, o.x, o.y, o.z, v.x, v.y, v.z, w.x, w.y, w.z]
        self._add(self.base, message, odometry.header, values)

    def _imu(self, message: Message, imu: Any) -> None:
        self.imu_frames.add(imu.header.frame_id)
        o, w, f = imu.orientation, imu.angular_velocity, imu.linear_acceleration
        values = np.array([o.w, o.x, o.y, o.z, w.x, w.y, w.z, f.x, f.y, f.z], dtype=float)
        # A covariance that begins with -1 says that there is no such reading.
        for name, part in (
            ("orientation", slice(0, 4)),
            ("angular_velocity", slice(4, 7)),
            ("linear_acceleration", slice(7, 10)),
        ):
            covariance = list(getattr(imu, f"{name}_covariance", ()))
            if covariance[:1] == [-1.0]:
                values[part] = np.nan
        self._add(self.imu, message, imu.header, values)

    def _wrench(self, message: Message, wrench: Any) -> None:
        body, axes = self._bodies[message.topic], self._options.wrench_axes
        frame = wrench.header.frame_id.lstrip("/")
        if frame and (frame in _WORLD) != (axes is WrenchAxes.WORLD):
            raise LogError(
                f"wrenches on {message.topic} are in the axes of {frame!r}, not of the {axes}; give --wrench-axes "
                "body where that frame is the body's own, else turn them into the world's axes first"
            )
        f, m = wrench.wrench.force, wrench.wrench.torque
        sign = -1.0 if self._options.flip_wrenches else 1.0
        values = sign * np.array([f.x, f.y, f.z, m.x, m.y, m.z])
        self._add(self.wrenches[body], message, wrench.header, values)
