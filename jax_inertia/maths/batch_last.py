"""Functions of one sample that `vmap` computes with the batch as the last, contiguous axis.

Rigid-body dynamics is a few hundred small operations on 3-vectors. With the batch first, as `vmap` alone would have it,
each of them works on three numbers at a time; with the batch last, on as many samples as a register holds. So a
function is written once, for arrays with any number of batch axes *after* their own: none for one sample, one for
`vmap`, two for a `vmap` of a `vmap`. On a CPU a large batch goes through in chunks that stay in a core's cache.
"""

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_batching import custom_vmap
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, Float

_CACHE_BYTES = 400_000
"""What a chunk's arguments, results and intermediate values may take of a core's second-level cache."""


def batch_last(kernel: Callable[..., Any], *args: Any) -> Any:
    """`kernel(*args)`, where `vmap` hands the kernel its batch as the last axis of every array.

    Arrays that are not batched get a last axis of length one. Results must have the batch axes last, too, of full
    length or one. Differentiable in both modes; derivatives are batched as `vmap` does by itself.
    """
    leaves, structure = jax.tree.flatten(args)

    def plain(*leaves: Array) -> Any:
        return kernel(*jax.tree.unflatten(structure, leaves))

    # `custom_vmap` alone has no reverse mode, and zero tangents that are spelt out would cost as much as others.
    @jax.custom_jvp
    def call(*leaves: Array) -> Any:
        return _with_rule(plain)(*leaves)

    def along(primals: tuple, tangents: tuple) -> tuple:
        moved = [i for i, t in enumerate(tangents) if not isinstance(t, SymbolicZero)]

        def of_moved(*values: Array) -> Any:
            at = dict(enumerate(primals)) | dict(zip(moved, values, strict=True))
            return plain(*at.values())

        return jax.jvp(of_moved, [primals[i] for i in moved], [tangents[i] for i in moved])

    call.defjvp(along, symbolic_zeros=True)
    return call(*leaves)


def _with_rule(plain: Callable[..., Any]) -> Callable[..., Any]:
    @custom_vmap
    def call(*leaves: Array) -> Any:
        return plain(*leaves)

    @call.def_vmap
    def rule(size: int, batched: list[bool], *leaves: Array) -> Any:
        # Traced once, for its shapes and for its use.
        @partial(jax.jit, inline=True)
        def whole(*leaves: Array) -> Any:
            lasts = [
                jnp.moveaxis(x, 0, -1) if is_batched else x[..., None]
                for x, is_batched in zip(leaves, batched, strict=True)
            ]
            out = _with_rule(plain)(*lasts)
            length = max(x.shape[-1] for x in lasts)
            return jax.tree.map(
                lambda x: jnp.moveaxis(jnp.broadcast_to(x, (*x.shape[:-1], length)), -1, 0), out
            )

        def in_chunks(*leaves: Array) -> Any:
            return _map(whole, chunk, batched, leaves)

        shapes = jax.eval_shape(whole, *leaves)
        batched_out = jax.tree.map(lambda _: True, shapes)
        chunk = _chunk(size, batched, leaves, jax.tree.leaves(shapes))
        if size <= chunk:
            return whole(*leaves), batched_out
        return jax.lax.platform_dependent(*leaves, cpu=in_chunks, default=whole), batched_out

    return call


def _chunk(size: int, batched: list[bool], leaves: tuple, out: list) -> int:
    """How many samples go through at once: a power of two, at least eight."""
    each = sum(x.nbytes // (size if b else 1) for x, b in zip(leaves, batched, strict=True))
    each += sum(math.prod(x.shape) * x.dtype.itemsize // size for x in out)
    # Intermediate values are about as many again as what goes in and comes out.
    return max(8, 2 ** int(math.log2(max(_CACHE_BYTES / (each + 1), 8))))


def _map(whole: Callable[..., Any], chunk: int, batched: list[bool], leaves: tuple) -> Any:
    """`whole` over chunks of the batched leaves."""
    moving = [x for x, b in zip(leaves, batched, strict=True) if b]

    def one_chunk(moving: list[Array]) -> Any:
        rest = iter(moving)
        return whole(*(next(rest) if b else x for x, b in zip(leaves, batched, strict=True)))

    count, left = divmod(len(moving[0]), chunk)
    parts = [x[: count * chunk].reshape(count, chunk, *x.shape[1:]) for x in moving]
    out = jax.lax.map(one_chunk, parts)
    out = jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), out)
    if left:
        end = one_chunk([x[-left:] for x in moving])
        out = jax.tree.map(lambda x, y: jnp.concatenate([x, y]), out, end)
    return out


def total(x: Float[Array, "..."], axis: int) -> Float[Array, "..."]:
    """The sum over a short axis that is not the batch's, computed once and not again in every operation that reads it.

    As a reduction, but for a CPU with a newer jax: seen with 0.12, though not yet with 0.9, XLA fuses short reductions
    into loops over single samples, some twenty times as slow. There it is spelt out, behind a barrier, since what is
    spelt out would be computed again.
    """
    if jax.default_backend() != "cpu" or jax.__version_info__ < (0, 10):
        return jnp.sum(x, axis)
    parts = (jax.lax.index_in_dim(x, k, axis, keepdims=False) for k in range(x.shape[axis]))
    return jax.lax.optimization_barrier(sum(parts))


# Lists of 3-vectors (n, 3, *b) and of 3×3 matrices (n, 3, 3, *b). Sums over components are no products of matrices: XLA
# would take each of those for a tiny one of its own.

# Unsigned: JAX 0.9 could not make signed ones positive in `enable_x64` after other work in single precision.
_NEXT, _AFTER = np.array([1, 2, 0], np.uint8), np.array([2, 0, 1], np.uint8)


def cross(
    a: Float[Array | np.ndarray, "n 3 ..."], b: Float[Array | np.ndarray, "n 3 ..."]
) -> Float[Array | np.ndarray, "n 3 ..."]:
    """a × b, of JAX or of NumPy."""
    return a[:, _NEXT] * b[:, _AFTER] - a[:, _AFTER] * b[:, _NEXT]


def turn(m: Float[Array, "n 3 3 ..."], x: Float[Array, "n 3 ..."]) -> Float[Array, "n 3 ..."]:
    """m x."""
    return total(m * x[:, None], 2)


def turn_back(m: Float[Array, "n 3 3 ..."], x: Float[Array, "n 3 ..."]) -> Float[Array, "n 3 ..."]:
    """mᵀ x."""
    return total(m * x[:, :, None], 1)


def compose(
    a: Float[Array, "n i 3 ..."], b: Float[Array, "n 3 k ..."]
) -> Float[Array, "n i k ..."]:
    """a b."""
    return total(a[:, :, :, None] * b[:, None], 2)


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
