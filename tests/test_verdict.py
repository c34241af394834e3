"""The one table of verdicts, at its borders."""

import dataclasses

import numpy as np
import pytest
from scipy import stats

from jax_inertia.diagnosis.certainty.doubts import Doubts, odds_of_verdict
from jax_inertia.diagnosis.effects.base import Place
from jax_inertia.diagnosis.result import Found, Verdict
from jax_inertia.diagnosis.verdict import Errors, joined, judged
from jax_inertia.maths.sample_weight import odds_within

MOVES = np.array([True, True])
KNEE = Place("joint", "knee", 1)


def errors(before, after, **more) -> Errors:
    """Two joints whose sensors leave 1."""
    given = Errors(
        ("hip", "knee"), np.ones(2), np.array(before), np.array(after), MOVES, np.zeros(2)
    )
    return dataclasses.replace(given, **more)


@pytest.mark.parametrize(
    ("before", "after", "wanted"),
    [
        ((1.51, 1.0), (1.0, 1.0), Verdict.EXPLAINED),
        ((30.0, 1.0), (1.5, 1.5), Verdict.EXPLAINED),
        # A tenth of the gap at a multiple of the floor is no explanation without a stated discrepancy.
        ((300.0, 1.0), (1.6, 1.0), Verdict.PARTLY),
        # One joint at its floor does not make up for another one.
        ((900.0, 40.0), (1.0, 20.0), Verdict.PARTLY),
        ((10.0, 1.0), (8.0, 1.0), Verdict.UNKNOWN),
        # Half of the gap's energy above the floor: (7² − 1) / (10² − 1) and (7.2² − 1) / (10² − 1).
        ((10.0, 1.0), (7.0, 1.0), Verdict.PARTLY),
        ((10.0, 1.0), (7.2, 1.0), Verdict.UNKNOWN),
        # A fit that makes a joint worse that was sound before.
        ((10.0, 1.0), (1.0, 2.0), Verdict.PARTLY),
    ],
)
def test_each_joint_is_judged_by_its_own_floor(before, after, wanted):
    assert judged(errors(before, after), named=True).verdict is wanted


def test_a_stated_discrepancy_explains_no_more_than_a_tenth():
    stated = {"discrepancy": np.array([5.0, 5.0])}
    assert judged(errors((60.0, 1.0), (5.0, 1.0), **stated), True).verdict is Verdict.EXPLAINED
    assert judged(errors((40.0, 1.0), (5.0, 1.0), **stated), True).verdict is Verdict.PARTLY
    far = judged(errors((90.0, 1.0), (8.5, 1.0), **stated), True)
    assert far.verdict is Verdict.PARTLY
    assert [x.name for x in far.left] == ["hip"]
    assert far.left[0].floors == pytest.approx(8.5)


def test_a_joint_without_a_gap_may_err_by_what_is_stated():
    """Of no gap there is no tenth."""
    stated = {"discrepancy": np.array([0.0, 2.0])}
    for before, after, wanted in (
        (1.4, 3.3, Verdict.EXPLAINED),
        (1.4, 3.4, Verdict.PARTLY),
        (1.6, 3.3, Verdict.PARTLY),
    ):
        assert judged(errors((60.0, before), (1.0, after), **stated), True).verdict is wanted


def test_what_cannot_be_and_what_has_no_name_explains_nothing():
    good = errors((90.0, 3.0), (1.0, 1.0))
    assert judged(good, named=True).verdict is Verdict.EXPLAINED
    told = judged(good, True, ["a load of −0.43 kg on 0.5 kg"])
    assert told.verdict is Verdict.PARTLY
    assert told.against
    assert judged(good, named=False).verdict is Verdict.UNKNOWN


def test_a_joint_that_rests_says_nothing():
    rests = errors((90.0, 9.0), (1.0, 9.0), moves=np.array([True, False]))
    assert judged(rests, True).verdict is Verdict.EXPLAINED


def test_there_is_no_gap_where_nothing_is_named_and_every_output_is_quiet():
    quiet, loud = errors((1.5, 1.4), (1.5, 1.4)), errors((1.0, 1.6), (1.0, 1.0))
    assert judged(quiet, named=False).verdict is Verdict.NO_GAP
    # What is named is an effect, small as it may be.
    assert judged(quiet, named=True).verdict is Verdict.EXPLAINED
    assert judged(quiet, False, ["a mass 7 tolerances off"]).verdict is Verdict.UNKNOWN
    assert judged(loud, named=False).verdict is Verdict.UNKNOWN
    both = joined([quiet, loud])
    assert both.names == ("hip", "knee") * 2
    assert judged(both, named=False).verdict is Verdict.UNKNOWN
    # The model with its numbers where they fit within their tolerances, and what the log leaves of them open.
    assert judged(joined([quiet, loud]).as_given(), named=False).verdict is Verdict.NO_GAP
    open_ = dataclasses.replace(loud, discrepancy=np.array([0.0, 0.5]))
    assert judged(open_, named=False).verdict is Verdict.NO_GAP


@pytest.mark.parametrize(
    ("doubts", "named", "against"),
    [
        (Doubts(), True, 0),
        (Doubts(another=0.9, refuted=True), True, 0),
        (Doubts(another=1.1), True, 1),
        (Doubts(another=1.1, refuted=True), False, 1),
        (Doubts(unnamed=0.1), True, 1),
        (Doubts(another=9.0, unnamed=4.0), True, 2),
    ],
)
def test_what_stands_against_a_verdict_whatever_the_errors(doubts, named, against):
    reasons = tuple(doubts.against(named))
    assert len(reasons) == against
    good = errors((90.0, 1.0), (1.0, 1.0)) if named else errors((1.0, 1.0), (1.0, 1.0))
    right = Verdict.EXPLAINED if named else Verdict.NO_GAP
    assert (judged(good, named, reasons).verdict is right) == (against == 0)


def test_odds_against_a_verdict_add_up():
    """−ln Σ e^−x of effects, of one more, and of every output that may be beyond its border."""

    def odds(given, within, effects=(), **doubts):
        found = [Found("joint_spring", KNEE, {}, 0.5, x, x, 0.9, (), False, "") for x in effects]
        return odds_of_verdict(np.array(within), given, found, Doubts(**doubts))

    sure = odds(Verdict.EXPLAINED, [4.0, 7.0], [9.0])
    assert sure == pytest.approx(-np.log(np.exp(-9.0) + np.exp(-4.0) + np.exp(-7.0)))
    doubted = odds(Verdict.EXPLAINED, [40.0], [9.0], another=0.5)
    assert doubted == pytest.approx(-np.log(np.exp(-9.0) + 0.5))
    assert odds(Verdict.NO_GAP, [3.0]) == pytest.approx(3.0)
    assert odds(Verdict.PARTLY, [-5.0, 8.0], [9.0]) == pytest.approx(
        -np.log(np.exp(-9) + np.exp(-5))
    )
    assert odds(Verdict.PARTLY, [8.0], unnamed=6.0) == pytest.approx(6.0)
    assert odds(Verdict.UNKNOWN, [-2.0, 1.0], another=20.0) == pytest.approx(2.0)


def test_how_sure_an_error_is_within_a_limit_is_a_matter_of_its_samples():
    """Of white noise 4 sampling deviations away on either side, of slow noise hardly any."""
    rng, count = np.random.default_rng(1), 20_000
    white = rng.normal(size=(count, 1))
    far = np.sqrt(1.0 + 4.0 * np.sqrt(2.0 / count))
    (odds,) = odds_within(white / np.std(white), np.array([far]))
    assert odds == pytest.approx(-np.log(stats.norm.sf(4.0)), rel=0.15)
    slow = np.repeat(white[::200], 200, axis=0)
    (hardly,) = odds_within(slow / np.std(slow), np.array([far]))
    assert 0.0 < hardly < 1.5
    assert odds_within(2.0 * white, np.array([far]))[0] < -100.0
    rests = np.where(np.arange(count)[:, None] % 2, white / np.std(white[1::2]), np.nan)
    assert np.isfinite(odds_within(rests, np.array([far]))[0])
