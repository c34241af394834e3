"""A legged robot whose contact wrenches nobody measured, walked in MuJoCo C."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import mujoco
import numpy as np
import pytest

from benchmarks.worlds import effects as fx
from benchmarks.worlds.feet.balance import walk
from benchmarks.worlds.feet.quadruped import quadruped
from jax_inertia import load_model, read_log
from jax_inertia.diagnosis.entry import diagnose
from jax_inertia.diagnosis.result import Verdict
from jax_inertia.logs.log import Log, LogError
from jax_inertia.signals.ground.support import _solved
from jax_inertia.signals.torque_residual import prepare

FEET = ("FL_foot", "FR_foot", "RL_foot", "RR_foot")


def walked(kind: str, *effects: fx.Effect, folder: Path) -> Log:
    """Four seconds with quiet sensors, the wrenches still there."""
    file = folder / "log.npz"
    np.savez(file, **walk(kind, [5], 4.0, effects=effects))
    return read_log(file)


def unmeasured(log: Log, bodies: tuple[str, ...] = ()) -> Log:
    return dataclasses.replace(log, contact_wrench=None, contact_bodies=bodies)


@pytest.fixture(scope="module")
def robot():
    return load_model(mujoco.MjModel.from_xml_string(quadruped().xml))


@pytest.fixture(scope="module")
def trotted(tmp_path_factory):
    return walked("trot", folder=tmp_path_factory.mktemp("trot"))


@pytest.mark.parametrize("named", [(), FEET])
@pytest.mark.slow
def test_what_the_ground_gives_is_what_the_legs_show(robot, trotted, named):
    found = prepare(robot, unmeasured(trotted, named)).support
    assert sorted(found.bodies) == sorted(FEET)
    measured = prepare(robot, trotted)
    order = [measured.observation.motion.contact_bodies.index(name) for name in found.bodies]
    force = np.asarray(measured.observation.motion.wrench)[:, order, :3]
    weight = 9.81 * float(robot.pi[:, 0].sum())
    keep = measured.measured[:, 0] > 0
    error = (found.wrench[:, :, :3] - force)[keep]
    assert force[..., 2].max() > 0.4 * weight
    assert np.sqrt(np.mean(error**2)) < 0.01 * weight


@pytest.mark.slow
def test_nothing_is_missing_where_no_wrench_is_measured(robot, trotted):
    found = diagnose(robot, unmeasured(trotted))
    assert found.verdict is Verdict.NO_GAP
    assert any("no contact wrench is measured" in note for note in found.notes)


@pytest.mark.slow
def test_a_weak_knee_is_named_by_what_it_does_to_the_base(robot, tmp_path):
    gain = fx.TorqueGain("joint", "FL_knee", {"gain": 0.88})
    found = diagnose(robot, unmeasured(walked("trot", gain, folder=tmp_path)))
    assert found.verdict is Verdict.EXPLAINED
    (effect,) = found.odd
    assert (effect.family, effect.place.name) == ("torque_gain", "FL_knee")
    assert effect.parameters["gain"].value == pytest.approx(0.88, abs=0.01)


@pytest.mark.slow
def test_a_shank_longer_than_the_model_s_is_no_cause_of_the_library(trotted):
    longer = quadruped().xml.replace(
        'name="FL_shank" pos="0 0 -0.23"', 'name="FL_shank" pos="0 0 -0.22"'
    )
    assert longer != quadruped().xml
    longer_legged = load_model(mujoco.MjModel.from_xml_string(longer))
    found = diagnose(longer_legged, trotted, max_effects=1)
    assert found.verdict in (Verdict.UNKNOWN, Verdict.PARTLY)


def test_a_robot_that_flies_has_no_feet(robot):
    time = np.arange(400) / 200.0
    log = Log(
        time=time,
        joint_names=robot.joint_names[1:],
        qpos=0.1 * np.sin(3 * time)[:, None] * np.ones(12),
        tau=np.zeros((400, 12)),
        base_pos=np.stack([0 * time, 0 * time, 9 - 4.905 * (time - 1) ** 2], axis=1),
        base_quat=np.tile([1.0, 0, 0, 0], (400, 1)),
    )
    assert prepare(robot, log).support is None


def test_a_contact_without_shape_is_refused(robot, trotted):
    with pytest.raises(LogError, match=r"'trunk' has no contact_wrench, and no colliding geom"):
        prepare(robot, unmeasured(trotted, ("trunk",)))


def test_forces_that_no_torque_tells_from_none_are_none():
    """Two feet of which one way is the same: the least forces that do it, where the equations have many."""
    rows = np.random.default_rng(4).normal(size=(3, 6, 10))
    rows[1, 5] = rows[1, 2]
    force = np.random.default_rng(5).normal(size=(3, 6))
    size = np.linspace(0.5, 2.0, 10)
    found = np.einsum("tmj,tj->tm", _solved(rows, size), np.einsum("tmj,tm->tj", rows, force))
    np.testing.assert_allclose(found[[0, 2]], force[[0, 2]], rtol=1e-6)
    shared = 0.5 * (force[1, 2] + force[1, 5])
    np.testing.assert_allclose(found[1, [2, 5]], shared, rtol=1e-6)
