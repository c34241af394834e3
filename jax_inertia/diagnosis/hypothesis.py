"""One effect at one place with one set of nonlinear numbers: its columns, and the prior of its size."""

import dataclasses
import functools
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jax_inertia.diagnosis.effects.base import Columns, Effect, Parameter, Place, Shape
from jax_inertia.diagnosis.residual import Residual


class Cut(NamedTuple):
    """The part of each slow row in which a logged torque does not reach the joint."""

    share: Float[np.ndarray, " R"]
    room: Float[np.ndarray, " R"]
    """Over how much it may lie there [N m]."""


@dataclasses.dataclass(frozen=True, eq=False)
class Hypothesis:
    """e = A θ on the rows of the residual, θ / `scale` ~ N(`prior_mean`, 1).

    `columns` (R, k) act on one `row`, (R, n, k) on all where that is None [N m per unit of θ].
    """

    effect: Effect
    place: Place
    shape: Shape
    columns: np.ndarray
    row: int | None
    scale: Float[np.ndarray, " k"]
    """Prior standard deviation of each number, in its unit."""
    mean: Float[np.ndarray, " k"]
    """Prior mean of each number, in its unit."""
    odds: float
    """Prior log odds against it, nats."""
    level: Effect | None = None
    """The ordinary effect whose columns and numbers come before its own: one law with it, where the model has its
    ordinary physics; where it lacks that, each joint has that effect of its own."""
    assumed: bool = False
    """Whether it is an ordinary effect that every hypothesis has."""
    cut: Cut | None = None
    """Where on its row it leaves the logged torque open."""
    form_error: float = Effect.form_error
    """Relative error of its equation."""

    @property
    def count(self) -> int:
        """How many numbers."""
        return len(self.scale)

    @property
    def family(self) -> str:
        """Name of its effect."""
        return self.effect.name

    @functools.cached_property
    def key(self) -> tuple[str, str, str]:
        """Family and place."""
        return self.family, self.place.kind, self.place.name

    @property
    def ordinary(self) -> bool:
        """Whether every robot as it is bought has it, and this model lacks it."""
        return self.effect.ordinary and self.assumed

    @property
    def is_odd(self) -> bool:
        """Whether it is beyond the ordinary and the tolerances; generic alternatives are."""
        return not self.ordinary and not self.effect.marginal

    @property
    def fills(self) -> str:
        """The ordinary effect that it is a law of, where it is no addition to one that is there already."""
        if self.level is not None:
            return self.level.name
        return self.family if self.effect.ordinary and not self.assumed else ""

    @property
    def named(self) -> bool:
        """Whether it names a cause."""
        return self.effect.named

    @functools.cached_property
    def prior_mean(self) -> Float[np.ndarray, " k"]:
        """Prior mean of each number per standard deviation."""
        return self.mean / self.scale

    def possible(self, residual: Residual, theta: Float[np.ndarray, " k"]) -> bool:
        """Whether a robot can have these numbers."""
        context, effect = residual.context, self.effect
        if self.level is None:
            return effect.possible(context, self.place, theta)
        level, own = theta[:1], theta[1:]
        both = self.level.possible(context, self.place, level)
        return both and effect.possible_with(context, self.place, float(level[0]), own)

    @property
    def own_columns(self) -> Float[np.ndarray, "R k"]:
        """Of a joint's effect, on the joint's own row: forces of the ground may spread it over all."""
        return self.columns if self.row is not None else self.columns[:, self.place.index]

    @functools.cached_property
    def rows(self) -> tuple[int, ...]:
        """Rows that it acts on."""
        if self.row is not None:
            return (self.row,)
        return tuple(np.flatnonzero(self.columns.any(axis=(0, 2))).tolist())

    @property
    def on_rows(self) -> Float[np.ndarray, "R rows k"]:
        """Columns on those rows, per prior standard deviation."""
        own = self.columns[:, None] if self.row is not None else self.columns[:, list(self.rows)]
        return own * self.scale

    def on_row(self, row: int) -> Float[np.ndarray, "R k"]:
        """Columns on one of those rows, per prior standard deviation."""
        return (self.columns if self.row is not None else self.columns[:, row]) * self.scale

    @property
    def scaled(self) -> np.ndarray:
        """Columns per prior standard deviation."""
        return self.columns * self.scale

    def torque(
        self, mean: Float[np.ndarray, " k"], shape: tuple[int, int]
    ) -> Float[np.ndarray, "R n"]:
        """Torque of the effect at numbers in units of `scale` [N m]."""
        values = self.columns @ (mean * self.scale)
        if self.row is None:
            return values
        out = np.zeros(shape)
        out[:, self.row] = values
        return out

    def numbers(self, residual: Residual, theta: Float[np.ndarray, " k"]) -> dict[str, Parameter]:
        """What is reported of θ, in newtons and metres of a joint that slides."""
        return self.effect.reported(residual.context, self.place, self.shape, theta)


def hypothesis(
    residual: Residual,
    effect: Effect,
    place: Place,
    shape: Shape,
    odds: float,
    level: Effect | None = None,
    *,
    assumed: bool = False,
) -> Hypothesis:
    """An effect's columns on the residual's rows, those of its `level` before them."""
    columns, row, cut = _seen(residual, effect, place, shape, level)
    laws = effect if level is None else level, effect
    priors = [
        (law.scale(context, place, shape), law.mean(context, place, shape))
        for law, context in ((law, residual.context_of(law)) for law in dict.fromkeys(laws))
    ]
    scale, mean = (np.concatenate(x) for x in zip(*priors, strict=True))
    form = effect.form_error_at(residual.context_of(effect), place, shape)
    return Hypothesis(
        effect, place, shape, columns, row, scale, mean, odds, level, assumed, cut, form
    )


def reshaped(h: Hypothesis, residual: Residual, shape: Shape) -> Hypothesis:
    """The same hypothesis with other nonlinear numbers."""
    return hypothesis(residual, h.effect, h.place, shape, h.odds, h.level, assumed=h.assumed)


def elsewhere(h: Hypothesis, residual: Residual) -> Hypothesis:
    """The same hypothesis on another log, with the first one's prior."""
    columns, row, cut = _seen(residual, h.effect, h.place, h.shape, h.level)
    return dataclasses.replace(h, columns=columns, row=row, cut=cut)


MOST_KNOWN = 4000
"""Columns that a log keeps: a search between a grid's points comes by the same numbers many times."""
AT_ONCE = 32_000_000
"""Bytes of columns on the fast grid that go through the chain's last filter together."""


def foreseen(
    residual: Residual,
    effect: Effect,
    place: Place,
    shapes: Iterable[Shape],
    level: Effect | None = None,
) -> None:
    """Make the columns of many nonlinear numbers at once: later `hypothesis` calls find them."""
    waiting: list[tuple[Shape, Columns]] = []
    for shape in shapes:
        if (effect, place, shape, level) in residual.known:
            continue
        waiting.append((shape, _raw(residual, effect, place, shape, level)))
        if waiting[-1][1].values.nbytes * (len(waiting) + 1) > AT_ONCE:
            _finish(residual, effect, place, waiting, level)
            waiting = []
    if waiting:
        _finish(residual, effect, place, waiting, level)


def _finish(
    residual: Residual,
    effect: Effect,
    place: Place,
    made: list[tuple[Shape, Columns]],
    level: Effect | None,
) -> None:
    """Columns of one effect at one place on the residual's rows, kept; the latest are."""
    known = residual.known
    values, row = residual.rows_of(
        Columns(np.concatenate([c.values for _, c in made], axis=-1), made[0][1].row)
    )
    ends = np.cumsum([c.values.shape[-1] for _, c in made])
    for (shape, _), part in zip(made, np.split(values, ends[:-1], axis=-1), strict=True):
        if len(known) >= MOST_KNOWN:
            known.pop(next(iter(known)))
        cut = _cut(residual, effect, place, shape)
        known[effect, place, shape, level] = np.ascontiguousarray(part), row, cut


def _seen(
    residual: Residual, effect: Effect, place: Place, shape: Shape, level: Effect | None
) -> tuple[np.ndarray, int | None, Cut | None]:
    """Columns on the residual's rows, the row that they act on, and what is cut off; the latest are kept."""
    key = (effect, place, shape, level)
    if key not in residual.known:
        _finish(residual, effect, place, [(shape, _raw(residual, *key))], level)
    return residual.known[key]


def _cut(residual: Residual, effect: Effect, place: Place, shape: Shape) -> Cut | None:
    room = effect.room(residual.context_of(effect), place, shape)
    if room is None:
        return None
    share, mean = residual.prepared.finish(np.stack([room > 0, room], axis=1).astype(float)).T
    share = np.clip(share, 0.0, 1.0)
    return Cut(share, np.maximum(mean, 0.0) / np.maximum(share, 1e-9))


def fast_torque(h: Hypothesis, residual: Residual, theta: Float[np.ndarray, " k"]) -> np.ndarray:
    """Torque of a hypothesis on the fast grid (T, nv), at numbers in their own units [N m]."""
    columns = _raw(residual, h.effect, h.place, h.shape, h.level)
    values = columns.values @ theta
    if columns.row is None:
        return values
    out = np.zeros((len(values), residual.robot.nv))
    out[:, columns.row] = values
    return out


def _raw(
    residual: Residual, effect: Effect, place: Place, shape: Shape, level: Effect | None
) -> Columns:
    """Columns on the fast grid, those of its `level` before them."""
    columns = effect.columns(residual.context_of(effect), place, shape)
    if level is not None:
        before = effect.of_level(level, residual.context_of(effect), place, shape).values
        columns = Columns(np.concatenate([before, columns.values], axis=-1), columns.row)
    return columns


def excluded(residual: Residual, h: Hypothesis, chosen: Iterable[Hypothesis]) -> bool:
    """Whether it is chosen already, or another law of what its place has but one of."""
    for c in chosen:
        if c.family == h.family and one_place(residual, c, h):
            apart = c.effect.apart(residual.context, c.place, c.shape, h.shape)
            if not (c.effect.many and apart):
                return True
        if h.fills and c.fills == h.fills and c.place == h.place:
            return True
        held = h.family == c.effect.holds or c.family == h.effect.holds
        if held and c.place == h.place and not (c.assumed or h.assumed):
            return True
        if not h.effect.law:
            continue
        together = c.place == h.place or "global" in (c.place.kind, h.place.kind)
        if c.effect.law == h.effect.law and together:
            return True
    return False


def one_place(residual: Residual, a: Hypothesis, b: Hypothesis) -> bool:
    """Whether two places are one: bodies that are fixed to each other are."""
    if a.place.kind == b.place.kind == "body":
        return residual.robot.topology.welded(a.place.index, b.place.index)
    return a.place == b.place
