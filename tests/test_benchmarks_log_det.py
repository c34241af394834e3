"""The semidefinite baseline of `benchmarks/loads.py`, against a solver that knows nothing of its form."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import minimize

from benchmarks.harness.log_det import pseudo_inertia, solved
from jax_inertia.maths import inertial_parameters as ip


@pytest.mark.parametrize("pull", [0.1, 3.0])
def test_it_is_the_least_within_what_a_body_can_be(pull):
    """The pull of the data ends within, and far outside of what a body can be."""
    rng = np.random.default_rng(1)
    inertia = jnp.diag(jnp.array([2e-4, 2e-4, 1e-4]))
    own = np.asarray(ip.from_com(jnp.array(0.2), jnp.array([0.01, 0.0, 0.05]), inertia))
    scale = np.array([0.2, *[0.01] * 3, *[1e-4] * 6])
    rows = rng.normal(size=(60, 13))
    inner, right = rows.T @ rows, rows.T @ (rows @ (pull * rng.normal(size=13)))
    z, spread = solved(inner, right, own, scale)
    p0 = pseudo_inertia(own)
    np.testing.assert_allclose(p0, ip.pseudo_inertia(jnp.asarray(own)), atol=1e-15)

    def value(x):
        p = pseudo_inertia(own + scale * x[:10])
        if np.linalg.eigvalsh(p)[0] <= 0.0:
            return np.inf
        prior = np.trace(np.linalg.solve(p0, p)) - np.linalg.slogdet(p)[1]
        return 0.5 * x @ inner @ x - right @ x + prior

    assert np.linalg.eigvalsh(pseudo_inertia(own + scale * z[:10]))[0] > 0.0
    best = minimize(value, z, method="Nelder-Mead", options={"maxiter": 4000, "adaptive": True})
    assert value(z) <= best.fun + 1e-6
    assert np.all(np.linalg.eigvalsh(spread) > 0.0)
