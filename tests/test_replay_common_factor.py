"""What positions cannot tell: gains, frictions and masses, all by one factor. It must not be known to a replay's fit.

MuJoCo C moves the arms, and the law (M q̈ + g + friction = τ, both sides by one factor) is in closed form.
"""

import dataclasses

import mujoco
import numpy as np
import pytest
from test_replay import ARM, NAMES, run, without_torque

import jax_inertia as ji
from benchmarks.policy import arm
from benchmarks.worlds.targets import machines
from jax_inertia.replay.fitting import columns
from jax_inertia.replay.fitting.errors import Weights, replay_errors
from jax_inertia.replay.fitting.fit import Fit
from jax_inertia.replay.listing import known
from jax_inertia.replay.loop import ALL, NO_JOINT, Parameter, ordinary, position_loop
from jax_inertia.replay.record import record_of
from jax_inertia.replay.search.candidates import Candidate
from jax_inertia.replay.search.elsewhere import Possible, elsewhere
from jax_inertia.replay.search.parsimony import needed
from jax_inertia.replay.simulation.plant import Plant

EARLY = '<mujoco><option timestep="0.001" iterations="4" ls_iterations="6"/>'
"""Of a model for MJX: the solver of friction stops early."""


def spec() -> mujoco.MjSpec:
    return mujoco.MjSpec.from_string(ARM.replace("<mujoco>", EARLY))


def scaled(j: int) -> list[tuple[Parameter, float]]:
    """The ordinary numbers of a joint, each with by what it grows where all grow by one factor."""
    kd, damping = (1.5, 0.8)[j], 0.05
    own = {"viscous_friction": kd + damping, "coulomb_friction": 0.1, "armature": (0.02, 0.01)[j]}
    rows = [(Parameter(f, j, x, x, 0.0, np.inf), x) for f, x in own.items()]
    return [*rows, (Parameter("kp_scale", j, 0.0, 1.0, -3.0, 3.0), 1.0)]


def test_derivatives_say_that_one_factor_of_all_is_the_same_motion():
    log = without_torque(run(delay=0.004, seconds=4.0))
    loop = position_loop(log, spec().compile())
    # MuJoCo's own friction creeps, by figures of the compiled model that no factor changes.
    plant = Plant(spec(), NAMES, loop, holds=True)
    rows = [*scaled(0), *scaled(1)]
    rows += [
        (Parameter("mass_share", NO_JOINT, 0.0, 1.0, -0.5, 0.5, b), 1.0) for b in ("upper", "lower")
    ]
    table, way = zip(*rows, strict=True)
    records, theta = [record_of(log, loop)], np.array([p.nominal for p in table])
    more = [np.log1p(0.02) if p.family == "kp_scale" else 0.02 * x for p, x in rows]
    one = np.where([p.family == "kp_scale" for p in table], more, 0.0)
    errors = replay_errors(
        plant, table, theta + np.stack([0.0 * one, one, np.array(more)]), records
    )
    alone, every = np.abs(errors[1:] - errors[0]).max(axis=(1, 2))
    assert every < 0.02 * alone
    # As wide as of numbers that a log of some minutes knows.
    bend = np.full(len(table), 1e8) / np.array([max(x, 0.01) for x in way]) ** 2
    of_all = columns.narrow(plant, table, records, theta, np.ones(len(table), bool), bend)
    size = np.sqrt(np.mean(of_all**2, axis=(1, 2))) * np.array(way)
    left = np.sqrt(np.mean(np.tensordot(np.array(way), of_all, 1) ** 2))
    assert left < 0.02 * size.max()


def test_what_a_model_says_is_off_by_a_tolerance_and_what_a_log_says_is_not():
    log = without_torque(run(seconds=1.0))
    model = spec().compile()
    two, one = np.ones(2), position_loop(log, model)
    said = position_loop(dataclasses.replace(log, kp=one.kp, kd=one.kd), model)
    assert (one.source, said.source) == ("model", "log")
    for loop, gains in ((one, 0.05), (said, 0.0)):
        own = (0.02 * two, 0.05 * two, 0.1 * two)
        table = ordinary(loop, *own, 0.03 * two, 0.03 * two, two)
        sd = {(p.family, p.joint): p.own for p in table}
        assert sd["kp_scale", 0] == gains
        assert sd["armature", 1] == pytest.approx(0.05 * 0.02)
        assert sd["coulomb_friction", 1] == pytest.approx(0.1 * 0.1)
        assert sd["viscous_friction", 0] == pytest.approx(np.hypot(0.1 * 0.05, gains * 1.5))
        # What no model has is there or is not.
        assert sd["encoder_offset", 0] == sd["target_delay", ALL] == 0.0


def fitted(table: tuple[Parameter, ...], theta: np.ndarray, known: float) -> Fit:
    """Numbers at the least of a cost whose second derivatives are a number's own: deviation `known` each."""
    n = len(table)
    columns = np.zeros((n, 100, 1))
    columns[np.arange(n), np.arange(n), 0] = 1.0 / known
    weights = Weights(np.ones(1), np.ones(1))
    square = known**2 * np.eye(n)
    return Fit(
        table, theta, square, np.linalg.inv(square), 100.0, np.zeros((100, 1)), columns, weights
    )


def test_what_a_model_is_off_by_in_any_case_is_not_needed():
    off = np.array([-0.06, -0.3])
    for own, expected in ((0.0, [1, 0]), (0.05, [1])):
        table = tuple(
            Parameter("kp_scale", j, 0.0, 1e3, -np.inf, np.inf, own=own) for j in range(2)
        )
        assert needed(fitted(table, off, 0.005), [0, 1]) == expected


def test_intervals_are_of_a_fit_with_what_may_be_there_too():
    """Against the variance of draws from both fits, each as often as it is probable."""
    gain, load = (Parameter(f, 0, 0.0, 1e3, -np.inf, np.inf) for f in ("kp_scale", "payload"))
    without = fitted((gain,), np.array([-0.36]), 0.02)
    more = fitted((gain, load), np.array([-0.30, 0.25]), 0.03)
    evidence = 2.0 * np.log(0.25 / 0.75)
    possible = [Possible(Candidate("payload", (load,), ()), evidence, more)]
    rng = np.random.default_rng(0)
    there = rng.random(400_000) < 0.25
    draws = np.where(there, rng.normal(-0.30, 0.03, 400_000), rng.normal(-0.36, 0.02, 400_000))
    expected = np.mean((draws + 0.36) ** 2)
    added = elsewhere(without, without, possible)
    assert 0.02**2 + added[0] == pytest.approx(expected, rel=0.01)
    _, sd = known(without._replace(elsewhere=added), 0)
    assert sd == pytest.approx(np.sqrt(expected), rel=0.01)
    # Where nothing else may be there, nothing is added.
    assert elsewhere(without, without, []) == 0.0
    # Nor by what evidence asks for and validation rows refused.
    assert elsewhere(without, without, [possible[0]._replace(evidence=1000.0)]) == 0.0


@pytest.mark.slow
def test_a_load_is_held_by_its_interval_where_no_log_says_the_gains(tmp_path):
    """The arm of benchmarks/policy, of MuJoCo C with LuGre's friction: 0.5 kg at its tip, 0.7 of the elbow's gain."""
    motion = arm.wanted(np.random.default_rng(1), seconds=20.0, fastest=2.0)
    seen, sent = arm.moved(lambda k, q, v: motion[k], motion, seed=1)
    at = arm.PERIOD * np.arange(len(seen))
    log = ji.Log(time=at, joint_names=arm.JOINTS, qpos=seen, qpos_target=sent)
    (tmp_path / "arm.xml").write_text(arm.MODEL)
    found = ji.diagnose(tmp_path / "arm.xml", log)
    assert isinstance(found, ji.ReplayDiagnosis)
    sizes = {(e.family, e.name): dict(e.sizes) for e in found.effects}
    load, gain = sizes["payload", "lower"], sizes["kp_scale", "elbow"]["scale"]
    assert load["mass"].low < arm.LOAD < load["mass"].high
    assert gain.low < arm.WEAK < gain.high
    for x in (load["mass"], gain):
        assert 0.02 < (x.high - x.low) / x.value < 0.3


@pytest.mark.slow
def test_a_load_is_not_every_gain_a_tenth_too_low(tmp_path):
    """A leg of the other plant, its friction of bristles: 0.25 kg at its hip's link, 0.75 of the knee's gain.

    All gains, frictions and rotors a tenth lower replay it as well. No joint's gain but the knee's may be called wrong.
    """
    leg = machines.leg()
    kp = machines.at(leg, "knee", 0.75, 1.0)
    x = machines.simulated(leg, machines.Hidden(kp=kp, mass={"hip_link": 0.25}), 14.0, 3)
    spec = mujoco.MjSpec.from_string(leg.xml)
    for joint, p, d in zip(leg.joints, leg.kp, leg.kd, strict=True):
        a = spec.add_actuator(name=joint, target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        a.set_to_position(kp=p, kv=d)
    spec.compile()
    (tmp_path / "leg.xml").write_text(spec.to_xml())
    names = ("time", "joint_names", "qpos", "qpos_target")
    found = ji.diagnose(tmp_path / "leg.xml", ji.Log(**{k: x[k] for k in names}))
    assert isinstance(found, ji.ReplayDiagnosis)
    gains = {e.name: e.sizes[0][1] for e in found.effects if e.family == "kp_scale"}
    assert set(gains) == {"knee"}
    assert gains["knee"].low < 0.75 < gains["knee"].high
    loads = [e for e in found.effects if e.family == "payload"]
    for e in loads:
        assert e.name == "hip_link"
        assert e.sizes[0][1].low < 0.25 < e.sizes[0][1].high
    # What is not named is tied with the gain.
    (gain,) = (e for e in found.effects if e.family == "kp_scale")
    assert loads or any(t.family == "payload" for t in gain.ties)
