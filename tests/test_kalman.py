"""The Kalman update against the textbook, batch least squares, SciPy and the χ² distribution."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats

from jax_inertia.maths import kalman
from jax_inertia.maths.gates import ChiSquaredGate, FixedGate
from jax_inertia.maths.noise import CorrelatedNoise, IndependentNoise

FORMS = [kalman.Standard(), kalman.SquareRoot(), kalman.Information(), kalman.Elementary()]
forms = pytest.mark.parametrize(
    "form", FORMS, ids=["standard", "square_root", "information", "elementary"]
)
noises = pytest.mark.parametrize("correlated", [False, True], ids=["independent", "correlated"])
N, M = 6, 9


def covariance(rng: np.random.Generator, n: int) -> np.ndarray:
    # Mild enough for the textbook's own (1 − K H) P to be right to eleven digits.
    root = rng.normal(size=(n, n)) * 10 ** rng.uniform(-0.5, 0.5, size=n)
    return root @ root.T + 0.1 * np.eye(n)


def problem(seed: int, correlated: bool = False):
    """A belief, rows H, noise with its matrix R, and a measurement drawn from them."""
    rng = np.random.default_rng(seed)
    mean, p, h = rng.normal(size=N), covariance(rng, N), rng.normal(size=(M, N))
    if correlated:
        r = covariance(rng, M)
        noise = CorrelatedNoise(jnp.asarray(r))
    else:
        variance = rng.uniform(0.1, 2.0, M)
        r, noise = np.diag(variance), IndependentNoise(jnp.asarray(variance))
    z = rng.multivariate_normal(h @ mean, h @ p @ h.T + r)
    return kalman.Belief(jnp.asarray(mean), jnp.asarray(p)), h, noise, r, z


def textbook(belief, h, r, z):
    """Foster et al., eq. update, word for word, in NumPy."""
    x, p = np.asarray(belief.mean), np.asarray(belief.covariance)
    s = h @ p @ h.T + r
    gain = p @ h.T @ np.linalg.inv(s)
    return x + gain @ (z - h @ x), (np.eye(len(x)) - gain @ h) @ p, s


def close(got, wanted, relative: float):
    wanted = np.asarray(wanted)
    assert np.max(np.abs(np.asarray(got) - wanted)) <= relative * np.max(np.abs(wanted))


@forms
@noises
def test_update_is_the_textbook_s(form, correlated):
    for seed in range(5):
        belief, h, noise, r, z = problem(seed, correlated)
        after, said = kalman.update(belief, jnp.asarray(z), lambda x, h=h: h @ x, noise, form=form)
        mean, p, s = textbook(belief, h, r, z)
        nu = z - h @ np.asarray(belief.mean)
        close(after.mean, mean, 1e-10)
        close(after.covariance, p, 1e-10)
        close(said.residual, nu, 1e-12)
        close(said.sigma, np.sqrt(np.diag(s)), 1e-12)
        close(said.nis, nu @ np.linalg.solve(s, nu), 1e-10)
        likelihood = scipy.stats.multivariate_normal(np.zeros(M), s).logpdf(nu)
        close(said.log_likelihood, likelihood, 1e-10)
        assert said.rows == M
        assert said.accepted


def test_predict_is_a_random_walk():
    belief, *_ = problem(0)
    q = covariance(np.random.default_rng(1), N)
    after = kalman.predict(belief, jnp.asarray(q))
    np.testing.assert_array_equal(after.mean, belief.mean)
    np.testing.assert_array_equal(after.covariance, belief.covariance + q)


@forms
@noises
def test_a_masked_row_is_a_row_that_was_not_there(form, correlated):
    """Rows left out by `mask`, by a NaN measurement, or (both) with a NaN in H, which must not spread."""
    belief, h, noise, r, z = problem(7, correlated)
    mask, h_nan, z_nan = np.ones(M, bool), h.copy(), z.copy()
    mask[2], mask[5] = False, False
    h_nan[5], z_nan[0], z_nan[5], z_nan[8] = np.nan, np.nan, np.inf, -np.inf
    keep = np.array([1, 3, 4, 6, 7])
    after, said = kalman.update(
        belief,
        jnp.asarray(z_nan),
        lambda x: h_nan @ x,
        noise,
        mask=jnp.asarray(mask),
        form=form,
    )
    mean, p, s = textbook(belief, h[keep], r[np.ix_(keep, keep)], z[keep])
    nu = z[keep] - h[keep] @ np.asarray(belief.mean)
    close(after.mean, mean, 1e-10)
    close(after.covariance, p, 1e-10)
    close(said.nis, nu @ np.linalg.solve(s, nu), 1e-10)
    close(said.log_likelihood, scipy.stats.multivariate_normal(np.zeros(5), s).logpdf(nu), 1e-10)
    assert said.rows == 5
    assert np.all(np.isfinite(said.residual))


@forms
def test_nothing_measured_is_nothing_learnt(form):
    belief, h, noise, _, _ = problem(8)
    after, said = kalman.update(belief, jnp.full(M, jnp.nan), lambda x: h @ x, noise, form=form)
    np.testing.assert_array_equal(after.mean, belief.mean)
    close(after.covariance, belief.covariance, 1e-13)
    assert (said.rows, said.nis, said.log_likelihood) == (0, 0, 0)


@forms
@pytest.mark.parametrize("iterations", [1, 5])
def test_a_run_is_batch_least_squares(form, iterations):
    """Linear data one by one, or all at once with the prior as rows of their own: the same Gaussian."""
    rng = np.random.default_rng(3)
    belief, _, _, _, _ = problem(3)
    steps = 200
    hs, zs = rng.normal(size=(steps, M, N)), rng.normal(size=(steps, M)) * 3.0
    variance = rng.uniform(0.1, 2.0, size=M)
    noise = IndependentNoise(jnp.asarray(variance))

    def step(belief, sample):
        h, z = sample
        after, _ = kalman.update(
            belief, z, lambda x: h @ x, noise, form=form, iterations=iterations
        )
        return after, None

    run, _ = jax.jit(lambda b: jax.lax.scan(step, b, (hs, zs)))(belief)
    root = np.linalg.inv(np.linalg.cholesky(belief.covariance))
    weight = 1 / np.sqrt(variance)
    rows = np.concatenate([root, (hs * weight[:, None]).reshape(-1, N)])
    right = np.concatenate([root @ belief.mean, (zs * weight).ravel()])
    mean, *_ = np.linalg.lstsq(rows, right)
    close(run.mean, mean, 1e-9)
    close(run.covariance, np.linalg.inv(rows.T @ rows), 1e-9)


def curved(x):
    """A mildly nonlinear h with as many rows as `M`."""
    rows = np.random.default_rng(5).normal(size=(M, N))
    return rows @ x + 0.3 * jnp.sin(rows[:, ::-1] @ x)


@pytest.mark.parametrize("iterations", [1, 4])
def test_forms_agree_and_jacobians_agree(iterations):
    belief, _, noise, _, _ = problem(11, correlated=True)
    z = curved(belief.mean) + 0.5
    rows = np.random.default_rng(5).normal(size=(M, N))

    def jacobian(x):
        return rows + 0.3 * jnp.cos(rows[:, ::-1] @ x)[:, None] * rows[:, ::-1]

    results = [
        kalman.update(belief, z, curved, noise, form=form, jacobian=given, iterations=iterations)
        for form in FORMS
        for given in (None, jacobian)
    ]
    for after, said in results[1:]:
        close(after.mean, results[0][0].mean, 1e-10)
        close(after.covariance, results[0][0].covariance, 1e-10)
        close(said.log_likelihood, results[0][1].log_likelihood, 1e-10)


def test_iterations_find_the_maximum_of_the_posterior():
    """Gauss–Newton from the prior: the gradient of the cost vanishes, and the observation counts once."""
    belief, _, noise, r, _ = problem(12, correlated=True)
    z = curved(belief.mean) + 0.5

    def cost(x):
        nu, dx = z - curved(x), x - belief.mean
        return nu @ jnp.linalg.solve(r, nu) + dx @ jnp.linalg.solve(belief.covariance, dx)

    gradients = []
    for iterations in (1, 30):
        after, said = kalman.update(belief, z, curved, noise, iterations=iterations)
        gradients.append(float(jnp.linalg.norm(jax.grad(cost)(after.mean))))
    assert gradients[1] < 1e-6 * gradients[0]
    # The Gauss–Newton Hessian at the maximum, not a sum over iterations.
    h = jax.jacfwd(curved)(after.mean)
    information = jnp.linalg.inv(belief.covariance) + h.T @ jnp.linalg.solve(r, h)
    close(after.covariance, jnp.linalg.inv(information), 1e-6)
    # What the gate tests is the least cost; of the innovation it is said what the prior says.
    _, once = kalman.update(belief, z, curved, noise)
    np.testing.assert_allclose(said.nis, cost(after.mean), rtol=1e-9)
    np.testing.assert_allclose(said.sigma, once.sigma, rtol=1e-12)
    np.testing.assert_allclose(said.log_likelihood, once.log_likelihood, rtol=1e-12)


@pytest.mark.parametrize("iterations", [1, 5])
def test_the_gate_looks_at_the_prior(iterations):
    """νᵀ S⁻¹ ν of the prior just inside and just outside γ; outside, not a bit of the belief changes."""
    belief, h, noise, r, z = problem(13)
    nu = z - h @ np.asarray(belief.mean)
    nis = float(nu @ np.linalg.solve(textbook(belief, h, r, z)[2], nu))
    for factor, wanted in ((1.0001, True), (0.9999, False)):
        after, said = kalman.update(
            belief,
            jnp.asarray(z),
            lambda x: h @ x,
            noise,
            gate=FixedGate(nis * factor),
            iterations=iterations,
        )
        assert bool(said.accepted) is wanted
        assert bool(jnp.all(after.mean == belief.mean)) is not wanted
        assert bool(jnp.all(after.covariance == belief.covariance)) is not wanted


def test_chi_squared_gate_keeps_what_it_promises():
    """10⁴ consistent measurements: the share kept lies within 4 σ of the binomial, for any row count."""
    draws, probability = 10_000, 0.95
    gate = ChiSquaredGate(probability, M)
    belief, h, _, _, _ = problem(14)
    rng = np.random.default_rng(15)
    r = covariance(rng, M)
    noise = CorrelatedNoise(jnp.asarray(r))
    s = h @ np.asarray(belief.covariance) @ h.T + r
    zs = rng.multivariate_normal(h @ np.asarray(belief.mean), s, size=draws)

    @jax.jit
    @jax.vmap
    def accepted(z):
        return kalman.update(belief, z, lambda x: h @ x, noise, gate=gate)[1].accepted

    bound = 4 * np.sqrt(probability * (1 - probability) / draws)
    for rows in (1, 4, M):
        # NaN rows are rows that are not there: γ must follow their number.
        z = np.where(rng.permuted(np.tile(np.arange(M), (draws, 1)), axis=1) < rows, zs, np.nan)
        assert abs(np.mean(accepted(z)) - probability) <= bound
    assert np.mean(accepted(zs + 40.0)) < 0.05
    # Without a row there is nothing to believe, nor to reject.
    assert not np.any(accepted(np.full((3, M), np.nan)))


def test_gate_probability_is_checked():
    for bad in (0.0, 1.0, -0.5, 95.0, float("nan")):
        with pytest.raises(ValueError, match="between 0 and 1"):
            ChiSquaredGate(bad, 3)


def test_an_update_that_is_not_finite_is_not_made():
    belief, h, noise, _, z = problem(16)
    cases = {
        "model": lambda x: jnp.where(jnp.arange(M) == 3, jnp.inf, h @ x),
        "iterate": lambda x: jnp.exp(1e4 * h @ x),
    }
    for model in cases.values():
        after, said = kalman.update(
            belief,
            jnp.asarray(z),
            model,
            noise,
            iterations=3,
            project=lambda x: jnp.clip(x, -1e3, 1e3),
        )
        assert not said.accepted
        np.testing.assert_array_equal(after.mean, belief.mean)
        np.testing.assert_array_equal(after.covariance, belief.covariance)


@pytest.mark.parametrize("sharp", [1.0, 1e4, 1e9])
def test_derivatives_of_the_forms_agree_however_sharp_a_measurement_is(sharp):
    """Of what a measurement leaves of the state, by how sharp it is: nothing is left of it where it is very sharp."""
    belief, h, _, _, z = problem(3)

    def gone(form):
        def of(size):
            rows = size * jnp.asarray(h)
            out = form.correct(belief.covariance, rows, size * jnp.asarray(z))
            return jnp.sum(out.step) + out.log_det

        return jax.grad(of)(sharp)

    assert gone(kalman.Information()) == pytest.approx(float(gone(kalman.SquareRoot())), rel=1e-9)
