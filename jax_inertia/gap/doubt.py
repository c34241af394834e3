"""Whether what was found may stand, or something that no family is does better.

A mechanical stop is no push, though it happens in passing, and oil that drags as the square of speed is no spring. So
each found effect, and all of them together, are tried against every outsider (`outsiders`): where one fits better by
more than its numbers cost and than the found equations' own errors may leave, the cause is not in the library.
"""

import numpy as np

from jax_inertia.gap.candidate import Beside, Candidate
from jax_inertia.gap.constancy import Inconstant, crowded
from jax_inertia.gap.outsiders import Outsider, outsiders
from jax_inertia.gap.pool import Pool
from jax_inertia.gap.propose import STOP
from jax_inertia.gap.select import SWAPS
from jax_inertia.gap.together import misfit, remaining, stacked


def better_than(
    pool: Pool, chosen: list[Candidate], noise: float
) -> tuple[list[Candidate], Outsider] | None:
    """Found effects and the outsider that should be in their place; None where all stand.

    Where nothing was found, an outsider that does better than nothing.
    """
    others = outsiders(pool)
    if not chosen:
        others = [o for o in others if o.beyond.shape[1]]
    now = float(np.sum(remaining(pool, chosen) ** 2))
    unit = max(1.0, now / max(noise, 1.0))
    best, most = None, 0.0
    for replaced in _replaceable(chosen):
        kept = [c for c in chosen if not any(c is r for r in replaced)]
        rest = Beside.of(pool.evidence, *stacked(pool, kept))
        size = sum(c.size for c in replaced)
        allowed = sum(c.excuses(c.effect) for c in replaced)
        enough = STOP
        if replaced and replaced[0].family.passing:
            # Any bump may be drawn by enough pushes: what one misses is excused as far as it is there. But what happens
            # where a joint is, or by its speed, and would be drawn by one seldom is: fewer numbers speak for it. Where
            # it draws several, it need do so no better than a push's equation is good: events seldom recur as one law.
            several = len(replaced) > 1 and all(c.family.passing for c in replaced)
            allowed = -allowed if several else min(allowed, max(now - noise, 0.0))
            enough = SWAPS + 2 * np.log(len(others))
        for o in others:
            columns = o.columns if replaced else o.beyond
            free = rest.free(columns)
            left = np.linalg.lstsq(free, rest.target, rcond=None)
            after = float(np.sum((rest.target - free @ left[0]) ** 2))
            price = (columns.shape[1] - size) * np.log(pool.evidence.rows)
            if not replaced:
                # It is the best of many, and nothing else speaks for it.
                price += 2 * np.log(len(others))
            won = (now - after - allowed) / unit - price - enough
            if won > most:
                best, most = (replaced, o), won
    return best


def _replaceable(chosen: list[Candidate]) -> list[list[Candidate]]:
    """Effects that one cause may be behind: each alone, all that happen in passing, and all there are."""
    if not chosen:
        return [[]]
    passing = [c for c in chosen if c.family.passing]
    alone = [[c] for c in chosen if not c.family.passing]
    groups = [*alone, *([passing] if passing else [])]
    return [*groups, chosen] if len(groups) > 1 else groups


def leans_on(pool: Pool, chosen: list[Candidate]) -> tuple[Outsider, float]:
    """The outsider that fits best what the effects leave, and its share of that."""
    left = remaining(pool, chosen)
    total = max(float(left @ left), 1e-300)
    shares = [(o, float(np.sum((o.columns.T @ left) ** 2)) / total) for o in outsiders(pool)]
    return max(shares, key=lambda x: x[1])


def standing(
    chosen: list[Candidate],
    rival: tuple[list[Candidate], Outsider] | None,
    changing: Inconstant | None,
) -> list[Candidate]:
    """The effects that nothing speaks against, each by itself."""
    fallen = [
        *(rival[0] if rival else ()),
        *([changing.effect] if changing else ()),
        *(crowded(chosen) or ()),
    ]
    return [c for c in chosen if not any(c is f for f in fallen)]


def share_of_others(pool: Pool, chosen: list[Candidate], some: list[Candidate]) -> float:
    """Share of the misfit explained that effects brought which are not among some; zero where all are."""
    if len(some) == len(chosen):
        return 0.0
    nothing, part, whole = (misfit(pool, x) for x in ([], some, chosen))
    return float(np.clip((part - whole) / max(nothing - whole, 1e-300), 1e-6, 1.0))
