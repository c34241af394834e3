"""The search for what the model lacks, and its second pass where the model is worse than its sensors.

The first pass takes the sensors for the only noise. Where that leaves more than noise, what is left after the best
effects is itself whitened (`Whitener.then`) and the search begins again: now effects and the nominal model's tolerances
compete against the errors that are really there, and neither is bent to fit them.
"""

import dataclasses
import functools
from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from jax_inertia.gap.band import Band
from jax_inertia.gap.candidate import Candidate, effect_torque
from jax_inertia.gap.chain import Prepared
from jax_inertia.gap.constancy import Inconstant, inconstant
from jax_inertia.gap.context import Context
from jax_inertia.gap.doubt import better_than, entangled, share_of_others, standing
from jax_inertia.gap.evidence import Evidence, moving
from jax_inertia.gap.families.base import Family
from jax_inertia.gap.motors import by_samples, torque_noise, with_torque_noise
from jax_inertia.gap.noise import Whitener, at_random, whitener
from jax_inertia.gap.nuisance import CAUSES, Nuisances, Tolerance, nuisances
from jax_inertia.gap.outcome import Search
from jax_inertia.gap.pool import Echo, Pool
from jax_inertia.gap.propose import Rows
from jax_inertia.gap.select import WORSE, select
from jax_inertia.gap.sensors import stated
from jax_inertia.gap.slow import Slow
from jax_inertia.gap.strain import Left, strained, strangeness
from jax_inertia.gap.suited import at_their_best, bent_by, suited
from jax_inertia.gap.together import remaining
from jax_inertia.gap.verdict import Verdict, doubted, judge, with_strain
from jax_inertia.log import Log


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

    def search(self, white: Whitener, noise: Rows | None = None) -> Search:
        """One pass, against the noise of a whitener: what is told of each row, or what the sensors' leaves there."""
        context = self.context
        evidence = Evidence(context.prepared, white, self.nuisances)
        again = evidence.charged(self.again.finish_torque(self.again.missing))
        noise_of_y = evidence.without_tolerances((again - evidence.y)[:, None])[:, 0]
        echo = Echo(context.echo(self.again), noise_of_y)
        pool = Pool(context, evidence, self.library, echo)
        found = self._settled(pool, white, noise)
        beyond = [s.column for s in found.strains if self._has_cause(pool.evidence, s.column)]
        if not beyond:
            return found
        # A number that is off by more than its tolerance is not within it, and the library has an effect for it.
        evidence = found.pool.evidence.pinning(beyond)
        freed = self._settled(found.pool.charged_as(evidence), white, noise)
        if freed.verdict is Verdict.EXPLAINED:
            return freed
        # It may stand for what the library lacks: then an effect in its place is the better guess, and no surer.
        return freed.no_surer_than(found) if freed.instead_of(found) else found

    def _settled(self, pool: Pool, white: Whitener, noise: Rows | None) -> Search:
        """Effects and the scales of the model's tolerances, found in turn."""
        floor, against, (chosen, ranking, misfits) = self._selected(pool, noise)
        scales, alone = suited(pool, chosen, self.max_effects, against)
        for _ in range(ROUNDS):
            if scales == pool.evidence.scales:
                break
            pool = pool.charged_as(pool.evidence.rescaled(scales))
            floor, against, (chosen, ranking, misfits) = self._selected(pool, noise)
            scales, alone = suited(pool, chosen, self.max_effects, against)
        return self._judged(pool, white, floor, against, chosen, ranking, misfits, alone)

    def _has_cause(self, evidence: Evidence, column: int) -> bool:
        """Whether the library has the effect that an error of one of the model's numbers would be."""
        return CAUSES[evidence.kind(column)] in {family.name for family in self.library}

    def _judged(
        self,
        pool: Pool,
        white: Whitener,
        floor: float,
        against: Rows,
        chosen: list[Candidate],
        ranking: list[Candidate],
        misfits: list[float],
        alone: list[int],
    ) -> Search:
        """What was found, with the verdict on it; `floor` is the misfit of noise alone, `alone` as of `suited`."""
        left = remaining(pool, chosen)
        known = stated(self.log) or (
            misfits[-1] < LOUDER * floor and self._at_random(pool.evidence, left)
        )
        noisier = self._noisier(pool)
        strains = [
            s
            for s in strained(Left(pool.evidence, left), alone, noisier and noisier(chosen))
            if s.name not in bent_by(chosen)
        ]
        own = strains
        if chosen:
            own = strained(Left(pool.evidence, pool.evidence.y), (), noisier and noisier([]))
        slow = Slow.of(pool.evidence, self.replicas, known)
        bare = strangeness(slow, floor, own)
        if chosen and strains and bare.most <= 1.0:
            # Effects that need the model's numbers bent, in a log that is within noise without either: the two undo
            # each other, as a weight and a force do, to fit the noise that both carry.
            chosen, misfits, strains = [], misfits[:1], []
        rival = better_than(pool, chosen, float(against.sum()))
        changing = _changing(pool, chosen, against)
        apart, in_doubt, missed = Verdict.of_nothing(bare, rival is not None), 0.0, None
        if chosen:
            allowed = sum((c.excuses(c.effect) + c.stirred for c in chosen), start=0.0)
            apart = judge(misfits, floor, allowed, known)
            if apart is Verdict.EXPLAINED and (missed := slow.missed(left, chosen)) is not None:
                apart = doubted(apart, missed.share)
            if apart is Verdict.UNKNOWN and self._are_causes(pool.evidence, chosen, left, WELL):
                apart = Verdict.PARTLY
            apart = with_strain(apart, strains, misfits[0] - misfits[-1], allowed)
            stand = standing(chosen, rival, changing)
            in_doubt = share_of_others(pool, chosen, stand)
            apart = doubted(apart, in_doubt)
            if apart is Verdict.UNKNOWN and self.are_several(pool.evidence, stand):
                apart = Verdict.PARTLY
        return Search(
            pool, white, self.replicas, chosen, ranking, misfits, floor, known, self.torque_noise,
            against, rival, changing, in_doubt, entangled(pool, chosen), apart, bare, missed, strains,
        )  # fmt: skip

    def charged(self, evidence: Evidence, c: Candidate) -> Float[np.ndarray, " n"]:
        """A found effect in the metric of any evidence of this log."""
        drawn = effect_torque(self.context, c)
        return evidence.charged(self.context.prepared.finish_torque(drawn))

    def are_several(self, evidence: Evidence, stand: list[Candidate]) -> bool:
        """Whether effects that stand are too many to be one cause in disguise, and most of them explain their rows."""
        if len(stand) < SEVERAL:
            return False
        left = evidence.y - np.sum([self.charged(evidence, c) for c in stand], axis=0)
        return self._are_causes(evidence, stand, left, MOSTLY)

    def _are_causes(
        self,
        evidence: Evidence,
        chosen: list[Candidate],
        left: Float[np.ndarray, " n"],
        share: float,
    ) -> bool:
        """Whether two effects, and half of all, leave less than a share of the energy on the rows where they act."""
        before, after = evidence.by_row(evidence.y), evidence.by_row(left)
        rows = [evidence.acted_on(effect_torque(self.context, c)) for c in chosen]
        explained = [after[acts].sum() < share * before[acts].sum() for acts in rows]
        return bool(sum(explained) >= max(2, len(chosen) / 2))

    def _noisier(self, pool: Pool) -> Callable[[list[Candidate]], Callable[[], Left]] | None:
        """What effects leave of the log with its noise added again, where columns are as noisy as what is missing."""
        if not self.context.robot.has_free_base:
            return None
        context = pool.echo.context

        @functools.cache
        def evidence() -> Evidence:
            own, columns = pool.evidence, nuisances(context, self.tolerance, self.log)
            again = Evidence(self.again, own.whitener, columns, own.scales, own.used)
            return again.pinning(own.pinned)

        def left(chosen: list[Candidate]) -> Left:
            torque = self.again.missing - sum(effect_torque(context, c) for c in chosen)
            return Left(evidence(), evidence().charged(self.again.finish_torque(torque)))

        return lambda chosen: functools.partial(left, chosen)

    def _at_random(self, evidence: Evidence, left: np.ndarray) -> bool:
        """Whether what effects leave looks like noise."""
        period = 1.0 / self.context.prepared.settings.decimated
        return at_random(evidence.unflatten(left), period)

    def by_its_torques(self) -> tuple["Finder", Search]:
        """The first pass, against the noise that the log's torques turn out to have where it states none.

        Effects hide in noise that is taken for less than it is, and stand out of it once it is known; so the two are
        found in turn.
        """
        finder = self
        if not stated(self.log):
            evidence = Evidence(self.context.prepared, self.white, self.nuisances)
            finder = self._as_loud_as(evidence, evidence.y, louder=False)
        found = finder.search(finder.white)
        for _ in range(ROUNDS):
            evidence, left = found.pool.evidence, remaining(found.pool, found.chosen)
            louder = self._at_random(evidence, left)
            if stated(self.log) and not (louder and finder._more_than_noise(evidence, left)):
                break
            other = finder._as_loud_as(evidence, left, louder=louder)
            if other is finder:
                break
            finder, found = other, other.search(other.white)
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

    def _selected(self, pool: Pool, noise: Rows | None):
        """The noise's own misfit, the misfit that effects compete against, and what `select` finds against it."""
        rows = pool.evidence.noise_by_row(self.replicas)
        against = rows if noise is None else noise
        return float(rows.sum()), against, select(pool, self.max_effects, against)


def _changing(pool: Pool, chosen: list[Candidate], noise: Rows) -> Inconstant | None:
    """`inconstant`, but for what the model's numbers would take, however far off: that is no change of an effect."""
    wide, fitted = at_their_best(pool, chosen, noise)
    found = inconstant(wide, fitted, float(noise.sum()))
    if found is None:
        return None
    own = next(c for c, x in zip(chosen, fitted, strict=True) if x is found.effect)
    return dataclasses.replace(found, effect=own)


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


def find(finder: Finder) -> tuple[Search, Search]:
    """The first pass and the last, which are one where the sensors' noise is all there is."""
    finder, first = finder.by_its_torques()
    if (
        first.verdict in (Verdict.EXPLAINED, Verdict.NO_GAP)
        or first.misfits[-1] < WORSE * first.noise
    ):
        return first, first
    evidence = first.pool.evidence
    # Charged twice: what is left once the nuisances, too, are at their best.
    left = evidence.unflatten(evidence.charge(remaining(first.pool, first.chosen)[:, None])[:, 0])
    first.pool.forget()
    second = finder.search(
        finder.white.then(left, evidence.used), noise=evidence.used.sum(axis=0) * 1.0
    )
    if not second.chosen:
        return first, first
    # It was whitened to its own misses, so they look like noise to it: the first pass's measure stays the judge.
    effects = [finder.charged(evidence, c) for c in second.chosen]
    after = float(np.sum((evidence.y - np.sum(effects, axis=0)) ** 2))
    allowed = sum((c.excuses(e) for c, e in zip(second.chosen, effects, strict=True)), start=0.0)
    verdict = judge([first.misfits[0], after], first.floor, allowed, first.known)
    verdict = doubted(verdict, second.in_doubt)
    stand = standing(second.chosen, second.rival, second.inconstant)
    causes = second.verdict is Verdict.PARTLY or finder.are_several(evidence, stand)
    if verdict is Verdict.UNKNOWN and causes:
        verdict = Verdict.PARTLY
    return first, dataclasses.replace(second, apart=verdict)


# Samples below which a search would fit noise.
LEAST = 100
# An effect that leaves less than the one share of the energy where it acts is a cause though much is left elsewhere.
# One cause that is not in the library may look like two or three that are, and hardly like as many as this: there the
# other share will do.
WELL, MOSTLY, SEVERAL = 0.1, 0.3, 4
# Effects and the tolerances' scales are found in turn; more seldom changes either.
ROUNDS = 3
# Torque noise learned from what is left counts where some row's noise becomes this many times as loud, or as quiet.
LOUDER = 1.3
