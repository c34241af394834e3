"""The one score against a brute-force marginal likelihood, and the verdict's table row by row."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm

from jax_inertia.diagnosis.checks import _Run
from jax_inertia.diagnosis.detectability import information, smallest
from jax_inertia.diagnosis.effects.actuator import TorqueSaturation
from jax_inertia.diagnosis.effects.base import Place
from jax_inertia.diagnosis.effects.joint import ViscousFriction
from jax_inertia.diagnosis.effects.tolerances import InertialTolerances
from jax_inertia.diagnosis.hypothesis import Cut, Hypothesis
from jax_inertia.diagnosis.search.bank import Bank
from jax_inertia.diagnosis.search.discrepancy import LENGTHS, SlowNoise
from jax_inertia.diagnosis.search.evidence import Evidence, Posterior
from jax_inertia.diagnosis.search.ordinary import _rescaled
from jax_inertia.diagnosis.search.selection import bayes_factor
from jax_inertia.diagnosis.settings import Settings

ROWS, JOINTS = 30, 2


def hypotheses(rng, count):
    out = []
    for k in range(count):
        row = None if k % 2 else k % JOINTS
        shape = (ROWS, 2) if row is not None else (ROWS, JOINTS, 2)
        place = Place("joint", f"j{k}", k % JOINTS)
        scale = rng.uniform(0.3, 3.0, 2)
        # One in three is all there or not at all: θ = 1, give or take.
        effect = ViscousFriction() if k % 3 else TorqueSaturation()
        mean, columns = np.full(2, 0.0 if k % 3 else 1.0), rng.normal(size=shape)
        out.append(Hypothesis(effect, place, (), columns, row, scale, mean, 0.0))
    return tuple(out)


def log_marginal(evidence, chosen):
    """Of y with every number integrated out, as one Gaussian of all rows."""
    covariance = np.diag((evidence.noise.variance * evidence.noise.repeated).ravel())
    mean = np.zeros(ROWS * JOINTS)
    for h in chosen:
        wide = np.zeros((ROWS, JOINTS, h.count))
        wide[:, slice(None) if h.row is None else h.row] = h.columns
        flat = wide.reshape(-1, h.count) * h.scale
        covariance = covariance + flat @ flat.T
        if h.effect.misses:
            mean = mean + wide.reshape(-1, h.count) @ np.ones(h.count)
    return multivariate_normal(mean, covariance).logpdf(evidence.y.ravel())


@pytest.fixture
def problem():
    rng = np.random.default_rng(3)
    chosen = hypotheses(rng, 5)
    y = rng.normal(size=(ROWS, JOINTS)) + chosen[1].columns @ [1.0, -2.0]
    evidence = Evidence(y, np.ones_like(y), np.full(JOINTS, 1e-6))
    slow = tuple(
        SlowNoise(w, at) for w, at in zip(evidence.weight.T, ((0, 0), (4, 1)), strict=True)
    )
    evidence.noise = dataclasses.replace(evidence.noise, slow=slow)
    return evidence, chosen


def test_a_torque_that_is_cut_off_counts_as_a_censored_one(problem):
    """Mean of ln N(e; 0, σ) − ln (Φ(e / σ) / room) over e, in rows that are cut off; none where there is no room."""
    evidence, (h, *_) = problem
    share, room = np.linspace(0.0, 1.0, ROWS), np.full(ROWS, 5.0)
    room[-10:] = 1e-3
    cut = dataclasses.replace(h, row=0, cut=Cut(share, room))
    z = np.linspace(-8.0, 8.0, 4001)
    deviation = np.sqrt(evidence.noise.variance[0, 0])
    owed = norm.logpdf(z) - np.log(deviation) - norm.logcdf(z) + np.log(5.0)
    mean = np.sum(norm.pdf(z) * owed) * (z[1] - z[0])
    rows = share[:-10].sum() / evidence.noise.repeated[0]
    assert evidence.unsaid(cut) == pytest.approx(rows * mean, rel=1e-4)
    now = evidence.nothing()
    plain, with_cut = (evidence.gains(now, (x,))[0] for x in (dataclasses.replace(h, row=0), cut))
    assert plain - with_cut == pytest.approx(evidence.unsaid(cut))
    assert evidence.unsaid(h) == 0.0


def test_adding_changes_the_log_marginal_likelihood_by_the_gain(problem):
    evidence, (a, b, *others) = problem
    now = evidence.posterior((a, b))
    before = log_marginal(evidence, (a, b))
    expected = [log_marginal(evidence, (a, b, h)) - before for h in others]
    np.testing.assert_allclose(evidence.gains(now, tuple(others)), expected, rtol=1e-8)


def test_gains_without_some_of_the_chosen_are_gains_beside_the_rest(problem):
    evidence, (a, b, c, *others) = problem
    now = evidence.posterior((a, b, c))
    for gone in ((a,), (b, c)):
        rest = evidence.posterior(tuple(h for h in now.chosen if h not in gone))
        expected = evidence.gains(rest, tuple(others))
        np.testing.assert_allclose(evidence.gains(now, tuple(others), gone), expected, rtol=1e-8)


def test_deleting_changes_it_by_the_worth(problem):
    evidence, chosen = problem
    whole = log_marginal(evidence, chosen)
    expected = [
        whole - log_marginal(evidence, tuple(x for x in chosen if x is not h)) for h in chosen
    ]
    np.testing.assert_allclose(evidence.worths(evidence.posterior(chosen)), expected, rtol=1e-8)


def test_without_one_is_what_a_fit_without_it_finds(problem):
    evidence, chosen = problem
    for h in chosen:
        found = evidence.posterior(chosen).without(h)
        fresh = evidence.posterior(tuple(x for x in chosen if x is not h))
        assert found.chosen == fresh.chosen
        assert found.slices == fresh.slices
        for name in ("mean", "covariance", "fitted", "log_evidence"):
            np.testing.assert_allclose(
                getattr(found, name), getattr(fresh, name), rtol=1e-7, atol=1e-9
            )


def test_the_mean_given_some_numbers_is_the_best_fit_with_them_held(problem):
    evidence, chosen = problem
    now = evidence.posterior(chosen)
    held, values = np.array([0, 3]), np.array([0.7, -1.1])
    got = now.given(held, values)
    # By the normal equations of all other numbers, at the same noise.
    precision = np.linalg.inv(now.covariance)
    free = np.setdiff1d(np.arange(len(now.mean)), held)
    pull = precision @ now.mean - precision[:, held] @ values
    np.testing.assert_allclose(got.mean[held], values)
    np.testing.assert_allclose(
        got.mean[free], np.linalg.solve(precision[np.ix_(free, free)], pull[free]), rtol=1e-8
    )
    fitted = sum(got.torque(h) for h in chosen)
    np.testing.assert_allclose(got.fitted, fitted)
    assert now.given(np.zeros(0, int), np.zeros(0)) is now


def test_parts_that_agree_as_the_log_does_bring_the_worth(problem):
    evidence, chosen = problem
    now = evidence.posterior(chosen)
    for h, part, worth in zip(chosen, now.slices, evidence.worths(now), strict=True):
        own = now.covariance[part, part]
        assert bayes_factor(h, now.mean[part], own, own) == pytest.approx(worth, rel=1e-4)


def test_what_is_all_there_is_not_refuted_by_parts_that_find_seven_tenths_of_it():
    """By a closed form: of ẑ ± √v, prior 1 ± s against none."""
    place = Place("joint", "j0", 0)
    prior = np.array([0.2]), np.ones(1)
    h = Hypothesis(TorqueSaturation(), place, (), np.ones((ROWS, 1)), 0, *prior, 0.0)
    exact, wide = np.array([[1e-6]]), np.array([[1.0]])
    mean = np.array([0.7 / 0.2])
    wanted = 0.5 * (3.5**2 / 1.0 - (3.5 - 5.0) ** 2 / 2.0 + np.log(1.0 / 2.0))
    assert bayes_factor(h, mean, exact, wide) == pytest.approx(wanted, rel=1e-3)
    assert wanted > 4.0


def test_a_moments_push_is_no_slow_misfit_and_a_slow_misfit_no_push():
    rng, rows = np.random.default_rng(4), 400
    place = Place("body", "b", 1)
    window = np.zeros((rows, 1, 1))
    window[150:190] = 1.0
    h = Hypothesis(ViscousFriction(), place, (), window, None, np.array([10.0]), np.zeros(1), 0.0)
    weight = np.ones((rows, 1))
    slow = np.zeros(rows)
    for k in range(1, rows):
        slow[k] = 0.98 * slow[k - 1] + 0.2 * rng.normal()
    noise = 0.02 * rng.normal(size=rows)

    def lost(y: np.ndarray) -> float:
        evidence = Evidence(y[:, None], weight, np.full(1, 1e-3))
        now = evidence.posterior((h,))
        evidence.learn(now)
        return evidence.loss(evidence.posterior((h,)), h)

    assert lost(noise + 0.6 * window[:, 0, 0]) > 100.0
    assert lost(noise + slow) < 8.0


def test_the_smallest_detectable_size_gains_its_prior_odds(problem):
    """An effect of just that size, and nothing else in the rows."""
    evidence, chosen = problem
    chosen, others = (
        tuple(
            dataclasses.replace(h, effect=ViscousFriction(), mean=np.zeros(h.count)) for h in some
        )
        for some in (chosen, hypotheses(np.random.default_rng(8), 4))
    )
    for h in others:
        one = dataclasses.replace(h, columns=h.columns[..., :1], scale=h.scale[:1], mean=h.mean[:1])
        now = evidence.posterior(chosen)
        z = smallest(float(information(evidence, now, [one])[0][0]), odds=8.0)
        evidence.y = one.torque(np.array([z]), evidence.y.shape)
        gain = evidence.gains(evidence.posterior(chosen), (one,))[0]
        assert gain == pytest.approx(8.0, rel=1e-6)


def test_a_row_that_weighs_nothing_tells_nothing(problem):
    evidence, chosen = problem
    first = np.arange(ROWS)[:, None] < 10
    evidence = evidence.without(np.broadcast_to(first, evidence.y.shape))
    before = evidence.posterior(chosen).mean
    evidence.y[:10] = 1e6
    np.testing.assert_allclose(evidence.posterior(chosen).mean, before)


def test_the_whole_likelihood_is_that_of_one_gaussian(problem):
    evidence, (a, b, c, *_) = problem
    few, more = (evidence.posterior(x).log_evidence for x in ((a,), (a, b, c)))
    expected = log_marginal(evidence, (a, b, c)) - log_marginal(evidence, (a,))
    assert more - few == pytest.approx(expected, rel=1e-8)


def test_the_likelihood_of_slow_noise_is_its_gaussian_s():
    rng, rows = np.random.default_rng(1), 40
    weight, values = rng.uniform(0.2, 1.0, rows), rng.normal(size=rows)
    lag = np.abs(np.subtract.outer(np.arange(rows), np.arange(rows)))
    found, expected = [], []
    for at in ((0, 0), (3, 1), (7, 4)):
        noise = SlowNoise(weight, at)
        c = np.diag((1 - noise.share) / weight) + noise.share * noise.forgotten**lag
        scale = values @ np.linalg.solve(c, values) / rows
        expected.append(multivariate_normal(np.zeros(rows), scale * c).logpdf(values))
        found.append(noise.log_likelihood(values))
    np.testing.assert_allclose(np.diff(found), np.diff(expected), rtol=1e-8)


def test_what_is_slow_of_a_residual_is_learned():
    rng = np.random.default_rng(0)
    rows = 4000
    slow = np.zeros(rows)
    for k in range(1, rows):
        slow[k] = np.exp(-1 / 30) * slow[k - 1] + np.sqrt(1 - np.exp(-2 / 30)) * rng.normal()
    white = rng.normal(size=rows)
    weight = np.ones(rows)
    found = SlowNoise(weight).likeliest(2.0 * (np.sqrt(0.8) * slow + np.sqrt(0.2) * white))
    assert found.share == pytest.approx(0.8, abs=0.11)
    assert LENGTHS[found.at[1]] == 30.0
    assert SlowNoise(weight).likeliest(white).share <= 0.1


def rescaled(errors, counts_for=20.0, most=np.inf):
    """Scale of the centres of mass of five bodies, whose errors are given in units of the stated tolerance."""
    count = 10 * 5 + 3
    numbers = np.zeros(count)
    numbers[[10 * body + 1 + axis for body in range(5) for axis in range(3)]] = errors
    place, shape = (
        Place("global", "global", -1),
        (0.02, 1e-3, 0.05, 1e-3, counts_for, 1e-3, most, 1e-3),
    )
    columns, prior = np.zeros((ROWS, JOINTS, count)), (np.ones(count), np.zeros(count))
    h = Hypothesis(InertialTolerances(), place, shape, columns, None, *prior, 0.0)
    known = np.zeros((count, count))
    now = Posterior((h,), (slice(0, count),), numbers, known, np.zeros((ROWS, JOINTS)))
    return _rescaled(now)[0].scale[1]


def test_tolerances_are_as_large_as_most_numbers_say_and_not_as_one_does():
    assert rescaled(np.r_[8.0, np.zeros(14)]) < 1.0
    assert rescaled(np.full(15, 1.9)) > 1.3


def test_a_calibrated_model_is_as_good_as_its_numbers_say_and_never_worse_than_stated():
    assert rescaled(np.full(15, 0.1), counts_for=1.0, most=1.0) < 0.3
    assert rescaled(np.full(15, 1.9), counts_for=1.0, most=1.0) == 1.0


def test_a_candidate_that_the_motion_does_not_excite_gains_nothing():
    rng = np.random.default_rng(4)
    seen, unseen = hypotheses(rng, 2)
    unseen = dataclasses.replace(unseen, columns=np.zeros((len(seen.columns), 2, 2)), row=None)
    y = np.zeros((len(seen.columns), 2))
    y[:, 0] = seen.columns[:, 0] if seen.columns.ndim == 2 else seen.columns[:, 0, 0]
    evidence = Evidence(y, np.ones(y.shape), np.ones(2))
    gains = evidence.gains(evidence.nothing(), Bank((seen, unseen)))
    assert gains[0] > 1.0
    assert gains[1] == pytest.approx(0.0, abs=1e-9)


def test_settings_are_frozen():
    with pytest.raises(dataclasses.FrozenInstanceError):
        Settings().gate = 0.5


class Predicted(_Run):
    """Rows of two joints: what is left with an effect and without it."""

    def __init__(self, with_it, without):
        self.residual = SimpleNamespace(weight=np.ones(with_it.shape), sensors=np.zeros(2))
        self._left, self._without = with_it, without

    def torques(self, now):
        return iter(())

    def parts(self, weight):
        return iter(())

    def left(self, now):
        return self._left

    def left_without(self, now, asked):
        return iter([self._without] * len(asked))

    def covariances(self, now):
        return iter(())


def test_support_is_a_likelihood_of_as_many_rows_as_are_independent():
    rng, rows = np.random.default_rng(2), 3000
    asked = hypotheses(rng, 1)
    nothing = Posterior((), (), np.zeros(0), np.zeros((0, 0)), np.zeros((rows, 2)))
    white = rng.normal(size=(rows, 2))
    loud = white * [1.0, 3.0]
    (found,) = Predicted(white, loud).support(nothing, asked)
    assert found == pytest.approx(rows * np.log(3.0), rel=0.02)
    assert Predicted(loud, white).support(nothing, asked)[0] < 0.0
    slow = np.convolve(rng.normal(size=rows + 400), np.exp(-np.arange(401) / 100), "valid")
    hidden = np.stack([white[:, 0], 3.0 * slow[:rows] / np.std(slow)], axis=1)
    (found,) = Predicted(white, hidden).support(nothing, asked)
    assert 3.0 < found < rows * np.log(3.0) / 20


@pytest.mark.parametrize(("misfit", "form_error"), [(0.1, 0.5), (0.1, 0.02), (3.0, 0.1)])
def test_equations_err_by_no_more_than_the_residual_shows(misfit, form_error):
    """A friction of 2 N m whose equation may err by half, on rows that it fits to 0.1 N m: they are that exact."""
    rng = np.random.default_rng(5)
    speed = rng.normal(size=400)
    h = Hypothesis(
        ViscousFriction(), Place("joint", "j0", 0), (), -speed[:, None], 0, np.ones(1), np.zeros(1), 0.0,
        form_error=form_error,
    )  # fmt: skip
    y = (-2.0 * speed + misfit * rng.normal(size=400))[:, None]
    evidence = Evidence(y, np.ones_like(y), np.array([1e-3]))
    for _ in range(3):
        evidence.learn(evidence.posterior((h,)))
    assert np.sqrt(np.mean(evidence.noise.variance)) == pytest.approx(misfit, rel=0.1)
    # What the equation errs by is where its torque is large.
    large = np.abs(speed) > 1.0
    assert bool(np.all(evidence.noise.variance[large] > np.min(evidence.noise.variance)))
