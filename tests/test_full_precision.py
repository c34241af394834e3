"""Float32 stays float32 on a GPU: no product of matrices of the filter may be left to TensorFloat-32's ten bits."""

import jax
import jax.numpy as jnp
import pytest

from jax_inertia import load_model
from jax_inertia.estimation.inertial_filter import Estimator, make_estimator
from jax_inertia.maths import charts, inertial_parameters
from jax_inertia.maths.kalman import Information, SquareRoot
from jax_inertia.robots.pendulum import double_pendulum
from jax_inertia.signals.differences import Observation
from jax_inertia.signals.generalised_motion import Motion


def products(function, *args) -> list[str]:
    """The products of a program, as the compiler is told of them."""
    text = jax.jit(function).lower(*args).as_text()
    return [line for line in text.splitlines() if "stablehlo.dot_general" in line]


def coarse(function, *args) -> list[str]:
    """Those that a GPU would shorten."""
    return [line for line in products(function, *args) if "HIGHEST" not in line]


def test_a_plain_product_is_found():
    assert len(coarse(jnp.dot, jnp.eye(3), jnp.eye(3))) == 1


@pytest.fixture(scope="module")
def robot():
    return load_model(double_pendulum()).astype("float32")


def observation() -> Observation:
    two = jnp.ones(2, jnp.float32)
    motion = Motion(time=jnp.zeros((), jnp.float32), q=two, v=two, tau=two, valid=jnp.ones(2, bool))
    return Observation(motion, two)


def step(estimator: Estimator):
    return lambda: estimator.step(estimator.initial(), observation(), 0.01)


@pytest.mark.parametrize("form", [SquareRoot(), Information()])
@pytest.mark.parametrize("sigma_a", [None, 0.3])
def test_a_filter_step_is_at_full_precision(robot, form, sigma_a):
    estimator = make_estimator(robot, ["lower"], sigma_tau=0.1, form=form, sigma_a=sigma_a)
    assert products(step(estimator))
    assert coarse(step(estimator)) == []


@pytest.mark.parametrize("chart", [charts.LogCholesky(), charts.LogCholeskyUUt(), "relative"])
def test_an_analytic_jacobian_is_at_full_precision(robot, chart):
    chart = charts.Relative.to(robot.pi[1]) if chart == "relative" else chart
    x = chart.from_pi(robot.pi[1])
    assert products(lambda x: chart.jacobian(x), x)
    assert coarse(lambda x: chart.jacobian(x), x) == []
    assert coarse(inertial_parameters.factor, x) == []
