"""Slides that always carry the same: their friction, rotor and offset could be all that a model needs of them.

Torques in closed form, and a hinge that is right throughout.
"""

import mujoco
import numpy as np
import pytest

import jax_inertia as ji
from jax_inertia.logs.log import Log
from jax_inertia.preflight.against_model import against_model

ROBOT = """<mujoco><worldbody><body><joint name="swing" axis="0 1 0"/>
<inertial mass="3" pos="0 0 -0.3" diaginertia="0.03 0.03 0.01"/></body>
<body pos="1 0 0"><joint name="rail" type="slide" axis="1 0 0"/>
<inertial mass="6" pos="0 0 0" diaginertia="0.02 0.02 0.02"/>
<body pos="0 0 0.1"><joint name="lift" type="slide" axis="0 0 1"/>
<inertial mass="2" pos="0.05 0 0" diaginertia="0.01 0.01 0.01"/></body></body></worldbody></mujoco>"""
NAMES = "swing", "rail", "lift"
INERTIA = np.array([3 * 0.3**2 + 0.03 + 0.1, 8.0 + 3.0, 2.0 + 0.8])
"""What each joint moves, its rotor's inertia with it [kg m², kg, kg]."""
WEIGHT = 2 * 9.81
LEVEL, DAMPING, OFFSET = np.array([0.4, 4.0, 2.0]), np.array([0.2, 6.0, 3.0]), [0.1, -0.5, 0.6]


def log_of(change=lambda tau: None, weight: float = 1.0) -> Log:
    rng = np.random.default_rng(2)
    t = np.arange(0.0, 12.0, 0.004)
    q, v, a = np.zeros((3, len(t), 3))
    for f in (0.13, 0.31, 0.57, 0.83):
        size = np.array([0.3, 0.03, 0.03]) * rng.uniform(0.5, 1.0, 3)
        phase, w = rng.uniform(0, 6.28, 3), 2 * np.pi * f
        q += size * np.sin(w * t[:, None] + phase)
        v += size * w * np.cos(w * t[:, None] + phase)
        a -= size * w * w * np.sin(w * t[:, None] + phase)
    tau = INERTIA * a + LEVEL * np.tanh(v / 1e-3) + DAMPING * v + OFFSET
    tau[:, 0] += 3 * 9.81 * 0.3 * np.sin(q[:, 0])
    tau[:, 2] += weight * WEIGHT
    change(tau)
    return Log(
        time=t,
        qpos=q + 5e-6 * rng.normal(size=q.shape),
        qvel=None,
        tau=tau + 0.02 * rng.normal(size=q.shape),
        joint_names=NAMES,
        tau_kind="sensor",
    )


def turned(joint: str):
    def change(tau):
        tau[:, NAMES.index(joint)] *= -1.0

    return change


@pytest.fixture(scope="module")
def robot():
    return ji.load_model(mujoco.MjModel.from_xml_string(ROBOT))


@pytest.mark.parametrize("joint", ["rail", "lift"])
def test_friction_that_drives_is_a_sign(robot, joint):
    (finding,) = against_model(log_of(turned(joint)), robot)
    assert finding.check == "sign"
    assert f"tau of {joint} is minus" in finding.message


def test_an_offset_as_large_as_the_weight_is_none(robot):
    (finding,) = against_model(log_of(weight=0.0), robot)
    assert finding.check == "gravity"
    assert "tau of lift does not hold the weight" in finding.message


@pytest.mark.parametrize("weight", [1.0, 0.8, 1.3])
def test_what_such_a_joint_may_have_is_no_other_reading(robot, weight):
    """A drawing that is a fifth off, a load: friction is all that is said to be missing."""
    assert [f.check for f in against_model(log_of(weight=weight), robot)] == ["no_friction"]
