"""What a log could not have shown: a little more is found, a tenth of it is not; logs by MuJoCo C."""

import mujoco
import numpy as np
import pytest
from arm_log import ARM, loaded, simulate

from jax_inertia import load_model
from jax_inertia.diagnosis.entry import diagnose
from jax_inertia.diagnosis.result import Verdict

CENTRE = (0.02, 0.0, -0.15)


@pytest.fixture(scope="module")
def robot():
    return load_model(mujoco.MjModel.from_xml_string(ARM))


@pytest.fixture(scope="module")
def smallest(robot):
    """By family and place, of a log with nothing to find."""
    found = diagnose(robot, simulate())
    assert found.verdict is Verdict.NO_GAP
    return {(family, place.name): p for family, place, p in found.undetectable_below}


def biased(size):
    return {"torque": lambda t, q, v, u: np.array([0.0, size])}


def dragging(size):
    return {"torque": lambda t, q, v, u: np.array([0.0, -size * v[1]])}


def weighed(size):
    return {"edit": loaded(size, CENTRE)}


@pytest.mark.parametrize(
    ("family", "place", "unit", "hidden"),
    [
        ("torque_bias", "elbow", "N m", biased),
        ("viscous_friction", "elbow", "N m s/rad", dragging),
        ("payload", "lower", "kg", weighed),
    ],
)
@pytest.mark.slow
def test_a_little_more_is_found_and_far_less_is_not(robot, smallest, family, place, unit, hidden):
    size = smallest[family, place]
    assert size.unit == unit
    seen = diagnose(robot, simulate(**hidden(2.0 * size.value)))
    # Found, or a number of the model is said to be off.
    assert seen.verdict is not Verdict.NO_GAP
    assert diagnose(robot, simulate(**hidden(0.1 * size.value))).verdict is Verdict.NO_GAP


def test_every_kind_of_effect_with_a_size_is_told(smallest):
    told = {family for family, _ in smallest}
    assert told >= {
        *("viscous_friction", "coulomb_friction", "joint_spring", "armature", "torque_bias"),
        *("torque_gain", "time_delay", "actuator_lag", "encoder_scale"),
        *("payload", "com_shift", "link_inertia", "constant_force", "drag"),
    }
    assert all(np.isfinite(p.value) for p in smallest.values())
