"""Friction that turns round over a displacement: a chain with bristles in MuJoCo C."""

import dataclasses

import mujoco
import numpy as np
import pytest
from chain_log import FRICTION, JOINTS, chain_xml, simulate

from jax_inertia import load_model
from jax_inertia.gap import diagnose
from jax_inertia.gap.correct import corrected
from jax_inertia.gap.effect import effects_of
from jax_inertia.gap.rollout import rollouts

NOMINAL = chain_xml(FRICTION)


@pytest.fixture(scope="module")
def robot():
    return load_model(mujoco.MjModel.from_xml_string(NOMINAL))


@pytest.mark.parametrize("reach", [2e-4, 1e-3])
def test_the_displacement_is_found_and_rollouts_stay_at_their_floor(robot, reach):
    """The generator's bristles are straight springs that slip at once, ours (Dahl) bend over."""
    log = simulate(friction=FRICTION, reach=reach)
    found = diagnose(robot, log)
    moved = found.trace.turning
    assert np.all(moved > 0)
    assert np.median(moved) == pytest.approx(reach, rel=0.5)
    sharp = dataclasses.replace(found.trace, turning=np.zeros(JOINTS))
    nominal = mujoco.MjSpec.from_string(NOMINAL)
    correction = corrected(mujoco.MjSpec.from_string(NOMINAL), effects_of(found))
    rolled, stumbling = (rollouts(nominal, correction, robot, log, t) for t in (found.trace, sharp))
    assert rolled is not None
    assert stumbling is not None
    assert rolled.after < 1.3 * rolled.floor
    assert rolled.after < 0.8 * stumbling.after


def test_without_friction_nothing_turns():
    robot = load_model(mujoco.MjModel.from_xml_string(chain_xml(0.0 * FRICTION)))
    assert not diagnose(robot, simulate(seconds=4.0)).trace.turning.any()
