"""Charts: round trips, Jacobians, `project` on bodies a robot carries and on wild coordinates."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bodies import random_bodies, rotation, spread_body

from jax_inertia.maths import charts, inertial_parameters

NOMINAL = spread_body(3.0, [0.05, 0.1, -0.2], [0.1, 0.06, 0.2], rotation(np.random.default_rng(0)))
ROD = spread_body(2.0, [0.1, -0.1, 0.3], [0.3, 0.003, 0.003], rotation(np.random.default_rng(1)))
MAKE = {
    "Linear": lambda dtype: charts.Linear(),
    "LogCholesky": lambda dtype: charts.LogCholesky(),
    "LogCholeskyUUt": lambda dtype: charts.LogCholeskyUUt(),
    "Relative": lambda dtype: charts.Relative.to(jnp.asarray(NOMINAL, dtype)),
    "Relative to a rod": lambda dtype: charts.Relative.to(jnp.asarray(ROD, dtype)),
}
PHYSICAL = [name for name in MAKE if name != "Linear"]
dtypes = pytest.mark.parametrize("dtype", [np.float64, np.float32], ids=["f64", "f32"])


@functools.cache
def functions(name: str, dtype):
    chart = MAKE[name](dtype)
    return chart, *(eqx.filter_jit(f) for f in (chart.to_pi, chart.from_pi, chart.project))


def error(got, pi) -> float:
    """Largest error against what the entries of π are stored against: m, √(m tr Σ), tr Σ."""
    pi = np.asarray(pi, float)
    trace = 0.5 * (pi[..., 4] + pi[..., 7] + pi[..., 9])
    scale = np.stack([pi[..., 0], *[np.sqrt(pi[..., 0] * trace)] * 3, *[trace] * 6], axis=-1)
    return float(np.max(np.abs(np.asarray(got, float) - pi) / scale))


@dtypes
@pytest.mark.parametrize("name", MAKE)
def test_round_trip(name, dtype):
    _, to_pi, from_pi, _ = functions(name, dtype)
    pi = jnp.asarray(random_bodies(300), dtype)
    x = from_pi(pi)
    assert x.dtype == dtype
    # The rod's chart divides by its thickness, a hundredth of the others.
    tolerance = 1e3 if name == "Relative to a rod" else 100
    assert error(to_pi(x), pi) <= tolerance * np.finfo(dtype).eps


@pytest.mark.parametrize("name", MAKE)
def test_jacobian_is_autodiff(name):
    chart = MAKE[name](np.float64)
    x = jnp.asarray(np.random.default_rng(1).normal(size=(50, 10)))
    exact = jax.jit(jax.vmap(jax.jacfwd(chart.to_pi)))(x)
    scale = np.max(np.abs(exact), axis=-2, keepdims=True)
    assert np.max(np.abs(chart.jacobian(x) - exact) / scale) <= 1e-12


def test_relative_zero_is_the_nominal_body():
    for pi in (NOMINAL, ROD):
        chart = charts.Relative.to(jnp.asarray(pi))
        assert error(chart.to_pi(jnp.zeros(10)), pi) <= 1e-15
        np.testing.assert_allclose(chart.from_pi(jnp.asarray(pi)), np.zeros(10), atol=1e-10)


@pytest.mark.parametrize("name", PHYSICAL)
def test_inverse_root_is_the_spread_about_the_centre_of_mass(name):
    """W Wᵀ = Σ_c⁻¹ with Σ_c = Σ − h hᵀ/m, which `project` measures against tr Σ."""
    chart = MAKE[name](np.float64)
    for pi in random_bodies(20, seed=2):
        p = np.asarray(inertial_parameters.pseudo_inertia(jnp.asarray(pi)))
        spread = p[:3, :3] - np.outer(p[:3, 3], p[:3, 3]) / p[3, 3]
        root = chart.inverse_root(chart.from_pi(jnp.asarray(pi)))
        np.testing.assert_allclose(root @ root.T @ spread, np.eye(3), atol=1e-7)


@dtypes
@pytest.mark.parametrize("name", MAKE)
def test_project_leaves_ordinary_bodies_alone(name, dtype):
    """Links, and a millimetre-thin rod and plate of a third of a metre, off-centre: bit for bit."""
    _, _, from_pi, project = functions(name, dtype)
    turn = rotation(np.random.default_rng(3))
    rod = spread_body(0.5, [0.1, 0.0, -0.1], [0.1, 1e-3, 1e-3], turn)
    plate = spread_body(0.5, [0.1, 0.0, -0.1], [0.1, 0.1, 1e-3], turn)
    x = from_pi(jnp.asarray(np.concatenate([random_bodies(500, seed=5), [rod, plate]]), dtype))
    assert np.all(np.isfinite(x))
    np.testing.assert_array_equal(project(x), x)


@dtypes
@pytest.mark.parametrize("name", PHYSICAL)
def test_project_makes_wild_coordinates_physical(name, dtype):
    """Without it, most of these are bodies only in exact arithmetic: rounding π spoils them."""
    _, to_pi, _, project = functions(name, dtype)
    rng = np.random.default_rng(4)
    physical = jax.jit(inertial_parameters.is_physical)
    for scale in (1.0, 3.0, 10.0, 1e2, 1e6):
        x = (scale * rng.normal(size=(10_000, 10))).astype(dtype)
        projected = project(x)
        pi = to_pi(projected)
        assert pi.dtype == dtype
        assert np.all(np.isfinite(projected))
        assert np.all(physical(pi)), f"{np.mean(~physical(pi)):.2%} at scale {scale}"
        if scale >= 10.0:
            assert np.mean(physical(to_pi(x))) < 0.95
    # One wild coordinate, and the largest that a float holds.
    one = np.concatenate([s * np.eye(10) for s in (-1e30, -1e3, 1e3, 1e30)]).astype(dtype)
    x = np.zeros((10_000, 10), dtype)
    x[: len(one)] = one
    x[-1] = np.nan
    projected = project(x)
    assert np.all(physical(to_pi(projected))[:-1])
    assert np.all(np.isnan(projected[-1]))


@dtypes
@pytest.mark.parametrize("name", PHYSICAL)
def test_project_is_continuous_and_settles(name, dtype):
    """It adds what is lacking and no more: doing it again changes the body by rounding only."""
    _, to_pi, _, project = functions(name, dtype)
    x = (2.0 * np.random.default_rng(6).normal(size=(2000, 10))).astype(dtype)
    once = project(x)
    assert error(to_pi(project(once)), to_pi(once)) <= 200 * np.finfo(dtype).eps
    # What it adds is of the order of rounding, unless the bounds on size were met.
    inside = np.all(np.abs(x) < 9, axis=-1)
    assert error(to_pi(once)[inside], to_pi(jnp.asarray(x))[inside]) <= 200 * np.finfo(dtype).eps


def test_linear_is_pi_itself():
    _, to_pi, from_pi, project = functions("Linear", np.float64)
    x = jnp.asarray(np.random.default_rng(7).normal(size=(4, 10)))
    for f in (to_pi, from_pi, project):
        np.testing.assert_array_equal(f(x), x)
