"""Forces on bodies: at their centre of mass or any other point; logs by MuJoCo C."""

import re

import mujoco
import numpy as np
import pytest
from arm_log import ARM, simulate

from jax_inertia import load_model
from jax_inertia.diagnosis.entry import diagnose
from jax_inertia.diagnosis.result import Verdict

PULL = np.array([4.0, 0.0, -7.0])
TIP = (0.03, 0.0, -0.33)


@pytest.fixture(scope="module")
def robot():
    return load_model(mujoco.MjModel.from_xml_string(ARM))


@pytest.mark.slow
def test_a_pull_away_from_the_centre_of_mass_is_found_with_its_point(robot):
    found = diagnose(robot, simulate(force=lambda t: PULL, at=TIP))
    assert found.verdict is Verdict.EXPLAINED
    (effect,) = found.odd
    assert (effect.family, effect.place.name) == ("constant_force", "lower")
    # On a line along the elbow's axis, the nearer to the shoulder's the harder: all of it is in the intervals.
    truth = dict(zip(("force_x", "force_y", "force_z"), PULL, strict=True))
    truth |= dict(zip(("point_x", "point_y", "point_z"), TIP, strict=True))
    for name, x in truth.items():
        assert effect.parameters[name].low <= x <= effect.parameters[name].high
    force = np.array([effect.parameters[f"force_{k}"].value for k in "xyz"])
    cosine = force @ PULL / np.linalg.norm(force) / np.linalg.norm(PULL)
    assert cosine == pytest.approx(1.0, abs=1e-3)
    assert np.linalg.norm(force) == pytest.approx(np.linalg.norm(PULL), rel=0.3)


def test_a_hard_pull_beside_a_centre_of_mass_that_is_off_is_one_force(robot):
    found = diagnose(robot, simulate(force=lambda t: 3.0 * PULL, at=(0.0205, 0.0, -0.151)))
    assert found.verdict is Verdict.EXPLAINED
    (effect,) = found.odd
    assert (effect.family, effect.place.name) == ("constant_force", "lower")
    assert effect.parameters["point_x"].low <= 0.0205 <= effect.parameters["point_x"].high


def test_a_pull_at_the_centre_of_mass_is_there(robot):
    (effect,) = diagnose(robot, simulate(force=lambda t: PULL)).odd
    assert (effect.family, effect.place.name) == ("constant_force", "lower")
    for name, x in zip("xyz", (0.02, 0.0, -0.15), strict=True):
        point = effect.parameters[f"point_{name}"]
        assert point.low <= x <= point.high


def test_the_headline_tells_how_hard_it_pulls(robot):
    found = diagnose(robot, simulate(force=lambda t: np.array([0.0, 0.0, -7.0])))
    size = float(re.search(r"constant force at lower \(([\d.]+) N\)", found.headline)[1])
    assert size == pytest.approx(7.0, rel=0.05)


def pushed(start: float, force: np.ndarray):
    """A force for a second, from `start` [s] on."""
    return lambda t: force if start < t < start + 1.0 else np.zeros(3)


@pytest.fixture(scope="module")
def push_log():
    return simulate(force=pushed(3.0, 2.0 * PULL), seconds=8.0)


@pytest.mark.parametrize(
    ("again", "shrinks"),
    [
        pytest.param(lambda t: np.zeros(3), pytest.approx(0.0, abs=0.1), id="not again"),
        pytest.param(pushed(3.0, 2.0 * PULL), pytest.approx(0.95, abs=0.06), id="as it was"),
        pytest.param(
            pushed(1.2, np.array([-9.0, 0.0, 3.0])), pytest.approx(0.95, abs=0.06), id="otherwise"
        ),
    ],
)
@pytest.mark.slow
def test_a_push_may_happen_again_on_another_motion(robot, push_log, again, shrinks):
    other = simulate(force=again, seconds=6.0, seed=5)
    found = diagnose(robot, push_log, test_log=other)
    assert found.verdict is Verdict.EXPLAINED
    (effect,) = found.odd
    assert (effect.family, effect.place.name) == ("push", "lower")
    # When, and how hard, the other motion tells.
    assert found.test is not None
    assert found.test.share == shrinks


@pytest.mark.slow
def test_a_push_does_not_excuse_another_cause_on_another_motion(robot, push_log):
    other = simulate(force=lambda t: PULL, seconds=6.0, seed=5)
    assert diagnose(robot, push_log, test_log=other).verdict is Verdict.UNKNOWN


@pytest.mark.slow
def test_a_body_that_is_pushed_twice_is_named_twice(robot):
    """By two forces at two times: what is left of one that is found is no push on the next body."""
    twice = (pushed(1.8, 2.0 * PULL), pushed(5.2, np.array([-3.0, 0.0, -5.0])))
    found = diagnose(robot, simulate(force=lambda t: sum(push(t) for push in twice), seconds=8.0))
    assert found.verdict in (Verdict.EXPLAINED, Verdict.PARTLY)
    assert [(f.family, f.place.name) for f in found.odd] == [("push", "lower")] * 2
    forces = {round(f.parameters["start"].value): f.parameters for f in found.odd}
    assert set(forces) == {2, 5}
    assert forces[2]["force_x"].value == pytest.approx(8.0, rel=0.1)
    assert forces[5]["force_x"].value == pytest.approx(-3.0, rel=0.2)


@pytest.mark.slow
def test_what_only_the_other_motion_shows_elsewhere_makes_no_wrong_cause(robot):
    """Friction at the shoulder; the elbow's drive has a limit that only the faster motion comes to."""

    def lacking(t, q, v, u):
        return np.array([-0.4 * np.tanh(v[0] / 0.005), np.clip(u[1], -4.0, 4.0) - u[1]])

    log, other = simulate(lacking, pace=0.5), simulate(lacking, seed=5)
    assert np.abs(log.tau[:, 1]).max() < 4.0 < np.abs(other.tau[:, 1]).max()
    found = diagnose(robot, log, test_log=other)
    assert found.verdict in (Verdict.PARTLY, Verdict.UNKNOWN)
    (effect,) = found.found
    assert (effect.family, effect.place.name) == ("coulomb_friction", "shoulder")
    assert max(found.remainder.where, key=found.remainder.where.get) == "elbow"


@pytest.mark.slow
def test_a_soft_stop_is_no_push(robot):
    def rubber(t, q, v, u):
        depth = max(q[1] - 2.3, 0.0)
        return np.array([0.0, -max(0.1 * depth * (1.0 + 0.3 * v[1]), 0.0)])

    found = diagnose(robot, simulate(torque=rubber))
    assert found.verdict in (Verdict.PARTLY, Verdict.UNKNOWN)
