"""What a whole-robot diagnosis writes and prints."""

import json
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from jax_inertia.diagnosis.report.json_report import to_report
from jax_inertia.diagnosis.report.json_values import clean
from jax_inertia.diagnosis.report.next_motion import next_step, to_record
from jax_inertia.diagnosis.report.page import page
from jax_inertia.diagnosis.result import Diagnosis
from jax_inertia.diagnosis.simulate.rollout import rollouts
from jax_inertia.diagnosis.simulate.whole_robot import turning_of
from jax_inertia.logs.log import Log
from jax_inertia.model.load import compile_spec, is_urdf, load_spec, model_path
from jax_inertia.model.mujoco_types import MjSpec
from jax_inertia.model.robot import Robot
from jax_inertia.model.write import changes, loadable, write_urdf_as
from jax_inertia.text.words import chance, interval, number, plain, plus_minus, unit, where


def nominal_of(model: Path, robot: Robot) -> MjSpec:
    """The spec of a model's file, its base as the robot's."""
    floats = is_urdf(model_path(model)) and robot.has_free_base
    spec = load_spec(model, floating_base=floats)
    spec.option.gravity = np.asarray(robot.gravity)
    return spec


def write(
    folder: Path,
    found: Diagnosis,
    robot: Robot,
    log: Log,
    paths: tuple[Path, Path],
    quality,
) -> dict:
    """report.json, report.html and corrected.xml (of a URDF corrected.urdf too); the report. `paths`: log and model."""
    source, model = paths
    nominal, done = nominal_of(model, robot), found.corrected
    assert done is not None
    rolled = None
    # Joints that are held are free in the file.
    if compile_spec(nominal).nv == robot.nv:
        rolled = rollouts(nominal, done, robot, log, turning_of(found, robot))
    report = to_report(found, rollouts=rolled, quality=quality)
    report["notes"] += list(done.notes)
    before, after = compile_spec(nominal), compile_spec(done.spec)
    report["changes"] = clean([c._asdict() for c in changes(before, after)])
    if is_urdf(model_path(model)):
        lost = write_urdf_as(model_path(model), folder / "corrected.urdf", before, after)
        report["notes"] += [lost] if lost else []
    text = json.dumps(report, indent=1, allow_nan=False)
    (folder / "report.json").write_text(text + "\n", encoding="utf-8")
    (folder / "corrected.xml").write_text(
        loadable(done.spec, model, folder.parent), encoding="utf-8"
    )
    content = page(found, done, log, (source.name, model.name), report, rolled)
    (folder / "report.html").write_text(content, encoding="utf-8")
    return report


def _joints(found: Diagnosis) -> Table:
    """Each joint's numbers and torque error."""
    geared = ", motor's gain" if found.gains else ""
    table = Table(
        title=f"each joint, ± 95 %: viscous and dry friction, rotor inertia, offset{geared}",
        title_justify="left",
    )
    for name in (
        "joint",
        "viscous",
        "dry friction",
        "rotor inertia",
        "offset",
        *(["gain"] if found.gains else []),
        "torque error before → after",
    ):
        table.add_column(name)
    for joint, own in found.joints.items():
        cells = [plus_minus(p.value, p.low, p.high) for p in own.values()]
        if found.gains:
            p = found.gains.get(joint)
            cells.append("1" if p is None else plus_minus(p.value, p.low, p.high))
        before, after = found.checked.per_joint[joint]
        table.add_row(escape(joint), *cells, f"{before:.2g} → {after:.2g}")
    return table


def show(found: Diagnosis, report: dict, out: Path, *, as_json: bool) -> None:
    """Headline, the joints' table, odd effects, what remains."""
    if as_json:
        print(json.dumps(report, indent=1, allow_nan=False))
        return
    console = Console()
    sure = f"{plain(str(found.verdict))} (confidence {chance(found.confidence)})"
    console.print(f"[bold]{sure}[/bold]")
    console.print(escape(found.headline), highlight=False)
    console.print(_joints(found))
    if (least := found.checked.least_squares) is not None:
        told = f"{found.checked.before:.3g} N m as given, {least:.3g} by plain least squares of four terms a joint, "
        console.print(
            f"{found.checked_on}: {told}{found.checked.after:.3g} by these files", highlight=False
        )
    for f in found.odd:
        sizes = "; ".join(
            f"{plain(n)} {interval(w.value, w.low, w.high)}{unit(p.unit)}{p.of_model}"
            for n, p, w in ((n, p, p.whole) for n, p in f.parameters.items())
        )
        ties = ", ".join(f"{plain(t.family)} at {where(t.place)}" for t in f.equivalent)
        text = (
            f"{plain(f.family)} at {where(f.place)}: {sizes}; probability {chance(f.probability)}"
        )
        console.print(
            escape(text + (f"; or, not distinguishable by this log, {ties}" if ties else "")),
            highlight=False,
            soft_wrap=True,
        )
    if rolled := report["shrink"]["rollout"]:
        before, after, floor = (number(rolled[k]) for k in ("before", "after", "floor"))
        text = f"{before} → {after} {rolled['unit']} (sensors {floor})"
        console.print(f"{rolled['horizon_s']:g} s rollouts: {text}", highlight=False)
    if wanted := report["suggested_motion"]:
        for one in (wanted, *wanted["others"]):
            console.print(f"record next: {escape(one['text'])}", highlight=False, soft_wrap=True)
    todo = next_step(found, to_record(found))
    console.print(f"next: {escape(todo)}", highlight=False, soft_wrap=True)
    for note in report["notes"]:
        console.print(f"note: {escape(note)}", highlight=False, soft_wrap=True)
    console.print(f"report: {escape(str(out / 'report.html'))}", soft_wrap=True, highlight=False)
