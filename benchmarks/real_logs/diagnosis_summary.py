"""What DIAGNOSES.md says of a case, as numbers: the diagnosis beside the published fit, and what is not physical."""

import dataclasses
from dataclasses import dataclass

import jax
import numpy as np
from diagnosis_cases import Case, Files

import jax_inertia as ji
from jax_inertia.cli.diagnose_run import Inputs, Result
from jax_inertia.gap.evidence import moving
from jax_inertia.logs.log_files import read_log
from jax_inertia.model.robot import Robot
from jax_inertia.signals.torque_residual import Prepared, prepare

DRY = ("coulomb_friction", "asymmetric_coulomb", "stribeck_friction", "load_friction")
VISCOUS = ("viscous_friction", "friction_drift")
# A measured or given torque was this share of its peak at least, or the limit is no limit.
LEAST_LIMIT = 0.3
SOFTEST = 0.02  # rad at peak torque: ten times what an arm's drive gives way
HEAVIEST_ROTOR = 3.0  # times the largest inertia that the joint moves


@dataclass(frozen=True)
class Row:
    """One joint: residuals [N m] and joint terms, found and published; NaN where there is none."""

    joint: str
    speed: float
    before: float
    after: float
    published: float
    found: dict[str, float]
    theirs: dict[str, float]


@dataclass(frozen=True)
class Summary:
    """One case, ready to be printed."""

    name: str
    verdict: str
    confidence: float
    effects: list[dict]
    """As in report.json, with `doubt`, why it is not physical, or nothing, and `weak`, not distinct from zero."""
    chi2: float
    floor: float
    shrink: dict
    published: dict[str, float]
    """Residual of the published fit on the log and on the other run [N m], where it can be evaluated."""
    rows: list[Row]
    gains: list[str]
    ties: int
    seconds: float
    duration: float

    def to_json(self) -> dict:
        """Only JSON's own types."""
        return dataclasses.asdict(self)

    @staticmethod
    def from_json(x: dict) -> "Summary":
        """The inverse of `to_json`."""
        return Summary(**{**x, "rows": [Row(**r) for r in x["rows"]]})


def summarise(case: Case, files: Files, inputs: Inputs, result: Result, seconds: float) -> Summary:
    """Numbers of one diagnosis."""
    report, trace = result.report, result.found.trace
    prepared = prepare(inputs.robot, inputs.log)
    peak = dict(zip(trace.rows, np.percentile(np.abs(trace.tau), 99.5, axis=0), strict=True))
    inertia = dict(zip(trace.rows, _inertias(inputs.robot, prepared), strict=True))
    effects = [
        {**e, "doubt": _doubt(case, e, peak, inertia), "weak": _weak(e)} for e in report["effects"]
    ]
    theirs = published_left(case, files, inputs.robot)
    # As the shrink is measured.
    loud = list(trace.gap)
    moving = ~trace.rest
    last = trace.left[-1] if trace.left else trace.missing
    rows = [
        Row(
            joint=name,
            speed=float(np.median(np.abs(trace.v[moving[:, j], j]))) if moving[:, j].any() else 0.0,
            before=_rms(trace.missing[:, j], moving[:, j]),
            after=_rms(last[:, j], moving[:, j]),
            published=_rms(theirs[0][0][:, j], theirs[0][1][:, j]) if theirs else float("nan"),
            found=_terms(effects, name, float(np.mean(np.abs(trace.tau[:, j])))),
            theirs=_published_terms(case, j),
        )
        for j, name in enumerate(trace.rows)
    ]
    return Summary(
        name=case.name,
        verdict=report["verdict"],
        confidence=report["confidence"],
        effects=effects,
        chi2=report["gap"]["chi2"],
        floor=report["gap"]["noise_floor"],
        shrink=report["shrink"],
        published={
            which: _rms(x[:, loud], m[:, loud])
            for which, (x, m) in zip(("log", "test"), theirs, strict=False)
        },
        rows=rows,
        gains=[f.message for f in inputs.quality if f.check == "drive_gain"],
        ties=sum(len(e["equivalent"]) for e in effects),
        seconds=seconds,
        duration=inputs.log.duration,
    )


def published_left(case: Case, files: Files, robot: Robot) -> list[tuple[np.ndarray, np.ndarray]]:
    """(missing torque after the published fit, where it counts) of the log and the other run; empty without one."""
    if case.law is None:
        return []
    out = []
    for path in (files.log, files.test):
        if path is None:
            continue
        log = read_log(path)
        # Logs that are no torque: at the published gains, not at those that the tool took.
        prepared = prepare(robot, log if case.gains is None else log.with_torque_gains(case.gains))
        v, a = np.asarray(prepared.observation.motion.v), np.asarray(prepared.observation.a)
        left = prepared.finish(prepared.missing + case.law(v, a))
        out.append((left, moving(prepared)))
    return out


def _inertias(robot: Robot, prepared: Prepared) -> np.ndarray:
    """Largest inertia of the links that each row moves, over the log, its rotor apart."""
    q = np.asarray(prepared.observation.motion.q)[:: max(1, len(prepared.time) // 50)]
    mass = jax.lax.map(lambda x: ji.mass_matrix(robot, x), q)
    own = np.diagonal(np.asarray(mass), axis1=1, axis2=2) - np.asarray(robot.armature)
    return own.max(axis=0)


def _rms(x: np.ndarray, where: np.ndarray) -> float:
    return float(np.sqrt(np.mean(x[where] ** 2))) if where.any() else float("nan")


def _value(effect: dict, name: str) -> float:
    return float(effect["parameters"][name]["value"])


def _terms(effects: list[dict], joint: str, load: float) -> dict[str, float]:
    """Coulomb, viscous, offset, armature of a joint, summed over what was found there; offsets as the sensor reads."""
    out: dict[str, float] = {}

    def add(name: str, value: float) -> None:
        out[name] = out.get(name, 0.0) + value

    for e in effects:
        if e["location"] != {"kind": "joint", "name": joint}:
            continue
        family = e["family"]
        if family in ("coulomb_friction", "stribeck_friction", "load_friction"):
            add("coulomb", _value(e, "coulomb"))
        if family == "load_friction":
            add("coulomb", load * _value(e, "load_coefficient"))
        if family == "asymmetric_coulomb":
            add("coulomb", 0.5 * (_value(e, "positive") + _value(e, "negative")))
            add("offset", 0.5 * (_value(e, "positive") - _value(e, "negative")))
        if family in VISCOUS:
            add("viscous", _value(e, "damping"))
        if family == "armature":
            add("armature", _value(e, "armature"))
        if family == "torque_bias":
            add("offset", -_value(e, "bias"))
    return out


def _published_terms(case: Case, j: int) -> dict[str, float]:
    if case.terms is None:
        return {}
    every = {
        field.name: float(getattr(case.terms, field.name)[j])
        for field in dataclasses.fields(case.terms)
    }
    return {name: x for name, x in every.items() if np.isfinite(x)}


def _doubt(case: Case, e: dict, peak: dict[str, float], inertia: dict[str, float]) -> str:
    """Why a finding cannot be what the robot has; empty where nothing speaks against it."""
    family, place = e["family"], e["location"]["name"]
    if family in case.impossible:
        return case.impossible[family]
    if family == "torque_saturation" and _value(e, "limit") < LEAST_LIMIT * peak[place]:
        return f"a limit at {100 * _value(e, 'limit') / peak[place]:.0f} % of the torque that was there"
    if family in ("joint_elasticity", "backlash"):
        give = peak[place] / _value(e, "stiffness")
        if give > SOFTEST:
            return f"gives way {give:.2g} rad at its peak torque"
    if family == "armature" and _value(e, "armature") > HEAVIEST_ROTOR * inertia[place]:
        times = _value(e, "armature") / inertia[place]
        return f"a rotor of {times:.2g} times all that it moves"
    return ""


def _weak(e: dict) -> bool:
    """Whether the number that makes the effect may as well be zero."""
    main = _SIZE.get(e["family"])
    if main is None:
        return False
    low, high = e["parameters"][main]["ci95"]
    return low is not None and high is not None and low < 0 < high


_SIZE = {
    "coulomb_friction": "coulomb",
    "viscous_friction": "damping",
    "load_friction": "load_coefficient",
    "armature": "armature",
    "torque_saturation": "limit",
    "torque_bias": "bias",
    "payload": "mass",
}
