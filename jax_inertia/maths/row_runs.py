"""A few rows of an array, taken out and put back by runs of consecutive ones: no gather, no scatter."""

import jax.numpy as jnp
from jaxtyping import Array, Shaped


def take_rows(x: Shaped[Array, "n ..."], rows: tuple[int, ...]) -> Shaped[Array, "k ..."]:
    """These ascending rows of x, by runs: of what `spread_rows` put together nothing is left but the rows."""
    parts = [x[first:last] for first, last in _runs(rows)]
    return parts[0] if len(parts) == 1 else jnp.concatenate([x[:0], *parts])


def spread_rows(
    x: Shaped[Array, "k ..."], rows: tuple[int, ...], count: int
) -> Shaped[Array, "n ..."]:
    """`count` rows, zero but for these ascending ones."""
    parts, taken, done = [], 0, 0
    for first, last in _runs(rows):
        parts += [jnp.zeros((first - done, *x.shape[1:]), x.dtype), x[taken : taken + last - first]]
        taken, done = taken + last - first, last
    parts.append(jnp.zeros((count - done, *x.shape[1:]), x.dtype))
    parts = [part for part in parts if len(part)] or [x]
    return parts[0] if len(parts) == 1 else jnp.concatenate(parts)


def _runs(rows: tuple[int, ...]) -> list[tuple[int, int]]:
    """First and one past the last of each run of consecutive numbers."""
    starts = [i for i in rows if i - 1 not in rows]
    return [(i, next(j for j in range(i, rows[-1] + 2) if j not in rows)) for i in starts]
