"""Which accelerations are motion: where a band ends, and what starts and stops do in it, on logs of MuJoCo C."""

import dataclasses

import jax.numpy as jnp
import mujoco
import numpy as np
from chain_log import JOINTS, chain_xml, simulate

from jax_inertia import load_model
from jax_inertia.demo.hidden import draw
from jax_inertia.demo.simulation import Load
from jax_inertia.gap.band import Band
from jax_inertia.gap.chain import prepare
from jax_inertia.gap.context import Context
from jax_inertia.gap.noise import whitener
from jax_inertia.inertia import from_com
from jax_inertia.robots.arm import HAND

STEEL = 7850.0


def test_a_band_ends_where_noise_begins():
    robot = load_model(mujoco.MjModel.from_xml_string(chain_xml(np.zeros(JOINTS))))
    log = simulate(seconds=5.0)
    loud = dataclasses.replace(
        log,
        qpos=log.qpos + 2e-3 * np.random.default_rng(1).standard_normal(log.qpos.shape),
        sigma_qpos=np.full(JOINTS, 2e-3),
    )
    bands = []
    for one in (log, loud):
        prepared = prepare(robot, one)
        white, replicas, _ = whitener(prepared, one)
        bands.append(Band.of(prepared, white, replicas))
    # The fastest of its sines has 0.7 Hz, and its torque products of some of them.
    assert 2.0 < bands[1].cutoff < bands[0].cutoff
    assert not bands[1].faster.any()


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
    white, replicas, _ = whitener(prepared, case.log)
    band = Band.of(prepared, white, replicas)
    context = Context(prepared, band)
    hand = robot.body_names.index(HAND)
    missed = prepared.missing - context.regressor[:, :, hand] @ np.asarray(pi)
    left = prepared.finish_torque(missed) / white.sigma
    early = prepared.time[prepared.kept] < 0.6
    assert np.abs(left[early]).max() < 1.5 * np.abs(left[~early]).max()
    at = context.time
    assert band.faster[(at > 0.3) & (at < 0.6)].min() > 0.99
    assert not band.faster[(at > 2.0) & (at < 8.0)].any()
