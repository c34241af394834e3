"""The charged least-squares problem that every candidate is judged in.

All columns are finished, whitened and flattened to the n samples that count. With the nuisances' prior charged, sums of
squares are taken in the metric M = (1 + N Nᵀ)⁻¹: J(θ) = (y − A θ)ᵀ M (y − A θ). `Evidence` applies M^{1/2} once to
everything, so that from then on it is ordinary least squares. It does so in two steps, what is the same for every robot
before the model's own tolerances, since the scales of those are learned (`scales`) while columns are at hand.
"""

import copy
import functools
import itertools
from collections.abc import Callable, Iterable, Iterator
from typing import TypeVar

import numpy as np
import scipy.fft
from jaxtyping import Bool, Float, Int
from scipy import ndimage

from jax_inertia.diagnosis.effects.base import Columns
from jax_inertia.gap.energies import shares
from jax_inertia.gap.noise import Whitener, with_all_before
from jax_inertia.gap.nuisance import Nuisances
from jax_inertia.gap.span import Brief, Span, Split
from jax_inertia.signals.torque_residual import Prepared

T = TypeVar("T")

# Shapes that go through filters and products at once: more would leave the cache.
WIDE = 16
# A torque acts on rows that have more than this share of its energy on the row where it has most, and is louder than
# noise where it has this many times its energy.
ACTS, LOUDER = 0.05, 2.0


class Evidence:
    """Whitened missing torque of one log, with the nuisances integrated out."""

    def __init__(
        self,
        prepared: Prepared,
        whitener: Whitener,
        nuisances: Nuisances,
        scales: dict[str, float] | None = None,
        used: Bool[np.ndarray, "R nv"] | None = None,
    ):
        self.prepared = prepared
        self.whitener = whitener
        self._nuisances = nuisances
        self.used = moving(prepared) if used is None else used
        self._whitening = whitener.over(self.used)
        self.raw = self._whiten(Columns(prepared.missing[:, :, None]))
        fixed, brief = (self._side_by_side(x) for x in (nuisances.fixed, nuisances.brief))
        self._brief = Brief(brief) if brief.shape[1] else None
        self._fixed = Span(self._charge_brief(fixed))
        self._fixed_charging = self._fixed.charging()
        self.kinds = list(nuisances.tolerances)
        """Of tolerances."""
        parts = [self._side_by_side(nuisances.tolerances[kind]) for kind in self.kinds]
        self.kind_of = np.repeat(np.arange(len(parts)), [x.shape[1] for x in parts])
        self.tolerances = self._charge_fixed(np.concatenate(parts, axis=1))
        """Columns of all tolerances, kind by kind (`kind_of`), once the fixed nuisances are charged."""
        self.named = [name for kind in self.kinds for name in nuisances.named[kind]]
        """What each of these columns is an error of."""
        self._own = Span(self.tolerances)
        self._take(dict.fromkeys(self.kinds, 1.0) | (scales or {}), frozenset())

    def rescaled(self, scales: dict[str, float]) -> "Evidence":
        """The same log where the tolerances are `scales` times as large."""
        out = copy.copy(self)
        out._take(scales, self.pinned)
        return out

    def among(self, used: Bool[np.ndarray, "R nv"]) -> "Evidence":
        """The same log where only some samples count."""
        out = Evidence(self.prepared, self.whitener, self._nuisances, self.scales, used)
        return out.pinning(self.pinned)

    def pinning(self, columns: Iterable[int]) -> "Evidence":
        """The same log where some of the model's numbers are taken for exact: what is beside them is an effect's."""
        out = copy.copy(self)
        out._take(self.scales, self.pinned.union(columns))
        return out

    def unpinned(self) -> "Evidence":
        """The same log where none of them is, and those of their kinds are no better than was stated."""
        out = copy.copy(self)
        kinds = {self.kind(j): 1.0 for j in self.pinned}
        out._take({k: max(x, kinds.get(k, 0.0)) for k, x in self.scales.items()}, frozenset())
        return out

    def _take(self, scales: dict[str, float], pinned: frozenset[int]) -> None:
        self.scales, self.pinned = scales, pinned
        self._charging = self._own.charging(self.per_column())
        self._change = self._charging.T @ self._charging - np.eye(len(self._charging))
        self.y = self.charge(self.raw)[:, 0]

    def per_column(self) -> Float[np.ndarray, " k"]:
        """The scale of each column of the tolerances."""
        out = np.array([self.scales[kind] for kind in self.kinds])[self.kind_of]
        out[sorted(self.pinned)] = 0.0
        return out

    @property
    def gram(self) -> Float[np.ndarray, "k k"]:
        """NᵀN of the tolerances' columns."""
        return self._own.gram

    def _side_by_side(self, columns: list[Columns]) -> Float[np.ndarray, "n k"]:
        nothing = np.zeros((self.rows, 0))
        return np.concatenate([nothing, *(self._whiten(block) for block in columns)], axis=1)

    @property
    def rows(self) -> int:
        """Number of whitened samples used."""
        return int(self.used.sum())

    @property
    def share(self) -> Float[np.ndarray, " nv"]:
        """What each row has of the gap: of the energy above the noise's, before anything is explained."""
        return shares(np.sum(self.unflatten(self.raw[:, 0]) ** 2 - self.used, axis=0))

    def charge(self, x: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "n k"]:
        """M^{1/2} x."""
        return self.charge_own(self._charge_fixed(x))

    def _charge_fixed(self, x: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "n k"]:
        return self._fixed.apply(self._fixed_charging, self._charge_brief(x))

    def _charge_brief(self, x: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "n k"]:
        return x if self._brief is None else self._brief.charge(x)

    def charge_own(self, x: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "n k"]:
        """M^{1/2} x of what the fixed nuisances have charged."""
        return self._own.apply(self._charging, x)

    def added(self, inside: Float[np.ndarray, "s k"]) -> Float[np.ndarray, "s k"]:
        """What M^{1/2} adds to columns with these coordinates in the tolerances' span, A in `span`."""
        return self._charging @ inside - inside

    def charged_product(
        self,
        product: Float[np.ndarray, "k l"],
        left: Float[np.ndarray, "s k"],
        right: Float[np.ndarray, "s l"],
    ) -> Float[np.ndarray, "k l"]:
        """XᵀMY of columns with this product XᵀY and these coordinates in the tolerances' span."""
        return product + left.T @ (self._change @ right)

    @property
    def basis(self) -> Float[np.ndarray, "n s"]:
        """Of the tolerances' span, orthonormal."""
        return self._own.basis

    def without_tolerances(self, x: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "n k"]:
        """What was charged with all nuisances, charged with the fixed ones alone."""
        return self._own.apply(np.linalg.inv(self._charging), x)

    def recharging(
        self, before: "Evidence"
    ) -> Callable[[Float[np.ndarray, "n k"]], Float[np.ndarray, "n k"]]:
        """From what was charged with the tolerances' scales `before` to the same with those of now."""
        return functools.partial(self._own.apply, self._charging @ np.linalg.inv(before._charging))

    def deviations(
        self, left: Float[np.ndarray, " n"]
    ) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
        """How far off each number of the model is by what effects leave, its error, and the size of its column.

        The first two in the tolerances that were stated, whatever their scales now.
        """
        scale = self.per_column()
        off = self._off(self.charge_own(left[:, None])[:, 0])
        inside = np.eye(len(scale)) + scale[:, None] * self.gram * scale
        error = scale * np.sqrt(np.diagonal(np.linalg.inv(inside)))
        return off, error, np.sqrt(np.diagonal(self.gram))

    def excused(self, left: Float[np.ndarray, " n"]) -> Float[np.ndarray, "R nv"]:
        """The finished torque that nuisances most likely have in what effects leave: N ẑ, ẑ = Λ² Nᵀ M (y − A θ)."""
        inside = self.charge_own(left[:, None])
        # M^{1/2} is one root after the other, so its transpose is the other after the one.
        fixed = self._fixed.apply(self._fixed_charging, inside)[:, 0]
        numbers = [self._fixed.along(fixed)]
        if self._brief is not None:
            numbers.append(self._brief.along(self._brief.charge(fixed)))
        torque = self._nuisances.torque(np.concatenate(numbers), self._off(inside[:, 0]))
        return self.prepared.finish_torque(torque)

    def _off(self, inside: Float[np.ndarray, " n"]) -> Float[np.ndarray, " k"]:
        """How far off each number of the model is; `inside` is what effects leave, charged once more."""
        return self.per_column() ** 2 * (self.tolerances.T @ inside)

    def kind(self, j: int) -> str:
        """What kind of number the j-th tolerance is of."""
        return self.kinds[self.kind_of[j]]

    def furthest(self, left: Float[np.ndarray, " n"], count: int) -> list[int]:
        """The tolerances that are strained most by what effects leave, against their scales now, the most first."""
        off = self._off(self.charge_own(left[:, None])[:, 0])
        strain = np.abs(off) / np.maximum(self.per_column(), 1e-300)
        return np.argsort(-strain)[:count].tolist()

    def charged_tolerance(self, j: int) -> Float[np.ndarray, "n 1"]:
        """The column of the j-th tolerance in the charged metric."""
        return self.charge_own(self.tolerances[:, [j]])

    def column(self, columns: Columns) -> Float[np.ndarray, "n k"]:
        """A candidate's columns in the charged metric."""
        return self.charge(self._whiten(columns))

    def of_many(self, shapes: Iterable[Columns]) -> Iterator[Split]:
        """Columns alike in form and row, apart from the tolerances: some at a time, since filters like them wide."""
        for batch in _batches(shapes):
            wide = np.concatenate([c.values for c in batch], axis=-1)
            charged = self._charge_fixed(self._whiten(Columns(wide, batch[0].row)))
            yield from self.split(charged).parts([c.values.shape[-1] for c in batch])

    def split(self, x: Float[np.ndarray, "n k"]) -> Split:
        """Columns that the fixed nuisances have charged, and what of them lies in the tolerances' span."""
        return self._own.split(x)

    def charged(self, y: Float[np.ndarray, "R nv"]) -> Float[np.ndarray, " n"]:
        """A finished torque on all rows, in the charged metric."""
        return self.charge(self._whitening(y)[self.used][:, None])[:, 0]

    def noise_energy(self, replicas: Float[np.ndarray, "K R nv"]) -> float:
        """Charged misfit of noise alone: the mean over its replicas, finished but not whitened."""
        return float(np.mean([np.sum(self.charged(x) ** 2) for x in replicas]))

    def noise_by_row(self, replicas: Float[np.ndarray, "K R nv"]) -> Float[np.ndarray, " nv"]:
        """Charged energy of noise alone on each row, likewise."""
        return np.mean([self.by_row(self.charged(x)) for x in replicas], axis=0)

    @functools.cached_property
    def slow_modes(self) -> int:
        """Cosines in time that hold nine tenths of the needed torque, between 1 and 5 Hz."""
        needed = self.prepared.finish_torque(self.prepared.inverse) / self.whitener.sigma
        cosines = np.asarray(scipy.fft.dct(needed, axis=0, norm="ortho"))
        energy = np.cumsum((cosines[1:] ** 2).sum(axis=1))
        count = int(np.searchsorted(energy, 0.9 * energy[-1])) + 2
        # The k-th cosine of a record of T seconds has k / 2T Hz.
        seconds = len(needed) / self.prepared.bands.rows
        return int(np.clip(count, 2 * seconds, min(10 * seconds, len(needed))))

    @property
    def slow_band(self) -> float:
        """Up to which frequency they reach [Hz]."""
        return self.slow_modes * self.prepared.bands.rows / (2 * len(self.used))

    @functools.cached_property
    def slow_basis(self) -> Float[np.ndarray, "m s"]:
        """The tolerances' span in the motion's own band."""
        return self.slow(self.basis)

    def slow(self, x: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "m k"]:
        """The part in the motion's own band, by its cosines; lengths are kept."""
        return self._cosines(x)[: self.slow_modes].reshape(-1, x.shape[-1])

    def heard(self, x: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "m k"]:
        """The part in the band in which the first column's torque is louder than noise; that is `slow`'s at least.

        Over every hertz of it, on the rows where the torque acts.
        """
        cosines = self._cosines(x)
        energy = cosines[:, :, 0] ** 2
        energy = energy[:, acting(energy.sum(axis=0))].mean(axis=1)
        hertz = 2 * len(energy) / self.prepared.bands.rows
        quiet = np.flatnonzero(ndimage.uniform_filter1d(energy, round(hertz)) < LOUDER)
        modes = max(self.slow_modes, int(quiet[0]) if len(quiet) else len(energy))
        return cosines[:modes].reshape(-1, x.shape[-1])

    def by_band(self, x: Float[np.ndarray, " n"]) -> Float[np.ndarray, "b nv"]:
        """Energy of whitened samples on each row in the motion's own band, the octave above it and all above that."""
        energy = self._cosines(x) ** 2
        starts = np.minimum(self.slow_modes * np.array([0, 1, 2]), len(energy) - 1)
        return np.add.reduceat(energy, starts, axis=0)

    def _cosines(self, x: Float[np.ndarray, "n *k"]) -> Float[np.ndarray, "R nv *k"]:
        return np.asarray(scipy.fft.dct(self.unflatten(x), axis=0, norm="ortho"))

    def unflatten(self, x: Float[np.ndarray, "n *k"]) -> Float[np.ndarray, "R nv *k"]:
        """Whitened samples back on their rows; zero where not used."""
        out = np.zeros((*self.used.shape, *x.shape[1:]))
        out[self.used] = x
        return out

    def by_row(self, x: Float[np.ndarray, " n"]) -> Float[np.ndarray, " nv"]:
        """Energy of whitened samples on each row."""
        return np.sum(self.unflatten(x) ** 2, axis=0)

    def acted_on(self, torque: Float[np.ndarray, "T nv"]) -> Bool[np.ndarray, " nv"]:
        """The rows on which a torque acts, not whitened [N m]."""
        return acting(np.sum((torque / self.whitener.sigma) ** 2, axis=0))

    def part(self, count: int) -> Int[np.ndarray, " n"]:
        """Which of `count` equal stretches of the log each sample lies in."""
        return np.nonzero(self.used)[0] * count // len(self.used)

    def _whiten(self, columns: Columns) -> Float[np.ndarray, "n k"]:
        row = columns.row
        finished = self.prepared.finish_torque(columns.values, row)
        whitening = self._whitening
        if row is None or self.prepared.spreads(row):
            return whitening(finished)[self.used]
        return whitening.one_row(finished, row)[self.used]


def acting(energy: Float[np.ndarray, " nv"]) -> Bool[np.ndarray, " nv"]:
    """The rows on which a torque acts that has this energy on each, in units of their noise."""
    return energy > ACTS * energy.max()


def _batches(items: Iterable[T]) -> Iterator[list[T]]:
    """`WIDE` of them at a time."""
    items = iter(items)
    while batch := list(itertools.islice(items, WIDE)):
        yield batch


# The chain's last filter carries what happens at rest this many samples into the motion.
CARRIED = 2


def moving(prepared: Prepared) -> Bool[np.ndarray, "R nv"]:
    """Samples that count, (R, nv): measured, of a joint that moves, and so are those that the autoregression leans on.

    Friction at rest is whatever balances, so a joint that stands tells nothing.
    """
    rest = prepared.rest[prepared.kept] * 1.0
    far = ndimage.maximum_filter1d(rest, 2 * CARRIED + 1, axis=0) == 0
    return with_all_before(prepared.valid & far)
