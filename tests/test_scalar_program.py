"""A function's scalar operations give what the function gives, and are those that it needs."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.scipy.linalg import solve_triangular

from jax_inertia.dynamics import recursions
from jax_inertia.dynamics.kinematics import forward_kinematics
from jax_inertia.maths.charts import LogCholeskyUUt
from jax_inertia.maths.scalar import trace as scalar_trace
from jax_inertia.maths.scalar.program import Node, Program
from jax_inertia.maths.scalar.trace import one_thread


def program_of(function, *args, straight: bool = False) -> Program:
    """Its program, with all arguments for inputs."""
    shapes = [jax.ShapeDtypeStruct(x.shape, x.dtype) for x in args]
    before = one_thread.set(straight)
    closed = jax.make_jaxpr(lambda *x: jax.tree.leaves(function(*x)))(*shapes)
    one_thread.reset(before)
    # Arguments first, then what the trace found to be known.
    jaxpr = closed.jaxpr.replace(
        constvars=[], invars=[*closed.jaxpr.invars, *closed.jaxpr.constvars]
    )
    return scalar_trace.traced(jaxpr, [*shapes, *closed.consts])


def results(program: Program, *args) -> list[np.ndarray]:
    out = [np.zeros(x.shape) for x in program.outputs]
    for k, at, value in program.run(lambda k, at: jnp.asarray(args[k])[at]):
        out[k][at] = value
    return out


FUNCTIONS = {
    "products": lambda a, b: (a @ b, a.T @ a, jnp.einsum("ij,ik->kj", a, b)),
    "moves": lambda a, b: (a[::-1, 1:], jnp.stack([a, b]).reshape(-1), a[np.array([2, 0])]),
    "sums": lambda a, b: (a[:0].sum(0), a.sum(0), b.max(1), (a > b).any(), (a > 0).all(1), jnp.where(a > b, a, b)),
    "scalars": lambda a, b: (a**3, a**-2, 0.0 - (-a), jnp.sqrt(a * a), a / b, abs(a - a)),
    "logic": lambda a, b: ((a > b).astype(float).sum(), jnp.sum(a > b), ~(a > b) & (a > 0), a.astype(bool) | (b > 0)),
    "branches": lambda a, b: (jax.lax.cond(a[0, 0] > b[0, 0], lambda: a, lambda: b),),
    "loops": lambda a, b: jax.lax.scan(lambda c, x: (c + x, c * x), b[0], a, reverse=True),
    "factors": lambda a, b: (
        jnp.linalg.cholesky(a @ a.T + jnp.eye(3)),
        solve_triangular(a, b, lower=True),
        solve_triangular(a, b, trans=1),
        jax.lax.linalg.triangular_solve(a, b, lower=True),
    ),
    "places": lambda a, b: (
        jax.lax.dynamic_index_in_dim(a, (b[0, 0] > 0).astype(int) + 1, keepdims=False),
        jnp.pad(a, ((1, 0), (0, 2))),
    ),
    "functions": lambda a, b: (jnp.sin(a), jnp.cos(b), jnp.exp(a), jnp.tanh(b), jnp.log(a * a), jnp.isfinite(a)),
}  # fmt: skip


@pytest.mark.parametrize("name", list(FUNCTIONS))
def test_as_the_function(name: str):
    rng = np.random.default_rng(0)
    args = [rng.normal(size=(3, 3)), rng.normal(size=(3, 3))]
    found = results(program_of(FUNCTIONS[name], *args), *args)
    for a, b in zip(found, FUNCTIONS[name](*map(jnp.asarray, args)), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-6)


@pytest.mark.parametrize("name", ["floating_tree", "arm7"])
@pytest.mark.slow
def test_dynamics_as_one_thread_computes_them(cases, name: str):
    case = cases(name)
    robot = case.robot
    q, v, a = (jnp.asarray(x)[0] for x in case.states(1))

    def both(q, v, a):
        return recursions.condensed_dynamics((1,), robot, q, v, a)

    for straight in (False, True):
        found = results(program_of(both, q, v, a, straight=straight), q, v, a)
        for x, y in zip(found, both(q, v, a), strict=True):
            np.testing.assert_allclose(x, y, rtol=0, atol=1e-9 * np.abs(y).max())


def test_one_thread_composes_each_pose_once(cases):
    robot = cases("arm7").robot
    q = np.zeros(robot.nq)
    few, many = (
        len(program_of(lambda q: forward_kinematics(robot, q), q, straight=x).ordered())
        for x in (True, False)
    )
    assert few < many


def test_chart_and_its_jacobian():
    chart, x = LogCholeskyUUt(), jnp.linspace(-0.4, 0.5, 10)
    found = results(
        program_of(lambda x: (chart.to_pi(x), chart.jacobian(x), chart.project(x)), x), x
    )
    for a, b in zip(found, (chart.to_pi(x), chart.jacobian(x), chart.project(x)), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-9)


def test_known_numbers_are_folded_in():
    known = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, -1.0, 2.0]])
    program = program_of(lambda x: known @ x, np.ones(3))
    (out,) = program.outputs
    assert out[0].name == "input"
    assert out[1] == 0.0
    assert [n.name for n in program.ordered()].count("mul") == 1
    assert program.used() == [0]


def test_sums_along_a_tree_take_one_addition_a_node():
    chain = np.tril(np.ones((6, 6)))
    program = program_of(lambda x: chain @ x, np.ones(6))
    assert [n.name for n in program.ordered()].count("add") == 5


def test_same_operation_once():
    program = program_of(lambda x: x[0] * x[1] + x[0] * x[1], np.ones(2))
    assert sum(isinstance(n, Node) and n.name == "mul" for n in program.ordered()) == 1


def test_loops_until_a_condition_holds_have_no_scalar_form():
    with pytest.raises(NotImplementedError, match="while"):
        program_of(
            lambda x: jax.lax.while_loop(lambda y: y[0] < 9.0, lambda y: 2.0 * y, x), np.ones(2)
        )
