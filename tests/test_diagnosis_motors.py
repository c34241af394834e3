"""Torque noise that a log does not state, and its samples do not show; a chain in MuJoCo C."""

import dataclasses

import mujoco
import numpy as np
import pytest
from chain_log import JOINTS, TAU, chain_xml, simulate

from jax_inertia import load_model
from jax_inertia.diagnosis.entry import diagnose
from jax_inertia.diagnosis.result import Verdict
from jax_inertia.signals.sensor_noise import sensor_noise

MISSED = np.array([0.3, 0.3, 0.15, 0.05, 0.03])
# A controller that answers every jolt writes them into its commands.
SOFT = 0.02


@pytest.fixture(scope="module")
def robot():
    return load_model(mujoco.MjModel.from_xml_string(chain_xml(np.zeros(JOINTS))))


def assert_only_a_gain(found, joint, gain):
    assert found.verdict in (Verdict.EXPLAINED, Verdict.PARTLY)
    (effect,) = found.odd
    assert (effect.family, effect.place.name) == ("torque_gain", joint)
    number = effect.parameters["gain"]
    assert number.low < gain < number.high


@pytest.mark.slow
def test_what_motors_miss_is_told_joint_by_joint(robot):
    found = diagnose(robot, simulate(motors=MISSED, braking=SOFT))
    assert found.verdict is Verdict.NO_GAP


@pytest.mark.slow
def test_a_gain_stands_out_of_the_noise_of_motors(robot):
    gain = np.array([1.0, 1.0, 1.0, 0.9, 1.0])
    found = diagnose(robot, simulate(motors=MISSED, braking=SOFT, gain=gain))
    assert_only_a_gain(found, "axis4", 0.9)


JITTER = 20.0 * TAU


@pytest.mark.slow
def test_a_gain_stands_out_of_the_commands_between_samples(robot):
    gain = np.array([1.0, 1.0, 1.0, 0.8, 1.0])
    found = diagnose(robot, simulate(jitter=JITTER, braking=SOFT, gain=gain))
    assert_only_a_gain(found, "axis4", 0.8)


@pytest.mark.slow
def test_noise_that_samples_do_not_show_is_a_gap(robot):
    """What a log states of its torques is believed where they are no rougher."""
    log = simulate(motors=MISSED, braking=SOFT)
    stated = dataclasses.replace(log, sigma_qpos=np.full(JOINTS, 2e-5), sigma_tau=TAU)
    assert np.all(sensor_noise(log.tau) < 0.3 * MISSED)
    assert diagnose(robot, stated).verdict is Verdict.UNKNOWN
