"""The node of docs/ros2_node.py on the messages of a recorded bag, against what the arm is made to hold.

rclpy is on no package index: where it is not installed, stand-ins with the names that the node uses deliver messages.
"""

import importlib.util
import sys
import types
from pathlib import Path
from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest
from log_files import Maker, store, write_bag

import jax_inertia as ji
from jax_inertia.cli.demo.simulation import simulate

pytest.importorskip("rosbags")
NODE = Path(__file__).parents[1] / "docs" / "ros2_node.py"


class Node:
    """What the example uses of rclpy.node.Node; timers and subscriptions are called by the test."""

    parameters: ClassVar[dict] = {}

    def __init__(self, name):
        self.said, self.heard, self.timers = {}, {}, []

    def declare_parameter(self, name, value):
        return SimpleNamespace(value=self.parameters.get(name, value))

    def create_publisher(self, kind, topic, depth):
        said = self.said.setdefault(topic, [])
        return SimpleNamespace(publish=said.append)

    def create_subscription(self, kind, topic, take, depth):
        self.heard[topic] = take

    def create_timer(self, seconds, answer):
        self.timers.append(answer)


def loaded(monkeypatch):
    """The example as a module, on stand-ins."""
    message = type("Message", (SimpleNamespace,), {})
    modules = {
        "rclpy": {}, "rclpy.node": {"Node": Node}, "sensor_msgs": {}, "std_msgs": {},
        "sensor_msgs.msg": {"JointState": message},
        "std_msgs.msg": {"Float64MultiArray": message, "String": message},
    }  # fmt: skip
    for name, content in modules.items():
        module = types.ModuleType(name)
        module.__dict__.update(content)
        monkeypatch.setitem(sys.modules, name, module)
    spec = importlib.util.spec_from_file_location("ros2_node", NODE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def recorded(tmp_path, log: ji.Log) -> list:
    """Joint states of a log, through a bag, with a message that lacks effort and joints in another order."""
    maker, sent, names = Maker(), [], log.joint_names[::-1]
    for k, time in enumerate(np.asarray(log.time)):
        stamp = round(time * 1e9) + 10**18
        channels = (np.asarray(x)[k, ::-1] for x in (log.qpos, log.qvel, log.tau))
        sent.append(("/joint_states", maker.joints(stamp, names, *channels), stamp))
    sent.append(
        ("/joint_states", maker.joints(stamp + 10**6, names, np.zeros(len(names))), stamp + 10**6)
    )
    folder = write_bag(tmp_path / "bag", sent, "mcap")
    from rosbags.highlevel import AnyReader

    with AnyReader([folder], default_typestore=store()) as reader:
        return [reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages()]


def test_the_node_weighs_what_a_recorded_arm_picks_up(tmp_path, monkeypatch):
    data = simulate()
    (tmp_path / "arm.xml").write_text(data.model_xml)
    messages = recorded(tmp_path, data.log.between(0.0, 8.0))
    Node.parameters = {"model": str(tmp_path / "arm.xml")}
    node = loaded(monkeypatch).Payload()
    for k, message in enumerate(messages):
        node.heard["joint_states"](message)
        if k % 125 == 0:
            node.timers[0]()
    node.timers[0]()
    masses = [message.data for message in node.said["~/payload"]]
    verdicts = [message.data for message in node.said["~/verdict"]]
    assert len(masses) == len(verdicts) > 10
    # 1.1 kg alone, and 1.9 kg more from 4 s on.
    before, after = masses[len(masses) // 3], masses[-1]
    assert abs(before[0] - 1.1) < 0.15
    assert abs(after[0] - 3.0) < 0.15
    assert len(after) == 5
    held = float(verdicts[-1].split()[2])
    assert verdicts[-1].startswith("hand holds")
    assert abs(held - 1.9) < 0.15
