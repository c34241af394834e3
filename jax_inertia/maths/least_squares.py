"""The paper's batch estimator (eq. stacked, eq. least-squares), and what its data can and cannot determine.

    min over π of ½ ‖f − Y π‖²_W

The regressor of a robot is rank-deficient twice over, by structure and by the motion. The solution with the smallest
norm (in scaled columns) is given, and `Identifiability` says which parameters it means anything for.
"""

from collections.abc import Sequence

import equinox as eqx
import numpy as np
import scipy.linalg
from jaxtyping import Bool, Float


class Identifiability(eqx.Module):
    """Rank and null space of a regressor, column by column."""

    names: tuple[str, ...] = eqx.field(static=True)
    rank: int = eqx.field(static=True)
    condition: float = eqx.field(static=True)
    """Ratio of the largest to the smallest singular value within the rank, columns scaled to one."""
    null_space: Float[np.ndarray, "p k"]
    """Orthonormal basis of what the data cannot see, in units of the column scales."""
    determined: Bool[np.ndarray, " p"]
    """Parameters that no null direction touches: the data alone fixes them."""
    invisible: Bool[np.ndarray, " p"]
    """Parameters that never moved the measurement at all."""
    combinations: tuple[str, ...] = eqx.field(static=True)
    """The independent combinations that are determined, e.g. 'link2.m + 3.1 link3.hx'."""

    def __repr__(self) -> str:
        seen, alone = len(self.names) - int(self.invisible.sum()), int(self.determined.sum())
        return (
            f"Identifiability(rank {self.rank} of {len(self.names)}; {alone} determined alone, "
            f"{seen - alone} only in combination, {int(self.invisible.sum())} invisible)"
        )


class LinearFit(eqx.Module):
    """Solution of the weighted least-squares problem."""

    value: Float[np.ndarray, " p"]
    covariance: Float[np.ndarray, "p p"]
    """Of the determined part, for unit-variance weighted noise; infinite uncertainty lies in the null space."""
    cost: float = eqx.field(static=True)
    """½ ‖f − Y π‖²_W at the solution."""
    identifiability: Identifiability


def weighted_least_squares(
    regressor: Float[np.ndarray, "rows p"],
    measurement: Float[np.ndarray, " rows"],
    weight: Float[np.ndarray, " rows"] | float = 1.0,
    *,
    names: Sequence[str] | None = None,
    tolerance: float = 1e-8,
) -> LinearFit:
    """Weighted least squares with a rank report (Foster et al., eq. least-squares); W = diag(`weight`).

    Rows with weight zero are left out. Raises ValueError for shapes that do not fit together, non-finite rows, and
    weights that are negative or not finite.

    >>> import numpy as np
    >>> from jax_inertia.maths.least_squares import weighted_least_squares
    >>> both = np.array([[1.0, 1.0], [2.0, 2.0]])  # only their sum shows
    >>> fit = weighted_least_squares(both, np.array([3.0, 6.0]), names=["a", "b"])
    >>> fit.identifiability.rank, fit.identifiability.combinations
    (1, ('a +1 b',))
    """
    y, f, w = _rows(regressor, measurement, weight)
    names = tuple(f"x{i}" for i in range(y.shape[1])) if names is None else tuple(names)
    if len(names) != y.shape[1]:
        raise ValueError(f"{len(names)} names for {y.shape[1]} columns of the regressor")
    keep = w > 0
    if not (np.isfinite(y[keep]).all() and np.isfinite(f[keep]).all()):
        raise ValueError("a row is not finite; give it weight 0")
    root = np.sqrt(w[keep])
    p = y.shape[1]
    # QR first: the singular values of a long regressor are those of its small triangular factor.
    stacked = np.column_stack([y[keep] * root[:, None], f[keep] * root])
    r = np.asarray(np.linalg.qr(stacked, mode="r"))
    if r.shape[0] < p + 1:
        r = np.vstack([r, np.zeros((p + 1 - r.shape[0], p + 1))])
    scale = np.linalg.norm(r[:p, :p], axis=0)
    invisible = scale <= tolerance * max(scale.max(initial=0.0), 1e-300)
    scale = np.where(invisible, 1.0, scale)
    scaled = np.where(invisible, 0.0, r[:p, :p] / scale)
    u, s, vt = np.linalg.svd(scaled)
    rank = int(np.sum(s > tolerance * max(s[0], 1e-300))) if p else 0
    inverse = vt[:rank].T / s[:rank]
    value = inverse @ (u[:, :rank].T @ r[:p, p]) / scale
    root_covariance = inverse / scale[:, None]
    null = vt[rank:].T
    cost = 0.5 * float(np.sum((r[:, p] - r[:, :p] @ value) ** 2))
    report = Identifiability(
        names=names,
        rank=rank,
        condition=float(s[0] / s[rank - 1]) if rank else np.inf,
        null_space=null,
        determined=np.linalg.norm(null, axis=1) < 1e-6,
        invisible=invisible,
        combinations=tuple(combinations(scaled, 1.0 / scale, rank, names)),
    )
    return LinearFit(value, root_covariance @ root_covariance.T, cost, report)


def _rows(
    regressor: Float[np.ndarray, "rows p"],
    measurement: Float[np.ndarray, " rows"],
    weight: Float[np.ndarray, " rows"] | float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The three as arrays whose rows belong together, one weight for each; ValueError where they do not."""
    y, f, w = (np.asarray(x, float) for x in (regressor, measurement, weight))
    if y.ndim != 2:
        raise ValueError(f"regressor has shape {y.shape}; expected (rows, parameters)")
    if f.shape != y.shape[:1]:
        raise ValueError(f"measurement has shape {f.shape}; the regressor has {len(y)} rows")
    if w.shape not in ((), f.shape):
        raise ValueError(
            f"weight has shape {w.shape}; expected one number, or one for each of {len(f)} rows"
        )
    if not np.isfinite(w).all() or np.any(w < 0):
        raise ValueError("a weight is negative or not finite; weights are inverse variances")
    return y, f, np.broadcast_to(w, f.shape)


def combinations(
    scaled: Float[np.ndarray, "rows p"],
    unit: Float[np.ndarray, " p"],
    rank: int,
    names: Sequence[str],
    *,
    least: float = 1e-6,
) -> dict[str, Float[np.ndarray, " p"]]:
    """Base parameters by pivoted QR (Gautier 1991): each independent column with what is regrouped into it.

    Text such as 'b.hz +0.31 b.m', and its coefficients. Column k of `scaled` is that of parameter k in units of
    `unit`; of what is regrouped, terms below `least` of those units are left out.

    >>> import numpy as np
    >>> from jax_inertia.maths.least_squares import combinations
    >>> list(combinations(np.array([[1.0, 2.0]]), np.ones(2), 1, ["a", "b"]))
    ['b +0.5 a']
    """
    if rank == 0:
        return {}
    r, order = (np.asarray(x) for x in scipy.linalg.qr(scaled, mode="r", pivoting=True))
    regroup = scipy.linalg.solve_triangular(r[:rank, :rank], r[:rank, rank:])
    out = {}
    for i in range(rank):
        base = int(order[i])
        text, weight = [names[base]], np.zeros(len(names))
        weight[base] = 1.0
        for k in np.argsort(-np.abs(regroup[i])):
            if abs(regroup[i, k]) > least:
                other = int(order[rank + k])
                weight[other] = regroup[i, k] * unit[base] / unit[other]
                text.append(f"{weight[other]:+.4g} {names[other]}")
        out[" ".join(text)] = weight
    return out
