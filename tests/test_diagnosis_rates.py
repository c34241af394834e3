"""Fast motions in logs of few samples a second: by MuJoCo C, sampled down."""

import dataclasses

import mujoco
import numpy as np
import pytest
from arm_log import ARM, simulate

from jax_inertia import load_model
from jax_inertia.diagnosis.entry import diagnose
from jax_inertia.diagnosis.result import Verdict


@pytest.fixture(scope="module")
def robot():
    return load_model(mujoco.MjModel.from_xml_string(ARM))


def seldom(torque, every):
    """A log of motion up to 2 Hz and beyond, every so many samples of 500 Hz."""
    log = simulate(torque, pace=2.5)
    pick = slice(None, None, every)
    return dataclasses.replace(log, time=log.time[pick], qpos=log.qpos[pick], tau=log.tau[pick])


@pytest.mark.slow
@pytest.mark.parametrize("every", [pytest.param(2, marks=pytest.mark.slow), 5])
def test_a_fast_motion_seldom_sampled_is_no_gap(robot, every):
    """At 5 Hz, second-order differences lose 3 % of an acceleration in 100 Hz, torques put off along lines 1 %."""
    found = diagnose(robot, seldom(lambda t, q, v, u: np.zeros(2), every))
    assert found.verdict is Verdict.NO_GAP


@pytest.mark.slow
def test_a_weak_motor_is_sized_in_a_log_of_100_hz(robot):
    found = diagnose(robot, seldom(lambda t, q, v, u: np.array([0.0, -0.03 * u[1]]), 5))
    assert found.verdict in (Verdict.EXPLAINED, Verdict.PARTLY)
    (effect,) = found.odd
    assert (effect.family, effect.place.name) == ("torque_gain", "elbow")
    assert effect.parameters["gain"].value == pytest.approx(0.97, abs=1e-3)
