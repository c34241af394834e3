"""The square-root update of a fleet of filters as one GPU kernel, in which factors never leave the registers.

XLA sends every small factorisation through memory: some 100 kB a filter and sample, where 6 kB are needed.
"""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_batching import custom_vmap
from jax.experimental import pallas as pl
from jax.experimental.pallas import triton
from jaxtyping import Array, Float

from jax_inertia.dynamics.sparse_rows import moved_rows as moved_rows
from jax_inertia.dynamics.sparse_rows import take_rows
from jax_inertia.maths.kalman import Correction, SquareRoot, cholesky
from jax_inertia.maths.precision import in_full_precision

MAX_STATES = 24
"""More do not fit into the registers."""
WIDTH, WARPS = 8, 1
"""Filters to a program; the rows of their matrices are dealt among four lanes: two shuffles to a sum, no barrier."""
BLOCK = 5
"""Columns that a loop of the factorisation goes over; fewer are less work and more code."""


class FusedSquareRoot(SquareRoot):
    """`kalman.SquareRoot`, done by one kernel (Pallas) where `vmap` batches it on a GPU.

    The rows are taken one after the other by the triangular update of Carlson (1973, "Fast triangular formulation of
    the square root filter", AIAA Journal 11): P⁺ = L Lᵀ stays positive, as with the QR factorisation. On other
    devices, unbatched, or with more than 24 states it is `SquareRoot` itself. A batch over several devices has to be
    split by `jax.shard_map`: XLA does not split a kernel. To differentiate through a filter, take `SquareRoot`.

    `rows` are those of H that may differ from zero, ascending (None: all), the `moved_rows` of the estimated bodies;
    the others count in `nis` alone. Whitening must not mix rows then: independent noise.
    """

    rows: tuple[int, ...] | None = eqx.field(static=True, default=None)

    @property
    def leaves_rows_out(self) -> bool:
        return self.rows is not None

    @in_full_precision
    def correct(
        self, p: Float[Array, "n n"], h: Float[Array, "m n"], nu: Float[Array, " m"]
    ) -> Correction:
        if len(p) > MAX_STATES:
            return super().correct(p, h, nu)
        rows = tuple(range(len(nu))) if self.rows is None else self.rows
        rest = np.setdiff1d(np.arange(len(nu)), rows)
        step, covariance, nis, log_det = _correct(p, take_rows(h, rows), take_rows(nu, rows))
        nis = nis + jnp.sum(nu[rest] ** 2)
        return Correction(step, covariance, nis, log_det, h @ cholesky(p))


def _plain(p: Array, h: Array, nu: Array) -> tuple[Array, Array, Array, Array]:
    out = SquareRoot().correct(p, h, nu)
    return out.step, out.covariance, out.nis, out.log_det


_correct = custom_vmap(_plain)


@_correct.def_vmap
def _batched(axis_size: int, batched: list[bool], p: Array, h: Array, nu: Array):
    args = [
        x if on else jnp.broadcast_to(x, (axis_size, *x.shape))
        for x, on in zip((p, h, nu), batched, strict=True)
    ]
    out = jax.lax.platform_dependent(*args, cuda=kernel, default=jax.vmap(_plain))
    return out, (True,) * 4


def kernel(
    p: Float[Array, "robots n n"],
    h: Float[Array, "robots m n"],
    nu: Float[Array, "robots m"],
    *,
    interpret: bool = False,
) -> tuple[Array, Array, Array, Array]:
    """K ν, P⁺, νᵀ S⁻¹ ν and log det S of every filter; `interpret` runs it without a GPU, slowly."""
    robots, _, n = h.shape

    def last(x: Array) -> Array:
        return jnp.moveaxis(x, 0, -1)

    inputs = last(p), last(h), last(nu)
    shapes = (n, robots), (n, n, robots), (robots,), (robots,)
    step, covariance, nis, log_det = pl.pallas_call(
        partial(_program, n),
        grid=(-(-robots // WIDTH),),
        out_shape=[jax.ShapeDtypeStruct(s, p.dtype) for s in shapes],
        interpret=interpret,
        compiler_params=triton.CompilerParams(num_warps=WARPS, num_stages=1),
    )(*inputs)
    return step.T, jnp.moveaxis(covariance, -1, 0), nis, log_det


def _program(n: int, p_ref, h_ref, nu_ref, step_ref, p_out, nis_ref, log_det_ref) -> None:
    """WIDTH filters: matrices are lists of columns, a column has a row for each state and a lane for each filter."""
    robots, dtype = nu_ref.shape[1], p_ref.dtype
    height = 1 << (n - 1).bit_length()  # Triton's tensors have powers of two
    lane = pl.program_id(0) * WIDTH + jnp.arange(WIDTH)
    # Lanes beyond the last filter and rows beyond the last state do its work again, and write the same.
    lane = jnp.minimum(lane, robots - 1)
    level = jnp.minimum(jnp.arange(height), n - 1)
    row = jax.lax.broadcasted_iota(jnp.int32, (height, WIDTH), 0)
    state = jnp.minimum(row, n - 1)
    one, zero = jnp.ones(WIDTH, dtype), jnp.zeros((height, WIDTH), dtype)
    margin = float(jnp.finfo(dtype).eps)

    def column_of(ref, j) -> Array:
        return triton.load(ref.at[j, level[:, None], lane[None, :]])

    def entry(column: Array, i) -> Array:
        return jnp.sum(jnp.where(row == i, column, 0.0), axis=0)

    def factored(j, columns):
        """Column j of `kalman.cholesky`, from the left."""
        new = column_of(p_ref, j)
        new = jnp.where(state == j, new * (1.0 + 8.0 * margin), new)
        for other in columns:
            new = new - other * entry(other, j)[None]
        new = jnp.where(row >= j, new * jax.lax.rsqrt(entry(new, j))[None], 0.0)
        return [jnp.where(j == i, new, other) for i, other in enumerate(columns)]

    def absorbed(i, carry):
        """Row i of H with unit noise: Carlson's recursion from the last column; `gain` is K s, s = 1 + |Lᵀ h|²."""
        columns, step, nis, log_det = carry
        h: Array = jnp.where(row < n, column_of(h_ref, i), 0.0)
        left = triton.load(nu_ref.at[i, lane]) - jnp.sum(h * step, axis=0)
        new, gain, s, root = list(columns), zero, one, one
        for j in reversed(range(n)):
            f = jnp.sum(columns[j] * h, axis=0)
            more = s + f * f
            root_more = jax.lax.rsqrt(more)
            both = root * root_more
            new[j] = columns[j] * (s * both)[None] - gain * (f * both)[None]
            gain = gain + columns[j] * f[None]
            s, root = more, root_more
        share = left / s
        return new, step + gain * share[None], nis + left * share, log_det + jnp.log(s)

    def multiplied(columns, j, _):
        """Column j of L Lᵀ, kept positive as by `kalman.positive`."""
        new: Array = zero
        for column in columns:
            new = new + column * entry(column, j)[None]
        more = new * (1.0 + n * margin) + float(jnp.finfo(dtype).tiny) ** 0.5
        at = p_out.at[j, level[:, None], lane[None, :]]
        triton.store(at, jnp.asarray(jnp.where(state == j, more, new)))

    # By blocks: of column j only the j before it count, and zeros cost as much as numbers.
    blocks = [(first, min(first + BLOCK, n)) for first in range(0, n, BLOCK)]
    columns: list[Array] = []
    for first, last in blocks:
        columns = jax.lax.fori_loop(first, last, factored, columns + [zero] * (last - first))
    start = (columns, zero, 0.0 * one, 0.0 * one)
    columns, step, nis, log_det = jax.lax.fori_loop(0, h_ref.shape[0], absorbed, start)
    for first, last in blocks:
        jax.lax.fori_loop(first, last, partial(multiplied, columns[:last]), None)
    triton.store(step_ref.at[level[:, None], lane[None, :]], step)
    triton.store(nis_ref.at[lane], nis)
    triton.store(log_det_ref.at[lane], log_det)
