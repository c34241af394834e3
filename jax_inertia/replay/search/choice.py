"""Which numbers are kept: all ordinary ones, those that are needed, odd effects, and what would do in their place.

Numbers are fitted to some rows, and chosen by others (`held`), which are no test.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jax_inertia.replay import checks
from jax_inertia.replay.fitting.fit import Fit, Progress, fit
from jax_inertia.replay.fitting.start import start as first_numbers
from jax_inertia.replay.loop import TOLERANCES
from jax_inertia.replay.record import Record
from jax_inertia.replay.result import rms, total
from jax_inertia.replay.search import causal, clock, odd, parsimony
from jax_inertia.replay.search.exchange import exchanged
from jax_inertia.replay.search.held_out import LISTED, Unseen, least_share, shown_in
from jax_inertia.replay.search.instead import Instead, Rows, in_place_of
from jax_inertia.replay.search.possible import pressed
from jax_inertia.replay.search.probability import Sure, odds_of_effects
from jax_inertia.replay.search.tries import AS_GOOD
from jax_inertia.replay.simulation.plant import Plant
from jax_inertia.text.words import number

_FIRST = 6
"""Rounds of the fits that say whether friction creeps."""
_IDLE = 0.005
_SPARSER = 1.01
_GAINS = "kp_scale", "kd_scale"
_TOGETHER = _GAINS, ("torque_speed",)
"""Families whose numbers are given up together: gains that the log says, of which a little more of one takes back what
a little more of another does to the torque; and by how much limits fall with speed: without that they are limits.
"""
_DROPPED = 3
"""Effects at most that are dropped because the validation rows' replay is worse for them."""


class Chosen(NamedTuple):
    """What was chosen, and why."""

    plant: Plant
    """Whose dry friction does at rest what the robot's does."""
    everything: Fit
    """All ordinary numbers, with odd effects if any."""
    found: Fit
    search: odd.Search
    instead: Mapping[Rows, tuple[Instead, ...]]
    shares: Mapping[Rows, float]
    """Of the gap in the validation rows, by the rows of each number or odd effect that is large enough to be listed."""
    odds: Mapping[Rows, Sure]
    """Of each of these."""
    impossible: tuple[str, ...]
    records: Sequence[Record]
    """That were fitted, and in which samples the robot touches something."""
    sound: bool
    """Whether nothing but a clock is lacking."""
    harm: bool = False
    """Whether all that was found replays the validation rows worse than the nominal model."""


def chosen(
    plants: tuple[Plant, Plant],
    table,
    records: Sequence[Record],
    held: Sequence[Record],
    torque: Float[np.ndarray, " n"],
    timed: clock.Timed,
    exclude: Sequence[str],
    progress: Progress,
) -> Chosen:
    """All numbers at once, those that are needed, odd effects, what each takes, and what would do instead."""
    bare = plants[1]
    if timed.quiet:
        return _sound(timed, table, records, progress)
    plant, everything, records, least = _ordinary_fit(plants, table, records, held, progress)
    error = total(rms(everything.error[:, : len(plant.names)]))
    progress(f"with kp, delay, friction and armature fitted: replay error {number(error)} rad")
    search = odd.Search(everything, (), (), ())
    if "odd" not in exclude:
        search = odd.add_odd(plant, everything, records, held, torque, least, exclude, progress)
        search = exchanged(plant, search, records, held, least, progress)
    impossible = pressed(search.found, plant.names)
    found = _sparse(plant, search.found, len(table), records, held, least, progress)
    progress("taking each effect back")
    found, shares = gated(plant, found, [o.rows for o in search.odd], held, least)
    own = nominal_fit(found).theta
    there = [o.rows for o in search.odd if np.any((found.theta != own)[list(o.rows)])]
    run = Unseen(plant, held, least)
    if np.all(run.missed(found) > Unseen(bare, held, least).missed(nominal_fit(found))):
        return unchanged(bare, everything, records)
    seen = shown_in(plant, found, there, records, least)
    large = sorted((k for k, s in shares.items() if s > LISTED), key=lambda k: -shares[k])
    others = in_place_of(plant, found, search.found.columns, large, search.pool, records, run)
    least_odd = _least_odd(found, run)
    own = {k: least_odd if max(k) >= len(table) else LISTED for k in shares}
    listed = {k: s for k, s in shares.items() if s > own[k]} | {k: shares.get(k, 0.0) for k in seen}
    every = Unseen(plant, [*records, *held], least)
    sure = odds_of_effects(
        found, [*listed], [o.rows for o in search.odd], others, run, every,
        lambda rows: _without(plant, found, rows, records, least),
    )  # fmt: skip
    return Chosen(
        plant, search.found, found, search, others, listed, sure, impossible, records, False
    )


def _without(plant: Plant, found: Fit, rows: Rows, records, least) -> Fit:
    """The fit of the numbers that are in, without those of one effect."""
    theta, free = found.theta.copy(), found.moved
    theta[list(rows)] = [found.table[k].nominal for k in rows]
    free[list(rows)] = False
    return fit(plant, found.table, records, theta, free=free, floor=least, exact=True)


def _least_odd(found: Fit, run: Unseen) -> float:
    """Of the gap in the validation rows, what an odd effect takes that is listed."""
    before = run.misses(found.table, nominal_fit(found).theta[None])[0, 0]
    after, floor = run.missed(found)[0], run.squares(run.floor**2)[0]
    return least_share(*(float(np.sqrt(x)) for x in (before, after, floor)))


def _sound(timed: clock.Timed, table, records: Sequence[Record], progress: Progress) -> Chosen:
    """Nothing but a clock; all ordinary numbers are fitted for how well the log knows each."""
    least = checks.least(records, timed.plant.loop)
    start = np.array([p.nominal for p in table])
    everything = fit(
        timed.plant, table, records, start, floor=least, rounds=_FIRST, progress=progress
    )
    found = clock.within(everything, timed)
    none = odd.Search(everything, (), (), ())
    return Chosen(timed.plant, everything, found, none, {}, {}, {}, (), records, True)


def unchanged(plant: Plant, everything: Fit, records: Sequence[Record]) -> Chosen:
    """Nothing is kept of what was found."""
    none = odd.Search(everything, (), (), ())
    same = nominal_fit(everything)
    return Chosen(plant, everything, same, none, {}, {}, {}, (), records, False, True)


def nominal_fit(found: Fit) -> Fit:
    """The nominal model's numbers."""
    return found._replace(theta=np.array([p.nominal for p in found.table]))


def _ordinary_fit(
    plants: tuple[Plant, Plant], table, records, held, progress
) -> tuple[Plant, Fit, Sequence[Record], Float[np.ndarray, " m"]]:
    """(plant whose friction is the robot's, all ordinary numbers, records without touches, the errors' floor)."""
    plant, bare = plants
    least = checks.least(records, plant.loop)
    progress("looking for kp and delay")
    first = _first_numbers(plants, table, records)
    everything = fit(plant, table, records, first, floor=least, rounds=_FIRST, progress=progress)
    progress("the same with a friction that creeps at rest")
    creeping = fit(
        bare, table, records, everything.theta, floor=least, rounds=_FIRST, progress=progress
    )
    if _creeps(plants, everything, creeping, held, least):
        plant, everything = bare, creeping
    records = checks.without_touches(plant, everything, records)
    touched = any(r.touched is not None for r in records)
    least = np.hypot(least, checks.step_error(plant, everything, records))
    near = None if touched else (everything.error, everything.columns)
    everything = fit(
        plant, table, records, everything.theta, floor=least, known=near, exact=True, progress=progress
    )  # fmt: skip
    return plant, everything, records, least


def _first_numbers(plants: Sequence[Plant], table, records) -> Float[np.ndarray, " P"]:
    """Where a fit starts; the plants' steps are as long as the loops that were found allow."""
    plant = plants[0]
    first = first_numbers(plant, table, records, plant.loop.source == "model")
    scale = np.array(
        [np.exp(x) for p, x in zip(table, first, strict=True) if p.family == "kp_scale"]
    )
    if len(scale) == len(plant.names):
        for one in plants:
            one.retime(one.loop.kp * np.minimum(2.0 * scale, 1.0))
    return first


def _creeps(
    plants: tuple[Plant, Plant],
    holding: Fit,
    creeping: Fit,
    held: Sequence[Record],
    least: Float[np.ndarray, " m"],
) -> bool:
    """Whether dry friction lets joints creep at rest, as MuJoCo's own does: by fitted logs and replays of others.

    Both are one evidence (`Unseen.likelier`): a log whose joints never rest does not tell, and another motion may.
    ln p(log) of a fit is −Σ_j N/T_j ln σ_j, σ_j the rms of output j's error and N/T_j its independent samples.
    """
    rms = [np.maximum(np.sqrt(np.mean(f.error**2, axis=0)), least) for f in (holding, creeping)]
    samples = len(holding.error) / holding.weights.correlated
    runs = [Unseen(plant, held, least) for plant in plants]
    holds, creeps = (run.errors(f) for run, f in zip(runs, (holding, creeping), strict=True))
    evidence = 2.0 * np.sum(samples * np.log(rms[0] / rms[1]))
    return bool(evidence + runs[0].likelier(creeps, holds, holding.weights) > AS_GOOD)


def _sparse(plant, full: Fit, ordinaries: int, records, held, least, progress) -> Fit:
    """The numbers that are needed, refitted alone; all of them where the held-out replay is better for it.

    The others are the model's own, and off by no more than such numbers are, or a clock leaves open. Within that they
    stay free: held, they would measure every other number. Gains, frictions and masses by one factor are the same
    motion, and a friction of 0.2 N m that is exactly that says the factor.
    """
    asked = [k for k in range(ordinaries) if full.table[k].family not in TOLERANCES]
    keep = parsimony.needed(full, asked)
    given_up = np.isin(np.arange(len(full.table)), np.setdiff1d(asked, keep))
    within = parsimony.within(full.table)
    free = full.free & ~(given_up & (within == 0))
    table = tuple(
        p._replace(sd=sd, own=0.0, given=True) if up and sd else p
        for p, up, sd in zip(full.table, given_up, within.tolist(), strict=True)
    )
    nominal = np.array([p.nominal for p in full.table])
    start = np.where(given_up, nominal, np.where(free, full.theta, nominal))
    few = fit(
        plant, table, records, start, free=free, floor=least, rounds=5, exact=True, progress=progress
    )  # fmt: skip
    run, every = Unseen(plant, held, least), Unseen(plant, [*records, *held], least)
    most = _SPARSER**2 * run.missed(full)
    # Twenty to one, as of any other choice: where joints err by a discrepancy a few samples say nothing.
    better = run.likelier(run.errors(full), run.errors(few), full.weights) > AS_GOOD
    found = full if better and np.any(run.missed(few) > most) else few
    for families in _TOGETHER:
        if families == _GAINS and plant.loop.source == "model":
            continue
        given_up = np.array([p.family in families for p in found.table])
        start = np.where(given_up, nominal, found.theta)
        if np.array_equal(start, found.theta):
            continue
        free = found.free & ~given_up
        fewer = fit(
            plant, found.table, records, start, free=free, floor=least, rounds=5, exact=True
        )
        # Any motion asks for gains. Another one may hardly ask for a limit, and tells nothing of how it falls.
        refuted = families != _GAINS and _clearly_better(found, fewer, every)
        if np.all(run.missed(fewer) <= most) and not refuted:
            found = fewer
    return found


def _clearly_better(found: Fit, fewer: Fit, every: Unseen) -> bool:
    """Whether all rows, fitted and validation ones, are likelier by 20 to 1, ln N paid for each number that is more."""
    paid = np.sum(fewer.theta != found.theta, where=found.free & ~fewer.free) * np.log(
        max(found.samples, 2.0)
    )
    errors = every.errors(found), every.errors(fewer)
    return bool(every.likelier(*errors, found.weights) - paid > AS_GOOD)


def gated(
    plant,
    found: Fit,
    odd_rows: Sequence[tuple[int, ...]],
    held: Sequence[Record],
    least: Float[np.ndarray, " m"] | None = None,
) -> tuple[Fit, dict[tuple[int, ...], float]]:
    """Without the numbers that make the held-out replay worse, and what share of its error each other one takes.

    Numbers of one effect come and go together. Where torque is logged, an effect's share is that of positions or of
    torques, whichever is larger: what a loop does to the torque, a stiff joint may hardly show. What changes neither by
    as much as sensors resolve has no share.
    """
    nominal = np.array([p.nominal for p in found.table])
    groups = [*odd_rows, *(x for k in range(len(nominal)) if len(x := causal.late(found, k)) > 1)]
    run = Unseen(plant, held, least)
    energy = run.misses(found.table, nominal[None])[0]
    grouped, dropped = {k for rows in groups for k in rows}, 0
    grouped |= {k for k, p in enumerate(found.table) if p.is_tolerance}
    while True:
        away = set(np.flatnonzero(found.theta != nominal).tolist())
        units = [(k,) for k in sorted(away - grouped)]
        units += [rows for rows in groups if not away.isdisjoint(rows)]
        errors = run.taken_back(found, units)
        square = run.missed_by(errors)
        each = (square[1:] - square[0]) / energy
        sums = each.sum(axis=1)
        if dropped == _DROPPED or not np.any(sums < -_IDLE):
            break
        theta, worst = found.theta.copy(), list(units[int(np.argmin(sums))])
        theta[worst] = nominal[worst]
        found, dropped = found._replace(theta=theta), dropped + 1
    shares = zip(units, each.max(axis=1, initial=-np.inf).tolist(), run.shown(errors), strict=True)
    return found, {rows: share for rows, share, shown in shares if shown}
