"""NIS, NEES and whiteness: on filters that are right about their noise, and on ones that are not."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats

from jax_inertia.maths import kalman
from jax_inertia.maths.innovation_tests import consistency, nees
from jax_inertia.maths.noise import IndependentNoise

SAMPLES, STATES, ROWS = 500, 3, 2
SIGMA = np.array([0.2, 0.5])


@jax.jit
def run(h, z, variance):
    """A random walk watched through h, from a standard normal prior."""
    noise = IndependentNoise(variance)

    def one(belief, x):
        h, z = x
        belief = kalman.predict(belief, 1e-3 * jnp.eye(STATES))
        belief, innovation = kalman.update(belief, z, lambda x: h @ x, noise)
        return belief, (belief, innovation)

    start = kalman.Belief(jnp.zeros(STATES), jnp.eye(STATES))
    return jax.lax.scan(one, start, (h, z))[1]


def data(seed: int, correlation: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(h, z, states): noise of the stated size, white or with that correlation from sample to sample."""
    rng = np.random.default_rng(seed)
    steps = np.sqrt(1e-3) * rng.normal(size=(SAMPLES, STATES))
    x = rng.normal(size=STATES) + np.cumsum(steps, axis=0)
    h = rng.normal(size=(SAMPLES, ROWS, STATES))
    noise = rng.normal(size=(SAMPLES, ROWS))
    for k in range(1, SAMPLES):
        noise[k] = correlation * noise[k - 1] + np.sqrt(1 - correlation**2) * noise[k]
    return h, np.einsum("tmn,tn->tm", h, x) + SIGMA * noise, x


def innovations(seed: int, stated: float = 1.0, correlation: float = 0.0):
    h, z, _ = data(seed, correlation)
    return run(h, z, jnp.asarray((stated * SIGMA) ** 2))[1]


def test_a_consistent_filter_is_called_so():
    found = [consistency(innovations(seed), skip=20) for seed in range(20)]
    inside = [c.nis_interval[0] <= c.nis_per_row <= c.nis_interval[1] for c in found]
    assert sum(inside) >= 16  # 19 of 20 on average; below 16 once in 400
    assert np.mean([c.within_95 for c in found]) == pytest.approx(0.95, abs=0.01)
    assert np.mean([c.row_variance for c in found]) == pytest.approx(1.0, abs=0.05)
    assert np.mean([c.row_white for c in found]) > 0.9
    assert np.max(np.abs([c.row_correlation for c in found])) < 0.2
    assert all(c.rejected == 0 for c in found)


@pytest.mark.parametrize("stated", [0.7, 1.4])
def test_noise_stated_wrong_shows_in_nis(stated):
    found = consistency(innovations(1, stated), skip=20)
    assert not found.nis_interval[0] <= found.nis_per_row <= found.nis_interval[1]
    # Part of the innovation is the state's own, so the ratio is a little nearer to one than 1 / stated².
    assert found.nis_per_row == pytest.approx(stated**-2, rel=0.25)
    assert (found.within_95 < 0.9) == (stated < 1)
    assert np.all((found.row_variance > 1.5) == (stated < 1))


def test_correlated_noise_is_not_white():
    found = consistency(innovations(2, correlation=0.8), skip=20)
    assert not np.any(found.row_white)
    assert np.all(found.row_correlation > 0.4)


def test_rejected_and_masked_rows_are_counted_as_such():
    innovation = innovations(3)
    accepted = np.arange(SAMPLES) % 10 != 0
    found = consistency(eqx.tree_at(lambda i: i.accepted, innovation, accepted))
    assert found.rejected == pytest.approx(0.1)
    h, z, _ = data(3)
    z[:, 1] = np.nan
    blind = consistency(run(h, z, jnp.asarray(SIGMA**2))[1], skip=20)
    assert np.isnan(blind.row_variance[1])
    assert blind.row_variance[0] == pytest.approx(1.0, abs=0.2)
    assert blind.nis_interval[0] <= blind.nis_per_row <= blind.nis_interval[1]
    with pytest.raises(ValueError, match="10 samples after the first 490; at least 20"):
        consistency(innovation, skip=490)


def test_nees_follows_chi_squared():
    """Over 60 seeds, at the last sample: mean within 99.9 % of χ², and far above it for too small a covariance."""
    last, small = [], []
    for seed in range(60):
        h, z, x = data(seed)
        belief, _ = run(h, z, jnp.asarray(SIGMA**2))
        value = nees(belief.mean[-1:], belief.covariance[-1:], jnp.asarray(x[-1]))
        np.testing.assert_allclose(
            value,
            (x[-1] - belief.mean[-1])
            @ np.linalg.inv(belief.covariance[-1])
            @ (x[-1] - belief.mean[-1]),
        )
        last.append(value[0])
        small.append(nees(belief.mean[-1:], 0.5 * belief.covariance[-1:], jnp.asarray(x[-1]))[0])
    low, high = np.array(scipy.stats.chi2.interval(0.999, STATES * 60)) / 60
    assert low < np.mean(last) < high
    assert np.mean(small) > high
