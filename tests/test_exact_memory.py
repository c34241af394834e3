"""A filter that keeps all samples' likelihood: against generalised least squares, and its ± by Monte Carlo."""

import equinox as eqx
import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from benchmarks.online import honest
from jax_inertia import load_model
from jax_inertia.estimation.online.exact_memory import make_exact_estimator
from jax_inertia.estimation.priors import Load, Tolerance
from jax_inertia.maths import inertial_parameters
from jax_inertia.maths.charts import LogCholeskyUUt
from jax_inertia.signals.differences import Observation
from jax_inertia.signals.generalised_motion import Motion

SLED = """
<mujoco><option gravity="0 0 0"/><worldbody><body name="sled"><joint name="rail" type="slide" axis="1 0 0"/>
<inertial pos="0 0 0" mass="2" diaginertia="0.01 0.01 0.01"/></body></worldbody></mujoco>
"""
STEP, COUNT, SIGMA_F, SIGMA_V = 0.02, 300, 0.05, 0.002


def pushed() -> tuple[Observation, np.ndarray, np.ndarray]:
    """(a sled's log, its accelerations as measured, forces): velocities noisy, accelerations their differences."""
    rng = np.random.default_rng(2)
    time = STEP * np.arange(COUNT + 1)
    v = np.sin(7.0 * time) + 0.5 * np.cos(3.0 * time)
    true = np.diff(v) / STEP
    a = np.diff(v + SIGMA_V * rng.normal(size=len(v))) / STEP
    force = 2.0 * true + SIGMA_F * rng.normal(size=COUNT)
    zero = np.zeros((COUNT, 1))
    motion = Motion(time=time[1:], q=zero, v=zero, tau=force[:, None], valid=zero == 0)
    return Observation(motion, a[:, None]), a, force


@pytest.mark.parametrize("dtype", ["float64", pytest.param("float32", marks=pytest.mark.slow)])
def test_a_sled_is_weighed_as_generalised_least_squares_weighs_it(dtype):
    """σ² of the mass = 1 / aᵀ C⁻¹ a with C of a moving average: noise m n_k / T comes back with the other sign."""
    log, a, force = pushed()
    robot = load_model(mujoco.MjModel.from_xml_string(SLED)).astype(dtype)
    estimator = make_exact_estimator(
        robot, ["sled"], sigma_tau=SIGMA_F, sigma_v=SIGMA_V, prior=Load(20.0), drift=1e12
    )

    def one(state, x):
        return estimator.step(state, x, STEP)

    run = eqx.filter_jit(lambda log: jax.lax.scan(one, estimator.initial(), log))
    state, step = run(jax.tree.map(jnp.asarray, log))
    found = estimator.estimate(state.belief)
    difference = (np.eye(COUNT, COUNT + 1, 1) - np.eye(COUNT, COUNT + 1)) * SIGMA_V * 2.0 / STEP
    covariance = difference @ difference.T + SIGMA_F**2 * np.eye(COUNT)
    weighed = np.linalg.solve(covariance, a)
    sigma = (weighed @ a) ** -0.5
    mass = weighed @ force / (weighed @ a)
    white = 1.0 / np.sqrt(a @ a / np.diag(covariance)[0])
    assert white > 2.5 * sigma  # what noise taken for white would say
    assert float(found.sigma_pi[0, 0]) == pytest.approx(sigma, rel=0.02)
    assert float(found.pi[0, 0]) == pytest.approx(mass, abs=0.3 * sigma)
    assert float(jnp.mean(step.nis)) == pytest.approx(1.0, abs=0.25)
    # What no sample saw is as it was.
    before = estimator.estimate(estimator.initial().belief)
    np.testing.assert_allclose(found.com, before.com, atol=1e-5)


def test_settings_that_cannot_be_are_one_line():
    robot = load_model(mujoco.MjModel.from_xml_string(SLED))
    with pytest.raises(ValueError, match="no body to estimate"):
        make_exact_estimator(robot, [], sigma_v=1e-3)
    with pytest.raises(ValueError, match="reopen_after is"):
        make_exact_estimator(robot, ["sled"], sigma_v=1e-3, reopen_after=-1.0)


@pytest.mark.parametrize("load", [0.1, 1.0, 10.0])
def test_the_load_stated_is_one_sigma_from_the_bare_body(load):
    """Its mass is; its own inertia of a tenth of m r² on three axes adds 3 %."""
    bare = inertial_parameters.from_com(jnp.ones(1), jnp.zeros((1, 3)), 0.02 * jnp.eye(3)[None])
    ball = inertial_parameters.from_com(
        jnp.full(1, load), jnp.zeros((1, 3)), 0.1 * load * 0.2**2 * jnp.eye(3)[None]
    )
    chart = LogCholeskyUUt()
    away = (chart.from_pi(bare + ball) - chart.from_pi(bare))[0]
    covariance = Load(load, 0.2, shape=jnp.asarray(1e3)).covariance(chart, bare)[0]
    assert float(away @ jnp.linalg.solve(covariance, away)) == pytest.approx(1.03, rel=1e-3)


def test_a_prior_asks_a_gpu_for_full_precision():
    """TensorFloat-32 had put it off by up to 38 % of a variance."""
    chart, bare = LogCholeskyUUt(), load_model(mujoco.MjModel.from_xml_string(SLED)).pi
    for prior in (Load(1.0), Load(1.0).of_a_body(), Tolerance(0.1, 0.01)):
        program = str(jax.make_jaxpr(lambda x, p=prior: p.covariance(chart, x))(bare))
        assert "dot_general" in program
        assert "precision=None" not in program


@pytest.mark.slow
@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_its_plus_minus_is_honest(dtype):
    found = honest.trials("small", honest.logs(honest.subject("small"), 64), dtype)
    assert 0.85 <= found["within_2_sigma"] <= 1.0
    assert found["nees_below_95"] >= 0.85
    assert found["nis_per_row"] == pytest.approx(1.0, abs=0.05)


@pytest.mark.slow
def test_windows_in_which_an_arm_turns_bias_nothing():
    """Seven joints at 1 Hz: rows of the windows' mean motion, for the mean rows, had a NEES of twice its mean."""
    found = honest.trials("arm", honest.logs(honest.subject("arm"), 96), "float32")
    assert found["nees_mean_in_bounds"]
