"""Odd effects that were chosen before others were there, and whether another one would do better in their place now.

Effects come in one by one. What was chosen while a lag was not yet in the model, 20 to 1 or less before the next one,
was chosen to do some of the lag's work too.
"""

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float

from jax_inertia.replay.fitting.fit import Fit, fit
from jax_inertia.replay.record import Record
from jax_inertia.replay.search.candidates import Candidate
from jax_inertia.replay.search.held_out import Unseen
from jax_inertia.replay.search.odd import Odd, Search, fall
from jax_inertia.replay.search.parsimony import Parabola
from jax_inertia.replay.search.tries import ROUNDS, fitted_from, price, ranked, settled
from jax_inertia.replay.simulation.plant import Plant

_RIVALS = 3
"""Of an effect, that are tried."""


def exchanged(
    plant: Plant,
    search: Search,
    records: Sequence[Record],
    held_out: Sequence[Record],
    floor: Float[np.ndarray, " m"],
    progress: Callable[[str], None],
) -> Search:
    """The same search, with whatever is likelier in the place of an effect that has rivals and was not the last."""
    run = Unseen(plant, held_out, floor)
    for i in range(len(search.odd) - 1):
        # Of the search as it is now: an exchange moves the numbers of all others.
        o = search.odd[i]
        for rival in o.rivals[:_RIVALS]:
            progress(f"{rival.family} for {o.candidate.family}")
            tried = _instead(plant, search.found, o, rival, records, floor)
            if tried is not None and _likelier(plant, search.found, o, rival, tried, run):
                search = _with(search, o, rival, tried)
                break
    return search


def _instead(
    plant: Plant, found: Fit, o: Odd, rival: Candidate, records, floor: np.ndarray
) -> Fit | None:
    """The fit with a rival, whose numbers are last; None where its columns promise nothing."""
    keep = _others(found, o)
    table, theta, free = tuple(found.table[k] for k in keep), found.theta[keep], found.free[keep]
    bare = fit(plant, table, records, theta, free=free, floor=floor, rounds=ROUNDS)
    if rival.starts:
        order = ranked(plant, bare, [rival], records)
        if not order:
            return None
        start = order[0][2]
    else:
        # A load with its place: some of it, at its body's centre.
        start = 0.2 * np.array([p.sd for p in rival.parameters]) * (np.arange(4) == 0)
    first = fitted_from(plant, bare, rival, np.append(bare.theta, start), records, floor)
    return settled(plant, first, records, floor)


def _others(found: Fit, o: Odd) -> list[int]:
    return [k for k in range(len(found.table)) if k not in o.rows]


def _likelier(plant: Plant, found: Fit, o: Odd, rival: Candidate, tried: Fit, run: Unseen) -> bool:
    """By S, prices paid, and the runs that played no part."""
    now = Parabola(found, found.samples).worth()
    fell = fall(plant, found, now, rival, tried)[0] + price(found, o.candidate)
    return fell + run.likelier(run.errors(tried), run.errors(found), found.weights) > 0


def _with(search: Search, o: Odd, rival: Candidate, tried: Fit) -> Search:
    """A search whose effect `o` is a rival now, and the rival's rival."""
    place = {k: i for i, k in enumerate(_others(search.found, o))}
    count = len(tried.table)
    rows = tuple(range(count - len(rival.parameters), count))
    rivals = (o.candidate, *(c for c in o.rivals if c != rival))
    odd = []
    for other in search.odd:
        if other is o:
            odd.append(Odd(rival, rows, rivals))
        else:
            odd.append(other._replace(rows=tuple(place[k] for k in other.rows)))
    pool = [c for c in search.pool if (c.family, c.place) != (rival.family, rival.place)]
    return search._replace(found=tried, odd=tuple(odd), pool=(*pool, o.candidate))
