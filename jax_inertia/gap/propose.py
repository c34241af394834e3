"""Which effect to add to those that are chosen: every candidate at every place, the leading ones refined.

A candidate's score is the drop of the charged misfit J it brings to those already chosen, against the noise the data
still show, less the price of its numbers: ΔJ/s² − p ln n − 2 ln(grid).
"""

import numpy as np
from jaxtyping import Float

from jax_inertia.diagnosis.effects.base import Shape
from jax_inertia.gap.block import Beside
from jax_inertia.gap.candidate import Candidate
from jax_inertia.gap.loudness import Loudness
from jax_inertia.gap.pool import Pool
from jax_inertia.gap.together import misfit, remaining, stacked
from jax_inertia.gap.verdict import DOUBT

Rows = Float[np.ndarray, " nv"]

# An effect must bring this much score (twice the log of the odds, about) to be added to what is chosen.
STOP = 30.0


def propose(
    pool: Pool, chosen: list[Candidate], floor: Rows, *, by_row: bool = False
) -> list[Candidate]:
    """Candidates to add, best first, the leading ones refined; simpler families first where they do as well.

    `floor`: the misfit that noise leaves on each row. `by_row`: each is scored against what is left on the rows where
    it acts, not on all rows as one. A row is also loud by a cause that is yet to be found, so by row the first of
    several would be one that keeps off the others' rows; but on all as one, a quiet row's cause is lost beside a row
    that no effect explains.
    """
    columns, target = stacked(pool, chosen)
    noise = float(floor.sum())
    # Of the first step all are told; on rows of its own, a cause that explains little may be the loudest.
    share = 0.0 if by_row or not chosen else LITTLE
    ranked = others(pool, chosen, columns, target, share)
    if not ranked:
        return []
    before = misfit(pool, chosen)

    def scored(every: list[Candidate]) -> Loudness:
        """Scores against what the best of them leaves; how loud that is."""
        loud = loudness(pool, [*chosen, max(every, key=lambda c: c.gain)], floor)
        loud = loud if by_row else loud.evenly
        for c in every:
            c.score = score(c, loud)
        every.sort(key=lambda c: -c.score)
        return loud

    loud = scored(ranked)
    left = Beside.of(pool.evidence, columns, target, loud)
    # Between grid points a candidate gains some; one that is far behind does not catch up.
    near = [c for c in ranked[:8] if c.score > 0.25 * ranked[0].score]
    lead = _led(pool, near, left)
    freed = _freed(pool, lead, left, floor)
    # Six free numbers draw some of anything: they are a cause where little else is left.
    freed = [f for f in freed if before - f.gain - noise < max(0.2 * noise, DOUBT**2 * before)]
    for c in lead:
        c.score = score(c, loud)
    _told_in_band(lead, left)
    ranked = sorted([*lead, *ranked[len(near) :]], key=lambda c: -c.score)
    if any(f.gain > ranked[0].gain for f in freed):
        ranked = [*ranked, *freed]
        scored(ranked)
    return _parsimonious(ranked, before, noise)


def score(c: Candidate, loud: Loudness) -> float:
    """What a candidate explains against the noise beside it, less what its numbers cost."""
    return c.gain / c.noise(loud) - c.price(c.block.evidence.rows) - c.surprise


# What explains less than this share of what another cause does, beside the same effects, does not lead.
LITTLE = 0.1
# What passes is refined on its own where at the leader's time it explains this share of what the leader does.
CLOSE = 0.8


def _led(pool: Pool, near: list[Candidate], left: Beside) -> list[Candidate]:
    """The leading candidates refined.

    What happens in passing happens at one time, whatever it is done to: it is tried at the leader's time too.
    """
    lead: list[Candidate] = []
    for c in near:
        times = _times(lead) if c.family.passing else []
        start = max([c, *pool.best_at(times, c.family, c, left)], key=lambda x: x.aim)
        behind = bool(times) and start.gain < CLOSE * max(x.gain for x in lead)
        lead.append(start if behind else pool.refined(start, left, everywhere=not times))
    return [_as_another(pool, c, lead, left) for c in lead]


def _as_another(pool: Pool, c: Candidate, lead: list[Candidate], left: Beside) -> Candidate:
    """A refined candidate, or from where the best other law at its place was refined to, whichever is better."""
    law = c.family.law_of
    others = [
        x for x in lead if law and x.family.law_of == law and x.place == c.place and x is not c
    ]
    if not others:
        return c
    shape = max(others, key=lambda x: x.gain).shape
    found = pool.best_at(c.family.as_another(pool.context, c.place, shape), c.family, c, left)
    return max([c, *(pool.between(x, left) for x in found)], key=lambda x: x.gain)


def _told_in_band(lead: list[Candidate], left: Beside) -> None:
    """Causes of a given size at one place, both judged in the motion's own band, are told apart where they are heard.

    Above, a controller's torque follows the encoders' noise, and a delay passes on more of that than a lag does; in
    the motion's own band alone a slow motion tells a delay from a lag by next to nothing.
    """
    given = [c for c in lead if c.family.slow and c.family.whole is not None]
    for place in {c.place for c in given}:
        twins = [c for c in given if c.place == place]
        if len(twins) < 2:
            continue
        effects = left.free(np.stack([c.effect for c in twins], axis=1))
        *heard, target = left.evidence.heard(np.column_stack([effects, left.target])).T
        # A size between two of those that were tried costs neither.
        seen = [float(e @ target) ** 2 / max(float(e @ e), 1e-300) for e in heard]
        gain, most = max(c.gain for c in twins), max(seen)
        for c, own in zip(twins, seen, strict=True):
            c.score += (gain - c.gain - (most - own)) / c.noise(left.loudness)


def _freed(pool: Pool, lead: list[Candidate], left: Beside, floor: Rows) -> list[Candidate]:
    """The causes of the leading candidates with more numbers; none where noise is not what it seems."""
    if pool.evidence.whitener.of_misses:
        return []
    out = []
    for c in lead:
        # More numbers make no event of what is none.
        if c.family.freer is not None and not faint(pool, c, floor):
            shapes = {c.shape, *(_times(lead) if c.family.passing else ())}
            out += pool.best_at(shapes, c.family.freer, c, left)
    return out


def _times(lead: list[Candidate]) -> list[Shape]:
    """When the best of what passes does; none where nothing does."""
    passing = [x for x in lead if x.family.passing]
    return [max(passing, key=lambda x: x.gain).shape] if passing else []


def _parsimonious(ranked: list[Candidate], before: float, floor: float) -> list[Candidate]:
    """Of the leader and what it contains, or is contained in, at its place: the simplest that does nearly as well.

    What the richer one brings decides, not its price: that is for numbers of which nothing is known before.
    """
    ranked = _carried(ranked)
    best = ranked[0]
    laws = [c for c in ranked if best.family.passing and not c.family.passing and c.score > STOP]
    for c in laws[:1]:
        if best.gain - c.gain < HAPPENED * best.gain:
            return [c, *(x for x in ranked if x is not c)]
    for c in ranked[1:]:
        if c.place != best.place or c.score <= STOP:
            continue
        over = max(before - max(best.gain, c.gain) - floor, 0.0)
        noise = 1.0 + over / max(floor, 1.0)
        simpler = c.family.name in best.family.simpler and not _set_apart(best, c, noise, over)
        richer = best.family.name in c.family.simpler and _set_apart(c, best, noise, over)
        if simpler or richer:
            return [c, *(x for x in ranked if x is not c)]
    return ranked


def _carried(ranked: list[Candidate]) -> list[Candidate]:
    """With a leader that bodies welded to each other show alike at the one of them that a joint carries.

    Where that weighs nothing (a frame before the link itself), at the first that does.
    """
    best = ranked[0]
    if not best.family.rigid:
        return ranked
    robot, at = best.block.evidence.prepared.robot, best.place.index
    same = (c for c in ranked if c.family is best.family)
    alike = [c for c in same if robot.topology.welded(c.place.index, at)]
    first = min(alike, key=lambda c: (robot.pi[c.place.index, 0] < WEIGHTLESS, c.place.index))
    return [first, *(x for x in ranked if x is not first)]


# A body that weighs less than this [kg] is a frame.
WEIGHTLESS = 1e-6


# What follows from a law that holds all along, but for this share of it, did not just happen at that time.
HAPPENED = 0.02
# No curve fits all that a simpler family's inexact equation misses: it brings the richer no more than so many times
# what that leaves beside the noise, and so much where it leaves none.
MISSED, UNSEEN = 2.0, 40.0


def _set_apart(rich: Candidate, simple: Candidate, noise: float, over: float) -> bool:
    """Whether a family brings more than noise and the inexact equation of the one it contains let it.

    `over`: misfit that the better of them leaves beyond the noise's.
    """
    inexact = min(simple.family.leeway * rich.gain, UNSEEN + MISSED * over)
    return _behind(rich, simple) >= max(rich.family.set_apart * noise, inexact)


def _behind(best: Candidate, simpler: Candidate) -> float:
    """How much less a simpler family brings; of two whose size is given, without what is the noise of either."""
    gain, aim = best.gain - simpler.gain, best.aim - simpler.aim
    return gain if simpler.family.whole is None else min(gain, aim)


def others(
    pool: Pool,
    chosen: list[Candidate],
    columns: np.ndarray,
    target: np.ndarray,
    share: float = 0.0,
) -> list[Candidate]:
    """Every candidate beside the chosen ones (`stacked`), fitted to what they leave.

    Without those that cannot explain a `share` of what the best does.
    """
    laws = {(c.family.law_of, c.place) for c in chosen if c.family.law_of}
    every = pool.best(Beside.of(pool.evidence, columns, target), share)
    return [
        c
        for c in every
        if (c.family.law_of, c.place) not in laws and not any(c.same_cause(x) for x in chosen)
    ]


def loudness(pool: Pool, chosen: list[Candidate], floor: Rows) -> Loudness:
    """How much louder than noise what effects leave is."""
    return Loudness.of(pool.evidence, remaining(pool, chosen), floor)


def faint(pool: Pool, added: Candidate, floor: Rows) -> bool:
    """Whether a burst holds no more than a tenth of the noise: spikes, or a reversal of friction, are as much."""
    worth = added.gain - added.price(pool.evidence.rows)
    return added.family.passing and bool(worth < STOP + 0.1 * floor.sum())
