"""A joint beside one that a model misses by far more; logs by MuJoCo C."""

import mujoco
import numpy as np
import pytest
from arm_log import ARM, simulate

from jax_inertia import load_model
from jax_inertia.diagnosis.entry import diagnose
from jax_inertia.diagnosis.result import Verdict

BIAS = 0.25


def strange(t, q, v, u):
    """A constant torque on the shoulder, and on the elbow what no library has."""
    return np.array([BIAS, 1.5 * np.sin(2.0 * v[0]) * np.cos(4.0 * q[1])])


@pytest.mark.slow
def test_a_joint_is_heard_beside_one_that_no_effect_explains():
    found = diagnose(load_model(mujoco.MjModel.from_xml_string(ARM)), simulate(strange))
    assert found.verdict is Verdict.UNKNOWN
    [bias] = [f for f in found.odd if f.place.name == "shoulder"]
    assert bias.family == "torque_bias"
    assert bias.parameters["bias"].low <= BIAS <= bias.parameters["bias"].high
