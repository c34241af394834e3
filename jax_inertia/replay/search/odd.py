"""What may be wrong beyond what every robot has: candidates that compete on what the ordinary numbers leave.

Each is tried at a few sizes, the ordinary numbers following along the cost's parabola, or given up; the best few are
fitted, and the best of them stays if evidence and a replay that played no part both ask for it.
"""

import itertools
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jax_inertia.replay import fit as fitting
from jax_inertia.replay.fit import Fit
from jax_inertia.replay.loop import ORDINARY
from jax_inertia.replay.plant import Plant
from jax_inertia.replay.record import Record
from jax_inertia.replay.search import by_law
from jax_inertia.replay.search import held_out as unseen
from jax_inertia.replay.search.by_law import AS_GOOD
from jax_inertia.replay.search.candidates import VARYING, Candidate, candidates, centre_of
from jax_inertia.replay.search.parsimony import Parabola, Worth, nominal

MOST = 6
LOG_ODDS = float(np.log(20.0))
"""Against any one odd effect: one robot in twenty has it."""
_GAIN = 0.02
_FINALISTS, _ROUNDS, _AT_ONCE = 4, 4, 32
_AFRESH, _STIFFER = 3, (0.0, 0.35, 0.7, 1.1)
"""Fits from afresh: how many, and by what logarithms gains are raised."""
_FROM_NOMINAL = 1
_GIVES = 1e-3
"""By what a joint gives before it slides, to start from [rad]."""
_SETTLED = 2
"""Of the effects that pass, how many are fitted until they settle before one is chosen.

Along a valley where ordinary numbers make room for an effect a first fit goes part of the way, of one effect more than
of another: a payload at the shank came to 0.10 of its 0.32 kg, and one at the thigh was nearer to its own end.
"""
_CONTENDERS = 0.3
"""Of the best one's gain, what another one must promise to be fitted, and have to be fitted until it settles."""


class Search(NamedTuple):
    """What the search for odd effects leaves."""

    found: Fit
    odd: tuple["Odd", ...]
    possible: tuple[Candidate, ...]
    """That did not get in, by less than a twentieth of the probability."""
    pool: tuple[Candidate, ...]
    """All that did not get in."""


class Odd(NamedTuple):
    """An effect that was added: its numbers in the fit's table, and what would do nearly as well in its place."""

    candidate: Candidate
    rows: tuple[int, ...]
    rivals: tuple[Candidate, ...]


def add_odd(
    plant: Plant,
    found: Fit,
    records: Sequence[Record],
    held_out: Sequence[Record],
    torque: Float[np.ndarray, " n"],
    floor: Float[np.ndarray, " m"],
    exclude: Sequence[str],
    progress: Callable[[str], None],
) -> "Search":
    """The fit with odd effects added one by one, for as long as evidence and held-out replays both ask for them."""
    numbers = plant.numbers(found.table, found.theta, None)
    pool = [c for c in candidates(plant, records, numbers, torque) if c.family not in exclude]
    run, torque_logged = unseen.Unseen(plant, held_out), records[0].torque is not None
    out, possible, afresh = [], [], True
    for c in [c for c in pool if c.family == "presliding"]:
        # What every dry friction does comes first: all other numbers of a fit without it are a little off.
        progress("fitting friction that gives before it slides")
        theta = np.append(found.theta, _GIVES)
        tried = _fitted_from(plant, found, c, theta, records, floor, fitting.ROUNDS)
        if _judged(plant, found, [(c, tried)], run, run.missed(found))[0]:
            found, pool = tried, [x for x in pool if x != c]
            out.append(Odd(c, (len(found.table) - 1,), ()))
    best = run.missed(found)
    for k in range(MOST):
        progress(f"looking for odd effects, {k} found")
        excess, loops, here = _rms(found)[: len(plant.names)] / floor[: len(plant.names)], [], pool
        if torque_logged:
            excess = by_law.excess(plant, found, records, floor)
            loops, here = by_law.sought(pool, excess)
        # The loop's half first: its torque tells it, whatever the robot makes of it.
        passed, possible = {}, []
        for fits in _by_law(plant, found, loops, excess, records, floor):
            passed, more = _judged(plant, found, fits, run, best)
            possible += more
            if passed:
                break
        if not passed:
            fits = _finalists(plant, found, here, records, floor)
            if afresh:
                fits += _afresh(plant, found, here, excess, records, floor)
                fits += _limits_afresh(plant, found, here, excess, records, floor)
                fits += _from_nominal(plant, found, here, records, floor)
            passed, more = _judged(plant, found, fits, run, best)
            possible, afresh = [*possible, *more], False
        if not passed:
            break
        order = sorted(passed, key=lambda c: -passed[c][0])
        least = _CONTENDERS * passed[order[0]][0]
        near = [c for c in order[:_SETTLED] if passed[c][0] >= least]
        now = Parabola(found, plant.loop, found.samples).worth()
        for c in near:
            tried = _settled(plant, passed[c][1], records, floor)
            passed[c] = _evidence(plant, found, now, c, tried)[0], tried
        first = max(near, key=lambda c: passed[c][0])
        evidence, found = passed[first]
        best = run.missed(found)
        rows = tuple(range(len(found.table) - len(first.parameters), len(found.table)))
        rivals = tuple(c for c in order if passed[c][0] > evidence - AS_GOOD and c != first)
        pool = [c for c in pool if (c.family, c.place) != (first.family, first.place)]
        if first.family == "payload_centre":
            out = [o._replace(rows=o.rows + rows) if _is_load_of(o, first) else o for o in out]
            continue
        out.append(Odd(first, rows, rivals))
        if first.family == "payload" and (centre := centre_of(first, plant)) is not None:
            pool.append(centre)
    return Search(found, tuple(out), tuple(possible), tuple(pool))


def _judged(
    plant: Plant, found: Fit, fits: Sequence[tuple[Candidate, Fit]], run: unseen.Unseen, best
) -> tuple[dict[Candidate, tuple[float, Fit]], list[Candidate]]:
    """(those that evidence and held-out runs both ask for, with evidence and fit; those that are nearly as good)."""
    now = Parabola(found, plant.loop, found.samples).worth()
    passed: dict[Candidate, tuple[float, Fit]] = {}
    possible = []
    for c, tried in fits:
        evidence, kept = _evidence(plant, found, now, c, tried)
        # A number that does not carry over to another stretch is none of the robot's; one that stands for several
        # does if it does no harm.
        simpler = kept + len(c.parameters) < now.kept
        least = 1.0 + _GAIN if simpler else 1.0 - _GAIN
        if evidence > 0 and unseen.carries_over(run.missed(tried), best, least):
            if evidence > passed.get(c, (0.0,))[0]:
                passed[c] = evidence, tried
        elif evidence > -AS_GOOD:
            possible.append(c)
    return passed, possible


def _evidence(plant: Plant, found: Fit, now: Worth, c: Candidate, tried: Fit) -> tuple[float, int]:
    """(by how much S falls from `now` with a candidate, its price paid; how many ordinary numbers that keeps)."""
    new = Parabola(tried, plant.loop, found.samples, found.weights).worth()
    return now.total - new.total - _price(found, c), new.kept


def _rms(found: Fit) -> Float[np.ndarray, " m"]:
    """Of each output, rms."""
    return np.sqrt(np.mean(found.error**2, axis=0))


def _is_load_of(o: Odd, centre: Candidate) -> bool:
    return o.candidate.family == "payload" and o.candidate.place == centre.place


def _settled(plant: Plant, tried: Fit, records: Sequence[Record], floor: np.ndarray) -> Fit:
    """A fit, gone on with by Jacobians of its own."""
    return fitting.fit(
        plant, tried.table, records, tried.theta, free=tried.free, floor=floor, rounds=2 * _ROUNDS,
        known=(tried.error, tried.columns),
    )  # fmt: skip


def _price(found: Fit, c: Candidate) -> float:
    """What S must fall by for a candidate: ln N for each number (BIC), and the odds against it."""
    if c.family == "payload_centre":
        # Every load is somewhere, and S counts the coordinates that it needs.
        return 0.0
    return len(c.parameters) * float(np.log(found.samples)) + 2.0 * LOG_ODDS


def _finalists(
    plant: Plant,
    found: Fit,
    pool: Sequence[Candidate],
    records: Sequence[Record],
    floor: np.ndarray,
) -> list[tuple[Candidate, Fit]]:
    """Fits with the candidates that promise most."""
    tries = [(c, s) for c in pool for s in c.starts]
    if not tries:
        return []
    about = Parabola(found, plant.loop, found.samples)
    now = about.worth().total
    best: dict[tuple, tuple] = {}
    for c, start, error in tried_errors(plant, found, tries, records):
        worth, share = _scaled(about, c, start, error) if c.scales else (about.worth(error), 1.0)
        gain, key = now - worth.total, (c.family, c.place)
        if gain > _price(found, c) - AS_GOOD and (key not in best or gain > best[key][0]):
            best[key] = gain, c, tuple(share * np.array(start))
    order = sorted(best.values(), key=lambda x: _price(found, x[1]) - x[0])[:_FINALISTS]
    least = _CONTENDERS * max((gain for gain, *_ in order), default=0.0)
    return [
        (c, _fitted(plant, found, c, start, records, floor))
        for gain, c, start in order
        if gain >= least
    ]


def _scaled(about: Parabola, c: Candidate, start, error: np.ndarray) -> tuple[Worth, float]:
    """(S, multiple of the start) where a candidate is best scaled."""
    p, own = c.parameters[0], start[0]
    ends = sorted((p.low / own, p.high / own))
    return about.scaled(error - about.found.error, p.sd / abs(own), *ends)


def _by_law(
    plant: Plant,
    found: Fit,
    pool: Sequence[Candidate],
    excess: Float[np.ndarray, " n"],
    records: Sequence[Record],
    floor: np.ndarray,
) -> Iterator[list[tuple[Candidate, Fit]]]:
    """Joint by joint, fits with what its torque says of its loop; none where no torque is logged."""
    for near in by_law.starts(plant, found, pool, excess, records) if pool else ():
        fits = []
        for c, theta, _ in near:
            fits.append((c, _fitted_from(plant, found, c, theta, records, floor)))
        yield fits


def _from_nominal(
    plant: Plant,
    found: Fit,
    pool: Sequence[Candidate],
    records: Sequence[Record],
    floor: np.ndarray,
) -> list[tuple[Candidate, Fit]]:
    """Fits that start at the nominal model with one effect and few ordinary numbers.

    Where many ordinary numbers, each far off, pass for one effect, no small step leads from them to it: about them the
    cost is no parabola as far as the nominal model. About that the effects are ranked, in units of the whole gap.
    """
    theta = np.where(found.free, nominal(found), found.theta)
    start = fitting.fit(plant, found.table, records, theta, free=found.free, floor=floor, rounds=0)
    about = Parabola(start, plant.loop, start.samples)
    bare = about.worth().total
    tries = [(c, c.starts[0]) for c in pool if c.scales]
    ranked = []
    for c, size, error in tried_errors(plant, start, tries, records):
        worth, share = _scaled(about, c, size, error)
        ranked.append((bare - worth.total - _price(start, c), c, share * size[0], worth.off))
    ranked.sort(key=lambda x: -x[0])
    out = []
    for gain, c, size, off in ranked[:_FROM_NOMINAL]:
        if gain > 0:
            new = theta.copy()
            new[about.go] = nominal(found)[about.go] + off
            new = np.append(new, size)
            out.append((c, _fitted_from(plant, found, c, new, records, floor)))
    return out


def tried_errors(
    plant: Plant, found: Fit, tries: Sequence[tuple[Candidate, tuple[float, ...]]], records
) -> Iterator[tuple[Candidate, tuple[float, ...], np.ndarray]]:
    """Each candidate at a start with the error (N, n) there; those of separate trees of joints share replays."""
    # What is stepped with friction set anew is stepped together.
    tries = sorted(tries, key=lambda x: x[0].family in VARYING)
    rows = np.array(fitting.together([plant.tree_of(c.parameters[0]) for c, _ in tries]), int)
    for first in range(0, rows.max(initial=-1) + 1, _AT_ONCE):
        mine = np.flatnonzero((rows >= first) & (rows < first + _AT_ONCE)).tolist()
        more = [p for k in mine for p in tries[k][0].parameters]
        theta = np.concatenate([found.theta, [p.nominal for p in more]])
        thetas = np.repeat(theta[None], rows[mine].max() - first + 1, axis=0)
        at = len(found.table)
        for k in mine:
            thetas[rows[k] - first, at : at + len(tries[k][1])] = tries[k][1]
            at += len(tries[k][1])
        changed = fitting.errors(plant, (*found.table, *more), thetas, records)
        for k in mine:
            c, start = tries[k]
            touched = fitting.touches(plant, c.parameters[:1], changed.shape[-1])[0]
            yield c, start, np.where(touched, changed[rows[k] - first], found.error)


def _afresh(
    plant: Plant,
    found: Fit,
    pool: Sequence[Candidate],
    excess: Float[np.ndarray, " n"],
    records: Sequence[Record],
    floor: np.ndarray,
) -> list[tuple[Candidate, Fit]]:
    """Fits with a dead band that do not start at the numbers without one.

    A soft loop with much friction passes for a stiff one with a dead band, and no small step leads from one to the
    other: gain, friction and dead band are looked for together, at the joints whose replays, or torques, err most.
    """
    pool = [c for c in pool if c.family == "dead_band" and c.place[0] >= 0]
    pool = sorted(
        (c for c in pool if excess[c.place[0]] > by_law.ROUGH), key=lambda c: -excess[c.place[0]]
    )
    where = {(p.family, p.joint): k for k, p in enumerate(found.table)}
    out = []
    for c in pool[:_AFRESH]:
        gain, dry, wet = (
            where.get((f, c.place[0]), -1)
            for f in ("kp_scale", "coulomb_friction", "viscous_friction")
        )
        if min(gain, dry, wet) < 0:
            continue
        table, tries = (*found.table, *c.parameters), []
        for (width,), stiffer, rubs in itertools.product(c.starts, _STIFFER, (True, False)):
            theta = np.append(found.theta, width)
            theta[gain] += stiffer
            if not rubs:
                theta[[dry, wet]] = table[dry].nominal, table[wet].nominal
            tries.append(theta)
        weighed = fitting.errors(plant, table, np.array(tries), records) * found.weights.root
        theta = tries[int(np.argmin(np.sum(weighed**2, axis=(1, 2))))]
        out.append((c, _fitted_from(plant, found, c, theta, records, floor)))
    return out


def _limits_afresh(
    plant: Plant,
    found: Fit,
    pool: Sequence[Candidate],
    excess: Float[np.ndarray, " n"],
    records: Sequence[Record],
    floor: np.ndarray,
) -> list[tuple[Candidate, Fit]]:
    """Fits with a limit of the joint that errs most, its ordinary numbers starting at the nominal model's.

    What a low limit does to a motion, a loop with half its kp and twice its damping does in part, and at those numbers
    a limit is hardly reached.
    """
    worst, out = int(np.argmax(excess)), []
    own = [k for k, p in enumerate(found.table) if p.joint == worst and p.family in ORDINARY]
    for c in pool:
        if c.family not in ("torque_saturation", "torque_speed") or c.place[0] != worst:
            continue
        thetas = np.array([np.append(found.theta, start) for start in c.starts])
        thetas[:, own] = nominal(found)[own]
        errors = fitting.errors(plant, (*found.table, *c.parameters), thetas, records)
        weighed = np.sum((errors * found.weights.root) ** 2, axis=(1, 2))
        theta = thetas[int(np.argmin(weighed))]
        out.append((c, _fitted_from(plant, found, c, theta, records, floor)))
    return out


def _fitted_from(
    plant, found: Fit, c: Candidate, theta: np.ndarray, records, floor, rounds: int = _ROUNDS
) -> Fit:
    """A fit with a candidate, from numbers of its own; those of the candidate are last."""
    table = (*found.table, *c.parameters)
    free = np.append(found.free, np.ones(len(c.parameters), bool))
    return fitting.fit(plant, table, records, theta, free=free, floor=floor, rounds=rounds)


def _fitted(plant, found: Fit, c: Candidate, start, records, floor) -> Fit:
    """A first fit with a candidate."""
    table = (*found.table, *c.parameters)
    theta = np.append(found.theta, start)
    new = np.zeros(len(table), bool)
    new[len(found.table) :] = True
    error, columns = fitting.derivatives(plant, table, records, theta, new)
    columns[: len(found.table)] = found.columns
    free = np.append(found.free, np.ones(len(c.parameters), bool))
    return fitting.fit(
        plant, table, records, theta, free=free, floor=floor, rounds=_ROUNDS, known=(error, columns),
        mended_only=True,
    )  # fmt: skip
