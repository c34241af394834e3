"""Mixed examinations: any robot's mechanics kept, strata by their shares, faults as described, marks by hand."""

from __future__ import annotations

import json
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from benchmarks.blind import adapters, pace_positions, sysid_fit
from benchmarks.exam import marks, page, position_marks
from benchmarks.worlds import fleet, strata
from benchmarks.worlds.dynamics import inverse_dynamics
from benchmarks.worlds.misread import FAULTS, misread, mount
from benchmarks.worlds.own_robot import Unsuitable, own_robot
from benchmarks.worlds.targets import position

SCARA = """<mujoco model="scara"><compiler angle="degree"/><option gravity="0 0 -9.7"/><worldbody>
<body name="column" pos="0.1 0 0.4"><inertial pos="0.1 0 0" mass="3" diaginertia="0.02 0.03 0.03"/>
<joint name="turn" axis="0 0 1" range="-120 120" limited="true" damping="0.4" armature="0.1"/>
<body name="forearm" pos="0.3 0 0" euler="0 0 20"><inertial pos="0.1 0.02 0" mass="2" diaginertia="0.01 0.02 0.02"/>
<joint name="fold" axis="0 0 1" stiffness="0.7" springref="10" frictionloss="0.3"/>
<body pos="0.25 0 0"><inertial pos="0 0 -0.1" mass="0.8" diaginertia="0.004 0.004 0.001"/>
<joint name="lift" type="slide" axis="0 0 -1" range="0 0.18" limited="true" ref="0.05"/>
<geom type="mesh" mesh="tip" mass="0" contype="0" conaffinity="0"/></body></body></body></worldbody>
<asset><mesh name="tip" vertex="0 0 0 .1 0 0 0 .1 0 0 0 .1"/></asset>
<actuator><motor joint="turn"/></actuator></mujoco>"""

RIG = """<mujoco><worldbody><body name="bar"><joint name="hinge" axis="0 1 0"/>
<inertial pos="0 0 -0.14" mass="0.6" diaginertia="0.004 0.004 0.0005"/></body></worldbody></mujoco>"""

FREE = """<mujoco><worldbody><body name="trunk" pos="0 0 1"><freejoint/><geom size="0.1" mass="4"/>
<body name="leg" pos="0 0.1 0"><joint name="hip" axis="1 0 0"/><geom size="0.04" mass="1" pos="0 0 -0.2"/></body>
</body></worldbody></mujoco>"""


@pytest.fixture
def scara(tmp_path):
    file = tmp_path / "scara.xml"
    file.write_text(SCARA)
    return file


def test_own_robot_keeps_the_mechanics(scara):
    """Torques of MuJoCo's inverse dynamics, to the digits that MJCF keeps; no mesh, no actuator."""
    robot, model = own_robot(scara), mujoco.MjModel.from_xml_string(SCARA)
    assert robot.joints == ("turn", "fold", "lift")
    assert robot.bodies == ("column", "forearm", "body3")
    rng = np.random.default_rng(0)
    q, v, a = rng.uniform(-0.5, 0.5, (3, 20, 3))
    q[:, 2] = rng.uniform(0.01, 0.17, 20)  # inside the range, whose stop is left out
    kept = inverse_dynamics(robot.model(), q, v, a)
    np.testing.assert_allclose(kept, inverse_dynamics(model, q, v, a), rtol=1e-6, atol=1e-6)
    assert "mesh" not in robot.xml
    assert "motor" not in robot.xml


def test_own_robot_moves_within_the_ranges(scara):
    robot = own_robot(scara)
    low, high = np.deg2rad(120), 0.18
    assert -low < robot.lower[0] < robot.upper[0] < low
    assert 0.0 < robot.lower[2] < robot.upper[2] < high
    assert np.all(robot.peak > 0)


def test_a_floating_base_is_held_only_when_asked(tmp_path):
    file = tmp_path / "free.xml"
    file.write_text(FREE)
    with pytest.raises(Unsuitable, match="--fix-base"):
        own_robot(file)
    robot = own_robot(file, fix_base=True)
    assert (robot.joints, robot.bodies) == (("hip",), ("leg",))


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("<mujoco><worldbody><body><geom size='1'/></body></worldbody></mujoco>", "no joint"),
        ("<mujoco><worldbody><body><joint type='ball'/><geom size='1'/></body></worldbody></mujoco>", "ball"),
        ("not a model", "MJCF or URDF"),
    ],
)  # fmt: skip
def test_unsuitable_models_are_refused_in_one_line(tmp_path, text, word):
    file = tmp_path / "model.xml"
    file.write_text(text)
    with pytest.raises(Unsuitable, match=word) as caught:
        own_robot(file)
    assert "\n" not in str(caught.value)


def test_plan_holds_every_stratum_by_its_share():
    tasks = strata.plan(5, 200)
    for name, share in strata.SHARES.items():
        assert abs(sum(t.stratum == name for t in tasks) - 200 * share) <= 1
    assert {t.kind for t in tasks if t.stratum == "misread"} == set(FAULTS)
    assert {t.stratum for t in strata.plan(5, 12)} == set(strata.SHARES)
    assert tasks == strata.plan(5, 200)
    assert tasks != strata.plan(6, 200)


def test_a_sixth_of_the_logs_with_torque_is_the_second_engines():
    tasks = strata.plan(5, 615)
    for stratum in strata.TWO_ENGINES:
        made = [t.engine for t in tasks if t.stratum == stratum]
        assert 0.1 < made.count("pinocchio") / len(made) < 0.2
        kinds = {t.kind for t in tasks if (t.stratum, t.engine) == (stratum, "pinocchio")}
        assert len(kinds) >= min(len(strata.KINDS.get(stratum, "x")), 4)
        assert any(t.validation for t in tasks if t.stratum == stratum)
    assert {t.engine for t in tasks if t.stratum not in strata.TWO_ENGINES} == {"mujoco"}
    assert {t.engine for t in strata.plan(5, 420, engines=("mujoco",))} == {"mujoco"}


def test_what_matters_most_comes_most_often_and_outside_there_are_nine_forms():
    tasks = strata.plan(5, 615)
    one = [t.kind for t in tasks if t.stratum == "one_effect"]
    assert sum(k in page.SOFT for k in one) >= 25
    assert len({t.kind for t in tasks if t.stratum == "outside"}) == 9


@pytest.mark.parametrize("seed", [None, 5])
@pytest.mark.parametrize("name", fleet.FLEET)
def test_the_fleets_robots_carry_themselves(name, seed):
    """Mass matrices are positive, motions keep to the ranges, and every joint's rated torque is more than nothing."""
    robot = fleet.robot(name, seed)
    model = robot.model()
    data, full = mujoco.MjData(model), np.zeros((model.nv, model.nv))
    data.qpos[:] = 0.5 * (robot.lower + robot.upper)
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, full)
    assert np.linalg.eigvalsh(full).min() > 0
    low, high = mujoco.MjModel.from_xml_string(fleet.mjcf(name, seed)).jnt_range.T
    assert np.all((low < robot.lower) & (robot.upper < high))
    assert robot.peak.min() > 0


@pytest.mark.slow
def test_every_set_has_robots_of_its_own():
    masses = [
        mujoco.MjModel.from_xml_string(fleet.mjcf("scara", s)).body_mass for s in (None, 5, 6)
    ]
    assert len({round(float(m[2]), 6) for m in masses}) == 3
    sound = {strata.make(t).truth["robot"] for t in some_sound(5)}
    assert len(sound) == 3


def some_sound(seed: int) -> list[strata.Task]:
    """Three sound robots that are told positions."""
    at = strata.plan(seed, 1)[0]
    return [replace(at, stratum="position", kind=str(6 * k)) for k in range(3)]


def test_a_robot_of_ones_own_stands_on_no_feet():
    assert {t.stratum for t in strata.plan(5, 40, ("mine.xml",))} == set(strata.SHARES) - {"imu"}


@pytest.fixture
def log(scara):
    robot = own_robot(scara)
    time = np.arange(0, 4, 0.01)
    q = np.stack([np.sin(time), np.cos(2 * time), 0.05 * np.sin(time)], 1)[:, [2, 0, 1]]
    names = np.array(["lift", "turn", "fold"])
    v = np.gradient(q, 0.01, axis=0)
    return robot, {"time": time, "joint_names": names, "qpos": q, "qvel": v, "tau": 3 * v + q}


def test_no_gravity_takes_the_models_gravity_out(log):
    robot, clean = log
    out = misread(clean, "no_gravity", robot, [1])
    lacking = clean["tau"] - out["tau"]
    assert np.abs(lacking[:, 0]).min() > 7.0  # 0.8 kg of the lift
    np.testing.assert_allclose(lacking[:, 1], 0.0, atol=1e-12)  # an upright axis carries none


def test_late_torque_is_the_same_curve_elsewhere(log):
    robot, clean = log
    out = misread(clean, "late_torque", robot, [3])
    name = "tau" if np.any(out["tau"] != clean["tau"]) else "qpos"
    rows = next(k for k in range(1, 30) if np.array_equal(out[name][k:], clean[name][:-k]))
    assert 0.035 < rows * 0.01 < 0.26


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_changes_only_what_it_says_and_is_drawn_again_alike(log, fault):
    robot, clean = log
    first, again = (misread(clean, fault, robot, [2]) for _ in range(2))
    for name, x in first.items():
        np.testing.assert_array_equal(x, again[name])
    changed = {n for n, x in first.items() if not np.array_equal(x, clean[n])}
    assert bool(changed) == (fault != "turned_mount")
    assert changed <= (
        {"tau"}
        if fault not in ("degrees", "other_zero", "late_torque")
        else {"qpos", "qvel", "tau"}
    )


def test_a_mount_is_turned_by_twenty_degrees_and_more(scara):
    robot = own_robot(scara)
    for seed in range(20):
        g = mount(robot, np.random.default_rng(seed))
        assert np.linalg.norm(g) == pytest.approx(9.7)
        assert -g[2] / 9.7 < np.cos(np.deg2rad(19))


def truth(stratum: str, odd=None, fault: str = "", sigmas: float = 10.0) -> dict:
    if odd:
        odd = odd | {"visibility": {"sigmas": sigmas}, "parameters": {}, "equivalent": []}
    return {
        "stratum": stratum,
        "robot": "r",
        "odd": odd,
        "fault": fault,
        "present": [],
        "joints": {},
    }


def effect(family: str, name: str, kind: str = "joint") -> dict:
    return {
        "family": family,
        "location": {"kind": kind, "name": name},
        "parameters": {},
        "equivalent": [],
    }


PAYLOAD = {"family": "payload", "location": {"kind": "body", "name": "hand"}}
HOSE = {"family": "unknown", "mechanism": "hose", "location": {"name": "a"}}


@pytest.mark.parametrize(
    ("hidden", "verdict", "listed", "right", "wrong"),
    [
        (truth("sound"), "no_gap", [], True, False),
        (truth("sound"), "explained", [effect("cogging", "a")], False, True),
        (truth("bare"), "explained", [effect("armature", "a")], True, False),
        (truth("bare"), "explained", [effect("cogging", "a")], False, True),
        (truth("bare_odd", PAYLOAD), "partly", [effect("payload", "hand", "body")], True, False),
        (truth("bare_odd", PAYLOAD), "explained", [effect("payload", "arm", "body")], False, True),
        (truth("bare_odd", PAYLOAD, sigmas=1.0), "explained", [effect("armature", "a")], True, False),
        (truth("outside", HOSE), "partly", [], True, False),
    ],
)  # fmt: skip
def test_marks_of_effects(hidden, verdict, listed, right, wrong):
    report = {"verdict": verdict, "effects": listed}
    odd = hidden["odd"]
    row = {"verdict": verdict, "asked": not odd or odd["visibility"]["sigmas"] >= 3.0}
    made = marks._of_effects(hidden, report, row)
    assert (made["right"], made["confident_wrong"]) == (right, wrong)


@pytest.mark.parametrize(
    ("report", "said", "right"),
    [
        (None, "error: tau holds no gravity; --gravity-compensated", True),
        (None, "error: the log is too short", False),
        ({"verdict": "explained", "effects": []}, "warning: gravity", False),
        ({"verdict": "unknown", "effects": [], "misread": "no_gravity"}, "", True),
    ],
)
def test_marks_of_faults(report, said, right):
    assert marks._of_fault(truth("misread", fault="no_gravity"), report, said)["right"] == right


def told(kind: str, *effects: dict, sigmas: float = 10.0) -> dict:
    seen = [e | {"visibility": {"sigmas": sigmas}} for e in effects]
    return {"stratum": "position", "kind": kind, "effects": seen}


DEAD, LATE = effect("dead_band", "a"), effect("target_delay", "global", "global")


@pytest.mark.parametrize(
    ("hidden", "verdict", "listed", "right", "wrong"),
    [
        (told("sound"), "no_gap", [], True, False),
        (told("sound"), "explained", [effect("armature", "a")], False, True),
        (told("ordinary"), "explained", [effect("armature", "a")], True, False),
        (told("ordinary"), "explained", [DEAD], False, True),
        (told("single", DEAD), "explained", [effect("armature", "a"), DEAD], True, False),
        (told("single", DEAD), "partly", [effect("backlash", "a") | {"equivalent": [DEAD]}], True, False),
        (told("single", DEAD), "explained", [effect("dead_band", "b")], False, True),
        (told("single", DEAD, sigmas=1.0), "explained", [], True, False),
        (told("pair", DEAD, LATE), "explained", [DEAD], False, True),
        (told("pair", DEAD, LATE), "partly", [DEAD], False, False),
        (told("pair", DEAD, LATE), "explained", [DEAD, LATE], True, False),
        (told("alone", LATE), "explained", [LATE], True, False),
    ],
)  # fmt: skip
def test_marks_of_positions(hidden, verdict, listed, right, wrong):
    made = position_marks.of_effects(hidden, {"verdict": verdict, "effects": listed})
    assert (made["right"], made["confident_wrong"]) == (right, wrong)


@pytest.fixture(scope="module")
def rigs(tmp_path_factory):
    """Logs of the one-joint rig: sound, and with a dead band that friction accompanies; their folders."""
    home = tmp_path_factory.mktemp("rigs")
    out = {}
    file = home / "rig.xml"
    file.write_text(RIG)
    for kind, number in (("sound", 6), ("single", 44)):
        made = position.make(number, [5], torque=False, bought=own_robot(file))
        assert made.truth["kind"] == kind
        folder = home / kind
        folder.mkdir()
        (folder / "nominal.xml").write_text(made.nominal)
        (folder / "truth.json").write_text(json.dumps(made.truth | {"stratum": "position"}))
        for name, log in (("log", made.log), ("test", made.test)):
            np.savez(folder / f"{name}.npz", **log)
        out[kind] = folder
    return out


@pytest.mark.slow
def test_position_logs_hold_targets_and_no_torque(rigs):
    with np.load(rigs["single"] / "log.npz") as log:
        assert set(log.files) == {"time", "joint_names", "qpos", "qpos_target", "kp", "kd"}
    truth = json.loads((rigs["single"] / "truth.json").read_text())
    [hidden] = truth["effects"]
    assert hidden["location"] == {"kind": "joint", "name": "hinge"}
    assert hidden["visibility"]["sigmas"] > 1.0


@pytest.mark.slow
def test_a_sound_robot_replays_as_its_nominal_model(rigs, tmp_path):
    """Within what a loop's hold of a millisecond is at some rad/s, which a loop without hold does not know."""
    found = position_marks.errors(rigs["sound"], tmp_path)
    assert found["tool"] == found["nominal"] < 3e-3


def test_the_pace_like_fit_hands_back_a_model_that_replays(rigs, tmp_path):
    folder = rigs["single"]
    with np.load(folder / "log.npz") as file:
        log = {k: file[k] for k in file.files}
    report, xml = pace_positions.answer(folder, log)
    (tmp_path / "corrected.xml").write_text(xml)
    found = position_marks.errors(folder, tmp_path)
    assert found["tool"] < 0.5 * found["nominal"]
    assert {e["family"] for e in report["effects"]} & {"armature", "coulomb_friction"}


def test_sysid_says_what_to_install_and_floating_bases_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(sysid_fit, "AVAILABLE", False)
    (tmp_path / "nominal.xml").write_text(SCARA)
    one = {"time": np.arange(9.0), "joint_names": np.array(["turn"]), "tau": np.zeros((9, 1))}
    np.savez(tmp_path / "log.npz", **one)
    adapters.answer(tmp_path, tmp_path / "out", "mujoco_sysid")
    place = tmp_path / "out" / "results" / tmp_path.name
    run = json.loads((place / "run.json").read_text())
    assert run["error"] == "mujoco.sysid lacks its libraries; pip install 'mujoco[sysid]'"
    assert not (place / "report.json").exists()
    np.savez(tmp_path / "log.npz", **one, base_quat=np.ones((9, 4)))
    for tool in ("least_squares", "greedy_bic", "pace_like", "mujoco_sysid"):
        with pytest.raises(ValueError, match="the base floats"):
            adapters.report(tmp_path, tool)


@pytest.mark.skipif(not sysid_fit.AVAILABLE, reason="needs mujoco[sysid]")
def test_sysid_fits_what_it_is_told(tmp_path):
    """A pendulum with friction that its model lacks, from its torques."""
    model = (
        '<mujoco><option timestep="0.001"/><worldbody><body name="bar"><joint name="a" axis="0 1 0"{}/>'
        '<inertial pos="0 0 -0.3" mass="1" diaginertia="0.02 0.02 0.001"/></body></worldbody></mujoco>'
    )
    real = mujoco.MjModel.from_xml_string(model.format(' damping="0.3" armature="0.02"'))
    data, rows = mujoco.MjData(real), []
    for k in range(4000):
        tau = 2.0 * np.sin(0.004 * k) + np.sin(0.011 * k)
        if k % 4 == 0:
            rows.append((0.001 * k, data.qpos[0], tau))
        data.qfrc_applied[:] = tau
        mujoco.mj_step(real, data)
    time, q, tau = np.array(rows).T
    log = {"time": time, "joint_names": np.array(["a"]), "qpos": q[:, None], "tau": tau[:, None]}
    (lacking,), power = sysid_fit.fit(mujoco.MjSpec.from_string(model.format("")), log)
    assert lacking[0] == pytest.approx(0.3, rel=0.2)
    assert power.shape == (1, 4)


def test_some_rows_of_a_log_are_kept_with_what_has_no_rows():
    log = {
        "time": np.arange(10.0),
        "qpos": np.ones((10, 2)),
        "sigma_tau": np.ones(2),
        "tau_kind": np.array("current"),
    }
    out = strata.kept(log, 4)
    assert out["time"].tolist() == [0.0, 4.0, 8.0]
    assert out["qpos"].shape == (3, 2)
    assert out["sigma_tau"].shape == (2,)
    assert str(out["tau_kind"]) == "current"


def test_an_own_robot_gets_a_position_loop(scara):
    robot = position.told_positions(own_robot(scara))
    assert robot.joints == ("turn", "fold", "lift")
    assert np.all(robot.kp > 0)
    assert np.all(robot.kd > 0)
    assert np.all(robot.swing > 0)
