"""Noise of accelerations told apart from that of torques: what errors in variables do to a mass, and what is left."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from excitation import compiled, loaded, log_of

import jax_inertia as ji
from jax_inertia.estimation.inertial_filter import Estimator, make_estimator
from jax_inertia.estimation.priors import Load
from jax_inertia.maths import charts
from jax_inertia.signals.differences import Observation
from jax_inertia.signals.generalised_motion import Motion

FAST = {"xla_backend_optimization_level": 0}
STILL = Load(0.0)
SLED = """
<mujoco><option gravity="0 0 0"/><worldbody><body name="sled"><joint name="rail" type="slide" axis="1 0 0"/>
<inertial pos="0 0 0" mass="2" diaginertia="0.01 0.01 0.01"/></body></worldbody></mujoco>
"""
TRUE = 2.6  # kg


@eqx.filter_jit(compiler_options=FAST)
def run(estimator: Estimator, state, observations):
    return estimator.run(state, observations)


def pushed_sled(sigma_a: float, sigma_tau: float, samples: int = 4000) -> Observation:
    """A sled that noisy forces push along a rail, its acceleration as noisy: MuJoCo's inverse dynamics."""
    plant = mujoco.MjModel.from_xml_string(SLED.replace('mass="2"', f'mass="{TRUE}"'))
    data = mujoco.MjData(plant)
    rng = np.random.default_rng(0)
    time = 0.01 * np.arange(samples)
    a = np.sin(7.0 * time) + np.cos(11.0 * time)
    force = np.empty(samples)
    for k in range(samples):
        data.qacc[:] = a[k]
        mujoco.mj_inverse(plant, data)
        force[k] = data.qfrc_inverse[0]
    zero = np.zeros((samples, 1))
    tau = force + sigma_tau * rng.normal(size=samples)
    valid = np.ones((samples, 1), bool)
    motion = Motion(time=time, q=zero, v=zero, tau=tau[:, None], valid=valid)
    return Observation(motion, (a + sigma_a * rng.normal(size=samples))[:, None])


@pytest.mark.parametrize(("sigma_a", "sigma_tau"), [(1.0, 0.3), (0.5, 2.0)])
def test_a_noisy_acceleration_gives_deming_s_slope_and_not_least_squares(sigma_a, sigma_tau):
    """y = m x, both noisy, ratio of their variances δ known: closed forms of both slopes.

    m = (s − δ s_xx + √((s_yy − δ s_xx)² + 4 δ s_xy²)) / 2 s_xy with s = s_yy (Deming 1943), least squares s_xy / s_xx.
    """
    log = pushed_sled(sigma_a, sigma_tau)
    robot = ji.load_model(mujoco.MjModel.from_xml_string(SLED))
    x, y = log.a[:, 0], log.motion.tau[:, 0]
    xx, xy, yy, delta = x @ x, x @ y, y @ y, (sigma_tau / sigma_a) ** 2
    deming = (yy - delta * xx + np.sqrt((yy - delta * xx) ** 2 + 4 * delta * xy**2)) / (2 * xy)
    assert xy / xx < 0.85 * TRUE
    assert deming == pytest.approx(TRUE, rel=0.05)
    masses = []
    for options in (
        {"sigma_tau": np.hypot(sigma_tau, TRUE * sigma_a)},
        {"sigma_tau": sigma_tau, "sigma_a": sigma_a},
    ):
        estimator = make_estimator(
            robot,
            ["sled"],
            prior=Load(3.0),
            drift=STILL,
            chart=charts.Linear(),
            paper=True,
            **options,
        )
        _, trace = run(estimator, estimator.initial(), log)
        masses.append(float(trace.estimate.pi[-1, 0, 0]))
    # The filter sees each sample once, from where it then stands: its first ones cost it 2 %.
    assert masses[0] == pytest.approx(xy / xx, rel=0.01)
    assert masses[1] == pytest.approx(deming, rel=0.03)


def arm(dtype=None, **options) -> tuple[Estimator, Observation]:
    """A filter that a load of 2.4 kg on the tip surprises, and its noisy log."""
    bare = compiled("universal")
    robot = ji.load_model(bare)
    robot = robot if dtype is None else robot.astype(dtype)
    log = log_of(loaded(bare, "tip"), 200, noise=0.1)
    settings = {"sigma_tau": 0.1, "prior": Load(3.0), "chart": charts.LogCholeskyUUt()}
    settings |= {"paper": True}  # every sample is used
    return make_estimator(robot, ["tip"], **{**settings, **options}), log


def last(estimator: Estimator, log: Observation) -> np.ndarray:
    return np.asarray(run(estimator, estimator.initial(), log)[1].estimate.pi[-1])


@pytest.mark.parametrize(
    ("chart", "iterations"),
    [("Linear", 1), pytest.param("LogCholeskyUUt", 3, marks=pytest.mark.slow)],
)
def test_without_noise_it_is_the_paper_s_filter(chart, iterations):
    options = {"chart": getattr(charts, chart)(), "iterations": iterations}
    (exact, log), (paper, _) = arm(sigma_a=0.0, **options), arm(**options)
    np.testing.assert_allclose(last(exact, log), last(paper, log), rtol=1e-8, atol=1e-10)


def test_run_is_a_loop_of_steps():
    # One iteration overshoots from a prior this wide: rounding of 1e-13 is 1 after twenty samples
    # of it, on any jax, and what the compiler fuses decides. Five find the same to 1e-10.
    estimator, log = arm(sigma_a=0.5, iterations=5)
    state, step = estimator.initial(), eqx.filter_jit(Estimator.step, compiler_options=FAST)
    for k in range(20):
        state, _ = step(estimator, state, jax.tree.map(lambda x, k=k: x[k], log), 0.01)
    whole, _ = run(estimator, estimator.initial(), jax.tree.map(lambda x: x[:20], log))
    np.testing.assert_allclose(whole.belief.mean, state.belief.mean, rtol=1e-8, atol=1e-9)


def test_rows_that_are_not_measured_say_nothing():
    """A row that is marked may hold anything; a sample whose acceleration or position is not finite is left out."""
    estimator, log = arm(sigma_a=0.5)
    valid = np.array(log.motion.valid)
    valid[::3, 1] = False
    answers = []
    for wrong in (0.0, 1e6, np.nan):
        tau, q, a = np.array(log.motion.tau), np.array(log.motion.q), np.array(log.a)
        tau[::3, 1] = wrong
        a[50], q[60] = np.nan, np.nan
        motion = dataclasses.replace(log.motion, q=q, tau=tau, valid=valid)
        answers.append(last(estimator, Observation(motion, a)))
    assert np.isfinite(answers[0]).all()
    np.testing.assert_array_equal(answers[0], answers[1])
    np.testing.assert_array_equal(answers[0], answers[2])


@pytest.mark.slow
def test_float32_stays_close_to_float64():
    wide, log = arm(sigma_a=0.05, iterations=3)
    narrow, _ = arm(jnp.float32, sigma_a=0.05, iterations=3)
    single = jax.tree.map(lambda x: x.astype(np.float32) if x.dtype == float else x, log)
    np.testing.assert_allclose(last(narrow, single), last(wide, log), rtol=2e-2, atol=2e-3)


def test_noise_cannot_be_negative():
    with pytest.raises(ValueError, match="sigma_a"):
        arm(sigma_a=-1.0)
