"""One effect at one place with one set of nonlinear numbers: its columns, and the prior of its size."""

import dataclasses
import functools

import numpy as np
from jaxtyping import Float

from jax_inertia.diagnosis.effects.base import Effect, Parameter, Place, Shape
from jax_inertia.diagnosis.residual import Residual


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
    odds: float
    """Prior log odds against it, nats."""

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
        """Whether every robot has it."""
        return self.effect.ordinary

    @property
    def is_odd(self) -> bool:
        """Whether it is beyond the ordinary and the tolerances; generic alternatives are."""
        return not self.effect.ordinary and not self.effect.marginal

    @property
    def named(self) -> bool:
        """Whether it names a cause."""
        return self.effect.named

    @property
    def form_error(self) -> float:
        """Relative error of its equation."""
        return self.effect.form_error

    @functools.cached_property
    def prior_mean(self) -> Float[np.ndarray, " k"]:
        """Prior mean of each number per standard deviation: zero, or of θ = 1 where an effect is all there or not."""
        return (1.0 if self.effect.sized_by_shape else 0.0) / self.scale

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
    residual: Residual, effect: Effect, place: Place, shape: Shape, odds: float
) -> Hypothesis:
    """An effect's columns on the residual's rows."""
    context = residual.context_of(effect)
    columns, row = residual.rows_of(effect.columns(context, place, shape))
    scale = effect.scale(context, place, shape)
    return Hypothesis(effect, place, shape, columns, row, scale, odds)


def elsewhere(h: Hypothesis, residual: Residual) -> Hypothesis:
    """The same hypothesis on another log, with the first one's prior."""
    context = residual.context_of(h.effect)
    columns, row = residual.rows_of(h.effect.columns(context, h.place, h.shape))
    return dataclasses.replace(h, columns=columns, row=row)
