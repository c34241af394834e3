"""Forces on bodies: at their centre of mass or any other point; logs by MuJoCo C."""

import re
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from arm_log import ARM, loaded, simulate

from jax_inertia import load_model
from jax_inertia.diagnosis.effects.base import Place
from jax_inertia.gap import Verdict, diagnose
from jax_inertia.gap.candidate import Candidate
from jax_inertia.gap.doubt import better_than
from jax_inertia.gap.evidence import Evidence
from jax_inertia.gap.locate import _closed, windows
from jax_inertia.gap.outsiders import Outsider
from jax_inertia.gap.pool import Pool
from jax_inertia.gap.select import _likelier, split
from jax_inertia.gap.together import solved

PULL = np.array([4.0, 0.0, -7.0])
TIP = (0.03, 0.0, -0.33)


@pytest.fixture(scope="module")
def robot():
    return load_model(mujoco.MjModel.from_xml_string(ARM))


@pytest.mark.slow
def test_a_pull_away_from_the_centre_of_mass_is_found_with_its_point(robot):
    found = diagnose(robot, simulate(force=lambda t: PULL, at=TIP))
    assert found.verdict is Verdict.EXPLAINED
    (effect,) = found.findings
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


def test_numbers_stay_where_they_are_along_what_is_not_told():
    columns = np.outer(np.arange(1.0, 6.0), [2.0, 4.0])
    start = np.array([3.0, -1.0])
    target = columns @ start + columns[:, 0]
    np.testing.assert_allclose(columns @ solved(columns, target, start), target)
    assert np.linalg.norm(solved(columns, target, start) - start) < 1.0


def test_a_hard_pull_beside_a_centre_of_mass_that_is_off_is_one_force(robot):
    found = diagnose(robot, simulate(force=lambda t: 10.0 * PULL, at=(0.0205, 0.0, -0.151)))
    assert found.verdict is Verdict.EXPLAINED
    (effect,) = found.findings
    assert (effect.family, effect.place.name) == ("constant_force", "lower")
    assert effect.parameters["point_x"].low <= 0.0205 <= effect.parameters["point_x"].high


def test_a_pull_at_the_centre_of_mass_needs_no_point(robot):
    (effect,) = diagnose(robot, simulate(force=lambda t: PULL)).findings
    assert (effect.family, effect.place.name) == ("constant_force", "lower")
    assert not any(name.startswith("point") for name in effect.parameters)


def test_the_headline_tells_how_hard_it_pulls(robot):
    found = diagnose(robot, simulate(force=lambda t: np.array([0.0, 0.0, -7.0])))
    size = float(re.search(r"constant force at lower \(([\d.]+) N\)", found.headline)[1])
    assert size == pytest.approx(7.0, rel=0.05)


def test_what_joints_at_rest_do_not_tell_is_no_gap_between_two_stretches():
    loud = np.array([0, 1, 1, 0, 0, 0, 0, 0, 1, 1, 0], bool)
    all_tell = np.ones(len(loud), bool)
    at_rest = all_tell & ~((np.arange(len(loud)) > 3) & (np.arange(len(loud)) < 7))
    np.testing.assert_array_equal(_closed(loud, 3, all_tell), loud)
    joined = np.array([0, 1, 1, 1, 1, 1, 1, 1, 1, 1, 0], bool)
    np.testing.assert_array_equal(_closed(loud, 3, at_rest), joined)


def beside(*columns: np.ndarray) -> tuple[Pool, list[Candidate]]:
    """A pool whose missing torque is the sum of effects with these columns, and the effects."""
    pool, evidence = object.__new__(Pool), object.__new__(Evidence)
    pool.evidence, evidence.y = evidence, np.sum(columns, axis=0)
    evidence.used = np.ones((len(evidence.y), 1), bool)
    effects = [object.__new__(Candidate) for _ in columns]
    for effect, column in zip(effects, columns, strict=True):
        vars(effect).update(columns=column[:, None], offset=np.zeros(len(column)))
        effect.theta = np.ones(1)
    return pool, effects


def test_effects_are_swapped_for_what_costs_less():
    x, y = np.eye(40)[:2] * 30.0
    pool, (one, other) = beside(x, y)
    family = SimpleNamespace(size=None, doubt=0.0, free_shape=0)
    for effect in (one, other):
        effect.family, effect.block, effect.grid = family, SimpleNamespace(shape=()), 1
    assert not _likelier(pool, [one], [other], floor=np.array([900.0]))
    # Six numbers that leave as much as one does.
    other.theta = np.ones(6)
    assert _likelier(pool, [one], [other], floor=np.array([900.0]))
    assert not _likelier(pool, [other], [one], floor=np.array([900.0]))


def test_two_effects_stand_in_place_of_one_that_has_many_numbers_to_draw_both(monkeypatch):
    x, y = np.eye(40)[0] * 30.0, np.eye(40)[1] * 12.0
    pool, (one, other) = beside(x, y)
    draws = beside(x + 0.5 * y)[1][0]
    draws.theta, draws.columns = np.ones(6), np.tile(draws.columns, 6)
    for name, effect in {"bias": one, "tilt": other, "force": draws}.items():
        effect.family = SimpleNamespace(
            name=name, size=None, doubt=0.0, free_shape=0, passing=False
        )
        effect.block, effect.grid, effect.gain = SimpleNamespace(shape=()), 1, 900.0
        effect.place = Place("body", name, 0)
    ranked = {0: [draws, one, other], 1: [other]}
    monkeypatch.setattr("jax_inertia.gap.select.propose", lambda _, some, __: ranked[len(some)])
    monkeypatch.setattr("jax_inertia.gap.select.settle", lambda _, some, __: some)
    assert split(pool, [draws], floor=np.array([40.0])) == [one, other]
    # A load's own centre and inertia are no second cause: not where both act on its body.
    one.place, own = draws.place, one.place
    assert split(pool, [draws], floor=np.array([40.0])) == [one, other]
    other.place = draws.place
    assert split(pool, [draws], floor=np.array([40.0])) == []
    one.place, other.place = own, own
    # One number is not split.
    draws.theta = np.ones(1)
    assert split(pool, [draws], floor=np.array([40.0])) == []
    # Nor where the first of two explains far less.
    draws.theta, one.gain, other.gain = np.ones(6), 700.0, 700.0
    assert split(pool, [draws], floor=np.array([40.0])) == []


def pushed(start: float, force: np.ndarray):
    """A force for a second, from `start` [s] on."""
    return lambda t: force if start < t < start + 1.0 else np.zeros(3)


@pytest.fixture(scope="module")
def push_log():
    return simulate(force=pushed(3.0, 2.0 * PULL), seconds=8.0)


@pytest.mark.parametrize(
    ("again", "shrinks"),
    [
        pytest.param(lambda t: np.zeros(3), None, id="not again"),
        pytest.param(pushed(3.0, 2.0 * PULL), pytest.approx(0.95, abs=0.06), id="as it was"),
        pytest.param(
            pushed(1.2, np.array([-9.0, 0.0, 3.0])), pytest.approx(0.0, abs=0.1), id="otherwise"
        ),
    ],
)
@pytest.mark.slow
def test_a_push_may_happen_again_on_another_motion(robot, push_log, again, shrinks):
    other = simulate(force=again, seconds=6.0, seed=5)
    found = diagnose(robot, push_log, test_log=other)
    assert found.verdict is Verdict.EXPLAINED
    (effect,) = found.findings
    assert (effect.family, effect.place.name) == ("push", "lower")
    # What was fitted to the other motion itself is no prediction of it.
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
    assert found.verdict is Verdict.EXPLAINED
    assert [(f.family, f.place.name) for f in found.findings] == [("push", "lower")] * 2
    forces = {round(f.parameters["start"].value): f.parameters for f in found.findings}
    assert set(forces) == {2, 5}
    assert forces[2]["force_x"].value == pytest.approx(8.0, rel=0.1)
    assert forces[5]["force_x"].value == pytest.approx(-3.0, rel=0.2)


@pytest.mark.slow
def test_a_push_beside_a_load_is_no_error_of_the_loads_equation(robot):
    found = diagnose(
        robot, simulate(edit=loaded(3.0, (0.0, 0.05, -0.3)), force=pushed(3.0, 0.1 * PULL))
    )
    assert found.verdict is Verdict.EXPLAINED
    assert [(x.family, x.place.name) for x in found.findings] == [
        ("payload", "lower"),
        ("push", "lower"),
    ]


@pytest.mark.slow
def test_a_hard_push_excuses_nothing_before_and_after(robot):
    """Errors of a push's equation are bought while it lasts: a little friction shows all along."""

    def rubs(t, q, v, u):
        return np.array([0.0, -0.006 * np.tanh(v[1] / 0.003)])

    found = diagnose(robot, simulate(rubs, force=pushed(3.0, 8.0 * PULL), seed=1))
    assert found.verdict is Verdict.EXPLAINED
    assert [(x.family, x.place.name) for x in found.findings] == [
        ("push", "lower"),
        ("coulomb_friction", "elbow"),
    ]


@pytest.mark.slow
def test_what_only_the_other_motion_shows_elsewhere_makes_no_wrong_cause(robot):
    """Friction at the shoulder; the elbow's drive has a limit that only the faster motion comes to."""

    def lacking(t, q, v, u):
        return np.array([-0.4 * np.tanh(v[0] / 0.005), np.clip(u[1], -4.0, 4.0) - u[1]])

    log, other = simulate(lacking, pace=0.5), simulate(lacking, seed=5)
    assert np.abs(log.tau[:, 1]).max() < 4.0 < np.abs(other.tau[:, 1]).max()
    found = diagnose(robot, log, test_log=other)
    assert found.verdict is Verdict.PARTLY
    (effect,) = found.findings
    assert (effect.family, effect.place.name) == ("coulomb_friction", "shoulder")
    assert "elbow" in found.doubts[0]


def residual(rows: int, loud: float, seed: int) -> tuple[Evidence, np.ndarray]:
    """Whitened noise on some rows for 15 s at 50 Hz, `loud` times as energetic from 4 to 6 s."""
    evidence = object.__new__(Evidence)
    time = np.arange(750) / 50.0
    evidence.prepared = SimpleNamespace(time=time, kept=np.arange(len(time)))
    evidence.used = np.ones((len(time), rows), bool)
    size = np.where((time > 4.0) & (time < 6.0), np.sqrt(loud), 1.0)
    noise = np.random.default_rng(seed).standard_normal((len(time), rows))
    return evidence, (size[:, None] * noise).ravel()


@pytest.mark.parametrize("seed", range(5))
def test_what_is_not_much_louder_stands_out_of_many_rows(seed):
    evidence, y = residual(18, 3.0, seed)
    # The noise is taken for a third louder than it is.
    found = windows(evidence, y, 1.35 * y.size)
    assert any(window == pytest.approx((4.0, 6.0), abs=0.2) for window in found)
    for rows in (2, 7, 18):
        evidence, y = residual(rows, 1.0, seed)
        assert windows(evidence, y, float(y.size)) == ()


def test_what_errors_of_the_feets_sensors_come_to_does_not_speak_alone(monkeypatch):
    pool, _ = beside(np.array([30.0, 0.0]))
    pool.evidence.used = np.ones((2, 1), bool)
    pull = np.array([[1.0], [0.0]])
    held, floating = Outsider("gravity", pull, pull), Outsider("gravity", pull, pull[:, :0])
    monkeypatch.setattr("jax_inertia.gap.doubt.outsiders", lambda pool: [held])
    assert better_than(pool, [], 900.0) == ([], held)
    monkeypatch.setattr("jax_inertia.gap.doubt.outsiders", lambda pool: [floating])
    assert better_than(pool, [], 900.0) is None


@pytest.mark.slow
def test_a_soft_stop_is_no_push(robot):
    def rubber(t, q, v, u):
        depth = max(q[1] - 2.3, 0.0)
        return np.array([0.0, -max(0.1 * depth * (1.0 + 0.3 * v[1]), 0.0)])

    found = diagnose(robot, simulate(torque=rubber))
    assert found.verdict is Verdict.UNKNOWN
    assert any("a soft stop that elbow runs into fits better than push" in x for x in found.doubts)


@pytest.mark.slow
def test_of_two_effects_that_a_log_cannot_tell_the_one_that_another_motion_refutes_does_not_stand(
    robot,
):
    """Moved one way only, a shoulder that rubs is one that is pushed; the other motion turns round."""

    def rubs(t, q, v, u):
        return np.array([-0.4 * np.tanh(v[0] / 0.003), 0.0])

    log = simulate(torque=rubs, seed=2, seconds=5.0, pace=0.1)
    (alone,) = diagnose(robot, log).findings
    assert (alone.family, alone.place.name) == ("torque_bias", "shoulder")
    assert ("coulomb_friction", "motion_limited") in {(t.family, t.kind) for t in alone.equivalent}
    found = diagnose(robot, log, test_log=simulate(torque=rubs, seed=5))
    (effect,) = found.findings
    assert (effect.family, found.verdict) == ("coulomb_friction", Verdict.EXPLAINED)
    assert effect.parameters["coulomb"].value == pytest.approx(0.4, rel=0.03)
    assert any("the other motion speaks against the first" in note for note in found.notes)
