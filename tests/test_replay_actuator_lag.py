"""A motor's torque that lags, in replays: the closed form, and logs of MuJoCo C whose torque a filter holds back."""

import numpy as np
import pytest
from test_replay_effects import KD, KP, LOOP, NAMES, made, odd_effects, two

from jax_inertia.replay import pipeline
from jax_inertia.replay.loop import Parameter
from jax_inertia.replay.record import record_of
from jax_inertia.replay.simulation.plant import Plant
from jax_inertia.replay.simulation.simulate import replay


def lagging(seed: int, slow: float):
    """Joint a's torque is that of the loop 1 / (T s + 1), in steps of the loop's 1 ms."""
    held = np.zeros(2)

    def law(miss, v):
        asked = KP * miss - KD * v
        share = np.array([1.0 - np.exp(-1e-3 / slow), 1.0])
        held[:] += share * (asked - held)
        return held.copy(), 0.05

    return made(law, seed=seed)


def test_a_torque_that_lags_moves_as_mujoco_c_moves_it():
    """Of MuJoCo C at 0.5 ms with a filter in the loop, in short steps and in long ones."""
    record = record_of(lagging(1, 0.02), LOOP)
    plant = Plant(two(), NAMES, LOOP, holds=True)
    table = tuple(
        Parameter(f, j, 0.0, 1.0, -9.0, 9.0)
        for f, j in [("actuator_lag", 0), ("coulomb_friction", 0), ("coulomb_friction", 1)]
    )
    theta = np.array([0.0205, 0.05, 0.05])
    for one, most in ((plant, 3e-3), (plant.quick, 6e-3)):
        error = replay(one, table, theta[None], record)[0] - record.q
        assert np.sqrt(np.mean(error[200:] ** 2)) < most


def test_a_lag_is_less_damping_and_less_inertia_to_its_second_order():
    plant = Plant(two(), NAMES, LOOP)
    table = (Parameter("actuator_lag", 0, 0.0, 0.02, 0.0, 0.5),)
    x = plant.numbers(table, np.array([0.02]), None).lumped
    s = 1e-3j
    exact = (KP[0] + KD[0] * s) / (0.02 * s + 1.0)
    got = (
        x.kp[0] + (x.kd[0] + x.damping[0]) * s + (x.armature[0] - plant.nominal.armature[0]) * s**2
    )
    assert got == pytest.approx(exact, abs=1e-11)
    assert x.lag[0] == 0.02
    assert x.armature[1] == plant.nominal.armature[1]


@pytest.mark.slow
def test_a_lag_of_a_motor_is_found_and_no_gain_is_blamed():
    log, other = (lagging(seed, 0.02) for seed in (2, 3))
    found = pipeline.diagnose([log], two, test_log=other)
    odd = odd_effects(found)
    assert set(odd) == {("actuator_lag", "a")}
    assert dict(odd["actuator_lag", "a"].sizes)["time_constant"].value == pytest.approx(
        0.02, rel=0.05
    )
    # As a lag of the targets alone it was a kd of a third, and less rotor.
    assert not {e.family for e in found.effects} & {"kd_scale", "armature"}
    # Nor has the file a motor that lags: what it has in its place replays as one, 28 mrad without.
    assert np.all(found.replayed.after < 5e-4)
