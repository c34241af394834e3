"""Scales of the nominal model's tolerances that suit a log, and numbers of the model that are off alone."""

import dataclasses
from collections.abc import Iterator

import numpy as np

from jax_inertia.gap.candidate import Candidate
from jax_inertia.gap.nuisance import CAUSES
from jax_inertia.gap.pool import Pool
from jax_inertia.gap.propose import Rows, faint, loudness, others
from jax_inertia.gap.scales import GRID, Learned, Learner
from jax_inertia.gap.select import settle
from jax_inertia.gap.together import misfit, remaining, stacked

# How many of the leading candidates may show that the model is better than its tolerances, and how many of its numbers.
LEADING, ASTRAY = 12, 3
# By how much likelier (twice the log) one effect, or one number that is off alone, makes the log with the tolerances
# that suit it, its price paid.
SUITS = 12.0


def suited(
    pool: Pool, chosen: list[Candidate], max_effects: int, floor: Rows
) -> tuple[dict[str, float], list[int]]:
    """Scales of the model's tolerances that suit the log beside what is chosen, and beside one more if that pays.

    With them, the tolerances' columns of numbers that are off alone: the others of their kind are right.

    One more effect, or one number of the model that is off while the others of its kind are right, where the library
    has an effect for it: within wide tolerances neither is remarkable, beside right numbers each is a finding.
    """
    columns, target = stacked(pool, chosen)
    rows = pool.evidence.rows
    ranked = sorted(others(pool, chosen, columns, target), key=lambda c: -c.gain)[:LEADING]
    noise = loudness(pool, [*chosen, ranked[0]], floor).whole if ranked else 1.0
    # Whitened to what a model misses, a log has lost most of what would hold tolerances back.
    most = 1.0 if pool.evidence.whitener.of_misses else GRID[0]
    learner = Learner(pool.evidence, noise, most)
    without = learner.beside(*_free(pool, chosen))
    freed = list(_freed(pool, chosen, learner, without))
    alone = [j for j, score, _ in freed if score > SUITS]
    if len(chosen) == max_effects:
        return _told(pool, chosen, without.scales), alone
    best, scales = SUITS, without.scales
    for c in ranked:
        if faint(pool, c, floor):
            continue
        learned = learner.beside(*_free(pool, chosen, c))
        score = without.cost - learned.cost - c.price(rows)
        if score > best:
            best, scales = score, learned.scales
    known = {family.name for family in pool.library}
    for j, score, learned in freed:
        if score > best and CAUSES[pool.evidence.kind(j)] in known:
            best, scales = score, learned.scales
    return _told(pool, chosen, scales), alone


def _told(pool: Pool, chosen: list[Candidate], scales: dict[str, float]) -> dict[str, float]:
    """The scales; as they were for a kind whose every number is a chosen effect's own, as none is left to tell."""
    evidence = pool.evidence
    own = {(c.family.name, c.place.name) for c in chosen}
    telling = {
        kind
        for kind, name in ((evidence.kind(j), x) for j, x in enumerate(evidence.named))
        if (CAUSES[kind], name.removeprefix(f"{kind} of ")) not in own
    }
    return {kind: x if kind in telling else evidence.scales[kind] for kind, x in scales.items()}


def at_their_best(pool: Pool, chosen: list[Candidate], floor: Rows) -> tuple[Pool, list[Candidate]]:
    """The chosen, in their order, beside the tolerances that suit them, however wide: where those were kept narrow."""
    if not (chosen and pool.evidence.whitener.of_misses):
        return pool, chosen
    noise = max(1.0, misfit(pool, chosen) / max(float(floor.sum()), 1.0))
    scales = Learner(pool.evidence, noise).beside(*_free(pool, chosen)).scales
    if scales == pool.evidence.scales:
        return pool, chosen
    pool = pool.charged_as(pool.evidence.rescaled(scales))
    charged = [dataclasses.replace(c, block=c.block.charged_as(pool.evidence)) for c in chosen]
    return pool, settle(pool, charged, floor)


def bent_by(chosen: list[Candidate]) -> set[str]:
    """Numbers of the model that the effects themselves change beyond their equations."""
    return {f"{kind} of {c.place.name}" for c in chosen for kind in c.family.bends}


def _free(pool: Pool, chosen: list[Candidate], *added: Candidate) -> tuple[np.ndarray, np.ndarray]:
    """`stacked`, and the numbers of the model that the chosen change beyond their equations free as well.

    Of an effect that is only tried they are not: it would be let off their price.
    """
    columns, target = stacked(pool, [*chosen, *added])
    names = bent_by(chosen)
    bent = [j for j, name in enumerate(pool.evidence.named) if name in names]
    return np.hstack([columns, *(pool.evidence.charged_tolerance(j) for j in bent)]), target


def _freed(
    pool: Pool, chosen: list[Candidate], learner: Learner, without: Learned
) -> Iterator[tuple[int, float, Learned]]:
    """The numbers that are strained most: column, score of letting each be free, and the scales that suit the rest."""
    evidence = pool.evidence
    columns, target = _free(pool, chosen)
    price = np.log(evidence.rows) + 2 * np.log(len(evidence.named))
    for j in evidence.furthest(remaining(pool, chosen), ASTRAY):
        if evidence.named[j] in bent_by(chosen):
            continue
        learned = learner.beside(np.hstack([columns, evidence.charged_tolerance(j)]), target)
        yield j, without.cost - learned.cost - price, learned
