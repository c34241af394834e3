"""The square-root update of a fleet of filters as one GPU kernel, in which factors never leave the registers.

XLA sends every small factorisation through memory: some 100 kB a filter and sample, where 6 kB are needed.
"""

from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
from jax.custom_batching import custom_vmap
from jaxtyping import Array, Float

from jax_inertia.maths.kalman_forms import Correction, SquareRoot, T, cholesky
from jax_inertia.maths.lanes import LANES, available, in_lanes, lane_kernel
from jax_inertia.maths.precision import in_full_precision

MAX_STATES = 24
"""More do not fit into the registers."""


class FusedSquareRoot(SquareRoot):
    """`kalman.SquareRoot` for a fleet: what `vmap` batches on a GPU are a few kernels, one filter a thread.

    The update takes the rows one after the other by the triangular update of Carlson (1973, "Fast triangular
    formulation of the square root filter", AIAA Journal 11): P⁺ = L Lᵀ stays positive, as with the QR factorisation.
    What comes before and after it goes through `lanes.in_lanes`. On other devices, unbatched, or with more than 24
    states it is `SquareRoot` itself. A batch over several devices has to be split by `jax.shard_map` with
    `check_vma=False`: XLA does not split a kernel. To differentiate through a filter, take `SquareRoot`.
    """

    def fused(self, function: Callable[..., T]) -> Callable[..., T]:
        return in_lanes(function)

    def kept(self, function: Callable[[], T]) -> Callable[[], T]:
        return function

    @in_full_precision
    def correct(
        self, p: Float[Array, "n n"], h: Float[Array, "m n"], nu: Float[Array, " m"]
    ) -> Correction:
        if len(p) > MAX_STATES:
            return super().correct(p, h, nu)
        step, covariance, nis, log_det = _correct(p, h, nu)
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
    plain = jax.vmap(_plain)
    if axis_size < LANES or p.dtype != jnp.float32 or not available():
        return plain(*args), (True,) * 4
    return jax.lax.platform_dependent(*args, cuda=kernel, default=plain), (True,) * 4


def kernel(
    p: Float[Array, "robots n n"],
    h: Float[Array, "robots m n"],
    nu: Float[Array, "robots m"],
) -> tuple[Array, Array, Array, Array]:
    """K ν, P⁺, νᵀ S⁻¹ ν and log det S of at least 128 filters."""
    _, m, n = h.shape
    last = [jnp.moveaxis(x, 0, -1) for x in (p, h, nu)]
    out = lane_kernel("square_root_update", partial(body, n, m), [(n,), (n, n), (), ()], last)
    step, covariance, nis, log_det = (jnp.moveaxis(x, -1, 0) for x in out)
    return step, covariance, nis, log_det


def body(
    n: int,
    m: int,
    p: Callable,
    h: Callable,
    nu: Callable,
    step_out: Callable,
    p_out: Callable,
    nis_out: Callable,
    log_det_out: Callable,
) -> None:
    """One filter's update, entry by entry (see `maths.lanes`): `columns[j][i - j]` is L_ij."""
    margin = float(jnp.finfo(jnp.float32).eps)
    columns: list[list[Array]] = []
    for j in range(n):
        """Column j of `kalman.cholesky`, from the left."""
        new = [p(j, i) for i in range(j, n)]
        new[0] = new[0] * (1.0 + 8.0 * margin)
        for k, other in enumerate(columns):
            own = other[j - k]
            new = [x - other[j - k + i] * own for i, x in enumerate(new)]
        scale = jax.lax.rsqrt(new[0])
        columns.append([x * scale for x in new])

    def absorbed(row: Array, carry: tuple) -> tuple:
        """Row of H with unit noise: Carlson's recursion from the last column; `gain` is K s, s = 1 + |Lᵀ h|²."""
        columns, step, nis, log_det = carry
        own = [h(row, i) for i in range(n)]
        left = nu(row) - _dot(own, step)
        f = [_dot(own[j:], column) for j, column in enumerate(columns)]
        new, gain = list(columns), [0.0] * n
        s = root = 1.0
        for j in reversed(range(n)):
            more = s + f[j] * f[j]
            root_more = jax.lax.rsqrt(more)
            both = root * root_more
            keep, less = s * both, f[j] * both
            new[j] = [x * keep - gain[j + i] * less for i, x in enumerate(columns[j])]
            for i, x in enumerate(columns[j]):
                gain[j + i] = gain[j + i] + x * f[j]
            s, root = more, root_more
        share = left / s
        step = [x + g * share for x, g in zip(step, gain, strict=True)]
        return new, step, nis + left * share, log_det + jnp.log(s)

    zero = 0.0 * columns[0][0]
    start = (columns, [zero] * n, zero, zero)
    columns, step, nis, log_det = jax.lax.fori_loop(0, m, absorbed, start)
    for i in range(n):
        for j in range(i + 1):
            """Entry of L Lᵀ, kept positive as by `kalman.positive`."""
            new = _dot(
                [columns[k][i - k] for k in range(j + 1)], [columns[k][j - k] for k in range(j + 1)]
            )
            if i == j:
                new = new * (1.0 + n * margin) + float(jnp.finfo(jnp.float32).tiny) ** 0.5
            else:
                p_out(new, j, i)
            p_out(new, i, j)
        step_out(step[i], i)
    nis_out(nis)
    log_det_out(log_det)


def _dot(a: list[Array], b: list[Array]) -> Array:
    out = a[0] * b[0]
    for x, y in zip(a[1:], b[1:], strict=True):
        out = out + x * y
    return out
