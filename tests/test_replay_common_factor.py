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
from jax_inertia.replay.fitting import columns
from jax_inertia.replay.fitting.errors import replay_errors
from jax_inertia.replay.loop import ALL, NO_JOINT, Parameter, ordinary, position_loop
from jax_inertia.replay.record import record_of
from jax_inertia.replay.search.parsimony import own_tolerance
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
    for loop, gains in ((one, 0.1), (said, 0.0)):
        own = (0.02 * two, 0.05 * two, 0.1 * two)
        table = ordinary(loop, *own, 0.03 * two, 0.03 * two, two)
        sd = dict(
            zip([(p.family, p.joint) for p in table], own_tolerance(table, loop), strict=True)
        )
        assert sd["kp_scale", 0] == gains
        assert sd["armature", 1] == pytest.approx(0.05 * 0.02)
        assert sd["coulomb_friction", 1] == pytest.approx(0.1 * 0.1)
        assert sd["viscous_friction", 0] == pytest.approx(np.hypot(0.1 * 0.05, gains * 1.5))
        # What no model has is there or is not.
        assert sd["encoder_offset", 0] == sd["target_delay", ALL] == 0.0


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
