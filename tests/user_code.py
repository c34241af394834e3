# pyright: strict
"""What a user of the library writes: the lint step checks that its types hold in pyright's strict mode."""

import json
from collections.abc import Iterator
from pathlib import Path

import jax
import numpy as np

import jax_inertia as ji
from jax_inertia.maths import charts, gates  # modules whose classes plug into an estimator


def model() -> ji.Robot:
    robot = ji.load_model("arm.xml")
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
    pi = ji.from_com(mass, com, inertia)
    theta = ji.to_log_cholesky(pi)
    print(ji.pseudo_inertia(ji.from_log_cholesky(theta)).shape)
    return bool(ji.is_physical(pi))


def logs(path: Path, robot: ji.Robot) -> ji.Log:
    log = ji.read_log(path, options=ji.Options(degrees=True), names=robot)
    for finding in ji.check_log(log, robot).of(ji.Severity.WARNING):
        print(finding.check, finding.message)
    ji.write_log(log.between(0.0, 1.0).select(["elbow"]), path.with_suffix(".csv"))
    return log.with_torque_gains([1.0, 2.0])


def estimate(robot: ji.Robot, log: ji.Log) -> float:
    observed = ji.observe(log, robot)
    fit = ji.batch_fit(robot, [observed], ["lower"], prior=ji.Load(1.0), joint_terms=("damping",))
    ekf = ji.make_log_filter(robot, ["lower"], fit.noise, prior=ji.Load(1.0))
    state, trace = ji.run_log_filter(ekf, ekf.initial(), ji.thinned(observed))
    other: ji.Estimator = ji.make_estimator(
        robot,
        ["lower"],
        sigma_tau=0.1,
        chart=charts.LogCholeskyUUt(),
        gate=gates.ChiSquaredGate(0.999, 2),
    )
    print(state.belief.mean, other.bodies, trace.innovation.nis, fit.converged)
    known = ji.knowledge(robot, observed, ["lower"], fit.noise, prior=ji.Load(1.0))
    print(known.combinations, known.log_det)
    return float(trace.estimate.pi[-1, 0, 0])


def commands(robot: ji.Robot, log: ji.Log, other: ji.Log) -> dict[str, np.ndarray]:
    found: ji.LogEstimate = ji.estimate(robot, log, ["lower"], calibrate=[other], gains=[1.0, 2.0])
    missing = ji.diagnose(robot, log, test_log=other, exclude=["backlash"])
    print(missing.headline, missing.verdict, ji.to_report(missing), ji.to_report(found)["bodies"])
    return found.pi


def stream(robot: ji.Robot, chunks: Iterator[ji.Log], path: Path) -> None:
    whole = ji.Stream(ji.make_estimator(robot, ["lower"], sigma_tau=0.1), window=8)
    state = ji.load_stream(path, whole) if path.exists() else whole.start()
    for chunk in chunks:
        state, part = whole.feed(state, chunk)
        if part is not None:
            print(part.time[-1], part.trace.estimate.pi[-1])
        ji.save_stream(path, whole, state)


def gap(robot: ji.Robot, log: ji.Log, folder: Path) -> None:
    found = ji.diagnose(robot, log, exclude=["backlash"])
    if found.verdict == ji.Verdict.EXPLAINED and isinstance(found, ji.Diagnosis):
        for effect in found.found:
            for name, p in effect.parameters.items():
                print(effect.family, effect.place.name, name, p.value, p.low, p.high, p.unit)
    report = ji.to_report(found)
    (folder / "report.json").write_text(json.dumps(report))
    spec = ji.load_spec(folder / "corrected.xml")
    correct = ji.step_callback(spec.compile(), ji.effects_in(report))
    print(correct, found.headline)


def motion(robot: ji.Robot, source: Path) -> np.ndarray:
    spec = ji.load_spec(source)
    found = ji.suggest_motion(robot, ["lower"], ji.Limits.of(spec.compile(), velocity=1.0))
    ji.set_inertials(spec, {"lower": np.asarray(robot.pi[1])})
    ji.write_urdf(source, source.with_name("out.urdf"), {"lower": np.asarray(robot.pi[1])})
    return found.q
