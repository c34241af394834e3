"""The diagnosis on small logs made by MuJoCo C, effects in forms of its own; nothing of the generator's code."""

import dataclasses
import json
import re

import mujoco
import numpy as np
import pytest
from arm_log import ARM, loaded, nothing, simulate

from jax_inertia import load_model
from jax_inertia.diagnosis.entry import diagnose
from jax_inertia.diagnosis.report.json_report import to_report
from jax_inertia.diagnosis.result import Verdict
from jax_inertia.diagnosis.simulate import plant
from jax_inertia.model.mujoco_warnings import mujoco_warnings
from jax_inertia.text.progress import share_of, shared
from jax_inertia.text.words import length


@pytest.fixture(scope="module")
def robot():
    return load_model(mujoco.MjModel.from_xml_string(ARM))


def test_a_true_model_has_no_gap(robot):
    found = diagnose(robot, simulate(nothing))
    assert found.verdict is Verdict.NO_GAP
    assert found.odd == ()


def viscous(t, q, v, u):
    return np.array([0.0, -0.15 * v[1]])


@pytest.fixture(scope="module")
def heard():
    """Stages of the next one."""
    return []


@pytest.fixture(scope="module")
def with_friction(robot, heard):
    """The diagnosis of viscous friction at the elbow, and a test log."""
    other = simulate(viscous, seed=5, seconds=6.0)
    return diagnose(robot, simulate(viscous), test_log=other, progress=shared(heard.append))


def test_a_program_hears_every_stage_and_the_first_answer_early(with_friction, heard):
    shares = [stage.share for stage in heard]
    assert shares == sorted(shares)
    assert shares[-1] >= 0.8
    assert all(share_of(stage) is not None for stage in heard)
    first = next(k for k, s in enumerate(heard) if s.startswith("ordinary physics alone"))
    assert heard[first + 1].startswith(("columns", "odd effects"))
    before, after = map(float, re.findall(r"(\S+) → (\S+) N m", heard[first])[0])
    assert before == pytest.approx(with_friction.heldout.before, rel=0.1)
    assert 0 < after < 0.3 * before


def test_viscous_friction_is_named_placed_and_sized(with_friction):
    found = with_friction
    assert found.verdict is Verdict.EXPLAINED
    (effect,) = found.odd
    assert (effect.family, effect.place.name) == ("viscous_friction", "elbow")
    assert effect.parameters["damping"].value == pytest.approx(0.15, rel=0.05)
    assert found.heldout.share > 0.8
    assert found.test is not None
    assert found.test.share > 0.8


@pytest.mark.slow
def test_dry_friction_with_another_law(robot):
    # A bristle of its own: deflection saturating over 0.5 mrad, not the library's sign.
    state = np.zeros(1)

    def torque(t, q, v, u):
        state[0] = np.clip(state[0] + v[0] * 0.0005 / 5e-4, -1, 1)
        return np.array([-0.6 * state[0], 0.0])

    found = diagnose(robot, simulate(torque))
    assert found.odd[0].family in ("coulomb_friction", "stribeck_friction")
    assert found.odd[0].place.name == "shoulder"


@pytest.mark.slow
@pytest.mark.parametrize("exponent", [2.0])
def test_either_curve_of_stribeck_is_told_from_the_other(robot, exponent):
    def torque(t, q, v, u):
        slow = np.exp(-(np.abs(v[1] / 0.15) ** exponent))
        return np.array([0.0, -(0.3 + 0.35 * slow) * np.tanh(v[1] / 0.002)])

    # Slow enough for the curve to last longer than the filters.
    (effect,) = diagnose(robot, simulate(torque, pace=0.2, seconds=12.0)).odd
    assert (effect.family, effect.place.name) == ("stribeck_friction", "elbow")
    assert effect.parameters["exponent"].value == exponent
    assert effect.parameters["stribeck_velocity"].value == pytest.approx(0.15, rel=0.1)
    assert effect.parameters["stiction"].value == pytest.approx(0.65, rel=0.1)


@pytest.mark.parametrize("of_motor", [0.0, pytest.param(1.0, marks=pytest.mark.slow)])
def test_what_loads_the_teeth_is_the_links_torque_or_the_motors(of_motor):
    """Of a shoulder whose motor takes nothing for itself: what the link carries is all that the motor gives."""
    robot = load_model(
        mujoco.MjModel.from_xml_string(ARM.replace(' damping="0.3" armature="0.05"', ""))
    )

    def rotorless(model):
        model.dof_armature[0] = model.dof_damping[0] = 0.0

    def torque(t, q, v, u):
        # f = F + μ|u| of the motor's torque u, and of the link's, u − f s: with the motion, or against it.
        s, mu = np.tanh(v[0] / 0.002), 0.0 if of_motor else 0.15 * np.sign(u[0] * v[0])
        return np.array([-(0.2 + 0.15 * abs(u[0])) / (1.0 + mu) * s, 0.0])

    (effect,) = diagnose(robot, simulate(torque, rotorless)).odd
    assert (effect.family, effect.place.name) == ("load_friction", "shoulder")
    assert effect.parameters["of_motor"].value == of_motor
    assert effect.parameters["load_coefficient"].value == pytest.approx(0.15, rel=0.03)
    assert effect.parameters["coulomb"].value == pytest.approx(0.2, rel=0.1)


def size_of(effect) -> float:
    """Of an angle, or of a vector of them."""
    vector = length(effect.parameters)
    return next(iter(effect.parameters.values())).value if vector is None else vector


@pytest.mark.parametrize("joint", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_an_encoder_that_is_degrees_off_is_all_there_is(robot, joint):
    """To first order in the angle two per cent of it would be left, for a force or a shifted mass to explain."""
    wrong = 0.08 * np.eye(2)[joint]
    (effect,) = diagnose(robot, simulate(encoder=lambda q: q + wrong, noise=0.1, seed=3)).odd
    # About the shoulder's own axis it is a tilt of gravity, exactly.
    names = {(x.family, x.place.name) for x in (effect, *effect.equivalent)}
    assert ("encoder_offset", ("shoulder", "elbow")[joint]) in names
    assert size_of(effect) == pytest.approx(0.08, rel=0.03)


@pytest.mark.slow
def test_gravity_that_is_degrees_off_is_all_there_is(robot):
    def tilt(model):
        model.opt.gravity[:] = 9.81 * np.array([-np.sin(0.07), 0.0, -np.cos(0.07)])

    # About the shoulder's own axis it is an offset of that joint's encoder, exactly.
    (effect,) = diagnose(robot, simulate(edit=tilt, noise=0.1, seed=3)).odd
    assert {effect.family, *(tie.family for tie in effect.equivalent)} >= {
        "encoder_offset",
        "gravity_tilt",
    }
    assert size_of(effect) == pytest.approx(0.07, rel=0.005)


def test_payload_is_found_on_its_body(robot):
    found = diagnose(robot, simulate(edit=loaded(0.4, (0.0, 0.0, -0.3))))
    effect = found.odd[0]
    names = {
        (effect.family, effect.place.name),
        *((t.family, t.place.name) for t in effect.equivalent),
    }
    assert ("payload", "lower") in names
    if effect.family == "payload":
        assert effect.parameters["mass"].value == pytest.approx(0.4, rel=0.1)


def test_excluded_families_are_not_found(robot):
    log = simulate(viscous)
    found = diagnose(robot, log, exclude=["viscous_friction"])
    assert all(f.family != "viscous_friction" for f in found.odd)
    with pytest.raises(ValueError, match="valid: actuator_lag"):
        diagnose(robot, log, exclude=["viscosity"])


def test_report_is_plain_json(with_friction):
    report = to_report(with_friction)
    text = json.dumps(report, allow_nan=False)
    assert json.loads(text)["schema"] == 1
    assert report["effects"][0]["location"] == {"kind": "joint", "name": "elbow"}


def test_too_short_a_log_is_refused(robot):
    log = simulate(nothing, seconds=1.0)
    with pytest.raises(ValueError, match="moving rows at most; at least 20 are needed"):
        diagnose(robot, log)


@pytest.mark.parametrize("factor", [1e3, 1e-3])
def test_torques_in_another_unit_are_refused(robot, factor):
    log = simulate(nothing)
    with pytest.raises(ValueError, match="times what the model needs"):
        diagnose(robot, dataclasses.replace(log, tau=factor * np.asarray(log.tau)))


@pytest.mark.slow
def test_who_asks_for_one_effect_of_two_is_told(robot):
    log = simulate(lambda t, q, v, u: np.array([0.5, -0.15 * v[1]]))
    found = diagnose(robot, log, max_effects=1)
    assert found.verdict in (Verdict.UNKNOWN, Verdict.PARTLY)
    assert len(found.odd) == 1
    assert len(diagnose(robot, log).odd) == 2


def test_a_simulation_that_bursts_leaves_nothing_in_the_user_s_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    model = mujoco.MjModel.from_xml_string(ARM)
    data = mujoco.MjData(model)
    data.qvel[:] = 1e12
    with mujoco_warnings() as said:
        mujoco.mj_step(model, data)
    assert len(said) == 1
    assert any(data.warning[kind].number for kind in plant._UNSTABLE)
    assert list(tmp_path.iterdir()) == []
