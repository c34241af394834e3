"""The paper's batch estimator, and its report of what data can and cannot determine."""

import numpy as np
import pytest

from jax_inertia.maths.inertial_parameters import PI_NAMES
from jax_inertia.maths.least_squares import weighted_least_squares

# Rank of the regressor of robots whatever their motion. Two links in a vertical plane: of each a moment of inertia and
# two first moments, the second's mass hung into the first's. `welded` has two joints, the first fixed in the world:
# 3 and 7. A free body shows all ten. Arms of seven joints, the first axis vertical: 43 (Gaz et al. 2019, the Panda).
RANKS = {"planar_2r": 6, "welded": 10, "free_body": 10, "arm7": 43}


@pytest.fixture(scope="module", params=RANKS)
def stacked(request, cases):
    """(robot's name, rows of its regressor at random states, names of the columns)."""
    case = cases(request.param)
    y = np.asarray(case.core(case.robot, *case.states(100))["regressor"])
    names = [f"{body}.{p}" for body in case.robot.body_names for p in PI_NAMES]
    return request.param, y.reshape(-1, len(names)), names


def vector(combination: str, names: list[str]) -> np.ndarray:
    """The coefficients of a printed combination, e.g. 'a.m +3.1 b.hx'."""
    out = np.zeros(len(names))
    first, *rest = combination.split(" ")
    out[names.index(first)] = 1.0
    for coefficient, name in zip(rest[::2], rest[1::2], strict=True):
        out[names.index(name)] = float(coefficient)
    return out


def test_rank_null_space_and_combinations_of_known_robots(stacked):
    robot, y, names = stacked
    seen = weighted_least_squares(y, np.zeros(len(y)), names=names).identifiability
    scale = np.linalg.norm(y, axis=0)
    unseen = scale < 1e-9 * scale.max()
    scale[unseen] = 1.0
    _, s, vt = np.linalg.svd(y / scale)
    rank = int(np.sum(s > 1e-9 * s[0]))
    assert seen.rank == rank == RANKS[robot]
    assert seen.condition == pytest.approx(s[0] / s[rank - 1], rel=1e-6)
    # NumPy's null space, spanned by the report's orthonormal basis.
    basis = seen.null_space
    np.testing.assert_allclose(basis.T @ basis, np.eye(len(names) - rank), atol=1e-9)
    np.testing.assert_allclose(basis @ basis.T, vt[rank:].T @ vt[rank:], atol=1e-7)
    assert np.array_equal(seen.invisible, unseen)
    assert np.array_equal(seen.determined, np.linalg.norm(vt[rank:], axis=0) < 1e-6)
    # Every printed combination is one: what the data cannot see does not move it, to the digits printed.
    assert len(seen.combinations) == rank
    rows = np.array([vector(text, names) for text in seen.combinations])
    moved = rows @ (basis / scale[:, None])
    size = np.linalg.norm(rows / scale, axis=1, keepdims=True)
    assert np.max(np.abs(moved) / size, initial=0.0) < 1e-3
    assert np.linalg.matrix_rank(rows) == rank


def test_solution_covariance_and_cost_are_the_normal_equations(stacked):
    _, y, names = stacked
    rng = np.random.default_rng(0)
    f, w = rng.normal(size=len(y)), rng.uniform(0.1, 5.0, size=len(y))
    fit = weighted_least_squares(y, f, w, names=names)
    residual = f - y @ fit.value
    assert fit.cost == pytest.approx(0.5 * np.sum(w * residual**2), rel=1e-9)
    # At the minimum nothing is left along any column.
    size = np.linalg.norm(y, axis=0)
    slope = y.T @ (w * residual) / np.maximum(size, 1e-9 * size.max())
    assert np.max(np.abs(slope)) < 1e-8 * np.linalg.norm(f)
    pseudo = np.linalg.pinv(y * np.sqrt(w)[:, None], rcond=1e-10)
    predicted = y @ (pseudo @ (f * np.sqrt(w)))
    np.testing.assert_allclose(y @ fit.value, predicted, atol=1e-8)
    # What the determined part is uncertain by, seen through the rows themselves.
    np.testing.assert_allclose(
        np.einsum("rp,pq,rq->r", y, fit.covariance, y),
        np.sum((y @ pseudo) ** 2, axis=1),
        rtol=1e-6,
        atol=1e-9,
    )


def test_rows_of_weight_zero_may_hold_anything_and_others_may_not():
    rng = np.random.default_rng(1)
    y, f = rng.normal(size=(30, 3)), rng.normal(size=30)
    wanted = weighted_least_squares(y[5:], f[5:], 2.0)
    bad_y, bad_f, w = y.copy(), f.copy(), np.full(30, 2.0)
    bad_y[0], bad_f[1:5], w[:5] = np.nan, np.inf, 0.0
    np.testing.assert_allclose(weighted_least_squares(bad_y, bad_f, w).value, wanted.value)
    with pytest.raises(ValueError, match="not finite"):
        weighted_least_squares(bad_y, bad_f)
    with pytest.raises(ValueError, match="negative"):
        weighted_least_squares(y, f, -w)


def test_no_rows_and_fewer_rows_than_parameters():
    nothing = weighted_least_squares(np.zeros((4, 3)), np.ones(4)).identifiability
    assert nothing.rank == 0
    assert nothing.invisible.all()
    assert "3 invisible" in repr(nothing)
    one = weighted_least_squares(np.array([[1.0, 2.0]]), np.array([5.0]))
    assert one.identifiability.rank == 1
    assert float(np.array([1.0, 2.0]) @ one.value) == pytest.approx(5.0)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"weight": [1.0, np.nan, 1.0]}, "negative or not finite; weights are inverse variances"),
        (
            {"weight": np.ones(2)},
            r"weight has shape \(2,\); expected one number, or one for each of 3 rows",
        ),
        ({"weight": np.eye(3)}, r"weight has shape \(3, 3\)"),
        ({"regressor": np.ones(3)}, r"regressor has shape \(3,\); expected \(rows, parameters\)"),
        ({"measurement": np.ones(4)}, r"measurement has shape \(4,\); the regressor has 3 rows"),
        ({"names": ["a"]}, "1 names for 2 columns"),
    ],
)
@pytest.mark.usefixtures("unchecked")
def test_what_does_not_fit_is_named(changes, said):
    with pytest.raises(ValueError, match=said):
        weighted_least_squares(
            **{"regressor": np.ones((3, 2)), "measurement": np.ones(3)} | changes
        )
