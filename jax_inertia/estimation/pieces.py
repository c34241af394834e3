"""A log in pieces of two seconds, each with bodies of its own: linear rows, ridge regression, evidence.

A load taken up in the middle of a log is in the residual of any fit to the whole of it; most pieces do not see it.
"""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy.stats
from jaxtyping import Bool, Float

from jax_inertia.estimation.batch_rows import correlation_inflation
from jax_inertia.estimation.joint_terms import JointTerms, columns
from jax_inertia.signals.holds import Holds, without_friction

_SECONDS = 2.0
CHANGED = 5.0
"""A constant body leaves up to some three times more of a whole real log than of its pieces; one picked up, fifty."""


@dataclasses.dataclass(frozen=True)
class LinearRows:
    """residual + columns @ x = noise, with x ~ N(0, sigma²): the torque residual and what may explain it."""

    columns: Float[np.ndarray, "T nv n"]
    residual: Float[np.ndarray, "T nv"]
    valid: Bool[np.ndarray, "T nv"]
    sigma: Float[np.ndarray, " n"]

    def with_joints(self, joints: JointTerms, v: Float[np.ndarray, "T nv"]) -> "LinearRows":
        """The same with the joints' own terms as further columns."""
        steps, nv, n = self.columns.shape
        own = np.where(self.valid[..., None], columns(np.nan_to_num(v)), 0.0)
        wide = np.zeros((steps, nv, n + 3 * nv))
        wide[..., :n] = self.columns
        for j in range(nv):
            wide[:, j, n + 3 * j : n + 3 * j + 3] = own[:, j]
        sigma = np.concatenate([self.sigma, np.asarray(joints.sigma).ravel()])
        return dataclasses.replace(self, columns=wide, sigma=sigma)

    def with_columns(
        self, more: Float[np.ndarray, "T nv k"], sigma: Float[np.ndarray, " k"]
    ) -> "LinearRows":
        """The same with further columns."""
        columns = np.concatenate([self.columns, np.where(self.valid[..., None], more, 0.0)], axis=2)
        return dataclasses.replace(self, columns=columns, sigma=np.append(self.sigma, sigma))

    def normal(
        self, part: slice, noise: Float[np.ndarray, " nv"]
    ) -> tuple[Float[np.ndarray, "n n"], Float[np.ndarray, " n"]]:
        """(1 + Σ Aᵀ R⁻¹ A Σ, −Σ Aᵀ R⁻¹ residual), the unknowns in units of their prior."""
        rows = (self.columns[part] / noise[:, None]).reshape(-1, self.columns.shape[2]) * self.sigma
        right = rows.T @ np.where(self.valid[part], self.residual[part] / noise, 0.0).ravel()
        return rows.T @ rows + np.eye(len(self.sigma)), -right

    def solved(self, part: slice, noise: Float[np.ndarray, " nv"]) -> Float[np.ndarray, " n"]:
        """The most probable x of a part of the log, given the noise of each row."""
        inner, right = self.normal(part, noise)
        return self.sigma * np.linalg.solve(inner, right)

    def evidence(self, part: slice, noise: Float[np.ndarray, " nv"]) -> float:
        """log p(residual) of a part of the log, up to what does not hang on the columns [nats]."""
        inner, right = self.normal(part, noise)
        factor = np.linalg.cholesky(inner)
        half = np.linalg.solve(factor, right)
        return float(0.5 * half @ half - np.sum(np.log(np.diagonal(factor))))


class PieceFit(NamedTuple):
    """Residual and noise of each row after the fit of one piece; NaN for rows hardly measured [N m, N]."""

    rms: Float[np.ndarray, " nv"]
    noise: Float[np.ndarray, " nv"]


def cut(count: int, period: float) -> list[slice]:
    """The pieces of a log of so many samples, every so many seconds.

    >>> from jax_inertia.estimation.pieces import cut
    >>> cut(500, 0.01)
    [slice(0, 200, None), slice(200, 400, None)]
    """
    length = int(_SECONDS / period)
    return [slice(k, k + length) for k in range(0, count - length + 1, length)]


def of_each(
    rows: LinearRows, parts: Sequence[slice], size: Float[np.ndarray, " nv"]
) -> tuple[Float[np.ndarray, " nv"], Float[np.ndarray, " nv"]]:
    """(rms, noise) of each row in the median piece; `size`: what the noise is no larger than."""
    fits = [_fitted(rows, part, size) for part in parts]
    rms, noise = (_median(np.array(x)) for x in zip(*fits, strict=True))
    return rms, noise


def changed_between_holds(
    rows: LinearRows, after: Float[np.ndarray, " nv"], holds: Holds, parts: Sequence[slice]
) -> bool:
    """Whether bodies changed in a log that rests in one pose after another, dry friction aside.

    Each hold has a friction of its own, which one piece takes for a load and the whole log cannot: without it in both
    fits every such log would seem to change. Its level is that of the moving rows, or at most all of the residual,
    `after` of the fit of constant bodies.
    """
    steps, joints, columns = rows.columns.shape
    wide = np.zeros((steps, joints, columns + joints))
    wide[..., :columns] = rows.columns
    index = np.arange(joints)
    wide[:, index, columns + index] = holds.direction * rows.valid
    moving = rows.valid & ~holds.at_rest[:, None]
    reach = np.concatenate([rows.sigma, after])
    own = LinearRows(wide * moving[..., None], rows.residual * moving, moving, reach)
    x = own.solved(slice(None), np.maximum(after, 1e-9))
    level = np.where(moving.any(axis=0), np.abs(x[columns:]), after)
    noise = np.maximum(1e-9, 0.1 * level)

    def rms(part: slice) -> np.ndarray:
        held, ok = holds[part], rows.valid[part]
        a = without_friction(wide[part], ok, held, noise, level)
        b = without_friction(rows.residual[part], ok, held, noise, level)
        return _fitted(LinearRows(a, b, ok, reach), slice(None), after).rms

    each = _median(np.array([rms(part) for part in parts]))
    return bool(np.any(rms(slice(None)) > CHANGED * np.where(each > 0, each, np.inf)))


def _fitted(rows: LinearRows, part: slice, noise: Float[np.ndarray, " nv"]) -> PieceFit:
    valid, residual = rows.valid[part], rows.residual[part]
    noise, after = np.maximum(noise, 1e-9), residual
    count = valid.sum(axis=0)
    # A row of few samples is fitted exactly by its joint's own terms, and shows no noise.
    measured = count > len(valid) // 2
    for _ in range(3):
        x = rows.solved(part, noise)
        after = np.where(valid, residual + rows.columns[part] @ x, 0.0)
        rms = np.sqrt(np.sum(after**2, axis=0) / np.maximum(count, 1)).clip(1e-9)
        noise = np.where(measured, rms, noise)
    rms = np.where(measured, noise, np.nan)
    return PieceFit(rms, rms * correlation_inflation(after, valid))


def _median(x: Float[np.ndarray, "pieces nv"]) -> Float[np.ndarray, " nv"]:
    """Of the pieces that measured a row; NaN where none did."""
    measured = np.isfinite(x).any(axis=0)
    return np.where(measured, np.nanmedian(np.where(measured, x, 0.0), axis=0), np.nan)


def sensitivity(
    rows: LinearRows,
    part: slice,
    noise: Float[np.ndarray, " nv"],
    more: Float[np.ndarray, "T nv k"],
) -> Float[np.ndarray, "n k"]:
    """By how much x errs for each unit of further unknowns with columns `more` that are taken for zero.

    S = (Aᵀ R⁻¹ A + Σ⁻¹)⁻¹ Aᵀ R⁻¹ B; of unknowns of unit variance S Sᵀ is Schmidt's consider covariance (1966).
    """
    inner, _ = rows.normal(part, noise)
    a = (rows.columns[part] / noise[:, None]).reshape(-1, len(rows.sigma)) * rows.sigma
    b = np.where(rows.valid[part][..., None], more[part], 0.0) / noise[:, None]
    return rows.sigma[:, None] * np.linalg.solve(inner, a.T @ b.reshape(len(a), -1))


# A load's mass and first moments are free in the test, its own inertia as large as the prior says.
_FREE = 1e4


def load_test(
    rows: LinearRows,
    part: slice,
    noise: Float[np.ndarray, " nv"],
    body: int,
    own: Float[np.ndarray, "4 k"],
) -> float:
    """p-value of "nothing is held": chance of so large a mass and first moment where none is there.

    Wald's test of the first four numbers of the `body`-th block of ten columns: χ² with four degrees of freedom, all
    other columns marginalised with their priors; `own` is by how much the bare body's own four are more for each unit
    of the last k columns.
    """
    four = slice(10 * body, 10 * body + 4)
    sigma = rows.sigma.copy()
    sigma[four] *= _FREE
    held = np.zeros((4, len(sigma)))
    held[:, four] = np.eye(4)
    held[:, len(sigma) - own.shape[1] :] -= own
    free = dataclasses.replace(rows, sigma=sigma)
    inner, right = free.normal(part, noise)
    inverse = np.linalg.inv(inner)
    found = held @ (sigma * (inverse @ right))
    covariance = held @ (sigma[:, None] * inverse * sigma) @ held.T
    statistic = float(found @ np.linalg.solve(covariance, found))
    return float(scipy.stats.chi2.sf(statistic, 4))
