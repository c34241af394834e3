"""What a whole-robot diagnosis writes and prints."""

import json
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from jax_inertia.diagnosis.report.json_report import to_report
from jax_inertia.diagnosis.report.page import page
from jax_inertia.diagnosis.result import Diagnosis
from jax_inertia.diagnosis.simulate.rollout import rollouts
from jax_inertia.diagnosis.simulate.whole_robot import correction, turning_of
from jax_inertia.logs.log import Log
from jax_inertia.model.load import compile_spec, is_urdf, load_spec, model_path, write_urdf
from jax_inertia.model.robot import Robot
from jax_inertia.model.write import changed_inertials, loadable
from jax_inertia.text.words import chance, interval, number, plain, plus_minus, unit, where


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
    floats = is_urdf(model_path(model)) and robot.has_free_base
    nominal, wanted = (load_spec(model, floating_base=floats) for _ in range(2))
    for spec in (nominal, wanted):
        spec.option.gravity = np.asarray(robot.gravity)
    done = correction(wanted, robot, found)
    rolled = None
    # Joints that are held are free in the file.
    if compile_spec(nominal).nv == robot.nv:
        rolled = rollouts(nominal, done, robot, log, turning_of(found, robot))
    report = to_report(found, rollouts=rolled, quality=quality)
    report["notes"] += list(done.notes)
    text = json.dumps(report, indent=1, allow_nan=False)
    (folder / "report.json").write_text(text + "\n")
    (folder / "corrected.xml").write_text(loadable(done.spec, model, folder.parent))
    if is_urdf(model_path(model)):
        before, after = compile_spec(nominal), compile_spec(done.spec)
        if pi := changed_inertials(before, after):
            write_urdf(model_path(model), folder / "corrected.urdf", pi)
    content = page(found, done, log, (source.name, model.name), report, rolled)
    (folder / "report.html").write_text(content)
    return report


def show(found: Diagnosis, report: dict, out: Path, *, as_json: bool) -> None:
    """Headline, the joints' table, odd effects, what remains."""
    if as_json:
        print(json.dumps(report, indent=1, allow_nan=False))
        return
    console = Console()
    sure = f"{plain(str(found.verdict))} (confidence {chance(found.confidence)})"
    console.print(f"[bold]{sure}[/bold]")
    console.print(escape(found.headline), highlight=False)
    geared = ", motor's gain" if found.gains else ""
    table = Table(
        title=f"every joint with 95 % interval: viscous and dry friction, rotor inertia, offset{geared}",
        title_justify="left",
    )
    for name in (
        "joint",
        "viscous",
        "dry friction",
        "rotor inertia",
        "offset",
        *(["gain"] if found.gains else []),
        "error before → after",
    ):
        table.add_column(name)
    for joint, own in found.joints.items():
        cells = [plus_minus(p.value, p.low, p.high) for p in own.values()]
        if found.gains:
            p = found.gains.get(joint)
            cells.append("1" if p is None else plus_minus(p.value, p.low, p.high))
        before, after = found.checked.per_joint[joint]
        table.add_row(escape(joint), *cells, f"{before:.2g} → {after:.2g}")
    console.print(table)
    for f in found.odd:
        sizes = "; ".join(
            f"{plain(n)} {interval(p.value, p.low, p.high)}{unit(p.unit)}"
            for n, p in f.parameters.items()
        )
        ties = ", ".join(f"{plain(t.family)} at {where(t.place)}" for t in f.equivalent)
        text = (
            f"{plain(f.family)} at {where(f.place)}: {sizes}; probability {chance(f.probability)}"
        )
        console.print(
            escape(text + (f"; or {ties}" if ties else "")), highlight=False, soft_wrap=True
        )
    if rolled := report["shrink"]["rollout"]:
        before, after, floor = (number(rolled[k]) for k in ("before", "after", "floor"))
        text = f"{before} → {after} {rolled['unit']} (sensors {floor})"
        console.print(f"{rolled['horizon_s']:g} s rollouts: {text}", highlight=False)
    if wanted := report["suggested_motion"]:
        for one in (wanted, *wanted["others"]):
            console.print(f"record next: {escape(one['text'])}", highlight=False, soft_wrap=True)
    for note in found.notes:
        console.print(f"note: {escape(note)}", highlight=False, soft_wrap=True)
    console.print(f"report: {escape(str(out / 'report.html'))}", soft_wrap=True, highlight=False)
