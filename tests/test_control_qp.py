"""The interior-point QP against two solvers of other families, and what it says when there is no answer."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import FAST

from jax_inertia.control.qp import Program, Solution, solve

N, ROWS = 16, 10


def problems(kind: str, count: int = 40) -> Program:
    """Random programs: a low-rank cost with bounds x ≥ 0 and two-sided rows that x = 0 meets."""
    out = []
    for seed in range(count):
        rng = np.random.default_rng([seed, 1])
        rank = 4 if kind == "flat cost" else N
        a = rng.normal(size=(rank, N))
        p = a.T @ a + (1e-4 if kind == "flat cost" else 1e-2) * np.eye(N)
        q = 3.0 * rng.normal(size=N)
        c = np.vstack([np.eye(N), rng.normal(size=(ROWS, N))])
        lower = np.concatenate([np.zeros(N), -np.abs(rng.normal(size=ROWS))])
        upper = np.concatenate([np.full(N, np.inf), np.abs(rng.normal(size=ROWS))])
        if kind == "badly scaled rows":
            factor = 10.0 ** rng.uniform(-3, 3, size=ROWS)
            c[N:] *= factor[:, None]
            lower[N:] *= factor
            upper[N:] *= factor
        if kind == "all forbidden":  # every variable but one is held at zero by its own bounds
            upper[1:N] = 1e-6
        if kind == "repeated rows":
            c[N + 5 :] = c[N : N + 5]
            lower[N + 5 :], upper[N + 5 :] = lower[N : N + 5], upper[N : N + 5]
        out.append((p, q, c, lower, upper, np.zeros(N + ROWS)))
    return Program(*(jnp.asarray(np.stack(x)) for x in zip(*out, strict=True)))


def batch_solver(iterations: int):
    return jax.jit(jax.vmap(lambda p: solve(p, iterations=iterations)), compiler_options=FAST)


SOLVE = batch_solver(15)
TEN = batch_solver(10)


class One(NamedTuple):
    """One program in NumPy."""

    p: np.ndarray
    q: np.ndarray
    c: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    softness: np.ndarray


def one(programs: Program, i: int) -> One:
    return One(*(np.array(x[i]) for x in jax.tree.leaves(programs)))


def by_active_set(p: One) -> np.ndarray:
    quadprog = pytest.importorskip("quadprog")
    low, high = np.isfinite(p.lower), np.isfinite(p.upper)
    c = np.vstack([p.c[low], -p.c[high]])
    b = np.concatenate([p.lower[low], -p.upper[high]])
    return quadprog.solve_qp(p.p, -p.q, c.T, b)[0]


def by_proximal(p: One) -> np.ndarray:
    proxsuite = pytest.importorskip("proxsuite")
    far = 1e20
    lower, upper = np.clip(p.lower, -far, far), np.clip(p.upper, -far, far)
    result = proxsuite.proxqp.dense.solve(
        p.p, p.q, None, None, p.c, lower, upper, eps_abs=1e-10, max_iter=10_000
    )
    return result.x


def cost(p: One, x: np.ndarray) -> float:
    return float(0.5 * x @ p.p @ x + p.q @ x)


@pytest.mark.parametrize("oracle", [by_active_set, by_proximal])
@pytest.mark.parametrize(
    "kind", ["plain", "flat cost", "badly scaled rows", "all forbidden", "repeated rows"]
)
def test_agrees_with_other_solvers(kind, oracle):
    programs = problems(kind)
    found = SOLVE(programs)
    assert np.all(found.converged)
    for i in range(len(programs.q)):
        program, x = one(programs, i), np.asarray(found.x[i])
        exact = oracle(program)
        assert cost(program, x) <= cost(program, exact) + 1e-5 * (1 + abs(cost(program, exact)))
        # A flat cost leaves the minimiser itself badly determined.
        np.testing.assert_allclose(x, exact, atol=2e-3 if kind == "flat cost" else 1e-4)


def test_multipliers_meet_the_conditions():
    programs = problems("plain")
    found = SOLVE(programs)
    gradient = jnp.einsum("bij,bj->bi", programs.p, found.x) + programs.q
    np.testing.assert_allclose(gradient, -jnp.einsum("bji,bj->bi", programs.c, found.y), atol=1e-4)


def test_float32_in_ten_iterations():
    programs = problems("plain")
    single = jax.tree.map(lambda x: x.astype(jnp.float32), programs)
    found: Solution = TEN(single)
    assert found.x.dtype == jnp.float32
    assert np.all(found.converged)
    for i in range(len(programs.q)):
        program = one(programs, i)
        exact = by_active_set(program)
        value, best = cost(program, np.asarray(found.x[i], float)), cost(program, exact)
        assert abs(value - best) < 3e-3 * (1 + abs(best))


def test_soft_rows_are_the_same_program_with_slack_variables():
    programs = problems("plain", 10)
    # Rows that x = 0 breaks by far: hard, there would be no answer.
    lower = programs.lower.at[:, N:].set(5.0)
    upper = programs.upper.at[:, N:].set(6.0)
    softness = jnp.zeros_like(lower).at[:, N:].set(0.1)
    programs = Program(programs.p, programs.q, programs.c, lower, upper, softness)
    found = SOLVE(programs)
    assert np.all(found.converged)
    for i in range(10):
        p = one(programs, i)
        hessian = np.zeros((N + ROWS, N + ROWS))
        hessian[:N, :N] = p.p
        hessian[N:, N:] = np.eye(ROWS) / 0.1
        c = np.hstack([p.c, np.vstack([np.zeros((N, ROWS)), -np.eye(ROWS)])])
        q = np.concatenate([p.q, np.zeros(ROWS)])
        wide = One(hessian, q, c, p.lower, p.upper, np.zeros(N + ROWS))
        np.testing.assert_allclose(found.x[i], by_active_set(wide)[:N], atol=1e-4)


def test_says_when_there_is_no_answer():
    programs = problems("plain", 4)
    apart = Program(
        programs.p,
        programs.q,
        programs.c.at[:, 1].set(programs.c[:, 0]),
        programs.lower.at[:, 0].set(1.0),
        programs.upper.at[:, 1].set(0.5),
        programs.softness,
    )
    found = SOLVE(apart)
    assert not np.any(found.converged)
    assert np.all(np.isfinite(found.x))
    spoiled = Program(
        programs.p.at[:, 0, 0].set(jnp.nan),
        programs.q,
        programs.c,
        programs.lower,
        programs.upper,
        programs.softness,
    )
    assert not np.any(SOLVE(spoiled).converged)


def test_too_few_iterations_are_reported():
    assert not np.any(batch_solver(2)(problems("plain")).converged)


def test_without_any_row_it_is_a_linear_solve():
    rng = np.random.default_rng(0)
    a = rng.normal(size=(5, 5))
    p, q = a.T @ a + np.eye(5), rng.normal(size=5)
    free = Program(*map(jnp.asarray, (p, q, np.eye(5), [-np.inf] * 5, [np.inf] * 5, [0.0] * 5)))
    found = jax.jit(lambda p: solve(p))(free)
    assert bool(found.converged)
    np.testing.assert_allclose(found.x, np.linalg.solve(p, -q), atol=1e-8)
