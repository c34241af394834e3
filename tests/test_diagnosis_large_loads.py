"""One effect that makes most of a gap, on robots as bought and on calibrated ones; logs by MuJoCo C."""

import re
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from arm_log import ARM, loaded, simulate

import jax_inertia as ji
from jax_inertia.diagnosis import pipeline
from jax_inertia.diagnosis.effects.base import Place
from jax_inertia.diagnosis.effects.external_force import ConstantForce
from jax_inertia.diagnosis.settings import CalibrationState
from jax_inertia.robots.pendulum import double_pendulum, swing

BARE = re.sub(r' (damping|armature)="[^"]*"', "", ARM)
FRICTION = np.array([0.4, 0.2])


def rubbing(t, q, v, u):
    return -FRICTION * np.tanh(v / 0.004)


@pytest.mark.slow
def test_a_load_that_is_most_of_what_is_missing():
    """Ten times the torque of friction and rotors: a gain of all motors and a torque limit explain much of it."""
    robot = ji.load_model(mujoco.MjModel.from_xml_string(BARE))
    log, other = (simulate(rubbing, edit=loaded(1.0, (0.0, 0.03, -0.3)), seed=k) for k in (3, 8))
    found = ji.diagnose(robot, log, test_log=other)
    assert str(found.verdict) == "explained"
    load = next(f for f in found.found if f.family == "payload")
    assert load.place.name == "lower"
    assert load.parameters["mass"].value == pytest.approx(1.0, rel=0.05)
    for joint, own, friction in zip(("shoulder", "elbow"), (0.3, 0.2), FRICTION, strict=True):
        numbers = found.joints[joint]
        assert numbers["viscous_friction"].value == pytest.approx(own, rel=0.05)
        assert numbers["coulomb_friction"].value == pytest.approx(friction, rel=0.05)
    assert found.test.after < 0.01 * found.test.before


@pytest.mark.slow
@pytest.mark.parametrize("mass", [1.5, 2.5, 3.5])
def test_beside_a_load_as_heavy_as_its_arm_friction_still_votes(mass):
    robot = ji.load_model(mujoco.MjModel.from_xml_string(BARE))
    log, other = (simulate(rubbing, edit=loaded(mass, (0, 0, -0.25)), seed=k) for k in (11, 61))
    found = ji.diagnose(robot, log, test_log=other)
    (load,) = (f for f in found.found if not f.ordinary)
    assert (load.family, load.place.name) == ("payload", "lower")
    assert load.parameters["mass"].value == pytest.approx(mass, rel=0.1)
    assert found.joints["shoulder"]["viscous_friction"].value == pytest.approx(0.3, rel=0.05)


def test_a_load_half_way_down_a_long_link():
    robot = ji.load_model(double_pendulum()).astype("float64")
    found = pipeline.diagnose(
        robot, swing(load=0.5, seconds=8.0), state=CalibrationState.CALIBRATED
    )
    (effect,) = found.found
    assert (effect.family, effect.place.name) == ("payload", "lower")
    assert effect.parameters["mass"].value == pytest.approx(0.5, rel=0.05)
    assert effect.parameters["com_z"].value == pytest.approx(-0.5, rel=0.05)


def test_what_pulls_on_a_small_robot_for_good_is_no_more_than_its_weight():
    body = Place("body", "lower", 1)
    for mass, newtons in ((0.05, 0.1 * 9.81), (1.0, 10.0), (50.0, 0.025 * 100.0 * 9.81)):
        pi = np.array([[mass, 0.0, 0.0, 0.1 * mass, *[0.0] * 6]] * 2)
        context = SimpleNamespace(pi=pi, scale=1.0)
        assert ConstantForce().scale(context, body, ())[0] == pytest.approx(newtons)
