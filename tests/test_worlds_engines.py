"""The mixed examination's two engines make the same motion; robots on their feet weigh what their truth says."""

from __future__ import annotations

import dataclasses
import json

import mujoco
import numpy as np
import pytest
from pinocchio_oracle import pin  # noqa: F401 (skips where Pinocchio is absent)
from test_worlds_strata import SCARA

from benchmarks.exam import imu_marks
from benchmarks.worlds import as_bought, joint_physics
from benchmarks.worlds import effects as fx
from benchmarks.worlds import friction as fr
from benchmarks.worlds import setting as settings
from benchmarks.worlds import two_mass as tm
from benchmarks.worlds.feet import legs, standing
from benchmarks.worlds.motions import make_motion
from benchmarks.worlds.odd import Hidden
from benchmarks.worlds.own_robot import own_robot
from benchmarks.worlds.pinocchio_plant import PinocchioPlant, Slips
from benchmarks.worlds.plant import Noise, Plant
from benchmarks.worlds.robots import CAD_ROBOTS


@pytest.fixture
def scara(tmp_path):
    """A robot with a slide, a spring of its own and a reference that is not zero."""
    file = tmp_path / "scara.xml"
    file.write_text(SCARA)
    return own_robot(file)


ARM = CAD_ROBOTS["arm3"]()


def run(kind: type[Plant], robot, made, seconds: float = 0.5, armature: float = 0.05) -> dict:
    model = robot.model()
    model.dof_armature[:] = armature
    model.dof_damping[:] = model.dof_frictionloss[:] = 0.0
    plant = kind(robot, model, made)
    motion = make_motion(robot, "exciting", [3])
    start = motion(-0.2)[:2]

    def loop(k, t, q, v, base, target):
        return 0.2 * robot.peak * (target[0] - q) - 0.04 * robot.peak * v, q

    none = Noise.none(len(robot.joints))
    return plant.run(loop, motion, start, 500, seconds, none, np.random.default_rng(0), 0.2)


EFFECTS = {
    "nothing": lambda: [],
    "payload": lambda: [fx.Payload("body", "link3", {"mass": 1.5, "com": [0.2, 0.1, 0.0], "size": 0.1})],
    "tilt": lambda: [fx.GravityTilt("global", "global", {"tilt": [0.1, -0.05]})],
    "force": lambda: [fx.ConstantForce("body", "link2", {"force": [10.0, -5.0, 20.0]})],
    "delay and gain": lambda: [
        fx.TimeDelay("global", "global", {"delay": 0.011}),
        fx.TorqueGain("joint", "joint2", {"gain": 0.8}),
    ],
    "spring and offset": lambda: [
        fr.JointSpring("joint", "joint1", {"stiffness": 20.0, "rest_angle": 0.3}),
        fx.EncoderOffset("joint", "joint2", {"offset": 0.1}),
    ],
    "soft joint": lambda: [tm.JointElasticity("joint", "joint2", {"stiffness": 900.0})],
}  # fmt: skip


@pytest.mark.parametrize("name", EFFECTS)
def test_without_friction_both_engines_make_the_same_motion(name):
    logs = [run(kind, ARM, EFFECTS[name]()) for kind in (Plant, PinocchioPlant)]
    assert np.ptp(logs[0]["qpos"], axis=0).min() > 0.02
    tolerance = 2e-5 if name == "soft joint" else 2e-6
    np.testing.assert_allclose(logs[0]["qpos"], logs[1]["qpos"], atol=tolerance)
    np.testing.assert_allclose(logs[0]["tau"], logs[1]["tau"], atol=0.02)


def test_slides_references_and_springs_of_the_model_are_the_same(scara):
    logs = [run(kind, scara, []) for kind in (Plant, PinocchioPlant)]
    np.testing.assert_allclose(logs[0]["qpos"], logs[1]["qpos"], atol=2e-6)


def test_a_coupled_motor_is_the_same():
    def made(kind):
        ordinary = kind(
            joint_physics.Law(*(np.full(3, x) for x in (1e-9, 0.0, 0.01, 0.0, 0.0, 1.0))),
            np.full(3, 1e-3), np.full(3, 0.1), np.zeros(3),
        )  # fmt: skip
        coupling = joint_physics.JointCoupling("joint3", "joint2", 0.4)
        hidden = Hidden(ordinary.law, np.zeros(3), ordinary.armature, np.zeros(3), {}, coupling)
        ordinary.coupling = coupling
        return hidden.model(ARM), [ordinary, coupling]

    rows, start = [], (np.array([0.1, 0.4, -0.3]), np.zeros(3))
    for kind, law in ((Plant, joint_physics.Ordinary), (PinocchioPlant, Slips)):
        model, some = made(law)
        plant = kind(ARM, model, some)
        log = plant.run(
            lambda k, t, q, v, base, target: (np.array([5.0, -20.0, 6.0]), q), lambda t: start,
            start, 500, 0.2, Noise.none(3), np.random.default_rng(0), 0.0,
        )  # fmt: skip
        rows.append(log["qpos"])
    assert np.ptp(rows[0], axis=0).max() > 0.05
    np.testing.assert_allclose(*rows, atol=1e-5)


def test_slipping_springs_hold_below_their_level_and_slide_at_it():
    law = joint_physics.Law(*(np.array([x]) for x in (2.0, 0.0, 0.01, 0.0, 0.0, 1.0)))
    slips = Slips(law, np.array([1e-3]), np.array([0.1]), np.array([0.0]))
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body><joint name='a' axis='0 1 0'/><geom size='0.1' mass='1'/></body></worldbody></mujoco>"
    )
    slips.edit(model)
    slips.bind(model, ("a",))
    slips.reset(np.zeros(1), np.zeros(1))
    speed, torque = np.array([0.3]), []
    for _ in range(160):
        torque.append(float(slips._torque(np.zeros(1), speed)[0]))
        slips.evolve(1e-4)
        slips.commit()
    assert torque[0] == pytest.approx(0.0, abs=1e-9)
    assert np.all(np.diff(torque) >= -1e-9)
    assert torque[-1] == pytest.approx(2.0)
    # As stiff as the bristle, until the first spring slips.
    slips.reset(np.zeros(1), np.zeros(1))
    slips._torque(np.zeros(1), np.array([1e-5]))
    slips.evolve(1.0)
    assert float(slips._torque(np.zeros(1), np.zeros(1))[0]) == pytest.approx(
        2.0 * 1e-5 / 1e-3, rel=0.02
    )


def test_a_robot_with_friction_moves_nearly_alike_in_both_worlds():
    setting = dataclasses.replace(settings.draw_setting(5, 3), duration=1.0)
    hidden = as_bought.draw_hidden(setting, "", 0)
    logs = []
    for setting.engine in settings.ENGINES:
        logs.append(
            as_bought.simulate(setting, hidden, 0, settings.draw_noise(setting, hidden.scale), 0.3)
        )
    apart = np.abs(logs[0]["qpos"] - logs[1]["qpos"]).max()
    assert 1e-7 < apart < 3e-3
    assert (
        np.abs(logs[0]["friction"] - logs[1]["friction"]).max() < np.abs(logs[0]["friction"]).max()
    )


@pytest.fixture(scope="module")
def stood():
    """A quadruped with a load, 0.6 s."""
    rng = np.random.default_rng(4)
    robot = legs.quadruped(rng)
    real = standing._draw(robot, "payload", rng)
    motion = legs.sways(robot, rng)
    return robot, real, standing.simulate(robot, real, motion, 0.6, 500, 200)


def test_feet_bear_what_the_robot_and_its_load_weigh(stood):
    robot, real, rows = stood
    model = real.model(robot)
    weight = 9.81 * float(model.body_mass.sum())
    bodies = 9.81 * float(mujoco.MjModel.from_xml_string(robot.xml).body_mass.sum())
    assert weight - bodies == pytest.approx(9.81 * real.load[0], rel=0.3)
    # Over the sway; what is left is the vertical acceleration.
    assert rows["load"].sum(1).mean() == pytest.approx(weight, rel=0.12)
    assert np.linalg.norm(rows["base_linacc"].mean(0)) == pytest.approx(9.81, rel=0.12)
    assert np.all(rows["load"].mean(0) > 0.1 * weight)


def test_no_place_of_the_base_and_no_wrench_is_told(stood):
    robot, _, rows = stood
    setting = {"torque": False, "flags": False, "rate_hz": 200, "loop_hz": 500}
    log = standing.sensed(
        robot, rows, standing.Sensors(1e-4, 0.05), setting, np.random.default_rng(0)
    )
    assert set(log) == {
        "time", "joint_names", "qpos", "qpos_target", "kp", "kd", "base_quat", "base_angvel", "base_linacc",
        "imu_body", "imu_pos",
    }  # fmt: skip
    assert len(log["joint_names"]) == log["qpos"].shape[1] == 12


@pytest.mark.parametrize("kind", ["quadruped", "biped"])
def test_told_angles_put_the_feet_where_they_are_meant(kind):
    robot = legs.WALKERS[kind](np.random.default_rng(1))
    model = mujoco.MjModel.from_xml_string(robot.xml)
    data = mujoco.MjData(model)
    pose = np.array([0.01, -0.012, 0.015, 0.03, -0.02, 0.04])
    if robot.ankles:
        pose[3:] = 0.0
    places = []
    for p in (np.zeros(6), pose):
        data.qpos[7:] = robot.told(np.zeros((len(robot.legs), 3)), p)
        data.qpos[:3] = model.qpos0[:3] + p[:3]
        mujoco.mju_mat2Quat(data.qpos[3:7], legs.turned(p[3:]).ravel())
        mujoco.mj_forward(model, data)
        places.append(data.geom_xpos[1:].copy())
    np.testing.assert_allclose(*places, atol=1e-7)
    # On the ground: the balls touch it.
    assert np.allclose(places[0][:, 2], model.geom_size[1:, 0], atol=1e-4)


PAYLOAD = {
    "family": "payload", "location": {"kind": "body", "name": "trunk"}, "equivalent": [],
    "parameters": {"mass": {"value": 2.0, "unit": "kg"}}, "visibility": {"sigmas": 9.0},
}  # fmt: skip


def test_a_load_is_weighed_and_inventions_are_counted():
    truth = {"kind": "alone", "effects": [PAYLOAD]}
    found = json.loads(json.dumps(PAYLOAD))
    found["parameters"]["mass"]["value"] = 2.04
    row = imu_marks.marks(truth, {"verdict": "explained", "effects": [found]})
    assert (row["right"], row["invented"]) == (True, False)
    assert row["mass_error"] == pytest.approx(0.02)
    extra = {
        "family": "armature",
        "location": {"kind": "joint", "name": "a"},
        "parameters": {},
        "equivalent": [],
    }
    row = imu_marks.marks(truth, {"verdict": "explained", "effects": [found, extra]})
    assert row["invented"]
    bare = {"kind": "single", "effects": [PAYLOAD]}
    assert not imu_marks.marks(bare, {"verdict": "partly", "effects": [found, extra]})["invented"]
    assert imu_marks.marks(bare, None)["mass_error"] is None
