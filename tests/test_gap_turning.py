"""Friction that turns round over a displacement: a chain with bristles in MuJoCo C."""

import dataclasses

import mujoco
import numpy as np
import pytest
from arm_log import ARM
from arm_log import simulate as simulate_arm
from chain_log import DAMPING, FRICTION, JOINTS, chain_xml, simulate

from jax_inertia import load_model
from jax_inertia.diagnosis.features.context import Context
from jax_inertia.diagnosis.simulate.corrected import corrected
from jax_inertia.diagnosis.simulate.rollout import rollouts
from jax_inertia.gap import Verdict, diagnose
from jax_inertia.gap.families import LIBRARY
from jax_inertia.gap.finder import finder
from jax_inertia.gap.finding import effects_of, known_of
from jax_inertia.gap.nuisance import Tolerance
from jax_inertia.gap.propose import propose
from jax_inertia.gap.search import search
from jax_inertia.gap.turning import CREEPS
from jax_inertia.signals.torque_residual import prepare

NOMINAL = chain_xml(FRICTION)


@pytest.fixture(scope="module")
def robot():
    return load_model(mujoco.MjModel.from_xml_string(NOMINAL))


@pytest.mark.slow
@pytest.mark.parametrize("reach", [2e-4, 1e-3])
def test_the_displacement_is_found_and_rollouts_stay_at_their_floor(robot, reach):
    """The generator's bristles are straight springs that slip at once, ours (Dahl) bend over."""
    log = simulate(friction=FRICTION, reach=reach)
    found = diagnose(robot, log)
    moved = found.trace.turning
    assert np.all(moved > 0)
    assert np.median(moved) == pytest.approx(reach, rel=0.5)
    given = known_of(found, robot, log)
    sharp = dataclasses.replace(given, turning=np.zeros(JOINTS))
    nominal = mujoco.MjSpec.from_string(NOMINAL)
    correction = corrected(mujoco.MjSpec.from_string(NOMINAL), effects_of(found))
    rolled, stumbling = (rollouts(nominal, correction, robot, log, t) for t in (given, sharp))
    assert rolled is not None
    assert stumbling is not None
    assert rolled.after < 1.3 * rolled.floor
    assert rolled.after < 0.8 * stumbling.after


@pytest.mark.slow
def test_rollouts_of_a_robot_that_creeps_let_it_creep():
    friction = 3.0 * FRICTION
    nominal = mujoco.MjSpec.from_string(chain_xml(friction))
    robot = load_model(nominal.compile())
    log = simulate(soft=friction, damping=DAMPING * np.array([1.0, 1.0, 3.0, 1.0, 1.0]), stops=True)
    found = diagnose(robot, log)
    (effect,) = found.findings
    assert (effect.family, effect.place.name) == ("viscous_friction", "axis3")
    assert np.all(found.trace.turning == CREEPS)
    given = known_of(found, robot, log)
    sharp = dataclasses.replace(given, turning=np.zeros(JOINTS))
    correction = corrected(nominal.copy(), effects_of(found))
    rolled, stumbling = (rollouts(nominal, correction, robot, log, t) for t in (given, sharp))
    assert rolled is not None
    assert stumbling is not None
    assert rolled.after < 1.2 * rolled.floor
    assert rolled.after < 0.8 * stumbling.after


@pytest.mark.slow
@pytest.mark.parametrize("joint", [3, 4])
def test_friction_that_creeps_is_friction(joint):
    """A robot that is MuJoCo with friction loss, its model without."""
    robot = load_model(mujoco.MjModel.from_xml_string(chain_xml(0.0 * FRICTION)))
    soft = np.where(np.arange(JOINTS) == joint, 0.5, 0.0)
    found = diagnose(robot, simulate(soft=soft, stops=True))
    assert found.verdict is Verdict.EXPLAINED
    (effect,) = found.findings
    assert (effect.family, effect.place.name) == ("coulomb_friction", f"axis{joint + 1}")
    assert effect.parameters["coulomb"].value == pytest.approx(0.5, rel=0.02)


@pytest.mark.slow
def test_a_joint_has_one_dry_friction():
    robot = load_model(mujoco.MjModel.from_xml_string(chain_xml(0.0 * FRICTION)))
    log = simulate(friction=np.where(np.arange(JOINTS) == 2, 0.5, 0.0))
    ready = finder(prepare(robot, log), log, Tolerance(), list(LIBRARY), 1)
    found = search(ready, ready.white)
    (rubbing,) = found.chosen
    assert rubbing.key == ("coulomb_friction", "joint", "axis3")
    dry = [c for c in propose(found.pool, found.chosen, found.noise_by_row) if c.family.law_of]
    assert dry
    assert all(c.place != rubbing.place for c in dry)


@pytest.mark.slow
def test_without_friction_nothing_turns():
    robot = load_model(mujoco.MjModel.from_xml_string(chain_xml(0.0 * FRICTION)))
    assert not diagnose(robot, simulate(seconds=4.0)).trace.turning.any()


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
def test_joints_that_halt_as_they_turn_round_have_no_gap(friction):
    """For some hundredths of a second the model's own friction holds them, and is then whatever balances."""
    shoulder, elbow = friction
    own = ARM.replace('damping="0.3"', f'damping="0.3" frictionloss="{shoulder}"')
    own = own.replace('damping="0.2"', f'damping="0.2" frictionloss="{elbow}"')
    robot = load_model(mujoco.MjModel.from_xml_string(own))

    def turning(t, q, v, u):
        return -np.array(friction) * np.tanh(v / 0.004)

    found = diagnose(robot, simulate_arm(turning, noise=0.3, seed=2))
    assert found.verdict is Verdict.NO_GAP


@pytest.mark.slow
def test_a_found_friction_may_turn_round_over_another_displacement_elsewhere():
    """A log does not always tell over which; a cold gearbox has another than a warm one."""
    robot = load_model(mujoco.MjModel.from_xml_string(chain_xml(np.zeros(JOINTS))))
    friction = np.array([0.0, 0.0, 1.0, 0.0, 0.0])
    log = simulate(friction=friction, reach=1e-4)
    found = diagnose(robot, log, test_log=simulate(friction=friction, reach=3e-3, seed=4))
    assert found.verdict is Verdict.EXPLAINED
    (effect,) = found.findings
    assert (effect.family, effect.place.name) == ("coulomb_friction", "axis3")
    assert found.test is not None
    assert found.test.after < 0.06 * found.test.before
