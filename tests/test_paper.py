"""The experiments' own pieces: plant, sensors, waveforms, report. The closed loops are `benchmarks/paper`."""

import json
from pathlib import Path

import mujoco
import numpy as np
import pytest

ROOT = Path(__file__).parents[1]

from benchmarks.paper import curl, elbow, pelvis, report  # noqa: E402
from benchmarks.paper.brain import carrying_rows  # noqa: E402
from benchmarks.paper.hardware import NOTHING, Effects, hardware  # noqa: E402
from benchmarks.paper.loop import Run, summary  # noqa: E402
from benchmarks.paper.plant import PER_TICK, STEP, Fleet, LinkMass, Sensors, model  # noqa: E402
from benchmarks.paper.shared_out import merged  # noqa: E402
from jax_inertia import load_model  # noqa: E402
from jax_inertia.model.load import body_pi  # noqa: E402

SILENT = Sensors(
    joint_position=0.0,
    joint_velocity=0.0,
    base_position=0.0,
    base_orientation=0.0,
    base_velocity=0.0,
    base_rate=0.0,
    torque=0.0,
    corner_force=0.0,
)


@pytest.fixture(scope="module")
def plant() -> mujoco.MjModel:
    return model()


def test_waveforms_are_the_papers_table():
    assert elbow.waveform(0.25) == pytest.approx(7.5)
    assert elbow.waveform(0.75) == pytest.approx(1.5)
    assert [float(elbow.waveform(t)) for t in (8.1, 8.6)] == [7.5, 1.5]
    assert [pelvis.waveform(t) for t in (0.1, 2.6, 5.1)] == [35.0, 25.0, 35.0]


def test_bodies_answer_for_the_error_of_the_joints_that_carry_them(plant):
    robot = load_model(plant)
    arm = tuple("elbow" in name or "shoulder" in name for name in robot.joint_names[1:])

    def rows(body: str) -> list[str | int]:
        own = np.flatnonzero(carrying_rows(robot, arm, (robot.body_index(body),)))
        return [robot.joint_names[i - 5] if i > 5 else int(i) for i in own]

    assert rows("torso_link") == [2]  # the pelvis's height
    left = rows("left_elbow_pitch_link")
    assert "left_elbow_y" in left
    assert all(str(name).startswith("left_") for name in left)


def test_runs_shared_out_are_one_again():
    def part(seed: int, mode: int) -> Run:
        one = np.array([seed])
        series = {"error": np.full((3, 1), 10.0 * mode + seed)}
        return Run(np.arange(3.0), np.array([mode]), one, series, 1.0 * one, one, one, 1.0, [])

    found = merged([part(seed, mode) for mode in (0, 1) for seed in (4, 5)])
    assert found.seed.tolist() == [4, 5, 4, 5]
    assert found.mode.tolist() == [0, 0, 1, 1]
    assert found.series["error"][:, found.mode == 1].tolist() == [[14.0, 15.0]] * 3


def test_plant_steps_as_mujoco_does(plant):
    """Nothing is lost between ticks: the fleet's robot is MuJoCo's own."""
    fleet = Fleet(plant, np.array([0, 1]), SILENT)
    data = mujoco.MjData(plant)
    mujoco.mj_resetDataKeyframe(plant, data, 0)
    torque = np.random.default_rng(0).normal(size=(2, 23))
    for _ in range(20):
        fleet.step(torque)
        data.ctrl[:] = torque[1]
        for _ in range(PER_TICK):
            mujoco.mj_step(plant, data)
    np.testing.assert_allclose(fleet.q[1], data.qpos, atol=1e-7)
    np.testing.assert_allclose(fleet.v[1], data.qvel, atol=1e-5)


def test_windows_obey_the_equation_of_motion_of_all_bodies(plant):
    """m v̇ of the centre of mass = contact forces + weight, each averaged over the same window."""
    fleet = Fleet(plant, np.array([0]), SILENT)
    data = mujoco.MjData(plant)

    def momentum() -> np.ndarray:
        data.qpos[:], data.qvel[:] = fleet.q[0], fleet.v[0]
        mujoco.mj_forward(plant, data)
        mujoco.mj_subtreeVel(plant, data)
        return plant.body_subtreemass[1] * data.subtree_linvel[1].copy()

    for _ in range(30):  # falling on its knees: large, changing forces
        fleet.step(np.zeros((1, 23)))
    before = momentum()
    for _ in range(fleet.sensors.window // PER_TICK):
        fleet.step(np.zeros((1, 23)))
    rate = (momentum() - before) / (fleet.sensors.window * STEP)
    force = fleet.sense().force[0].sum(axis=0) + plant.body_subtreemass[1] * plant.opt.gravity
    np.testing.assert_allclose(rate, force, atol=2.0)


def test_noise_is_that_of_the_seed_and_of_the_stated_size(plant):
    sensors = Sensors()
    fleet = Fleet(plant, np.array([3, 4, 3]), sensors)
    errors = []
    for _ in range(40):
        fleet.step(np.zeros((3, 23)))
        errors.append(fleet.sense().v - fleet.v)
    errors = np.array(errors)
    np.testing.assert_array_equal(errors[:, 0], errors[:, 2])
    assert not np.allclose(errors[:, 0], errors[:, 1])
    np.testing.assert_allclose(errors[..., 6:].std(), sensors.joint_velocity, rtol=0.1)
    np.testing.assert_allclose(errors[..., :3].std(), sensors.base_velocity, rtol=0.2)
    np.testing.assert_allclose(np.linalg.norm(fleet.sense().q[:, 3:7], axis=1), 1.0)


def test_a_fitted_window_gives_the_slope_of_the_fitted_line_and_its_noise(plant):
    """Against NumPy's line through the window's samples, and σ² 12 / w (w + 1) (w + 2) h² of its slope."""
    sensors = Sensors(window=12, fitted=True)
    fleet = Fleet(plant, np.array([0]), sensors)
    for _ in range(6):
        fleet.step(np.zeros((1, 23)))
    slopes = np.polyfit(STEP * np.arange(13), fleet.v_window[0], 1)[0]
    np.testing.assert_allclose(fleet.sense().a[0], slopes, rtol=1e-9)
    expected = sensors.velocity() * np.sqrt(12.0 / (12 * 13 * 14)) / STEP
    np.testing.assert_allclose(sensors.acceleration(), expected)
    ends = Sensors(window=12)
    np.testing.assert_allclose(ends.acceleration(), np.sqrt(2.0) * sensors.velocity() / (12 * STEP))
    assert ends.averaged() == pytest.approx(12**-0.5)


def test_link_mass_keeps_mujocos_sums_true():
    plant = model()
    link = LinkMass(plant, "torso_link")
    pi = body_pi(plant, link.id)
    link.set(30.0)
    np.testing.assert_allclose(body_pi(plant, link.id), pi * 30.0 / link.nominal)
    expected = plant.body_subtreemass.copy()
    mujoco.mj_setConst(plant, mujoco.MjData(plant))
    np.testing.assert_allclose(expected, plant.body_subtreemass)


def test_dumbbell_joins_the_forearm_by_the_parallel_axis_theorem():
    plant = hardware(NOTHING)
    forearm, dumbbell = (plant.body(n).id for n in (curl.FOREARM, curl.DUMBBELL))
    joined = curl.with_dumbbell(body_pi(plant, forearm), body_pi(plant, dumbbell))
    m, c = body_pi(plant, dumbbell)[0], np.array(curl.GRIP)
    parts = body_pi(plant, forearm)
    assert joined[0] == pytest.approx(parts[0] + m)
    np.testing.assert_allclose(joined[1:4], parts[1:4] + m * c)
    inertia = parts[4] + body_pi(plant, dumbbell)[4] + m * (c[1] ** 2 + c[2] ** 2)
    assert joined[4] == pytest.approx(inertia)
    assert joined[5] == pytest.approx(parts[5] - m * c[0] * c[1])


def test_hoist_pulls_as_stated_and_nothing_else_is_added():
    bare, hung = hardware(NOTHING), hardware(Effects(0.0, 0.0, 0.0, 0.0, 40.0))
    force = []
    for plant in (bare, hung):
        data = mujoco.MjData(plant)
        mujoco.mj_resetDataKeyframe(plant, data, 0)
        mujoco.mj_forward(plant, data)
        force.append(data.qfrc_passive[2])
    assert force[0] == pytest.approx(0.0)
    assert force[1] == pytest.approx(40.0, rel=1e-3)


def test_summary_is_the_median_and_nine_in_ten():
    found = summary(np.arange(101.0))
    assert (found["low"], found["median"], found["high"]) == (5.0, 50.0, 95.0)


def test_ripple_in_step_with_the_curl_leaves_noise_out():
    time = np.arange(0.0, 9.0, 0.003)
    noise = np.random.default_rng(0).normal(size=(len(time), 1))
    wave = 0.3 * np.sin(2 * np.pi * curl.FREQUENCY * time + 1.0)[:, None]
    assert curl.in_step(time, 6.0 + wave) == pytest.approx(0.3, abs=0.01)
    assert curl.in_step(time, 6.0 + wave + noise) == pytest.approx(0.3, abs=0.1)
    assert curl.in_step(time, 6.0 + noise) < 0.1


def test_sensed_values_are_not_overwritten_by_later_ticks(plant):
    fleet = Fleet(plant, np.array([0]), Sensors(sampled_forces=True))
    sensed = fleet.sense()
    kept = [np.array(x) for x in vars(sensed).values()]
    for _ in range(3):
        fleet.step(np.zeros((1, 23)))
    for before, after in zip(kept, vars(sensed).values(), strict=True):
        np.testing.assert_array_equal(before, after)


def test_report_writes_what_the_last_run_found():
    path = ROOT / "benchmarks" / "results" / "paper.json"
    if not path.exists():
        pytest.skip("no results of the paper's experiments here")
    found = json.loads(path.read_text())
    page = report.report(found)
    assert page.count("## ") >= len(found) - 1
    for name in ("pelvis", "elbow"):
        assert {"none", "adaptive", "oracle"} <= found[name].keys()
    assert {"kf", "ekf"} <= found["unphysical"].keys()
