"""Every family at every place: its columns, computed once, and its fit to what is left of the missing torque."""

import copy
import dataclasses
import functools
from collections.abc import Iterable, Iterator

import numpy as np
from jaxtyping import Float

from jax_inertia.diagnosis.effects.base import Place, Shape
from jax_inertia.diagnosis.features.context import Context
from jax_inertia.gap.block import Beside, Block, Carried, Plain
from jax_inertia.gap.candidate import Candidate, fit
from jax_inertia.gap.evidence import Evidence
from jax_inertia.gap.families.base import Family
from jax_inertia.gap.refine import refine
from jax_inertia.gap.span import Split

# Samples of columns of single shapes that are kept, at most, about.
KEPT = 3e7
# A grid point that explains this share of what the best does may lie on the flank of a higher peak.
NEARLY = 0.5


@dataclasses.dataclass(frozen=True)
class Echo:
    """The log once more, with its sensors' noise added again."""

    context: Context
    noise: Float[np.ndarray, " n"]
    """What that noise does to y, before the tolerances charge it."""


@dataclasses.dataclass
class Entry:
    """A family at a place, with the shapes that were tried and those that may be."""

    family: Family
    place: Place
    blocks: list[Block]
    rest: list[Shape]
    count: int
    """Among how many shapes, tried or not, the best is picked (`Family.count`)."""


class Pool:
    """All candidates of a log, their columns computed once."""

    def __init__(self, context: Context, evidence: Evidence, library: list[Family], echo: Echo):
        self.context, self.evidence, self.echo = context, evidence, echo
        self.library = library
        self._kept: dict[tuple[Family, Place, Shape], Block] = {}

    @functools.cached_property
    def entries(self) -> list[Entry]:
        """Every family at every place where it does something."""
        return self._entered([], self.library)

    def forget(self) -> None:
        """Let go of the columns, gigabytes for a humanoid; they are computed again if they are asked for."""
        self.__dict__.pop("entries", None)
        self._kept.clear()

    def look_again(self, windows: tuple[tuple[float, float], ...]) -> None:
        """Offer what happens in passing (pushes) over other stretches of time."""
        if windows == self.context.windows:
            return
        self.context.windows = windows
        lasting = [e for e in self.entries if not e.family.passing]
        self.entries = self._entered(lasting, [f for f in self.library if f.passing])

    def _entered(self, entries: list[Entry], families: list[Family]) -> list[Entry]:
        """Entries, and those of more families."""
        out = list(entries)
        for family in families:
            for place in family.places(self.context):
                shapes = self._heard(family, family.shapes(self.context, place))
                first = set(family.first(self.context, place))
                rest = [s for s in shapes if s not in first]
                alike = [e for e in out if family.alike and e.family.alike == family.alike]
                blocks = next((e.blocks for e in alike if e.place == place), None)
                if blocks is None:
                    blocks = self._sound(family, place, [s for s in shapes if s in first])
                if blocks:
                    out.append(
                        Entry(family, place, blocks, rest, family.count(self.context, place))
                    )
        return out

    def _heard(self, family: Family, shapes: Iterable[Shape]) -> list[Shape]:
        """Those that this noise can judge: none above the motion's band where what the model misses is the noise.

        A model misses least where nothing moves, and what a joint that yields would do there is its encoder's noise,
        twice differentiated: it draws some of whatever is left.
        """
        band = self.context.slow_band if self.evidence.whitener.of_misses else np.inf
        return [s for s in shapes if family.band(s) <= band]

    def _sound(self, family: Family, place: Place, shapes: list[Shape]) -> list[Block]:
        """Blocks of the shapes that do something."""
        return [
            b
            for b in self.blocks(family, place, shapes)
            if np.isfinite(b.plain.columns).all() and np.trace(b.gram) > 1e-12
        ]

    def blocks(self, family: Family, place: Place, shapes: list[Shape]) -> list[Block]:
        """A family's columns at a place, for given nonlinear numbers."""

        def columns(context: Context) -> Iterator[Split]:
            family.prepare(context, place, shapes)
            return self.evidence.of_many(family.columns(context, place, s) for s in shapes)

        plain = functools.partial(Plain, self.evidence)
        own = columns(self.context)
        if not family.noisy(self.context):
            return [Block(self.evidence, s, plain(x)) for s, x in zip(shapes, own, strict=True)]
        return [
            Block(self.evidence, s, plain(x), Carried.of(again.minus(x), self._of_y))
            for s, x, again in zip(shapes, own, columns(self.echo.context), strict=True)
        ]

    def block(self, family: Family, place: Place, shape: Shape) -> Block:
        """`blocks` of one shape: the same are come back to, whatever is chosen beside them."""
        key, kept = (family, place, shape), self._kept
        if key not in kept:
            if len(kept) * self.evidence.rows > KEPT:
                del kept[next(iter(kept))]
            kept[key] = self.blocks(family, place, [shape])[0]
        return kept[key].charged_as(self.evidence)

    @functools.cached_property
    def _of_y(self) -> Split:
        """What the echo's noise does to y."""
        return self.evidence.split(self.echo.noise[:, None])

    def charged_as(self, evidence: Evidence) -> "Pool":
        """The same candidates where the model's tolerances are larger, smaller or fewer."""
        out = copy.copy(self)
        out.evidence = evidence
        every = {id(e.blocks): e.blocks for e in self.entries}
        now = {key: [b.charged_as(evidence) for b in group] for key, group in every.items()}
        out.entries = [dataclasses.replace(e, blocks=now[id(e.blocks)]) for e in self.entries]
        return out

    def best(self, left: Beside, share: float = 0.0) -> list[Candidate]:
        """Every candidate fitted to what is left, without those that cannot explain a share of what the best does."""
        most = [max(left.most(b) for b in e.blocks) for e in self.entries]
        found, enough = {}, 0.0
        for i in np.argsort(most)[::-1]:
            if most[i] < enough:
                break
            c = self._best_of(self.entries[i], left)
            if c is not None:
                found[i] = c
                enough = max(enough, share * c.gain)
        return [found[i] for i in sorted(found)]

    def _best_of(self, entry: Entry, left: Beside) -> Candidate | None:
        firsts = [fits[0] for fits in self._ranked(entry, left)]
        top = max(firsts, key=lambda c: c.gain, default=None)
        if top is not None:
            # Windows were picked from all there are: (duration / 0.1 s)² of them, about.
            windows = max(2, round((self.context.time[-1] / 0.1) ** 2))
            top.grid = windows if entry.family.passing else entry.count
        return top

    def _ranked(self, entry: Entry, left: Beside) -> list[list[Candidate]]:
        """For every band that the family may be judged in, an entry's fits, those of the highest aim first.

        The aim tells where in a band a shape is best; which band, what is gained in all.
        """
        family, coarse = entry.family, bool(entry.rest)
        fits = (
            fit(self.context, family, entry.place, b, left, coarse=coarse) for b in entry.blocks
        )
        bands: dict[float, list[Candidate]] = {}
        for c in sorted((f for f in fits if f is not None), key=lambda c: -c.aim):
            bands.setdefault(family.band(c.shape), []).append(c)
        return list(bands.values())

    def _entry_of(self, candidate: Candidate) -> Entry | None:
        """Where a candidate's grid is; none for a family with more numbers than the library's."""
        of = candidate.family, candidate.place
        return next((e for e in self.entries if (e.family, e.place) == of), None)

    def refined(self, candidate: Candidate, left: Beside, *, everywhere: bool = True) -> Candidate:
        """The same candidate with its shape between grid points, from wherever the grid shows a peak.

        Not `everywhere`: about the candidate's own shape alone.
        """
        best = self._on_all(candidate, left)
        others = self._other_peaks(best, left) if everywhere else []
        found = [self.between(c, left) for c in (best, *others)]
        best = max(found, key=lambda c: c.gain)
        restarts = best.family.restarts(self.context, best.place, best.shape)
        shapes = self._heard(best.family, restarts)
        for c in self.best_at(shapes, best.family, best, left):
            best = max(best, self.between(c, left), key=lambda c: c.gain)
        return self._plain(best, left)

    def _plain(self, best: Candidate, left: Beside) -> Candidate:
        """A refined candidate as the model has it, where what it says beyond that is hardly told."""
        entry, family = self._entry_of(best), best.family
        if entry is None or family.plain(best.shape):
            return best
        enough = best.gain - family.set_apart * best.noise(left.loudness)
        plain = ([c for c in fits if family.plain(c.shape)] for fits in self._ranked(entry, left))
        found = [self.between(fits[0], left) for fits in plain if fits]
        near = [c for c in found if c.gain > enough]
        return max(near, key=lambda c: c.gain, default=best)

    def between(self, candidate: Candidate, left: Beside) -> Candidate:
        """The candidate with its shape between the grid points about it."""
        if not candidate.shape:
            return candidate

        def block_of(shape: Shape) -> Block:
            return self.block(candidate.family, candidate.place, shape)

        return refine(self.context, block_of, candidate, left)

    def _other_peaks(self, best: Candidate, left: Beside) -> list[Candidate]:
        """The best grid points of each band that do not lie about the best or each other, as many as there may be."""
        entry, family = self._entry_of(best), best.family
        if entry is None or (family.peaks == 1 and not family.band(best.shape)):
            return []
        others: list[Candidate] = []
        for fits in self._ranked(entry, left):
            band = family.band(fits[0].shape)
            taken = [best] if family.band(best.shape) == band else []
            for c in fits:
                if len(taken) == family.peaks:
                    break
                if c.gain > NEARLY * best.gain and not any(self._about(c.shape, t) for t in taken):
                    c.grid = best.grid
                    taken.append(c)
            others += [c for c in taken if c is not best]
        return others

    def _about(self, shape: Shape, other: Candidate) -> bool:
        """Whether a shape lies where another's is refined."""
        bounds = other.family.around(self.context, other.place, other.shape)
        return all(low <= x <= high for x, (low, high) in zip(shape, bounds, strict=True))

    def _on_all(self, candidate: Candidate, left: Beside) -> Candidate:
        """The candidate at the best of all its shapes, those not tried so far included."""
        entry = self._entry_of(candidate)
        if entry is None or not entry.rest:
            return candidate
        entry.blocks = entry.blocks + self._sound(entry.family, entry.place, entry.rest)
        entry.rest = []
        found = self._best_of(entry, left)
        return found or dataclasses.replace(candidate, gain=0.0, aim=0.0)

    def at(
        self, shape: Shape, family: Family, candidate: Candidate, left: Beside
    ) -> Candidate | None:
        """A cause at a candidate's place, by an equation and a shape that may be others than the candidate's."""
        block = self.block(family, candidate.place, shape)
        fitted = fit(self.context, family, candidate.place, block, left)
        if fitted is not None:
            fitted.grid = candidate.grid
        return fitted

    def best_at(
        self, shapes: Iterable[Shape], family: Family, candidate: Candidate, left: Beside
    ) -> list[Candidate]:
        """A cause at a candidate's place at the best of some shapes; none where it fits at no one."""
        tried = (self.at(shape, family, candidate, left) for shape in shapes)
        return sorted((x for x in tried if x is not None), key=lambda x: -x.aim)[:1]

    def fit_again(self, candidate: Candidate, left: Beside) -> Candidate | None:
        """The candidate refitted at its own shape, then refined; None where it is no longer physical."""
        fitted = self.at(candidate.shape, candidate.family, candidate, left)
        return None if fitted is None else self.between(self._on_all(fitted, left), left)
