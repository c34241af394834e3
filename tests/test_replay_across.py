"""A spring across two joints of a position-controlled robot: its equation, its file, and logs of a twin whose spring is
torques of the test's own code at 0.5 ms, where the fit has a tendon in steps of 2 ms."""

import mujoco
import numpy as np
import pytest
from test_replay_effects import odd_effects

from jax_inertia.logs.log import Log
from jax_inertia.replay import handover, pipeline
from jax_inertia.replay.loop import Loop, Parameter
from jax_inertia.replay.record import record_of
from jax_inertia.replay.result import Correction
from jax_inertia.replay.simulation.plant import Plant
from jax_inertia.replay.simulation.simulate import replay

LEG = """<mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody><body name="thigh" pos="0 0 1">
<joint name="hip" axis="0 1 0" damping="0.3" armature="0.02"/>
<inertial pos="0 0 -0.12" mass="1.5" diaginertia="0.009 0.009 0.002"/>
<body name="shank" pos="0 0 -0.25"><joint name="knee" axis="0 1 0" damping="0.3" armature="0.02"/>
<inertial pos="0 0 -0.1" mass="0.5" diaginertia="0.003 0.003 0.0005"/></body></body></worldbody></mujoco>"""
NAMES = ("hip", "knee")
KP, KD = np.full(2, 40.0), np.full(2, 0.8)
LOOP = Loop(KP, KD, np.full(2, np.inf), "log")
K, RATIO, REST, DAMPING = 9.0, -0.7, 0.4, 0.15
TABLE = (
    Parameter("spring_across", 1, 0.0, 20.0, 0.0, np.inf),
    Parameter("across_torque", 1, 0.0, 20.0, -np.inf, np.inf),
    Parameter("across_damping", 1, 0.0, 1.0, 0.0, np.inf),
    Parameter("across_ratio", 1, -1.0, 0.5, -5.0, -0.2),
)
THETA = np.array([K, K * REST, DAMPING, RATIO])


def leg() -> mujoco.MjSpec:
    return mujoco.MjSpec.from_string(LEG)


def sprung(q: np.ndarray, v: np.ndarray) -> np.ndarray:
    along = np.array([1.0, RATIO])
    return -(K * (along @ q - REST) + DAMPING * (along @ v)) * along


def recorded(seed: int, torque=sprung, seconds=8.0) -> Log:
    """50 Hz, of MuJoCo C at 0.5 ms, the loop's and the spring's torques by hand."""
    m = leg().compile()
    m.opt.timestep = 5e-4
    data, rng, rows = mujoco.MjData(m), np.random.default_rng(seed), []
    phase = rng.uniform(0, 6, 2)
    for k in range(int(seconds * 50)):
        aim = [0.4, 0.5] * np.sin(2 * np.pi * k / 50 * np.array([0.4, 1.1]) + phase) + [0, -0.6]
        aim = aim + 0.2 * np.sin(2 * np.pi * 2.0 * k / 50 + phase)
        rows.append((k / 50, *(data.qpos + 2e-4 * rng.normal(size=2)), *aim))
        for _ in range(40):
            own = KP * (aim - data.qpos) - KD * data.qvel
            data.qfrc_applied[:] = own + torque(data.qpos, data.qvel)
            mujoco.mj_step(m, data)
    x = np.array(rows)
    return Log(
        time=x[:, 0], joint_names=NAMES, qpos=x[:, 1:3], qpos_target=x[:, 3:], kp=KP, kd=KD
    )  # fmt: skip


def test_a_model_has_the_torque_of_the_equation():
    plant = Plant(leg(), NAMES, LOOP)
    assert plant.pairs == [(0, 1)]
    x = plant.numbers(TABLE, THETA, None)
    model = plant.variants(plant.structure(x), [x])[0]
    data = mujoco.MjData(model)
    for q, v in np.random.default_rng(0).normal(size=(20, 2, 2)):
        data.qpos[:], data.qvel[:] = q, v
        mujoco.mj_forward(model, data)
        np.testing.assert_allclose(data.qfrc_passive, sprung(q, v) - 0.3 * v, atol=1e-9)


def test_a_ratio_is_of_its_own_spring_alone():
    """Of two in one table, as candidates are tried side by side, the one that is not there changes nothing."""
    other = (*TABLE[:3], TABLE[3]._replace(nominal=1.0))
    plant, none = Plant(leg(), NAMES, LOOP), np.array([0.0, 0.0, 0.0, 1.0])
    for table, theta in (((*TABLE, *other), [*THETA, *none]), ((*other, *TABLE), [*none, *THETA])):
        x = plant.numbers(table, np.array(theta), None)
        assert (x.across[1], x.ratio[1]) == (K, RATIO)
    assert not plant.structure(plant.numbers(other, none, None)).across


def test_replay_and_file_move_as_the_twin():
    record, plant = record_of(recorded(1), LOOP), Plant(leg(), NAMES, LOOP)
    table = (*TABLE, Parameter("encoder_offset", 1, 0.0, 0.1, -1.0, 1.0))
    theta = np.append(THETA, 0.0)
    paths = replay(plant, table, np.array([theta, np.zeros(5)]), record)
    with_it, without = np.sqrt(np.mean((paths - record.q)[:, 20:] ** 2, axis=(1, 2)))
    # An offset of 20 mrad more is in the file's references, and the spring's rest with them.
    theta[-1] = 0.02
    planned = replay(plant, table, theta[None], record)[0]
    found = plant.numbers(table, theta, None)
    made = Correction(
        NAMES, LOOP, found, found.at_joint.lumped, plant.nominal, found.dry, False, plant.pairs
    )
    file = handover.written(made, leg(), handover.in_memory)
    done = handover.replayed(file.model, NAMES, LOOP, record)
    assert with_it < 3e-3
    assert without > 30.0 * with_it
    assert np.sqrt(np.mean((planned - done)[20:] ** 2)) < 2e-5


@pytest.mark.slow
def test_a_spring_across_two_joints_is_found_with_its_numbers():
    found = pipeline.diagnose([recorded(2)], leg, test_log=recorded(3))
    odd = odd_effects(found)
    assert set(odd) == {("spring_across", "knee")}
    sizes = dict(odd["spring_across", "knee"].sizes)
    assert sizes["stiffness"].value == pytest.approx(K, rel=0.05)
    assert sizes["ratio"].value == pytest.approx(RATIO, rel=0.05)
    assert sizes["rest_angle"].value == pytest.approx(REST, abs=0.03)
    assert odd["spring_across", "knee"].probability > 0.8
    assert found.replayed.after.max() < 1e-3


@pytest.mark.slow
def test_a_leg_without_it_has_none():
    found = pipeline.diagnose(
        [recorded(4, lambda q, v: np.zeros(2))],
        leg,
        test_log=recorded(5, lambda q, v: np.zeros(2)),
    )
    assert odd_effects(found) == {}
