# pyright: strict
"""What a user of the library writes: the lint step checks that its types hold in pyright's strict mode."""

import json
from collections.abc import Iterator
from pathlib import Path

import jax
import numpy as np

import jax_inertia as ji
from jax_inertia.diagnosis.effects.identified import effects_in
from jax_inertia.diagnosis.entry import diagnose
from jax_inertia.diagnosis.report.json_report import to_report
from jax_inertia.diagnosis.result import Diagnosis, Verdict
from jax_inertia.diagnosis.simulate.step_law import callback
from jax_inertia.diagnosis.simulate.whole_robot import correction
from jax_inertia.estimation import batch_fit, log_filter
from jax_inertia.estimation.checkpoint import load_stream, save_stream
from jax_inertia.estimation.excitation import suggest_motion
from jax_inertia.estimation.identifiability import Source, knowledge, structure
from jax_inertia.estimation.inertial_filter import Estimator, make_estimator
from jax_inertia.estimation.innovation_tests import consistency, nees
from jax_inertia.estimation.motion_limits import Limits
from jax_inertia.estimation.online.slew import Slew
from jax_inertia.estimation.priors import Load
from jax_inertia.estimation.stream import Stream
from jax_inertia.logs.readers import Options
from jax_inertia.maths import charts
from jax_inertia.maths.gates import ChiSquaredGate
from jax_inertia.maths.inertial_parameters import from_com, pseudo_inertia
from jax_inertia.maths.least_squares import weighted_least_squares
from jax_inertia.model.load import load_spec, set_inertials, write_urdf
from jax_inertia.preflight.preflight import Severity, preflight
from jax_inertia.robots.pendulum import double_pendulum


def model() -> ji.Robot:
    robot = ji.load_model(double_pendulum())
    names: tuple[str, ...] = robot.body_names
    print(names, robot.nv, robot.has_free_base, robot.joint_index("elbow"))
    return robot.with_pi((1,), 2.0 * robot.pi[1:]).astype("float64")


def dynamics(robot: ji.Robot, q: jax.Array, v: jax.Array, a: jax.Array) -> jax.Array:
    torque = ji.inverse_dynamics(robot, q, v, a) - ji.passive_torque(robot, q, v)
    y = ji.torque_regressor(robot, q, v, a, ["lower"])
    condensed, nominal = ji.condensed_dynamics(robot, q, v, a, ["lower"])
    rotation, position = ji.body_poses(robot, q)
    wrench = ji.contact_torque(robot, q, robot.pi[:1, :6], ["lower"])
    total = torque + nominal + wrench + ji.mass_matrix(robot, q) @ a
    print(y.shape, condensed.shape, rotation.shape, position.shape)
    return total + ji.body_jacobian(robot, q, "lower").T @ robot.pi[0, :6]


def bodies(mass: jax.Array, com: jax.Array, inertia: jax.Array) -> bool:
    pi = from_com(mass, com, inertia)
    theta = ji.to_log_cholesky(pi)
    print(pseudo_inertia(ji.from_log_cholesky(theta)).shape)
    return bool(ji.is_physical(pi))


def logs(path: Path, robot: ji.Robot) -> ji.Log:
    log = ji.read_log(path, options=Options(degrees=True), names=robot)
    for finding in preflight(log, robot).of(Severity.WARNING):
        print(finding.check, finding.message)
    ji.write_log(log.between(0.0, 1.0).select(["elbow"]), path.with_suffix(".csv"))
    return log.with_torque_gains([1.0, 2.0])


def estimate(robot: ji.Robot, log: ji.Log) -> float:
    observed = log_filter.observe(log, robot)
    fit = batch_fit.fit(robot, [observed], ["lower"], prior=Load(1.0), joint_terms=("damping",))
    ekf = log_filter.online(robot, ["lower"], fit.noise, prior=Load(1.0))
    state, trace = log_filter.run(ekf, ekf.initial(), log_filter.thinned(observed))
    other: Estimator = make_estimator(
        robot,
        ["lower"],
        sigma_tau=0.1,
        chart=charts.LogCholeskyUUt(),
        gate=ChiSquaredGate(0.999, 2),
    )
    checks = consistency(trace.innovation)
    handed = Slew().step(robot.pi[1], trace.estimate.pi[-1, 0], 0.01)
    print(state.belief.mean, other.bodies, checks.nis_per_row, handed, fit.converged)
    print(nees(state.belief.mean, state.belief.covariance, state.belief.mean))
    known = knowledge(robot, observed, ["lower"], fit.noise, prior=Load(1.0))
    print(known.of(Source.PRIOR), structure(robot).rank, known.log_det)
    return float(trace.estimate.pi[-1, 0, 0])


def commands(robot: ji.Robot, log: ji.Log, other: ji.Log) -> dict[str, np.ndarray]:
    found: ji.LogEstimate = ji.estimate(robot, log, ["lower"], calibrate=[other], gains=[1.0, 2.0])
    missing = ji.diagnose(robot, log, test_log=other, exclude=["backlash"])
    print(missing.headline, missing.verdict, ji.to_report(missing), ji.to_report(found)["bodies"])
    return found.pi


def stream(robot: ji.Robot, chunks: Iterator[ji.Log], path: Path) -> None:
    whole = Stream(make_estimator(robot, ["lower"], sigma_tau=0.1), window=8)
    state = load_stream(path, whole) if path.exists() else whole.start()
    for chunk in chunks:
        state, part = whole.feed(state, chunk)
        if part is not None:
            print(part.time[-1], part.trace.estimate.pi[-1])
        save_stream(path, whole, state)


def gap(robot: ji.Robot, log: ji.Log, folder: Path) -> Diagnosis:
    found = diagnose(robot, log, exclude=["backlash"], nominal_uncertainty=(0.01, 0.001, 0.02))
    if found.verdict is Verdict.EXPLAINED:
        for effect in found.found:
            for name, p in effect.parameters.items():
                print(effect.family, effect.place.name, name, p.value, p.low, p.high, p.unit)
    report = to_report(found)
    (folder / "report.json").write_text(json.dumps(report))
    done = correction(load_spec(folder / "arm.xml"), robot, found)
    correct = callback(done.spec.compile(), effects_in(report))
    print(correct, found.headline, done.notes)
    return found


def motion(robot: ji.Robot, source: Path) -> np.ndarray:
    found = suggest_motion(robot, ["lower"], Limits.of(double_pendulum(), velocity=1.0))
    spec = load_spec(source)
    set_inertials(spec, {"lower": np.asarray(robot.pi[1])})
    write_urdf(source, source.with_name("out.urdf"), {"lower": np.asarray(robot.pi[1])})
    fit = weighted_least_squares(np.eye(3), np.ones(3))
    print(fit.value, fit.identifiability.rank)
    return found.q
