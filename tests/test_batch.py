"""The batch fit on torques of MuJoCo C: joint terms, gains, bodies, loads, and whether intervals mean what they say."""

import functools

import mujoco
import numpy as np
import pytest
from excitation import LOAD, compiled, loaded, motion_of, observation, torques

import jax_inertia as ji
from jax_inertia.estimation import batch_fit
from jax_inertia.estimation.priors import Load, Tolerance
from jax_inertia.maths.inertial_parameters import is_physical
from jax_inertia.model.load import body_pi
from jax_inertia.robots.pendulum import swing

SAMPLES, SLOW = 500, 0.1
DAMPING, FRICTION = np.array([1.1, 0.4, 0.15]), np.array([0.8, 0.5, 0.3])
ARMATURE, OFFSET = np.array([0.12, 0.06, 0.03]), np.array([0.5, -0.3, 0.1])
GAINS, NOISE = np.array([12.0, 9.0, 5.0]), 0.05


@functools.cache
def robot() -> ji.Robot:
    return ji.load_model(compiled("universal"))


def plant(load: float | None = None) -> mujoco.MjModel:
    """The robot with damping and rotor inertia that its model knows nothing of, and a load on its tip."""
    model = compiled("universal")
    model.dof_damping[:], model.dof_armature[:] = DAMPING, ARMATURE
    return model if load is None else loaded(model, "tip", load)


def log(model: mujoco.MjModel, seed: int, *, joints: bool = True, gains=1.0, noise=NOISE):
    """Torques by mj_inverse, Coulomb friction and an offset added; rows too slow for Coulomb's law are masked."""
    time, q, v, a = motion_of(model, SAMPLES, seed)
    tau = torques(model, q, v, a) + noise * np.random.default_rng([seed, 7]).normal(size=v.shape)
    if joints:
        tau = np.where(np.abs(v) < SLOW, np.nan, tau + FRICTION * np.sign(v) + OFFSET)
    return observation(time, q, v, a, tau / gains)


def within(value, sigma, truth, *, sigmas: float = 4.0, useful: float) -> bool:
    """Near the truth by its own account, and that account is worth having."""
    return bool(np.all(np.abs(value - truth) < sigmas * sigma) and np.all(sigma < useful))


@pytest.mark.slow
def test_joint_terms_and_gains_are_recovered():
    """Currents of three logs: gains start 30 % off, bodies are known to 0.1 %, and set the scale of torque."""
    logs = [log(plant(), seed, gains=GAINS) for seed in range(3)]
    tight = Tolerance(1e-3, 1e-4, 1e-3)
    fit = batch_fit.fit(
        robot(),
        logs,
        prior=tight,
        joint_terms=batch_fit.JOINT_TERMS,
        gains=GAINS * np.array([1.3, 0.75, 1.2]),
        gain_sigma=0.5,
    )
    assert fit.converged
    assert within(fit.gains / GAINS, fit.gains_sigma / GAINS, 1.0, useful=0.02)
    wanted = {"damping": DAMPING, "frictionloss": FRICTION, "armature": ARMATURE, "offset": OFFSET}
    for term, truth in wanted.items():
        assert within(fit.joint_terms[term], fit.joint_sigma[term], truth, useful=0.05), term
    np.testing.assert_allclose(fit.robot.damping, DAMPING, atol=0.05)
    np.testing.assert_allclose(fit.bias, fit.joint_terms["offset"])
    assert np.all(fit.rms_after < 1.1 * NOISE)
    assert np.all(fit.rms_before > 5 * NOISE)
    assert np.all(is_physical(fit.robot.pi))


@pytest.mark.slow
def test_noise_and_residuals_are_in_newton_metres_whatever_the_gains():
    fit = batch_fit.fit(
        robot(),
        [log(plant(), 0, gains=GAINS)],
        prior=Tolerance(0.05, 0.01),
        gains=GAINS,
        joint_terms=batch_fit.JOINT_TERMS,
    )
    np.testing.assert_allclose(fit.rms_after, NOISE, rtol=0.15)
    # White noise: correlation inflates it by little.
    assert np.all(fit.noise > 0.8 * NOISE)
    assert np.all(fit.noise < 2.0 * NOISE)
    np.testing.assert_array_equal(fit.gains, GAINS)
    # A person can read it: a line for the fit, one for each body.
    assert repr(fit).count("\n") == robot().nb
    assert f"  tip: {float(fit.estimate.pi[-1, 0]):.4g} ± " in repr(fit)


def test_joint_terms_never_fall_below_zero():
    """A model with more damping than the plant's, and torques that claim negative friction."""
    model = compiled("universal")
    time, q, v, a = motion_of(model, SAMPLES, 0)
    tau = torques(model, q, v, a) - 0.3 * np.sign(v)
    fit = batch_fit.fit(
        robot(),
        [observation(time, q, v, a, np.where(np.abs(v) < SLOW, np.nan, tau))],
        prior=Tolerance(0.01, 0.001),
        joint_terms=("damping", "frictionloss"),
    )
    assert np.all(np.asarray(fit.robot.frictionloss) == 0)
    assert np.all(np.asarray(fit.robot.damping) >= 0)
    assert np.all(fit.joint_sigma["frictionloss"] == 0)


@pytest.mark.slow
def test_intervals_cover_the_truth():
    """A load of 2.4 kg on the tip, 20 seeds of motion and noise: how often 95 % intervals hold mass, centre and π."""
    model = loaded(compiled("universal"), "tip")
    truth = body_pi(model, model.body("tip").id)
    z, z_com, width = [], [], []
    for seed in range(20):
        one = log(model, seed, joints=False, noise=0.3)
        fit = batch_fit.fit(robot(), [one], ["tip"], prior=Load(3.0))
        assert fit.converged
        assert np.all(is_physical(fit.estimate.pi))
        z.append((fit.estimate.pi[0] - truth) / fit.estimate.sigma_pi[0])
        z_com.append((fit.estimate.com[0] - truth[1:4] / truth[0]) / fit.estimate.sigma_com[0])
        width.append(fit.estimate.sigma_pi[0, 0])
    z, z_com = np.abs(z), np.abs(z_com)
    # Of 20 a right account covers 19; fewer than 15 once in 3000.
    assert np.sum(z[:, 0] < 1.96) >= 15
    assert np.mean(z < 1.96) > 0.88
    assert np.mean(z_com < 1.96) > 0.85
    # And not by being wide: errors are of the size that is claimed.
    assert np.sqrt(np.mean(z**2)) > 0.6
    assert np.max(width) < 0.3
    assert LOAD["mass"] == 2.4


@pytest.mark.slow
def test_a_carried_load_is_told_from_the_bodies_that_carry_it():
    """One log without, one with 1.5 kg; gains unknown, bodies known to a few per cent."""
    free, carrying = log(plant(), 0, gains=GAINS), log(plant(1.5), 1, gains=GAINS)
    options = {
        "prior": Tolerance(0.03, 0.01),
        "joint_terms": batch_fit.JOINT_TERMS,
        "gains": GAINS * 1.2,
        "gain_sigma": 0.3,
    }
    fit = batch_fit.fit(
        robot(), [free, carrying], carried=batch_fit.Carried("tip", (1,), Load(3.0)), **options
    )
    assert within(fit.load.pi[0, 0], fit.load.sigma_pi[0, 0], 1.5, useful=0.15)
    np.testing.assert_allclose(fit.load.com[0], LOAD["com"], atol=0.02)
    none = batch_fit.fit(
        robot(),
        [free, log(plant(), 2, gains=GAINS)],
        carried=batch_fit.Carried("tip", (1,), Load(3.0)),
        **options,
    )
    assert within(none.load.pi[0, 0], none.load.sigma_pi[0, 0], 0.0, useful=0.05)


def test_draws_spread_as_the_posterior_says():
    fit = batch_fit.fit(
        robot(),
        [log(plant(), 0, gains=GAINS)],
        prior=Tolerance(0.03, 0.01),
        joint_terms=batch_fit.JOINT_TERMS,
        gains=GAINS,
        gain_sigma=0.1,
    )
    drawn = fit.draws(200)
    gains = np.array([one.gains for one in drawn])
    np.testing.assert_allclose(gains.mean(axis=0), fit.gains, atol=4 * np.max(fit.gains_sigma) / 14)
    np.testing.assert_allclose(gains.std(axis=0), fit.gains_sigma, rtol=0.25)
    bias = np.array([one.bias for one in drawn])
    np.testing.assert_allclose(bias.std(axis=0), fit.joint_sigma["offset"], rtol=0.25)
    assert all(np.all(is_physical(one.robot.pi)) for one in drawn)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"observations": []}, "observations is empty; give a list"),
        ({"observations": log(plant(), 0)}, "observations is one Observation; give a list"),
        ({"observations": [swing()]}, r"observations\[0\] is of type Log; give"),
        ({"joint_terms": "damping"}, r"the text 'damping'; give a list: \['damping'\]"),
        ({"joint_terms": ("damping", "backlash")}, r"terms \['backlash'\]; valid: damping"),
        ({"bodies": ["hand"]}, "gimbal, tip"),
        ({"prior": Load(np.nan)}, "mass of prior is nan; it must be finite"),
        ({"prior": Load(0.0)}, r"the prior \(Load\) holds a body fast; .* must be positive"),
        (
            {"carried": batch_fit.Carried("tip", (1,), Load(1.0))},
            r"logs \[1\] carry the load; expected some of 0 to 0",
        ),
        (
            {"carried": batch_fit.Carried("tip", (0,), Load(np.nan))},
            "sigma_pi of the load carried is .* must be positive",
        ),
    ],
)
def test_mistakes_are_named(changes, says):
    with pytest.raises(ValueError, match=says):
        batch_fit.fit(robot(), **{"observations": [log(plant(), 0)], "prior": Load(1.0)} | changes)
