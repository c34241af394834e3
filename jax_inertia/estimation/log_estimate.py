"""What was estimated from a log: as an object, as text, and as report.json."""

import dataclasses
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jax_inertia.dynamics.rigid_body import resolve_bodies
from jax_inertia.dynamics.sparse_rows import moved_rows
from jax_inertia.estimation import joint_terms
from jax_inertia.estimation.batch_fit import BatchFit
from jax_inertia.estimation.held_load import Considered
from jax_inertia.estimation.identifiability import Knowledge, Source
from jax_inertia.estimation.inertial_filter import Trace
from jax_inertia.estimation.physical_estimate import Estimate
from jax_inertia.estimation.priors import Load
from jax_inertia.logs.findings import Finding, Severity
from jax_inertia.maths.inertial_parameters import PI_NAMES, is_physical
from jax_inertia.maths.innovation_tests import consistency, rejected_share
from jax_inertia.maths.precision import in_double_precision
from jax_inertia.model.robot import HINGE, SLIDE, Robot
from jax_inertia.model.write import JointNumbers
from jax_inertia.signals.differences import RIGID_BODY_ERROR, Observation
from jax_inertia.text.notebook_page import line, table
from jax_inertia.text.words import plus_minus

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
    friction: bool
    """Whether friction and offsets of the joints were estimated with the bodies."""
    considered: Considered
    """What the filter knows at the end, with what it takes for exact."""
    held_p: Float[np.ndarray, " bodies"]
    """Of each body at the end of the log: chance of what is seen if it held nothing beyond the model."""
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
    def loads(self) -> Float[np.ndarray, "2 bodies"]:
        """What each body has beyond its unloaded mass, by the filter at the end and by the batch fit [kg]."""
        online = np.asarray(self.trace.estimate.pi)[-1, :, 0] - self.unloaded_mass
        if self.calibration is None:
            online = online - self.considered.bare[:, 0]
            return np.stack([online, np.asarray(self.fit.added.pi)[:, 0]])
        return np.stack([online, np.asarray(self.fit.estimate.pi)[:, 0] - self.unloaded_mass])

    @property
    def calibration_sigma(self) -> float:
        """What the calibration leaves open of the load's mass [kg]; zero where it was not asked for."""
        if self.load is None:
            return 0.0
        whole, given = float(self.load.sigma_pi[0, 0]), float(self.fit.estimate.sigma_pi[0, 0])
        return float(np.sqrt(max(whole**2 - given**2, 0.0)))

    @property
    def rejected_share(self) -> float:
        """Of the filter's samples that could be tested."""
        return rejected_share(self.trace.innovation)

    def filter_sigma(self, i: int) -> tuple[Float[np.ndarray, "10"], Float[np.ndarray, "3"]]:
        """σ of π and of the centre of mass of the i-th body at the end, with what the filter takes for exact.

        Of a constant body the fit of all samples, which marginalises what a filter takes for exact, is right about the
        same numbers: the filter's intervals hold the fit's.
        """
        sigmas = self._own_filter_sigma(i)
        if self.changed or self.held:
            return sigmas
        online, whole = self.trace.estimate, self.fit.estimate
        out = []
        for sigma, name in zip(sigmas, ("pi", "com"), strict=True):
            apart = np.abs(
                np.asarray(getattr(online, name))[-1, i] - np.asarray(getattr(whole, name))[i]
            )
            known = np.asarray(getattr(whole, f"sigma_{name}"))[i]
            out.append(np.maximum(sigma, apart / Z95 + known))
        return out[0], out[1]

    def _own_filter_sigma(self, i: int) -> tuple[Float[np.ndarray, "10"], Float[np.ndarray, "3"]]:
        """The same, whatever the batch fit says."""
        e, p = self.trace.estimate, self.considered.bodies[i]
        pi, com = np.asarray(e.pi)[-1, i], np.asarray(e.com)[-1, i]
        slope = np.concatenate([-com[:, None], np.eye(3)], axis=1) / pi[0]
        more = np.diagonal(slope @ p[:4, :4] @ slope.T)
        own = np.asarray(e.sigma_pi)[-1, i], np.asarray(e.sigma_com)[-1, i]
        return np.hypot(own[0], np.sqrt(np.diagonal(p))), np.sqrt(own[1] ** 2 + more)

    def mass_half_widths(self, i: int) -> tuple[float, float]:
        """Half of the 95 % intervals of the i-th mass by the filter at the end and by the batch fit [kg].

        Of a constant body both are right about the same number: the filter's interval holds the fit's, and where they
        differ by more than chance makes them, the fit's is as wide as the difference. In a log of poses at rest the
        filter's alone.
        """
        halves = self._mass_halves(i)
        return self._widened(i, *halves, self._apart(i, *halves))

    def _widened(self, i: int, online: float, whole: float, apart: float) -> tuple[float, float]:
        """Halves of two intervals of a mass where filter and batch fit differ by so much beyond chance [kg]."""
        if self.held:
            return max(online, apart), whole
        if self.changed:
            return online, whole
        # As NumPy arrays: JAX outside of `estimate` may be set to single precision.
        pis = np.asarray(self.trace.estimate.pi)[-1], np.asarray(self.fit.estimate.pi)
        masses = [float(pi[i, 0]) for pi in pis]
        return max(online, abs(masses[0] - masses[1]) + whole), max(whole, apart)

    def load_half_widths(self, i: int) -> tuple[float, float]:
        """The same of what the i-th body has beyond the model's own mass [kg].

        Not those of its mass: what the model is off by about the bare body is in one and not in the other. A load is so
        well known that by how much filters and differences distort its own torque counts (`RIGID_BODY_ERROR`).
        """
        if self.calibration is not None:
            return self.mass_half_widths(i)
        form = RIGID_BODY_ERROR * np.abs(self.loads[:, i])
        online = Z95 * float(np.hypot(form[0], np.sqrt(self.considered.loads[i, 0, 0])))
        whole = Z95 * float(np.hypot(self.fit.added.sigma_pi[i, 0], form[1]))
        return self._widened(i, online, whole, self._apart(i, *self._mass_halves(i)))

    def _mass_halves(self, i: int) -> tuple[float, float]:
        """Half of each 95 % interval of the i-th mass, filter and batch fit apart [kg]."""
        sigmas = self._own_filter_sigma(i)[0][0], float(self.fit.estimate.sigma_pi[i, 0])
        online, whole = (Z95 * float(np.hypot(s, self.calibration_sigma)) for s in sigmas)
        return online, whole

    def _apart(self, i: int, online: float, whole: float) -> float:
        """By how much filter and batch fit differ beyond chance; zero where they do not, or the bodies changed."""
        pi = np.asarray(self.trace.estimate.pi)[-1, i, 0], np.asarray(self.fit.estimate.pi)[i, 0]
        apart = float(abs(pi[0] - pi[1]))
        return apart if not self.changed and apart > np.hypot(online, whole) else 0.0

    @property
    def disagreements(self) -> list[str]:
        """Where filter and batch fit contradict each other, in words."""
        out = []
        for i, name in enumerate(self.bodies):
            halves = self._mass_halves(i)
            if (apart := self._apart(i, *halves)) > 0:
                out.append(
                    f"{name}: filter and batch fit differ by {apart:.3g} kg, beyond their intervals (± {halves[0]:.2g} "
                    f"and {halves[1]:.2g}): something changes that neither knows of; intervals are widened to hold both"
                )
        return out

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
    low, high = value["ci95"]
    if high - low < 0.001:  # which three decimals would call none
        return plus_minus(value["value"], low, high)
    return f"{value['value']:.3f} ± {0.5 * (high - low):.3f}"


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
        "joint_terms": _joint_terms(found),
        "filter": {
            "samples": len(found.time),
            "nis_per_row": None if checks is None else checks.nis_per_row,
            "nis_per_row_expected": None if checks is None else checks.nis_interval,
            "nis_within_95": None if checks is None else checks.within_95,
            "rejected_share": found.rejected_share,
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
    physical = found.physical[:, i]
    loads = found.loads[:, i]
    ways = zip(found.mass_half_widths(i), loads, found.load_half_widths(i), strict=True)
    of_online, of_batch = ways

    def entry(
        e: Estimate,
        row: tuple[int, ...],
        masses: tuple[float, float, float],
        sigmas: tuple[np.ndarray, np.ndarray],
    ) -> dict[str, Any]:
        pi, com = (np.asarray(x)[row] for x in (e.pi, e.com))
        sigma_pi, sigma_com = sigmas
        half, load, of_load = masses
        return {
            "mass_kg": {"value": pi[0], "ci95": [pi[0] - half, pi[0] + half]},
            "load_kg": {"value": load, "ci95": [load - of_load, load + of_load]},
            "com_m": com,
            "com_ci95_half_width_m": Z95 * sigma_com,
            "pi": dict(zip(PI_NAMES, pi, strict=True)),
            "pi_sigma": dict(zip(PI_NAMES, sigma_pi, strict=True)),
            "is_physical": bool(is_physical(jnp.asarray(pi))),
        }

    return {
        "model": {"mass_kg": model[0], "com_m": model[1:4] / model[0]},
        "holds_nothing_p": float(found.held_p[i]),
        "online": entry(found.trace.estimate, (-1, i), of_online, found.filter_sigma(i))
        | {
            "at_s": found.time[-1],
            "physical_samples": int(physical.sum()),
            "unphysical_samples": int((~physical).sum()),
        },
        "batch": entry(
            found.fit.estimate,
            (i,),
            of_batch,
            (
                np.asarray(found.fit.estimate.sigma_pi)[i],
                np.asarray(found.fit.estimate.sigma_com)[i],
            ),
        )
        | {"converged": found.fit.converged},
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


def _joint_terms(found: LogEstimate) -> dict[str, Any] | None:
    """Friction and offsets beyond the model's own, at the end of the log where bodies changed; None where not asked."""
    terms = found.trace.joints
    if terms is None:
        return None
    fit, rows = found.fit, moved_rows(found.robot, resolve_bodies(found.robot, found.bodies))
    out = {}
    for j, name in enumerate(found.row_names):
        if found.changed and j not in rows:
            continue
        k = rows.index(j) if found.changed else 0
        online = np.asarray(terms.value)[-1, k], np.asarray(terms.sigma)[-1, k]
        whole = [[x[t][j] for t in joint_terms.NAMES] for x in (fit.joint_terms, fit.joint_sigma)]
        value, sigma = online if found.changed else whole
        out[name] = {
            t: {"value": value[m], "sigma": sigma[m]} for m, t in enumerate(joint_terms.NAMES)
        }
    return out


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
