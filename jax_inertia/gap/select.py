"""Which effects: forward with joint refits, then backward and swaps."""

import copy
import dataclasses
import itertools

import numpy as np
from jaxtyping import Bool, Float

from jax_inertia.gap import locate
from jax_inertia.gap.block import Beside
from jax_inertia.gap.candidate import Candidate
from jax_inertia.gap.evidence import acting
from jax_inertia.gap.loudness import Loudness
from jax_inertia.gap.pool import Pool
from jax_inertia.gap.propose import STOP, Rows, faint, loudness, propose, score
from jax_inertia.gap.shrink import what_is_left
from jax_inertia.gap.together import misfit, remaining, solved, stacked


def select(
    pool: Pool, max_effects: int, floor: Rows
) -> tuple[list[Candidate], list[Candidate], list[float]]:
    """(chosen effects, the first step's ranking, misfit J after 0, 1, 2 ... effects).

    `floor` is the J that noise alone would have on each row. A leader that is heard beside all rows as one and not
    beside its own is the first of several causes there, or beside what no effect explains: both ways on are tried, and
    the other end is taken where it is better.
    """
    path = _path(pool, [], max_effects, floor, own_rows=False)
    chosen = path.chosen
    if path.parts is not None:
        other = _path(pool, path.parts, max_effects, floor, own_rows=True).chosen
        if _better(pool, other, chosen, floor):
            chosen = other
        pool.look_again(windows(pool, chosen, floor))
    return chosen, path.ranking, [misfit(pool, chosen[:k]) for k in range(len(chosen) + 1)]


@dataclasses.dataclass(frozen=True)
class _Path:
    """Where forward steps ended."""

    chosen: list[Candidate]
    ranking: list[Candidate]
    """Of the first step."""
    parts: list[Candidate] | None
    """Effects beside which some leader was first heard beside all rows as one and not beside its own: there the ways
    part."""


def _path(
    pool: Pool, chosen: list[Candidate], max_effects: int, floor: Rows, *, own_rows: bool
) -> _Path:
    """Forward steps beside those chosen; `own_rows`: a leader has to be heard beside those on which it acts."""
    ranking: list[Candidate] = []
    parts = None
    while len(chosen) < max_effects:
        pool.look_again(windows(pool, chosen, floor))
        step = propose(pool, chosen, floor)
        if not chosen:
            ranking = step
        own, all_ = _heard(pool, chosen, step[0], floor) if step else (False, False)
        if parts is None and all_ and not own:
            parts = chosen
        heard = own or (all_ and not own_rows)
        more = _with_one_more(pool, chosen, step, max_effects, floor, heard=heard)
        more = more or split(pool, chosen, floor)
        if not more:
            break
        chosen = more
    return _Path(chosen, ranking, parts)


def _with_one_more(
    pool: Pool,
    chosen: list[Candidate],
    step: list[Candidate],
    max_effects: int,
    floor: Rows,
    *,
    heard: bool,
) -> list[Candidate]:
    """The chosen and the best beside them, or two that hide each other; none where what is left is no further cause."""
    if not step:
        return []
    if not heard:
        pair = [] if chosen or max_effects < 2 else _hidden_by_each_other(pool, step[0], floor)
        if pair or loudness(pool, chosen, floor).quiet:
            return pair
        step = propose(pool, chosen, floor, by_row=True)
        if not step or not _heard(pool, chosen, step[0], floor)[0]:
            return []
    trial = settle(pool, [*chosen, step[0]], floor)
    if len(trial) > 1:
        trial = swap(pool, prune(pool, trial, floor), floor)
        # Significance is not materiality: beside a large effect, the error of its own equation is significant.
        if len(trial) <= len(chosen) or material(pool, chosen, trial) < STOP:
            return []
    return trial


# One of two effects explains this share, at least, of what an effect does that draws both.
DRAWN, SPLITS = 0.8, 3


def split(pool: Pool, chosen: list[Candidate], floor: Rows) -> list[Candidate]:
    """The chosen with two effects in place of one that has more numbers and draws both; none where there are none such.

    A force at a point of a body can draw a tilt and a bias at once, better than either does alone.
    """
    for c in [x for x in chosen if x.size > 1]:
        others = [x for x in chosen if x is not c]
        alone = misfit(pool, others)
        drawn = alone - misfit(pool, chosen)
        simpler: dict[str, Candidate] = {}
        for x in propose(pool, others, floor):
            if x.size < c.size and x.gain > DRAWN * drawn:
                simpler.setdefault(x.family.name, x)
        for first in list(simpler.values())[:SPLITS]:
            some = settle(pool, [*others, first], floor)
            step = propose(pool, some, floor)
            # What passes would draw whatever the first leaves; and a load's own centre and inertia are no second cause.
            here = first.place == c.place
            if not step or step[0].family.passing or (here and step[0].place == c.place):
                continue
            trial = settle(pool, [*some, step[0]], floor)
            if len(trial) > len(chosen) and _likelier(pool, trial, chosen, floor, by=STOP):
                return trial
    return []


def _hidden_by_each_other(pool: Pool, first: Candidate, floor: Rows) -> list[Candidate]:
    """The first and the best beside it, where either alone takes the other for noise; none where they are no better."""
    chosen = settle(pool, [first], floor)
    step = propose(pool, chosen, floor)
    if not step or faint(pool, step[0], floor):
        return []
    trial = swap(pool, settle(pool, [*chosen, step[0]], floor), floor)
    return trial if min(_worth(pool, trial, floor)) >= STOP else []


def _worth(pool: Pool, chosen: list[Candidate], floor: Rows) -> list[float]:
    """The score of each effect beside the others: what it brings materially, less the price of its numbers."""
    loud = loudness(pool, chosen, floor)
    rests = ([x for x in chosen if x is not c] for c in chosen)
    return [
        loud.counted(material_by_row(pool, rest, chosen)) - c.price(pool.evidence.rows)
        for c, rest in zip(chosen, rests, strict=True)
    ]


def windows(pool: Pool, chosen: list[Candidate], floor: Rows) -> tuple[tuple[float, float], ...]:
    """Stretches of time that stand out of what effects leave.

    Also of what is left with the model's numbers right: bent to a hard push, they spread it over the whole log.
    """
    left = remaining(pool, chosen)
    sides = (left, pool.evidence.without_tolerances(left[:, None])[:, 0])
    return tuple(sorted({w for x in sides for w in locate.windows(pool.evidence, x, floor.sum())}))


def _heard(pool: Pool, chosen: list[Candidate], added: Candidate, floor: Rows) -> tuple[bool, bool]:
    """Whether an effect brings enough beside what is left on the rows where it acts, and beside all rows as one.

    Noise is itself estimated: once a cause is found, structure in a hundredth of the noise on those rows is none.
    """
    if faint(pool, added, floor):
        return False, False
    enough = STOP
    if chosen:
        enough += 0.01 * floor[acting(pool.evidence.by_row(added.effect))].sum()
    loud = loudness(pool, [*chosen, added], floor)
    own, all_ = (bool(score(added, x) >= enough) for x in (loud, loud.evenly))
    return own, all_


def material(pool: Pool, fewer: list[Candidate], more: list[Candidate]) -> float:
    """`material_by_row`, of all rows."""
    return float(np.sum(material_by_row(pool, fewer, more)))


def material_by_row(pool: Pool, fewer: list[Candidate], more: list[Candidate]) -> Rows:
    """Drop of the misfit from `fewer` effects to `more` that errors of the shared effects' equations cannot buy.

    Row by row, and while what passes lasts: what rattles at one joint excuses nothing at another, nor what is off
    all along what happens once, nor what happens once anything at another time. What a joint's law misses comes in
    bursts, where it turns round: at any time.
    """
    unflatten = pool.evidence.unflatten
    before, after = (unflatten(remaining(pool, chosen)) ** 2 for chosen in (fewer, more))
    added = [c for c in more if not any(c.same_cause(x) for x in fewer)]
    when = np.ones(len(before), bool)
    if added and all(c.family.passing for c in added):
        when = _lasts(np.sum([unflatten(c.effect) ** 2 for c in added], axis=0))
    drops = (before - after) * when[:, None]
    drop = np.sum(drops, axis=0)
    for c in fewer:
        if any(c.same_cause(x) for x in more):
            energy = unflatten(c.effect) ** 2
            there = slice(None) if c.family.kind == "joint" else when
            excused = c.family.form_error**2 * np.sum(energy[there], axis=0)
            if c.family.passing:
                excused = np.minimum(excused, np.maximum(drops[_lasts(energy)].sum(axis=0), 0.0))
            drop -= excused
    return np.maximum(drop, 0.0)


def _lasts(energy: Float[np.ndarray, "T nv"]) -> Bool[np.ndarray, " T"]:
    """While what passes is there."""
    at = np.sum(energy, axis=1)
    return at > LASTS * at.max()


# What passes is there where its energy is more than this share of its highest.
LASTS = 0.01


# Numbers have settled when another round brings less of the misfit than this share.
SETTLED = 1e-4


def settle(pool: Pool, chosen: list[Candidate], floor: Rows) -> list[Candidate]:
    """Refit all numbers together: each in turn against what the others leave, then all θ at once."""
    for _ in range(3 if len(chosen) > 1 else 1):
        before = misfit(pool, chosen)
        loud = loudness(pool, chosen, floor)
        for i, c in enumerate(chosen):
            others = [x for k, x in enumerate(chosen) if k != i]
            left = Beside.of(pool.evidence, *stacked(pool, others), loud)
            refit = pool.fit_again(c, left)
            if refit is not None:
                chosen = [refit if k == i else x for k, x in enumerate(chosen)]
        columns, target = stacked(pool, chosen)
        theta = solved(columns, target, np.concatenate([c.theta for c in chosen]))
        parts = np.split(theta, np.cumsum([len(c.theta) for c in chosen])[:-1])
        if all(
            c.family.physical(pool.context, c.place, c.shape, x)
            for c, x in zip(chosen, parts, strict=True)
        ):
            chosen = [_at(c, x) for c, x in zip(chosen, parts, strict=True)]
        if before - misfit(pool, chosen) < SETTLED * before:
            break
    return chosen


def _at(c: Candidate, theta: Float[np.ndarray, " p"]) -> Candidate:
    """The same with other numbers: the effects of another way on keep theirs."""
    out = copy.copy(c)
    out.theta = theta
    return out


def prune(pool: Pool, chosen: list[Candidate], floor: Rows) -> list[Candidate]:
    """Drop effects that the others have made redundant."""
    while len(chosen) > 1:
        worth = _worth(pool, chosen, floor)
        weakest = int(np.argmin(worth))
        if worth[weakest] < STOP:
            chosen = settle(pool, [x for k, x in enumerate(chosen) if k != weakest], floor)
            continue
        fewer = _as_one(pool, chosen, floor)
        if fewer is None:
            break
        chosen = fewer
    return chosen


def _as_one(pool: Pool, chosen: list[Candidate], floor: Rows) -> list[Candidate] | None:
    """The chosen with one effect for two on one body, where it draws both once its numbers are sought anew.

    Beside another change of the body a load's numbers may have settled far from its own: alone it may need none.
    """
    loud = loudness(pool, chosen, floor)
    for one, other in itertools.permutations(chosen, 2):
        if one.place != other.place or one.family.size is None:
            continue
        rest = [c for c in chosen if c is not one and c is not other]
        left = Beside.of(pool.evidence, *stacked(pool, rest), loud)
        for family in (one.family, one.family.freer):
            for again in pool.best_at([one.shape], family, one, left) if family else ():
                trial = settle(pool, [*rest, again], floor)
                worth = loud.counted(material_by_row(pool, trial, chosen))
                if worth - other.price(pool.evidence.rows) < STOP:
                    return trial
    return None


def swap(pool: Pool, chosen: list[Candidate], floor: Rows) -> list[Candidate]:
    """Try each chosen effect's place for another: forward steps alone lose the smaller of two."""
    for _ in range(2):
        improved = False
        for i in range(len(chosen)):
            others = [x for k, x in enumerate(chosen) if k != i]
            options = propose(pool, others, floor)
            if not options or options[0].same_as(chosen[i]):
                continue
            trial = settle(pool, [*others[:i], options[0], *others[i:]], floor)
            # Beside the others, the same cause at its place may do with fewer numbers, or a law that it contains.
            if _contained(options[0], chosen[i]) or _likelier(pool, trial, chosen, floor):
                chosen, improved = trial, True
        if not improved:
            break
    return chosen


def _contained(these: Candidate, those: Candidate) -> bool:
    """Whether one is the other with fewer numbers, at its place."""
    if these.place != those.place:
        return False
    return these.family.freer is those.family or these.family.name in those.family.simpler


def _better(pool: Pool, these: list[Candidate], those: list[Candidate], floor: Rows) -> bool:
    """Whether other effects are likelier, or, where both leave far more than noise, foretell more of the log.

    There the noise is not what it is taken for, and likelihood in its units prefers what fits where sensors are best.
    What is left in newton metres, each stretch predicted from the others, is what the effects are wanted for.
    """
    worse = min(misfit(pool, x) for x in (these, those)) > WORSE * floor.sum()
    if not (worse or pool.evidence.whitener.of_misses):
        return _likelier(pool, these, those, floor)
    used = pool.evidence.used
    sizes = [float(np.sum(what_is_left(pool, x, foretold=True)[used] ** 2)) for x in (these, those)]
    return sizes[0] < sizes[1]


# A model is worse than its sensors where more than this multiple of the noise's misfit is left.
WORSE = 3.0
# By how much likelier (twice the log of the odds) effects are than those they are swapped for.
SWAPS = 6.0


def _likelier(
    pool: Pool, these: list[Candidate], those: list[Candidate], floor: Rows, by: float = SWAPS
) -> bool:
    """Whether what effects leave and what their numbers cost is less than with others in their place."""
    left = [remaining(pool, x) for x in (these, those)]
    loud = Loudness.of(pool.evidence, min(left, key=lambda x: x @ x), floor)
    prices = [sum(c.price(pool.evidence.rows) + c.surprise for c in x) for x in (these, those)]
    costs = [
        loud.counted(pool.evidence.by_row(x)) + price for x, price in zip(left, prices, strict=True)
    ]
    return bool(costs[0] < costs[1] - by)
