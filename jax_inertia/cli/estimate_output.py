"""What `jax-inertia estimate` writes and prints."""

import argparse
import json
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from jax_inertia.cli.estimate_run import Result
from jax_inertia.estimation.identifiability import Source
from jax_inertia.estimation.innovation_tests import consistency
from jax_inertia.maths.inertial_parameters import PI_NAMES, is_physical

_SCHEMA = 1
_Z95 = 1.959964


def write(folder: Path, args: argparse.Namespace, result: Result) -> None:
    """estimates.npz, estimates.csv, report.json and estimate.png."""
    from jax_inertia.cli import plots

    columns = _columns(result)
    np.savez_compressed(folder / "estimates.npz", allow_pickle=False, **_arrays(result))
    table = np.column_stack(list(columns.values()))
    header = ",".join(columns)
    np.savetxt(
        folder / "estimates.csv", table, fmt="%.9g", delimiter=",", header=header, comments=""
    )
    (folder / "report.json").write_text(_as_json(args, result) + "\n")
    plots.estimate_figure(result).savefig(folder / "estimate.png", dpi=130)


def _as_json(args: argparse.Namespace, result: Result) -> str:
    return json.dumps(_plain(report(args, result)), indent=1, allow_nan=False)


def report(args: argparse.Namespace, result: Result) -> dict:
    """The report as plain numbers and text; keys carry units."""
    trace, fit, seen = result.trace, result.fit, result.known.alone
    innovation = trace.innovation
    enough = len(result.time) >= 20
    checks = consistency(innovation) if enough else None
    online = np.sqrt(
        np.mean(np.square(innovation.residual), axis=0, where=np.asarray(innovation.residual) != 0)
    )
    return {
        "schema": _SCHEMA,
        "log": str(args.log),
        "model": str(args.model),
        "settings": {
            key: [str(v) for v in value] if isinstance(value, list) else value
            for key, value in vars(args).items()
            if key not in ("run", "log", "model", "json") and not isinstance(value, Path)
        }
        | {
            "prior_mass_kg": float(result.prior.mass),
            "gate": result.gate,
            "filter_rate_hz": 1.0 / float(np.median(np.diff(result.time))),
            "sigma_tau": dict(zip(result.row_names, result.noise, strict=True)),
            "bias": dict(zip(result.row_names, result.bias, strict=True)),
            "gains": dict(zip(result.row_names, result.gains, strict=True)),
        },
        "versions": _versions(),
        "findings": [
            {"severity": str(f.severity), "check": f.check, "message": f.message}
            for f in result.findings
        ],
        "notes": list(result.notes),
        "bodies_changed": result.changed,
        "bodies": {name: _body(result, i) for i, name in enumerate(result.bodies)},
        "calibration": _calibration(result),
        "filter": {
            "samples": len(result.time),
            "nis_per_row": None if checks is None else checks.nis_per_row,
            "nis_per_row_expected": None if checks is None else checks.nis_interval,
            "nis_within_95": None if checks is None else checks.within_95,
            "rejected_share": float(np.mean(~np.asarray(innovation.accepted))),
            "reopened_at_s": result.time[np.asarray(trace.reopened)],
        },
        "residual_rms": {
            name: {"model": before, "online": o, "batch": after}
            for name, before, o, after in zip(
                result.row_names, fit.rms_before, online, fit.rms_after, strict=True
            )
        },
        "identifiability": {
            "rank": seen.rank,
            "parameters": len(seen.names),
            "condition": seen.condition,
            "invisible": _named(seen.names, seen.invisible),
            "only_in_combination": _named(seen.names, ~seen.determined & ~seen.invisible),
            "combinations": seen.combinations,
            "left_to_the_prior": result.known.of(Source.PRIOR) + result.known.of(Source.NOTHING),
            "determined": [c.text for c in result.known.combinations],
        },
    }


def best(result: Result) -> dict[str, np.ndarray]:
    """π (10,) of each body: from the whole log, or where the bodies changed meanwhile from its end."""
    pi = result.trace.estimate.pi[-1] if result.changed else result.fit.estimate.pi
    return dict(zip(result.bodies, np.asarray(pi), strict=True))


def show(args: argparse.Namespace, result: Result, out: Path) -> None:
    """Print what was found."""
    if args.json:
        print(_as_json(args, result))
        return
    console = Console()
    table = Table(title="at the end of the log, ± 95 %", title_justify="left")
    table.add_column("")
    bodies = [_body(result, i) for i in range(len(result.bodies))]
    for name in result.bodies:
        table.add_column(name, justify="right")

    def line(label: str, text: Callable[[dict], str]) -> None:
        table.add_row(escape(label), *(text(body) for body in bodies))

    line("mass, model [kg]", lambda body: f"{body['model']['mass_kg']:.3f}")
    line("mass, filter [kg]", lambda body: _interval(body["online"]["mass_kg"]))
    if not result.changed:
        line("mass, batch fit [kg]", lambda body: _interval(body["batch"]["mass_kg"]))
    if result.calibration is not None:
        line("load, filter [kg]", lambda body: _interval(body["online"]["load_kg"]))
        line("load, batch fit [kg]", lambda body: _interval(body["batch"]["load_kg"]))
    for k, axis in enumerate("xyz"):
        line(f"centre of mass, filter, {axis} [mm]", lambda body, k=k: _com(body["online"], k))
    line(
        "physical samples",
        lambda body: f"{body['online']['physical_samples']} of {len(result.time)}",
    )
    console.print(table)
    if (load := _load(result)) is not None:
        console.print(
            f"Load, fitted together with the calibration: {_interval(load['mass_kg'])} kg"
        )
    rows = Table(title=escape("residual, rms [N m, N]"), title_justify="left")
    for column in ("row", "model", "online", "batch"):
        rows.add_column(column, justify="left" if column == "row" else "right")
    innovation = np.asarray(result.trace.innovation.residual)
    online = np.sqrt(np.mean(innovation**2, axis=0, where=innovation != 0))
    for name, *values in zip(
        result.row_names, result.fit.rms_before, online, result.fit.rms_after, strict=True
    ):
        rows.add_row(name, *(f"{x:.3g}" for x in values))
    console.print(rows)
    if unsaid := result.known.of(Source.NOTHING):
        console.print(f"This log says nothing about: {', '.join(unsaid)}")
    if (bound := result.known.of(Source.PRIOR)) and not result.changed:
        console.print(f"Little more than the prior speaks in: {', '.join(bound)}")
        sums = [c.text for c in result.known.combinations if " " in c.text]
        if sums:
            console.print(f"of which the log determines only: {'; '.join(sums)}")
    for note in result.notes:
        console.print(f"Note: {note}.")
    console.print(
        f"Written to {out}/: estimate.png, report.json, estimates.csv, estimates.npz",
        soft_wrap=True,
    )


def _com(estimate: dict, k: int) -> str:
    return f"{1e3 * estimate['com_m'][k]:.0f} ± {1e3 * estimate['com_ci95_half_width_m'][k]:.0f}"


def _interval(value: dict) -> str:
    return f"{value['value']:.3f} ± {0.5 * (value['ci95'][1] - value['ci95'][0]):.3f}"


def _body(result: Result, i: int) -> dict:
    index = result.robot.body_index(result.bodies[i])
    model = np.asarray(result.robot.pi)[index]
    unloaded = result.unloaded_mass[i]
    physical = result.physical[:, i]

    def entry(pi, sigma_pi, com, sigma_com):
        pi, sigma_pi, com, sigma_com = (np.asarray(x) for x in (pi, sigma_pi, com, sigma_com))
        half = _Z95 * np.hypot(sigma_pi[0], result.calibration_sigma)
        load = pi[0] - unloaded
        return {
            "mass_kg": {"value": pi[0], "ci95": [pi[0] - half, pi[0] + half]},
            "load_kg": {"value": load, "ci95": [load - half, load + half]},
            "com_m": com,
            "com_ci95_half_width_m": _Z95 * sigma_com,
            "pi": dict(zip(PI_NAMES, pi, strict=True)),
            "pi_sigma": dict(zip(PI_NAMES, sigma_pi, strict=True)),
            "is_physical": bool(is_physical(jnp.asarray(pi))),
        }

    e, f = result.trace.estimate, result.fit.estimate
    online = (e.pi[-1, i], e.sigma_pi[-1, i], e.com[-1, i], e.sigma_com[-1, i])
    whole = (f.pi[i], f.sigma_pi[i], f.com[i], f.sigma_com[i])
    return {
        "model": {"mass_kg": model[0], "com_m": model[1:4] / model[0]},
        "online": entry(*online)
        | {
            "at_s": result.time[-1],
            "physical_samples": int(physical.sum()),
            "unphysical_samples": int((~physical).sum()),
        },
        "batch": entry(*whole) | {"converged": result.fit.converged},
    }


def _calibration(result: Result) -> dict | None:
    fit = result.calibration
    if fit is None:
        return None
    terms = {
        key: {
            name: {"value": value, "sigma": sigma}
            for name, value, sigma in zip(
                result.row_names, fit.joint_terms[key], fit.joint_sigma[key], strict=True
            )
        }
        for key in fit.joint_terms
    }
    gains = zip(result.row_names, fit.gains, fit.gains_sigma, strict=True)
    return {
        "converged": fit.converged,
        "gains": {name: {"value": g, "sigma": s} for name, g, s in gains},
        "added_to_the_model": terms,
        "residual_rms_before": dict(zip(result.row_names, fit.rms_before, strict=True)),
        "residual_rms_after": dict(zip(result.row_names, fit.rms_after, strict=True)),
        "load_sigma_kg": result.calibration_sigma,
        "load_fitted_with_calibration": _load(result),
    }


def _load(result: Result) -> dict | None:
    if result.load is None:
        return None
    value, half = float(result.load.pi[0, 0]), _Z95 * float(result.load.sigma_pi[0, 0])
    return {
        "mass_kg": {"value": value, "ci95": [value - half, value + half]},
        "com_m": result.load.com[0],
        "com_ci95_half_width_m": _Z95 * np.asarray(result.load.sigma_com)[0],
    }


def _arrays(result: Result) -> dict[str, np.ndarray]:
    trace = result.trace
    fields = {
        "time": result.time,
        "bodies": np.array(result.bodies),
        "rows": np.array(result.row_names),
        "pi_names": np.array(PI_NAMES),
        "pi": trace.estimate.pi,
        "sigma_pi": trace.estimate.sigma_pi,
        "com": trace.estimate.com,
        "sigma_com": trace.estimate.sigma_com,
        "is_physical": result.physical,
        "innovation": trace.innovation.residual,
        "innovation_sigma": trace.innovation.sigma,
        "nis": trace.innovation.nis,
        "nis_rows": trace.innovation.rows,
        "nis_gate": trace.threshold,
        "accepted": trace.innovation.accepted,
        "reopened": trace.reopened,
        "batch_pi": result.fit.estimate.pi,
        "batch_sigma_pi": result.fit.estimate.sigma_pi,
    }
    return {name: np.asarray(value) for name, value in fields.items()}


def _columns(result: Result) -> dict[str, np.ndarray]:
    """Columns of the CSV, by name."""
    e, innovation = result.trace.estimate, result.trace.innovation
    out = {"time": result.time}
    for i, body in enumerate(result.bodies):
        pi, sigma = np.asarray(e.pi)[:, i], np.asarray(e.sigma_pi)[:, i]
        com, com_sigma = np.asarray(e.com)[:, i], np.asarray(e.sigma_com)[:, i]
        out |= {f"{body}.mass": pi[:, 0], f"{body}.mass_sigma": sigma[:, 0]}
        for k, axis in enumerate("xyz"):
            out |= {f"{body}.com_{axis}": com[:, k], f"{body}.com_{axis}_sigma": com_sigma[:, k]}
        for k, name in enumerate(PI_NAMES[4:], start=4):
            out |= {f"{body}.{name}": pi[:, k], f"{body}.{name}_sigma": sigma[:, k]}
        out[f"{body}.physical"] = result.physical[:, i]
    nis = {"nis": innovation.nis, "nis_rows": innovation.rows, "accepted": innovation.accepted}
    return out | {name: np.asarray(value) for name, value in nis.items()}


def _named(names: tuple[str, ...], where: np.ndarray) -> list[str]:
    return [name for name, yes in zip(names, where, strict=True) if yes]


def _versions() -> dict[str, str]:
    out = {}
    for name in ("jax-inertia", "jax", "mujoco", "numpy"):
        try:
            out[name] = version(name)
        except PackageNotFoundError:
            out[name] = "not installed"
    return out


def _plain(value):
    """What JSON can hold: arrays as lists, numbers that are not finite as null."""
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, str | bool | int) or value is None:
        return value
    if isinstance(value, float | np.floating):
        return float(value) if np.isfinite(value) else None
    array = np.asarray(value)
    return _plain(array.tolist())
