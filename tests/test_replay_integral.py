"""The integral of a drive: MuJoCo's own steps against a sum by hand, and logs of MuJoCo C whose loop integrates in
code of the test's own, every 1 ms where the fit takes other steps."""

import dataclasses

import mujoco
import numpy as np
import pytest
from test_replay_effects import KD, KP, LOOP, NAMES, made, odd_effects, two

from jax_inertia.replay import pipeline
from jax_inertia.replay.loop import Parameter
from jax_inertia.replay.record import record_of
from jax_inertia.replay.simulation.plant import Plant
from jax_inertia.replay.simulation.simulate import misses, replay
from jax_inertia.replay.simulation.spec_edits import INTEGRAL, add_integral

KI, CLAMP = np.array([40.0, 30.0]), np.array([0.35, np.inf])
TABLE = tuple(
    Parameter(family, j, 0.0, 1.0, 0.0, 999.0)
    for family in ("drive_integral", "integral_windup", "coulomb_friction")
    for j in (0, 1)
)
THETA = np.array([*KI, 1.0 / CLAMP[0], 0.0, 0.05, 0.05])


def integrating(seed: int, ki=KI, clamp=CLAMP, *, seconds=8.0):
    """Loops of 1 kHz with an integral that stays within its clamp."""
    wound = np.zeros(2)

    def law(miss, v):
        wound[:] = np.clip(wound + 1e-3 * ki * miss, -clamp, clamp)
        return KP * miss - KD * v + wound, 0.05

    return made(law, seed=seed, seconds=seconds)


def test_a_model_integrates_up_to_its_clamp():
    plant = Plant(two(), NAMES, LOOP)
    x = plant.numbers(TABLE, THETA, None)
    model, at = plant.variants(plant.structure(x), [x])[0], plant.compiled(plant.structure(x))
    data, wound, reached = mujoco.MjData(model), np.zeros(2), np.zeros(2)
    for k in range(1500):
        aim = 0.4 * np.sin(np.array([2.0, 3.0]) * k * model.opt.timestep) + 0.1
        data.ctrl[at.act] = data.ctrl[at.integral] = aim
        mujoco.mj_forward(model, data)
        np.testing.assert_allclose(data.actuator_force[at.integral], wound, atol=1e-9)
        reached = np.maximum(reached, np.abs(wound))
        step = model.opt.timestep * KI * (aim - data.qpos)
        wound = np.clip(wound + step, -CLAMP, CLAMP)
        mujoco.mj_step(model, data)
    assert reached[0] == pytest.approx(CLAMP[0])
    assert reached[1] > 1.5 * CLAMP[0]


def test_replays_are_those_of_another_loops_code_from_any_sample_on():
    """Of the whole log, and of a stretch at whose start the integral is nobody's knowledge."""
    record = record_of(integrating(1), LOOP)
    plant = Plant(two(), NAMES, LOOP, holds=True)
    bare = THETA * (np.arange(6) > 3)
    for r in (record, record.between(700, 1500)):
        for one, most in ((plant, 2e-3), (plant.quick, 3e-3)):
            paths = replay(one, TABLE, np.array([THETA, bare]), r)
            error = np.sqrt(np.mean((paths - r.q)[:, r.settled] ** 2, axis=(1, 2)))
            assert error[0] < most
            assert error[1] > 8.0 * most


def test_a_torque_limit_is_of_loop_and_integral_together():
    plant = Plant(two(), NAMES, LOOP._replace(limit=np.full(2, 1.0)))
    x = plant.numbers(TABLE, THETA, None)
    model, at = plant.variants(plant.structure(x), [x])[0], plant.compiled(plant.structure(x))
    data = mujoco.MjData(model)
    data.ctrl[at.act] = data.ctrl[at.integral] = 0.5
    data.act[:] = 0.2 / KI
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(data.actuator_force[at.integral], 0.2)
    np.testing.assert_allclose(data.qfrc_actuator, 1.0)


def test_a_logged_torque_has_the_integral_along_what_was_measured():
    log = integrating(2, seconds=5.0)
    wound, tau = np.array([0.2, -0.5]), []
    speed = np.gradient(log.qpos, log.time, axis=0)
    for q, aim, v in zip(log.qpos, log.qpos_target, speed, strict=True):
        tau.append(KP * (aim - q) - KD * v + wound)
        wound = np.clip(wound + 5e-3 * KI * (aim - q), -CLAMP, CLAMP)
    record = record_of(dataclasses.replace(log, tau=np.array(tau)), LOOP, torque=True)
    plant = Plant(two(), NAMES, LOOP)
    error = misses(plant, TABLE, np.array([THETA, 0.0 * THETA]), record)[:, record.settled]
    with_it, without = np.sqrt(np.mean(error**2, axis=(1, 2)))
    assert with_it < 0.05 * without


def test_an_integral_that_a_model_has_is_its_own():
    """As a second actuator, and in one with the position's gains."""
    spec = two()
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    for name, kp, kd, ki in zip(NAMES, KP, KD, KI, strict=True):
        a = spec.add_actuator(name=f"{name}_drive", target=name)
        a.trntype = mujoco.mjtTrn.mjTRN_JOINT
        if name == "a":
            a.set_to_position(kp=kp, kv=kd)
            add_integral(spec, name, ki, CLAMP[0])
        else:
            a.set_to_pid(kp=kp, kv=kd, ki=ki)
    assert any(x.name.endswith(INTEGRAL) for x in spec.actuators)
    plant = Plant(spec, NAMES, LOOP._replace(source="model"))
    np.testing.assert_allclose(plant.nominal.integral, KI)
    np.testing.assert_allclose(plant.nominal.windup, CLAMP)
    record = record_of(integrating(3, seconds=4.0), LOOP)
    own = replay(plant, (), np.zeros((1, 0)), record)[0]
    added = replay(Plant(two(), NAMES, LOOP), TABLE[:4], THETA[None, :4], record)[0]
    np.testing.assert_allclose(own, added, atol=1e-9)


@pytest.mark.slow
def test_an_integral_is_found_at_its_joint():
    ki = KI * [1.0, 0.0]
    log, other = (integrating(seed, ki, seconds=10.0) for seed in (4, 5))
    found = pipeline.diagnose([log], two, test_log=other)
    odd = odd_effects(found)
    assert set(odd) == {("drive_integral", "a")}
    sizes = dict(odd["drive_integral", "a"].sizes)
    assert sizes["ki"].value == pytest.approx(40.0, rel=0.1)
    assert sizes["windup"].value == pytest.approx(0.35, rel=0.1)
    assert odd["drive_integral", "a"].probability > 0.8


@pytest.mark.slow
def test_a_sound_robot_and_a_bias_have_no_integral():
    for bias in (0.0, 0.4):
        log, other = (
            made(lambda miss, v, b=bias: (KP * miss - KD * v + [b, 0.0], 0.05), seed=seed)
            for seed in (6, 7)
        )
        found = pipeline.diagnose([log], two, test_log=other)
        assert {key[0] for key in odd_effects(found)} <= {"torque_bias"}
        assert bool(odd_effects(found)) == (bias > 0)
