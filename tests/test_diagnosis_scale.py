"""Robots of tonnes and of grams: what is too far, too hard or within tolerance grows with them; logs by MuJoCo C."""

import mujoco
import numpy as np
import pytest
from arm_log import loaded, simulate, sized

from jax_inertia import load_model
from jax_inertia.diagnosis.entry import diagnose
from jax_inertia.diagnosis.result import Verdict

# Links of 4.8 m and 3 t, and of 24 mm and 0.4 g.
CRANE, FINGER = 12.0, 0.06


def the_one(size, **hidden):
    """The effect that explains a log of an arm of some size."""
    found = diagnose(load_model(sized(size)), simulate(size=size, **hidden))
    assert found.verdict is Verdict.EXPLAINED, found.headline
    (effect,) = found.odd
    return effect, {name: p.value for name, p in effect.parameters.items()}


@pytest.mark.slow
@pytest.mark.parametrize("size", [FINGER])
def test_a_load_is_found_on_a_robot_of_any_size(size):
    mass, at = 0.3 * size**3, (0.02 * size, 0.0, -0.2 * size)
    effect, value = the_one(size, edit=loaded(mass, at, 0.05 * size))
    assert (effect.family, effect.place.name) == ("payload", "lower")
    assert value["mass"] == pytest.approx(mass, rel=0.1)
    assert value["com_z"] == pytest.approx(at[2], rel=0.05)


@pytest.mark.slow
def test_a_crane_is_pushed_by_more_than_a_person():
    force = np.array([9000.0, 0.0, -6000.0])
    effect, value = the_one(CRANE, force=lambda t: force * (3.0 <= t < 4.2))
    assert (effect.family, effect.place.name) == ("push", "lower")
    assert value["force_x"] == pytest.approx(9000.0, rel=0.1)


@pytest.mark.slow
def test_a_load_of_any_form_is_one_effect():
    """A box is neither a point nor a ball: of its inertia some is left, which is no change of the link's own."""

    def edit(model):
        loaded(0.8, (0.05, 0.1, -0.25))(model)
        turn = np.zeros(9)
        mujoco.mju_quat2Mat(turn, model.body_iquat[2])
        turn = turn.reshape(3, 3)
        inertia = turn @ np.diag(model.body_inertia[2]) @ turn.T + np.diag([0.001, 0.006, 0.006])
        model.body_inertia[2], axes = np.linalg.eigh(inertia)
        axes[:, 2] *= np.sign(np.linalg.det(axes))
        mujoco.mju_mat2Quat(model.body_iquat[2], axes.ravel())

    effect, value = the_one(1.0, edit=edit)
    assert (effect.family, effect.place.name) == ("payload", "lower")
    assert value["mass"] == pytest.approx(0.8, rel=0.05)
