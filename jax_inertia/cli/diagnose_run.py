"""What `jax-inertia diagnose` computes, writes and prints."""

import argparse
import dataclasses
import functools
import json
from collections.abc import Callable, Sequence
from pathlib import Path

import mujoco
import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from jax_inertia.cli import diagnose_whole as output
from jax_inertia.cli import replay_run
from jax_inertia.cli.console import warn
from jax_inertia.cli.conventions import met
from jax_inertia.cli.replay_run import SILENT, Gains
from jax_inertia.diagnosis.effects.registry import NAMES as BY_TORQUE
from jax_inertia.diagnosis.simulate.corrected import Correction, corrected
from jax_inertia.diagnosis.simulate.rollout import Rollouts, rollouts
from jax_inertia.gap import either
from jax_inertia.gap.finding import Diagnosis, effects_of, known_of
from jax_inertia.gap.html import Page, page
from jax_inertia.gap.report import to_report
from jax_inertia.gap.verdict import Verdict
from jax_inertia.logs.log import Log, LogError
from jax_inertia.logs.log_files import read_log
from jax_inertia.logs.readers import Options
from jax_inertia.model.load import (
    compile_spec,
    is_urdf,
    load_model,
    load_spec,
    model_path,
    write_urdf,
)
from jax_inertia.model.log_match import afloat
from jax_inertia.model.robot import Robot
from jax_inertia.model.write import changed_inertials, loadable
from jax_inertia.preflight.preflight import Finding as Quality
from jax_inertia.preflight.preflight import Severity
from jax_inertia.replay import entry
from jax_inertia.text.words import percent, plain


@dataclasses.dataclass(frozen=True)
class Inputs:
    """What was read, and found sound."""

    model: Path
    path: Path
    robot: Robot
    log: Log
    test_log: Log | None
    quality: tuple[Quality, ...]
    more: tuple[Log, ...] = ()
    of_loop: bool = False
    """Whether torques are not of the log, but what a position loop gives."""
    replayed: bool = False
    """Whether targets are replayed."""
    uncertainty: tuple[float, float, float] | None = None
    """Standard deviations of the model's masses (relative), centres [m] and inertias (relative), where stated."""


@dataclasses.dataclass(frozen=True)
class Result:
    """What was found, and what becomes of it."""

    found: Diagnosis
    nominal: mujoco.MjSpec
    correction: Correction
    rollouts: Rollouts | None
    report: dict


def read(
    model: Path,
    log: Path,
    test_log: Path | None,
    exclude: Sequence[str],
    conventions: argparse.Namespace | None = None,
    gains: Gains = SILENT,
    more: Sequence[Path] = (),
) -> Inputs:
    """Read model and logs, and look at them before anything is computed; ValueError with one line.

    `conventions` are the options of `cli.conventions`, `gains` those of a position loop. `more` logs are fitted with
    the first, where targets are replayed.
    """
    if unknown := entry.unknown_families(exclude):
        raise ValueError(
            f"--exclude {' '.join(unknown)}: no such family; valid: {', '.join(entry.FAMILIES)}"
        )
    held = gains.fix_base
    robot = load_model(compile_spec(entry.nominal_spec(model, True), model) if held else model)
    paths = (log, *more, *([] if test_log is None else [test_log]))
    options = Options(time_unit=None if conventions is None else conventions.time_unit)
    given = [read_log(path, names=robot, options=options) for path in paths]
    robot, told = afloat(robot, model, given[0])
    of_loop = given[0].tau is None and robot.has_free_base
    given = [entry.of_loop(one, robot, model, gains.kp, gains.kd) for one in given]
    quality: list[Quality] = [*told]
    if conventions is not None:
        robot, given, notes = met(conventions, robot, given, gains=conventions.gains)
        quality += notes
    logs: list[Log] = []
    drives = None
    for path, one in zip(paths, given, strict=True):
        try:
            if one.tau is None and (not logs or logs[0].tau is None):
                findings = entry.usable(one, robot)
            else:
                one, drives, findings = either.usable(one, robot, drives, path.name)
        except LogError as error:
            raise LogError(f"{path}: {error}") from None
        logs.append(one)
        quality += [f._replace(message=f"{path.name}: {f.message}") for f in findings]
    for finding in quality:
        if finding.severity is Severity.WARNING:
            warn(finding.message)
    replayed = logs[0].tau is None or (
        not of_loop and entry.replayable(model, given, gains.kp, gains.kd, held)
    )
    if more and not replayed:
        raise ValueError(
            f"--more-logs is for logs of targets that are replayed, and {log.name} is diagnosed by its torque: leave "
            "it out"
        )
    last = len(more) + 1
    test = logs[last] if test_log is not None else None
    more_logs = tuple(logs[1:last])
    return Inputs(model, log, robot, logs[0], test, tuple(quality), more_logs, of_loop, replayed)


def diagnosed(
    folder: Path,
    inputs: Inputs,
    exclude: Sequence[str],
    max_effects: int,
    stage: Callable[[str], None],
    gains: Gains = SILENT,
) -> Callable[..., None]:
    """Diagnose, and write everything into a folder; what prints it, given where it is and `as_json`.

    By replays of the targets where the loop is known, torque or none; else by torque, and the loop on its own.
    """
    if inputs.replayed:
        paths, logs = (inputs.path, inputs.model), (inputs.log, *inputs.more)
        loop = {"kp": gains.kp, "kd": gains.kd, "fix_base": gains.fix_base}
        found = entry.by_replays(
            inputs.model, logs, inputs.test_log, exclude, progress=stage, **loop
        )
        if not entry.left_to_torque(found, logs):
            stage("writing")
            return replay_run.written(folder, paths, found, inputs.log, gains, inputs.quality)
        exclude = [x for x in exclude if x in BY_TORQUE]
    show_it = by_torque(folder, inputs, exclude, max_effects, stage)
    if inputs.of_loop:
        return show_it
    return replay_run.add_command(folder, inputs.model, inputs.log, gains, show_it)


def by_torque(
    folder: Path,
    inputs: Inputs,
    exclude: Sequence[str],
    max_effects: int,
    stage: Callable[[str], None],
) -> Callable[..., None]:
    """Diagnose torque → motion, and write everything into a folder; what prints it."""
    asked = either.Asked(exclude, (), inputs.uncertainty, stage)
    found = either.searched(inputs.robot, (inputs.log, inputs.test_log), asked, max_effects)
    if isinstance(found, Diagnosis):
        result = corrected_by(inputs, found, stage)
        stage("writing")
        write(folder, inputs, result)
        return functools.partial(show, result)
    stage("writing")
    paths = inputs.path, inputs.model
    report = output.write(folder, found, inputs.robot, inputs.log, paths, inputs.quality)
    return functools.partial(output.show, found, report)


def single_effects(
    inputs: Inputs, exclude: Sequence[str], max_effects: int, stage: Callable[[str], None]
) -> Result:
    """What a calibrated model lacks, and what becomes of it."""
    asked = either.Asked(exclude, (), inputs.uncertainty, stage)
    logs = inputs.log, inputs.test_log
    return corrected_by(
        inputs, either.single_effects(inputs.robot, logs, asked, max_effects), stage
    )


def corrected_by(inputs: Inputs, found: Diagnosis, stage: Callable[[str], None]) -> Result:
    """Correct the model by what was found, and roll both models out."""
    stage("rolling models out in MuJoCo")
    floats = is_urdf(model_path(inputs.model)) and inputs.robot.has_free_base
    nominal, wanted = (load_spec(inputs.model, floating_base=floats) for _ in range(2))
    for spec in (nominal, wanted):
        spec.option.gravity = np.asarray(inputs.robot.gravity)
    correction = corrected(wanted, effects_of(found))
    # Joints that are held are free in the file.
    whole = compile_spec(nominal).nv == inputs.robot.nv
    given = known_of(found, inputs.robot, inputs.log)
    rolled = rollouts(nominal, correction, inputs.robot, inputs.log, given) if whole else None
    report = to_report(found, rollouts=rolled, quality=inputs.quality)
    return Result(found, nominal, correction, rolled, report)


NO_CORRECTION = "verdict unknown: the effects in this model are the nearest ones, and no correction"


def write(folder: Path, inputs: Inputs, result: Result) -> None:
    """report.json, report.html and corrected.xml; for a URDF whose inertials change corrected.urdf too."""
    text = json.dumps(result.report, indent=1, allow_nan=False)
    (folder / "report.json").write_text(text + "\n")
    model = loadable(result.correction.spec, inputs.model, folder.parent)
    if result.found.verdict is Verdict.UNKNOWN and result.found.findings:
        model = f"<!-- {NO_CORRECTION} -->\n{model}"
    (folder / "corrected.xml").write_text(model)
    nominal, mended = compile_spec(result.nominal), compile_spec(result.correction.spec)
    if is_urdf(model_path(inputs.model)) and (pi := changed_inertials(nominal, mended)):
        write_urdf(model_path(inputs.model), folder / "corrected.urdf", pi)
    content = Page(
        inputs.path.name,
        inputs.model.name,
        inputs.log,
        result.found,
        result.correction,
        result.rollouts,
        result.report,
    )
    (folder / "report.html").write_text(page(content))


def show(result: Result, out: Path, *, as_json: bool) -> None:
    """Print what was found."""
    if as_json:
        print(json.dumps(result.report, indent=1, allow_nan=False))
        return
    console = Console()
    console.print(escape(result.found.headline), highlight=False)
    table(console, result.found)
    for kind, text in shrink_lines(result):
        console.print(f"{kind:>22}: {text}", highlight=False, soft_wrap=True)
    for doubt in result.found.doubts:
        console.print(f"doubt: {escape(doubt)}", highlight=False, soft_wrap=True)
    said = [q["message"] for q in result.report["data_quality"]]
    for note in result.found.notes:
        # What is wrong with the log was said when it was read.
        if not any(note in message for message in said):
            console.print(f"note: {escape(note)}", highlight=False, soft_wrap=True)
    if wanted := result.report["suggested_motion"]:
        console.print(f"to tell ties apart: {escape(wanted['text'])}", soft_wrap=True)
    console.print(f"report: {escape(str(out / 'report.html'))}", soft_wrap=True, highlight=False)


def table(console: Console, found: Diagnosis) -> None:
    """Verdict and effects."""
    rows = Table(
        title=f"{plain(str(found.verdict))} ({found.certainty})",
        title_justify="left",
    )
    for name in ("effect", "where", "size, 95 % interval", "explains", "or"):
        rows.add_column(name)
    for f in found.findings:
        rows.add_row(
            f.family,
            escape(f.place.name),
            escape("\n".join(f.sizes)),
            percent(f.explained),
            escape(f.rivals),
        )
    if found.findings:
        console.print(rows)
    else:
        console.print(rows.title)


def shrink_lines(result: Result) -> list[tuple[str, str]]:
    """How far the gap shrinks, in up to three ways."""
    found, rolled = result.found, result.rollouts
    out = []
    for name, s in (("held-out residual", found.heldout), ("other motion", found.test)):
        if s is not None:
            text = f"{s.before:.3g} → {s.after:.3g} {found.unit} (floor {s.noise:.2g})"
            out.append((name, text))
    if rolled is not None:
        sizes = [rolled.shown * x for x in (rolled.before, rolled.after, rolled.floor)]
        text = "{:.3g} → {:.3g} {} (floor {:.2g})".format(*sizes[:2], rolled.shown_in, sizes[2])
        out.append((f"{rolled.horizon:g} s rollouts", text))
    return out
