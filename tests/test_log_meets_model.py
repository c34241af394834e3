"""Every line of docs/log_meets_model.md on robots of other kinds and sizes, and what must pass without a word.

A leg of two kilograms, a crane of tonnes, a gantry of slides, a one-joint rig and a leg with springs, simulated by
MuJoCo's forward dynamics with their own friction (`robots_in_motion`).
"""

import dataclasses
import functools

import numpy as np
import pytest
import robots_in_motion as robots

import jax_inertia as ji
from jax_inertia.preflight.against_model import against_model
from jax_inertia.signals.corrections import mounted, with_later_torque, with_model_gravity


@functools.cache
def sound(name: str) -> tuple[ji.Robot, ji.Log]:
    return robots.robot_of(name), robots.log_of(name)


def told(name: str, change) -> list[str]:
    robot, log = sound(name)
    made = change(robot, log)
    robot, log = made if isinstance(made, tuple) else (robot, made)
    return [f"{f.severity}: {f.message}" for f in against_model(log, robot)]


def torque(log: ji.Log, tau) -> ji.Log:
    return dataclasses.replace(log, tau=np.asarray(tau))


def gravity(robot: ji.Robot, log: ji.Log) -> np.ndarray:
    return np.asarray(with_model_gravity(torque(log, 0.0 * log.tau), robot).tau)


def weightless(robot: ji.Robot, log: ji.Log) -> ji.Log:
    return torque(log, log.tau - gravity(robot, log))


def loaded_weightless(name: str):
    def change(robot: ji.Robot, _: ji.Log) -> ji.Log:
        return weightless(robot, robots.log_of(name, load=1.0))

    return change


def scaled(*factors: float):
    def change(_: ji.Robot, log: ji.Log) -> ji.Log:
        return torque(log, log.tau * np.resize(factors, log.tau.shape[1]))

    return change


def last_turned(_: ji.Robot, log: ji.Log) -> ji.Log:
    return torque(
        log, log.tau * np.where(np.arange(log.tau.shape[1]) == log.tau.shape[1] - 1, -1, 1)
    )


def in_another_order(_: ji.Robot, log: ji.Log) -> ji.Log:
    return torque(log, np.roll(log.tau, 1, axis=1))


def in_degrees(_: ji.Robot, log: ji.Log) -> ji.Log:
    return dataclasses.replace(log, qpos=np.degrees(log.qpos))


def off(joint: int, angle: float):
    def change(_: ji.Robot, log: ji.Log) -> ji.Log:
        return dataclasses.replace(
            log, qpos=log.qpos + angle * (np.arange(log.qpos.shape[1]) == joint)
        )

    return change


def mount(*angles: float):
    return lambda robot, log: (mounted(robot, angles), log)


def differential(_: ji.Robot, log: ji.Log) -> ji.Log:
    tau = np.array(log.tau)
    tau[:, -2:] = 0.5 * tau[:, -2:] @ np.array([[1.0, 1.0], [1.0, -1.0]])
    return torque(log, tau)


def next_to_nothing(_: ji.Robot, log: ji.Log) -> ji.Log:
    noise = np.random.default_rng(0).normal(size=log.tau.shape)
    return torque(log, 0.02 * np.std(log.tau, axis=0) * noise)


def large_inertia(robot: ji.Robot, log: ji.Log):
    return robot.with_pi((1,), robot.pi[1:2].at[:, 4:].multiply(1e7)), log


def without_friction(robot: ji.Robot, log: ji.Log):
    none = 0.0 * robot.damping
    return dataclasses.replace(robot, damping=none, frictionloss=none, armature=none), log


def lifted(robot: ji.Robot, log: ji.Log):
    """A model in which MuJoCo's gravcomp lifts every body, and a log of a robot that nothing lifts."""
    return dataclasses.replace(robot, compensated=robot.pi[:, :4]), log


def lifted_in_both(robot: ji.Robot, log: ji.Log):
    return lifted(robot, weightless(robot, log))


def no_gravity(robot: ji.Robot, log: ji.Log):
    return dataclasses.replace(robot, gravity=0.0 * robot.gravity), log


def lifted_and_loaded(name: str):
    return lambda robot, _: lifted(robot, robots.log_of(name, load=1.0))


def late(seconds: float):
    return lambda robot, log: with_later_torque(log, seconds)


SAID = [
    ("leg", weightless, "error: tau holds no gravity", "--gravity-compensated"),
    ("crane", weightless, "error: tau holds no gravity", "--gravity-compensated"),
    ("gantry", weightless, "error: tau holds no gravity", "--gravity-compensated"),
    ("sprung", weightless, "error: tau holds no gravity", "--gravity-compensated"),
    ("crane", loaded_weightless("crane"), "error: tau holds no gravity", "--gravity-compensated"),
    ("gantry", loaded_weightless("gantry"), "error: tau holds no gravity", "--gravity-compensated"),
    ("rig", weightless, "neither gravity nor inertia", "--gravity-compensated"),
    ("leg", next_to_nothing, "neither gravity nor inertia", "log what motors or sensors give"),
    ("gantry", next_to_nothing, "neither gravity nor inertia", "log what motors or sensors give"),
    ("leg", scaled(1 / 8, 1 / 11, 1 / 15), "error: tau is 0.067 to 0.13 times", "--tau-unit A"),
    ("crane", scaled(1 / 8, 1 / 9, 1 / 12, 1 / 15), "times what the model needs", "--tau-unit A"),
    ("leg", scaled(1 / 50), "error: tau is 0.02001 times", "--tau-unit motor --gains 49.9"),
    ("crane", scaled(1 / 120), "error: tau is 0.00833", "--tau-unit motor --gains 120"),
    ("rig", scaled(1 / 50), "error: tau is 0.02 times", "--tau-unit motor --gains 50"),
    ("leg", scaled(1000.0), "error: tau is 1001 times", "--tau-unit mNm"),
    ("gantry", scaled(1000.0), "error: tau is 1002 times", "--tau-unit mNm"),
    ("crane", scaled(-1.0), "tau of every joint is minus", "--gains -1"),
    ("gantry", scaled(-1.0), "tau of every joint is minus", "--gains -1"),
    ("leg", last_turned, "tau of knee is minus", "--gains -1"),
    ("sprung", last_turned, "tau of knee is minus", "--gains -1"),
    ("leg", in_another_order, "tau of 'knee' is what 'swing' needs", "joint_names"),
    ("sprung", in_another_order, "tau of 'knee' is what 'swing' needs", "joint_names"),
    ("leg", in_degrees, "error: torques fit the motion if qpos is in degrees", "--degrees"),
    ("rig", in_degrees, "error: torques fit the motion if qpos is in degrees", "--degrees"),
    ("leg", off(2, 0.5 * np.pi), "the zero of qpos is elsewhere", "add -90° (-1.5708 rad) at knee"),
    ("crane", off(1, np.pi), "the zero of qpos is elsewhere", "add +180° (+3.1416 rad) at luff"),
    ("crane", mount(90.0, 0.0), "gravity is turned by 90°", "--mount="),
    ("gantry", mount(0.0, 40.0), "gravity is turned by 40°", "--mount="),
    # About the first joint's axis a turned base and that joint's zero are the same, and both are said.
    (
        "leg",
        mount(90.0, 0.0),
        "the zero of qpos is elsewhere: add -90° (-1.5708 rad) at abduct",
        "or else",
    ),
    ("leg", differential, "two motors that drive both joints", "swing = 1"),
    ("sprung", differential, "two motors that drive both joints", "swing = 1"),
    ("leg", large_inertia, "error: thigh: 1.2 kg with", "give kg m²"),
    ("crane", large_inertia, "error: boom: 600 kg with", "give kg m²"),
    ("leg", lifted, "error: tau holds gravity", "take gravcomp out of the model"),
    ("crane", lifted, "error: tau holds gravity", "take gravcomp out of the model"),
    ("sprung", lifted, "error: tau holds gravity", "take gravcomp out of the model"),
    ("rig", lifted, "error: tau holds gravity", "take gravcomp out of the model"),
    ("leg", lifted_and_loaded("leg"), "warning: the model takes gravity out", "gravcomp"),
    ("gantry", lifted_and_loaded("gantry"), "error: tau holds gravity", "gravcomp"),
    ("leg", no_gravity, "error: tau holds gravity", 'gravity="0 0 -9.81"'),
    ("gantry", no_gravity, "error: tau holds gravity", 'gravity="0 0 -9.81"'),
    ("leg", late(0.15), "error: tau of every joint runs 14", "--shift-torque -0.1"),
    ("gantry", late(-0.08), "error: tau of every joint runs 8", "--shift-torque 0.08"),
    ("crane", late(0.15), "error: tau of every joint runs 14", "--shift-torque -0.1"),
    ("leg", without_friction, "warning: the model has no friction", "--calibrate"),
    ("crane", without_friction, "warning: the model has no friction", "--calibrate"),
]


# A robot of its own is some seconds of compiling: one is in the fast run.
FAST = ("leg",)
LINES = [pytest.param(*one, marks=[pytest.mark.slow] * (one[0] not in FAST)) for one in SAID]


@pytest.mark.parametrize(("name", "change", "what", "way"), LINES)
def test_what_is_wrong_is_said_in_one_line(name, change, what, way):
    (line,) = told(name, change)
    assert what in line
    assert way in line
    assert "\n" not in line


def test_two_faults_are_both_said():
    lines = told("leg", lambda robot, log: with_later_torque(weightless(robot, log), 0.15))
    assert ["holds no gravity" in lines[0], "ms behind" in lines[1]] == [True, True]


@pytest.mark.parametrize("name", ["leg", pytest.param("crane", marks=pytest.mark.slow)])
def test_a_model_without_weight_passes_where_the_torque_has_none(name):
    assert told(name, lifted_in_both) == []


def stiffer(spec) -> None:
    for joint in spec.joints:
        joint.damping, joint.frictionloss = 3.0 * np.array(joint.damping), 4.0 * joint.frictionloss
        joint.armature = 3.0 * joint.armature


def springs(spec) -> None:
    model = spec.copy().compile()
    for k, joint in enumerate(spec.joints):
        joint.stiffness[0] = 2.0 * 9.81 * model.body_subtreemass[k + 1] * 0.1


def heavier(spec) -> None:
    for body in spec.bodies[1:]:
        body.mass *= 1.5


PASSED = {
    "as it is": {},
    "a load as heavy as its last link": {"load": 1.0},
    "a load four times as heavy": {"load": 4.0},
    "a slow motion": {"slower": 4.0, "seconds": 20.0},
    "a motion hardly faster than creep": {"slower": 15.0, "seconds": 30.0},
    "noise of a tenth": {"noise": 0.1},
    "noise of four tenths": {"noise": 0.4},
    "little more than two seconds": {"seconds": 3.0},
    "four times the friction": {"change": stiffer},
    "springs that the model lacks": {"change": springs},
    "half as heavy again": {"change": heavier},
}


EVERY = [
    pytest.param(name, what, marks=[pytest.mark.slow] * (name != "leg"))
    for name in robots.ROBOTS
    for what in PASSED
]


@pytest.mark.parametrize(("name", "what"), EVERY)
def test_what_a_diagnosis_is_for_passes(name, what):
    robot, _ = sound(name)
    found = against_model(robots.log_of(name, **PASSED[what]), robot)
    assert found == (), str(found[0])


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=[pytest.mark.slow] * (name not in FAST)) for name in robots.ROBOTS],
)
def test_gains_and_short_delays_pass(name):
    halves = scaled(0.5, 2.0)
    assert told(name, halves) == []
    assert told(name, lambda robot, log: with_later_torque(log, 0.025)) == []
