"""What resembles an effect on average, and is not as large throughout: on logs by MuJoCo C."""

import dataclasses

import mujoco
import numpy as np
import pytest
from arm_log import ARM, simulate

from jax_inertia import load_model
from jax_inertia.diagnosis.entry import diagnose
from jax_inertia.diagnosis.result import Verdict


@pytest.fixture(scope="module")
def robot():
    return load_model(mujoco.MjModel.from_xml_string(ARM))


def test_an_encoder_with_a_wrong_scale_is_named(robot):
    found = diagnose(robot, simulate(encoder=lambda q: q * np.array([1.0, 1.012])))
    assert found.verdict is Verdict.EXPLAINED
    (effect,) = found.odd
    assert (effect.family, effect.place.name) == ("encoder_scale", "elbow")
    assert effect.parameters["scale"].value == pytest.approx(0.012, rel=0.1)


@pytest.mark.slow
def test_an_encoder_whose_disk_is_eccentric_is_no_wrong_scale(robot):
    disk = 0.012 * np.array([0.0, 1.0])
    found = diagnose(robot, simulate(encoder=lambda q: q + disk * np.sin(q)))
    assert found.verdict is Verdict.UNKNOWN


def test_what_no_effect_comes_near_stands_out_all_the_same(robot):
    """A disk that wobbles thrice a turn, too little for any effect of the library to be found in its place."""
    wobble = 1.2e-3 * np.array([0.0, 1.0])
    found = diagnose(robot, simulate(encoder=lambda q: q + wobble * np.sin(3 * q)))
    assert found.verdict is Verdict.UNKNOWN
    assert not found.odd


@pytest.mark.slow
def test_a_friction_that_grows_with_the_angle_is_no_friction_of_the_library(robot):
    found = diagnose(robot, simulate(lambda t, q, v, u: np.array([0.0, -0.2 * v[1] * (q[1] > 0)])))
    assert found.verdict is Verdict.UNKNOWN


def shove(turning: float):
    """6 N on the lower arm from 3 to 3.8 s, turning about at `turning` rad/s."""

    def force(t):
        angle = turning * (t - 3.0)
        return 6.0 * (3.0 <= t < 3.8) * np.array([np.cos(angle), 0.0, np.sin(angle)])

    return force


@pytest.mark.slow
def test_a_push_with_a_sudden_beginning_and_end_is_sized(robot):
    found = diagnose(robot, simulate(force=shove(0.0)))
    assert found.verdict is Verdict.EXPLAINED
    (effect,) = found.odd
    assert (effect.family, effect.place.name) == ("push", "lower")
    value = {name: p.value for name, p in effect.parameters.items()}
    assert value["force_x"] == pytest.approx(6.0, rel=0.05)
    assert value["force_z"] == pytest.approx(0.0, abs=0.4)
    assert value["start"] == pytest.approx(3.0, abs=0.06)
    assert value["end"] == pytest.approx(3.8, abs=0.06)


@pytest.mark.slow
def test_a_force_that_turns_about_is_no_push(robot):
    assert diagnose(robot, simulate(force=shove(9.0))).verdict in (Verdict.UNKNOWN, Verdict.PARTLY)


@pytest.mark.slow
def test_a_hose_with_hysteresis_is_no_spring(robot):
    state = np.zeros(1)

    def hose(t, q, v, u):
        # Dahl's law: half a radian until it yields, far from any dry friction.
        state[0] += (1.0 - state[0] * np.sign(v[1])) * v[1] / 0.5 * 5e-4
        return np.array([0.0, -0.3 * state[0]])

    found = diagnose(robot, simulate(hose))
    assert found.verdict is Verdict.UNKNOWN


@pytest.mark.slow
def test_clocks_that_run_apart_are_no_lag(robot):
    log = simulate()
    late = [np.interp(log.time * (1 + 2e-3), log.time, q) for q in np.asarray(log.qpos).T]
    found = diagnose(robot, dataclasses.replace(log, qpos=np.stack(late, axis=1)))
    assert found.verdict in (Verdict.UNKNOWN, Verdict.PARTLY)
