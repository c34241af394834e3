"""Feet that swing, feet that stand, and what a trunk weighs on them, against MuJoCo C's own contacts."""

from __future__ import annotations

import dataclasses
import functools

import mujoco
import numpy as np
import pytest
from walking_log import Quadruped, shifts, trot, walked

import jax_inertia as ji
from jax_inertia.logs.log import Log
from jax_inertia.logs.schema import SHAPES
from jax_inertia.maths.precision import in_double_precision
from jax_inertia.signals.ground.stance import swinging
from jax_inertia.signals.torque_residual import prepare

ROBOT = Quadruped()
RUBBING = dataclasses.replace(ROBOT, dry=0.45)
LOAD, PLACE = 1.5, np.array([0.08, -0.04, 0.05])
BARE = ("contact_force", "contact_flag", "contact_bodies", "qpos_target")


@functools.cache
def made(robot: Quadruped, gait, load: float = 0.0) -> dict:
    return walked(robot, gait, seconds=3.0, load=load, at=tuple(PLACE), seed=11)


def log_of(arrays: dict, *left_out: str) -> Log:
    fields = {k: x for k, x in arrays.items() if k in SHAPES and k not in (*BARE, *left_out)}
    fields |= {"joint_names": tuple(arrays["joint_names"]), "tau_kind": "current"}
    return Log(**fields, imu_pos=np.array(ROBOT.imu))


@functools.cache
def model():
    return ji.load_model(mujoco.MjModel.from_xml_string(ROBOT.xml))


@functools.cache
def prepared(robot: Quadruped, gait):
    return in_double_precision(prepare)(model(), log_of(made(robot, gait)))


def swings(found) -> np.ndarray:
    """Feet whose legs' rows are their own."""
    topology = found.robot.topology
    legs = [np.flatnonzero(topology.body_dof[f.body][6:]) + 6 for f in found.support.feet]
    return np.stack([~found.support.used_up[:, leg].any(axis=1) for leg in legs], axis=1)


@pytest.mark.slow
def test_a_foot_that_is_taken_to_swing_bears_nothing_in_mujoco():
    found, arrays = prepared(ROBOT, trot), made(ROBOT, trot)
    force = np.stack(
        [np.interp(found.time, arrays["time"], x) for x in arrays["contact_force"].T], axis=1
    )
    assert found.support is not None
    assert found.support.bodies == tuple(arrays["contact_bodies"])
    # Filters lean on their padding at either end, and no row is made of it.
    inner = slice(found.kept[0], found.kept[-1])
    said, force = swings(found)[inner], force[inner]
    assert force[said].max() < 0.02 * 9.81 * 13.0
    # What the low-pass carries over is left out at either end of a swing.
    assert said.sum() > 0.3 * (force < 0.1).sum()


def test_feet_of_a_robot_that_stands_never_swing():
    assert not swings(prepared(ROBOT, shifts)).any()


def test_a_foot_that_is_lightly_loaded_and_does_not_move_may_stand():
    load, still = np.full((500, 1), 0.05), np.zeros((500, 1))
    assert not swinging(load, still, 250.0).any()
    assert swinging(load, still + 0.4, 250.0)[50:-50].all()
    # A switch in the foot is one more measurement.
    assert swinging(load, still, 250.0, np.zeros_like(load))[50:-50].all()
    assert not swinging(load, still, 250.0, np.full_like(load, np.nan)).any()


def test_rows_of_legs_that_swing_show_their_joints_friction():
    """Least squares on the rows of a knee alone: 0.3 N m that the model lacks."""
    found = prepared(RUBBING, trot)
    y, v = found.finish_torque(found.missing), np.asarray(found.observation.motion.v)
    for row in [f + 2 for f in (6, 9, 12, 15)]:
        own = found.finish_torque(np.tanh(v[:, row] / 0.05), row)[:, row]
        moves = found.valid[:, row]
        level = -(own @ (moves * y[:, row])) / (own @ (moves * own))
        # By one column, without the rest of what a joint may have.
        assert level == pytest.approx(0.3, rel=0.5)
    sound = prepared(ROBOT, trot)
    left = sound.finish_torque(sound.missing)[:, 6:][sound.valid[:, 6:]]
    needed = sound.finish(sound.inverse)[:, 6:][sound.valid[:, 6:]]
    assert np.sqrt(np.mean(left**2)) < 0.25 * np.sqrt(np.mean(needed**2))


@pytest.mark.slow
def test_a_trunk_is_weighed_on_its_feet_as_well_as_is_stated():
    log, robot = log_of(made(ROBOT, trot, LOAD)), model()
    found = ji.estimate(robot, log, ["trunk"])
    mass = ROBOT.trunk + LOAD
    centre = (ROBOT.trunk * np.array([0.012, -0.002, 0.004]) + LOAD * 2 * PLACE) / mass
    pi, (sigma, of_centre) = np.asarray(found.pi["trunk"]), found.filter_sigma(0)
    assert pi[0] == pytest.approx(mass, rel=0.05)
    assert np.abs(pi[1:3] / pi[0] - centre[:2]).max() < 0.01
    assert np.all(np.abs(pi[1:4] / pi[0] - centre) < 3.0 * of_centre)
    assert abs(pi[0] - mass) < 3.0 * sigma[0]
    # The legs' own friction and the height of contact are no part of the filter's noise.
    alone = np.asarray(found.trace.estimate.sigma_com)[-1, 0]
    assert np.all(of_centre > alone)


def test_every_link_may_collide_and_feet_may_be_long():
    """A robot whose model gives each link a shape, and its shanks capsules that lie: no log of it is refused."""
    xml = ROBOT.xml.replace('<geom contype="0" conaffinity="0"/>', "<geom/>")
    for leg in ("FL", "FR", "RL", "RR"):
        xml = xml.replace(
            f'<geom name="{leg}" type="sphere" size="0.022" pos="0 0 -0.22"',
            f'<geom name="{leg}" type="capsule" size="0.022" fromto="-0.03 0 -0.22 0.03 0 -0.22"',
        )
    robot = ji.load_model(mujoco.MjModel.from_xml_string(xml))
    found = in_double_precision(prepare)(robot, log_of(made(ROBOT, shifts)))
    assert found.support is not None
    assert found.support.bodies == ("FL_shank", "FR_shank", "RL_shank", "RR_shank")
    assert not any(f.flat for f in found.support.feet)
    assert found.measured[:, :6].all()
