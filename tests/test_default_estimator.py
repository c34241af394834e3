"""The default of `make_estimator`: gradients, float32, spikes, and what `paper=True` takes instead."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bodies import random_bodies
from excitation import compiled, loaded, log_of

import jax_inertia as ji
from jax_inertia.estimation import log_filter
from jax_inertia.estimation.inertial_filter import Estimator, make_estimator
from jax_inertia.estimation.priors import Load
from jax_inertia.maths import charts, gates, inertial_parameters, kalman
from jax_inertia.maths.noise import IndependentNoise

FAST = {"xla_backend_optimization_level": 0}
TIP, LOAD = "tip", 2.4
RNG = np.random.default_rng


@functools.cache
def robot() -> ji.Robot:
    return ji.load_model(compiled("universal"))


@functools.cache
def log(samples: int = 150):
    """Of the arm with 2.4 kg on its tip, torques noisy by 0.1 N m."""
    return log_of(loaded(compiled("universal"), TIP, LOAD), samples, noise=0.1)


def truth() -> float:
    return float(robot().pi[robot().body_index(TIP), 0]) + LOAD


def test_the_default_and_the_paper_s_filter_are_what_they_say():
    safe = make_estimator(robot(), [TIP], sigma_tau=0.1)
    assert isinstance(safe.chart, charts.LogCholeskyUUt)
    assert isinstance(safe.gate, gates.ChiSquaredGate)
    assert (safe.iterations, float(safe.reopening.after), safe.outliers) == (5, 0.5, None)
    np.testing.assert_allclose(safe.process_noise * 3600, safe.prior.covariance)
    paper = make_estimator(robot(), [TIP], sigma_tau=0.1, paper=True)
    assert isinstance(paper.chart, charts.LogCholesky)
    assert float(paper.gate.threshold(jnp.array(3.0))) == np.inf
    assert (paper.iterations, float(paper.reopening.after), paper.outliers) == (1, np.inf, None)
    np.testing.assert_allclose(paper.process_noise * 3, paper.prior.covariance)
    # A log's filter is the default.
    online = log_filter.online(robot(), [TIP], np.full(3, 0.1), prior=Load(3.0))
    assert eqx.tree_equal(online, make_estimator(robot(), [TIP], sigma_tau=0.1, prior=Load(3.0)))


def test_drift_is_quick_where_nothing_else_follows_a_change():
    for gate, reopen_after in ((1.0, None), (gates.FixedGate(), None), (None, np.inf)):
        own = make_estimator(robot(), [TIP], sigma_tau=0.1, gate=gate, reopen_after=reopen_after)
        np.testing.assert_allclose(own.process_noise * 3, own.prior.covariance)
    slow = make_estimator(robot(), [TIP], sigma_tau=0.1, gate=1.0, drift=60.0)
    np.testing.assert_allclose(slow.process_noise * 60, slow.prior.covariance)


# --- spikes ------------------------------------------------------------------------------------------------------


@eqx.filter_jit(compiler_options=FAST)
def masses(estimator: Estimator, torques):
    """Of one run for each log of torques."""

    def one(tau):
        hit = eqx.tree_at(lambda o: o.motion.tau, log(), tau)
        return estimator.run(estimator.initial(), hit)[1].estimate.pi[:, 0, 0]

    return jax.vmap(one)(torques)


@functools.cache
def spiked() -> np.ndarray:
    """Torques of `log`: as they are, and with one sample of 10² to 10⁶ N m, the first or the 60th."""
    clean = np.array(log().motion.tau)
    out = [clean]
    for size in (1e2, 1e4, 1e6):
        for at in (0, 60):
            out.append(clean.copy())
            out[-1][at] = size * np.array([1.0, -1.0, 1.0])
    return np.array(out)


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.slow
def test_a_spike_without_a_gate_is_forgotten(dtype):
    """The mass is never absurd, and ends where it does without it."""
    settings = {"sigma_tau": 0.1, "prior": Load(3.0), "gate": gates.FixedGate(), "drift": 3600.0}
    own = make_estimator(robot().astype(dtype), [TIP], **settings)
    found = np.asarray(masses(own, jnp.asarray(spiked(), dtype)))
    assert np.all(found < 6.0)
    np.testing.assert_allclose(found[:, -1], truth(), atol=0.15)


@pytest.mark.slow
def test_the_paper_s_update_does_not_forget_one():
    """What the cure is for: every sample at its word, all else as above, and 10⁶ N m."""
    settings = {"sigma_tau": 0.1, "prior": Load(3.0), "drift": 3600.0, "paper": True}
    settings |= {"iterations": 5, "chart": charts.LogCholeskyUUt()}
    found = np.asarray(masses(make_estimator(robot(), [TIP], **settings), jnp.asarray(spiked())))
    assert abs(found[0, -1] - truth()) < 0.15
    assert np.all(np.abs(found[5:, -1] - truth()) > 3.0)


@pytest.mark.parametrize(("rows", "size"), [(1, 1e3), (3, 1e3), (3, 30.0)])
def test_an_outlier_s_noise_is_what_makes_it_consistent(rows, size):
    """Of a linear model: the update is that with R scaled by the root of νᵀ (H P Hᵀ + s² R)⁻¹ ν = γ, by bisection."""
    rng = RNG(rows)
    h, p = rng.normal(size=(rows, 4)), np.diag([4.0, 1.0, 0.3, 0.01])
    r, z, limit = np.diag(rng.uniform(0.5, 2.0, rows)), size * rng.normal(size=rows), 20.0

    def nis(t: float) -> float:
        return float(z @ np.linalg.solve(h @ p @ h.T + t * r, z))

    low, high = 1.0, 1e12
    for _ in range(200):
        middle = np.sqrt(low * high)
        low, high = (middle, high) if nis(middle) > limit else (low, middle)
    s = h @ p @ h.T + low * r
    gain = p @ h.T @ np.linalg.inv(s)
    before = kalman.Belief(jnp.zeros(4), jnp.asarray(p))
    noise = IndependentNoise(jnp.diagonal(jnp.asarray(r)))
    for iterations in (1, 3):
        after, said = kalman.update(
            before,
            jnp.asarray(z),
            lambda x: h @ x,
            noise,
            outliers=gates.FixedGate(limit),
            iterations=iterations,
        )
        np.testing.assert_allclose(after.mean, gain @ z, rtol=5e-3)
        np.testing.assert_allclose(after.covariance, p - gain @ h @ p, rtol=1e-3, atol=1e-9)
        assert said.nis == pytest.approx(nis(1.0))
        assert said.accepted


def test_a_consistent_sample_is_no_outlier():
    h, before = RNG(0).normal(size=(3, 4)), kalman.Belief(jnp.zeros(4), jnp.eye(4))
    noise, z = IndependentNoise(jnp.ones(3)), jnp.ones(3)
    plain, one = (
        kalman.update(before, z, lambda x: h @ x, noise, outliers=limit)[0]
        for limit in (None, gates.ChiSquaredGate(0.9999, 3))
    )
    np.testing.assert_allclose(plain.mean, one.mean, rtol=1e-14)
    np.testing.assert_allclose(plain.covariance, one.covariance, rtol=1e-14)


# --- gradients ---------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    "gate",
    [None, pytest.param(1.0, marks=pytest.mark.slow)],
    ids=["default", "no gate"],
)
def test_the_gradient_of_a_rollout_is_finite_and_right(gate):
    """Of the squared error of the mass over a scan of steps, by the noise told and by where the filter starts.

    Central differences. Where one of them takes back an iteration that the other keeps, the error jumps by 1e-9: the
    median over several widths has no such jump in it.
    """
    few = jax.tree.map(lambda x: x[:60], log())
    own = make_estimator(robot(), [TIP], sigma_tau=0.1, prior=Load(3.0), gate=gate)
    wanted = truth()

    def loss(x):
        noise = IndependentNoise((0.1 * jnp.exp(x[0])) ** 2 * jnp.ones(3))
        mine = eqx.tree_at(lambda e: e.noise, own, noise)
        start = mine.initial()
        start = eqx.tree_at(lambda s: s.belief.mean, start, start.belief.mean + x[1:])

        def body(state, sample):
            state, _ = mine.step(state, sample, 0.01)
            return state, (mine.chart.to_pi(state.belief.mean)[0] - wanted) ** 2

        return jnp.mean(jax.lax.scan(body, start, few)[1])

    widths = np.array([1e-4, 3e-5, 1e-5, 3e-6, 1e-6])[:, None, None]
    points = np.concatenate([np.zeros((1, 11)), *(widths * np.eye(11)), *(-widths * np.eye(11))])
    both = jax.jit(jax.vmap(jax.value_and_grad(loss)), compiler_options=FAST)
    values, slopes = map(np.asarray, both(points))
    assert np.all(np.isfinite(slopes))
    assert np.linalg.norm(slopes[0]) > 1e-3
    high, low = values[1:].reshape(2, len(widths), 11)
    differences = np.median((high - low) / (2 * widths[:, 0]), axis=0)
    np.testing.assert_allclose(
        slopes[0], differences, rtol=1e-3, atol=1e-4 * np.max(np.abs(slopes[0]))
    )


# --- many random updates -----------------------------------------------------------------------------------------


def random_updates(dtype: str, filters: int, steps: int, gate, seed: int = 0) -> dict:
    """Each of `steps` random samples to `filters` filters that start at random bodies: how they came out of it."""
    own = make_estimator(robot().astype(dtype), [TIP], sigma_tau=0.1, prior=Load(3.0), gate=gate)
    starts = own.chart.from_pi(jnp.asarray(random_bodies(filters, seed=seed), dtype))
    bare, column = own.robot.pi[own.bodies[0]], jnp.array([10.0] * 4 + [5.0] * 6, dtype)
    rows = jnp.ones(3, dtype)

    def power_of_ten(key, low, high):
        return 10 ** jax.random.uniform(key, (), dtype, low, high)

    def one(state, key):
        moved, which, loud, wild, size, noise, drawn = jax.random.split(key, 7)
        y = column * jax.random.normal(moved, (3, 1, 10), dtype) * power_of_ten(which, -2, 1)
        sigma = power_of_ten(loud, -3, 1)
        heavy = jnp.exp(jax.random.normal(drawn, (), dtype))
        error = jnp.where(jax.random.bernoulli(wild, 0.3), power_of_ten(size, -2, 7), sigma)
        z = heavy * (y[:, 0] @ bare) + error * jax.random.normal(noise, (3,), dtype)
        mine = eqx.tree_at(lambda e: e.noise, own, IndependentNoise(sigma**2 * rows))
        state, said = mine.update(state, y, -z, rows > 0, 0.05)
        mean, p = state.belief.mean, state.belief.covariance
        pi, wide = own.chart.to_pi(mean), p.astype(jnp.float64)
        scale = jnp.sqrt(jnp.diagonal(wide))
        return state, {
            "finite": jnp.all(jnp.isfinite(mean)) & jnp.all(jnp.isfinite(p)),
            "physical": jnp.all(inertial_parameters.is_physical(pi)),
            "symmetric": jnp.all(p == p.T),
            # Of the correlation matrix, in float64: tolerance zero.
            "positive": jnp.linalg.eigvalsh(wide / (scale[:, None] * scale))[0] > 0,
            "type": jnp.array(mean.dtype == pi.dtype == p.dtype == jnp.dtype(dtype)),
            "accepted": said.innovation.accepted,
            "mass": pi[0],
        }

    def follow(start, keys):
        state = eqx.tree_at(lambda s: s.belief.mean, own.initial(), start)
        return jax.lax.scan(one, state, keys)[1]

    keys = jax.random.split(jax.random.key(seed), (filters, steps))
    whole = jax.jit(jax.vmap(follow), compiler_options=FAST)
    return jax.tree.map(np.asarray, whole(starts, keys))


@pytest.mark.parametrize("gate", [None, 1.0], ids=["default", "no gate"])
@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.slow
def test_ten_thousand_random_updates_are_sound(dtype, gate):
    """Random regressors, noise of 0.001 to 10 N m, residuals up to 10⁷ N m."""
    out = random_updates(dtype, 100, 100, gate)
    assert out["mass"].size == 10_000
    for key in ("finite", "physical", "symmetric", "positive", "type"):
        assert np.all(out[key]), f"{key}: {np.sum(~out[key])} of {out[key].size}"
    # The filters did not shut their eyes to it.
    assert np.mean(out["accepted"]) > 0.2
    assert np.max(out["mass"]) < 1e6
