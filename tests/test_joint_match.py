"""Logs and models that do not hold the same joints: an arm with a gripper by MuJoCo's inverse dynamics."""

import dataclasses

import jax.numpy as jnp
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
    assert held.joint_names == same.joint_names == log.joint_names
    assert "stand still: finger at 0.03, other at 0.031" in note.message


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


# A lifting arm whose forearm a rod turns with the upper arm: q(fold) = 0.1 - 0.5 q(lift), by a joint equality.
RODS = """<mujoco><compiler angle="radian"/><option timestep="0.002"/><worldbody>
 <body name="base"><joint name="turn" axis="0 0 1" damping="1"/>
  <inertial mass="3" pos="0 0 0.1" diaginertia="0.02 0.02 0.02"/>
  <body name="upper" pos="0 0 0.2"><joint name="lift" axis="0 1 0" damping="1"/>
   <inertial mass="2" pos="0.2 0 0" diaginertia="0.01 0.02 0.02"/>
   <body name="fore" pos="0.4 0 0"><joint name="fold" axis="0 1 0" damping="1"/>
    <inertial mass="1.5" pos="0.15 0 0" diaginertia="0.01 0.02 0.02"/></body></body></body></worldbody>
 <equality><joint name="rod" joint1="fold" joint2="lift" polycoef="0.1 -0.5 0 0 0" solref="0.004 1"/></equality>
</mujoco>"""


def rod_log(reach: float) -> ji.Log:
    """Motors at turn and lift alone, by MuJoCo's forward dynamics; `reach` scales the lift's motion [rad]."""
    model = mujoco.MjModel.from_xml_string(RODS)
    data, rows = mujoco.MjData(model), []
    data.qpos[:] = 0.0, 0.3, 0.1 - 0.5 * 0.3
    for k in range(3000):
        t = k * model.opt.timestep
        want = np.array([0.5 * np.sin(t), 0.3 + reach * np.sin(1.7 * t)])
        data.qfrc_applied[:2] = 900.0 * (want - data.qpos[:2]) - 60.0 * data.qvel[:2]
        mujoco.mj_forward(model, data)
        rows.append((data.qpos.copy(), data.qfrc_applied.copy(), data.qfrc_constraint.copy()))
        mujoco.mj_step(model, data)
    q, tau, constraint = (np.array(x)[500:] for x in zip(*rows, strict=True))
    # The rod carries what holds the forearm: that is why rows of these joints cannot be judged alone.
    assert np.abs(constraint[:, 2]).mean() > 1.0
    names = ("turn", "lift", "fold")
    return ji.Log(time=np.arange(len(q)) * 0.002, joint_names=names, qpos=q, tau=tau)


def rods() -> ji.Robot:
    with pytest.warns(ji.ModelWarning):
        return ji.load_model(mujoco.MjModel.from_xml_string(RODS))


def test_joints_that_follow_one_another_and_move_are_refused():
    robot, log = rods(), rod_log(0.4)
    with pytest.raises(ji.LogError, match=r"^lift, fold follow one another .* tells; .*$"):
        same_joints(robot, [log])
    with pytest.raises(ji.LogError, match=r"^joint 'fold' follows 'lift' .*$"):
        preflight(log, robot).raise_for_errors()
    with pytest.raises(ji.LogError, match="follow one another"):
        same_joints(robot, [log.select(["turn", "lift"])])
    with pytest.raises(ji.LogError, match="follow one another"):
        same_joints(robot, [log.select(["turn", "lift"])], fix={"fold": 0.0})


@pytest.mark.parametrize("joints", [["turn", "lift", "fold"], ["turn", "lift"], ["turn", "fold"]])
def test_joints_that_follow_one_another_are_held_where_they_stand(joints):
    """The rest of the robot is judged exactly: MuJoCo's torque at the turning joint is the held model's."""
    robot, log = rods(), rod_log(0.0)
    held, (same,), (note,) = same_joints(robot, [log.select(joints)])
    assert held.joint_names == same.joint_names == ("turn",)
    assert "stand still: lift at 0.3" in note.message
    assert preflight(same, held).ok
    q = np.asarray(log.qpos)[:, 0]
    v, a = np.gradient(q, 0.002), np.gradient(np.gradient(q, 0.002), 0.002)
    inertia = ji.mass_matrix(held, jnp.asarray(q[:1]))[0, 0]
    left = (log.tau[:, 0] - float(inertia) * a - v)[20:-20]
    assert np.abs(left).max() < 2e-3 * np.abs(log.tau[:, 0]).max()


def test_light_fingers_that_move_are_held_with_a_warning(arm):
    robot, log = arm
    open_and_shut = 0.02 + 0.015 * np.sin(np.asarray(log.time))
    moving = with_joint(log, "finger", 0.0)
    moving.qpos[:, -1] = open_and_shut
    held, (same,), findings = same_joints(robot, [moving])
    assert held.joint_names == same.joint_names == log.joint_names
    assert [str(f.severity) for f in findings] == ["warning"]
    assert "finger at 0.02" in findings[0].message


@pytest.mark.parametrize(
    ("constraint", "what"),
    [
        ('<joint name="bent" joint1="j3" joint2="j4" polycoef="0 1 0.5 0 0"/>', "joint 'bent'"),
        ('<tendon name="belt" tendon1="t"/>', "tendon 'belt'"),
    ],
)
def test_other_equalities_are_closed_loops(constraint, what):
    tendon = '<tendon><fixed name="t"><joint joint="j3" coef="1"/><joint joint="j4" coef="2"/></fixed></tendon>'
    xml = ARMS["large"].replace("</mujoco>", f"{tendon}<equality>{constraint}</equality></mujoco>")
    with pytest.warns(ji.ModelWarning):
        robot = ji.load_model(mujoco.MjModel.from_xml_string(xml))
    with pytest.raises(ji.LogError, match=f"closed loop .{what}"):
        preflight(log_of(ARMS["large"]), robot).raise_for_errors()


def test_a_joint_that_the_model_keeps_in_place(arm):
    """An equality without a second joint: held there, if the log agrees."""
    fixed = '<equality><joint name="lock" joint1="j4" polycoef="0.2 0 0 0 0"/></equality></mujoco>'
    xml = ARMS["large"].replace("</mujoco>", fixed)
    with pytest.warns(ji.ModelWarning):
        robot = ji.load_model(mujoco.MjModel.from_xml_string(xml))
    _, log = arm
    held, (same,), (note,) = same_joints(robot, [log.select(log.joint_names[:4])])
    assert held.joint_names == same.joint_names == log.joint_names[:4]
    assert "j4 at 0.2" in note.message
    with pytest.raises(ji.LogError, match="'j4' moves"):
        same_joints(robot, [log])


def beside(robot_xml: str, body: str) -> str:
    """The arm's model and another body on the world."""
    return robot_xml.replace("</worldbody>", f"{body}</worldbody>")


OTHER_ARM = """<body name="torso" pos="0 0.5 0"><joint name="waist" axis="0 0 1"/>
 <inertial mass="9" pos="0 0 0.2" diaginertia="0.3 0.3 0.1"/><body name="arm" pos="0 0 0.4">
 <joint name="shoulder" axis="0 1 0"/><inertial mass="3" pos="0.2 0 0" diaginertia="0.02 0.05 0.05"/></body></body>"""
WHEEL = """<body name="wheel" pos="0.1 0 0"><joint name="roll" axis="0 1 0" pos="0 0 0.01"/>
 <inertial mass="{mass}" pos="0 0.02 {up}" diaginertia="0.01 0.02 {z}"/></body>"""


def held_beside(xml: str):
    robot, log = ji.load_model(mujoco.MjModel.from_xml_string(xml)), log_of(ARMS["large"])
    held, (same,), notes = same_joints(robot, [log])
    return robot, log, held, same, " ".join(note.message for note in notes)


def test_joints_of_another_branch_may_stand_anywhere():
    _robot, log, held, same, said = held_beside(beside(ARMS["large"], OTHER_ARM))
    assert held.joint_names == log.joint_names
    assert "waist at 0, shoulder at 0: in branches of their own" in said
    assert preflight(same, held).ok
    # Nothing that the log has a torque of depends on them: MuJoCo's own numbers.
    model = mujoco.MjModel.from_xml_string(beside(ARMS["large"], OTHER_ARM))
    data = mujoco.MjData(model)
    own = [model.joint(name).dofadr[0] for name in log.joint_names]
    found = []
    for stands in (0.0, 1.0):
        data.qpos[:] = stands
        data.qpos[own] = np.asarray(log.qpos)[7]
        mujoco.mj_inverse(model, data)
        found.append(data.qfrc_inverse[own].copy())
    np.testing.assert_allclose(found[0], found[1], atol=1e-9)


@pytest.mark.parametrize(
    ("mass", "up", "z", "round_"),
    [(4.0, 0.01, 0.01, True), (4.0, 0.05, 0.01, False), (4.0, 0.01, 0.02, False)],
    ids=["round", "off its axle", "no body of revolution"],
)
def test_a_wheel_may_stand_anywhere_and_a_crank_may_not(mass, up, z, round_):
    end = ARMS["large"].index("</body>")
    xml = ARMS["large"][:end] + WHEEL.format(mass=mass, up=up, z=z) + ARMS["large"][end:]
    _robot, log, held, _same, said = held_beside(xml)
    assert ("roll at 0: in branches of their own, or turning what is round" in said) == round_
    assert (held.joint_names == log.joint_names) == round_
