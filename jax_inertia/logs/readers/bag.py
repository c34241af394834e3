"""ROS 1 and ROS 2 bags and MCAP to the arrays of the log contract.

The stamps of `sensor_msgs/JointState` are the log's; odometry and wrenches have stamps of their own and are
interpolated linearly onto them.
"""

import re
from collections import Counter
from pathlib import Path

import numpy as np

from jax_inertia.logs.npz import LogError
from jax_inertia.logs.readers.bag_collect import (
    CONTROLLER,
    DYNAMIC,
    FIELDS,
    IMU,
    JOINTS,
    ODOMETRY,
    WRENCH,
    Collected,
    Publisher,
)
from jax_inertia.logs.readers.bag_messages import kind_of, messages
from jax_inertia.logs.readers.messages.robots import KINDS
from jax_inertia.logs.readers.options import Contents, Options, WrenchAxes
from jax_inertia.logs.readers.streams import Stream, onto
from jax_inertia.text.closest_names import listed, suggestion

_KINDS = (".mcap", ".db3")
_ARRAYS = dict(zip(FIELDS, ("qpos", "qvel", "tau"), strict=True))


def bag_parts(folder: Path) -> list[Path]:
    """The files of a ROS 2 bag, in the order they were written."""
    found = [p for p in folder.iterdir() if kind_of(p) in _KINDS and p.is_file()]
    return sorted(found, key=lambda p: [int(k) for k in re.findall(r"\d{1,18}", p.name)])


def read_bag(path: Path, options: Options, max_bytes: int) -> Contents:
    """Read joint states, and where topics for them are given the base's odometry and contact wrenches.

    Time counts from the first joint state. Raises `LogError` for a damaged file, topics that are not there, joint
    states without effort, and wrenches in other axes than the options say.
    """
    topics = (
        "topic_joints",
        "topic_targets",
        "joints",
        "topic_base",
        "topic_imu",
        "topic_wrenches",
        "wrench_axes",
        "flip_wrenches",
    )
    options.check("a bag", topics)
    collected = Collected(options, max_bytes)
    for part in bag_parts(path) if path.is_dir() else [path]:
        for message in messages(part):
            collected.take(message)
    _check_topics(collected, options)
    out, stream, notes = _joints(collected, options)
    notes += _add_targets(out, collected, options, stream)
    start = int(stream.time_ns[0])
    out["time"] = (stream.time_ns - start) * 1e-9
    notes.append(f"time counts from {start // 10**9}.{start % 10**9:09d} s")
    if options.topic_base is not None:
        notes += _add_base(out, collected, options.topic_base, stream)
    if options.topic_imu is not None or len(collected.own_imu) == 1:
        notes += _add_imu(out, collected, options.topic_imu, stream)
    if options.topic_wrenches:
        notes += _add_wrenches(out, collected, options, stream)
    if collected.unstamped:
        notes.append(f"{collected.unstamped} messages without a stamp have the time of recording")
    others = [f"{topic} ({kind})" for topic, kind in collected.seen if not collected.uses(topic)]
    return Contents(out, others, notes)


def _check_topics(collected: Collected, options: Options) -> None:
    """Raise where a topic that is asked for is not there, or none was chosen among several."""

    def topics(kind: str) -> list[str]:
        return [topic for topic, its in collected.seen if its == kind]

    robots = {topic for topic, its in collected.seen if its in (CONTROLLER, DYNAMIC, *KINDS)}
    asked: list[tuple[str | None, str]] = [
        (topic, JOINTS) for topic in options.joint_topics if topic not in robots
    ]
    asked += [(options.topic_base, ODOMETRY), (options.topic_imu, IMU)]
    asked += [(topic, WRENCH) for topic in options.topic_wrenches.values()]
    for topic, kind in asked:
        if topic is not None and topic not in (own := topics(kind)):
            hint = suggestion(topic, own) if own else "the bag has none"
            raise LogError(f"no {kind} on topic {topic!r}; {hint}")
    found = [topic for kind in (JOINTS, CONTROLLER, DYNAMIC, *KINDS) for topic in topics(kind)]
    if not found:
        there = listed([f"{topic} ({kind})" for topic, kind in collected.seen], 20) or "no messages"
        raise LogError(f"no {JOINTS}; the bag has {there}")


def _one_source_a_joint(publishers: list[Publisher]) -> tuple[list[Publisher], list[str]]:
    """Publishers of which no two name a joint, and notes.

    Of those that share joints, one without effort or position gives way where the others have all of its joints:
    commands are written as joint states, too. Raises `LogError` where two are left.
    """
    kept, notes = list(publishers), []
    for one in publishers[::-1]:
        others = {name for other in kept if other is not one for name in other.names}
        if others.issuperset(one.names) and not one.has("position", "effort"):
            kept.remove(one)
            notes.append(
                f"{len(one.rows)} joint states on {one.topic} are left out: no {one.lacking()} of joints that "
                "others have"
            )
    counts = Counter(name for one in kept for name in one.names)
    for name, count in counts.items():
        if count == 1:
            continue
        topics = sorted({one.topic for one in kept if name in one.names})
        if len(topics) > 1:
            raise LogError(
                f"joint states of {name!r} come on several topics, {listed(topics)}; choose with --topic-joints"
            )
        raise LogError(f"joint {name!r} comes in joint states with different sets of joints")
    if len(topics := list(dict.fromkeys(one.topic for one in kept))) > 1:
        notes.append(f"joints of several topics were put together: {listed(topics)}")
    return kept, notes


def _joints(
    collected: Collected, options: Options
) -> tuple[dict[str, np.ndarray], Stream, list[str]]:
    """Arrays of all joints at the stamps of the publisher that gave most, that publisher's stream, and notes."""
    publishers = sorted(collected.publishers.values(), key=lambda one: -one.size)
    publishers = [one for one in publishers if one.names]
    if not publishers:
        raise LogError("the joint states name no joints")
    publishers, notes = _one_source_a_joint(publishers)
    publishers, left_out = _with_torque(publishers)
    names = [name for one in publishers for name in one.names]
    stream = _stream(publishers[0])
    notes, streams = [*notes, *left_out, *stream.notes], [stream]
    for one in publishers[1:]:
        moved, note = onto(stream.time_ns, _stream(one), f"joint states of {listed(one.names)}")
        notes.append(note)
        streams.append(moved)
    out = {"joint_names": np.array(names, dtype=np.str_)}
    for k, field in enumerate(FIELDS):
        parts = [s.values[:, k :: len(FIELDS)] for s in streams]
        lacking = [one for one, p in zip(publishers, parts, strict=True) if np.isnan(p).all()]
        if not lacking:
            out[_ARRAYS[field]] = np.concatenate(parts, axis=1)
        elif field == "velocity" or (
            field == "effort" and (options.topic_wrenches or collected.targets.rows)
        ):
            array = _ARRAYS[field]
            notes.append(f"{array} is left out: no {field} of {listed(lacking[0].names)}")
        else:
            raise LogError(
                f"the joint states on {lacking[0].topic} of {listed(lacking[0].names, 6)} hold no {field}; "
                "a log needs position, and effort or position targets (--topic-targets), of every joint"
            )
    if "tau" in out:
        out["tau_unit"] = np.array("N m")
    return out, stream, notes


def _add_targets(
    out: dict[str, np.ndarray], collected: Collected, options: Options, joints: Stream
) -> list[str]:
    """Targets as asked, or as the one topic has them that is of the joints."""
    names = list(options.joints or out["joint_names"].tolist())
    topic = collected.targets.chosen(names)
    if topic is None:
        if "tau" not in out and not options.topic_wrenches:
            raise LogError(
                f"the joint states of {listed(names, 6)} hold no effort, and no topic holds position targets of these "
                "joints; a log needs one of both (--topic-targets names a topic of targets)"
            )
        others = listed(list(collected.targets.rows))
        return [f"{others} is left out: no targets of all joints"] * bool(others)
    values, note = collected.targets.at(topic, names, joints.time_ns)
    own = out["joint_names"].tolist()
    if lacking := [name for name in own if name not in names]:
        raise LogError(f"--joints does not name {listed(lacking)} of the joint states")
    out["qpos_target"] = values[:, [names.index(name) for name in own]]
    return [note]


def _with_torque(publishers: list[Publisher]) -> tuple[list[Publisher], list[str]]:
    """Publishers that give position and effort, where some do, and a note of the others: grippers often lack effort."""
    whole = [one for one in publishers if one.has("position", "effort")]
    if not whole:
        return publishers, []
    rest = [one for one in publishers if one not in whole]
    return whole, [f"left out, no {one.lacking()}: {listed(one.names)}" for one in rest]


def _stream(publisher: Publisher) -> Stream:
    return publisher.rows.stream(f"joint states on {publisher.topic}")


def _add_base(
    out: dict[str, np.ndarray], collected: Collected, topic: str, joints: Stream
) -> list[str]:
    """Pose and twist of the base: the quaternion as wxyz, the linear velocity in the world's axes."""
    name = f"odometry on {topic}"
    stream = collected.base.stream(name)
    stream.values[:, 3:7] = _one_sign(stream.values[:, 3:7])
    moved, note = onto(joints.time_ns, stream, name)
    # What is infinite or zero in the messages is NaN here, and masked later.
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        quat = moved.values[:, 3:7] / np.linalg.norm(moved.values[:, 3:7], axis=1, keepdims=True)
        w, u, v = quat[:, :1], quat[:, 1:], moved.values[:, 7:10]
        world = v + 2 * np.cross(u, np.cross(u, v) + w * v)
    out |= {"base_pos": moved.values[:, :3], "base_quat": quat}
    out |= {"base_linvel": world, "base_angvel": moved.values[:, 10:]}
    ((parent, child),) = collected.base_frames
    return [f"the base is {child[:80]!r} in {parent[:80]!r}", note]


def _add_imu(
    out: dict[str, np.ndarray], collected: Collected, topic: str | None, joints: Stream
) -> list[str]:
    """Attitude, rate and specific force of an IMU that is mounted along the base's axes; what odometry gave stays."""
    name = f"IMU on {topic or listed(sorted(collected.own_imu))}"
    stream = collected.imu.stream(name)
    stream.values[:, :4] = _one_sign(stream.values[:, :4])
    moved, note = onto(joints.time_ns, stream, name)
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        quat = moved.values[:, :4] / np.linalg.norm(moved.values[:, :4], axis=1, keepdims=True)
    found = {
        "base_quat": quat,
        "base_angvel": moved.values[:, 4:7],
        "base_linacc": moved.values[:, 7:],
    }
    for array, values in found.items():
        if not np.isnan(values).all():
            out.setdefault(array, values)
    frames = listed(sorted(frame[:80] for frame in collected.imu_frames)) or "in the joint states"
    return [f"the IMU ({frames}) is taken to lie along the base's axes", note]


def _one_sign(quat: np.ndarray) -> np.ndarray:
    """From one quaternion to the next the sign must not jump; both signs are the same attitude."""
    with np.errstate(invalid="ignore", over="ignore"):
        turns = np.where(np.sum(quat[1:] * quat[:-1], axis=1) < 0, -1.0, 1.0)
    return quat * np.concatenate([[1.0], np.cumprod(turns)])[:, None]


def _add_wrenches(
    out: dict[str, np.ndarray], collected: Collected, options: Options, joints: Stream
) -> list[str]:
    notes, parts = [], []
    for body, topic in options.topic_wrenches.items():
        name = f"wrenches on {topic}"
        moved, note = onto(joints.time_ns, collected.wrenches[body].stream(name), name)
        parts.append(moved.values)
        notes.append(note)
    out["contact_wrench"] = np.stack(parts, axis=1)
    out["contact_bodies"] = np.array(list(options.topic_wrenches), dtype=np.str_)
    if options.wrench_axes is WrenchAxes.BODY:
        notes.append("contact wrenches are in the axes of their bodies")
    return notes
