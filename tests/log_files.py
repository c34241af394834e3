"""Log files as other people's programs write them: csv, pyarrow, rosbags and mcap."""

import csv
import json
from pathlib import Path

import numpy as np

JOINTS = ("hip", "knee")
START = 1_700_000_000 * 10**9 + 123_456_789


def arrays(samples: int = 60) -> dict[str, np.ndarray]:
    """A sound log in the contract's own terms, 100 Hz."""
    rng = np.random.default_rng(1)
    return {
        "time": np.arange(samples) * 0.01,
        "qpos": rng.normal(size=(samples, 2)),
        "qvel": rng.normal(size=(samples, 2)),
        "tau": rng.normal(size=(samples, 2)),
    }


def columns(samples: int = 60) -> dict[str, np.ndarray]:
    """The same as columns."""
    data = arrays(samples)
    out = {"time": data["time"]}
    for name in ("qpos", "qvel", "tau"):
        out |= {f"{name}.{joint}": data[name][:, k] for k, joint in enumerate(JOINTS)}
    return out


def write_csv(path: Path, table: dict, delimiter: str = ",") -> Path:
    with open(path, "w", newline="") as file:
        writer = csv.writer(file, delimiter=delimiter)
        writer.writerow(table)
        writer.writerows(zip(*(np.asarray(v).tolist() for v in table.values()), strict=True))
    return path


def write_parquet(path: Path, table: dict, metadata: dict | None = None) -> Path:
    import pyarrow as pa
    import pyarrow.parquet as pq

    path.parent.mkdir(parents=True, exist_ok=True)
    made = pa.table({k: v.tolist() if np.ndim(v) > 1 else v for k, v in table.items()})
    pq.write_table(made.replace_schema_metadata(metadata), path)
    return path


def write_dataset(folder: Path, episodes: int = 2, one_file: bool = True) -> Path:
    """A LeRobot dataset: v3 with all episodes in one file, or v2 with one file each."""
    data = arrays()
    table = {
        "observation.state": data["qpos"].astype(np.float32),
        "observation.effort": data["tau"].astype(np.float32),
        "action": data["qpos"].astype(np.float32) + 0.5,
        "timestamp": data["time"].astype(np.float32),
    }
    rows = len(data["time"])
    whole = [{**table, "episode_index": np.full(rows, k)} for k in range(episodes)]
    # Only the second differs, so that taking the wrong one is seen.
    for k, episode in enumerate(whole):
        episode["observation.state"] = episode["observation.state"] + k
    names = {"observation.state": {"names": {"motors": [f"{joint}.pos" for joint in JOINTS]}}}
    (folder / "meta").mkdir(parents=True)
    (folder / "meta" / "info.json").write_text(json.dumps({"features": names}))
    chunk = folder / "data" / "chunk-000"
    if one_file:
        joined = {k: np.concatenate([e[k] for e in whole]) for k in whole[0]}
        write_parquet(chunk / "file-000.parquet", joined)
    else:
        for k, episode in enumerate(whole):
            write_parquet(chunk / f"episode_{k:06d}.parquet", episode)
    return folder


# --- ROS ---------------------------------------------------------------------------------------------------------


def store(ros1: bool = False):
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)


class Maker:
    """Messages of one ROS version."""

    def __init__(self, ros1: bool = False) -> None:
        self.types, self.ros1 = store(ros1).types, ros1

    def header(self, stamp_ns: int, frame: str = ""):
        time = self.types["builtin_interfaces/msg/Time"](stamp_ns // 10**9, stamp_ns % 10**9)
        extra = {"seq": 0} if self.ros1 else {}
        return self.types["std_msgs/msg/Header"](stamp=time, frame_id=frame, **extra)

    def joints(self, stamp_ns: int, names=JOINTS, position=(), velocity=(), effort=()):
        return self.types["sensor_msgs/msg/JointState"](
            header=self.header(stamp_ns),
            name=list(names),
            position=np.array(position, float),
            velocity=np.array(velocity, float),
            effort=np.array(effort, float),
        )

    def vector(self, values):
        return self.types["geometry_msgs/msg/Vector3"](*map(float, values))

    def wrench(self, stamp_ns: int, force, moment, frame: str = "world"):
        wrench = self.types["geometry_msgs/msg/Wrench"](self.vector(force), self.vector(moment))
        kind = self.types["geometry_msgs/msg/WrenchStamped"]
        return kind(self.header(stamp_ns, frame), wrench)

    def odometry(self, stamp_ns: int, position, quat_wxyz, linear, angular):
        t, (w, x, y, z) = self.types, map(float, quat_wxyz)
        point = t["geometry_msgs/msg/Point"](*map(float, position))
        pose = t["geometry_msgs/msg/Pose"](point, t["geometry_msgs/msg/Quaternion"](x, y, z, w))
        twist = t["geometry_msgs/msg/Twist"](self.vector(linear), self.vector(angular))
        none = np.zeros(36)
        return t["nav_msgs/msg/Odometry"](
            self.header(stamp_ns, "odom"),
            "pelvis",
            t["geometry_msgs/msg/PoseWithCovariance"](pose, none),
            t["geometry_msgs/msg/TwistWithCovariance"](twist, none),
        )


def write_bag(
    path: Path, messages: list[tuple[str, object, int]], kind: str, compression="", types=None
) -> Path:
    """Messages (topic, message, time of recording) as .bag, or as a folder with .mcap or .db3 in it.

    `types` knows messages that ROS itself does not bring.
    """
    ros1 = kind == "bag"
    types = types or store(ros1)
    if ros1:
        from rosbags.rosbag1 import Writer

        writer = Writer(path)
        if compression:
            writer.set_compression(Writer.CompressionFormat[compression])
    else:
        from rosbags.rosbag2 import StoragePlugin, Writer
        from rosbags.rosbag2.enums import CompressionFormat, CompressionMode

        plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
        writer = Writer(path, version=9, storage_plugin=plugin)
        if compression:
            writer.set_compression(CompressionMode[compression], CompressionFormat.ZSTD)
    serialize = types.serialize_ros1 if ros1 else types.serialize_cdr
    with writer:
        topics = {}
        for topic, message, received in messages:
            its = type(message).__msgtype__
            if topic not in topics:
                topics[topic] = writer.add_connection(topic, its, typestore=types)
            writer.write(topics[topic], received, serialize(message, its))
    return path


def joint_messages(ros1: bool = False, topic: str = "/joint_states") -> list:
    """The log of `arrays` as joint states, recorded 2 ms late."""
    data, maker = arrays(), Maker(ros1)
    out = []
    for k, time in enumerate(data["time"]):
        stamp = START + round(time * 1e9)
        parts = (data[name][k] for name in ("qpos", "qvel", "tau"))
        out.append((topic, maker.joints(stamp, JOINTS, *parts), stamp + 2_000_000))
    return out


def write_plain_mcap(path: Path, messages: list, compression: str = "lz4") -> Path:
    """The same by the mcap library's own writer."""
    from mcap.writer import CompressionType, Writer

    types = store()
    with open(path, "wb") as file:
        writer = Writer(file, compression=CompressionType[compression.upper()])
        writer.start("ros2", "test")
        channels = {}
        for topic, message, received in messages:
            its = type(message).__msgtype__
            if topic not in channels:
                schema = writer.register_schema(its, "ros2msg", b"")
                channels[topic] = writer.register_channel(topic, "cdr", schema)
            data = bytes(types.serialize_cdr(message, its))
            writer.add_message(channels[topic], received, data, received)
        writer.finish()
    return path
