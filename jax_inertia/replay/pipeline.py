"""From logs of targets and encoders, and torques where logged, to what the model lacks, proved by replays."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jax_inertia.logs.log import Log
from jax_inertia.model.mujoco_types import MjSpec
from jax_inertia.replay import checks, listing, proof
from jax_inertia.replay.fitting.fit import Fit, Progress, fit
from jax_inertia.replay.fitting.start import start as first_numbers
from jax_inertia.replay.inputs import (
    check_base,
    loops_of,
    ordinary_numbers,
    split_records,
    tolerances,
    typical_torque,
)
from jax_inertia.replay.loop import TOLERANCES
from jax_inertia.replay.record import Record
from jax_inertia.replay.result import Diagnosis, Replayed, total
from jax_inertia.replay.search import causal, odd, parsimony
from jax_inertia.replay.search.exchange import exchanged
from jax_inertia.replay.search.held_out import LISTED, Unseen, least_share, shown_in
from jax_inertia.replay.search.instead import Instead, Rows, in_place_of
from jax_inertia.replay.search.tries import AS_GOOD
from jax_inertia.replay.simulation.plant import Plant

_FIRST = 6
"""Rounds of the fits that say whether friction creeps."""
_IDLE = 0.005
_SPARSER = 1.01
_DROPPED = 3
"""Effects at most that are dropped because the held-out replay is worse for them."""

_HARM = (
    "numbers that fit the log replay the rest worse than the nominal model: none of them is kept"
)
_LIKE_MUJOCO = "joints that friction should hold creep at rest, as MuJoCo's own friction lets them: it is left so"


def diagnose(
    logs: Sequence[Log],
    spec: Callable[[], MjSpec],
    *,
    test_log: Log | None = None,
    kp: Sequence[float] | None = None,
    kd: Sequence[float] | None = None,
    exclude: Sequence[str] = (),
    progress: Progress = lambda text: None,
) -> Diagnosis:
    """Find what the model lacks, from targets and positions; `spec` gives the nominal model anew at each call.

    Torques are a further output of the replays where every log has those of its loop (`command.of_the_loop`).

    The fit sees `logs` (without a test log, the first 70 % of each); verdict, shares and gate are of replays of the
    rest. Logs may be of different gains. Raises `LogError` where joints or gains are missing.
    """
    names = logs[0].joint_names
    check_base(spec().compile())
    loops, test_loop, torque_logged = loops_of(logs, test_log, lambda: spec().compile(), kp, kd)
    loop = loops[0]
    bare, plant = Plant(spec(), names, loop), Plant(spec(), names, loop, holds=True)
    wholes, records, held, of = split_records(
        plant, logs, loops, test_log, test_loop, torque_logged
    )
    progress("replaying the nominal model")
    nothing = (), np.zeros(0)
    nominal = proof.paths(bare, *nothing, held)
    replayed = Replayed(held, nominal, nominal, checks.floor(held), of)
    replayed = proof.with_torques(replayed, bare, nothing, nothing)
    torque = typical_torque(plant, records)
    own = ordinary_numbers(plant, records, torque, loops, logs)
    table = (*(p for p in own if p.family not in exclude), *tolerances(plant))
    sound = listing.at_floor(replayed)
    done = _fitted((plant, bare), table, records, held, torque, sound, exclude, progress)
    plant, everything, found, shares = done.plant, done.everything, done.found, done.shares
    harm = not sound and np.array_equal(found.theta, _nominal(found).theta)
    sound = sound or harm
    after = nominal if sound else proof.paths(plant, found.table, found.theta, held)
    replayed = dataclasses.replace(replayed, corrected=after)
    replayed = proof.with_torques(replayed, plant, nothing, (found.table, found.theta))
    if not sound:
        replayed = dataclasses.replace(replayed, fan=proof.fan(plant, found, held[replayed.shown]))
    sizes = replayed.before, replayed.after, replayed.floor
    odd_least = least_share(*(total(x) for x in sizes))
    if harm or not sound:
        wholes = checks.without_touches(plant, found, wholes, done.records)
    if not sound and test_log is None:
        progress("fitting all of it")
        found = _on_all(plant, found, wholes)
    least = {k: odd_least if max(k) >= len(table) else LISTED for k in shares}
    large = {k for k, s in shares.items() if s > least[k]} | {*done.seen}
    kept = {k: shares.get(k, 0.0) for k in large if listing.distinct(found, k, loop)}
    effects = listing.listed(found, done.search, done.instead, kept, loop, names)
    verdict, confidence = listing.verdict(replayed, effects)
    said = dict.fromkeys(n for r in records for n in checks.objections(r, names))
    notes = [*said, *causal.notes(done.stamps, found, loop, torque_logged)]
    notes += [*checks.touch_note(wholes), *([_HARM] if harm else [])]
    if not sound:
        notes += proof.creeping(bare, found, replayed) if plant.holds else [_LIKE_MUJOCO]
    numbers = plant.numbers(found.table, found.theta, None)
    worse = () if sound else proof.worse(replayed, names)
    return Diagnosis(
        verdict, confidence, listing.headline(verdict, replayed), names, loop, effects, everything, found, numbers,
        plant.nominal, proof.mean_friction(numbers, held), plant.holds, replayed, worse, tuple(notes),
    )  # fmt: skip


class _Fitted(NamedTuple):
    plant: Plant
    """Whose dry friction does at rest what the robot's does."""
    stamps: Fit
    """Ordinary numbers alone, their delay as the log would have it."""
    everything: Fit
    """With odd effects, and of a delay that a model can have."""
    found: Fit
    search: odd.Search
    instead: Mapping[Rows, tuple[Instead, ...]]
    shares: dict[Rows, float]
    """Of the gap, by the rows of each number or odd effect."""
    seen: Sequence[Rows]
    """Odd effects that the fitted logs show."""
    records: Sequence[Record]
    """That were fitted, and in which samples the robot touches something."""


def _fitted(plants, table, records, held, torque, sound, exclude, progress) -> _Fitted:
    """All numbers at once, those that are needed, odd effects, what each takes, and what would do instead."""
    bare = plants[1]
    plant, everything, records, least = _ordinary_fit(plants, table, records, held, sound, progress)
    if sound:
        return _unchanged(plant, everything, records)
    possible = causal.fitted(plant, everything, records, least, progress)
    search = odd.Search(possible, (), (), ())
    if "odd" not in exclude:
        search = odd.add_odd(plant, possible, records, held, torque, least, exclude, progress)
        search = exchanged(plant, search, records, held, least, progress)
    found = _sparse(plant, search.found, len(table), records, held, least, progress)
    progress("taking each effect back")
    found, shares = _gated(plant, found, [o.rows for o in search.odd], held)
    own = _nominal(found).theta
    there = [o.rows for o in search.odd if np.any((found.theta != own)[list(o.rows)])]
    if np.all(Unseen(plant, held).missed(found) > Unseen(bare, held).missed(_nominal(found))):
        return _unchanged(bare, everything, records)
    seen = shown_in(plant, found, there, records)
    large = sorted((k for k, s in shares.items() if s > LISTED), key=lambda k: -shares[k])
    others = in_place_of(plant, found, search.found.columns, large, search.pool, records)
    told = causal.with_variance(search.found, everything)
    return _Fitted(plant, everything, told, found, search, others, shares, seen, records)


def _nominal(found: Fit) -> Fit:
    """The nominal model's numbers."""
    return found._replace(theta=np.array([p.nominal for p in found.table]))


def _unchanged(plant: Plant, everything: Fit, records: Sequence[Record]) -> _Fitted:
    """Nothing that the nominal model lacks."""
    none = odd.Search(everything, (), (), ())
    same = _nominal(everything)
    return _Fitted(plant, everything, everything, same, none, {}, {}, (), records)


def _ordinary_fit(
    plants: tuple[Plant, Plant], table, records, held, sound: bool, progress
) -> tuple[Plant, Fit, Sequence[Record], Float[np.ndarray, " m"]]:
    """(plant whose friction is the robot's, all ordinary numbers, records without touches, the errors' floor)."""
    plant, bare = plants
    least = checks.least(held, plant.loop)
    progress("looking for kp and delay")
    first = _first_numbers(plants, table, records)
    everything = fit(plant, table, records, first, floor=least, rounds=_FIRST, progress=progress)
    if sound:
        return plant, everything, records, least
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
    runs = [Unseen(plant, held) for plant in plants]
    holds, creeps = (run.errors(f) for run, f in zip(runs, (holding, creeping), strict=True))
    evidence = 2.0 * np.sum(samples * np.log(rms[0] / rms[1]))
    return bool(evidence + runs[0].likelier(creeps, holds, holding.weights) > AS_GOOD)


def _on_all(plant: Plant, found: Fit, wholes: Sequence[Record]) -> Fit:
    """The numbers that are in, fitted to what was held back too, once it has said which those are."""
    nominal = np.array([p.nominal for p in found.table])
    free = found.free & (found.theta != nominal)
    least = checks.least(wholes, plant.loop)
    return fit(
        plant, found.table, wholes, found.theta, free=free, floor=least, rounds=3, exact=True
    )


def _sparse(plant, full: Fit, ordinaries: int, records, held, least, progress) -> Fit:
    """The ordinary numbers that are needed, refitted alone; all of them where the held-out replay is better for it.

    What a clock leaves open of the others they stay free by, as a nominal model's tolerances are.
    """
    asked = [k for k in range(ordinaries) if full.table[k].family not in TOLERANCES]
    keep = parsimony.needed(full, plant.loop, asked)
    given_up = np.isin(np.arange(len(full.table)), np.setdiff1d(asked, keep))
    loose = checks.loose(full.table, plant.loop)
    free = full.free & ~(given_up & (loose == 0))
    by_clock = np.where(given_up & free, loose, 0.0)
    table = tuple(
        p._replace(sd=sd) if sd else p for p, sd in zip(full.table, by_clock.tolist(), strict=True)
    )
    nominal = np.array([p.nominal for p in full.table])
    start = np.where(given_up, nominal, np.where(free, full.theta, nominal))
    few = fit(
        plant, table, records, start, free=free, floor=least, rounds=5, exact=True, progress=progress
    )  # fmt: skip
    whole, fewer = Unseen(plant, held).misses(full.table, np.stack([full.theta, few.theta]))
    return few if np.all(fewer <= _SPARSER**2 * whole) else full


def _gated(
    plant, found: Fit, odd_rows: Sequence[tuple[int, ...]], held
) -> tuple[Fit, dict[tuple[int, ...], float]]:
    """Without the numbers that make the held-out replay worse, and what share of its error each other one takes.

    Numbers of one effect come and go together. Where torque is logged, an effect's share is that of positions or of
    torques, whichever is larger: what a loop does to the torque, a stiff joint may hardly show. What changes neither by
    as much as sensors resolve has no share.
    """
    nominal = np.array([p.nominal for p in found.table])
    groups = [*odd_rows, *(x for k in range(len(nominal)) if len(x := causal.late(found, k)) > 1)]
    run = Unseen(plant, held)
    energy = run.misses(found.table, nominal[None])[0]
    grouped, dropped = {k for rows in groups for k in rows}, 0
    grouped |= {k for k, p in enumerate(found.table) if p.family in TOLERANCES}
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
