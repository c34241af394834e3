"""Where a search ended: what was found, what it leaves, and what speaks against it."""

import dataclasses

import numpy as np

from jax_inertia.gap.candidate import Candidate
from jax_inertia.gap.constancy import Inconstant
from jax_inertia.gap.noise import Whitener
from jax_inertia.gap.outsiders import Outsider
from jax_inertia.gap.pool import Pool
from jax_inertia.gap.propose import Rows
from jax_inertia.gap.slow import Missed
from jax_inertia.gap.strain import Strained, Strangeness
from jax_inertia.gap.verdict import Verdict


@dataclasses.dataclass(frozen=True)
class Search:
    """Where a search ended."""

    pool: Pool
    white: Whitener
    replicas: np.ndarray
    """Draws of the sensors' noise in the finished missing torque, (K, R, nv)."""
    chosen: list[Candidate]
    ranking: list[Candidate]
    """All candidates at the first step, best first."""
    misfits: list[float]
    """Charged misfit J after 0, 1, 2 ... effects."""
    floor: float
    """J that noise alone would leave."""
    known: bool
    """Whether the log states its noise, or what is left is at random and as loud as it was taken for."""
    torque_noise: np.ndarray | None
    """Of each row, where the log states none and shows another than its samples do [N m]."""
    noise_by_row: Rows
    """J on each row that the noise leaves which the effects competed against: `floor`'s, or more in a second pass."""
    rival: tuple[list[Candidate], Outsider] | None
    """Found effects, and what fits better in their place and is no family."""
    inconstant: Inconstant | None
    """A found effect whose size would have to change."""
    in_doubt: float
    """Share of what was explained that effects brought which do not stand, each by itself."""
    verdict: Verdict
    """What can be said of the effects together."""
    bare: Strangeness
    """What the log shows without any effect."""
    missed: Missed | None
    """What the effects leave in the motion's own band, where all that they leave is within the noise."""
    strains: list[Strained]
    """Numbers of the model that are beyond their tolerances, beside the effects."""

    @property
    def noise(self) -> float:
        """J that this noise leaves in all."""
        return float(self.noise_by_row.sum())

    def instead_of(self, other: "Search") -> bool:
        """Whether an effect that the other lacks makes this log with less than the other grants its model."""
        own, others = ({(c.family.name, c.place) for c in s.chosen} for s in (self, other))
        return bool(own - others) and self._needed < other._needed

    def no_surer_than(self, other: "Search") -> "Search":
        """This, but unknown where the other is."""
        unknown = other.verdict is Verdict.UNKNOWN
        return dataclasses.replace(self, verdict=Verdict.UNKNOWN) if unknown else self

    @property
    def _needed(self) -> float:
        """Misfit, what numbers beyond their tolerances take of it, and the price of effects."""
        granted = sum(x.energy for x in self.strains)
        prices = sum(c.price(self.pool.evidence.rows) for c in self.chosen)
        return float(self.misfits[-1] + granted + prices)
