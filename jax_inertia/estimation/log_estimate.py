"""What was estimated from a log: as an object, as text, and as report.json."""

import dataclasses
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jax_inertia.dynamics.rigid_body import resolve_bodies
from jax_inertia.estimation.batch_fit import BatchFit
from jax_inertia.estimation.identifiability import Knowledge, Source
from jax_inertia.estimation.inertial_filter import Trace
from jax_inertia.estimation.innovation_tests import consistency
from jax_inertia.estimation.physical_estimate import Estimate
from jax_inertia.estimation.priors import Load
from jax_inertia.logs.findings import Finding, Severity
from jax_inertia.maths.inertial_parameters import PI_NAMES, is_physical
from jax_inertia.maths.precision import in_double_precision
from jax_inertia.model.robot import HINGE, SLIDE, Robot
from jax_inertia.model.write import JointNumbers
from jax_inertia.signals.differences import Observation
from jax_inertia.text.notebook_page import line, table

_SCHEMA = 1
Z95 = 1.959964


@dataclasses.dataclass(frozen=True, eq=False)
class LogEstimate:
    """Bodies estimated from a log, over time by the filter and over the whole log by the batch fit."""

    bodies: tuple[str, ...]
    robot: Robot
    """Calibrated where that was asked for, with the bodies asked for as the model has them."""
    findings: tuple[Finding, ...]
    """Of the logs, before anything was computed."""
    notes: tuple[str, ...]
    observation: Observation
    trace: Trace
    time: Float[np.ndarray, " T"]
    physical: Bool[np.ndarray, "T bodies"]
    fit: BatchFit
    calibration: BatchFit | None
    load: Estimate | None
    """With one body and a calibration: the load, fitted together with all that was calibrated."""
    noise: Float[np.ndarray, " nv"]
    bias: Float[np.ndarray, " nv"]
    gains: Float[np.ndarray, " nv"]
    prior: Load
    gate: float
    changed: bool
    """Whether the bodies changed during the log."""
    held: bool
    """Whether the robot rests in one pose after another: then the batch fit is the answer."""
    known: Knowledge
    """Whose word each parameter is: the log's, the prior's, or nobody's."""
    row_names: tuple[str, ...]
    settings: Mapping[str, Any]
    """As asked for."""

    @property
    def pi(self) -> dict[str, Float[np.ndarray, "10"]]:
        """π of each body [kg, kg m, kg m²]: from the whole log, or where the bodies changed meanwhile from its end."""
        pi = self.trace.estimate.pi[-1] if self.changed else self.fit.estimate.pi
        return dict(zip(self.bodies, np.asarray(pi), strict=True))

    @property
    def calibrated_pi(self) -> dict[str, Float[np.ndarray, "10"]]:
        """π of each body that the calibration fitted [kg, kg m, kg m²]; empty where there was none."""
        if self.calibration is None:
            return {}
        robot = self.calibration.robot
        return {
            name: pi
            for name, pi, physical in zip(
                robot.body_names, np.asarray(robot.pi), is_physical(robot.pi), strict=True
            )
            if physical
        }

    @property
    def calibrated_joints(self) -> dict[str, JointNumbers] | None:
        """What the calibration adds to each joint of one degree of freedom; None where there was none."""
        fit = self.calibration
        if fit is None:
            return None
        robot, terms = fit.robot, fit.joint_terms
        out = {}
        for name, kind, dof in zip(
            robot.joint_names, robot.joint_type, robot.joint_dofadr, strict=True
        ):
            if kind in (HINGE, SLIDE):
                own = {term: float(terms[term][dof]) for term in terms}
                out[name] = JointNumbers(**own, gain=float(fit.gains[dof]))
        return out

    @property
    def unloaded_mass(self) -> Float[np.ndarray, " bodies"]:
        """What the bodies weigh without load: as calibrated, else as in the model [kg]."""
        robot = self.robot if self.calibration is None else self.calibration.robot
        return np.asarray(robot.pi)[list(resolve_bodies(robot, self.bodies)), 0]

    @property
    def calibration_sigma(self) -> float:
        """What the calibration leaves open of the load's mass [kg]; zero where it was not asked for."""
        if self.load is None:
            return 0.0
        whole, given = float(self.load.sigma_pi[0, 0]), float(self.fit.estimate.sigma_pi[0, 0])
        return float(np.sqrt(max(whole**2 - given**2, 0.0)))

    @property
    def online_rms(self) -> Float[np.ndarray, " nv"]:
        """Of the filter's innovations, row by row [N m, N]."""
        innovation = np.asarray(self.trace.innovation.residual)
        return np.sqrt(np.mean(np.square(innovation), axis=0, where=innovation != 0))

    def __repr__(self) -> str:
        lines = [f"{self._title()}; ± 95 %"]
        for name, *cells in self._rows():
            model, online, whole = cells
            lines.append(f"  {name}: model {model} kg, filter {online}{_or(whole)}")
        return "\n".join([*lines, *(f"  {text}" for text in self._told())])

    def _repr_html_(self) -> str:
        """For notebooks: each body in the model, by the filter and by the batch fit, and what there is to say."""
        head = ("body", "mass, model [kg]", "filter, at the end [kg]", "batch fit [kg]")
        page = line(f"{self._title()}; ± 95 %") + table(head, self._rows())
        return page + "".join(line(text) for text in self._told())

    def _title(self) -> str:
        what = "bodies" if len(self.bodies) > 1 else "one body"
        count = f"{len(self.bodies)} {what}" if len(self.bodies) > 1 else what
        return f"LogEstimate({count}, {len(self.time)} samples to {self.time[-1]:.4g} s)"

    def _rows(self) -> list[tuple[str, str, str, str]]:
        found = (body_report(self, i) for i in range(len(self.bodies)))
        return [
            (
                name,
                f"{body['model']['mass_kg']:.3f}",
                interval_text(body["online"]["mass_kg"]),
                "" if self.changed else interval_text(body["batch"]["mass_kg"]),
            )
            for name, body in zip(self.bodies, found, strict=True)
        ]

    def _told(self) -> list[str]:
        """The load that was fitted with the calibration, notes, and warnings of the logs."""
        load = load_report(self)
        lines = [] if load is None else [f"load: {interval_text(load['mass_kg'])} kg"]
        lines += [f"note: {note}" for note in self.notes]
        told = (f for f in self.findings if f.severity is not Severity.NOTE)
        return lines + [f"{f.severity}: {f.message}" for f in told]


def _or(text: str) -> str:
    return f", batch fit {text}" if text else ""


def interval_text(value: Mapping[str, Any]) -> str:
    """A number of the report as text, with half the width of its interval."""
    return f"{value['value']:.3f} ± {0.5 * (value['ci95'][1] - value['ci95'][0]):.3f}"


@in_double_precision
def to_report(
    found: LogEstimate, *, log: str = "", model: str = "", settings: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """The estimate in the form of report.json: only JSON's own types, no NaN; keys carry units.

    `log` and `model` are the names of their files, `settings` (default: the estimate's own) what was asked for.
    """
    trace, fit = found.trace, found.fit
    innovation = trace.innovation
    checks = consistency(innovation) if len(found.time) >= 20 else None
    report = {
        "schema": _SCHEMA,
        "log": log,
        "model": model,
        "settings": _settings(found, found.settings if settings is None else settings),
        "versions": _versions(),
        "findings": [
            {"severity": str(f.severity), "check": f.check, "message": f.message}
            for f in found.findings
        ],
        "notes": list(found.notes),
        "bodies_changed": found.changed,
        "rests_in_poses": found.held,
        "bodies": {name: body_report(found, i) for i, name in enumerate(found.bodies)},
        "calibration": _calibration(found),
        "filter": {
            "samples": len(found.time),
            "nis_per_row": None if checks is None else checks.nis_per_row,
            "nis_per_row_expected": None if checks is None else checks.nis_interval,
            "nis_within_95": None if checks is None else checks.within_95,
            "rejected_share": float(np.mean(~np.asarray(innovation.accepted))),
            "reopened_at_s": found.time[np.asarray(trace.reopened)],
        },
        "residual_rms": {
            name: {"model": before, "online": online, "batch": after}
            for name, before, online, after in zip(
                found.row_names, fit.rms_before, found.online_rms, fit.rms_after, strict=True
            )
        },
        "identifiability": _identifiability(found.known),
    }
    return _plain(report)


def _settings(found: LogEstimate, asked: Mapping[str, Any]) -> dict[str, Any]:
    return dict(asked) | {
        "prior_mass_kg": float(found.prior.mass),
        "gate": found.gate,
        "filter_rate_hz": 1.0 / float(np.median(np.diff(found.time))),
        "sigma_tau": dict(zip(found.row_names, found.noise, strict=True)),
        "bias": dict(zip(found.row_names, found.bias, strict=True)),
        "gains": dict(zip(found.row_names, found.gains, strict=True)),
    }


def _identifiability(known: Knowledge) -> dict[str, Any]:
    seen = known.alone
    return {
        "rank": seen.rank,
        "parameters": len(seen.names),
        "condition": seen.condition,
        "invisible": _named(seen.names, seen.invisible),
        "only_in_combination": _named(seen.names, ~seen.determined & ~seen.invisible),
        "combinations": seen.combinations,
        "left_to_the_prior": known.of(Source.PRIOR) + known.of(Source.NOTHING),
        "determined": [c.text for c in known.combinations],
    }


def body_report(found: LogEstimate, i: int) -> dict[str, Any]:
    """The i-th body in the model, by the filter at the end, and by the batch fit."""
    index = found.robot.body_index(found.bodies[i])
    model = np.asarray(found.robot.pi)[index]
    unloaded = found.unloaded_mass[i]
    physical = found.physical[:, i]

    def entry(e: Estimate, row: tuple[int, ...]) -> dict[str, Any]:
        pi, sigma_pi, com, sigma_com = (
            np.asarray(x)[row] for x in (e.pi, e.sigma_pi, e.com, e.sigma_com)
        )
        half = Z95 * np.hypot(sigma_pi[0], found.calibration_sigma)
        load = pi[0] - unloaded
        return {
            "mass_kg": {"value": pi[0], "ci95": [pi[0] - half, pi[0] + half]},
            "load_kg": {"value": load, "ci95": [load - half, load + half]},
            "com_m": com,
            "com_ci95_half_width_m": Z95 * sigma_com,
            "pi": dict(zip(PI_NAMES, pi, strict=True)),
            "pi_sigma": dict(zip(PI_NAMES, sigma_pi, strict=True)),
            "is_physical": bool(is_physical(jnp.asarray(pi))),
        }

    return {
        "model": {"mass_kg": model[0], "com_m": model[1:4] / model[0]},
        "online": entry(found.trace.estimate, (-1, i))
        | {
            "at_s": found.time[-1],
            "physical_samples": int(physical.sum()),
            "unphysical_samples": int((~physical).sum()),
        },
        "batch": entry(found.fit.estimate, (i,)) | {"converged": found.fit.converged},
    }


def _calibration(found: LogEstimate) -> dict[str, Any] | None:
    fit = found.calibration
    if fit is None:
        return None
    terms = {
        key: {
            name: {"value": value, "sigma": sigma}
            for name, value, sigma in zip(
                found.row_names, fit.joint_terms[key], fit.joint_sigma[key], strict=True
            )
        }
        for key in fit.joint_terms
    }
    gains = zip(found.row_names, fit.gains, fit.gains_sigma, strict=True)
    return {
        "converged": fit.converged,
        "gains": {name: {"value": g, "sigma": s} for name, g, s in gains},
        "added_to_the_model": terms,
        "bodies": {
            name: {
                "mass_kg": pi[0],
                "com_m": pi[1:4] / pi[0],
                "pi": dict(zip(PI_NAMES, pi, strict=True)),
            }
            for name, pi in found.calibrated_pi.items()
        },
        "residual_rms_before": dict(zip(found.row_names, fit.rms_before, strict=True)),
        "residual_rms_after": dict(zip(found.row_names, fit.rms_after, strict=True)),
        "load_sigma_kg": found.calibration_sigma,
        "load_fitted_with_calibration": load_report(found),
    }


def load_report(found: LogEstimate) -> dict[str, Any] | None:
    """The load that was fitted together with the calibration; None where none was."""
    if found.load is None:
        return None
    value, half = float(found.load.pi[0, 0]), Z95 * float(found.load.sigma_pi[0, 0])
    return {
        "mass_kg": {"value": value, "ci95": [value - half, value + half]},
        "com_m": found.load.com[0],
        "com_ci95_half_width_m": Z95 * np.asarray(found.load.sigma_com)[0],
    }


def _named(names: tuple[str, ...], where: Bool[np.ndarray, " p"]) -> list[str]:
    return [name for name, yes in zip(names, where, strict=True) if yes]


def _versions() -> dict[str, str]:
    out = {}
    for name in ("jax-inertia", "jax", "mujoco", "numpy"):
        try:
            out[name] = version(name)
        except PackageNotFoundError:
            out[name] = "not installed"
    return out


def _plain(value: Any) -> Any:
    """What JSON can hold: arrays as lists, numbers that are not finite as null, what it does not know as text."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, str | bool | int) or value is None:
        return value
    if isinstance(value, float | np.floating):
        return float(value) if np.isfinite(value) else None
    if isinstance(value, np.ndarray | np.generic | Array):
        return _plain(np.asarray(value).tolist())
    return str(value)
