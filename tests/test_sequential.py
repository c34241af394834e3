"""The update row by row is the update."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jax_inertia.kalman import Belief, IndependentNoise, Information, update
from jax_inertia.sequential import Sequential, moved_rows

TOUCHED = (0, 1, 2, 5, 8)


def problem(dtype: str) -> tuple[Belief, np.ndarray, np.ndarray, IndependentNoise]:
    """Four states, nine rows of which five are touched, scales far apart."""
    rng = np.random.default_rng(3)
    root = rng.normal(size=(4, 4)) * np.array([1.0, 0.1, 3.0, 0.5])[:, None]
    h = np.zeros((9, 4))
    h[list(TOUCHED)] = rng.normal(size=(len(TOUCHED), 4))
    belief = Belief(jnp.asarray(rng.normal(size=4), dtype), jnp.asarray(root @ root.T, dtype))
    noise = IndependentNoise(jnp.asarray(rng.uniform(0.1, 2.0, 9), dtype))
    return belief, h.astype(dtype), rng.normal(size=9).astype(dtype), noise


@pytest.mark.parametrize(("dtype", "tolerance"), [("float64", 1e-11), ("float32", 2e-4)])
def test_same_as_in_information_form(dtype: str, tolerance: float):
    belief, h, z, noise = problem(dtype)
    mask = jnp.asarray(np.arange(9) != 2)
    found, wanted = (
        update(belief, jnp.asarray(z), lambda x: jnp.asarray(h) @ x, noise, mask=mask, form=form)
        for form in (Sequential(TOUCHED), Information())
    )
    for a, b in zip(jax.tree.leaves(found[0]), jax.tree.leaves(wanted[0]), strict=True):
        np.testing.assert_allclose(a, b, rtol=0, atol=tolerance * float(jnp.abs(b).max()))
    for name in ("nis", "sigma", "log_likelihood"):
        np.testing.assert_allclose(
            getattr(found[1], name), getattr(wanted[1], name), rtol=tolerance
        )


def test_moved_rows_are_those_of_the_regressor(cases):
    case = cases("floating_tree")
    bodies = (case.robot.body_index("shank"), case.robot.body_index("trunk"))
    every = np.asarray(case.core(case.robot, *case.states(8))["regressor"])[:, :, list(bodies)]
    rows = np.flatnonzero(np.abs(every).max(axis=(0, 2, 3)) > 0)
    assert moved_rows(case.robot, bodies) == tuple(rows)
