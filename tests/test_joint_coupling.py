"""A motor that turns with the joint before it: what identification computes against MuJoCo C's own tendon."""

import dataclasses

import jax
import mujoco
import numpy as np
import pytest
from diagnosis_robot import NOMINAL, log_of, motion

from jax_inertia.diagnosis.effects.base import Place
from jax_inertia.diagnosis.effects.identified import Identified
from jax_inertia.diagnosis.effects.transmission import JointCoupling
from jax_inertia.diagnosis.residual import Residual
from jax_inertia.diagnosis.settings import Settings
from jax_inertia.diagnosis.simulate.corrected import corrected
from jax_inertia.model.load import load_model

TIME, Q, V, A = motion(3, seconds=5.0, rate=250.0)
C, DAMPING, LEVEL, ROTOR = -0.4, 0.3, 0.25, 0.02
RUBBING = NOMINAL.replace(
    'name="wrist"', f'name="wrist" damping="{DAMPING}" frictionloss="{LEVEL}" armature="{ROTOR}"'
)
PLACE = Place("joint", "wrist", 2, "elbow")
TURNS = np.array([0.0, C, 1.0])
"""Of the wrist's motor, by each joint's speed."""


@pytest.fixture(scope="module", autouse=True)
def double_precision():
    with jax.enable_x64(True):
        yield


def torque_of_motors() -> np.ndarray:
    """What the motors give along the motion (T, 3), by MuJoCo's inverse dynamics and the motor's own equation."""
    model = mujoco.MjModel.from_xml_string(NOMINAL)
    data, joints = mujoco.MjData(model), np.zeros_like(V)
    for k in range(len(Q)):
        data.qpos[:], data.qvel[:], data.qacc[:] = Q[k], V[k], A[k]
        mujoco.mj_inverse(model, data)
        joints[k] = data.qfrc_inverse
    speed = V @ TURNS
    own = joints[:, 2] + ROTOR * (A @ TURNS) + DAMPING * speed + LEVEL * np.sign(speed)
    # The elbow's motor gives what its joint needs, less what the wrist's brings.
    return np.stack([joints[:, 0], joints[:, 1] - C * joints[:, 2], own], axis=1)


def test_columns_are_the_motors_own_equation():
    asked = torque_of_motors()
    robot = load_model(mujoco.MjModel.from_xml_string(RUBBING)).astype("float64")
    log = log_of(TIME, Q, asked, noise=0.0)
    residual = Residual(robot, dataclasses.replace(log, qpos=Q), Settings())
    values, row = residual.rows_of(JointCoupling().columns(residual.context, PLACE, (C, 0.0)))
    assert row is None
    theta = np.array([C, C * DAMPING])
    inside = slice(5, -5)
    wanted = residual.y[inside]
    off = (values @ theta)[inside] - wanted
    # Dry friction turns at once here, and over a small displacement there.
    assert np.sqrt(np.mean(off**2)) < 0.03 * np.sqrt(np.mean(wanted**2))
    fitted = np.linalg.lstsq(values[inside].reshape(-1, 2), wanted.ravel())[0]
    assert fitted == pytest.approx(theta, rel=0.05)


def test_the_tendon_turns_rubs_and_weighs_as_the_motor():
    values = {"coefficient": C, "friction_of_other_speed": C * DAMPING}
    found = Identified("joint_coupling", "joint", "wrist", values, "elbow")
    more = Identified("viscous_friction", "joint", "wrist", {"damping": 0.1})
    model = corrected(mujoco.MjSpec.from_string(RUBBING), [found, more]).spec.compile()
    # Whatever else is found of the joint comes first.
    assert model.tendon_damping == pytest.approx([DAMPING])
    assert model.dof_damping[2] == pytest.approx(0.1)
    assert model.tendon_frictionloss == pytest.approx([LEVEL])
    assert model.dof_frictionloss[2] == 0.0
    own = mujoco.MjModel.from_xml_string(NOMINAL)
    assert mass_matrix(model) - mass_matrix(own) == pytest.approx(
        ROTOR * np.outer(TURNS, TURNS), abs=1e-12
    )


def mass_matrix(model: mujoco.MjModel) -> np.ndarray:
    """Of the first moment (3, 3)."""
    data, full = mujoco.MjData(model), np.zeros((3, 3))
    data.qpos[:] = Q[0]
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, full)
    return full
