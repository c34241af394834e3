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
