"""A log made ready for the search: its noise, what may be found in it, and which of that is chosen against the noise.

Effects, the scales of the model's tolerances and, where the log states none, its torques' noise are found in turn.
"""

import dataclasses

import numpy as np
from jaxtyping import Float

from jax_inertia.diagnosis.features.band import Band
from jax_inertia.diagnosis.features.context import Context
from jax_inertia.gap.candidate import Candidate
from jax_inertia.gap.chance import noise_in
from jax_inertia.gap.evidence import Evidence, moving
from jax_inertia.gap.families.base import Family
from jax_inertia.gap.moderate import moderated
from jax_inertia.gap.motors import by_samples, torque_noise, with_torque_noise
from jax_inertia.gap.noise import Whitener, whitener
from jax_inertia.gap.nuisance import Nuisances, Tolerance, nuisances
from jax_inertia.gap.pool import Echo, Pool
from jax_inertia.gap.propose import Rows
from jax_inertia.gap.select import select
from jax_inertia.gap.suited import suited
from jax_inertia.gap.together import remaining
from jax_inertia.logs.log import Log
from jax_inertia.signals.sensor_noise import stated
from jax_inertia.signals.torque_residual import Prepared


@dataclasses.dataclass(frozen=True)
class Selection:
    """Effects that are chosen against a noise, before anything is said of them."""

    pool: Pool
    white: Whitener
    told: Rows | None
    """Misfit on each row that they compete against where it is not the noise's own."""
    noise_by_row: Rows
    """Misfit that noise alone leaves on each row."""
    chosen: list[Candidate]
    ranking: list[Candidate]
    """All candidates at the first step, best first."""
    misfits: list[float]
    """Charged misfit J after 0, 1, 2 ... effects."""
    scales: dict[str, float]
    """Of the model's tolerances, as they suit the log beside these effects."""
    alone: list[int]
    """Numbers of the model that are off while the others of their kind are right: columns of the tolerances."""

    @property
    def against(self) -> Rows:
        """Misfit on each row that the effects compete against."""
        return self.noise_by_row if self.told is None else self.told


@dataclasses.dataclass(frozen=True)
class Finder:
    """A log made ready, and what may be found in it."""

    context: Context
    white: Whitener
    replicas: np.ndarray
    again: Prepared
    nuisances: Nuisances
    library: list[Family]
    max_effects: int
    log: Log
    tolerance: Tolerance
    torque_noise: np.ndarray | None

    def selected(self, white: Whitener, told: Rows | None = None) -> Selection:
        """Effects against the noise of a whitener: what is told of each row, or what the sensors' leaves there."""
        context = self.context
        evidence = Evidence(context.prepared, white, self.nuisances)
        again = evidence.charged(self.again.finish_torque(self.again.missing))
        noise_of_y = evidence.without_tolerances((again - evidence.y)[:, None])[:, 0]
        echo = Echo(context.echo(self.again), noise_of_y)
        return self.settled(Pool(context, evidence, self.library, echo), white, told)

    def settled(self, pool: Pool, white: Whitener, told: Rows | None) -> Selection:
        """Effects and the scales of the model's tolerances, found in turn."""
        found = self._chosen(pool, white, told)
        for _ in range(ROUNDS):
            if found.scales == found.pool.evidence.scales:
                break
            pool = pool.charged_as(pool.evidence.rescaled(found.scales))
            found = self._chosen(pool, white, told)
        return found

    def _chosen(self, pool: Pool, white: Whitener, told: Rows | None) -> Selection:
        """Effects beside the scales as they are, and the scales that suit them."""
        rows = pool.evidence.noise_by_row(self.replicas)
        against = rows if told is None else told
        chosen, ranking, misfits = select(pool, self.max_effects, against)
        chosen = moderated(pool, chosen)
        scales, alone = suited(pool, chosen, self.max_effects, against)
        return Selection(pool, white, told, rows, chosen, ranking, misfits, scales, alone)

    def by_its_torques(self) -> tuple["Finder", Selection]:
        """The first pass, against the noise that the log's torques turn out to have where it states none.

        Effects hide in noise that is taken for less than it is, and stand out of it once it is known; so the two are
        found in turn.
        """
        finder = self
        if not stated(self.log):
            evidence = Evidence(self.context.prepared, self.white, self.nuisances)
            finder = self._as_loud_as(evidence, evidence.y, louder=False)
        found = finder.selected(finder.white)
        for _ in range(ROUNDS):
            evidence, left = found.pool.evidence, remaining(found.pool, found.chosen)
            noise = noise_in(evidence, left)
            if stated(self.log) and not (noise and finder._more_than_noise(*noise)):
                break
            other = finder._as_loud_as(*(noise or (evidence, left)), louder=noise is not None)
            if other is finder:
                break
            finder, found = other, other.selected(other.white)
        return finder, found

    def _more_than_noise(self, evidence: Evidence, left: Float[np.ndarray, " n"]) -> bool:
        """Whether some row has more energy left than its noise, so that there is noise to learn."""
        return bool(np.any(evidence.by_row(left) > LOUDER * evidence.noise_by_row(self.replicas)))

    def _as_loud_as(
        self, evidence: Evidence, left: Float[np.ndarray, " n"], *, louder: bool
    ) -> "Finder":
        """This finder, or one for as much torque noise as what is left shows."""
        log, prepared, taken = self.log, self.context.prepared, self.torque_noise
        if taken is None:
            taken = by_samples(log, prepared.robot)
        noise, factor = torque_noise(
            evidence, left, self.replicas, log, prepared, taken, louder=louder
        )
        if factor < LOUDER:
            return self
        return _made(prepared, log, self.tolerance, self.library, self.max_effects, noise)


def finder(
    prepared: Prepared,
    log: Log,
    tolerance: Tolerance,
    library: list[Family],
    max_effects: int,
) -> Finder:
    """Prepare a search. Raises ValueError for a log in which nothing moves."""
    if (count := int(moving(prepared).sum())) < LEAST:
        raise ValueError(
            f"{count} samples are of joints that move, at least {LEAST} are needed: friction at rest is whatever "
            "balances, so a robot that stands still tells nothing"
        )
    return _made(prepared, log, tolerance, library, max_effects, None)


def _made(
    prepared: Prepared,
    log: Log,
    tolerance: Tolerance,
    library: list[Family],
    max_effects: int,
    noise: np.ndarray | None,
) -> Finder:
    """A finder that takes torques for as noisy as told [N m], or as the log's samples show."""
    white, replicas, again = whitener(prepared, with_torque_noise(log, prepared.robot, noise))
    context = Context(prepared, Band.of(prepared, again))
    own = nuisances(context, tolerance, log)
    return Finder(context, white, replicas, again, own, library, max_effects, log, tolerance, noise)


# Samples below which a search would fit noise.
LEAST = 100
# Effects and the tolerances' scales are found in turn; more seldom changes either.
ROUNDS = 3
# Torque noise learned from what is left counts where some row's noise becomes this many times as loud, or as quiet.
LOUDER = 1.3
