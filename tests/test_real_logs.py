"""Recorded logs of real arms, with the settings of `benchmarks/real_logs`; skipped where the data are not there."""

import functools

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from benchmarks.real_logs import arms, logs, ur10e
from jax_inertia.estimation import batch_fit
from jax_inertia.estimation.batch_fit import Calibrated
from jax_inertia.maths.inertial_parameters import is_physical

pytestmark = pytest.mark.skipif(
    not logs.SHARED.is_dir(),
    reason=f"recorded logs are not at {logs.SHARED}; JAX_INERTIA_DATA may name their folder",
)


@functools.cache
def free():
    return ur10e.observe(ur10e.FREE)


@functools.cache
def pair():
    return ur10e.observe((ur10e.PAIR_FREE, ur10e.PAIR_PAYLOAD))


@functools.cache
def calibrations():
    repository, _, _, maker = ur10e.calibrations()
    return {"repository": repository, "maker": maker}


@pytest.mark.parametrize("name", [pytest.param("repository", marks=pytest.mark.slow), "maker"])
def test_ur10e_without_load_reads_zero(name):
    """Each free run weighed with bodies, friction and gains of the two others, and the pair's free one."""
    calibration = calibrations()[name]
    weighed = [calibration.weigh(free()[:k] + free()[k + 1 :], free()[k]) for k in range(3)]
    weighed.append(calibration.weigh(free(), pair()[0]))
    masses = [ur10e.mass(fit)[0] for fit in weighed]
    assert np.max(np.abs(masses)) < 0.1
    assert all(0.01 < ur10e.mass(fit)[1] < 0.1 for fit in weighed)


def test_ur10e_s_payload_is_weighed():
    """2.805 kg: gains on the maker's inertias cover it; the repository's gains, taken as exact, are a tenth short."""
    payload = pair()[1]
    value, half = ur10e.mass(calibrations()["maker"].weigh(free(), payload))
    assert abs(value - ur10e.TRUE_KG) < half < 0.25
    value, _ = ur10e.mass(calibrations()["repository"].weigh(free(), payload))
    assert 0.85 * ur10e.TRUE_KG < value < ur10e.TRUE_KG


@pytest.mark.slow
def test_ur10e_online_weighs_the_pair():
    """Five iterations in U Uᵀ on the calibrated model; the load above the calibrated wrist, after the last sample."""
    fit = calibrations()["maker"].fit(free())
    links = np.array([fit.robot.body_index(name) for name in ur10e.LINKS])
    assert np.all(is_physical(fit.robot.pi[links]))
    # As a JAX array: annotations are checked here.
    fit = eqx.tree_at(lambda f: f.noise, fit, jnp.asarray(fit.noise))
    best = Calibrated(fit.robot, fit.gains, fit.bias)
    variant = "LogCholeskyUUt, 5 iterations"
    empty, loaded = (ur10e._filter(best, fit, variant, log)[0][-1] for log in pair())
    assert abs(empty) < 0.1
    assert loaded == pytest.approx(ur10e.TRUE_KG, rel=0.1)


@pytest.mark.slow
def test_lwr_s_residual_shrinks_on_logs_that_the_fit_has_not_seen():
    """Joint by joint, fitted on train_1, judged on the repeat of the motion and on another one."""
    arm = arms.ARMS[1]
    robot = arm.setting.model(arm.model)
    log = arm.setting.observation(robot, arm.train)
    fit = batch_fit.fit(robot, [log], prior=arm.trust, joint_terms=batch_fit.JOINT_TERMS)
    for name in arm.tests:
        other = arm.setting.observation(robot, name)
        before = arms._rms(robot, np.zeros(robot.nv), other)
        after = arms._rms(fit.robot, fit.bias, other)
        assert np.all(before > 5.0)
        assert np.all(after < 0.1 * before), (name, before, after)
    # Sensors behind the gear see no rotor.
    assert np.max(fit.robot.armature - robot.armature) < 0.5
    assert np.all(is_physical(fit.robot.pi))
