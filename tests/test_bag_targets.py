"""Position targets in bags, as each kind of ROS message has them; written by rosbags, which knows whole definitions."""

import numpy as np
import pytest
from log_files import JOINTS, START, Maker, arrays, store, write_bag

from jax_inertia.logs.log import LogError
from jax_inertia.logs.log_files import read_log
from jax_inertia.logs.readers import Options

pytest.importorskip("rosbags")

POINT = "trajectory_msgs/JointTrajectoryPoint"
NAMED = "std_msgs/Header header\nstring[] joint_names\n"
NEW = NAMED + "".join(f"{POINT} {name}\n" for name in ("reference", "feedback", "error", "output"))
DEFINITIONS = {
    "JointTrajectoryControllerState": NEW + "string[] multi_dof_joint_names\n",
    "InterfaceValue": "string[] interface_names\nfloat64[] values\n",
    "DynamicJointState": NAMED + "control_msgs/InterfaceValue[] interface_values\n",
}


@pytest.fixture(scope="module")
def ros():
    from rosbags.typesys import get_types_from_msg

    own = store(False)
    for name, text in DEFINITIONS.items():
        kind = f"control_msgs/msg/{name}"
        if kind not in own.types:
            own.register(get_types_from_msg(text, kind))
    return own


@pytest.fixture
def types(ros):
    return ros.types


def point(types, position=(), velocity=(), effort=()):
    duration = types["builtin_interfaces/msg/Duration"](0, 0)
    fields = (np.array(x, float) for x in (position, velocity, (), effort))
    return types["trajectory_msgs/msg/JointTrajectoryPoint"](*fields, duration)


@pytest.fixture
def bag(ros, tmp_path):
    """Writes a bag of messages, and returns its folder."""

    def write(name, messages, storage, compression=""):
        return write_bag(tmp_path / name, messages, storage, compression, ros)

    return write


def recorded(types, kind: str) -> list:
    """Joint states without effort, and at every third of them, 1 ms before, a target: its row number."""
    data, maker, out = arrays(), Maker(), []
    layout = types["std_msgs/msg/MultiArrayLayout"]([], 0)
    for k, time in enumerate(data["time"]):
        stamp = START + round(time * 1e9)
        state = data["qpos"][k], data["qvel"][k]
        target = np.arange(len(JOINTS)) + k - k % 3
        names = list(JOINTS[::-1]) if kind != "array" else list(JOINTS)
        turned = target if kind == "array" else target[::-1]
        header, at = maker.header(stamp - 1_000_000), stamp - 1_000_000
        if kind == "controller":
            one = types["control_msgs/msg/JointTrajectoryControllerState"](
                maker.header(stamp),
                list(JOINTS),
                *(point(types, target), point(types, *state), point(types), point(types)),
                [],
            )
            out.append(("/arm/controller_state", one, stamp))
            continue
        out.append(("/joint_states", maker.joints(stamp, JOINTS, *state), stamp))
        if k % 3 == 0 and kind == "states":
            out.append(("/joint_commands", maker.joints(at, names, turned), at))
        if k % 3 == 0 and kind == "trajectory":
            plan = types["trajectory_msgs/msg/JointTrajectory"](
                header, names, [point(types, turned)]
            )
            out.append(("/arm/joint_trajectory", plan, at))
        if k % 3 == 0 and kind == "array":
            out.append(
                (
                    "/forward/commands",
                    types["std_msgs/msg/Float64MultiArray"](layout, turned.astype(float)),
                    at,
                )
            )
    return out


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
@pytest.mark.parametrize("kind", ["states", "controller", "trajectory", "array"])
def test_targets_hold_until_the_next_come(types, bag, kind, storage):
    log = read_log(bag("bag", recorded(types, kind), storage))
    k = np.arange(len(log.time))[:, None]
    expected = np.arange(len(JOINTS)) + k - k % 3
    order = [log.joint_names.index(name) for name in JOINTS]
    np.testing.assert_array_equal(np.asarray(log.qpos_target)[:, order], expected)
    np.testing.assert_allclose(np.asarray(log.qpos)[:, order], arrays()["qpos"])
    assert log.tau is None
    assert any("targets are those of" in note for note in log.notes)


def test_which_targets_is_asked_where_it_is_not_sure(types, bag):
    both = recorded(types, "states") + recorded(types, "trajectory")[1::2]
    path = bag("two", both, "mcap")
    with pytest.raises(
        LogError, match=r"targets come on several topics, .*; choose with --topic-targets"
    ):
        read_log(path)
    log = read_log(path, options=Options(topic_targets="/joint_commands"))
    assert log.qpos_target is not None
    with pytest.raises(
        LogError, match="no targets on topic '/joint_comands'; did you mean '/joint_commands'"
    ):
        read_log(path, options=Options(topic_targets="/joint_comands"))
    path = bag("none", [m for m in both if m[0] == "/joint_states"], "mcap")
    with pytest.raises(
        LogError, match="hold no effort; a log needs position, and effort or position targets"
    ):
        read_log(path)


def test_an_array_is_of_the_joints_that_are_named(types, bag):
    path = bag("bag", recorded(types, "array"), "mcap")
    log = read_log(path, options=Options(joints=JOINTS[::-1]))
    plain = read_log(path)
    np.testing.assert_array_equal(log.qpos_target, np.asarray(plain.qpos_target)[:, ::-1])
    with pytest.raises(LogError, match="does not name"):
        read_log(path, options=Options(joints=(*JOINTS[:-1], "other")))


def test_a_plan_of_several_points_is_no_stream_of_targets(types, bag):
    messages = recorded(types, "trajectory")
    plan = next(m for topic, m, _ in messages if topic == "/arm/joint_trajectory")
    plan.points.append(plan.points[0])
    with pytest.raises(LogError, match=r"a trajectory of 2 points.*JointTrajectoryControllerState"):
        read_log(bag("bag", messages, "mcap"))


def test_states_by_interface(types, bag):
    """control_msgs/DynamicJointState, with effort and an interface of its own."""
    data, maker, out = arrays(), Maker(), []
    value = types["control_msgs/msg/InterfaceValue"]
    for k, time in enumerate(data["time"]):
        stamp = START + round(time * 1e9)
        names = ["effort", "temperature", "position"]
        values = [
            value(names, np.array([data["tau"][k, j], 40.0, data["qpos"][k, j]]))
            for j in range(len(JOINTS))
        ]
        kind = types["control_msgs/msg/DynamicJointState"]
        out.append(
            ("/dynamic_joint_states", kind(maker.header(stamp), list(JOINTS), values), stamp)
        )
    log = read_log(bag("bag", out, "mcap"))
    np.testing.assert_allclose(log.qpos, data["qpos"])
    np.testing.assert_allclose(log.tau, data["tau"])
    assert log.qvel is None


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_a_bag_compressed_as_a_file(types, bag, storage):
    plain = read_log(bag("plain", recorded(types, "states"), storage))
    path = bag("packed", recorded(types, "states"), storage, "FILE")
    assert list(path.glob("*.zstd"))
    log = read_log(path)
    np.testing.assert_array_equal(log.qpos, plain.qpos)
    packed = next(path.glob("*.zstd"))
    np.testing.assert_array_equal(read_log(packed).qpos, plain.qpos)
    packed.write_bytes(packed.read_bytes()[:200])
    with pytest.raises(LogError):
        read_log(path)
