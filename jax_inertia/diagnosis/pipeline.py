"""`diagnose`: log → residual → hypotheses → posterior → checks → verdict."""

import dataclasses
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float
from threadpoolctl import threadpool_limits

from jax_inertia.diagnosis.calibration_state import log_odds_as_bought, stated_by_model
from jax_inertia.diagnosis.certainty.causes import borne_out, judges_of, remembering
from jax_inertia.diagnosis.certainty.rivals import told_apart
from jax_inertia.diagnosis.checks import LEAST_ROWS, PASSING, HeldOut, OtherRun, gated, rms
from jax_inertia.diagnosis.conclusion.stated_causes import Causes, causes_of
from jax_inertia.diagnosis.conclusion.summary import concluded, drafted
from jax_inertia.diagnosis.corrected.handed_over import HandedOver
from jax_inertia.diagnosis.detectability import undetectable
from jax_inertia.diagnosis.effects.base import Effect
from jax_inertia.diagnosis.effects.registry import NAMES, effects_of
from jax_inertia.diagnosis.features.context import Context
from jax_inertia.diagnosis.hypothesis import Hypothesis
from jax_inertia.diagnosis.report.json_report import to_report
from jax_inertia.diagnosis.residual import Residual
from jax_inertia.diagnosis.result import Diagnosis
from jax_inertia.diagnosis.search.ordinary import ordinary_of
from jax_inertia.diagnosis.search.refuted_tolerances import named_where_refuted
from jax_inertia.diagnosis.search.selection import Selection
from jax_inertia.diagnosis.search.stepwise import searched, started
from jax_inertia.diagnosis.settings import CalibrationState, Settings
from jax_inertia.diagnosis.simulate.whole_robot import correction
from jax_inertia.logs.log import Log
from jax_inertia.model.mujoco_types import MjSpec
from jax_inertia.model.robot import Robot
from jax_inertia.model.robot_spec import spec_of
from jax_inertia.model.spec import compile_spec
from jax_inertia.model.write import loadable
from jax_inertia.text.words import number

Progress = Callable[[str], None]


# NumPy's BLAS, SciPy's and XLA each keep a thread a core, spinning: on systems of 200 numbers they wait for each other.
@threadpool_limits.wrap(limits=1, user_api="blas")
def diagnose(
    robot: Robot,
    log: Log,
    *,
    validation_log: Log | None = None,
    test_log: Log | None = None,
    nominal: MjSpec | None = None,
    exclude: Sequence[str] = (),
    extra: Sequence[Effect] = (),
    settings: Settings = Settings(),  # noqa: B008 (frozen)
    state: CalibrationState | None = None,
    progress: Progress = lambda stage: None,
) -> Diagnosis:
    """Find the ordinary physics of every joint that the model lacks, and what is odd beyond it.

    Torques in N m. `exclude` removes families, `extra` adds effects of your own. `validation_log` is another motion by
    which effects are chosen; without it stretches of the log are, each predicted from the others. `test_log` is read
    once, at the end: its error is quoted, and no number and no choice depends on it. `nominal` is the spec that the
    robot came from, which corrected.xml is made of; without it one is made of the robot. `state`: whether the model has
    its joints' ordinary physics; the log says where it is left out. Raises ValueError for an unknown family and
    LogError for a log that does not fit the robot.
    """
    library, residual = _begun(robot, log, exclude, extra, settings, progress)
    if state is None and not _shows_joints(residual):
        # Forces of the ground use up what legs' torques would say of their joints' ordinary physics.
        state = stated_by_model(robot)
    as_bought = np.inf if state is CalibrationState.AS_BOUGHT else -np.inf
    if state is None:
        selection, as_bought = _selected(residual, library, settings, progress)
    else:
        selection = searched(
            started(residual, library, settings, state), library, settings, progress
        )
    if selection.state is CalibrationState.CALIBRATED:
        selection = named_where_refuted(selection, settings)
    spec = spec_of(robot) if nominal is None else nominal
    unseen = Unseen(robot, spec, validation_log, test_log, tuple(extra))
    return _judged(unseen, selection, as_bought, settings, progress)


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


class Unseen(NamedTuple):
    """What a selection is judged with."""

    robot: Robot
    nominal: MjSpec
    validation_log: Log | None
    test_log: Log | None
    extra: tuple[Effect, ...]


def _judged(
    unseen: Unseen, selection: Selection, as_bought: float, settings: Settings, progress: Progress
) -> Diagnosis:
    """Which of what was selected are causes, and what is to be said of them."""
    progress("checking on rows that numbers were not fitted to")
    heldout = HeldOut(selection, settings)
    validation = _other_run(unseen.robot, unseen.validation_log, selection, settings)
    judges = judges_of(heldout, validation)
    judge = judges[-1]
    if validation is not None:
        selection = told_apart(selection, validation, settings)
    gate, dropped = gated(selection, judge, settings)
    whole = remembering(gate, gate.posterior)
    everything = min(gate.posterior, whole.posterior, key=judge.error)
    selection = borne_out(whole, judges)

    def made(chosen: Selection) -> Made:
        causes = causes_of(chosen, everything, judges, dropped, settings)
        own = heldout.by_noise_of(causes.told.evidence)
        draft = drafted(causes, own, as_bought, settings)
        done = correction(_nominal(unseen), unseen.robot, draft, unseen.extra)
        draft = dataclasses.replace(draft, corrected=done)
        handed = _handed_over(draft, unseen)
        return Made(causes, draft, handed, own, causes.left(own, handed))

    done = _borne_out_by_files(selection, settings.gate, made)
    progress("what this log would have shown")
    context = selection.residual.context
    fast = np.percentile(np.abs(context.v), 99, axis=0)
    draft = dataclasses.replace(
        done.draft,
        notes=(
            *selection.residual.log.notes,
            *_of_the_ground(selection.residual),
            *done.draft.notes,
        ),
        undetectable_below=undetectable(selection),
        speed=dict(zip(context.row_names, fast.tolist(), strict=True)),
    )
    progress("the error of what is handed over")
    test = _other_run(unseen.robot, unseen.test_log, selection, settings)
    rows = done.heldout, done.left
    return concluded(draft, done.causes, done.handed, rows, validation, test)


class Made(NamedTuple):
    """What is stated of a selection, and what is handed over."""

    causes: Causes
    draft: Diagnosis
    handed: HandedOver
    heldout: HeldOut
    """Rows predicted from the others by the noise of what is stated."""
    left: Float[np.ndarray, "R n"]
    """Of those by what is handed over [N m]."""


def _borne_out_by_files(
    selection: Selection, gate: float, made: Callable[[Selection], Made]
) -> Made:
    """The causes, those withheld from the files by which held-out rows are predicted worse by a share `gate`.

    They are sought where the files lose as much of what the fit predicts. A spring between motor and link may be there
    beyond doubt, and no model that holds it predict as well as one without it: it is named, and not handed over. The
    worst first, one at a time, everything else refitted.
    """
    whole = now = made(selection)
    withheld: list[Hypothesis] = []
    moving = now.heldout.residual.moving
    while True:
        error = rms(now.left, moving)
        if error <= (1.0 + gate) * rms(now.heldout.left(now.causes.now), moving):
            break
        odd = [h for h in selection.odd if h.named and h.family not in PASSING]
        rests = [
            dataclasses.replace(selection, posterior=selection.posterior.without(h)) for h in odd
        ]
        tried = [made(rest) for rest in rests]
        errors = [rms(one.left, moving) for one in tried]
        if not tried or min(errors) >= (1.0 - gate) * error:
            break
        best = int(np.argmin(errors))
        withheld.append(odd[best])
        selection, now = rests[best], tried[best]
    keys = {(h.family, h.place) for h in withheld}
    named = (f for f in whole.draft.found if (f.family, f.place) in keys)
    named = tuple(dataclasses.replace(f, handed_over=False) for f in named)
    draft = dataclasses.replace(
        now.draft,
        found=(*now.draft.found, *named),
        not_listed=tuple(x for x in now.draft.not_listed if (x.family, x.place) not in keys),
    )
    return now._replace(draft=draft, causes=now.causes.naming(keys))


def _handed_over(draft: Diagnosis, unseen: Unseen) -> HandedOver:
    """The files of a diagnosis as they would be written, read back."""
    robot, nominal, done = unseen.robot, _nominal(unseen), draft.corrected
    given = compile_spec(nominal)
    if given.nv != robot.nv:
        # Joints that the robot holds are free in its file, and no log says where they are.
        given = compile_spec(spec_of(robot))
        done = correction(spec_of(robot), robot, draft, unseen.extra)
    assert done is not None
    report = json.loads(json.dumps(to_report(draft), allow_nan=False))
    text = loadable(done.spec, Path(nominal.modelfiledir or "model.xml"), Path("/"))
    return HandedOver(report, mujoco.MjModel.from_xml_string(text), given, unseen.extra)


def _nominal(unseen: Unseen) -> MjSpec:
    """The spec of the model's file, its base as the robot's."""
    out = unseen.nominal.copy()
    out.option.gravity = np.asarray(unseen.robot.gravity)
    return out


def _of_the_ground(residual: Residual) -> tuple[str, ...]:
    """What a log without contact wrenches can tell."""
    if residual.prepared.support is None:
        return ()
    bodies = ", ".join(residual.prepared.support.bodies)
    return (
        f"no contact wrench is measured: forces at {bodies} are taken from their legs' own torques, so that an effect "
        "is seen by what it does to the base's balance alone",
    )


def _shows_joints(residual: Residual) -> bool:
    """Whether most joints that move have rows of their own: all of a robot in the air, those of legs that swing."""
    rows = list(residual.context.joint_dofs.values())
    return bool(np.median(residual.weight[:, rows].sum(axis=0)) >= LEAST_ROWS)


def _selected(
    residual: Residual, library: tuple[Effect, ...], settings: Settings, progress: Progress
) -> tuple[Selection, float]:
    """The search of a robot as bought or of one whose model is calibrated, and the log odds of the former [nats].

    Every joint votes before anything odd is known; where that does not tell, after the search; and where some joints
    lack what others have, rows that no number was fitted to say which of the two searches predicts them.
    """
    progress("ordinary physics of every joint")
    bought = started(residual, library, settings, CalibrationState.AS_BOUGHT)
    progress(_first_answer(bought))
    odds = log_odds_as_bought(bought, settings)
    decided = odds <= -settings.odd_odds
    if not decided:
        bought = searched(bought, library, settings, progress)
        odds = log_odds_as_bought(bought, settings)
        if odds > settings.as_bought:
            return bought, odds
        decided = odds <= -settings.odd_odds
    start = started(residual, library, settings, CalibrationState.CALIBRATED)
    calibrated = searched(start, library, settings, progress)
    if not decided:
        odds += _predicts_better(bought, calibrated, settings)
    return (bought if odds > settings.as_bought else calibrated), odds


def _predicts_better(one: Selection, other: Selection, settings: Settings) -> float:
    """By how much rows that numbers were not fitted to are likelier by one search than by another [nats]."""
    a, b = (HeldOut(x, settings) for x in (one, other))
    return a.likelier(a.left(one.posterior), b.left(other.posterior))


def _first_answer(start: Selection) -> str:
    """The torque error of the log before and after ordinary physics alone, which is known after seconds."""
    y, weight, now = start.residual.y, start.residual.weight, start.posterior
    after = y - np.sum([now.torque(h) for h in now.chosen], axis=0)
    sizes = f"{number(rms(y, weight))} → {number(rms(after, weight))} N m"
    return f"ordinary physics alone: torque error of this log {sizes}; now odd effects"


def _other_run(
    robot: Robot, log: Log | None, selection: Selection, settings: Settings
) -> OtherRun | None:
    if log is None:
        return None
    ordinary = ordinary_of(selection.residual, selection.posterior)
    residual = Residual(robot, log, settings).calibrated(ordinary)
    return OtherRun(residual, selection.evidence)


def _require_rows(residual: Residual, log: Log) -> None:
    count = residual.weight.sum(axis=0)
    if count.max(initial=0.0) < LEAST_ROWS:
        rate = residual.band.rows
        raise ValueError(
            f"{log.duration:.3g} s of log leave {count.max(initial=0.0):.0f} moving rows at most; at least "
            f"{LEAST_ROWS} are needed, about {LEAST_ROWS / rate:.0f} s of motion"
        )
