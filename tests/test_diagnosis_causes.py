"""What is listed as a cause: better than a slow discrepancy in its place, and than nothing on the other run."""

import dataclasses

import mujoco
import numpy as np
import pytest
from diagnosis_robot import NOMINAL, log_of
from diagnosis_robot import motion as sines

from jax_inertia.diagnosis.certainty import causes
from jax_inertia.diagnosis.certainty.causes import _echoes, carried_over, odds_of_others
from jax_inertia.diagnosis.checks import OtherRun, rms
from jax_inertia.diagnosis.effects.base import Place
from jax_inertia.diagnosis.effects.external_force import Push
from jax_inertia.diagnosis.effects.joint import JointSpring
from jax_inertia.diagnosis.hypothesis import Hypothesis
from jax_inertia.diagnosis.residual import Residual
from jax_inertia.diagnosis.search import sensor_noise
from jax_inertia.diagnosis.search.evidence import Evidence
from jax_inertia.diagnosis.search.selection import Selection
from jax_inertia.diagnosis.settings import Settings
from jax_inertia.model.load import load_model

ROWS = 500


def spring(column):
    place = Place("joint", "elbow", 0)
    return Hypothesis(
        JointSpring(), place, (), column[:, None], 0, np.array([3.0]), np.zeros(1), 8.0
    )


def judged(y, h):
    """Evidence of one row's residual, its noise learned with the whole memory, and the posterior with `h`."""
    evidence = Evidence(y[:, None], np.ones((ROWS, 1)), np.array([1e-3]))
    evidence.learn(evidence.posterior((h,)))
    evidence = evidence.remembering(evidence.posterior((h,)))
    return evidence, evidence.posterior((h,))


@pytest.fixture
def motion():
    return np.sin(np.arange(ROWS) / 8.0)


def walk(memory, seed):
    """An Ornstein-Uhlenbeck process of variance one."""
    rng, out = np.random.default_rng(seed), np.zeros(ROWS)
    keep = np.exp(-1.0 / memory)
    for k in range(1, ROWS):
        out[k] = keep * out[k - 1] + np.sqrt(1 - keep**2) * rng.normal()
    return out


def test_what_is_there_pays_for_itself_beside_a_slow_discrepancy(motion):
    h = spring(motion)
    evidence, now = judged(2.0 * motion + 0.3 * walk(30.0, 0), h)
    assert evidence.loss(now, h) > 2 * h.odds


def test_what_follows_a_slow_discrepancy_by_chance_does_not(motion):
    """Of many slow misfits, the shapes that fit one by chance have worths far above their odds, and no evidence."""
    worths, losses = [], []
    for seed in range(20):
        slow = walk(60.0, seed)
        h = spring(walk(60.0, 100 + seed))
        noisy = slow + 0.05 * np.random.default_rng(seed).normal(size=ROWS)
        evidence, now = judged(noisy, h)
        losses.append(evidence.loss(now, h))
        evidence.noise = dataclasses.replace(evidence.noise, most_repeated=1.0)
        worths.append(evidence.worths(evidence.posterior((h,)))[0])
    assert np.sum(np.array(worths) > 8.0) >= 5
    assert np.sum(np.array(losses) > 8.0) <= 1


class _Rows(Residual):
    """Rows of one number each, all of them measured."""

    def __init__(self, y):
        self.y = y
        self.weight = np.ones_like(y)
        self.sensors = np.full(y.shape[1], 1e-3)
        self.known = {}

    def has(self, h):
        """The same with a hypothesis' columns as they are on the first run."""
        self.known[h.effect, h.place, h.shape, h.level] = h.columns, h.row, None
        return self


def test_causes_that_make_the_other_run_worse_than_no_cause_are_none(motion):
    h = spring(motion)
    evidence, now = judged(motion + 0.1 * walk(30.0, 0), h)
    for sign, kept in ((1.0, (h,)), (-1.0, ())):
        rows = _Rows(sign * evidence.y).has(h)
        other = OtherRun(rows, evidence)
        left = carried_over(now, other)
        assert left.chosen == kept
        assert other.error(left) <= rms(rows.y, rows.weight)


@pytest.mark.parametrize("seed", [0, 23, 105, 150])
def test_what_did_no_harm_itself_comes_back(seed):
    """Numbers fitted together may go for what one of them does: each is asked again once that is gone."""
    rng = np.random.default_rng(seed)
    columns = rng.normal(size=(ROWS, 3)) @ rng.normal(size=(3, 3))
    places = [Place("joint", name, 0) for name in "abc"]
    every = tuple(
        dataclasses.replace(spring(column), place=place)
        for column, place in zip(columns.T, places, strict=True)
    )
    evidence = Evidence(columns @ rng.normal(size=(3, 1)), np.ones((ROWS, 1)), np.array([0.1]))
    now = evidence.posterior(every)
    rows = _Rows(columns @ rng.normal(size=(3, 1)))
    for h in every:
        rows.has(h)
    other = OtherRun(rows, evidence)
    left = carried_over(now, other)
    error = other.error(left)
    assert error <= rms(rows.y, rows.weight)
    for h in every:
        if h not in left.chosen:
            assert other.error(evidence.posterior((*left.chosen, h))) >= error


def push(name, body, size, motion, start=1.0):
    place, shape = Place("body", name, body), (start, start + 0.4, 0.5, 0.0)
    columns = size * np.stack([motion, 0.0 * motion, 0.0 * motion], axis=-1)
    return Hypothesis(Push(), place, shape, columns, 0, np.ones(3), np.zeros(3), 8.0)


@pytest.fixture
def residual():
    """Of an arm in motion; its context tells pushes apart."""
    time, q, v, _ = sines(1, seconds=2.0)
    robot = load_model(mujoco.MjModel.from_xml_string(NOMINAL))
    return Residual(robot, log_of(time, q, 0.0 * v), Settings())


def test_pushes_at_the_moments_of_a_larger_one_are_its_echoes(motion, residual):
    later = np.roll(motion, ROWS // 2)
    small, large = push("hand", 2, 1.0, walk(20.0, 3)), push("lower", 1, 1.0, motion)
    apart = push("upper", 0, 1.0, later, start=3.0)
    y = 5.0 * motion + 0.5 * walk(20.0, 3) + 2.0 * later
    evidence = Evidence(y[:, None], np.ones((ROWS, 1)), np.array([0.1]))
    now = evidence.posterior((small, large, apart))
    assert _echoes(residual.context, evidence.worths(now), now.chosen) == [small]


class _Offers(Selection):
    """A search that ended where its log gives the last of its candidates ten nats beyond its odds."""

    def further(self, barred):
        h = self.candidates[-1]
        if h.key not in barred:
            yield 10.0, h, self.evidence.posterior((*self.posterior.chosen, h))


@pytest.mark.parametrize(
    ("brings", "refuted", "least", "most"),
    [
        (20.0, False, np.exp(10.0), np.exp(10.1)),  # by the log's own odds
        (7.0, False, np.exp(-1.1), np.exp(-0.9)),  # no more than what it brings as a cause
        (-3.0, False, 0.0, 1e-4),  # the other run bears it out not at all
        (20.0, True, 0.0, 0.0),
    ],
)
def test_another_effect_has_to_be_a_cause(
    motion, residual, monkeypatch, brings, refuted, least, most
):
    """It has to bring what a listed one has to; the echo of a listed push is no other effect, whatever it brings."""
    small, large = push("hand", 2, 1.0, walk(20.0, 3)), push("lower", 1, 1.0, motion)
    other = spring(walk(20.0, 4))
    evidence = Evidence(5.0 * motion[:, None], np.ones((ROWS, 1)), np.array([0.1]))
    now = evidence.posterior((small, large))
    told = {"push": 100.0, other.family: brings}
    monkeypatch.setattr(
        causes, "evidence_of_causes", lambda _search, asked, _: [told[h.family] for h in asked]
    )
    search = _Offers(residual, evidence, now, (other,), ())
    listed = evidence.posterior((large,))
    others = odds_of_others(search, listed, (other,) if refuted else (), ())
    assert small.key not in {h.key for h, _ in others}
    assert least <= sum(np.exp(odds) for _, odds in others) <= most


@pytest.mark.parametrize(("apart", "left"), [(0.5, True), (8.0, False)])
def test_what_noise_may_bring_by_chance_is_its_own(motion, residual, monkeypatch, apart, left):
    """A score of 30 spreads where noise brings 20 says something, unless it brings 20 give or take as much."""
    h = spring(motion)
    evidence = Evidence(np.zeros((ROWS, 1)), np.ones((ROWS, 1)), np.array([1.0]))
    root = np.sqrt(evidence.precision)
    own = h.columns.reshape(-1, 1) * float(h.scale[0]) * root
    spread = float(np.sqrt(1.0 + np.sum(own**2)))
    evidence.y = 30.0 * spread * own / root / np.sum(own**2)
    scores = np.full((2, sensor_noise.GROUPS, 1), 20.0 * spread / sensor_noise.GROUPS)
    scores[:, 0, 0] += np.array([apart, -apart]) * spread
    monkeypatch.setattr(sensor_noise, "by_noise", lambda *_: scores)
    share = sensor_noise.share(residual, evidence, evidence.nothing(), h)
    whole = 0.5 * 30.0**2
    assert share == pytest.approx(whole - 0.5 * 10.0**2 if left else whole, rel=0.02)
