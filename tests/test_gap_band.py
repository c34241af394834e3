"""Which accelerations are motion: where a band ends, and what starts and stops do in it, on logs of MuJoCo C."""

import dataclasses

import jax.numpy as jnp
import mujoco
import numpy as np
from chain_log import JOINTS, chain_xml, simulate

from jax_inertia import load_model
from jax_inertia.cli.demo.hidden import draw
from jax_inertia.cli.demo.simulation import Load
from jax_inertia.diagnosis.features.band import Band
from jax_inertia.diagnosis.features.context import Context
from jax_inertia.gap.noise import whitener
from jax_inertia.maths.inertial_parameters import from_com
from jax_inertia.robots.arm import HAND
from jax_inertia.signals.torque_residual import prepare

STEEL = 7850.0


def test_what_is_left_of_accelerations_is_nearer_to_the_true_ones():
    """Encoder noise of 2 mrad, twice differentiated, is a fifth to all of what the joints accelerate by below 10 Hz."""
    robot = load_model(mujoco.MjModel.from_xml_string(chain_xml(np.zeros(JOINTS))))
    log = simulate(seconds=5.0)
    true, kept, _ = _accelerations(robot, log)
    assert np.all((kept - true).std(axis=0) < 0.02 * true.std(axis=0))
    measured, left, band = _accelerations(robot, _noisy(log, 2e-3))
    assert np.all((left - true).std(axis=0) < 0.5 * (measured - true).std(axis=0))
    assert not band.faster.any()


def test_each_row_has_a_band_of_its_own():
    """One joint that trembles at 8 Hz; the others, in the same noise, need not hear what is above their sines."""
    robot = load_model(mujoco.MjModel.from_xml_string(chain_xml(np.zeros(JOINTS))))
    log = simulate(seconds=5.0)
    qpos = np.array(log.qpos)
    qpos[:, 2] += 0.02 * np.sin(2 * np.pi * 8.0 * np.asarray(log.time))
    _, _, band = _accelerations(robot, _noisy(dataclasses.replace(log, qpos=qpos), 2e-3))
    assert band.cutoff[2] >= 8.0
    assert np.median(np.delete(band.cutoff, 2)) < 6.0


def _noisy(log, sigma):
    noise = sigma * np.random.default_rng(1).standard_normal(log.qpos.shape)
    return dataclasses.replace(log, qpos=log.qpos + noise, sigma_qpos=np.full(JOINTS, sigma))


def _accelerations(robot, log):
    """What the chain measures and what of it is motion, both finished, and the band."""
    prepared = prepare(robot, log)
    band = Band.of(prepared, whitener(prepared, log)[2])
    a = np.asarray(prepared.observation.a)
    return prepared.finish(a), prepared.finish(band.motion(a, prepared.rate)), band


def test_what_starts_at_once_is_motion_while_it_starts():
    """The built-in arm starts within 0.3 s; cut to the band of its later motion, its load missed the start by 16 σ."""
    case = draw(0)
    assert case.secret.family == "payload"
    mass = case.secret.size
    edge = (mass / STEEL) ** (1 / 3)
    inertia = mass * edge**2 / 6 * jnp.eye(3)
    pi = from_com(jnp.array(mass), jnp.array(Load().centre), inertia)
    robot = load_model(mujoco.MjModel.from_xml_string(case.model_xml))
    prepared = prepare(robot, case.log)
    white, _, again = whitener(prepared, case.log)
    band = Band.of(prepared, again)
    context = Context(prepared, band)
    hand = robot.body_names.index(HAND)
    missed = prepared.missing - context.regressor[:, :, hand] @ np.asarray(pi)
    left = prepared.finish_torque(missed) / white.sigma
    early = prepared.time[prepared.kept] < 0.6
    assert np.abs(left[early]).max() < 1.5 * np.abs(left[~early]).max()
    at = context.time
    quick = band.faster[(at > 0.3) & (at < 0.6)].min(axis=0) > 0.99
    assert quick.sum() >= 6
    assert not band.faster[(at > 2.0) & (at < 8.0)].any()
