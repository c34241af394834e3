"""`diagnose`: log → residual → hypotheses → posterior → checks → verdict."""

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from jax_inertia.diagnosis import summary
from jax_inertia.diagnosis.calibration_state import log_odds_as_bought
from jax_inertia.diagnosis.causes import borne_out, remembering
from jax_inertia.diagnosis.checks import HeldOut, OtherRun, gated
from jax_inertia.diagnosis.detectability import undetectable
from jax_inertia.diagnosis.effects.base import Effect
from jax_inertia.diagnosis.effects.registry import NAMES, effects_of
from jax_inertia.diagnosis.residual import Residual
from jax_inertia.diagnosis.result import Diagnosis
from jax_inertia.diagnosis.search.ordinary import ordinary_of
from jax_inertia.diagnosis.search.selection import Selection
from jax_inertia.diagnosis.search.stepwise import searched, started
from jax_inertia.diagnosis.settings import CalibrationState, Settings
from jax_inertia.logs.log import Log
from jax_inertia.model.robot import Robot


def diagnose(
    robot: Robot,
    log: Log,
    *,
    test_log: Log | None = None,
    exclude: Sequence[str] = (),
    extra: Sequence[Effect] = (),
    settings: Settings = Settings(),  # noqa: B008 (frozen)
    progress: Callable[[str], None] = lambda stage: None,
) -> Diagnosis:
    """Find the ordinary physics of every joint that the model lacks, and what is odd beyond it.

    Torques in N m. `exclude` removes families, `extra` adds effects of your own, `test_log` is another motion: effects
    must carry over to it. Raises ValueError for an unknown family and LogError for a log that does not fit the robot.
    """
    if unknown := sorted(set(exclude) - set(NAMES)):
        raise ValueError(f"unknown families {unknown}; valid: {', '.join(NAMES)}")
    library = (*(e for e in effects_of(log) if e.name not in exclude), *extra)
    progress("filtering the log")
    residual = Residual(robot, log, settings)
    _require_rows(residual, log)
    selection, as_bought = _selected(residual, library, settings, progress)
    progress("checking on held-out stretches and on the other motion")
    heldout = HeldOut(selection, settings)
    other = None if test_log is None else _other_run(robot, test_log, selection, settings)
    judge = heldout if other is None else other
    gate, dropped = gated(selection, judge, settings)
    whole = remembering(gate, gate.posterior)
    everything = min(gate.posterior, whole.posterior, key=judge.error)
    selection = borne_out(whole, [heldout] if other is None else [heldout, other])
    found = summary.summarised(selection, everything, heldout, other, dropped, settings)
    progress("what this log would have shown")
    names, fast = residual.context.row_names, np.percentile(np.abs(residual.context.v), 99, axis=0)
    return dataclasses.replace(
        found,
        as_bought=as_bought,
        undetectable_below=undetectable(selection),
        speed=dict(zip(names, fast.tolist(), strict=True)),
    )


def _selected(
    residual: Residual,
    library: tuple[Effect, ...],
    settings: Settings,
    progress: Callable[[str], None],
) -> tuple[Selection, float]:
    """The search, by what the log says of the model's calibration, and that: log odds that it is as bought [nats].

    Every joint votes before anything odd is known; where that does not tell, after the search of a robot as bought.
    """
    progress("ordinary physics of every joint")
    bought = started(residual, library, settings, CalibrationState.AS_BOUGHT)
    odds = log_odds_as_bought(bought, settings)
    if odds > -settings.odd_odds:
        bought = searched(bought, library, settings, progress)
        odds = log_odds_as_bought(bought, settings)
        if odds > settings.as_bought:
            return bought, odds
    start = started(residual, library, settings, CalibrationState.CALIBRATED)
    return searched(start, library, settings, progress), odds


def _other_run(robot: Robot, log: Log, selection: Selection, settings: Settings) -> OtherRun:
    ordinary = ordinary_of(selection.residual, selection.posterior)
    residual = Residual(robot, log, settings).calibrated(ordinary)
    return OtherRun(residual, selection.evidence)


LEAST_ROWS = 20
"""Moving rows of a joint: five for each of its four ordinary numbers."""


def _require_rows(residual: Residual, log: Log) -> None:
    count = residual.weight.sum(axis=0)
    if count.max(initial=0.0) < LEAST_ROWS:
        rate = residual.band.rows
        raise ValueError(
            f"{log.duration:.3g} s of log leave {count.max(initial=0.0):.0f} moving rows at most; at least "
            f"{LEAST_ROWS} are needed, about {LEAST_ROWS / rate:.0f} s of motion"
        )
