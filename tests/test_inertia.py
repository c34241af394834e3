"""π, pseudo-inertia, both log-Cholesky maps: round trips, Jacobians, thin bodies, Pinocchio."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bodies import body, margin, random_bodies, rotation, spread_body
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from pinocchio_oracle import ORDER, pin

from jax_inertia.maths import inertial_parameters

MAPS = {
    name: tuple(map(jax.jit, (to_pi, to_theta, jacobian, jax.jacfwd(to_pi))))
    for name, to_pi, to_theta, jacobian in [
        (
            "UtU",
            inertial_parameters.from_log_cholesky,
            inertial_parameters.to_log_cholesky,
            inertial_parameters.log_cholesky_jacobian,
        ),
        (
            "UUt",
            inertial_parameters.from_log_cholesky_uut,
            inertial_parameters.to_log_cholesky_uut,
            inertial_parameters.log_cholesky_uut_jacobian,
        ),
    ]
}
maps = pytest.mark.parametrize("name", MAPS)
# Pinocchio's θ has s13 after s23.
THETA_ORDER = np.array([0, 1, 2, 3, 4, 6, 5, 7, 8, 9])
physical = jax.jit(inertial_parameters.is_physical)
pseudo_inertia = jax.jit(inertial_parameters.pseudo_inertia)

thetas = st.lists(st.floats(-3.0, 3.0), min_size=10, max_size=10).map(np.array)


def stored(pi) -> np.ndarray:
    """What each entry of π is stored against: m, √(m tr Σ) and tr Σ."""
    m, trace = pi[..., 0], 0.5 * (pi[..., 4] + pi[..., 7] + pi[..., 9])
    first = np.sqrt(m * trace)
    return np.stack([m, *[first] * 3, *[trace] * 6], axis=-1)


def spread_ratio(pi: np.ndarray) -> float:
    """Condition of the pseudo-inertia with its diagonal scaled to one."""
    p = np.asarray(pseudo_inertia(jnp.asarray(pi)))
    scale = 1 / np.sqrt(np.diagonal(p))
    return float(np.linalg.cond(p * scale[:, None] * scale))


def test_pi_is_mass_first_moment_and_inertia():
    pi = inertial_parameters.from_com(
        jnp.array(2.0), jnp.array([0.1, -0.2, 0.3]), jnp.diag(jnp.array([0.3, 0.4, 0.5]))
    )
    np.testing.assert_allclose(pi, body(2.0, [0.1, -0.2, 0.3], np.diag([0.3, 0.4, 0.5])), 1e-14)
    np.testing.assert_allclose(inertial_parameters.centre_of_mass(pi), [0.1, -0.2, 0.3], rtol=1e-14)
    assert inertial_parameters.PI_NAMES[7] == "Iyy"
    np.testing.assert_array_equal(inertial_parameters.rotational_inertia(pi)[1, 1], pi[7])
    np.testing.assert_array_equal(inertial_parameters.centre_of_mass(jnp.zeros(10)), np.zeros(3))


def test_pseudo_inertia_is_the_second_moment_of_mass():
    """P = Σ m [r; 1][r; 1]ᵀ and I = Σ m (r·r 1 − r rᵀ) over point masses, whatever they are."""
    rng = np.random.default_rng(3)
    masses, points = rng.uniform(0.1, 1.0, 6), rng.normal(size=(6, 3))
    ends = np.concatenate([points, np.ones((6, 1))], axis=1)
    pi = sum(body(m, r, np.zeros((3, 3))) for m, r in zip(masses, points, strict=True))
    p = np.einsum("n,ni,nj->ij", masses, ends, ends)
    np.testing.assert_allclose(inertial_parameters.pseudo_inertia(jnp.asarray(pi)), p, rtol=1e-13)
    np.testing.assert_allclose(
        inertial_parameters.from_pseudo_inertia(jnp.asarray(p)), pi, rtol=1e-13
    )


@maps
@settings(max_examples=100, deadline=None)
@given(theta=thetas)
@example(theta=np.array([1.0, 0.0, 3.0, -3.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0]))
def test_every_theta_is_a_body_and_comes_back(name, theta):
    to_pi, to_theta, _, _ = MAPS[name]
    pi = to_pi(jnp.asarray(theta))
    condition = spread_ratio(np.asarray(pi))
    assume(condition < 1e10)
    assert bool(physical(pi))
    # Cholesky is backward stable: θ moves by the rounding of π times the condition of the body; and π keeps sums of
    # second moments, so that the smallest of them is rounded like their trace.
    second = np.diagonal(np.asarray(pseudo_inertia(pi)))[:3]
    rounded = max(np.exp(2 * np.max(np.abs(theta))), second.sum() / second.min())
    tolerance = 1e-14 * condition * rounded
    np.testing.assert_allclose(to_theta(pi), theta, rtol=0, atol=tolerance)


@maps
def test_bodies_come_back(name):
    to_pi, to_theta, _, _ = MAPS[name]
    pi = random_bodies(500)
    back = to_pi(to_theta(jnp.asarray(pi)))
    assert np.max(np.abs(back - pi) / stored(pi)) <= 1e-14
    single = pi.astype(np.float32)
    back = to_pi(to_theta(jnp.asarray(single)))
    assert back.dtype == np.float32
    assert np.max(np.abs(back - single) / stored(single)) <= 1e-5


@maps
@settings(max_examples=100, deadline=None)
@given(theta=thetas)
def test_jacobian_is_autodiff(name, theta):
    _, _, jacobian, autodiff = MAPS[name]
    theta = jnp.asarray(theta)
    exact = autodiff(theta)
    scale = np.max(np.abs(exact), axis=0, keepdims=True)
    assert np.max(np.abs(jacobian(theta) - exact) / scale) <= 1e-12


THIN = {"rod": [0.3, 1.0, 1.0], "plate": [0.3, 0.4, 1.0], "point": [1.0, 1.0, 1.0]}


def thin_body(shape: str, thickness: float, com, turn) -> np.ndarray:
    sizes = [s if s < 1.0 else thickness for s in THIN[shape]]
    return spread_body(1.3, com, sizes, turn)


@maps
@pytest.mark.parametrize("shape", THIN)
@pytest.mark.parametrize("thickness", [1e-3, 1e-6])
def test_thin_bodies_turned_and_displaced(name, shape, thickness):
    """As thin as float64 can say: thickness² above ε times the moment about the origin."""
    to_pi, to_theta, jacobian, autodiff = MAPS[name]
    rng = np.random.default_rng(5)
    for _ in range(20):
        pi = thin_body(shape, thickness, rng.uniform(-0.2, 0.2, 3), rotation(rng))
        assert bool(physical(jnp.asarray(pi)))
        theta = to_theta(jnp.asarray(pi))
        # π comes back to rounding whatever the condition; θ only to ε times the condition.
        assert np.max(np.abs(to_pi(theta) - pi) / stored(pi)) <= 1e-14
        again = to_theta(to_pi(theta))
        tolerance = 4e-16 * spread_ratio(pi) * np.maximum(1, np.abs(theta))
        assert np.all(np.abs(again - theta) <= 10 * tolerance)
        exact = autodiff(theta)
        scale = np.max(np.abs(exact), axis=0, keepdims=True)
        assert np.max(np.abs(jacobian(theta) - exact) / scale) <= 1e-12


@maps
@pytest.mark.parametrize("shape", THIN)
def test_a_nanometre_thin_along_the_axes(name, shape):
    """1e-9 m: 1e-18 of a moment, which π holds only as a difference of moments.

    Rods and plates so thin are lost in π itself, where Iyy + Izz − Ixx rounds to zero; they must
    come out as not physical, or come back exactly. A point has no larger moment to be lost against.
    """
    to_pi, to_theta, _, _ = MAPS[name]
    pi = thin_body(shape, 1e-9, np.zeros(3), None)
    theta = np.asarray(to_theta(jnp.asarray(pi)))
    assert bool(physical(jnp.asarray(pi))) == bool(np.all(np.isfinite(theta)))
    assert (shape != "point") or np.all(np.isfinite(theta))
    if np.all(np.isfinite(theta)):
        assert np.max(np.abs(to_pi(jnp.asarray(theta)) - pi) / stored(pi)) <= 1e-14


@maps
def test_unphysical_bodies_have_no_theta(name):
    _, to_theta, _, _ = MAPS[name]
    bad = np.array([body(1.0, [0, 0, 0], np.diag([0.1, 0.1, 0.3])), -random_bodies(1)[0]])
    assert np.all(np.any(np.isnan(to_theta(jnp.asarray(bad))), axis=-1))


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_is_physical_against_the_definition(dtype):
    """Mass, principal moments, triangle inequalities by eigenvalues, across the edge of the set."""
    rng = np.random.default_rng(8)
    inside = random_bodies(4000, seed=1)
    push = rng.normal(size=inside.shape) * stored(inside) * 10 ** rng.uniform(-4, 0, (4000, 1))
    pi = (inside + push).astype(dtype)
    said = np.asarray(physical(jnp.asarray(pi)))
    truth = np.array([margin(x.astype(float)) for x in pi])
    # Closer to the edge than rounding, either answer is right.
    clear = np.abs(truth) > 100 * np.finfo(dtype).eps
    np.testing.assert_array_equal(said[clear], truth[clear] > 0)
    assert clear.mean() > 0.99
    assert 0.2 < np.mean(truth[clear] > 0) < 0.8
    assert physical(jnp.asarray(inside.astype(dtype))).all()


def test_is_physical_does_not_depend_on_units_or_break_on_rubbish():
    pi = random_bodies(50, seed=4)
    # Kilograms to milligrams, metres to micrometres; and the other way.
    for mass, length in ((1e6, 1e6), (1e-6, 1e-6)):
        units = mass * length ** np.array([0] + [1] * 3 + [2] * 6)
        assert physical(jnp.asarray((pi * units).astype(np.float32))).all()
    rubbish = np.tile(pi[0], (13, 1))
    rubbish[np.arange(10), np.arange(10)] = np.nan
    rubbish[10], rubbish[11, 0], rubbish[12, 4] = 0.0, np.inf, np.inf
    assert not physical(jnp.asarray(rubbish)).any()


def test_agrees_with_pinocchio_log_cholesky():
    """UUᵀ is Pinocchio's: π and Jacobian at random θ, with both conventions of order converted."""
    for theta in np.random.default_rng(2).normal(size=(50, 10)):
        parameters = pin.LogCholeskyParameters(theta[THETA_ORDER])
        pi = np.zeros(10)
        pi[ORDER] = parameters.toDynamicParameters()
        jacobian = np.zeros((10, 10))
        jacobian[np.ix_(ORDER, THETA_ORDER)] = parameters.calculateJacobian()
        ours = inertial_parameters.from_log_cholesky_uut(jnp.asarray(theta))
        assert np.max(np.abs(ours - pi) / stored(pi)) <= 1e-13
        exact = inertial_parameters.log_cholesky_uut_jacobian(jnp.asarray(theta))
        scale = np.max(np.abs(exact), axis=0, keepdims=True)
        assert np.max(np.abs(jacobian - exact) / scale) <= 1e-12


def test_the_two_factors_are_not_interchangeable():
    """The paper's m = e^{2α}(t·t + 1); in the other m = e^{2α} and t is the centre of mass."""
    theta = jnp.asarray(np.random.default_rng(6).normal(size=10))
    alpha, t = theta[0], theta[7:]
    paper, other = (
        inertial_parameters.from_log_cholesky(theta),
        inertial_parameters.from_log_cholesky_uut(theta),
    )
    np.testing.assert_allclose(paper[0], np.exp(2 * alpha) * (t @ t + 1), rtol=1e-13)
    np.testing.assert_allclose(other[0], np.exp(2 * alpha), rtol=1e-13)
    np.testing.assert_allclose(inertial_parameters.centre_of_mass(other), t, rtol=1e-13)
    assert np.max(np.abs(inertial_parameters.centre_of_mass(paper) - t)) > 0.1


@maps
def test_batch_axes(name):
    to_pi, to_theta, jacobian, _ = MAPS[name]
    theta = jnp.asarray(np.random.default_rng(9).normal(size=(2, 3, 10)))
    pi = to_pi(theta)
    assert physical(pi).shape == (2, 3)
    for i in np.ndindex(2, 3):
        np.testing.assert_allclose(pi[i], to_pi(theta[i]), rtol=1e-14)
        np.testing.assert_allclose(to_theta(pi)[i], to_theta(pi[i]), rtol=1e-12)
        np.testing.assert_allclose(jacobian(theta)[i], jacobian(theta[i]), rtol=1e-13, atol=1e-15)


@pytest.mark.usefixtures("unchecked")
@maps
def test_other_shapes_are_refused(name):
    to_pi, to_theta, jacobian, _ = MAPS[name]
    for size in (9, 11):
        for call, what in ((to_pi, "theta"), (jacobian, "theta"), (to_theta, "pi")):
            with pytest.raises(ValueError, match=rf"{what} has shape \({size},\).* end in \(10\)"):
                call(jnp.zeros(size))


@pytest.mark.usefixtures("unchecked")
def test_from_com_takes_numbers_and_no_diagonal():
    round_, com = 0.01 * np.eye(3), [0.0, 0.0, 0.1]
    np.testing.assert_array_equal(
        inertial_parameters.from_com(2.0, com, round_),
        inertial_parameters.from_com(jnp.array(2.0), jnp.array(com), round_),
    )
    with pytest.raises(ValueError, match=r"inertia has shape \(3,\).*jnp.diag"):
        inertial_parameters.from_com(2.0, com, np.array([0.02, 0.02, 0.01]))
