"""10⁵ updates with wild outliers and NaN rows in float32: always a body, always a covariance."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bodies import random_bodies

from jax_inertia.maths import charts, inertial_parameters, kalman
from jax_inertia.maths.noise import IndependentNoise

FILTERS, STEPS, ROWS = 250, 200, 12


def storm(chart: charts.Chart, key: jax.Array, bodies: int, iterations: int):
    """Run all filters; for each update, whether everything about it is in order."""
    states = 10 * bodies
    rng = np.random.default_rng(0)
    truth = random_bodies(bodies, seed=1)
    nominal = random_bodies(bodies, seed=2)
    # Torques of links in motion: accelerations of 10 m/s², angular ones of 5 rad/s².
    column = np.array([10.0] + [10.0] * 3 + [5.0] * 6)
    regressors = rng.normal(size=(64, ROWS, bodies, 10)) * column
    regressors, truth, nominal = (jnp.asarray(x, jnp.float32) for x in (regressors, truth, nominal))
    noise = IndependentNoise(jnp.full(ROWS, 0.25, jnp.float32))
    start = kalman.Belief(chart.from_pi(nominal).ravel(), jnp.eye(states, dtype=jnp.float32))
    drift = 1e-3 * jnp.eye(states, dtype=jnp.float32)

    def step(belief, key):
        pick, quiet, wild, size, nan, bad = jax.random.split(key, 6)
        y = regressors[jax.random.randint(pick, (), 0, len(regressors))]
        z = jnp.einsum("rbp,bp->r", y, truth) + 0.5 * jax.random.normal(quiet, (ROWS,))
        outlier = 10 ** jax.random.uniform(size, (ROWS,), minval=1, maxval=6)
        z = z + jnp.where(jax.random.bernoulli(wild, 0.1, (ROWS,)), outlier, 0.0)
        z = jnp.where(jax.random.bernoulli(nan, 0.1, (ROWS,)), jnp.nan, z)
        # Now and then the regressor itself is spoilt, row by row.
        y = jnp.where(jax.random.bernoulli(bad, 0.02, (ROWS, 1, 1)), jnp.nan, y)
        z = z.astype(jnp.float32)

        def predicted(x):
            return jnp.einsum("rbp,bp->r", y, chart.to_pi(x.reshape(bodies, 10)))

        def jacobian(x):
            g = chart.jacobian(x.reshape(bodies, 10))
            return jnp.einsum("rbp,bpj->rbj", y, g).reshape(ROWS, states)

        belief, said = kalman.update(
            kalman.predict(belief, drift),
            z,
            predicted,
            noise,
            jacobian=jacobian,
            mask=jnp.all(jnp.isfinite(y), axis=(1, 2)),
            iterations=iterations,
            project=lambda x: chart.project(x.reshape(bodies, 10)).ravel(),
        )
        pi, p = chart.to_pi(belief.mean.reshape(bodies, 10)), belief.covariance
        wide = p.astype(jnp.float64)
        scale = jnp.sqrt(jnp.diagonal(wide))
        return belief, {
            "float32": jnp.array(belief.mean.dtype == pi.dtype == p.dtype == jnp.float32),
            "finite": jnp.all(jnp.isfinite(belief.mean)) & jnp.all(jnp.isfinite(p)),
            "physical": jnp.all(inertial_parameters.is_physical(pi)),
            "symmetric": jnp.all(p == p.T),
            # Of the correlation matrix, in float64: tolerance zero.
            "positive": jnp.linalg.eigvalsh(wide / (scale[:, None] * scale))[0] > 0,
            "accepted": said.accepted,
            "moved": jnp.any(said.residual > 1e4),
        }

    keys = jax.random.split(key, (FILTERS, STEPS))
    return jax.jit(jax.vmap(lambda keys: jax.lax.scan(step, start, keys)[1]))(keys)


@pytest.mark.parametrize(
    ("chart", "bodies", "iterations"),
    [
        (charts.LogCholesky(), 2, 1),
        pytest.param(charts.LogCholeskyUUt(), 1, 3, marks=pytest.mark.slow),
    ],
    ids=["UtU", "UUt iterated"],
)
def test_every_estimate_is_a_body_and_every_covariance_one(chart, bodies, iterations):
    out = jax.tree.map(np.asarray, storm(chart, jax.random.key(3), bodies, iterations))
    assert out["physical"].size == 50_000
    for key in ("float32", "finite", "physical", "symmetric", "positive"):
        assert np.all(out[key]), f"{key}: {np.sum(~out[key])} of {out[key].size}"
    # The storm did blow, and the filters did not shut their eyes to it.
    assert np.mean(out["moved"]) > 0.1
    assert np.mean(out["accepted"]) > 0.5
