"""Arms that weigh by holding poses: dry friction at rest is no change of bodies, and a real change is one."""

import mujoco
import numpy as np
import pytest
from scipy import signal as scipy_signal

from jax_inertia.estimation import batch_fit, log_filter
from jax_inertia.estimation.priors import Load
from jax_inertia.logs.log import Log
from jax_inertia.model.load import load_model
from jax_inertia.robots.pendulum import double_pendulum, swing
from jax_inertia.signals.holds import holds_of, without_friction
from jax_inertia.signals.misfit import misfit_notes, misfits

RATE, HOLD, MOVE = 100.0, 2.5, 2.0
FRICTION = np.array([0.9, 0.4])


def posed(loads: list[float], friction=FRICTION) -> Log:
    """One hold for each load [kg] in the lower link's middle, and a smooth motion to it; friction stays by 60 %."""
    rng = np.random.default_rng(3)
    poses = rng.uniform(-1.5, 1.5, (len(loads) + 1, 2))
    move = np.arange(round(MOVE * RATE)) / (MOVE * RATE)
    blend = move**3 * (10 - 15 * move + 6 * move**2)
    angles, mass, direction = [], [], []
    for before, after, load in zip(poses, poses[1:], loads, strict=False):
        rest = round(HOLD * RATE)
        angles += [before + blend[:, None] * (after - before), np.repeat(after[None], rest, axis=0)]
        mass += [load] * (len(move) + rest)
        sign = np.sign(after - before)
        direction += [np.tile(sign, (len(move), 1)), np.tile(0.6 * sign, (rest, 1))]
    q = np.concatenate(angles)
    v = np.gradient(q, axis=0) * RATE
    a = np.gradient(v, axis=0) * RATE
    models = {m: double_pendulum(m) for m in set(mass)}
    tau = np.zeros_like(q)
    for k, m in enumerate(mass):
        data = mujoco.MjData(models[m])
        data.qpos[:], data.qvel[:], data.qacc[:] = q[k], v[k], a[k]
        mujoco.mj_inverse(models[m], data)
        tau[k] = data.qfrc_inverse
    tau += np.concatenate(direction) * friction + 0.02 * rng.normal(size=tau.shape)
    return Log(time=np.arange(len(q)) / RATE, joint_names=("shoulder", "elbow"), qpos=q, tau=tau)


def weighed(log: Log):
    robot = load_model(double_pendulum())
    observation = log_filter.observe(log, robot)
    fit = batch_fit.fit(robot, [observation], ["lower"], prior=Load(1.0))
    _, changed = log_filter.residual_noise(
        robot, observation, ["lower"], prior=Load(1.0), whole=fit
    )
    return observation, fit, changed


@pytest.mark.slow
def test_eight_poses_with_friction_are_one_load():
    observation, fit, changed = weighed(posed([0.8] * 8))
    holds = holds_of(observation)
    assert holds is not None
    assert len(holds.runs) == 8
    assert 0.4 < holds.share < 0.7
    assert not changed
    mass, sigma = fit.estimate.pi[0, 0], fit.estimate.sigma_pi[0, 0]
    assert abs(mass - 1.8) < 3 * sigma < 0.5


@pytest.mark.parametrize("friction", [0.0, 1.0])
@pytest.mark.slow
def test_a_load_put_on_between_poses_is_a_change(friction):
    _, _, changed = weighed(posed([0.0] * 4 + [1.0] * 4, friction * FRICTION))
    assert changed


def test_a_log_of_motion_has_no_holds():
    observation = log_filter.observe(swing(), load_model(double_pendulum()))
    assert holds_of(observation) is None


def test_what_is_taken_off_a_hold_makes_its_constant_white():
    """The covariance of the rows afterwards is σ² times the identity, by the definition of whitening."""
    observation, _, _ = weighed(posed([0.8] * 3))
    holds = holds_of(observation)
    assert holds is not None
    (a, b) = holds.runs[0]
    count, sigma, level = b - a, 0.3, 2.0
    basis = np.zeros((len(holds.at_rest), 2, count))
    basis[a:b, 0] = np.eye(count)
    valid = np.ones((len(basis), 2), bool)
    taken = without_friction(basis, valid, holds, np.full(2, sigma), np.full(2, level))[a:b, 0]
    before = sigma**2 * np.eye(count) + level**2 * np.ones((count, count))
    np.testing.assert_allclose(taken @ before @ taken.T, sigma**2 * np.eye(count), atol=1e-9)


def test_a_residual_that_is_noise_asks_for_nothing_and_one_of_friction_does():
    rng = np.random.default_rng(0)
    time = np.arange(400) * 0.05
    torque = 10.0 * np.sin(time)[:, None] * np.ones((1, 3))
    left = 0.1 * rng.normal(size=(400, 3))
    left[:, 1] += 2.0 * scipy_signal.square(0.7 * time)
    left[:, 2] -= 15.0 * np.sin(time + 0.3)
    valid = np.ones_like(left, bool)
    found = misfits(left, torque, valid)
    assert [(one.row, one.exceeds) for one in found] == [(2, True), (1, False)]
    assert found[0].noise == pytest.approx(0.1, rel=0.2)
    exceeding, lacking = misfit_notes(found, ("a", "b", "c"))
    assert "exceeds the torque itself (c 11 N m of 7" in exceeding
    assert "b 2 N m" in lacking
    assert "jax-inertia diagnose" in lacking
    assert misfits(left[:, :1], torque[:, :1], valid[:, :1]) == []
