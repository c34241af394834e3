"""Which effects: every candidate at every place, forward with joint refits, then backward and swaps.

A candidate's score is the drop of the charged misfit J it brings to those already chosen, against the noise the data
still show, less the price of its numbers: ΔJ/s² − p ln n − 2 ln(grid).
"""

from collections.abc import Iterator

import numpy as np

from jax_inertia.gap import locate
from jax_inertia.gap.candidate import Candidate, effect_torque
from jax_inertia.gap.nuisance import CAUSES
from jax_inertia.gap.pool import Pool
from jax_inertia.gap.scales import Learned, Learner


def select(
    pool: Pool, max_effects: int, floor: float
) -> tuple[list[Candidate], list[Candidate], list[float]]:
    """(chosen effects, the first step's ranking, misfit J after 0, 1, 2 ... effects).

    `floor` is the J that noise alone would have.
    """
    y = pool.evidence.y
    chosen: list[Candidate] = []
    misfits = [float(y @ y)]
    ranking: list[Candidate] = []
    while len(chosen) < max_effects:
        pool.look_again(_windows(pool, chosen, floor))
        step = propose(pool, chosen, floor)
        if not chosen:
            ranking = step
        if not step or step[0].score < _toll(chosen, floor) or _faint(pool, step[0], floor):
            break
        trial = settle(pool, [*chosen, step[0]])
        if len(trial) > 1:
            trial = swap(pool, prune(pool, trial, floor), floor)
            # Significance is not materiality: beside a large effect, the error of its own equation is significant.
            if len(trial) <= len(chosen) or material(pool, chosen, trial) < STOP:
                break
        chosen = trial
        misfits.append(misfit(pool, chosen))
    return chosen, ranking, misfits


def _windows(pool: Pool, chosen: list[Candidate], floor: float) -> tuple[tuple[float, float], ...]:
    """Stretches of time that stand out of what is left.

    Also of what is left with the model's numbers right: bent to a hard push, they spread it over the whole log.
    """
    left = remaining(pool, chosen)
    sides = (left, pool.evidence.without_tolerances(left[:, None])[:, 0])
    return tuple(sorted({w for x in sides for w in locate.windows(pool.evidence, x, floor)}))


def remaining(pool: Pool, chosen: list[Candidate]) -> np.ndarray:
    """What the chosen effects leave, in the charged metric."""
    columns, target = stacked(pool, chosen)
    if not columns.shape[1]:
        return target
    return target - columns @ np.linalg.lstsq(columns, target, rcond=None)[0]


# An effect must bring this much score (twice the log of the odds, about) to be added to what is chosen.
STOP = 30.0


def _redness(pool: Pool, chosen: list[Candidate], added: Candidate) -> float:
    """How many samples of what is left count as one: (1 + ρ)/(1 − ρ) of its lag-one correlation ρ."""
    left = pool.evidence.unflatten(remaining(pool, [*chosen, added]))
    rho = float(np.sum(left[1:] * left[:-1]) / max(float(np.sum(left**2)), 1e-300))
    rho = min(max(rho, 0.0), 0.9)
    return (1 + rho) / (1 - rho)


def _noise_beside(pool: Pool, chosen: list[Candidate], added: Candidate, floor: float) -> float:
    """Variance of one sample of what the best fit leaves, memory included, against the noise's."""
    noise = max(1.0, (misfit(pool, chosen) - added.gain) / max(floor, 1.0))
    return noise * _redness(pool, chosen, added) if noise > 1.2 else noise


def _others(
    pool: Pool, chosen: list[Candidate], columns: np.ndarray, target: np.ndarray
) -> list[Candidate]:
    """Every candidate beside the chosen ones (`stacked`), fitted to what they leave."""
    own = {c.key for c in chosen}
    return [c for c in pool.best(target, columns, 1.0) if c.key not in own]


# How many of the leading candidates may show that the model is better than its tolerances, and how many of its numbers.
LEADING, ASTRAY = 12, 3
# By how much likelier (twice the log) one effect, or one number that is off alone, makes the log with the tolerances
# that suit it, its price paid.
SUITS = 12.0


def suited(
    pool: Pool, chosen: list[Candidate], max_effects: int, floor: float
) -> tuple[dict[str, float], list[int]]:
    """Scales of the model's tolerances that suit the log beside what is chosen, and beside one more if that pays.

    With them, the tolerances' columns of numbers that are off alone: the others of their kind are right.

    One more effect, or one number of the model that is off while the others of its kind are right, where the library
    has an effect for it: within wide tolerances neither is remarkable, beside right numbers each is a finding.
    """
    columns, target = stacked(pool, chosen)
    rows = pool.evidence.rows
    ranked = sorted(_others(pool, chosen, columns, target), key=lambda c: -c.gain)[:LEADING]
    noise = _noise_beside(pool, chosen, ranked[0], floor) if ranked else 1.0
    learner = Learner(pool.evidence, noise)
    without = learner.beside(*_free(pool, chosen))
    freed = list(_freed(pool, chosen, learner, without))
    alone = [j for j, score, _ in freed if score > SUITS]
    if len(chosen) == max_effects:
        return without.scales, alone
    best, scales = SUITS, without.scales
    for c in ranked:
        if _faint(pool, c, floor):
            continue
        learned = learner.beside(*_free(pool, chosen, c))
        score = without.cost - learned.cost - c.price(rows)
        if score > best:
            best, scales = score, learned.scales
    known = {family.name for family in pool.library}
    for j, score, learned in freed:
        if score > best and CAUSES[pool.evidence.kind(j)] in known:
            best, scales = score, learned.scales
    return scales, alone


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


def _toll(chosen: list[Candidate], floor: float) -> float:
    """The score that an effect must bring, beside noise that is itself estimated.

    Once a cause is found, structure in a hundredth of the noise is none.
    """
    return STOP + (0.01 * floor if chosen else 0.0)


def _faint(pool: Pool, added: Candidate, floor: float) -> bool:
    """Whether a burst holds no more than a tenth of the noise: spikes, or a reversal of friction, are as much."""
    worth = added.gain - added.price(pool.evidence.rows)
    return added.family.passing and bool(worth < STOP + 0.1 * floor)


def material(pool: Pool, fewer: list[Candidate], more: list[Candidate]) -> float:
    """Drop of the misfit from `fewer` effects to `more` that errors of the shared effects' equations cannot buy.

    Row by row: what rattles at one joint excuses nothing at another.
    """
    unflatten = pool.evidence.unflatten
    before, after = (
        np.sum(unflatten(remaining(pool, chosen)) ** 2, axis=0) for chosen in (fewer, more)
    )
    keys = {c.key for c in more}
    allowed = sum(
        (
            c.family.form_error**2 * np.sum(unflatten(c.effect) ** 2, axis=0)
            for c in fewer
            if c.key in keys
        ),
        start=np.zeros_like(before),
    )
    return float(np.sum(np.maximum(before - after - allowed, 0.0)))


def row_energy(pool: Pool, c: Candidate) -> np.ndarray:
    """Energy of an effect on each row, in units of the row's noise."""
    return np.mean(effect_torque(pool.context, c) ** 2, axis=0) / pool.evidence.whitener.sigma**2


def propose(pool: Pool, chosen: list[Candidate], floor: float) -> list[Candidate]:
    """Candidates to add, best first, the leading ones refined; simpler families first where they do as well."""
    columns, target = stacked(pool, chosen)
    n = pool.evidence.rows
    ranked = _others(pool, chosen, columns, target)
    if not ranked:
        return []
    before = misfit(pool, chosen)

    def scored(every: list[Candidate]) -> float:
        """Scores against what the best of them leaves; that."""
        noise = _noise_beside(pool, chosen, max(every, key=lambda c: c.gain), floor)
        for c in every:
            c.score = c.gain / noise - c.price(n) - c.surprise
        every.sort(key=lambda c: -c.score)
        return noise

    noise = scored(ranked)
    # Between grid points a candidate gains some; one that is far behind does not catch up.
    near = [c for c in ranked[:8] if c.score > 0.25 * ranked[0].score]
    lead = [pool.refined(c, target, columns, noise) for c in near]
    freed = [f for c in lead if (f := pool.freed(c, target, columns)) is not None]
    ranked = sorted([*lead, *ranked[len(near) :]], key=lambda c: -c.score)
    if any(f.gain > ranked[0].gain for f in freed):
        ranked = [*ranked, *freed]
        scored(ranked)
    return _parsimonious(ranked, before, floor)


def _parsimonious(ranked: list[Candidate], before: float, floor: float) -> list[Candidate]:
    """Move a simpler family ahead of the leader where it explains nearly as much *and* fits nearly as well."""
    best = ranked[0]
    for c in ranked[1:]:
        if c.place != best.place or c.family.name not in best.family.simpler:
            continue
        noise = max(1.0, (before - best.gain) / max(floor, 1.0))
        if (
            best.gain - c.gain < max(best.family.set_apart * noise, 5e-4 * best.gain)
            and c.score > STOP
        ):
            return [c, *(x for x in ranked if x is not c)]
    return ranked


def solved(columns: np.ndarray, target: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Numbers that fit, as near to `start` as they come: along what a log does not tell they stay where they are."""
    scale = np.linalg.norm(columns, axis=0)
    scale[scale == 0] = 1.0
    return start + np.linalg.lstsq(columns / scale, target - columns @ start, rcond=1e-8)[0] / scale


# Numbers have settled when another round brings less of the misfit than this share.
SETTLED = 1e-4


def settle(pool: Pool, chosen: list[Candidate]) -> list[Candidate]:
    """Refit all numbers together: each in turn against what the others leave, then all θ at once."""
    for _ in range(3 if len(chosen) > 1 else 1):
        before = misfit(pool, chosen)
        for i, c in enumerate(chosen):
            others = [x for k, x in enumerate(chosen) if k != i]
            columns, target = stacked(pool, others)
            refit = pool.fit_again(c, target, columns)
            if refit is not None:
                chosen = [refit if k == i else x for k, x in enumerate(chosen)]
        columns, target = stacked(pool, chosen)
        theta = solved(columns, target, np.concatenate([c.theta for c in chosen]))
        parts = np.split(theta, np.cumsum([len(c.theta) for c in chosen])[:-1])
        if all(
            c.family.physical(pool.context, c.place, c.shape, x)
            for c, x in zip(chosen, parts, strict=True)
        ):
            for c, x in zip(chosen, parts, strict=True):
                c.theta = x
        if before - misfit(pool, chosen) < SETTLED * before:
            break
    return chosen


def prune(pool: Pool, chosen: list[Candidate], floor: float) -> list[Candidate]:
    """Drop effects that the others have made redundant."""
    while len(chosen) > 1:
        full = misfit(pool, chosen)
        noise = max(1.0, full / max(floor, 1.0))
        worth = []
        for i, c in enumerate(chosen):
            rest = [x for k, x in enumerate(chosen) if k != i]
            price = c.size * np.log(pool.evidence.rows)
            worth.append(material(pool, rest, chosen) / noise - price)
        weakest = int(np.argmin(worth))
        if worth[weakest] >= STOP:
            break
        chosen = settle(pool, [x for k, x in enumerate(chosen) if k != weakest])
    return chosen


def swap(pool: Pool, chosen: list[Candidate], floor: float) -> list[Candidate]:
    """Try each chosen effect's place for another: forward steps alone lose the smaller of two."""
    for _ in range(2):
        improved = False
        for i in range(len(chosen)):
            others = [x for k, x in enumerate(chosen) if k != i]
            options = propose(pool, others, floor)
            if not options or options[0].same_as(chosen[i]):
                continue
            trial = settle(pool, [*others[:i], options[0], *others[i:]])
            # Beside the others, the same cause at its place may do with fewer numbers.
            same = options[0].key == chosen[i].key
            fewer = same and options[0].family.freer is chosen[i].family
            if fewer or misfit(pool, trial) < misfit(pool, chosen) - STOP:
                chosen, improved = trial, True
        if not improved:
            break
    return chosen


def misfit(pool: Pool, chosen: list[Candidate]) -> float:
    """J with all θ free and the shapes as they are."""
    columns, target = stacked(pool, chosen)
    if not columns.shape[1]:
        return float(target @ target)
    theta = np.linalg.lstsq(columns, target, rcond=None)[0]
    return float(np.sum((target - columns @ theta) ** 2))


def stacked(pool: Pool, chosen: list[Candidate]) -> tuple[np.ndarray, np.ndarray]:
    """Columns of all θ together, and what they should come to: y less the offsets."""
    y = pool.evidence.y
    if not chosen:
        return np.zeros((len(y), 0)), y
    columns = np.concatenate([c.columns for c in chosen], axis=1)
    return columns, y - np.sum([c.offset for c in chosen], axis=0)
