"""What the search and its checks keep and drop, at the borders: gate, exchange, pruning, held-out odds."""

import dataclasses

import numpy as np
import pytest

from jax_inertia.diagnosis.certainty import probability
from jax_inertia.diagnosis.certainty.probability import log_odds
from jax_inertia.diagnosis.certainty.rivals import Rival
from jax_inertia.diagnosis.checks import HeldOut, gated
from jax_inertia.diagnosis.effects.base import Place
from jax_inertia.diagnosis.effects.joint import JointSpring, ViscousFriction
from jax_inertia.diagnosis.features.two_mass import DrivenLink
from jax_inertia.diagnosis.hypothesis import Hypothesis
from jax_inertia.diagnosis.residual import Residual
from jax_inertia.diagnosis.search import one_more, stepwise
from jax_inertia.diagnosis.search.bank import Bank
from jax_inertia.diagnosis.search.evidence import Evidence, Posterior
from jax_inertia.diagnosis.search.selection import Selection, _larger
from jax_inertia.diagnosis.settings import Settings

ROWS, JOINTS = 40, 2


def effect(kind, k: int, odds: float) -> Hypothesis:
    """One number at joint k, seen on every row."""
    columns = np.random.default_rng(k).normal(size=(ROWS, JOINTS, 1))
    place = Place("joint", f"j{k}", k % JOINTS)
    own = kind()
    return Hypothesis(
        own, place, (), columns, None, np.ones(1), np.zeros(1), odds, assumed=own.ordinary
    )


FRICTION, SPRING, OTHER = (
    effect(ViscousFriction, 0, 2.0),
    effect(JointSpring, 1, 8.0),
    effect(JointSpring, 2, 8.0),
)


def chosen_of(*hypotheses: Hypothesis) -> Posterior:
    evidence = Evidence(np.zeros((ROWS, JOINTS)), np.ones((ROWS, JOINTS)), np.ones(JOINTS))
    return evidence.posterior(hypotheses)


class Judge(HeldOut):
    """Rows whose error is known for each set of hypotheses."""

    def __init__(self, errors: dict[frozenset[int], float]):
        self.errors = errors

    def error(self, now: Posterior) -> float:
        return self.errors[frozenset(map(id, now.chosen))]

    def errors_without(self, now, asked):
        return [self.error(now.without(h)) for h in asked]


def kept(errors: dict[tuple[Hypothesis, ...], float]) -> set[int]:
    """What the gate keeps of friction and two springs."""
    evidence = Evidence(np.zeros((ROWS, JOINTS)), np.ones((ROWS, JOINTS)), np.ones(JOINTS))
    now = evidence.posterior((FRICTION, SPRING, OTHER))
    selection = Selection(object.__new__(Residual), evidence, now, (), ())
    table = {frozenset(map(id, some)): e for some, e in errors.items()}
    after, dropped = gated(selection, Judge(table), Settings())
    assert {*map(id, after.posterior.chosen), *map(id, dropped)} == {*map(id, now.chosen)}
    return {*map(id, after.posterior.chosen)}


EVERY = (FRICTION, SPRING, OTHER)


@pytest.mark.parametrize(("without", "stays"), [(0.91, True), (0.89, False)])
def test_an_effect_that_raises_the_error_of_held_out_rows_by_a_tenth_goes(without, stays):
    errors = {
        EVERY: 1.0,
        (FRICTION,): 2.0,
        (FRICTION, SPRING): without,
        (FRICTION, OTHER): 1.5,
        (SPRING, OTHER): 3.0,
        (SPRING,): 3.0,
    }
    assert kept(errors) == {*map(id, EVERY if stays else (FRICTION, SPRING))}


def test_an_ordinary_effect_may_be_the_one_that_goes():
    errors = {
        EVERY: 1.0,
        (FRICTION,): 2.0,
        (SPRING, OTHER): 0.5,
        (FRICTION, SPRING): 2.0,
        (FRICTION, OTHER): 2.0,
        (SPRING,): 0.7,
        (OTHER,): 0.7,
    }
    assert kept(errors) == {id(SPRING), id(OTHER)}


@pytest.mark.parametrize(("ordinary", "stays"), [(0.92, True), (0.90, False)])
def test_odd_effects_that_together_do_worse_than_ordinary_physics_go(ordinary, stays):
    errors = {
        EVERY: 1.0,
        (FRICTION,): ordinary,
        (FRICTION, SPRING): 0.97,
        (FRICTION, OTHER): 0.98,
        (SPRING, OTHER): 3.0,
        (SPRING,): 3.0,
    }
    assert kept(errors) == {*map(id, EVERY if stays else (FRICTION, SPRING))}


def test_what_is_left_out_is_what_was_never_chosen():
    """Mean and covariance of the others, against the posterior of them alone."""
    rng = np.random.default_rng(4)
    evidence = Evidence(
        rng.normal(size=(ROWS, JOINTS)), np.ones((ROWS, JOINTS)), np.full(JOINTS, 0.5)
    )
    downdated = evidence.posterior(EVERY).without(SPRING)
    alone = evidence.posterior((FRICTION, OTHER))
    np.testing.assert_allclose(downdated.mean, alone.mean, rtol=1e-9)
    np.testing.assert_allclose(downdated.covariance, alone.covariance, rtol=1e-9)
    assert downdated.log_evidence == pytest.approx(alone.log_evidence)


class Worths(Evidence):
    """Evidence whose worth of each hypothesis is given [nats]."""

    def __init__(self, **worths: float):
        super().__init__(np.zeros((ROWS, JOINTS)), np.ones((ROWS, JOINTS)), np.ones(JOINTS))
        self.by_place = worths

    def worths(self, now: Posterior):
        return np.array([self.by_place.get(h.place.name, 99.0) for h in now.chosen])


def test_an_effect_goes_once_it_has_lost_a_nat_more_than_its_odds_the_faintest_first():
    residual, now = object.__new__(Residual), chosen_of(*EVERY)
    stays = one_more.pruned(residual, Worths(j1=7.05, j2=9.0), now)
    assert stays.chosen == EVERY
    goes = one_more.pruned(residual, Worths(j1=6.95, j2=9.0), now)
    assert goes.chosen == (FRICTION, OTHER)
    none = one_more.pruned(residual, Worths(j0=-50.0, j1=1.0, j2=0.0), now)
    assert none.chosen == (FRICTION,)


@pytest.mark.parametrize(("gain", "exchanged"), [(11.9, False), (12.1, True)])
def test_another_effect_takes_a_place_by_two_nats_and_not_by_less(monkeypatch, gain, exchanged):
    """The spring brings 18 nats for its odds of 8; the other one, which searches no number, `gain` beyond its own."""
    now = chosen_of(FRICTION, SPRING)
    after = chosen_of(FRICTION, OTHER)
    monkeypatch.setattr(stepwise, "_best", lambda *_: iter([(OTHER, gain)]))
    monkeypatch.setattr(stepwise, "with_one_more", lambda *_: after)
    monkeypatch.setattr(stepwise, "_settled_with", lambda *_: after)
    monkeypatch.setattr(stepwise.sensor_noise, "owed", lambda *_: 0.0)
    monkeypatch.setattr(one_more, "steps_of", lambda *_: ())
    bank, nothing = Bank((SPRING, OTHER)), object.__new__(Residual)
    came = stepwise._exchanged(nothing, Worths(j1=18.0), now, bank, set(), set(), set())
    assert (came is after) == exchanged


def test_a_covariance_is_as_wide_as_the_wider_of_two_along_each_axis():
    """Of a calibrated model: the sandwich of the log's tenths where that is wider, never where it is narrower."""
    own, spread = np.diag([4.0, 1.0]), np.diag([1.0, 9.0])
    np.testing.assert_allclose(_larger(own, spread), np.diag([4.0, 9.0]), atol=1e-12)


def test_an_effect_is_as_sure_as_the_nearest_of_what_stands_against_it():
    assert log_odds([7.0]) == pytest.approx(7.0)
    assert log_odds([7.0, 2.0, 2.0]) == pytest.approx(-np.log(np.exp(-7.0) + 2 * np.exp(-2.0)))


def test_the_calibrated_probability_rises_with_the_odds_and_is_never_one():
    steps = [probability.probability(x) for x in (-1e4, -10.0, 0.0, 10.0, 1e4)]
    assert steps == sorted(set(steps))
    assert steps[0] > 0.0
    assert steps[-1] < 1.0
    assert steps[2] == 0.5
    assert steps[3] == pytest.approx(
        1.0 / (1.0 + np.exp(-probability.calibration()["slope"] * np.arcsinh(10.0)))
    )


class Foretold(HeldOut):
    """Rows that are likelier by some nats with what was chosen than with another in its place."""

    def __init__(self, nats: float):
        self.nats = nats

    def ahead(self, now, other):
        return self.nats


def odds(monkeypatch, ahead: float, cause: float = 40.0) -> float:
    """Of a spring that brings 38 nats for odds of 8; another is 12 nats behind it where both are fitted."""
    monkeypatch.setattr(probability, "evidence_of_causes", lambda *_: [cause])
    evidence = Worths(j1=38.0)
    selection = Selection(
        object.__new__(Residual), evidence, evidence.posterior((FRICTION, SPRING)), (), ()
    )
    judges = [Foretold(ahead)]
    by = probability.behind_it(selection, SPRING, Rival(OTHER, 12.0), judges)
    return probability.odds_of_effect(selection, SPRING, [by] if by > 0.0 else [], judges)


def test_an_effect_is_less_probable_where_another_predicts_held_out_rows_nearly_as_well(
    monkeypatch,
):
    """And tied with one that predicts them no worse: then it is the pair that is there."""
    far, near, none = (odds(monkeypatch, ahead) for ahead in (50.0, 2.0, -3.0))
    assert far == pytest.approx(log_odds([30.0, 12.0]))
    assert near == pytest.approx(log_odds([30.0, 2.0]))
    assert none == pytest.approx(30.0)


def test_an_effect_is_no_more_probable_than_rows_say_that_it_was_not_fitted_to(monkeypatch):
    assert odds(monkeypatch, 50.0, cause=11.0) == pytest.approx(log_odds([3.0, 12.0]))


def test_a_path_that_is_predicted_holds_no_logged_torque():
    """Whatever the motor is said to have given, the link of a soft joint goes as the motion says."""
    time = np.arange(0.0, 4.0, 0.004)
    needed, still = 5.0 * np.sin(2 * np.pi * 0.7 * time), np.zeros_like(time)
    logged = [needed + x * np.sin(2 * np.pi * 3.0 * time) for x in (0.0, 2.0)]
    links = [DrivenLink(time, needed, x, still + 0.8, still, still) for x in logged]
    coupling = (900.0, 0.02, 0.0, 0.0, 0.0)
    drawn = [link.separation(coupling) for link in links]
    predicted = [link.by_motion(needed).separation(coupling) for link in links]
    assert np.max(np.abs(drawn[0] - drawn[1])) > 1e-4
    np.testing.assert_array_equal(predicted[0], predicted[1])
    # Far below the resonance: the torque over the stiffness.
    closed = needed / (900.0 - 0.8 * (2 * np.pi * 0.7) ** 2)
    assert np.max(np.abs(predicted[0] - closed)) < 0.05 * np.max(np.abs(closed))


@pytest.mark.parametrize("differs", [0.0, 1.0])
def test_a_number_that_parts_of_a_log_disagree_about_is_known_as_well_as_they_agree(differs):
    """Ten parts with a number each, of standard deviation one: that of their mean is 1/√10."""
    rng, rows = np.random.default_rng(7), 2000
    columns, own = rng.normal(size=(rows, 1)), 3.0 + differs * np.repeat(rng.normal(size=10), 200)
    y = columns * own[:, None] + 0.3 * rng.normal(size=(rows, 1))
    evidence = Evidence(y, np.ones_like(y), np.full(1, 0.3))
    noise = dataclasses.replace(evidence.noise, variance=np.full_like(y, 0.09))
    evidence.noise = noise
    place = Place("joint", "j0", 0)
    h = Hypothesis(
        JointSpring(), place, (), columns[:, None], None, np.full(1, 9.0), np.zeros(1), 8.0
    )
    residual = object.__new__(Residual)
    residual.y = y
    selection = Selection(residual, evidence, evidence.posterior((h,)), (), ())
    white = 0.09 / np.sum(columns**2)
    wanted = white if not differs else np.var(own.reshape(10, 200)[:, 0], ddof=1) / 10.0
    assert 81.0 * selection.spread[0, 0] == pytest.approx(wanted, rel=0.6)
