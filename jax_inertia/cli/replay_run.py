"""What `jax-inertia replay`, and `diagnose` of a log of targets, compute, write and print."""

import functools
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from jax_inertia.cli import command_page
from jax_inertia.cli.console import warn
from jax_inertia.diagnosis.result import Verdict
from jax_inertia.logs.log import Log, LogError
from jax_inertia.logs.log_files import read_log
from jax_inertia.logs.readers import Options
from jax_inertia.model.load import compile_spec, is_urdf, load_model, load_spec, model_path
from jax_inertia.model.write import write_urdf_as
from jax_inertia.preflight.preflight import Finding, Severity
from jax_inertia.replay import checks, command, handover
from jax_inertia.replay.entry import known_loop, nominal_spec, usable
from jax_inertia.replay.loop import Loop, position_loop
from jax_inertia.replay.output import report
from jax_inertia.replay.output.figures import replays
from jax_inertia.replay.record import record_of
from jax_inertia.replay.result import Diagnosis, Effect, Replayed, total
from jax_inertia.replay.simulation.plant import Plant
from jax_inertia.replay.simulation.spec_edits import without_play
from jax_inertia.text.report_page import with_section
from jax_inertia.text.words import chance, number, percent, plain, unit
from jax_inertia.trainers import exports as trainers


class Gains(NamedTuple):
    """What the command line says of the position loop and of the base."""

    kp: Sequence[float] | None = None
    kd: Sequence[float] | None = None
    fix_base: bool = False


SILENT = Gains()
"""Nothing said."""


def read(
    model: Path, log: Path, gains: Gains, time_unit: str | None = None
) -> tuple[Log, tuple[Finding, ...]]:
    """A log with targets and what is to be said of it; raises `LogError` with one line, names the file."""
    spec = nominal_spec(model, gains.fix_base)
    without_play(spec)
    compiled = compile_spec(spec, model)
    robot = load_model(compiled)
    one = read_log(log, names=robot, options=Options(time_unit=time_unit))
    loop = known_loop(one, compiled, gains.kp, gains.kd, model_first=True)
    try:
        one, findings = usable(one, robot, loop)
    except LogError as error:
        raise LogError(f"{log}: {error}") from None
    for finding in findings:
        if finding.severity is Severity.WARNING:
            warn(f"{log.name}: {finding.message}")
    return one, findings


def replay(model: Path, log: Log, gains: Gains) -> tuple[Loop, Replayed]:
    """The log's targets through the model as it is, in its own steps."""
    spec = nominal_spec(model, gains.fix_base)
    loop = position_loop(log, compile_spec(spec, model), gains.kp, gains.kd, model_first=True)
    plant = Plant(spec, log.joint_names, loop)
    (record,) = checks.settling(plant, [record_of(log, loop)])
    given = handover.nominal_model(nominal_spec(model, gains.fix_base), log.joint_names, loop)
    path = handover.replayed(given, log.joint_names, loop, record)
    return loop, Replayed((record,), (path,), (path,), checks.floor((record,)), "the log")


def write_replay(folder: Path, log: Log, loop: Loop, done: Replayed) -> dict:
    """replay.json and replay.png; the former."""
    names = log.joint_names
    out = {
        "schema": 1,
        "error": {
            "rms": total(done.before),
            "floor": total(done.floor),
            "unit": "rad",
            "per_joint": {
                name: {"rms": float(b), "max": float(m), "floor": float(f)}
                for name, b, m, f in zip(names, done.before, largest(done), done.floor, strict=True)
            },
        },
        "loop": report.loop_report(names, loop),
        "notes": list(checks.objections(done.records[0], names)),
    }
    out = report.clean(out)
    (folder / "replay.json").write_text(
        json.dumps(out, indent=1, allow_nan=False) + "\n", encoding="utf-8"
    )
    figure = replays(names, done, both=False)
    FigureCanvasAgg(figure).print_png(str(folder / "replay.png"))
    return out


def largest(done: Replayed) -> np.ndarray:
    """The largest error of each joint [rad]."""
    return np.abs(done.nominal[0] - done.records[0].q)[done.records[0].settled].max(axis=0)


def show_replay(out: dict, where: Path) -> None:
    """The table of a replay."""
    console, whole = Console(), out["error"]
    table = Table(title="replay of the targets, rad", title_justify="left")
    for name in ("joint", "error, rms", "largest", "encoders leave", "kp", "kd"):
        table.add_column(name)
    for name, own in whole["per_joint"].items():
        gains = out["loop"]["joints"][name]
        cells = (own["rms"], own["max"], own["floor"], gains["kp"], gains["kd"])
        table.add_row(escape(name), *map(number, cells))
    console.print(table)
    for note in out["notes"]:
        console.print(f"note: {escape(note)}", soft_wrap=True, highlight=False)
    text = f"all joints: {number(whole['rms'])} rad rms; gains of the {out['loop']['source']}"
    console.print(text, highlight=False)
    console.print(f"figure: {escape(str(where / 'replay.png'))}", soft_wrap=True, highlight=False)


def written(
    folder: Path,
    paths: tuple[Path, Path],
    found: Diagnosis,
    log: Log,
    quality: Sequence[Finding],
    exports: Sequence[str] = (),
) -> Callable[..., None]:
    """Write all that replays found; what prints it. `paths`: first log and model."""
    source, model = paths
    halves = command.command_half(log, found.loop) if found.replayed.torques else ()
    out = report.to_report(found, quality=quality, halves=halves)
    (folder / "policy.json").write_text(
        json.dumps(out["policy"], indent=1) + "\n", encoding="utf-8"
    )
    text = found.text
    if said := distrust(found):
        text = f"<!-- {said} -->\n{text}"
        warn(said)
    (folder / "corrected.xml").write_text(text, encoding="utf-8")
    if is_urdf(model_path(model)):
        before = compile_spec(load_spec(model))
        after = handover.read_in(found.text, model, folder.parent)
        if lost := write_urdf_as(model_path(model), folder / "corrected.urdf", before, after):
            out["notes"].append(lost)
    (folder / "report.json").write_text(
        json.dumps(out, indent=1, allow_nan=False) + "\n", encoding="utf-8"
    )
    if nothing := trainers.written(folder, found, exports, source.name, model.name):
        warn(nothing)
    page = report.page(found, out, (source.name, model.name))
    if halves:
        loop_effects = out["command"]["effects"]
        page = with_section(page, command_page.part(halves, log, found.loop, loop_effects))
    (folder / "report.html").write_text(page, encoding="utf-8")
    return functools.partial(show, found, out)


def distrust(found: Diagnosis) -> str:
    """Why corrected.xml is not to be relied on; nothing where it is."""
    r = found.replayed
    if total(r.after) > total(r.before):
        return f"corrected.xml replays {r.of} worse than the nominal model"
    if found.worse:
        return (
            f"corrected.xml replays {', '.join(found.worse)} worse than the nominal model".replace(
                "--", "- -"
            )
        )
    if found.impossible:
        return (
            f"the numbers in this model are not possible together: {found.impossible[0]}".replace(
                "--", "- -"
            )
        )
    if found.verdict is Verdict.UNKNOWN:
        return (
            "verdict unknown: the numbers in this model are only the nearest ones, not a correction"
        )
    return ""


def show(found: Diagnosis, out: dict, where: Path, *, as_json: bool) -> None:
    """Headline, effects, joints."""
    if as_json:
        print(json.dumps(out, indent=1, allow_nan=False))
        return
    console = Console()
    console.print(
        f"[bold]{plain(str(found.verdict))}[/bold] (confidence {chance(found.confidence)})"
    )
    console.print(escape(found.headline), highlight=False, soft_wrap=True)
    if found.effects:
        table = Table()
        for name in ("effect", "where", "size, 95 % interval", "returns without it", "probability"):
            table.add_column(name)
        for e in found.effects:
            table.add_row(
                plain(e.family), escape(e.name), sizes(e), percent(e.share), chance(e.probability)
            )
        console.print(table)
    joints = Table(title="replay error of each joint [rad]", title_justify="left")
    for name in ("joint", "nominal", "corrected", "floor"):
        joints.add_column(name)
    for name, own in out["shrink"]["replay"]["per_joint"].items():
        joints.add_row(escape(name), *(number(own[k]) for k in ("before", "after", "floor")))
    console.print(joints)
    for name, x in found.clock:
        text = f"{plain(name)} {1e3 * x.value:.2g} ms [{1e3 * x.low:.2g}, {1e3 * x.high:.2g}]"
        console.print(f"clock of the loop, no gap: {text}", highlight=False, soft_wrap=True)
    for x in found.resembles:
        console.print(f"remainder: {escape(str(x))}", highlight=False, soft_wrap=True)
    if found.changes:
        text = f"corrected.xml changes {len(found.changes)} numbers of the model: `changes` of report.json has each"
        console.print(text, highlight=False, soft_wrap=True)
    if (x := found.replayed.torques) is not None:
        said = [number(v) for v in (total(x.before), total(x.after), total(x.replay_floor))]
        console.print(f"torque of the replays: {said[0]} → {said[1]} N m (floor {said[2]})")
    for text in (*out["doubts"], *out["notes"]):
        console.print(f"note: {escape(text)}", highlight=False, soft_wrap=True)
    console.print(f"report: {escape(str(where / 'report.html'))}", soft_wrap=True, highlight=False)


def sizes(e: Effect) -> str:
    """Every number of an effect with its interval, by name where there are several."""
    out = []
    for name, x in e.sizes:
        said = f"{plain(name)} " if len(e.sizes) > 1 else ""
        out.append(f"{said}{number(x.value)} [{number(x.low)}, {number(x.high)}]{unit(x.unit)}")
    return "\n".join(out)


def add_command(
    folder: Path, model: Path, log: Log, gains: Gains, show_rest: Callable[..., None]
) -> Callable[..., None]:
    """Add what the torques say of the position loop to a report that is written; what prints both.

    A loop that differs from what is said of it is a gap of its own, whatever the motion says.
    """
    try:
        loop = position_loop(log, compile_spec(load_spec(model), model), gains.kp, gains.kd)
        kp, kd = loop.kp, loop.kd
    except LogError:
        # Nobody says them: what is measured is in the report, and differs from nothing.
        loop, kp, kd = None, *np.zeros((2, len(log.joint_names)))
    halves = command.command_half(log, loop)
    if not halves:
        return show_rest
    half = report.clean(command.to_report(halves, kp, kd, log.joint_names))
    path = folder / "report.json"
    out = json.loads(path.read_text(encoding="utf-8"))
    out["command"] = half
    added = [e | {"half": "command", "ordinary": True, "equivalent": []} for e in half["effects"]]
    out["effects"] = [*out["effects"], *added]
    lines = [command.sentence(e) for e in half["effects"]]
    if lines and out["verdict"] == "no_gap":
        out["verdict"] = "explained"
        out["headline"] = f"torque and motion agree; between targets and torque: {'; '.join(lines)}"
    path.write_text(json.dumps(out, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    page = folder / "report.html"
    drawn = command_page.part(halves, log, loop, half["effects"])
    page.write_text(with_section(page.read_text(encoding="utf-8"), drawn), encoding="utf-8")

    def show_both(where: Path, *, as_json: bool) -> None:
        if as_json:
            print(json.dumps(out, indent=1, allow_nan=False))
            return
        show_rest(where, as_json=False)
        shown = "; ".join(lines) or "the position loop is as stated"
        Console().print(f"targets → torque: {escape(shown)}", highlight=False, soft_wrap=True)
        if lines:
            # What stands above is of torque and motion alone.
            verdict = plain(out["verdict"])
            Console().print(f"[bold]both halves together: {verdict}[/bold]", highlight=False)

    return show_both
