"""Loads of 0.1 to 30 times the link that takes them up: found by the defaults, whatever rows are lost. By MuJoCo C."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jax_inertia as ji
from benchmarks.harness import pickup_log
from benchmarks.harness.pickup_log import WRIST
from jax_inertia.estimation import log_filter
from jax_inertia.estimation.inertial_filter import make_estimator
from jax_inertia.estimation.online.exact_memory import make_exact_estimator
from jax_inertia.estimation.online.load_bank import make_load_bank
from jax_inertia.estimation.priors import Load
from jax_inertia.estimation.stream import Stream

KIND, RATIOS, PICKED = "planar", (0.0, 0.1, 1.0, 5.0, 12.0, 30.0), 3.0
QUICK = {"xla_backend_optimization_level": 0}
SIGMA = [0.03, 0.02, 0.006]


@functools.cache
def robot() -> ji.Robot:
    return ji.load_model(pickup_log.arm(KIND))


@functools.cache
def logs(at: float) -> list[ji.Log]:
    """One of each ratio."""
    own = pickup_log.own_mass(KIND)
    return [pickup_log.picked_up(KIND, r * own, at=at, seconds=6.0, seed=3) for r in RATIOS]


def stacked(observations):
    return jax.tree.map(lambda *x: np.stack([np.asarray(y) for y in x]), *observations)


@functools.cache
def observed(at: float):
    """As the filter of a log gets them, at 20 Hz."""
    return stacked([log_filter.thinned(log_filter.observe(log, robot())) for log in logs(at)])


def without(observations, lost: np.ndarray):
    """The same where whole samples are lost."""
    valid = np.asarray(observations.motion.valid) & ~lost[:, None]
    return eqx.tree_at(lambda o: o.motion.valid, observations, valid)


def run(observations):
    """(time, π's mass, its σ, innovations, reopened) of the defaults, a row for each log."""
    time = np.asarray(observations.motion.time)[0]
    dt = jnp.asarray(np.diff(time, prepend=2 * time[0] - time[1]))
    trace = _runs(make_estimator(robot(), [WRIST], sigma_tau=SIGMA), observations, dt)
    mass, sigma = (np.asarray(x)[..., 0, 0] for x in (trace.estimate.pi, trace.estimate.sigma_pi))
    return time, mass, sigma, trace


@functools.partial(eqx.filter_jit, compiler_options=QUICK)
def _runs(estimator, observations, dt):
    return jax.vmap(lambda o: estimator.run(estimator.initial(), o, dt=dt)[1])(observations)


def truths() -> np.ndarray:
    return pickup_log.own_mass(KIND) * (1.0 + np.array(RATIOS))


def lost_rows(count: int, every: int) -> np.ndarray:
    return np.arange(count) % every == 0


# Half the samples lost: a reopening takes the tested ones, twice the time.
@pytest.mark.parametrize(("every", "most"), [(0, 1.0), (8, 1.2), (2, 2.0)])
def test_a_load_taken_up_is_found_within_a_second(every, most):
    seen = observed(PICKED)
    if every:
        seen = without(seen, lost_rows(seen.a.shape[1], every))
    time, mass, sigma, trace = run(seen)
    settled = time > PICKED + most
    error = mass[:, settled] - truths()[:, None]
    assert np.all(np.abs(error) < np.maximum(0.05 * truths()[:, None], 0.03)), error.max(axis=1)
    assert np.all(np.abs(error[:, -1]) < 3.0 * sigma[:, -1])
    rejected = np.asarray(trace.innovation.rejected).mean(axis=1)
    assert np.all(rejected < 0.15)


def test_a_load_that_is_there_from_the_first_sample_is_not_refused():
    time, mass, sigma, trace = run(observed(0.0))
    error = mass[:, -1] - truths()
    assert np.all(np.abs(error) < 3.0 * sigma[:, -1])
    assert np.all(np.asarray(trace.innovation.rejected).mean(axis=1) < 0.02)
    assert not np.asarray(trace.reopened).any()
    assert np.all(np.abs(mass[:, time > 1.0] - truths()[:, None]) < 0.1 * truths()[:, None])


@pytest.mark.slow
def test_samples_without_rows_say_nothing_to_any_estimator():
    """What they leave is what was there: belief, doubt and the bank's memory, whatever came before."""
    one = jax.tree.map(lambda x: x[-1], observed(PICKED))
    empty = without(one, np.ones(one.a.shape[0], bool))
    heavy = jax.tree.map(lambda x: x[100], one)
    nothing = jax.tree.map(lambda x: x[100], empty)
    filter_ = make_estimator(robot(), [WRIST], sigma_tau=SIGMA, prior=Load(0.1), drift=1e12)
    exact = make_exact_estimator(robot(), [WRIST], sigma_tau=SIGMA, sigma_v=1e-3, prior=Load(0.1))
    bank = make_load_bank(robot(), [WRIST], sigma_tau=SIGMA, load=Load(0.1))
    for estimator, doubt in ((filter_, "rejected_for"), (exact, "doubted_for")):
        step = eqx.filter_jit(estimator.step, compiler_options=QUICK)
        state = estimator.initial()
        # A belief that is sure refuses the load, and doubts.
        sure = eqx.tree_at(lambda s: s.belief.covariance, state, 1e-8 * state.belief.covariance)
        if estimator is exact:
            for k in range(40):
                light = jax.tree.map(lambda x, k=k: x[k], one)
                state, _ = step(state, light, 0.05)
            sure = state
        doubting, _ = step(sure, heavy, 0.05)
        waited = float(getattr(doubting, doubt))
        assert waited == pytest.approx(0.05)
        after, said = step(doubting, nothing, 0.05)
        assert float(getattr(after, doubt)) == waited
        pi = estimator.estimate(after.belief).pi
        np.testing.assert_allclose(pi, estimator.estimate(doubting.belief).pi, rtol=1e-6)
    step = eqx.filter_jit(bank.step, compiler_options=QUICK)
    state, _ = step(bank.initial(), jax.tree.map(lambda x: x[0], one), 0.05)
    after, said = step(state, nothing, 0.05)
    assert float(said.weight) == 0.0
    for name in ("size", "last", "product"):
        np.testing.assert_array_equal(getattr(after, name), getattr(state, name))


@pytest.mark.slow
def test_the_exact_memory_finds_them_with_rows_lost():
    """Windows of 50 ms, every eighth of them lost."""
    stream = Stream(make_estimator(robot(), [WRIST], sigma_tau=SIGMA), window=10)
    seen = stacked([stream.observed(log) for log in logs(PICKED)])
    seen = without(seen, lost_rows(seen.a.shape[1], 8))
    exact = make_exact_estimator(robot(), [WRIST], sigma_tau=SIGMA, sigma_v=2e-4)

    @functools.partial(eqx.filter_jit, compiler_options=QUICK)
    def follow(observations):
        def one(observation):
            def step(state, x):
                state, _ = exact.step(state, x, 0.05)
                found = exact.estimate(state.belief)
                return state, (found.pi[0, 0], found.sigma_pi[0, 0])

            return jax.lax.scan(step, exact.initial(), observation)[1]

        return jax.vmap(one)(observations)

    mass, sigma = (np.asarray(x) for x in follow(seen))
    time = np.asarray(seen.motion.time)[0]
    error = mass[:, time > PICKED + 1.2] - truths()[:, None]
    assert np.all(np.abs(error) < np.maximum(0.05 * truths()[:, None], 0.03)), np.abs(error).max(1)
    assert np.all(np.abs(error[:, -1]) < 3.5 * sigma[:, -1])


@pytest.mark.slow
def test_an_arm_s_rated_load_by_the_whole_road():
    """Wrist of 0.19 kg, load of 22 times that, one lost row every 0.4 s."""
    kind, load = "spherical", 4.17
    log = pickup_log.picked_up(kind, load, at=4.0, seconds=9.0)
    tau = np.array(log.tau)
    tau[::80] = np.nan
    arm = ji.load_model(pickup_log.arm(kind))
    found = ji.estimate(arm, eqx.tree_at(lambda x: x.tau, log, tau), [WRIST])
    mass = float(found.pi[WRIST][0])
    sigma = float(found.trace.estimate.sigma_pi[-1, 0, 0])
    assert found.changed
    assert abs(mass - pickup_log.own_mass(kind) - load) < max(3.0 * sigma, 0.02)
    assert sigma < 0.1
