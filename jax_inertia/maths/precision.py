"""Double precision for what needs it, whatever JAX is set to."""

import functools
from collections.abc import Callable
from typing import ParamSpec, TypeVar

import jax

P = ParamSpec("P")
R = TypeVar("R")


def in_double_precision(function: Callable[P, R]) -> Callable[P, R]:
    """The same function under `jax.enable_x64`: for whole logs, whose covariances span twelve decades.

    >>> import jax.numpy as jnp
    >>> from jax_inertia.maths.precision import in_double_precision
    >>> in_double_precision(lambda: jnp.ones(2).dtype)()
    dtype('float64')
    """

    @functools.wraps(function)
    def wrapped(*args: P.args, **kwargs: P.kwargs) -> R:
        with jax.enable_x64(True):
            return function(*args, **kwargs)

    return wrapped


def in_full_precision(function: Callable[P, R]) -> Callable[P, R]:
    """The same function with products of matrices at the precision of their dtype.

    A GPU would take float32 factors with ten bits (TensorFloat-32): 3e-4 of an entry of a Jacobian, where a filter
    works with twelve decades of covariance.

    >>> import jax, jax.numpy as jnp
    >>> from jax_inertia.maths.precision import in_full_precision
    >>> "precision=(Precision.HIGHEST" in str(jax.make_jaxpr(in_full_precision(jnp.dot))(jnp.eye(2), jnp.eye(2)))
    True
    """

    @functools.wraps(function)
    def wrapped(*args: P.args, **kwargs: P.kwargs) -> R:
        with jax.default_matmul_precision("highest"):
            return function(*args, **kwargs)

    return wrapped
