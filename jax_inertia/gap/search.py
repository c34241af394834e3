"""The search for what the model lacks, and its second pass where the model is worse than its sensors.

The first pass takes the sensors for the only noise. Where that leaves more than noise, what is left after the best
effects is itself whitened (`Whitener.then`) and the search begins again: now effects and the nominal model's tolerances
compete against the errors that are really there, and neither is bent to fit them.
"""

import dataclasses
import functools
from collections.abc import Callable, Collection

import numpy as np
from jaxtyping import Float

from jax_inertia.diagnosis.features.context import Context
from jax_inertia.gap.candidate import Candidate, effect_torque
from jax_inertia.gap.chance import at_random
from jax_inertia.gap.constancy import Inconstant, inconstant
from jax_inertia.gap.doubt import better_than, share_of_others, standing
from jax_inertia.gap.evidence import Evidence
from jax_inertia.gap.finder import LOUDER, Finder, Selection
from jax_inertia.gap.noise import Whitener
from jax_inertia.gap.nuisance import CAUSES, nuisances
from jax_inertia.gap.outcome import Search
from jax_inertia.gap.pool import Pool
from jax_inertia.gap.propose import Rows
from jax_inertia.gap.select import WORSE
from jax_inertia.gap.slow import Slow
from jax_inertia.gap.strain import Left, Strained, strained, strangeness
from jax_inertia.gap.suited import at_their_best, bent_by
from jax_inertia.gap.together import remaining
from jax_inertia.gap.verdict import Verdict, doubted, judge, with_strain
from jax_inertia.signals.sensor_noise import stated


def search(finder: Finder, white: Whitener, told: Rows | None = None) -> Search:
    """One pass, against the noise of a whitener: what is told of each row, or what the sensors' leaves there."""
    return judged(finder, finder.selected(white, told))


def judged(finder: Finder, selection: Selection) -> Search:
    """What was chosen, with the verdict on it; or what is in place of numbers of the model that cannot be right."""
    found = _judged(finder, selection)
    beyond = [s.column for s in found.strains if _has_cause(finder, found.pool.evidence, s.column)]
    if not beyond:
        return found
    # A number that is off by more than its tolerance is not within it, and the library has an effect for it.
    pool = found.pool.charged_as(found.pool.evidence.pinning(beyond))
    freed = _judged(finder, finder.settled(pool, selection.white, selection.told))
    if freed.verdict is Verdict.EXPLAINED:
        return freed
    # It may stand for what the library lacks: then an effect in its place is the better guess, and no surer.
    return freed.no_surer_than(found) if freed.instead_of(found) else found


def _has_cause(finder: Finder, evidence: Evidence, column: int) -> bool:
    """Whether the library has the effect that an error of one of the model's numbers would be."""
    return CAUSES[evidence.kind(column)] in {family.name for family in finder.library}


def _judged(finder: Finder, selection: Selection) -> Search:
    """What was found, with the verdict on it."""
    pool, chosen, misfits = selection.pool, selection.chosen, selection.misfits
    against, alone = selection.against, selection.alone
    floor = float(selection.noise_by_row.sum())
    left = remaining(pool, chosen)
    known = stated(finder.log) or (misfits[-1] < LOUDER * floor and at_random(pool.evidence, left))
    strains = _strains(finder, pool, pool.evidence, left, chosen, alone)
    own = strains
    if chosen:
        own = _strains(finder, pool, pool.evidence, pool.evidence.y, [], ())
    slow = Slow.of(pool.evidence, finder.replicas, known)
    bare = strangeness(slow, floor, own)
    if chosen and strains and bare.most <= 1.0:
        # Effects that need the model's numbers bent, in a log that is within noise without either: the two undo
        # each other, as a weight and a force do, to fit the noise that both carry.
        chosen, misfits, strains = [], misfits[:1], []
    rival = better_than(pool, chosen, float(against.sum()))
    changing = _changing(pool, chosen, against)
    verdict, in_doubt, missed = Verdict.of_nothing(bare, rival is not None), 0.0, None
    if chosen:
        allowed = sum((c.excuses(c.effect) + c.stirred for c in chosen), start=0.0)
        verdict = judge(misfits, floor, allowed, known)
        errors = [c.family.form_error * c.effect for c in chosen]
        if verdict is Verdict.EXPLAINED and (missed := slow.missed(left, errors)) is not None:
            verdict = doubted(verdict, missed.share)
        if verdict is Verdict.UNKNOWN and _are_causes(finder, pool.evidence, chosen, left, WELL):
            verdict = Verdict.PARTLY
        verdict = with_strain(verdict, strains, misfits[0] - misfits[-1], allowed)
        stand = standing(chosen, rival, changing)
        in_doubt = share_of_others(pool, chosen, stand)
        verdict = doubted(verdict, in_doubt)
        if verdict is Verdict.UNKNOWN and _are_several(finder, pool.evidence, stand):
            verdict = Verdict.PARTLY
    return Search(
        pool, selection.white, finder.replicas, chosen, selection.ranking, misfits, floor, known, finder.torque_noise,
        against, rival, changing, in_doubt, verdict, bare, missed, strains,
    )  # fmt: skip


def _strains(
    finder: Finder,
    pool: Pool,
    evidence: Evidence,
    left: Float[np.ndarray, " n"],
    chosen: list[Candidate],
    alone: Collection[int],
) -> list[Strained]:
    """Numbers of the model that are beyond their tolerances where effects leave so much of the log (`strained`)."""
    noisier = _noisier(finder, pool)
    found = strained(Left(evidence, left), alone, noisier and noisier(chosen))
    return [s for s in found if s.name not in bent_by(chosen)]


def charged(context: Context, evidence: Evidence, c: Candidate) -> Float[np.ndarray, " n"]:
    """A found effect in the metric of any evidence of this log."""
    return evidence.charged(context.prepared.finish_torque(effect_torque(context, c)))


def _are_several(finder: Finder, evidence: Evidence, stand: list[Candidate]) -> bool:
    """Whether effects that stand are too many to be one cause in disguise, and most of them explain their rows."""
    if len(stand) < SEVERAL:
        return False
    left = evidence.y - np.sum([charged(finder.context, evidence, c) for c in stand], axis=0)
    return _are_causes(finder, evidence, stand, left, MOSTLY)


def _are_causes(
    finder: Finder,
    evidence: Evidence,
    chosen: list[Candidate],
    left: Float[np.ndarray, " n"],
    share: float,
) -> bool:
    """Whether two effects, and half of all, leave less than a share of the energy on the rows where they act."""
    before, after = evidence.by_row(evidence.y), evidence.by_row(left)
    rows = [evidence.acted_on(effect_torque(finder.context, c)) for c in chosen]
    explained = [after[acts].sum() < share * before[acts].sum() for acts in rows]
    return bool(sum(explained) >= max(2, len(chosen) / 2))


def _noisier(finder: Finder, pool: Pool) -> Callable[[list[Candidate]], Callable[[], Left]] | None:
    """What effects leave of the log with its noise added again, where columns are as noisy as what is missing."""
    if not finder.context.robot.has_free_base:
        return None
    context = pool.echo.context

    @functools.cache
    def evidence() -> Evidence:
        own, columns = pool.evidence, nuisances(context, finder.tolerance, finder.log)
        again = Evidence(finder.again, own.whitener, columns, own.scales, own.used)
        return again.pinning(own.pinned)

    def left(chosen: list[Candidate]) -> Left:
        torque = finder.again.missing - sum(effect_torque(context, c) for c in chosen)
        return Left(evidence(), evidence().charged(finder.again.finish_torque(torque)))

    return lambda chosen: functools.partial(left, chosen)


def _changing(pool: Pool, chosen: list[Candidate], noise: Rows) -> Inconstant | None:
    """`inconstant`, but for what the model's numbers would take, however far off: that is no change of an effect."""
    wide, fitted = at_their_best(pool, chosen, noise)
    found = inconstant(wide, fitted, float(noise.sum()))
    if found is None:
        return None
    own = next(c for c, x in zip(chosen, fitted, strict=True) if x is found.effect)
    return dataclasses.replace(found, effect=own)


def find(finder: Finder) -> tuple[Search, Search]:
    """The first pass and the last, which are one where the sensors' noise is all there is."""
    finder, selection = finder.by_its_torques()
    first = judged(finder, selection)
    if (
        first.verdict in (Verdict.EXPLAINED, Verdict.NO_GAP)
        or first.misfits[-1] < WORSE * first.noise
    ):
        return first, first
    evidence = first.pool.evidence
    # Charged twice: what is left once the nuisances, too, are at their best.
    left = evidence.unflatten(evidence.charge(remaining(first.pool, first.chosen)[:, None])[:, 0])
    first.pool.forget()
    white, told = finder.white.then(left, evidence.used), evidence.used.sum(axis=0) * 1.0
    second = search(finder, white, told)
    if not second.chosen:
        return first, first
    # It was whitened to its own misses, so they look like noise to it: the first pass's measure stays the judge.
    effects = [charged(finder.context, evidence, c) for c in second.chosen]
    left = evidence.y - np.sum(effects, axis=0)
    misfits = [first.misfits[0], float(left @ left)]
    allowed = sum((c.excuses(e) for c, e in zip(second.chosen, effects, strict=True)), start=0.0)
    verdict, missed = judge(misfits, first.floor, allowed, first.known), None
    if verdict is Verdict.EXPLAINED:
        errors = [c.family.form_error * e for c, e in zip(second.chosen, effects, strict=True)]
        missed = Slow.of(evidence, finder.replicas, first.known).missed(left, errors)
        verdict = doubted(verdict, 0.0 if missed is None else missed.share)
    strains = _strains(finder, first.pool, evidence, left, second.chosen, ())
    verdict = with_strain(verdict, strains, misfits[0] - misfits[1], allowed)
    verdict = doubted(verdict, second.in_doubt)
    stand = standing(second.chosen, second.rival, second.inconstant)
    causes = second.verdict is Verdict.PARTLY or _are_several(finder, evidence, stand)
    if verdict is Verdict.UNKNOWN and causes:
        verdict = Verdict.PARTLY
    return first, dataclasses.replace(second, verdict=verdict, missed=missed, strains=strains)


# An effect that leaves less than the one share of the energy where it acts is a cause though much is left elsewhere.
# One cause that is not in the library may look like two or three that are, and hardly like as many as this: there the
# other share will do.
WELL, MOSTLY, SEVERAL = 0.1, 0.3, 4
