"""What resembles an effect on average, and is not as large throughout: on logs by MuJoCo C."""

import dataclasses

import mujoco
import numpy as np
import pytest
from arm_log import ARM, simulate

from jax_inertia import load_model
from jax_inertia.diagnosis.effects.base import Place
from jax_inertia.diagnosis.features.context import Context
from jax_inertia.gap import Verdict, diagnose
from jax_inertia.gap.block import Block
from jax_inertia.gap.candidate import Candidate
from jax_inertia.gap.constancy import crowded
from jax_inertia.gap.families.force import Push
from jax_inertia.gap.families.joint import ViscousFriction
from jax_inertia.gap.outsiders import _lengths
from jax_inertia.signals.torque_residual import prepare


@pytest.fixture(scope="module")
def robot():
    return load_model(mujoco.MjModel.from_xml_string(ARM))


def test_an_encoder_with_a_wrong_scale_is_named(robot):
    found = diagnose(robot, simulate(encoder=lambda q: q * np.array([1.0, 1.012])))
    assert found.verdict is Verdict.EXPLAINED
    (effect,) = found.findings
    assert (effect.family, effect.place.name) == ("encoder_scale", "elbow")
    assert effect.parameters["scale"].value == pytest.approx(0.012, rel=0.1)


@pytest.mark.slow
def test_an_encoder_whose_disk_is_eccentric_is_no_wrong_scale(robot):
    disk = 0.012 * np.array([0.0, 1.0])
    found = diagnose(robot, simulate(encoder=lambda q: q + disk * np.sin(q)))
    assert found.verdict is Verdict.UNKNOWN
    assert any("would have to change" in note and "elbow" in note for note in found.doubts)


def test_what_no_effect_comes_near_stands_out_all_the_same(robot):
    """A disk that wobbles thrice a turn, too little for any effect of the library to be found in its place."""
    wobble = 6e-4 * np.array([0.0, 1.0])
    found = diagnose(robot, simulate(encoder=lambda q: q + wobble * np.sin(3 * q)))
    assert found.verdict is Verdict.UNKNOWN
    assert not found.findings
    assert any("encoder at elbow" in doubt for doubt in found.doubts)


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
    (effect,) = found.findings
    assert (effect.family, effect.place.name) == ("push", "lower")
    value = {name: p.value for name, p in effect.parameters.items()}
    assert value["force_x"] == pytest.approx(6.0, rel=0.05)
    assert value["force_z"] == pytest.approx(0.0, abs=0.3)
    assert value["start"] == pytest.approx(3.0, abs=0.03)
    assert value["end"] == pytest.approx(3.8, abs=0.03)


@pytest.mark.slow
def test_a_force_that_turns_about_is_no_push(robot):
    assert diagnose(robot, simulate(force=shove(9.0))).verdict is Verdict.UNKNOWN


def candidate(family, body: str, *shape: float) -> Candidate:
    place = Place(family.kind, body, 0)
    block = object.__new__(Block)
    vars(block)["shape"] = shape
    return Candidate(family, place, block, np.zeros(1), np.eye(1), np.zeros(1))


def test_forces_in_passing_at_two_bodies_are_one_cause():
    first = candidate(Push(), "upper", 1.0, 2.0, 0.3, 0.0)
    friction = candidate(ViscousFriction(), "elbow")
    again = candidate(Push(), "upper", 2.5, 3.0, 0.3, 0.0)
    elsewhere = candidate(Push(), "lower", 2.5, 3.0, 0.3, 0.0)
    overlapping = candidate(Push(), "upper", 1.5, 3.0, 0.3, 0.0)
    assert crowded([first, friction, again]) is None
    # Without a pause two pushes draw one event in pieces.
    assert crowded([first, friction, overlapping]) == (first, overlapping)
    assert crowded([first, friction, elsewhere]) == (first, elsewhere)


@pytest.mark.slow
def test_a_hose_with_hysteresis_is_no_spring(robot):
    state = np.zeros(1)

    def hose(t, q, v, u):
        # Dahl's law: half a radian until it yields, far from any dry friction.
        state[0] += (1.0 - state[0] * np.sign(v[1])) * v[1] / 0.5 * 5e-4
        return np.array([0.0, -0.3 * state[0]])

    found = diagnose(robot, simulate(hose))
    assert found.verdict is Verdict.UNKNOWN


def test_another_length_does_what_mujoco_says_it_does(robot):
    context = Context(prepare(robot, simulate(seconds=2.0)))
    ((name, columns),) = _lengths(context)
    assert name == "another length from upper to lower"
    needed = []
    for longer in (0.0, 0.01):
        model = mujoco.MjModel.from_xml_string(ARM)
        model.body_pos[2, 2] -= longer
        data = mujoco.MjData(model)
        rows = []
        for data.qpos[:], data.qvel[:], data.qacc[:] in zip(
            context.q[:40], context.v[:40], context.a[:40], strict=True
        ):
            mujoco.mj_inverse(model, data)
            rows.append(data.qfrc_inverse.copy())
        needed.append(np.array(rows))
    # Linear in the length but for the square of a centimetre.
    change = -0.01 * columns.values[:40, :, 2]
    np.testing.assert_allclose(change, needed[1] - needed[0], atol=0.03 * np.abs(change).max())


@pytest.mark.slow
def test_clocks_that_run_apart_are_no_lag(robot):
    log = simulate()
    late = [np.interp(log.time * (1 + 2e-3), log.time, q) for q in np.asarray(log.qpos).T]
    found = diagnose(robot, dataclasses.replace(log, qpos=np.stack(late, axis=1)))
    assert found.verdict is Verdict.UNKNOWN
