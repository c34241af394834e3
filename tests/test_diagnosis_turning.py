"""Friction that turns round over a displacement: a chain with bristles in MuJoCo C."""

import mujoco
import numpy as np
import pytest
from arm_log import ARM
from arm_log import simulate as simulate_arm
from chain_log import FRICTION, JOINTS, chain_xml, simulate

from jax_inertia import load_model
from jax_inertia.diagnosis.entry import diagnose
from jax_inertia.diagnosis.features.context import Context
from jax_inertia.diagnosis.result import Verdict

NOMINAL = chain_xml(FRICTION)


@pytest.fixture(scope="module")
def robot():
    return load_model(mujoco.MjModel.from_xml_string(NOMINAL))


@pytest.mark.slow
@pytest.mark.parametrize("joint", [3, 4])
def test_friction_that_creeps_is_friction(joint):
    """A robot that is MuJoCo with friction loss, its model without."""
    robot = load_model(mujoco.MjModel.from_xml_string(chain_xml(0.0 * FRICTION)))
    soft = np.where(np.arange(JOINTS) == joint, 0.5, 0.0)
    found = diagnose(robot, simulate(soft=soft, stops=True))
    assert found.verdict is Verdict.EXPLAINED
    (effect,) = found.odd
    assert (effect.family, effect.place.name) == ("coulomb_friction", f"axis{joint + 1}")
    assert effect.parameters["coulomb"].value == pytest.approx(0.5, rel=0.02)


def test_a_joint_creeps_as_mujoco_s_soft_constraint_lets_it():
    friction = 3.0 * FRICTION
    model = mujoco.MjModel.from_xml_string(chain_xml(friction))
    data, rows = mujoco.MjData(model), []
    for k in range(4000):
        pull = np.sin(2 * np.pi * np.arange(1, JOINTS + 1) * 0.4 * k * model.opt.timestep)
        data.qfrc_applied[:] = data.qfrc_bias + 1.3 * friction * pull
        mujoco.mj_step(model, data)
        mujoco.mj_forward(model, data)
        rows.append(np.array([data.qvel, data.qacc, data.qfrc_constraint / friction]))
    v, a, held = np.stack(rows, axis=1)
    context = Context.__new__(Context)
    vars(context).update(robot=load_model(model), v=v, a=a, _slides={})
    for row in range(JOINTS):
        creeps = np.abs(held[:, row]) < 0.95
        assert creeps.sum() > 200
        error = context.creeping(row, friction[row], np.inf) + held[:, row]
        assert np.median(np.abs(error[creeps])) < 0.03


@pytest.mark.slow
@pytest.mark.parametrize("encoder", [2e-5, 2e-4])
def test_a_model_whose_own_friction_creeps_has_no_gap(encoder):
    """However rough the encoders make the accelerations by which it is seen to creep."""
    friction = FRICTION + np.array([0.0, 0.0, 0.0, 1.0, 1.0])
    robot = load_model(mujoco.MjModel.from_xml_string(chain_xml(friction)))
    found = diagnose(robot, simulate(soft=friction, stops=True, encoder=encoder))
    assert found.verdict is Verdict.NO_GAP


@pytest.mark.parametrize("friction", [(1.0, 0.5), (2.0, 1.0)])
def test_joints_that_halt_as_they_turn_round_have_no_effect(friction):
    """For some hundredths of a second the model's own friction holds them, and is then whatever balances.

    What is left, the robot's law of turning round being another than the model's, is below 1 % of the friction.
    """
    shoulder, elbow = friction
    own = ARM.replace('damping="0.3"', f'damping="0.3" frictionloss="{shoulder}"')
    own = own.replace('damping="0.2"', f'damping="0.2" frictionloss="{elbow}"')
    robot = load_model(mujoco.MjModel.from_xml_string(own))

    def turning(t, q, v, u):
        return -np.array(friction) * np.tanh(v / 0.004)

    found = diagnose(robot, simulate_arm(turning, noise=0.3, seed=2))
    assert not found.odd
    assert found.verdict in (Verdict.NO_GAP, Verdict.UNKNOWN)
    assert found.checked.after < 0.01 * max(friction)


@pytest.mark.slow
def test_a_found_friction_may_turn_round_over_another_displacement_elsewhere():
    """A log does not always tell over which; a cold gearbox has another than a warm one."""
    robot = load_model(mujoco.MjModel.from_xml_string(chain_xml(np.zeros(JOINTS))))
    friction = np.array([0.0, 0.0, 1.0, 0.0, 0.0])
    log = simulate(friction=friction, reach=1e-4)
    found = diagnose(robot, log, test_log=simulate(friction=friction, reach=3e-3, seed=4))
    assert found.verdict in (Verdict.EXPLAINED, Verdict.PARTLY)
    (effect,) = found.odd
    assert (effect.family, effect.place.name) == ("coulomb_friction", "axis3")
    assert found.test is not None
    assert found.test.after < 0.4 * found.test.before
