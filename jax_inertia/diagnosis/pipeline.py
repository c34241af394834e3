"""`diagnose`: log → residual → hypotheses → posterior → checks → verdict."""

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
from threadpoolctl import threadpool_limits

from jax_inertia.diagnosis import summary
from jax_inertia.diagnosis.calibration_state import log_odds_as_bought
from jax_inertia.diagnosis.causes import borne_out, judges_of, remembering
from jax_inertia.diagnosis.checks import HeldOut, OtherRun, gated, told_apart
from jax_inertia.diagnosis.detectability import undetectable
from jax_inertia.diagnosis.effects.base import Effect
from jax_inertia.diagnosis.effects.registry import NAMES, effects_of
from jax_inertia.diagnosis.features.context import Context
from jax_inertia.diagnosis.residual import Residual
from jax_inertia.diagnosis.result import Diagnosis
from jax_inertia.diagnosis.search.ordinary import ordinary_of
from jax_inertia.diagnosis.search.refuted_tolerances import named_where_refuted
from jax_inertia.diagnosis.search.selection import Selection
from jax_inertia.diagnosis.search.stepwise import searched, started
from jax_inertia.diagnosis.settings import CalibrationState, Settings
from jax_inertia.logs.log import Log
from jax_inertia.model.robot import Robot

Progress = Callable[[str], None]


# NumPy's BLAS, SciPy's and XLA each keep a thread a core, spinning: on systems of 200 numbers they wait for each other.
@threadpool_limits.wrap(limits=1, user_api="blas")
def diagnose(
    robot: Robot,
    log: Log,
    *,
    test_log: Log | None = None,
    exclude: Sequence[str] = (),
    extra: Sequence[Effect] = (),
    settings: Settings = Settings(),  # noqa: B008 (frozen)
    state: CalibrationState | None = None,
    progress: Progress = lambda stage: None,
) -> Diagnosis:
    """Find the ordinary physics of every joint that the model lacks, and what is odd beyond it.

    Torques in N m. `exclude` removes families, `extra` adds effects of your own, `test_log` is another motion: effects
    must carry over to it. `state`: whether the model has its joints' ordinary physics; the log says where it is left
    out. Raises ValueError for an unknown family and LogError for a log that does not fit the robot.
    """
    library, residual = _begun(robot, log, exclude, extra, settings, progress)
    selection, as_bought = None, np.inf if state is CalibrationState.AS_BOUGHT else -np.inf
    if state is None and residual.prepared.support is not None:
        # Forces of the ground use up what legs' torques would say of their joints' ordinary physics.
        state = CalibrationState.CALIBRATED
    if state is None:
        selection, as_bought = _selected_as_bought(residual, library, settings, progress)
        state = CalibrationState.CALIBRATED
    if selection is None:
        selection = searched(
            started(residual, library, settings, state), library, settings, progress
        )
    if selection.state is CalibrationState.CALIBRATED:
        selection = named_where_refuted(selection, settings)
    return _judged(robot, test_log, selection, as_bought, settings, progress)


def _begun(robot, log: Log, exclude, extra, settings: Settings, progress: Progress):
    """The library of effects and the log's torque residual."""
    if unknown := sorted(set(exclude) - set(NAMES)):
        raise ValueError(f"unknown families {unknown}; valid: {', '.join(NAMES)}")
    if taken := sorted({e.name for e in extra} & set(NAMES)):
        raise ValueError(f"the library has families {taken} already; give yours another name")
    progress("filtering the log")
    Context.foresee(robot)
    residual = Residual(robot, log, settings)
    residual.context.foresee_sensitivity()
    _require_rows(residual, log)
    return (*(e for e in effects_of(log) if e.name not in exclude), *extra), residual


def _judged(
    robot: Robot,
    test_log: Log | None,
    selection: Selection,
    as_bought: float,
    settings: Settings,
    progress: Progress,
) -> Diagnosis:
    """Which of what was selected are causes, and what is to be said of them."""
    progress("checking on held-out stretches and on the other motion")
    heldout = HeldOut(selection, settings)
    other = None if test_log is None else _other_run(robot, test_log, selection, settings)
    judge = heldout if other is None else other
    if other is not None:
        selection = told_apart(selection, other, settings)
    gate, dropped = gated(selection, judge, settings)
    whole = remembering(gate, gate.posterior)
    everything = min(gate.posterior, whole.posterior, key=judge.error)
    selection = borne_out(whole, judges_of(heldout, other))
    found = summary.summarised(selection, everything, heldout, other, dropped, as_bought, settings)
    progress("what this log would have shown")
    context = selection.residual.context
    fast = np.percentile(np.abs(context.v), 99, axis=0)
    return dataclasses.replace(
        found,
        notes=(*selection.residual.log.notes, *_of_the_ground(selection.residual), *found.notes),
        undetectable_below=undetectable(selection),
        speed=dict(zip(context.row_names, fast.tolist(), strict=True)),
    )


def _of_the_ground(residual: Residual) -> tuple[str, ...]:
    """What a log without contact wrenches can tell."""
    if residual.prepared.support is None:
        return ()
    bodies = ", ".join(residual.prepared.support.bodies)
    return (
        f"no contact wrench is measured: forces at {bodies} are taken from their legs' own torques, so that an effect "
        "is seen by what it does to the base's balance alone",
    )


def _selected_as_bought(
    residual: Residual, library: tuple[Effect, ...], settings: Settings, progress: Progress
) -> tuple[Selection | None, float]:
    """The search of a robot as bought, None where its model is calibrated, and the log odds of the former [nats].

    Every joint votes before anything odd is known; where that does not tell, after the search.
    """
    progress("ordinary physics of every joint")
    bought = started(residual, library, settings, CalibrationState.AS_BOUGHT)
    odds = log_odds_as_bought(bought, settings)
    if odds <= -settings.odd_odds:
        return None, odds
    bought = searched(bought, library, settings, progress)
    odds = log_odds_as_bought(bought, settings)
    return bought if odds > settings.as_bought else None, odds


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
