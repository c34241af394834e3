"""Causes that resemble each other, told apart: on logs of a small arm by MuJoCo C."""

import mujoco
import numpy as np
import pytest
from arm_log import ARM, TORQUE, asked, loaded, logged, simulate, wave

from jax_inertia import load_model
from jax_inertia.diagnosis.entry import diagnose
from jax_inertia.diagnosis.result import Verdict

ENCODER = 1e-4


@pytest.fixture(scope="module")
def robot():
    return load_model(mujoco.MjModel.from_xml_string(ARM))


def quick_and_slow(t, seed):
    """A wide slow motion, nine tenths of its torque below 1 Hz, with a small quick one on it."""
    parts = [(1.0, wave(t, seed, 0.3)), (0.06, wave(t, seed + 7, 2.5))]
    return tuple(sum(size * x[k] for size, x in parts) for k in range(2))


def late(lag=0.0, delay=0, seed=0, seconds=8.0, wave=wave, encoder=ENCODER, hold=2):
    """A log of a loop that feeds its encoders' noise back; torque comes late by a lag [s] or by steps of 1 ms.

    `hold`: steps of the loop and of the log.
    """
    model = mujoco.MjModel.from_xml_string(ARM)
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = wave(0.0, seed)
    rng = np.random.default_rng(seed + 100)
    commands, state, before, rows = [], None, None, []
    for k in range(round(seconds * 1000)):
        target, speed = wave(data.time, seed)
        if k % hold == 0:
            seen = data.qpos + encoder * rng.standard_normal(2)
            slope = (seen - (seen if before is None else before)) / (1e-3 * hold)
            u = asked(target, speed, seen, slope)
            before = seen
            rows.append((data.time, seen, u + TORQUE * rng.standard_normal(2)))
        commands.append(u)
        data.qfrc_applied[:] = commands[max(k - delay, 0)]
        if lag:
            # Of the exact response to a held command, the mean over the step.
            apart, x = (u if state is None else state) - u, 0.001 / lag
            data.qfrc_applied[:] = u - apart * np.expm1(-x) / x
            state = u + apart * np.exp(-x)
        mujoco.mj_step(model, data, 2)
    return logged(rows, encoder, TORQUE)


@pytest.mark.parametrize(
    ("how", "family"),
    [
        ({"lag": 0.006}, "actuator_lag"),
        ({"delay": 6}, "time_delay"),
    ],
)
def test_a_lag_and_a_delay_of_a_loop_that_feeds_noise_back(robot, how, family):
    """A delay passes on more of that noise, and by it a lag would be taken for one."""
    (effect,) = diagnose(robot, late(**how, seed=1)).odd
    assert (family, "global") in {(x.family, x.place.kind) for x in (effect, *effect.equivalent)}
    assert next(iter(effect.parameters.values())).value == pytest.approx(0.006, rel=0.05)


def test_a_delay_of_a_sample_and_a_half_is_no_matter_of_stamps(robot):
    """A normal tolerance of when torques act took all of it, and no file held it: stated was what nobody was given."""
    found = diagnose(robot, late(delay=6, seed=1, hold=4))
    (effect,) = found.odd
    assert effect.place.kind == "global"
    assert effect.family in ("time_delay", "actuator_lag")
    assert next(iter(effect.parameters.values())).value == pytest.approx(0.006, rel=0.05)
    assert found.verdict is Verdict.EXPLAINED


@pytest.mark.parametrize(
    ("how", "family"), [({"lag": 0.008}, "actuator_lag"), ({"delay": 8}, "time_delay")]
)
@pytest.mark.slow
def test_a_lag_and_a_delay_of_a_slow_motion(robot, how, family):
    """They part where the motion is quick, however little of it is."""
    found = diagnose(robot, late(**how, seed=4, wave=quick_and_slow, encoder=2e-5))
    (effect,) = found.odd
    assert (effect.family, effect.place.kind) == (family, "global")
    assert effect.probability > 0.9


@pytest.mark.parametrize(
    ("more", "family", "numbers"),
    [
        (0.0, "coulomb_friction", {"coulomb": 0.05}),
        (0.5, "stribeck_friction", {"coulomb": 0.05, "stiction": 0.075, "stribeck_velocity": 0.06}),
    ],
)
def test_a_little_more_friction_when_slow_is_stribecks(robot, more, family, numbers):
    """It brings less than three free numbers of which nothing is known would cost."""

    def friction(t, q, v, u):
        stick = 1.0 + more * np.exp(-((v[1] / 0.06) ** 2))
        return np.array([0.0, -0.05 * stick * np.tanh(v[1] / 0.003)])

    (effect,) = diagnose(robot, simulate(friction, seed=1, pace=0.3)).odd
    assert (effect.family, effect.place.name) == (family, "elbow")
    for name, value in numbers.items():
        assert effect.parameters[name].value == pytest.approx(value, rel=0.15)


@pytest.mark.slow
def test_a_load_is_of_the_link_that_a_joint_carries():
    """Frames that are fixed to it would show it alike."""
    frames = '<body name="flange" pos="0.02 0.05 -0.3"/><body name="tool" pos="0 0.3 -0.3"/></body></body>'
    model = mujoco.MjModel.from_xml_string(ARM.replace("</body></body>", frames))
    log = simulate(edit=loaded(0.3, (0.02, 0.05, -0.3)), seed=4)
    (effect,) = diagnose(load_model(model), log).odd
    twins = {e.place.name for e in effect.equivalent if e.kind == "exact"}
    assert effect.family == "payload"
    assert {effect.place.name, *twins} >= {"lower"}


def test_a_load_of_some_size_is_one_load(robot):
    """Its own inertia is no error of a link's."""
    found = diagnose(robot, simulate(edit=loaded(1.0, (0.02, 0.05, -0.3), radius=0.1), seed=4))
    (effect,) = found.odd
    assert (effect.family, effect.place.name) == ("payload", "lower")
    values = {"mass": 1.0, "com_x": 0.02, "com_y": 0.05, "com_z": -0.3, "gyration_radius": 0.1}
    for name, value in values.items():
        assert effect.parameters[name].value == pytest.approx(value, rel=0.1, abs=0.004)
