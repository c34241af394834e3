"""Least squares of a body's inertial parameters that stays physical: a semidefinite program with a log-det prior.

    min_z  ½ zᵀ Q z − rᵀ z + γ [tr(P₀⁻¹ P) − ln det P],    P = P(π₀ + S z) ≻ 0

P is the body's pseudo-inertia, linear in π (Wensing, Kim & Slotine, RA-L 3(1), 2018), P₀ the one it is known by
beforehand; the bracket, less a constant, is the Bregman divergence of −ln det (Lee, Wensing & Park, T-RO 36(1), 2020).
It is self-concordant: Newton's method with a line search that stays inside needs no other solver. Nothing here imports
the package under test.
"""

import numpy as np
from jaxtyping import Float

CLOSE = 1e-6
"""Nats that one more step would gain, at which the minimum is reached."""
MOST = 500
"""Steps of Newton's method; some tens are usual."""


def pseudo_inertia(pi: Float[np.ndarray, "10"]) -> Float[np.ndarray, "4 4"]:
    """P of π = [m, m c, I_xx, I_xy, I_xz, I_yy, I_yz, I_zz] about the body's origin."""
    m, h, (xx, xy, xz, yy, yz, zz) = pi[0], pi[1:4], pi[4:]
    whole = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    second = 0.5 * np.trace(whole) * np.eye(3) - whole
    return np.block([[second, h[:, None]], [h[None], np.array([[m]])]])


def _start(inner, right, p0, each) -> np.ndarray:
    """The least squares solution with its pseudo-inertia moved inside: far from there Newton's steps are short."""
    ridge = inner + 1e-6 * np.eye(len(right))
    z = np.linalg.solve(ridge, right)
    values, axes = np.linalg.eigh(p0 + np.tensordot(z[:10], each, 1))
    values = np.maximum(values, np.linalg.eigvalsh(p0))
    wanted = (axes * values) @ axes.T - p0
    z[:10] = np.linalg.lstsq(each.reshape(10, 16).T, wanted.ravel(), rcond=None)[0]
    z[10:] = np.linalg.solve(ridge[10:, 10:], right[10:] - inner[10:, :10] @ z[:10])
    return z


def solved(
    inner: Float[np.ndarray, "n n"],
    right: Float[np.ndarray, " n"],
    own: Float[np.ndarray, "10"],
    scale: Float[np.ndarray, "10"],
    weight: float = 1.0,
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n n"]]:
    """(z, inverse of the Hessian there) of Q z = r with the prior; the first ten of z are (π − π₀) / S."""
    p0 = pseudo_inertia(own)
    each = np.array([pseudo_inertia(scale[k] * np.eye(10)[k]) for k in range(10)])
    known = np.einsum("ij,kji->k", np.linalg.inv(p0), each)
    z = _start(inner, right, p0, each)

    def value(z) -> float:
        sign, logdet = np.linalg.slogdet(p0 + np.tensordot(z[:10], each, 1))
        inside = sign > 0 and np.linalg.eigvalsh(p0 + np.tensordot(z[:10], each, 1))[0] > 0
        quadratic = 0.5 * z @ inner @ z - right @ z
        return quadratic + weight * (known @ z[:10] - logdet) if inside else np.inf

    fall = np.inf
    for _ in range(MOST):
        turned = np.linalg.solve(p0 + np.tensordot(z[:10], each, 1), each)
        gradient, hessian = inner @ z - right, inner.copy()
        gradient[:10] += weight * (known - np.einsum("kii->k", turned))
        hessian[:10, :10] += weight * np.einsum("kij,lji->kl", turned, turned)
        step = -np.linalg.solve(hessian, gradient)
        fall = -gradient @ step
        if fall < CLOSE:
            return z, np.linalg.inv(hessian)
        length, now = 1.0, value(z)
        while value(z + length * step) > now - 0.25 * length * fall and length > 1e-12:
            length *= 0.5
        z = z + length * step
    raise RuntimeError(f"no minimum after {MOST} steps: the last one would gain {fall:.2g}")
