"""Lists of 3-vectors (n, 3, *b) and of 3×3 matrices (n, 3, 3, *b), batch axes last; see `batch_last`.

Sums over components are written as reductions: XLA neither takes these apart into products of tiny matrices, nor
computes them again in every operation that reads them.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

_NEXT, _AFTER = np.array([1, 2, 0]), np.array([2, 0, 1])


def cross(a: Float[Array, "n 3 ..."], b: Float[Array, "n 3 ..."]) -> Float[Array, "n 3 ..."]:
    """a × b."""
    return a[:, _NEXT] * b[:, _AFTER] - a[:, _AFTER] * b[:, _NEXT]


def turn(m: Float[Array, "n 3 3 ..."], x: Float[Array, "n 3 ..."]) -> Float[Array, "n 3 ..."]:
    """m x."""
    return jnp.sum(m * x[:, None], 2)


def turn_back(m: Float[Array, "n 3 3 ..."], x: Float[Array, "n 3 ..."]) -> Float[Array, "n 3 ..."]:
    """mᵀ x."""
    return jnp.sum(m * x[:, :, None], 1)


def compose(
    a: Float[Array, "n i 3 ..."], b: Float[Array, "n 3 k ..."]
) -> Float[Array, "n i k ..."]:
    """a b."""
    return jnp.sum(a[:, :, :, None] * b[:, None], 2)


def skew(a: Float[Array, "n 3 ..."]) -> Float[Array, "n 3 3 ..."]:
    """[a]× with [a]× b = a × b."""
    x, y, z = a[:, 0], a[:, 1], a[:, 2]
    o = jnp.zeros_like(x)
    rows = [[o, -z, y], [z, o, -x], [-y, x, o]]
    return jnp.stack([jnp.stack(row, 1) for row in rows], 1)


def lever(w: Float[Array, "n 3 ..."]) -> Float[Array, "n 3 6 ..."]:
    """L(ω) with L(ω) [Ixx, Ixy, Ixz, Iyy, Iyz, Izz] = I ω."""
    x, y, z = w[:, 0], w[:, 1], w[:, 2]
    o = jnp.zeros_like(x)
    rows = [[x, y, z, o, o, o], [o, x, o, y, z, o], [o, o, x, o, y, z]]
    return jnp.stack([jnp.stack(row, 1) for row in rows], 1)


def symmetric(i: Float[Array, "n 6 ..."]) -> Float[Array, "n 3 3 ..."]:
    """The matrix of [Ixx, Ixy, Ixz, Iyy, Iyz, Izz]."""
    return jnp.stack([jnp.stack([i[:, k] for k in row], 1) for row in _ENTRIES], 1)


_ENTRIES = [[0, 1, 2], [1, 3, 4], [2, 4, 5]]
