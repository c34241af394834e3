"""What a diagnosis takes for noise, for rest, and for an error of the model: a chain of five joints in MuJoCo C."""

import dataclasses

import mujoco
import numpy as np
import pytest
from chain_log import DAMPING, FRICTION, JOINTS, QPOS, TAU, chain_xml, simulate
from scipy import signal

from jax_inertia import load_model
from jax_inertia.diagnosis.effects.registry import NAMES
from jax_inertia.diagnosis.entry import diagnose
from jax_inertia.diagnosis.result import Verdict
from jax_inertia.logs.log import TorqueKind
from jax_inertia.signals.creep import softness
from jax_inertia.signals.dry_friction import at_rest
from jax_inertia.signals.outliers import without_outliers
from jax_inertia.signals.sensor_noise import resolution, sensor_noise


@pytest.fixture(scope="module")
def robot():
    return load_model(mujoco.MjModel.from_xml_string(chain_xml(np.zeros(JOINTS))))


@pytest.fixture(scope="module")
def rubbing():
    return load_model(mujoco.MjModel.from_xml_string(chain_xml(FRICTION)))


@pytest.mark.slow
def test_frictions_at_all_joints_stand_beside_what_is_not_in_the_library(robot):
    """No one cause looks like dry friction at five joints; twice the damping, which is barred, is left over."""
    barred = [name for name in NAMES if name != "coulomb_friction"]
    log = simulate(2.0 * DAMPING, friction=2.0 * FRICTION)
    found = diagnose(robot, log, exclude=barred, max_effects=5)
    assert found.verdict in (Verdict.EXPLAINED, Verdict.PARTLY)
    assert {e.place.name for e in found.found} == {f"axis{k + 1}" for k in range(JOINTS)}


@pytest.mark.slow
def test_a_weight_comes_before_what_is_not_in_the_library():
    """Beside torques of no cause within the motion's band, tolerances twice as wide as stated carried half of it."""
    model = mujoco.MjModel.from_xml_string(chain_xml(np.zeros(JOINTS)))
    model.body_mass[-1] *= 0.8
    model.body_inertia[-1] *= 0.8
    log = simulate()
    noise = np.random.default_rng(8).standard_normal(log.tau.shape)
    band = signal.butter(2, [0.3, 2.5], "bandpass", fs=log.rate, output="sos")
    wander = signal.sosfiltfilt(band, noise, axis=0)
    wander *= 0.02 * np.std(log.tau, axis=0) / np.std(wander, axis=0)
    found = diagnose(load_model(model), dataclasses.replace(log, tau=log.tau + wander))
    assert found.verdict in (Verdict.UNKNOWN, Verdict.PARTLY)
    first = found.odd[0]
    assert (first.family, first.place.name) == ("payload", "segment5")


@pytest.mark.slow
def test_a_friction_beyond_its_tolerance_is_no_absence_of_a_gap():
    """The only friction of its kind, so that no other tells how good such numbers are."""
    friction = np.array([0.0, 0.0, 0.5, 0.0, 0.0])
    robot = load_model(mujoco.MjModel.from_xml_string(chain_xml(friction)))
    found = diagnose(robot, simulate(friction=1.25 * friction))
    assert found.verdict is Verdict.UNKNOWN
    assert "coulomb friction of axis3 is off by" in found.headline


@pytest.mark.slow
def test_dampings_that_are_all_off_by_as_much_are_a_model_slightly_off(robot):
    wrong = DAMPING * (1 + 0.07 * np.array([1.0, -1.0, 1.2, -0.8, 1.0]))
    found = diagnose(robot, simulate(wrong))
    assert found.verdict is Verdict.NO_GAP


@pytest.mark.slow
def test_an_effect_that_a_tolerance_swallows_is_no_absence_of_a_gap(robot):
    wrong = DAMPING * np.array([1.0, 1.0, 1.4, 1.0, 1.0])
    found = diagnose(robot, simulate(wrong), exclude=["viscous_friction", "friction_drift"])
    assert found.verdict is Verdict.UNKNOWN


@pytest.mark.slow
def test_a_robot_that_stops_with_its_known_friction_has_no_gap(rubbing):
    found = diagnose(rubbing, simulate(friction=FRICTION, stops=True))
    assert found.verdict is Verdict.NO_GAP


def test_standing_still_is_refused_in_one_line(robot):
    log = simulate(seconds=3.0)
    still = np.tile(np.asarray(log.qpos)[:1], (len(log.time), 1))
    noise = QPOS * np.random.default_rng(0).standard_normal(still.shape)
    with pytest.raises(ValueError, match="no joint moves by more than 1 mrad"):
        diagnose(robot, dataclasses.replace(log, qpos=still + noise))


@pytest.mark.slow
def test_a_torque_sensors_sample_may_be_of_the_period_that_follows(robot):
    log = dataclasses.replace(simulate(seconds=5.0), tau_kind=TorqueKind.SENSOR)
    assert diagnose(robot, log).verdict is Verdict.NO_GAP


@pytest.mark.slow
def test_noise_of_a_torque_sensor_is_no_lag(robot):
    # A lagged torque is a smoother one, and so has less of its own noise.
    log = simulate(seconds=5.0)
    noise = 10 * TAU * np.random.default_rng(3).standard_normal(log.tau.shape)
    loud = dataclasses.replace(log, tau=log.tau + noise, sigma_tau=10 * TAU)
    assert diagnose(robot, loud).verdict is Verdict.NO_GAP


@pytest.mark.parametrize("draw", ["normal", "laplace"])
def test_unstated_noise_is_measured_with_its_tails_and_without_impacts(draw):
    rng = np.random.default_rng(0)
    noise = {
        "normal": lambda: rng.normal(size=(4000, 3)),
        "laplace": lambda: rng.laplace(scale=np.sqrt(0.5), size=(4000, 3)),
    }[draw]()
    x = 0.01 * noise + np.sin(np.linspace(0, 30, 4000))[:, None]
    x[1000:] += 3.0
    assert sensor_noise(x, None) == pytest.approx(0.01 * np.ones(3), rel=0.05)


@pytest.mark.parametrize("fastest", [0.3, 30.0])
def test_a_coarse_encoder_is_as_noisy_as_its_steps(fastest):
    """Slow motion repeats most samples, so that their third differences say nothing; fast motion dithers itself."""
    step = 1e-3
    x = np.sin(np.linspace(0, fastest, 4000) ** 2 / fastest)[:, None]
    coarse = step * np.round(x / step)
    assert sensor_noise(coarse, None) == pytest.approx([step / np.sqrt(12)], rel=0.1)
    rng = np.random.default_rng(0)
    assert resolution(x[:, 0]) == 0.0
    assert resolution(x[:, 0] + 1e-4 * rng.normal(size=4000)) == 0.0
    assert resolution(coarse[:, 0]) == pytest.approx(step)


def test_at_rest_is_slow_for_long():
    v = np.full((500, 3), 0.5)
    v[100:200, 0] = 0.001  # 0.4 s: rest
    v[100:105, 1] = 0.001  # 20 ms: a reversal
    rest = at_rest(v, 250.0)
    assert rest[110:190, 0].all()
    assert not rest[:, 1:].any()


def test_a_joint_that_creeps_by_its_own_friction_is_at_rest():
    """Held by half its friction in MuJoCo C it creeps at half the speed that `softness` tells."""
    friction = np.full(JOINTS, 1.0)
    model = mujoco.MjModel.from_xml_string(chain_xml(friction))
    data = mujoco.MjData(model)
    for _ in range(1000):
        data.qfrc_applied[:] = data.qfrc_bias + 0.5 * friction
        mujoco.mj_step(model, data)
    creeping = friction * softness(load_model(model))
    np.testing.assert_allclose(data.qvel, 0.5 * creeping, rtol=0.1)
    v = np.tile(data.qvel, (200, 1))
    assert not at_rest(v, 250.0)[:, -1].any()
    assert at_rest(v, 250.0, creeping)[10:-10].all()


def test_repeated_and_struck_samples_are_replaced_and_the_rest_is_left():
    t = np.arange(1500) / 250.0
    rng = np.random.default_rng(4)
    clean = np.stack([np.sin(3 * t), 0.4 * np.cos(7 * t), 0.2 * t], axis=1)
    noisy = clean + QPOS * rng.standard_normal(clean.shape)
    bad = noisy.copy()
    for k in (120, 480, 900, 1201):
        bad[k, 0] = bad[k - 1, 0]
    # Two close together: neither fits with the other as it is.
    for k in (1000, 1002, 1100, 1101):
        bad[k, 0] = bad[k - 1, 0]
    bad[700, 1] += 0.01
    mended = without_outliers(bad)
    assert np.abs(mended - clean).max() < 6 * QPOS
    changed = np.flatnonzero(np.any(mended != bad, axis=1))
    assert set(changed) <= {120, 480, 700, 900, 1000, 1002, 1100, 1101, 1201}
    assert {120, 900, 700} <= set(changed)


def test_an_impact_and_a_coarse_encoder_are_no_outliers():
    t = np.arange(1500) / 250.0
    rng = np.random.default_rng(5)
    corner = 0.5 * np.abs(t - 3.0) + QPOS * rng.standard_normal(t.shape)
    coarse = np.round(np.sin(2 * t) / 1e-3) * 1e-3
    both = np.stack([corner, coarse], axis=1)
    np.testing.assert_array_equal(without_outliers(both), both)
