"""What `jax-inertia estimate` writes and prints."""

import argparse
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from jax_inertia.estimation.identifiability import Source
from jax_inertia.estimation.log_estimate import LogEstimate, body_report, interval_text, to_report
from jax_inertia.maths.inertial_parameters import PI_NAMES
from jax_inertia.text.words import plus_minus


def report(args: argparse.Namespace, found: LogEstimate) -> dict:
    """report.json, with the options as they were given."""
    asked = {
        key: [str(v) for v in value] if isinstance(value, list) else value
        for key, value in vars(args).items()
        if key not in ("run", "log", "model", "json", "no_cache") and not isinstance(value, Path)
    }
    return to_report(found, log=str(args.log), model=str(args.model), settings=asked)


def write(folder: Path, found: LogEstimate, report: dict) -> None:
    """estimates.npz, estimates.csv, report.json and estimate.png."""
    from jax_inertia.cli import plots

    columns = _columns(found)
    np.savez_compressed(folder / "estimates.npz", allow_pickle=False, **_arrays(found))
    table = np.column_stack(list(columns.values()))
    header = ",".join(columns)
    np.savetxt(
        folder / "estimates.csv", table, fmt="%.9g", delimiter=",", header=header, comments=""
    )
    (folder / "report.json").write_text(_as_json(report) + "\n", encoding="utf-8")
    plots.estimate_figure(found).savefig(folder / "estimate.png", dpi=130)


def _as_json(report: dict) -> str:
    return json.dumps(report, indent=1, allow_nan=False)


def show(found: LogEstimate, report: dict, out: Path, *, as_json: bool) -> None:
    """Print what was found."""
    if as_json:
        print(_as_json(report))
        return
    console = Console()
    console.print(_bodies(found))
    if found.load is not None:
        load = report["calibration"]["load_fitted_with_calibration"]
        console.print(
            f"Load, fitted together with the calibration: {interval_text(load['mass_kg'])} kg"
        )
    console.print(_residuals(found))
    for line in _said(found):
        console.print(line)
    if unsaid := found.known.of(Source.NOTHING):
        console.print(f"This log does not change: {', '.join(unsaid)}")
    if (bound := found.known.of(Source.PRIOR)) and not found.changed:
        console.print(f"Determined by the prior rather than by this log: {', '.join(bound)}")
        sums = [c.text for c in found.known.combinations if " " in c.text]
        if sums:
            console.print(f"of which this log determines only: {'; '.join(sums)}")
    for note in found.notes:
        console.print(f"Note: {note}.")
    console.print(
        f"Written to {out}/: estimate.png, report.json, estimates.csv, estimates.npz",
        soft_wrap=True,
    )


def _bodies(found: LogEstimate) -> Table:
    """Mass and centre of mass of every body, a column each."""
    title = "at the end of the log" if found.changed else "over the whole log, and at its end"
    table = Table(title=f"{title}, ± 95 %", title_justify="left")
    table.add_column("")
    bodies = [body_report(found, i) for i in range(len(found.bodies))]
    for name in found.bodies:
        table.add_column(name, justify="right")

    def line(label: str, text: Callable[[dict], str]) -> None:
        table.add_row(escape(label), *(text(body) for body in bodies))

    line("mass, model [kg]", lambda body: f"{body['model']['mass_kg']:.3f}")
    # Of constant bodies the batch fit is the answer, and comes first; of those that changed it is none.
    ways = {"online": "filter"} if found.changed else {"batch": "batch fit", "online": "filter"}
    for way, name in ways.items():
        line(f"mass, {name} [kg]", lambda body, way=way: interval_text(body[way]["mass_kg"]))
        if found.calibration is not None or found.robot.errors is not None:
            line(f"load, {name} [kg]", lambda body, way=way: interval_text(body[way]["load_kg"]))
        for k, axis in enumerate("xyz"):
            label = f"centre of mass, {name}, {axis} [mm]"
            line(label, lambda body, way=way, k=k: _com(body[way], k))
    line(
        "physical samples",
        lambda body: f"{body['online']['physical_samples']} of {len(found.time)}",
    )
    return table


_MANY = 0.1
"""Share of refused samples above which the estimate warns [1]: of ten seconds with one pick-up the gate of a right
model refuses 0.05 to 0.095, of a model without the log's friction 0.93 (benchmarks/results/loads.json)."""
_LEVEL = 0.01
"""Level of the test that a body holds nothing beyond its model [1], the usual 1 %: reached by none of 40 empty hands,
and by all of 40 loads (benchmarks/results/held.json)."""


def _said(found: LogEstimate) -> list[str]:
    """What the filter refused, whether anything is held, and what friction was found."""
    share = found.rejected_share
    reopened = int(np.sum(np.asarray(found.trace.reopened)))
    lines = [
        f"Samples that the filter refused: {100 * share:.1f} %"
        + (f"; its gate reopened {reopened} times" if reopened else "")
        + (
            ". More than the seconds before a new load is believed: what moves this robot is not in the model, or the "
            "noise is larger than stated"
            if share > _MANY
            else ""
        )
    ]
    for name, p in zip(found.bodies, found.held_p, strict=True):
        said = (
            "holds more than the model says" if p < _LEVEL else "nothing beyond the model is seen"
        )
        lines.append(f"{name}: {said} (chance of this if it holds nothing: {p:.2g})")
    if found.friction:
        lines.append(
            "Friction and offsets that the model lacks were estimated with the bodies (report.json, joint_terms); "
            "intervals contain what they leave open"
        )
    return lines


def _residuals(found: LogEstimate) -> Table:
    rows = Table(title=escape("residual, rms [N m, N]"), title_justify="left")
    for column in ("row", "model", "online", "batch"):
        rows.add_column(column, justify="left" if column == "row" else "right")
    for name, *values in zip(
        found.row_names, found.fit.rms_before, found.online_rms, found.fit.rms_after, strict=True
    ):
        rows.add_row(name, *(f"{x:.3g}" for x in values))
    return rows


def _com(estimate: dict, k: int) -> str:
    centre, half = (1e3 * estimate[name][k] for name in ("com_m", "com_ci95_half_width_m"))
    return plus_minus(centre, centre - half, centre + half)


def _arrays(found: LogEstimate) -> dict[str, np.ndarray]:
    trace = found.trace
    fields = {
        "time": found.time,
        "bodies": np.array(found.bodies),
        "rows": np.array(found.row_names),
        "pi_names": np.array(PI_NAMES),
        "pi": trace.estimate.pi,
        "sigma_pi": trace.estimate.sigma_pi,
        "com": trace.estimate.com,
        "sigma_com": trace.estimate.sigma_com,
        "is_physical": found.physical,
        "innovation": trace.innovation.residual,
        "innovation_sigma": trace.innovation.sigma,
        "nis": trace.innovation.nis,
        "nis_rows": trace.innovation.rows,
        "nis_gate": trace.threshold,
        "accepted": trace.innovation.accepted,
        "reopened": trace.reopened,
        "batch_pi": found.fit.estimate.pi,
        "batch_sigma_pi": found.fit.estimate.sigma_pi,
    }
    return {name: np.asarray(value) for name, value in fields.items()}


def _columns(found: LogEstimate) -> dict[str, np.ndarray]:
    """Columns of the CSV, by name."""
    e, innovation = found.trace.estimate, found.trace.innovation
    out = {"time": found.time}
    for i, body in enumerate(found.bodies):
        pi, sigma = np.asarray(e.pi)[:, i], np.asarray(e.sigma_pi)[:, i]
        com, com_sigma = np.asarray(e.com)[:, i], np.asarray(e.sigma_com)[:, i]
        out |= {f"{body}.mass": pi[:, 0], f"{body}.mass_sigma": sigma[:, 0]}
        for k, axis in enumerate("xyz"):
            out |= {f"{body}.com_{axis}": com[:, k], f"{body}.com_{axis}_sigma": com_sigma[:, k]}
        for k, name in enumerate(PI_NAMES[4:], start=4):
            out |= {f"{body}.{name}": pi[:, k], f"{body}.{name}_sigma": sigma[:, k]}
        out[f"{body}.physical"] = found.physical[:, i]
    nis = {"nis": innovation.nis, "nis_rows": innovation.rows, "accepted": innovation.accepted}
    return out | {name: np.asarray(value) for name, value in nis.items()}
