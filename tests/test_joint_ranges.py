"""Positions against the model's ranges: units that nobody knows, and stops, by MuJoCo's own limits."""

import dataclasses

import mujoco
import numpy as np
import pytest

import jax_inertia as ji
from jax_inertia.preflight.joint_ranges import end_stops, joint_ranges
from jax_inertia.preflight.preflight import preflight

ARM = """<mujoco><compiler angle="radian"/><option timestep="0.001" integrator="implicitfast"/><worldbody>
<body pos="0 0 1"><joint name="swing" axis="0 1 0" damping="0.3" range="-1.5 {end}" solreflimit="0.01 1"/>
<inertial pos="0 0 -0.3" mass="2" diaginertia="0.02 0.02 0.003"/></body></worldbody>
<actuator><position joint="swing" kp="60" kv="4"/></actuator></mujoco>"""


def recorded(end: float) -> tuple[ji.Robot, ji.Log]:
    """Eight seconds towards targets up to 0.6 rad, of which a stop at `end` lets the joint do what it can."""
    model = mujoco.MjModel.from_xml_string(ARM.format(end=end))
    data, rows = mujoco.MjData(model), []
    for k in range(8000):
        data.ctrl[0] = 0.6 * np.sin(2.2 * k * 1e-3)
        mujoco.mj_step(model, data)
        if k % 4 == 0:
            rows.append([data.time, data.qpos[0], data.actuator_force[0]])
    time, q, tau = np.array(rows).T
    log = ji.Log(time=time, joint_names=("swing",), qpos=q[:, None], tau=tau[:, None])
    return ji.load_model(model), log


def test_a_joint_that_stands_at_its_stop_is_named():
    robot, log = recorded(0.3)
    (found,) = end_stops(log, robot)
    assert "'swing' stands at an end of the model's range for" in found.message
    assert found in preflight(log, robot).of(ji.Severity.WARNING)


def test_a_joint_that_turns_before_its_stop_is_not():
    robot, log = recorded(1.0)
    assert list(end_stops(log, robot)) == []
    still = dataclasses.replace(log, qpos=np.full_like(log.qpos, 1.0))
    assert list(end_stops(still, robot)) == []


GRIPPER = """<mujoco><worldbody><body><joint name="grip" type="slide" axis="1 0 0" range="0 0.04"/>
<inertial pos="0 0 0" mass="0.1" diaginertia="1e-4 1e-4 1e-4"/></body></worldbody></mujoco>"""


@pytest.mark.parametrize(
    ("scale", "named"), [(2500.0, "per cent"), (1000.0, "read as mm"), (1.0, "")]
)
def test_a_unit_that_nobody_knows_is_named_by_how_far_the_joint_moves(scale, named):
    robot = ji.load_model(mujoco.MjModel.from_xml_string(GRIPPER))
    time = np.arange(500) * 0.01
    q = scale * (0.02 + 0.016 * np.sin(time))[:, None]
    log = ji.Log(time=time, joint_names=("grip",), qpos=q, tau=np.zeros_like(q))
    said = " ".join(f.message for f in joint_ranges(log, robot))
    assert (named in said) if named else said == ""
