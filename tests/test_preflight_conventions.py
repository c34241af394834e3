"""Logs that mean by a joint, a torque or an angle another thing than the model: one line; arms by MuJoCo C."""

import dataclasses

import mujoco
import numpy as np
import pytest
from arm_log import ARM, loaded, simulate
from chain_log import JOINTS, chain_xml
from chain_log import simulate as simulate_chain

from jax_inertia import load_model
from jax_inertia.logs.log import LogError
from jax_inertia.preflight.preflight import preflight


@pytest.fixture(scope="module")
def arm():
    """An arm that carries what its model does not know, so that no reading of its log fits without an effect."""
    return load_model(mujoco.MjModel.from_xml_string(ARM)), simulate(edit=loaded(0.2, (0, 0, -0.3)))


@pytest.fixture(scope="module")
def chain():
    return load_model(mujoco.MjModel.from_xml_string(chain_xml(np.zeros(JOINTS)))), simulate_chain()


def refused(robot, log) -> str:
    with pytest.raises(LogError) as caught:
        preflight(log, robot).raise_for_errors()
    message = str(caught.value)
    assert "\n" not in message
    return message


def test_a_log_and_its_model_that_agree_pass(arm, chain):
    """And the same two with a torque turned do not: what passes is not all that comes."""
    for robot, log in (arm, chain):
        preflight(log, robot).raise_for_errors()
        assert "tau" in refused(robot, dataclasses.replace(log, tau=-log.tau))


def test_torques_of_the_load_are_turned(arm):
    robot, log = arm
    message = refused(robot, dataclasses.replace(log, tau=-log.tau))
    assert "tau of every joint is minus what the model needs" in message


def test_one_torque_with_its_sign_turned_is_named(chain):
    robot, log = chain
    sign = np.array([1.0, 1.0, -1.0, 1.0, 1.0])
    message = refused(robot, dataclasses.replace(log, tau=sign * log.tau))
    assert message.startswith("tau of axis3 is minus")


def test_torques_in_another_order_are_told_joint_by_joint(chain):
    robot, log = chain
    message = refused(robot, dataclasses.replace(log, tau=log.tau[:, [0, 2, 1, 3, 4]]))
    assert "tau of 'axis2' is what 'axis3' needs" in message
    assert "tau of 'axis3' is what 'axis2' needs" in message


def test_degrees_are_no_radians(arm):
    robot, log = arm
    assert "degrees" in refused(robot, dataclasses.replace(log, qpos=np.rad2deg(log.qpos)))


@pytest.mark.parametrize("joint", [1, 2, 3])
def test_a_joint_that_runs_the_other_way_is_named(chain, joint):
    """Its encoder and its torque both: the log is consistent, and the model is not."""
    robot, log = chain
    sign = np.where(np.arange(JOINTS) == joint, -1.0, 1.0)
    message = refused(robot, dataclasses.replace(log, qpos=sign * log.qpos, tau=sign * log.tau))
    assert f"'axis{joint + 1}' runs the other way" in message
