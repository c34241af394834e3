"""Bands of a log by its rate, and logs from 20 Hz through both analyses."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jax_inertia import load_model
from jax_inertia.diagnosis.entry import diagnose
from jax_inertia.diagnosis.result import Verdict
from jax_inertia.estimation import batch_fit, log_filter
from jax_inertia.estimation.priors import Load
from jax_inertia.logs.log import LogError
from jax_inertia.robots.pendulum import double_pendulum, swing
from jax_inertia.signals.bands import (
    DIAGNOSIS,
    DIAGNOSIS_IN_CONTACT,
    ESTIMATE,
    SLOWEST,
    Bands,
    of_estimate,
    smooth_order,
)
from jax_inertia.signals.differences import central_differences
from jax_inertia.signals.filtering import low_pass, resample
from jax_inertia.signals.generalised_motion import generalised
from jax_inertia.signals.sensor_noise import sensor_noise
from jax_inertia.signals.torque_residual import below, prepare

EVERY = (ESTIMATE, DIAGNOSIS, DIAGNOSIS_IN_CONTACT)


@pytest.fixture(scope="module")
def robot():
    return load_model(double_pendulum())


@given(st.floats(SLOWEST, 2000.0), st.sampled_from(EVERY))
def test_every_filter_fits_every_log(rate, analysis):
    bands = analysis.at(rate)
    assert 0 < bands.cutoff <= bands.before < 0.45 * bands.grid
    assert bands.grid <= rate
    # Nothing of the band is lost by keeping fewer rows, and no filter's end is kept.
    assert 2 * bands.cutoff <= bands.rows <= bands.grid
    assert bands.margin * bands.cutoff >= 1 - 1e-12


@given(st.floats(100.0, 2000.0))
def test_a_fast_log_has_the_bands_that_are_wanted(rate):
    assert ESTIMATE.at(rate) == Bands(100.0, 10.0, 10.0, 20.0, 0.1)
    assert DIAGNOSIS.at(rate) == Bands(min(rate, 250.0), 40.0, 10.0, 50.0, 0.25)
    if rate >= 200.0:
        assert DIAGNOSIS_IN_CONTACT.at(rate) == Bands(min(rate, 250.0), 80.0, 20.0, 100.0, 0.25)
    assert smooth_order(rate) == 3


def test_of_a_fast_log_every_number_is_that_of_fixed_filters(robot):
    """To the last bit: rates and cut-offs that were written down before logs had bands."""
    log = swing(load=0.5, rate=500.0)
    seen = log_filter.observe(log, robot)
    plain = central_differences(generalised(low_pass(resample(log, 100.0), 10.0), robot))
    np.testing.assert_array_equal(seen.a, np.asarray(plain.a)[10:-10])
    np.testing.assert_array_equal(seen.motion.tau, np.asarray(plain.motion.tau)[10:-10])
    assert log_filter.stride(seen) == 5
    bare = dataclasses.replace(log, qvel=None)
    wide = central_differences(generalised(low_pass(resample(bare, 250.0), 40.0), robot))
    prepared = prepare(robot, log)
    np.testing.assert_array_equal(prepared.observation.a, wide.a)
    np.testing.assert_array_equal(prepared.kept, np.arange(62, len(wide.a) - 62, 5))


def test_what_is_given_is_taken_as_it_is():
    assert of_estimate(50.0, cutoff=8.0) == Bands(50.0, 8.0, 8.0, 16.0, 0.125)
    assert of_estimate(500.0, grid=250.0).cutoff == 10.0
    assert of_estimate(500.0, grid=30.0).cutoff == 6.0


def test_a_low_pass_above_what_a_grid_holds_changes_nothing():
    x = np.random.default_rng(0).standard_normal((200, 2))
    np.testing.assert_array_equal(below(40.0, x, 50.0), x)
    assert np.std(below(10.0, x, 50.0)) < 0.8


@pytest.mark.parametrize("rate", [19.3, 20.0])
def test_clocks_may_be_off(robot, rate):
    assert log_filter.observe(swing(rate=rate), robot).a.shape[1] == 2


def test_a_log_below_20_hz_is_refused_in_one_line_that_says_what_is_needed(robot):
    log = swing(rate=10.0, seconds=20.0)
    for use in (lambda: log_filter.observe(log, robot), lambda: diagnose(robot, log)):
        with pytest.raises(LogError, match=r"10 samples a second.*at least 20") as caught:
            use()
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("rate", [20.0, 30.0, 60.0, 80.0])
@pytest.mark.slow
def test_a_load_is_weighed_at_every_rate(robot, rate):
    seen = log_filter.observe(swing(load=0.5, seconds=10.0, rate=rate), robot)
    assert log_filter.stride(seen) == (2 if rate <= 50.0 else round(rate / 20.0 - 0.49))
    fit = batch_fit.fit(robot, [seen], ["lower"], prior=Load(1.0))
    lower = robot.pi[robot.body_index("lower")]
    # At 20 Hz mass and inertia hang together: the moment is known, the mass as well as its interval says.
    sure = max(0.02, 2.0 * float(fit.estimate.sigma_pi[0, 0]))
    assert fit.estimate.pi[0, 0] - lower[0] == pytest.approx(0.5, abs=sure)
    assert fit.estimate.pi[0, 3] - lower[3] == pytest.approx(-0.25, abs=0.005)
    assert sure < 0.1


@pytest.mark.slow
def test_at_50_hz_the_filter_weighs_a_load(robot):
    seen = log_filter.observe(swing(load=0.5, seconds=10.0, rate=50.0), robot)
    fit = batch_fit.fit(robot, [seen], ["lower"], prior=Load(1.0))
    noise = fit.noise / np.sqrt(log_filter.stride(seen))
    ekf = log_filter.online(robot, ["lower"], noise, prior=Load(1.0))
    _, trace = log_filter.run(ekf, ekf.initial(), log_filter.thinned(seen))
    body, sigma = robot.body_index("lower"), float(trace.estimate.sigma_pi[-1, 0, 0])
    assert sigma < 0.03
    for found in (trace.estimate.pi[-1, 0, 0], fit.estimate.pi[0, 0]):
        assert float(found) - float(robot.pi[body, 0]) == pytest.approx(0.5, abs=2.5 * sigma)


@pytest.mark.parametrize("rate", [20.0, 50.0, 100.0, 500.0])
def test_noise_is_told_from_motion_at_every_rate(rate):
    time = np.arange(4000) / rate
    motion = 0.5 * np.sin(2 * np.pi * 0.7 * time) + 0.2 * np.sin(2 * np.pi * 1.6 * time)
    noise = 1e-3 * np.random.default_rng(1).standard_normal(len(time))
    found = sensor_noise((motion + noise)[:, None], order=smooth_order(rate))
    assert found == pytest.approx([1e-3], rel=0.1)


@pytest.mark.slow
def test_a_load_is_named_at_30_hz(robot):
    found = diagnose(robot, swing(load=0.5, seconds=12.0, rate=30.0))
    assert found.verdict is Verdict.EXPLAINED
    (effect,) = found.odd
    assert (effect.family, effect.place.name) == ("payload", "lower")
    assert effect.parameters["mass"].value == pytest.approx(0.5, abs=0.02)
