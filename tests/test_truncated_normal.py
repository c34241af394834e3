"""Draws within bounds, against rejection sampling and SciPy's moments of one number."""

import numpy as np
import pytest
from scipy.stats import truncnorm

from jax_inertia.replay.fitting.draws import truncated_normal


@pytest.mark.parametrize("rho", [0.0, 0.9])
def test_a_pair_is_drawn_as_by_rejection(rho):
    mean, low, high = np.array([0.3, -0.2]), np.array([0.0, -np.inf]), np.array([np.inf, 0.4])
    covariance = np.array([[1.0, 0.5 * rho], [0.5 * rho, 0.25]])
    drawn = truncated_normal(mean, covariance, low, high, 4000, np.random.default_rng(1))
    free = np.random.default_rng(2).multivariate_normal(mean, covariance, 200_000)
    kept = free[np.all((free >= low) & (free <= high), axis=1)]
    error = kept.std(axis=0) / np.sqrt(len(drawn))
    assert np.all(np.abs(drawn.mean(axis=0) - kept.mean(axis=0)) < 4 * error)
    np.testing.assert_allclose(drawn.std(axis=0), kept.std(axis=0), rtol=0.06)
    np.testing.assert_allclose(np.corrcoef(drawn.T)[0, 1], np.corrcoef(kept.T)[0, 1], atol=0.05)


def test_far_beyond_a_bound_draws_are_at_it():
    none = np.array([0.0]), np.array([np.inf])
    drawn = truncated_normal(np.array([-8.0]), np.eye(1), *none, 2000, np.random.default_rng(3))
    assert np.all(drawn >= 0.0)
    expected = truncnorm.mean(8.0, np.inf) - 8.0
    np.testing.assert_allclose(drawn.mean(), expected, rtol=0.1)
