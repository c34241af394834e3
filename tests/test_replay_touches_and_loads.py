"""Touches in a replay, loads beside a body's centre, and friction that grows along a joint."""

import mujoco
import numpy as np
import pytest

from jax_inertia.model.joint_inertia import put_load
from jax_inertia.model.load import body_pi
from jax_inertia.replay import checks
from jax_inertia.replay.loop import Loop, Parameter
from jax_inertia.replay.record import Commanded, Record
from jax_inertia.replay.simulation.plant import Plant

ARM = """<mujoco><compiler angle="radian"/><worldbody><body name="upper"><joint name="a" axis="0 1 0" range="-1 3"/>
<inertial pos="0 0 -0.1" mass="0.8" diaginertia="0.004 0.003 0.001"/>
<body name="lower" pos="0 0 -0.2"><joint name="b" axis="0 1 0"/>
<inertial pos="0.01 0 -0.1" quat="0.9 0.1 0.3 0" mass="0.5" diaginertia="0.002 0.0015 0.001"/>
</body></body></worldbody></mujoco>"""


def record(error: np.ndarray) -> Record:
    time = np.arange(len(error)) * 0.01
    q = np.zeros_like(error)
    return Record(time, q, np.zeros(error.shape[1]), Commanded(time, q))


def test_joints_that_part_together_touch_something_and_one_joint_alone_does_not():
    rng = np.random.default_rng(0)
    errors = 1e-3 * rng.normal(size=(1000, 4))
    alone = errors.copy()
    alone[300:400, 1] += 0.05
    together = errors.copy()
    together[300:400, :3] += [0.05, -0.03, 0.02]
    always = errors.copy()
    always[200:900, :3] += [0.05, -0.03, 0.02]
    trees = np.zeros(4, int)
    for error, first, last in ((alone, 0, 0), (always, 0, 0), (together, 250, 450)):
        (mask,) = checks.touches([error], [record(error)], trees)
        assert mask.sum() == last - first
        assert mask[first:last].all()
    # Of separate chains no force acts on all.
    (mask,) = checks.touches([together], [record(together)], np.arange(4))
    assert not mask.any()


def test_samples_that_are_touched_do_not_count():
    touched = np.zeros(1000, bool)
    touched[300:400] = True
    one = record(np.zeros((1000, 2)))._replace(touched=touched)
    assert one.settled.sum() == 1000 - 20 - 100
    assert one.between(350, 1000).settled.sum() == 650 - 50
    (line,) = checks.touch_note([one])
    assert "3.0 to 4.0 s" in line


def test_a_load_beside_a_body_is_the_sum_of_both():
    model = mujoco.MjModel.from_xml_string(ARM)
    body = model.body("lower").id
    before, centre = body_pi(model, body), model.body_ipos[body].copy()
    added, r = 0.3, np.array([0.02, -0.01, 0.05])

    def shape(at, mass):
        return mass * (at @ at * np.eye(3) - np.outer(at, at))[np.triu_indices(3)]

    put_load(model, body, added, r)
    own = before[4:] - shape(centre, before[0])
    both = own + shape(centre, before[0]) + shape(centre + r, added)
    first = before[1:4] + added * (centre + r)
    expected = np.concatenate([[before[0] + added], first, both])
    np.testing.assert_allclose(body_pi(model, body), expected, atol=1e-12)


def test_friction_that_grows_along_a_joint_is_the_plain_one_in_the_middle_of_its_range():
    loop = Loop(np.full(2, 20.0), np.full(2, 0.5), np.full(2, np.inf), "log")
    plant = Plant(mujoco.MjSpec.from_string(ARM), ["a", "b"], loop)
    table = (
        Parameter("coulomb_friction", 0, 0.0, 1.0, 0.0, 5.0),
        Parameter("position_friction", 0, 0.0, 1.0, -5.0, 5.0),
    )
    numbers = plant.numbers(table, np.array([0.4, 0.5]), None)
    assert numbers.varies
    for q, dry in ((1.0, 0.4), (2.0, 0.9), (-0.5, 0.0)):
        found = numbers.friction(np.zeros(2), np.array([q, 0.0]), np.zeros(2))
        assert found == pytest.approx([dry, 0.0])
