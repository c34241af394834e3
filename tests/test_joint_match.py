"""Logs and models that do not hold the same joints: an arm with a gripper by MuJoCo's inverse dynamics."""

import dataclasses

import mujoco
import numpy as np
import pytest
from test_against_model import ARMS, log_of

import jax_inertia as ji
from jax_inertia.model.joint_match import same_joints
from jax_inertia.preflight.preflight import preflight

FINGERS = """<body name="left" pos="0.1 0.02 0"><joint name="finger" type="slide" axis="0 1 0" range="0 0.04"/>
  <inertial mass="0.02" pos="0.02 0 0" diaginertia="1e-6 1e-6 1e-6"/></body>
 <body name="right" pos="0.1 -0.02 0"><joint name="other" type="slide" axis="0 -1 0" range="0 0.04"/>
  <inertial mass="0.02" pos="0.02 0 0" diaginertia="1e-6 1e-6 1e-6"/></body>"""
MIMIC = (
    '<equality><joint joint1="other" joint2="finger" polycoef="0.001 1 0 0 0"/></equality></mujoco>'
)


@pytest.fixture(scope="module")
def arm():
    xml = ARMS["large"]
    end = xml.index("</body>")
    gripper = xml[:end] + FINGERS + xml[end:].replace("</mujoco>", MIMIC)
    with pytest.warns(ji.ModelWarning):
        robot = ji.load_model(mujoco.MjModel.from_xml_string(gripper))
    return robot, log_of(xml)


def with_joint(log: ji.Log, name: str, value: float) -> ji.Log:
    """The log with a joint more that stands still."""
    column = np.full((len(log.time), 1), value)
    return dataclasses.replace(
        log,
        joint_names=(*log.joint_names, name),
        qpos=np.hstack([log.qpos, column]),
        tau=np.hstack([log.tau, 0.0 * column]),
    )


def test_fingers_that_the_log_lacks_are_held_with_a_note(arm):
    robot, log = arm
    assert "--fix finger=VALUE" in " ".join(map(str, preflight(log, robot).findings))
    held, (same,), (note,) = same_joints(robot, [log])
    assert held.joint_names == log.joint_names
    assert held.body_names == robot.body_names
    assert "finger at 0, other at 0" in note.message
    assert preflight(same, held).ok


def test_a_finger_follows_its_master(arm):
    robot, log = arm
    held, (same,), (note,) = same_joints(robot, [with_joint(log, "finger", 0.03)])
    assert held.joint_names == same.joint_names == (*log.joint_names, "finger")
    assert "other at 0.031" in note.message


def test_joints_are_held_where_one_says(arm):
    robot, log = arm
    held, _, findings = same_joints(robot, [log], fix={"finger": 0.01})
    assert "finger at 0.01" in findings[0].message
    node = list(held.body_names).index("left")
    position = ji.body_poses(held, 0.0 * held.armature)[1]
    free = ji.body_poses(robot, 0.0 * robot.armature)[1]
    np.testing.assert_allclose(position[node] - free[node], [0, 0.01, 0], atol=1e-12)


def test_what_the_model_lacks_is_left_out(arm):
    robot, log = arm
    _, (same,), findings = same_joints(robot, [with_joint(log, "lamp", 1.0)])
    assert same.joint_names == log.joint_names
    assert "left out, not in the model: lamp" in findings[-1].message


def test_a_subset_of_joints_needs_the_others_at_rest(arm):
    robot, log = arm
    with pytest.raises(ji.LogError, match=r"^joint 'j4' is to be held and moves by .*$"):
        same_joints(robot, [log], joints=["j0", "j1", "j2", "j3"])
    still = dataclasses.replace(log, qpos=np.where(np.arange(5) == 4, 0.3, log.qpos))
    held, (same,), _ = same_joints(robot, [still], joints=["j0", "j1", "j2", "j3"])
    assert held.joint_names == same.joint_names == ("j0", "j1", "j2", "j3")


def test_a_heavy_joint_is_not_held_unasked(arm):
    robot, log = arm
    held, (same,), _ = same_joints(robot, [log.select(["j0", "j1", "j2", "j3"])])
    assert not preflight(same, held).ok
    for joints, fix, word in ((["j9"], None, "j9"), (None, {"fingr": 0.0}, "finger")):
        with pytest.raises(ji.LogError, match=word):
            same_joints(robot, [log], joints=joints, fix=fix)


def test_a_closed_loop_is_refused(arm):
    _, log = arm
    xml = ARMS["large"].replace(
        "</mujoco>",
        '<equality><connect name="bar" body1="link1" body2="link4" anchor="0 0 0.1"/></equality></mujoco>',
    )
    with pytest.warns(ji.ModelWarning):
        robot = ji.load_model(mujoco.MjModel.from_xml_string(xml))
    with pytest.raises(ji.LogError, match=r"^the model has a closed loop \(connect 'bar'\).*$"):
        preflight(log, robot).raise_for_errors()
