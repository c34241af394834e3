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
    assert found.verdict is Verdict.EXPLAINED
    (effect,) = found.odd
    assert (effect.family, effect.place.name) == ("torque_gain", joint)
    number = effect.parameters["gain"]
    assert number.low < gain < number.high


@pytest.mark.slow
def test_what_motors_miss_is_told_joint_by_joint(robot):
    found = diagnose(robot, simulate(motors=MISSED, braking=SOFT))
    assert found.verdict is Verdict.NO_GAP
    assert found.noise_floor == pytest.approx(found.chi2, rel=0.3)
    # The last joints' share stands on what the encoders leave of it.
    assert found.trace.torque_noise[:4] == pytest.approx(MISSED[:4], rel=0.2)


@pytest.mark.slow
def test_a_gain_stands_out_of_the_noise_of_motors(robot):
    gain = np.array([1.0, 1.0, 1.0, 0.9, 1.0])
    found = diagnose(robot, simulate(motors=MISSED, braking=SOFT, gain=gain))
    assert_only_a_gain(found, "axis4", 0.9)
    assert found.trace.torque_noise[:4] == pytest.approx(MISSED[:4], rel=0.25)


@pytest.mark.slow
def test_what_motors_miss_is_told_beside_a_push(robot):
    """A push does not look like noise, and all else does: a log of such commands had been told to lack a cause."""
    found = diagnose(robot, simulate(motors=12 * MISSED, braking=SOFT, push=(40.0, -25.0, 15.0)))
    assert found.verdict is Verdict.EXPLAINED
    (effect,) = found.odd
    assert (effect.family, effect.place.name) == ("push", "segment3")
    assert effect.parameters["start"].value == pytest.approx(3.05, abs=0.1)
    assert found.trace.torque_noise[:4] == pytest.approx(12 * MISSED[:4], rel=0.25)


@pytest.mark.slow
def test_what_a_controller_makes_of_its_encoders_is_no_noise_of_torques(robot):
    """It moves the robot. Taken for noise of the torque it hides a gain that is off by a thousandth."""
    log = simulate(
        motors=np.zeros(JOINTS),
        braking=0.03,
        listens=True,
        gain=np.array([1.0, 1.0, 0.9988, 1.0, 1.0]),
    )
    rough = sensor_noise(log.tau)
    assert np.all(rough > TAU)
    found = diagnose(robot, log)
    assert np.all(found.trace.torque_noise < 0.5 * rough)
    assert_only_a_gain(found, "axis3", 0.9988)


@pytest.mark.slow
def test_a_log_that_states_its_noise_is_believed(robot):
    assert diagnose(robot, simulate()).trace.torque_noise is None


JITTER = 20.0 * TAU


@pytest.mark.slow
def test_commands_between_a_logs_samples_are_no_gap(robot):
    """A loop twice as quick as the log: half of its rough commands are not in it, whatever noise the sensor states."""
    found = diagnose(robot, simulate(jitter=JITTER, braking=SOFT))
    assert found.verdict is Verdict.NO_GAP
    # The mean of two commands, of which the log has one.
    assert found.trace.torque_noise == pytest.approx(JITTER / np.sqrt(2.0), rel=0.3)
    assert any("louder than the noise that the log states" in note for note in found.notes)


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
