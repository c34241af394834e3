"""Candidates of the search tried at a size, and fitted: what the ways to start a fit have in common."""

from collections.abc import Iterator, Sequence

import numpy as np

from jax_inertia.replay.fitting.columns import together, touches
from jax_inertia.replay.fitting.errors import replay_errors
from jax_inertia.replay.fitting.fit import Fit, evaluated, fit
from jax_inertia.replay.joint_numbers import COORDINATES
from jax_inertia.replay.record import Record
from jax_inertia.replay.search.candidates import STEPPED, Candidate, centre_of
from jax_inertia.replay.search.parsimony import Parabola, Worth
from jax_inertia.replay.simulation.plant import Plant

AS_GOOD = 2.0 * float(np.log(20.0))
"""Of the cost: likelihoods that differ by less than twenty leave both possible."""
LOG_ODDS = float(np.log(20.0))
"""Against any one odd effect: one robot in twenty has it."""
ROUNDS = 4
"""Of a first fit."""
_AT_ONCE = 32


def numbers_of(c: Candidate) -> int:
    """How many numbers a candidate needs: every load is somewhere, and S counts the coordinates that are needed."""
    return sum(p.family not in COORDINATES for p in c.parameters)


def price(found: Fit, c: Candidate) -> float:
    """What S must fall by for a candidate: ln N for each number (BIC), and the odds against it."""
    if c.family == "payload_centre":
        return 0.0
    return numbers_of(c) * float(np.log(found.samples)) + 2.0 * LOG_ODDS


def column(c: Candidate, start: Sequence[float], change: np.ndarray) -> tuple[int, np.ndarray]:
    """(which number alone was tried, the error's change by one of it)."""
    off = np.array(start) - [p.nominal for p in c.parameters]
    k = int(np.flatnonzero(off)[0])
    return k, change / off[k]


Judged = tuple[Candidate, Worth, np.ndarray]


def at_best(
    plant: Plant, about: Parabola, pool: Sequence[Candidate], records: Sequence[Record]
) -> Iterator[Judged]:
    """(candidate, S, numbers) at each start; where columns grow with the numbers, once, at the best ones."""
    found, columns = about.found, {}
    tries = [(c, s) for c in pool for s in c.starts]
    for c, start, error in tried_errors(plant, found, tries, records):
        if not c.scales:
            yield c, about.worth(error), np.array(start)
            continue
        own = columns.setdefault(c, {})
        k, change = column(c, start, error - found.error)
        own[k] = change
        if len(own) == len(c.starts):
            tried, sizes = sorted(own), np.array(start)
            changes = np.array([own[i] for i in tried])
            del columns[c]
            worth, best = about.scaled([c.parameters[i] for i in tried], changes)
            sizes[tried] = best
            yield c, worth, sizes


def tried_errors(
    plant: Plant, found: Fit, tries: Sequence[tuple[Candidate, tuple[float, ...]]], records
) -> Iterator[tuple[Candidate, tuple[float, ...], np.ndarray]]:
    """Each candidate at a start with the error (N, n) there; those of separate trees of joints share replays.

    By what replays in long steps change.
    """
    if not tries:
        return
    quick = plant.quick
    now = replay_errors(quick, found.table, found.theta[None], records)[0]
    # What is stepped is stepped together.
    tries = sorted(tries, key=lambda x: x[0].family in STEPPED)
    rows = np.array(together([plant.tree_of(c.parameters[0]) for c, _ in tries]), int)
    for first in range(0, rows.max(initial=-1) + 1, _AT_ONCE):
        mine = np.flatnonzero((rows >= first) & (rows < first + _AT_ONCE)).tolist()
        more = [p for k in mine for p in tries[k][0].parameters]
        theta = np.concatenate([found.theta, [p.nominal for p in more]])
        thetas = np.repeat(theta[None], rows[mine].max() - first + 1, axis=0)
        at = len(found.table)
        for k in mine:
            thetas[rows[k] - first, at : at + len(tries[k][1])] = tries[k][1]
            at += len(tries[k][1])
        changed = replay_errors(quick, (*found.table, *more), thetas, records) - now
        for k in mine:
            c, start = tries[k]
            touched = touches(plant, c.parameters[:1], changed.shape[-1])[0]
            yield c, start, found.error + touched * changed[rows[k] - first]


def ranked(
    plant: Plant, found: Fit, pool: Sequence[Candidate], records
) -> list[tuple[float, Candidate, tuple[float, ...]]]:
    """Candidates by what they promise beyond their price, the best first: (by how much S falls, candidate, sizes)."""
    if not pool:
        return []
    about = Parabola(found, found.samples)
    now = about.worth().total
    best: dict[tuple, tuple] = {}
    for c, worth, sizes in at_best(plant, about, pool, records):
        gain, key = now - worth.total, (c.family, c.place)
        if (
            np.any(sizes)
            and gain > price(found, c) - AS_GOOD
            and (key not in best or gain > best[key][0])
        ):
            best[key] = gain, c, tuple(sizes)
    return sorted(best.values(), key=lambda x: price(found, x[1]) - x[0])


def fitted_from(plant, found: Fit, c: Candidate, theta: np.ndarray, records, floor) -> Fit:
    """A fit with a candidate, from numbers of its own; those of the candidate are last."""
    table = (*found.table, *c.parameters)
    free = np.append(found.free, np.ones(len(c.parameters), bool))
    return fit(plant, table, records, theta, free=free, floor=floor, rounds=ROUNDS)


def fitted(plant, found: Fit, c: Candidate, start, records, floor) -> Fit:
    """A first fit with a candidate."""
    table = (*found.table, *c.parameters)
    theta = np.append(found.theta, start)
    new = np.zeros(len(table), bool)
    new[len(found.table) :] = True
    error, columns = evaluated(plant, table, records, theta, new)
    columns[: len(found.table)] = found.columns
    free = np.append(found.free, np.ones(len(c.parameters), bool))
    return fit(
        plant, table, records, theta, free=free, floor=floor, rounds=ROUNDS, known=(error, columns),
        mended_only=True,
    )  # fmt: skip


def placed(
    plant: Plant, load: Candidate, tried: Fit, records: Sequence[Record], floor: np.ndarray
) -> list[tuple[Candidate, Fit]]:
    """A load with a place of its own on its link, which is how it competes, and the fit; none of what is no load."""
    out = []
    for _, c, start in ranked(plant, tried, centre(plant, load, tried), records)[:1]:
        whole = Candidate(load.family, (*load.parameters, *c.parameters), ())
        new = fitted(plant, tried, c, start, records, floor)
        out.append((whole, settled(plant, new, records, floor)))
    return out


def centre(plant: Plant, load: Candidate, tried: Fit) -> list[Candidate]:
    """Where a load may be, its numbers last in a fit: what a link lacks is taken from where it is, and has no place."""
    if load.family != "payload" or len(load.parameters) > 1 or tried.theta[-1] <= 0:
        return []
    return [c for c in (centre_of(load, plant),) if c is not None]


def settled(plant: Plant, tried: Fit, records: Sequence[Record], floor: np.ndarray) -> Fit:
    """A fit, gone on with by Jacobians of its own."""
    return fit(
        plant, tried.table, records, tried.theta, free=tried.free, floor=floor, rounds=2 * ROUNDS,
        known=(tried.error, tried.columns), exact=True,
    )  # fmt: skip
