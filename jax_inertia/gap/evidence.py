"""The charged least-squares problem that every candidate is judged in.

All columns are finished, whitened and flattened to n rows. With the nuisances' prior charged, sums of squares are
taken in the metric M = (1 + N Nᵀ)⁻¹: J(θ) = (y − A θ)ᵀ M (y − A θ). `Evidence` applies M^{1/2} once to everything,
so that from then on it is ordinary least squares.
"""

import functools
import itertools
from collections.abc import Iterable, Iterator

import numpy as np
import scipy.fft
import scipy.linalg
from jaxtyping import Float

from jax_inertia.gap.chain import Prepared
from jax_inertia.gap.families.base import Columns
from jax_inertia.gap.noise import ORDER, Whitener

# Shapes that go through the filters at once: more would leave the cache.
WIDE = 16


class Evidence:
    """Whitened missing torque of one log, with the nuisances integrated out."""

    def __init__(self, prepared: Prepared, whitener: Whitener, nuisance: list[Columns]):
        self.prepared = prepared
        self.whitener = whitener
        self.used = prepared.valid.copy()
        self.used[:ORDER] = False
        self.raw = self._whiten(Columns(prepared.missing[:, :, None]))
        n = np.concatenate([self._whiten(block) for block in nuisance], axis=1)
        # 1 + N Nᵀ = (in the span of N) 1 + s²: M^{1/2} scales each left singular vector by (1 + s²)^{-1/2}.
        gram = n.T @ n
        values, vectors = scipy.linalg.eigh(gram)
        kept = values > 1e-12 * max(values[-1], 1e-300)
        values, vectors = values[kept], vectors[:, kept]
        self._left = n @ (vectors / np.sqrt(values))
        self._shrink = 1.0 - 1.0 / np.sqrt(1.0 + values)
        self.y = self.charge(self.raw)[:, 0]

    @property
    def rows(self) -> int:
        """Number of whitened samples used."""
        return int(self.used.sum())

    def charge(self, x: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "n k"]:
        """M^{1/2} x."""
        return x - self._left @ (self._shrink[:, None] * (self._left.T @ x))

    def column(self, columns: Columns) -> Float[np.ndarray, "n k"]:
        """A candidate's columns in the charged metric."""
        return self.charge(self._whiten(columns))

    def of_many(self, shapes: Iterable[Columns]) -> Iterator[Float[np.ndarray, "n k"]]:
        """`column` of columns alike in form and row, some at a time: filters and products like them wide."""
        shapes = iter(shapes)
        while batch := list(itertools.islice(shapes, WIDE)):
            wide = np.concatenate([c.values for c in batch], axis=-1)
            parts = self.column(Columns(wide, batch[0].row))
            yield from np.split(parts, len(batch), axis=1)

    def charged(self, y: Float[np.ndarray, "R nv"]) -> Float[np.ndarray, " n"]:
        """A finished torque on all rows, in the charged metric."""
        return self.charge((self.whitener(y) * self.used).reshape(-1, 1))[:, 0]

    def noise_energy(self, replicas: Float[np.ndarray, "K R nv"]) -> float:
        """Charged misfit of noise alone: the mean over its replicas, finished but not whitened."""
        return float(np.mean([np.sum(self.charged(x) ** 2) for x in replicas]))

    @functools.cached_property
    def slow_modes(self) -> int:
        """Cosines in time that hold nine tenths of the needed torque, between 1 and 5 Hz."""
        needed = self.prepared.finish_torque(self.prepared.inverse) / self.whitener.sigma
        cosines = np.asarray(scipy.fft.dct(needed, axis=0, norm="ortho"))
        energy = np.cumsum((cosines[1:] ** 2).sum(axis=1))
        count = int(np.searchsorted(energy, 0.9 * energy[-1])) + 2
        # The k-th cosine of a record of T seconds has k / 2T Hz.
        seconds = len(needed) / self.prepared.settings.decimated
        return int(np.clip(count, 2 * seconds, min(10 * seconds, len(needed))))

    def slow(self, x: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "m k"]:
        """The part in the motion's own band, by its cosines; lengths are kept."""
        rows = x.reshape(*self.used.shape, -1)
        cosines = np.asarray(scipy.fft.dct(rows, axis=0, norm="ortho"))
        return cosines[: self.slow_modes].reshape(-1, x.shape[-1])

    def unflatten(self, x: Float[np.ndarray, " n"]) -> Float[np.ndarray, "R nv"]:
        """Whitened samples back on their rows; zero where not used."""
        return x.reshape(self.used.shape)

    def _whiten(self, columns: Columns) -> Float[np.ndarray, "n k"]:
        row = columns.row
        finished = self.prepared.finish_torque(columns.values, row)
        white = self.whitener(finished) if row is None else self.whitener.one_row(finished, row)
        white = white * self.used[:, :, None]
        return white.reshape(-1, white.shape[-1])
