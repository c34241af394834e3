"""Robots as bought: the generator's plant against MuJoCo's inverse dynamics, its truth, and the measure."""

from __future__ import annotations

import dataclasses
import json

import mujoco
import numpy as np
import pytest

from benchmarks.exam import least_squares, torque_marks
from benchmarks.exam.report_numbers import dahl
from benchmarks.exam.report_torque import ORDINARY, ReportTorque
from benchmarks.exam.torque_error import Signals, error_of, needed, rigid, signals, torque_error
from benchmarks.worlds import as_bought
from benchmarks.worlds import truth as nearest
from benchmarks.worlds.hidden import nominal_run
from benchmarks.worlds.motions import make_motion
from benchmarks.worlds.odd import ODD, OUTSIDE
from benchmarks.worlds.plant import Noise
from benchmarks.worlds.robots import CAD_ROBOTS
from benchmarks.worlds.setting import Setting, draw_noise, draw_setting

SETTING = draw_setting(3, 0)


def short(robot: str, seconds: float = 2.0) -> Setting:
    """A short log at 500 Hz, both motions exciting."""
    return dataclasses.replace(
        SETTING,
        robot=CAD_ROBOTS[robot](),
        rate=500,
        duration=seconds,
        test_duration=2.0,
        kinds=("exciting", "exciting"),
        bandwidth=12.0,
    )


@pytest.fixture(scope="module")
def ordinary():
    """(setting, hidden, noise, log without any noise) of an ordinary robot."""
    s = short("arm3")
    hidden = as_bought.draw_hidden(s, "", 0)
    log = as_bought.simulate(s, hidden, 0, Noise.none(3), preroll=0.4)
    return s, hidden, draw_noise(s, hidden.scale), log


def test_nominal_models_lack_friction_and_rotors():
    for name, make in CAD_ROBOTS.items():
        model = make().model()
        assert model.nv == int(name[-1])
        for array in (model.dof_damping, model.dof_frictionloss, model.dof_armature):
            np.testing.assert_array_equal(array, 0.0)


def test_an_ordinary_robot_leaves_nothing_of_its_own_equation(ordinary):
    """Bodies, rotors, recorded friction and offsets give the torque back: MuJoCo's inverse dynamics, 10 Hz."""
    s, hidden, noise, log = ordinary
    seen = nearest.judge(s.robot, hidden, log, noise, s.rate)["visibility"]
    for joint, left in seen["rms"].items():
        assert left < 2e-3 * seen["friction_rms"][joint]
    assert seen["sigmas"] < 0.5


def test_ripple_of_a_drive_is_no_effect(ordinary):
    """It moves the robot and is in no log: how visible an effect is must not count it."""
    s, hidden, noise, _ = ordinary
    s = dataclasses.replace(s, rate=1000)
    log = as_bought.simulate(s, hidden, 0, noise, preroll=0.4)
    seen = nearest.judge(s.robot, hidden, log, noise, s.rate)["visibility"]
    assert np.all(noise.ripple > 0)
    for joint, left in seen["rms"].items():
        assert left < 0.2 * seen["noise"][joint]


def test_friction_slides_at_the_law(ordinary):
    """Away from reversals the bristle's torque is g(v, τ) sign v + d |v|^p sign v."""
    _, hidden, _, log = ordinary
    v, tau = log["qvel"], log["tau"]
    fast = np.abs(v) > 0.3
    expected = hidden.law.sliding(v, tau)
    np.testing.assert_allclose(log["friction"][fast], expected[fast], rtol=0.02, atol=0.02)


@pytest.mark.parametrize(
    "kind",
    [
        *("gravity_tilt", "payload", "com_shift", "constant_force", "push"),
        *("torque_gain", "time_delay", "actuator_lag", "torque_saturation"),
        *("encoder_offset", "joint_elasticity", "joint_spring", "cogging", "joint_coupling"),
    ],
)
def test_the_truth_told_as_a_report_explains_the_log(kind, tmp_path):
    """Each convention of the truth, by an evaluator that has the contract's equation; no friction."""
    s = short("leg3", 4.0)
    hidden = as_bought.draw_hidden(s, kind, 0)
    s.duration = 2.0
    p = hidden.odd.parameters
    if kind == "push":
        p |= {"start": 0.8, "end": 1.4}
    law = hidden.law
    small = {"coulomb": law.coulomb * 1e-6, "viscous": law.viscous * 1e-6, "load": law.load * 0}
    hidden = dataclasses.replace(hidden, law=dataclasses.replace(law, **small))
    if kind == "torque_saturation":  # what was needed against friction is no longer
        joint = s.robot.joints.index(hidden.odd.name)
        p["limit"] = 0.7 * nominal_run(s.robot, "exciting", [*s.seed, 3, 0], 2.0).peak[joint]
    log = as_bought.simulate(s, hidden, 0, Noise.none(3), preroll=0.4)
    log["joint_names"] = np.array(s.robot.joints)
    terms = {"viscous_friction": 0 * hidden.bias, "coulomb_friction": 0 * hidden.bias}
    terms |= {"armature": hidden.armature, "torque_bias": hidden.bias}
    joints = {
        joint: {family: {"value": float(x[j])} for family, x in terms.items()}
        for j, joint in enumerate(s.robot.joints)
    }
    real = tmp_path / "real.xml"
    real.write_text(torque_marks.real_xml(s.robot.xml, hidden.inertials))
    odd = json.loads(json.dumps(hidden.odd.truth()))
    told = ReportTorque(real, {"effects": [odd], "joints": joints})
    left = told.error(log)["rms"]
    assert not told.left_out
    without = ReportTorque(real, {"effects": [], "joints": joints}).error(log)["rms"]
    # Flanks of a push, a second harmonic and a soft joint's damping are in no report.
    assert left < {"push": 0.6, "joint_elasticity": 0.2, "cogging": 0.2}.get(kind, 0.05) * without


def test_an_effect_beyond_the_evaluator_is_said(tmp_path, ordinary):
    s, _, _, log = ordinary
    path = tmp_path / "nominal.xml"
    path.write_text(s.robot.xml)
    effect = {"family": "backlash", "location": {"kind": "joint", "name": "joint2"}}
    told = ReportTorque(path, {"effects": [effect | {"parameters": {}}], "joints": {}})
    told.error(log | {"joint_names": np.array(s.robot.joints)})
    assert told.left_out == {"backlash"}


def test_inertias_of_a_corrected_model_keep_their_axes(tmp_path):
    """The nominal's are the bodies' own, and MuJoCo remembers that of a compiled model."""
    nominal, corrected = (tmp_path / name for name in ("nominal.xml", "corrected.xml"))
    body = '<body name="b{k}" pos="0 0 0.3"><joint name="j{k}" axis="{axis}"/>{inertia}'
    at = '<inertial pos="0.05 0 0.1" mass="2" diaginertia="0.01 0.03 0.02"{turned}/>'
    for path, turned in ((nominal, ""), (corrected, ' quat="0.7 0.5 0.3 0.2"')):
        bodies = "".join(
            body.format(k=k, axis=axis, inertia=at.format(turned=turned))
            for k, axis in enumerate(("0 0 1", "0 1 0"))
        )
        path.write_text(f"<mujoco><worldbody>{bodies}</body></body></worldbody></mujoco>")
    zero = {key: {"value": 0.0} for key in ORDINARY}
    told = ReportTorque(nominal, {"effects": [], "joints": {"j0": zero, "j1": zero}}, corrected)
    time = np.arange(0.0, 4.0, 0.004)
    q = 0.5 * np.sin(time[:, None] * np.array([3.0, 5.0]))
    log = {"time": time, "qpos": q, "tau": 0 * q, "joint_names": np.array(["j0", "j1"])}
    s = signals(mujoco.MjModel.from_xml_path(str(corrected)), log)
    right = rigid(mujoco.MjModel.from_xml_path(str(corrected)), s.q, s.v, s.a)
    np.testing.assert_allclose(told.needed(s), right, atol=1e-9)


def test_a_corrected_model_with_a_second_hinge_is_taken(tmp_path, ordinary):
    """Its bodies are; the joint between motor and link is none of the log's."""
    s, _, _, log = ordinary
    log = log | {"joint_names": np.array(s.robot.joints)}
    nominal, corrected = (tmp_path / name for name in ("nominal.xml", "corrected.xml"))
    nominal.write_text(s.robot.xml)
    spec = mujoco.MjSpec.from_string(s.robot.xml)
    joint = spec.joint("joint2")
    joint.parent.mass *= 1.5
    heavier = spec.copy().to_xml()
    hinge = joint.parent.add_joint(name="joint2_deflection", type=joint.type, axis=joint.axis)
    hinge.stiffness, joint.armature = np.array([500.0, 0.0, 0.0]), 0.05
    zero = {family: {"value": 0.0} for family in ORDINARY}
    report = {"effects": [], "joints": dict.fromkeys(s.robot.joints, zero)}
    errors = []
    for text in (spec.to_xml(), heavier, s.robot.xml):
        corrected.write_text(text)
        errors.append(ReportTorque(nominal, report, corrected).error(log)["rms"])
    assert errors[0] == pytest.approx(errors[1], rel=1e-9)
    assert abs(errors[0] - errors[2]) > 1e-3 * errors[2]


def test_dahl_follows_the_generator_s_bristle(ordinary):
    """LuGre without Stribeck or damping is Dahl's: z of both within 2 %."""
    _, hidden, _, log = ordinary
    t = log["time"]
    fine = np.linspace(t[0], t[-1], 20 * len(t))
    v = np.interp(fine, t, log["qvel"][:, 0])
    z = dahl(v, fine[1] - fine[0], hidden.presliding[0])
    x, exact = float(np.sign(v[0])), np.empty_like(z)
    for k, speed in enumerate(v):
        decay = np.exp(-abs(speed) * (fine[1] - fine[0]) / hidden.presliding[0])
        x = np.sign(speed) + (x - np.sign(speed)) * decay
        exact[k] = x
    np.testing.assert_allclose(z, exact, atol=0.1)
    assert np.sqrt(np.mean((z - exact) ** 2)) < 0.02


def test_the_measure_counts_moving_rows_in_its_band():
    """A constant 2 N m at a joint that moves half of the time; 60 Hz is out of the band."""
    model = CAD_ROBOTS["arm2"]().model()
    time = np.arange(0, 8, 0.004)
    v = np.zeros((len(time), 2))
    v[:, 0] = 1.0
    missing = np.zeros_like(v)
    missing[:, 0] = 2.0 + 5.0 * np.sin(2 * np.pi * 60.0 * time)
    missing[:, 1] = 100.0
    s = Signals(time, v, v, v, v, np.abs(v) > 0.02)
    error = error_of(model, s, missing)
    assert error["rows"] == {"joint1": len(time), "joint2": 0}
    assert error["rms"] == pytest.approx(2.0, rel=1e-3) == error["per_joint"]["joint1"]


def test_least_squares_finds_what_is_of_its_form():
    """A robot whose friction is d v + F sign v exactly; terms put in come out, another motion is explained."""
    robot = CAD_ROBOTS["arm3"]()
    model, time = robot.model(), np.arange(0, 12, 0.004)
    true = np.array([[1.2, 0.8, 0.3, 0.1], [0.9, 2.0, 0.2, -0.2], [0.3, 0.4, 0.05, 0.0]])
    logs = []
    for which in (0, 1):
        motion = make_motion(robot, "exciting", [5, which])
        q, v, a = (np.array(x) for x in zip(*map(motion, time), strict=True))
        tau = nearest.inverse_dynamics(model, q, v, a)
        tau += true[:, 0] * v + true[:, 1] * np.tanh(v / 0.003) + true[:, 2] * a + true[:, 3]
        logs.append({"time": time, "joint_names": np.array(robot.joints), "qpos": q, "tau": tau})
    fitted = least_squares.fit(model, logs[0], held=False)
    before = torque_error(model, needed, logs[1], held=False)["rms"]
    after = torque_error(model, fitted, logs[1], held=False)["rms"]
    assert after < 0.01 * before


def test_log_folder_is_whole_and_the_same_again(tmp_path, monkeypatch):
    """One log of two seconds on disk: contract's arrays, truth with every joint's terms, drawn again alike."""
    monkeypatch.setattr(as_bought, "draw_setting", lambda seed, index: short("arm2"))
    monkeypatch.setattr(as_bought, "draw_kind", lambda seed, index: "joint_spring")
    as_bought.write(tmp_path / "a", 1, 7), as_bought.write(tmp_path / "b", 1, 7)
    folder, again = tmp_path / "a" / "00007", tmp_path / "b" / "00007"
    assert sorted(p.name for p in folder.iterdir()) == [
        "log.npz",
        "nominal.xml",
        "test.npz",
        "truth.json",
    ]
    log = np.load(folder / "log.npz")
    assert {"time", "joint_names", "qpos", "tau", "tau_kind"} <= set(log.files)
    np.testing.assert_array_equal(log["qpos"], np.load(again / "log.npz")["qpos"])
    truth = json.loads((folder / "truth.json").read_text())
    assert truth["odd"]["family"] == "joint_spring"
    assert truth["odd"]["visibility"]["chi2"] > 0
    for terms in truth["joints"].values():
        assert {f: t["parameter"] for f, t in terms.items()} == {
            "viscous_friction": "damping",
            "coulomb_friction": "friction",
            "armature": "armature",
            "torque_bias": "bias",
        }


def test_shares_of_kinds():
    kinds = [as_bought.draw_kind(1, k) for k in range(200)]
    assert 0.5 < np.mean([k in ODD for k in kinds]) < 0.7
    assert 0.04 < np.mean([k in OUTSIDE for k in kinds]) < 0.17
    assert set(ODD) <= set(kinds)
