"""Policies trained in simulators that differ: the arm, the network, late targets, and the numbers of the page."""

import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from benchmarks.policy import __main__ as command
from benchmarks.policy import arm, train


def test_the_hand_is_where_mujoco_has_it():
    spec = mujoco.MjSpec.from_string(arm.MODEL)
    spec.body("lower").add_site(name="hand", pos=[arm.LOWER, 0, 0])
    model = spec.compile()
    data = mujoco.MjData(model)
    for q in np.random.default_rng(0).uniform(-1.5, 1.5, (5, 3)):
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        off = data.site("hand").xpos - np.array([0.0, 0.0, 0.1])
        np.testing.assert_allclose(arm.tip(q), off, atol=1e-12)


def test_a_network_that_adds_nothing_asks_for_the_motion_itself():
    rng = np.random.default_rng(0)
    motion, weights = arm.wanted(rng), rng.normal(size=train.SIZE)
    q, v = motion[3] + 0.05, np.ones(3)
    asked = train.act(weights, q, v, motion, 3)
    assert np.all(np.abs(asked - motion[3]) <= train.MOST)
    weights[-(3 * train.HIDDEN + 3) :] = 0.0
    np.testing.assert_array_equal(train.act(weights, q, v, motion, 3), motion[3])


def test_what_the_real_arm_has_beyond_its_model_makes_it_miss():
    motion = arm.wanted(np.random.default_rng(2))
    seen, sent = arm.moved(lambda k, q, v: motion[k], motion, seed=0)
    np.testing.assert_array_equal(sent, motion[: len(sent)])
    assert np.abs(seen[0] - motion[0]).max() < 1e-2
    off = np.linalg.norm(arm.tip(seen) - arm.tip(motion[: len(seen)]), axis=1)
    assert 0.05 < off.mean() < 0.3


@pytest.mark.slow
def test_late_targets_in_mjx_are_those_of_mujoco():
    """A network that adds nothing, with targets that are late by 0, 7 and 12 steps, against a loop of MuJoCo C."""
    from mujoco import mjx

    model = mujoco.MjModel.from_xml_string(arm.MODEL)
    motion, late = arm.wanted(np.random.default_rng(4)), np.array([0, 7, 12])
    weights = np.zeros(train.SIZE)
    wanted = jnp.asarray(motion)
    found = train.error(mjx.put_model(model), np.arange(3), late, wanted, weights)
    data, off, back = mujoco.MjData(model), [], {}
    data.qpos[:] = motion[0]
    for step in range(round(arm.SECONDS / arm.PERIOD) * arm.STEPS):
        back[step] = motion[step // arm.STEPS]
        data.ctrl[:] = [back.get(step - late[j], motion[0])[j] for j in range(3)]
        mujoco.mj_step(model, data)
        if (step + 1) % arm.STEPS == 0:
            k = (step + 1) // arm.STEPS
            off.append(np.linalg.norm(arm.tip(data.qpos) - arm.tip(motion[k])))
    assert float(found) == pytest.approx(np.mean(off), rel=1e-3)


def test_the_page_has_the_stored_numbers():
    assert command.table() in command.PAGE.read_text()
