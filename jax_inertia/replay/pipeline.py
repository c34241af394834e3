"""From logs of targets and encoders, and torques where logged, to what the model lacks, proved by replays of its
file."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from jax_inertia.diagnosis.certainty.probability import probability
from jax_inertia.diagnosis.settings import Settings
from jax_inertia.logs.log import Log
from jax_inertia.model.mujoco_types import MjModel, MjSpec
from jax_inertia.model.write import changes
from jax_inertia.replay import checks, handover, listing, proof
from jax_inertia.replay.fitting.draws import Draws, drawn
from jax_inertia.replay.fitting.errors import replay_errors
from jax_inertia.replay.fitting.file_form import InFile, file_form
from jax_inertia.replay.fitting.fit import Fit, Progress, fit
from jax_inertia.replay.inputs import (
    Parts,
    check_base,
    loops_of,
    ordinary_numbers,
    split_records,
    tolerances,
    typical_torque,
)
from jax_inertia.replay.loop import CLOCK, Loop
from jax_inertia.replay.record import Record, target_period
from jax_inertia.replay.remainder import resemblances
from jax_inertia.replay.result import Correction, Diagnosis, Replayed, Size, rms, total
from jax_inertia.replay.search import causal, choice, clock
from jax_inertia.replay.search.elsewhere import elsewhere
from jax_inertia.replay.simulation.plant import Plant
from jax_inertia.text.words import number

_HARM = "numbers that fit the log replay its validation rows worse than the nominal model: none of them is kept"
_LIKE_MUJOCO = "joints that friction should hold creep at rest, as MuJoCo's own friction lets them: it is left so"


def diagnose(
    logs: Sequence[Log],
    spec: Callable[[], MjSpec],
    *,
    test_log: Log | None = None,
    validation_log: Log | None = None,
    kp: Sequence[float] | None = None,
    kd: Sequence[float] | None = None,
    exclude: Sequence[str] = (),
    write: handover.Writer = handover.in_memory,
    progress: Progress = lambda text: None,
) -> Diagnosis:
    """Find what the model lacks, from targets and positions; `spec` gives the nominal model anew at each call.

    Torques are a further output of the replays where every log has those of its loop (`command.of_the_loop`).

    Numbers are fitted to most of `logs`, and chosen by `validation_log` or a stretch of each log; what is chosen is
    fitted to both, written as a file (`write`), read back, and replayed by MuJoCo in the model's own steps. `test_log`,
    or the last part of each log, is read then and not before: errors and verdict are of it. Logs may be of different
    gains. Raises `LogError` where joints or gains are missing.
    """
    names = logs[0].joint_names
    check_base(spec().compile())
    loops = loops_of(logs, validation_log, test_log, lambda: spec().compile(), kp, kd)
    loop = loops.fit[0]
    bare, plant = Plant(spec(), names, loop), Plant(spec(), names, loop, holds=True)
    parts = split_records(plant, logs, loops, validation_log, test_log)
    for one in (plant, bare):
        one.told_each(target_period(parts.whole))
    torque = typical_torque(plant, parts.fit)
    own = ordinary_numbers(plant, parts.fit, torque, loops.fit, logs)
    table = (*(p for p in own if p.family not in exclude), *tolerances(plant))
    rough = rms(replay_errors(bare, (), np.zeros((1, 0)), parts.whole)[0][:, : len(names)])
    progress(f"as modelled: replay error {number(total(rough))} rad; now fitting")
    timed = clock.fitted((plant, bare), table, parts.whole)
    done = choice.chosen(
        (plant, bare), table, parts.fit, parts.validation, torque, timed, exclude, progress
    )
    case = _Case(parts, loop, handover.nominal_model(spec(), names, loop), spec, write)
    handed = _handed_over(case, done, bare, progress)
    progress("replaying the test")
    draws = drawn(handed.done.plant, handed.found, handed.in_file) if handed.changed else None
    replayed = _test(case, handed, draws)
    found = _told(case, handed, replayed, timed, bare, loops.torque)
    return dataclasses.replace(found, draws=draws)


class _Case(NamedTuple):
    """What a file is made of and tried by."""

    parts: Parts
    loop: Loop
    given: MjModel
    """The model as it is."""
    spec: Callable[[], MjSpec]
    write: handover.Writer


class _Handed(NamedTuple):
    """What is handed over, and where it is from."""

    done: choice.Chosen
    found: Fit
    """Of fitted and validation rows."""
    correction: Correction
    in_file: InFile
    file: handover.Written
    whole: Sequence[Record]

    @property
    def changed(self) -> bool:
        """Whether anything beyond a clock is."""
        return not self.done.sound and not self.done.harm


def _handed_over(case: _Case, done: choice.Chosen, bare: Plant, progress: Progress) -> _Handed:
    """Fitted to validation rows too, written and read back; nothing, where the file replays these rows worse."""
    found, whole = done.found, case.parts.whole
    if not done.sound and not done.harm:
        known = [*done.records, *case.parts.validation][: len(whole)]
        whole = checks.without_touches(done.plant, found, whole, known)
        progress("fitting all of it")
        found = _on_all(done.plant, found, whole)
        found = found._replace(elsewhere=elsewhere(found, done.search.found, done.search.possible))
    progress("writing, reading back and replaying what was found")
    handed = _written(case, done, found, whole)
    if done.sound or not _harms(case, handed.file.model, handed.correction):
        return handed
    done = choice.unchanged(bare, done.everything, done.records)
    return _written(case, done, done.found, whole)


def _written(case: _Case, done: choice.Chosen, found: Fit, whole: Sequence[Record]) -> _Handed:
    """A fit, as a file that is written and read back."""
    in_file = file_form(done.plant, found, whole, checks.least(whole, done.plant.loop))
    correction = _correction(done, found, case.loop, whole, in_file)
    file = handover.written(correction, case.spec(), case.write)
    return _Handed(done, found, correction, in_file, file, whole)


def _test(case: _Case, handed: _Handed, draws: Draws | None) -> Replayed:
    """The test rows, read here for the first time."""
    names, test = handed.correction.names, case.parts.test
    before, after = (
        tuple(handover.replayed(m, names, case.loop, r) for r in test)
        for m in (case.given, handed.file.model)
    )
    replayed = Replayed(test, before, after, checks.floor(test), case.parts.of)
    plant, found = handed.done.plant, handed.found
    numbers = found.table, found.theta
    replayed = proof.with_torques(replayed, plant, ((), np.zeros(0)), numbers)
    if draws is None:
        return replayed
    fan = proof.fan(plant, found, draws, test[replayed.shown])
    return dataclasses.replace(replayed, fan=fan)


def _told(
    case: _Case, handed: _Handed, replayed: Replayed, timed: clock.Timed, bare: Plant, torque: bool
) -> Diagnosis:
    """Everything in words."""
    done, found, correction, _, file, whole = handed
    names, loop, test = correction.names, case.loop, case.parts.test
    # What is less likely than not, with all that has a name and would do in its place, is handed over and has no name.
    distinct = {k: s for k, s in done.shares.items() if listing.distinct(found, k)}
    kept = {
        k: s for k, s in distinct.items() if probability(done.odds[k].or_another) >= Settings.likely
    }
    effects = listing.listed(found, done.search, done.instead, kept, done.odds, loop, names)
    discrepancy = checks.discrepancy(correction.numbers, whole, timed.steps)
    # Where nothing is distinct the file differs from the model within its tolerances, and by a clock.
    in_tolerance = not distinct and not done.harm
    sure = [done.odds[k] for k in kept]
    told = proof.judgement(replayed, sure, discrepancy, done, in_tolerance)
    notes = [*dict.fromkeys(n for r in whole for n in checks.objections(r, names))]
    notes += [*causal.notes(found, loop, torque), *checks.touch_note(whole)]
    notes += [_HARM] if done.harm else []
    if handed.changed:
        notes += _of_friction(done, found, bare, case.parts.validation)
    left = [x.name for x in told.left if x.name in names]
    like = resemblances(names, left, replayed.corrected, test)
    return Diagnosis(
        told.verdict, told.log_odds, proof.headline(told, replayed, like), effects, done.everything, found,
        correction, file.text, changes(case.given, file.model), _clock(found, effects, loop), replayed,
        discrepancy, told.left, like, told.impossible,
        proof.worse(replayed, names), (*notes, *file.remarks),
    )  # fmt: skip


def _correction(
    done: choice.Chosen, found: Fit, loop: Loop, records: Sequence[Record], in_file: InFile
) -> Correction:
    """What is handed over of a fit."""
    plant = done.plant
    numbers = plant.numbers(found.table, found.theta, None)
    changed = bool(np.any(found.theta != choice.nominal_fit(found).theta))
    friction = proof.mean_friction(numbers, records) if numbers.varies else numbers.dry
    holds = changed and plant.holds
    return Correction(
        plant.names, loop, numbers, in_file(numbers), plant.nominal, friction, holds, plant.pairs
    )


def _harms(case: _Case, model: MjModel, c: Correction) -> bool:
    """Whether the file replays the validation rows worse than the model as given."""
    errors, rows = [], case.parts.validation
    for one in (case.given, model):
        paths = tuple(handover.replayed(one, c.names, c.loop, r) for r in rows)
        errors.append(total(Replayed(rows, paths, paths, np.zeros(0), "").before))
    return errors[1] > errors[0]


def _of_friction(done: choice.Chosen, found: Fit, bare: Plant, validation) -> list[str]:
    """What is to be said of friction at rest."""
    if not done.plant.holds:
        return [_LIKE_MUJOCO]
    return proof.creeping(done.plant, bare, found, validation)


def _clock(found: Fit, effects, loop: Loop) -> tuple[tuple[str, Size], ...]:
    """Numbers of the loop's clock that are handed over and are no effect."""
    listed = {e.family for e in effects if e.kind == "global"}
    return tuple(
        (p.family, listing.size_of(found, k, loop))
        for k, p in enumerate(found.table)
        if p.family in CLOCK
        and p.joint < 0
        and p.family not in listed
        and found.theta[k] != p.nominal
    )


def _on_all(plant: Plant, found: Fit, records: Sequence[Record]) -> Fit:
    """The numbers that are in, fitted to the validation rows too, once these have said which those are."""
    least = checks.least(records, plant.loop)
    return fit(
        plant,
        found.table,
        records,
        found.theta,
        free=found.moved,
        floor=least,
        rounds=3,
        exact=True,
    )
