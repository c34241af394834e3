"""Arguments of public functions, looked at before they are used: shapes always, values where they are known."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array


def last_axes(name: str, value: Any, shape: tuple[int, ...], meaning: str) -> Array:
    """An array whose last axes have a shape; ValueError says which they have instead."""
    array = jnp.asarray(value)
    if array.shape[-len(shape) :] != shape:
        wanted = ", ".join(map(str, shape))
        raise ValueError(f"{name} has shape {array.shape}; it must end in ({wanted}), {meaning}")
    return array


def known(value: Any) -> np.ndarray | None:
    """The numbers of an array; None while it is traced, when nothing is known of them."""
    return None if isinstance(value, Tracer) else np.asarray(value)


def require(name: str, value: Any, test: Callable[[np.ndarray], Any], wanted: str) -> None:
    """ValueError where a setting's numbers, if they are known, are not all what is `wanted`."""
    numbers = known(value)
    if numbers is not None and not np.all(test(numbers)):
        raise ValueError(f"{name} is {numbers}; it must be {wanted}")


def is_positive(x: np.ndarray) -> np.ndarray | np.bool_:
    """Where numbers are positive and finite."""
    return np.isfinite(x) & (x > 0)


def floats_as(tree: Any, dtype: jnp.dtype) -> Any:
    """The same with floating-point arrays, and Python's floats, of one type."""
    return jax.tree.map(lambda x: jnp.asarray(x, dtype) if _is_float(x) else x, tree)


def _is_float(x: Any) -> bool:
    """Whether it is of a floating type, by its `dtype`, which a tracer of any jax release has.

    Not `equinox.is_inexact_array_like`: that calls `__jax_array__` wherever there is an attribute
    of that name, and on the tracers of jax 0.11 and later it is there and None.
    """
    return isinstance(x, float) or jnp.issubdtype(getattr(x, "dtype", bool), jnp.floating)
