"""What may be wrong beyond what every robot has: candidates that compete on what the ordinary numbers leave.

Each is tried at a few sizes, the ordinary numbers following along the cost's parabola, or given up; the best few are
fitted, and the best of them stays if evidence asks for it and a replay that played no part does too.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jax_inertia.replay.fitting.fit import Fit
from jax_inertia.replay.record import Record
from jax_inertia.replay.search import afresh as afresh_fits
from jax_inertia.replay.search import by_law, closed_loop
from jax_inertia.replay.search import held_out as unseen
from jax_inertia.replay.search.candidates import Candidate, candidates
from jax_inertia.replay.search.elsewhere import Possible, most_likely
from jax_inertia.replay.search.parsimony import Parabola, Worth
from jax_inertia.replay.search.tries import (
    AS_GOOD,
    centre,
    fitted,
    fitted_from,
    numbers_of,
    placed,
    price,
    ranked,
    settled,
)
from jax_inertia.replay.simulation.plant import Plant

MOST = 6
_GAIN = 0.02
_FINALISTS, _ELSEWHERE = 4, 2
"""Candidates that are fitted in a round: those that promise most, and the best of further joints and bodies."""
_SETTLED = 2
"""Of the effects that pass, how many are fitted until they settle before one is chosen.

Along a valley where ordinary numbers make room for an effect a first fit goes part of the way, of one effect more than
of another: a payload at the shank came to 0.10 of its 0.32 kg, and one at the thigh was nearer to its own end.
"""
_STARTS = 2
"""Fits of one effect, from different starts, that are gone on with."""
_CONTENDERS = 0.3
"""Of the best one's gain, what another one must promise to be fitted, and have to be fitted until it settles."""


_AT_FLOOR = 1.1
"""Error of a joint's output in units of what encoders and steps leave, from which a law may be sought there."""


Passed = dict[Candidate, list[tuple[float, Fit]]]
"""Candidates, each with the evidence of its fits, the most first."""


class Search(NamedTuple):
    """What the search for odd effects leaves."""

    found: Fit
    odd: tuple["Odd", ...]
    possible: tuple[Possible, ...]
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
    run, torque_logged = unseen.Unseen(plant, held_out, floor), records[0].torque is not None
    out, possible, afresh = [], [], True
    progress("looking for odd effects by the loop's own response")
    proposed = closed_loop.find(plant, found.table, pool, records, floor[: len(plant.names)])
    for k in range(MOST):
        progress(f"looking for odd effects, {k} found")
        said = afresh_fits.gains_as_said(plant, found, records, floor)
        found = afresh_fits.simpler(plant, found, said, records, floor) if said else found
        before = run.errors(found)
        excess, loops = _rms(found)[: len(plant.names)] / floor[: len(plant.names)], []
        off = excess
        if torque_logged:
            excess = by_law.excess(plant, found, records, floor)
            off = np.maximum(off, excess)
        # Where nothing is left but what encoders and steps leave, no law is left out.
        here = [c for c in pool if c.scales or np.any(off[_at(c)] > _AT_FLOOR)]
        if torque_logged:
            loops, here = by_law.sought(here, excess)
        # The loop's half first: its torque tells it, whatever the robot makes of it.
        passed, possible = {}, []
        for fits in _by_law(plant, found, loops, excess, records, floor):
            passed, more = _judged(plant, found, fits, run, before)
            possible += more
            if passed:
                break
        if not passed:
            fits = _finalists(plant, found, here, records, floor)
            if proposed is not None:
                fits += closed_loop.fits(plant, found, proposed, here, records, floor)
            elif afresh:
                fits += afresh_fits.dead_bands(plant, found, here, excess, records, floor)
                fits += afresh_fits.limits(plant, found, here, excess, records, floor)
                fits += afresh_fits.from_nominal(plant, found, here, records, floor)
            fits += afresh_fits.as_said(plant, found, said, here, records, floor) if said else []
            passed, more = _settled_too(plant, found, fits, records, floor, run, before)
            possible, afresh = [*possible, *more], False
        if not passed:
            break
        first, chosen = _first(plant, found, passed, records, floor, run, before)
        evidence, found = chosen[first]
        rows = tuple(range(len(found.table) - len(first.parameters), len(found.table)))
        order = sorted(passed, key=lambda c: -chosen[c][0])
        rivals = tuple(c for c in order if chosen[c][0] > evidence - AS_GOOD and c != first)
        pool = [c for c in pool if (c.family, c.place) != (first.family, first.place)]
        if first.family == "payload_centre":
            out = [o._replace(rows=o.rows + rows) if _is_load_of(o, first) else o for o in out]
            continue
        out.append(Odd(first, rows, rivals))
        pool += centre(plant, first, found)
    return Search(found, tuple(out), most_likely(possible), tuple(pool))


def _judged(
    plant: Plant, found: Fit, fits: Sequence[tuple[Candidate, Fit]], run: unseen.Unseen, before
) -> tuple[Passed, list[Possible]]:
    """(those that evidence and held-out runs both ask for, with evidence and fits; those that are nearly as good).

    `before`: errors of the held-out runs by what is found.
    """
    now, best = Parabola(found, found.samples).worth(), run.missed_by(before[None])[0]
    passed: Passed = {}
    untold: Passed = {}
    possible = []
    for c, tried in fits:
        after = run.errors(tried)
        fell, kept = fall(plant, found, now, c, tried)
        evidence = fell + run.likelier(after, before, found.weights)
        # A number that does not carry over to another stretch is none of the robot's; one that stands for several
        # does if it does no harm.
        simpler = kept + numbers_of(c) < now.kept
        least = 1.0 + _GAIN if simpler else 1.0 - _GAIN
        missed = run.missed_by(after[None])[0]
        if evidence > AS_GOOD and unseen.carries_over(missed, best, least):
            passed.setdefault(c, []).append((evidence, tried))
        elif evidence > AS_GOOD and _below_what_is_seen(run, found, tried, after, best):
            untold.setdefault(c, []).append((evidence, tried))
        elif evidence > -AS_GOOD and c.family != "payload_centre":
            # Where a load is, is no effect by itself.
            possible.append(Possible(c, evidence, tried))
    # Where the runs can tell of some, they do.
    passed = passed or untold
    return {c: sorted(x, key=lambda y: -y[0]) for c, x in passed.items()}, possible


def _settled_too(
    plant: Plant, found: Fit, fits, records, floor: np.ndarray, run: unseen.Unseen, before
) -> tuple[Passed, list[Possible]]:
    """As `_judged`; promising ones are judged again once they settle; where none passes, all that may be there."""
    passed, possible = _judged(plant, found, fits, run, before)
    near = dict(_promising(plant, found, fits, passed, run, before))
    for x in most_likely(possible)[: 0 if passed else _SETTLED]:
        near.setdefault(x.candidate, x.fit)
    gone_on = [(c, settled(plant, x, records, floor)) for c, x in near.items()]
    more, others = _judged(plant, found, gone_on, run, before)
    return {**passed, **more}, [*[x for x in possible if x.candidate not in near], *others]


def _promising(
    plant: Plant,
    found: Fit,
    fits: Sequence[tuple[Candidate, Fit]],
    passed: Passed,
    run: unseen.Unseen,
    before,
) -> list[tuple[Candidate, Fit]]:
    """Fits that have not converged and are worth more rounds: those that are likelier than all that pass.

    Where none passes, the likeliest of those by which validation rows err less. Evidence that is short of being enough
    is short of what the same fit has where it settles, and so are the validation rows: a load of 0.5 kg at an arm's
    hand had three times the evidence of all others while gains that no log says were still on their way back.
    """
    now, best = Parabola(found, found.samples).worth(), run.missed_by(before[None])[0]
    least = max((x[0][0] for x in passed.values()), default=-np.inf)
    near = {}
    for c, tried in fits:
        after = run.errors(tried)
        less = unseen.carries_over(run.missed_by(after[None])[0], best, 1.0 - _GAIN)
        if c in passed or not (passed or less):
            continue
        evidence = fall(plant, found, now, c, tried)[0]
        evidence += run.likelier(after, before, found.weights)
        if evidence > least and (c not in near or evidence > near[c][0]):
            near[c] = evidence, tried
    order = sorted(near, key=lambda c: -near[c][0])
    return [(c, near[c][1]) for c in order[:_SETTLED]]


def _below_what_is_seen(
    run: unseen.Unseen, found: Fit, tried: Fit, after: np.ndarray, best: np.ndarray
) -> bool:
    """Whether runs err by less than is seen with an effect and without, and would by more were it taken back alone.

    `after`: errors of their replays with it; `best`: mean squares without.
    """
    missed = run.missed_by(after[None])[0]
    if np.any(np.maximum(missed, best) > run.squares(run.floor**2)):
        return False
    theta, own = tried.theta.copy(), len(found.table)
    theta[own:] = [p.nominal for p in tried.table[own:]]
    return run.moved(run.errors(tried._replace(theta=theta)), after)


def fall(plant: Plant, found: Fit, now: Worth, c: Candidate, tried: Fit) -> tuple[float, int]:
    """(by how much S falls from `now` with a candidate, its price paid; how many ordinary numbers that keeps).

    The noise is what remains of each fit: −2 ln p of output j is N/T_j ln σ_j², of which 1 − σ'_j²/σ_j², the cost's
    fall by the weights of `found`, is the first term. By that alone effects that explain most are all worth the same.
    """
    new = Parabola(tried, found.samples, found.weights).worth()
    ratio = (tried.weights.sigma / found.weights.sigma) ** 2
    samples = len(found.error) / np.maximum(found.weights.correlated, tried.weights.correlated)
    beyond = float(np.sum(samples * (ratio - 1.0 - np.log(ratio))))
    return now.total - new.total + beyond - price(found, c), new.kept


def _at(c: Candidate) -> int | slice:
    """The joint, or all of them."""
    return slice(None) if c.place[0] < 0 else c.place[0]


def _rms(found: Fit) -> Float[np.ndarray, " m"]:
    """Of each output, rms."""
    return np.sqrt(np.mean(found.error**2, axis=0))


def _is_load_of(o: Odd, centre: Candidate) -> bool:
    return o.candidate.family == "payload" and o.candidate.place == centre.place


def _first(
    plant: Plant,
    found: Fit,
    passed: Passed,
    records,
    floor,
    run: unseen.Unseen,
    before,
) -> tuple[Candidate, dict[Candidate, tuple[float, Fit]]]:
    """(the one with most evidence of those that are near the best once they settle; all, with what is known then).

    Of fits of one effect from several starts, the one that is simplest for what it fits once it settles.
    """
    out = {c: fits[0] for c, fits in passed.items()}
    order = sorted(out, key=lambda c: -out[c][0])
    near = [c for c in order[:_SETTLED] if out[c][0] >= _CONTENDERS * out[order[0]][0]]
    now = Parabola(found, found.samples).worth()
    for c in tuple(near):
        fits = [settled(plant, x, records, floor) for _, x in passed[c][:_STARTS]]
        tried = _simplest(plant, fits, found.samples)
        held = run.likelier(run.errors(tried), before, found.weights)
        out[c] = fall(plant, found, now, c, tried)[0] + held, tried
        for whole in placed(plant, c, tried, records, floor):
            out |= {
                x: fits[0] for x, fits in _judged(plant, found, [whole], run, before)[0].items()
            }
            near += [whole[0]] if whole[0] in out else []
    best = max(near, key=lambda c: out[c][0])
    return _without_stiffness(best, out), out


def _without_stiffness(best: Candidate, out: dict[Candidate, tuple[float, Fit]]) -> Candidate:
    """The constant torque of the same joint in place of a spring, where its evidence is within 20 to 1 of that."""
    for c, (evidence, _) in out.items():
        same = best.family == "joint_spring" and (c.family, c.place) == ("torque_bias", best.place)
        if same and evidence > out[best][0] - AS_GOOD:
            return c
    return best


def _simplest(plant: Plant, fits: Sequence[Fit], samples: float) -> Fit:
    """Of fits of the same numbers, the one of least S, by the errors that the closest leaves."""
    closest = min(fits, key=lambda f: np.sum(np.log(f.weights.sigma) / f.weights.correlated))
    return min(fits, key=lambda f: Parabola(f, samples, closest.weights).worth().total)


def _finalists(
    plant: Plant,
    found: Fit,
    pool: Sequence[Candidate],
    records: Sequence[Record],
    floor: np.ndarray,
) -> list[tuple[Candidate, Fit]]:
    """Fits with the candidates that promise most, and with the best of some places that none of these is at."""
    order = ranked(plant, found, pool, records)
    seen = {c.place for _, c, _ in order[:_FINALISTS]}
    elsewhere: dict[tuple[int, str], tuple] = {}
    for x in order:
        elsewhere.setdefault(x[1].place, x)
    further = [x for place, x in elsewhere.items() if place not in seen]
    order = order[:_FINALISTS] + further[:_ELSEWHERE]
    least = _CONTENDERS * max((gain for gain, *_ in order), default=0.0)
    return [
        (c, fitted(plant, found, c, start, records, floor))
        for gain, c, start in order
        if gain >= least
    ]


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
            fits.append((c, fitted_from(plant, found, c, theta, records, floor)))
        yield fits
