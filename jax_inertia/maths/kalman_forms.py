"""Forms of the Kalman update: one correction, computed in ways that differ in what rounding does to it.

`Standard` is the paper's text (Foster et al., eq. update); `SquareRoot` (the default in float32) computes the same
through a QR factorisation, so that the covariance stays symmetric positive, and `Information` (the default in float64)
through a Cholesky factorisation, which is faster. `Elementary` calls no library, for programs that are exported.
"""

import abc
from collections.abc import Callable
from typing import NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.scipy.linalg import cho_solve, solve_triangular
from jaxtyping import Array, Float

from jax_inertia.maths.precision import in_full_precision

T = TypeVar("T")


class Correction(NamedTuple):
    """What a form makes of whitened rows, for S = H P Hᵀ + 1."""

    step: Float[Array, " n"]
    """K ν."""
    covariance: Float[Array, "n n"]
    """P⁺."""
    nis: Float[Array, ""]
    """νᵀ S⁻¹ ν."""
    log_det: Float[Array, ""]
    """log det S."""
    rows: Float[Array, "m n"]
    """H L with P = L Lᵀ, so that S = H L (H L)ᵀ + 1."""


class Form(eqx.Module):
    """How gain and posterior covariance are computed from whitened rows (unit noise)."""

    def fused(self, function: Callable[..., T]) -> Callable[..., T]:
        """The same function, as one kernel where the form is for many filters on a GPU."""
        return function

    def kept(self, function: Callable[[], T]) -> Callable[[], T]:
        """What is needed more than once, as it was computed the first time; or computed each time, where that is less
        work for a kernel than to read it from memory.
        """
        value = function()
        return lambda: value

    def cholesky(self, p: Float[Array, "n n"]) -> Float[Array, "n n"]:
        """L of P = L Lᵀ, as `cholesky` does."""
        return cholesky(p)

    def solve(self, lower: Float[Array, "n n"], b: Float[Array, "n *k"]) -> Float[Array, "n *k"]:
        """L⁻¹ b."""
        return solve_triangular(lower, b, lower=True)

    @abc.abstractmethod
    def correct(
        self, p: Float[Array, "n n"], h: Float[Array, "m n"], nu: Float[Array, " m"]
    ) -> Correction:
        """The correction of covariance `p` by rows `h` with innovation `nu`."""


class Standard(Form):
    """The paper's text: K = P Hᵀ S⁻¹, P⁺ = (1 − K H) P (eq. update). Loses symmetry and sign in float32."""

    @in_full_precision
    def correct(
        self, p: Float[Array, "n n"], h: Float[Array, "m n"], nu: Float[Array, " m"]
    ) -> Correction:
        ph = p @ h.T
        s = h @ ph + jnp.eye(len(nu), dtype=p.dtype)
        factor = jnp.linalg.cholesky(s)
        gain = cho_solve((factor, True), ph.T).T
        return Correction(
            step=gain @ nu,
            covariance=p - gain @ ph.T,
            nis=nu @ cho_solve((factor, True), nu),
            log_det=2.0 * jnp.sum(jnp.log(jnp.diagonal(factor))),
            rows=h @ cholesky(p),
        )


class SquareRoot(Form):
    """The same from one QR factorisation; P⁺ is positive by construction.

    With P = L Lᵀ, QR of [[H L, ν], [1, 0]] gives R, u and ρ in [[R, u], [0, ρ]]: RᵀR = 1 + (H L)ᵀ H L without
    squaring the condition number, P⁺ = L (RᵀR)⁻¹ Lᵀ, K ν = L R⁻¹ u, and νᵀ S⁻¹ ν = ρ², the least-squares cost at
    its minimum, where Woodbury's formula would subtract.
    """

    @in_full_precision
    def correct(
        self, p: Float[Array, "n n"], h: Float[Array, "m n"], nu: Float[Array, " m"]
    ) -> Correction:
        n = len(p)
        factor = cholesky(p)
        rows = h @ factor
        below = jnp.eye(n, n + 1, dtype=p.dtype)
        stacked = jnp.concatenate([jnp.concatenate([rows, nu[:, None]], axis=1), below])
        r = jnp.asarray(jnp.linalg.qr(stacked, mode="r"))
        root = solve_triangular(r[:n, :n], factor.T, trans=1, lower=False)
        return Correction(
            step=r[:n, n] @ root,
            covariance=positive(root.T @ root),
            nis=r[n, n] ** 2,
            log_det=2.0 * jnp.sum(jnp.log(jnp.abs(jnp.diagonal(r)[:n]))),
            rows=rows,
        )


class Elementary(Form):
    """The same by sums, products and roots alone, without a call of LAPACK: for programs that are exported.

    The rows one after the other by the triangular update of Carlson (1973, "Fast triangular formulation of the square
    root filter", AIAA Journal 11), with f = Lᵀ h, s_j = 1 + Σ_{k ≥ j} f_k² and columns L_k:

        L_j ← L_j √(s_{j+1}/s_j) − (Σ_{k > j} L_k f_k) f_j / √(s_j s_{j+1}).
    """

    def cholesky(self, p: Float[Array, "n n"]) -> Float[Array, "n n"]:
        scale, unit = _unit_diagonal(p)
        rows = jnp.arange(len(p))
        columns: list[Array] = []
        for j in range(len(p)):
            column = unit[:, j]
            for other in columns:
                column = column - other * other[j]
            columns.append(jnp.where(rows >= j, column / jnp.sqrt(column[j]), 0.0))
        return scale[:, None] * jnp.stack(columns, axis=1)

    def solve(self, lower: Float[Array, "n n"], b: Float[Array, "n *k"]) -> Float[Array, "n *k"]:
        found: list[Array] = []
        for i, row in enumerate(lower):
            left = b[i]
            for k, x in enumerate(found):
                left = left - row[k] * x
            found.append(left / row[i])
        return jnp.stack(found)

    @in_full_precision
    def correct(
        self, p: Float[Array, "n n"], h: Float[Array, "m n"], nu: Float[Array, " m"]
    ) -> Correction:
        n = len(p)
        factor = self.cholesky(p)
        later = jnp.tril(jnp.ones((n, n), p.dtype), -1)
        """Of x @ later, entry j is the sum of x_k over k > j."""

        def absorbed(carry: tuple, row: tuple) -> tuple[tuple, None]:
            lower, step, nis, log_det = carry
            one, measured = row
            f = one @ lower
            after = 1.0 + f**2 @ later
            s = after + f**2
            left = (measured - one @ step) / s[0]
            spread = lower * f
            lower = lower * jnp.sqrt(after / s) - (spread @ later) * (f / jnp.sqrt(s * after))
            step = step + jnp.sum(spread, axis=1) * left
            return (lower, step, nis + s[0] * left**2, log_det + jnp.log(s[0])), None

        zero = jnp.zeros((), p.dtype)
        start = (factor, jnp.zeros(n, p.dtype), zero, zero)
        (lower, step, nis, log_det), _ = jax.lax.scan(absorbed, start, (h, nu))
        return Correction(step, positive(lower @ lower.T), nis, log_det, h @ factor)


class Information(Form):
    """The same from the Cholesky factor of 1 + (H L)ᵀ H L: a third cheaper, for float64.

    Squares the condition number: what a sharp measurement says of a wide prior is right to ε (σ prior/σ after)².
    """

    @in_full_precision
    def correct(
        self, p: Float[Array, "n n"], h: Float[Array, "m n"], nu: Float[Array, " m"]
    ) -> Correction:
        return _by_information(p, h, nu)


@jax.custom_jvp
def _by_information(
    p: Float[Array, "n n"], h: Float[Array, "m n"], nu: Float[Array, " m"]
) -> Correction:
    """`Information.correct`."""
    n = len(p)
    factor = cholesky(p)
    rows = h @ factor
    lower = jnp.linalg.cholesky(rows.T @ rows + jnp.eye(n, dtype=p.dtype))
    right = jnp.concatenate([(rows.T @ nu)[:, None], factor.T], axis=1)
    solved = solve_triangular(lower, right, lower=True)
    u, root = solved[:, 0], solved[:, 1:]
    return Correction(
        step=u @ root,
        covariance=positive(root.T @ root),
        nis=jnp.maximum(nu @ nu - u @ u, 0.0),
        log_det=2.0 * jnp.sum(jnp.log(jnp.diagonal(lower))),
        rows=rows,
    )


@_by_information.defjvp
def _along(primals: tuple, tangents: tuple) -> tuple[Correction, Correction]:
    """With the derivative of `SquareRoot`: that of a Cholesky factor divides by its pivots once more, and where the
    condition number squared has passed 1/ε it is noise, or NaN.
    """
    _, change = jax.jvp(SquareRoot().correct, primals, tangents)
    return _by_information(*primals), change


def default_form(dtype: jnp.dtype) -> Form:
    """`Information` where float64 leaves digits to square the condition number, `SquareRoot` elsewhere.

    >>> import jax.numpy as jnp
    >>> from jax_inertia.maths.kalman_forms import default_form
    >>> default_form(jnp.dtype("float32"))
    SquareRoot()
    """
    return Information() if jnp.finfo(dtype).bits >= 64 else SquareRoot()


def positive(p: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """p as it can be stored: symmetric to the last bit, and positive in spite of rounding and underflow.

    A Gram matrix rounded entry by entry is indefinite by up to n ε of its diagonal, so that much is added there,
    and so little that its own square would vanish.

    >>> import jax.numpy as jnp
    >>> from jax_inertia.maths.kalman_forms import positive
    >>> singular = jnp.ones((2, 2))  # what rounding leaves of it need not have a root
    >>> bool(jnp.isfinite(jnp.linalg.cholesky(positive(singular))).all())
    True
    """
    info = jnp.finfo(p.dtype)
    margin = len(p) * info.eps * jnp.diagonal(p) + info.tiny**0.5
    return 0.5 * (p + p.T) + jnp.diag(margin)


def cholesky(p: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """Cholesky factor after scaling the diagonal to one; a little is added there for a prior that is singular.

    >>> import jax.numpy as jnp
    >>> from jax_inertia.maths.kalman_forms import cholesky
    >>> cholesky(4.0 * jnp.eye(2))
    Array([[2., 0.],
           [0., 2.]], dtype=float64)
    """
    scale, unit = _unit_diagonal(p)
    return scale[:, None] * jnp.linalg.cholesky(unit)


def _unit_diagonal(p: Float[Array, "n n"]) -> tuple[Float[Array, " n"], Float[Array, "n n"]]:
    """Standard deviations, and the correlations with what keeps them positive in spite of rounding."""
    diagonal: Array = jnp.diagonal(p)
    scale = jnp.sqrt(jnp.where(diagonal > 0, diagonal, 1.0))
    jitter = 8.0 * jnp.finfo(p.dtype).eps
    return scale, p / (scale[:, None] * scale[None, :]) + jitter * jnp.eye(len(p), dtype=p.dtype)
