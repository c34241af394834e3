"""Floating bases that log an IMU instead of where they are: base motion, against MuJoCo C, and what becomes of it."""

from __future__ import annotations

import dataclasses
import functools
from pathlib import Path

import mujoco
import numpy as np
import pytest
from log_files import START, Maker, joint_messages, write_bag
from walking_log import Quadruped, shifts, trot, walked

import jax_inertia as ji
from jax_inertia.cli.main import main
from jax_inertia.diagnosis.result import Verdict
from jax_inertia.dynamics.rigid_body import resolve_bodies
from jax_inertia.logs.log import Log, LogError
from jax_inertia.logs.readers import Options
from jax_inertia.logs.schema import SHAPES
from jax_inertia.maths.precision import in_double_precision
from jax_inertia.preflight.preflight import Severity, preflight
from jax_inertia.signals.bands import DIAGNOSIS_IN_CONTACT, Bands
from jax_inertia.signals.base_motion import with_base
from jax_inertia.signals.filtering import low_pass, mask, resample
from jax_inertia.signals.ground.sinking import sunk
from jax_inertia.signals.held import with_loop_torque
from jax_inertia.signals.torque_residual import needed_torques, observed, prepare

CASES = Path(__file__).parents[2] / "shared" / "cases" / "position_controlled"
SMALL = Quadruped()
LARGE = Quadruped(
    trunk=11.0, thigh=0.26, shank=0.27, hip_x=0.24, hip_y=0.07, aside=0.1, leg=(1.1, 1.6, 0.4),
    foot=0.026, kp=120.0, kd=3.0, dry=0.3, soft=0.012, imu=(0.05, 0.0, -0.02),
)  # fmt: skip


@functools.cache
def model_of(robot: Quadruped):
    return ji.load_model(mujoco.MjModel.from_xml_string(robot.xml))


def log_of(arrays: dict, *left_out: str, **changes) -> Log:
    """A log of what the sensors wrote, without some of it."""
    fields = {k: x for k, x in arrays.items() if k in SHAPES and k not in left_out}
    fields |= {"joint_names": tuple(arrays["joint_names"]), "tau_kind": "current"}
    if not {"contact_force", "contact_flag"} <= set(left_out):
        fields["contact_bodies"] = tuple(arrays["contact_bodies"])
    return Log(**(fields | changes))


FEET = ("contact_force", "contact_flag")


@functools.cache
def stood() -> dict:
    return walked(SMALL, shifts, seconds=2.0, seed=3) | {"imu_pos": np.array(SMALL.imu)}


def flown(imu_body: str = "trunk") -> tuple[Log, np.ndarray]:
    """A quadruped that tumbles slowly through the air, all by itself, and MuJoCo's forces for that motion."""
    model = mujoco.MjModel.from_xml_string(SMALL.xml.replace('contype="1"', 'contype="0"'))
    data = mujoco.MjData(model)
    model.dof_frictionloss[:] = 0.0
    rate, seconds = 500.0, 2.0
    time = np.arange(int(rate * seconds)) / rate
    rng = np.random.default_rng(0)
    size, phase, pace = (rng.uniform(a, b, model.nv) for a, b in ((0.1, 0.3), (0, 6), (2, 5)))

    def at(t: float) -> np.ndarray:
        x = size * np.sin(pace * t + phase)
        turn, norm = x[3:6], np.linalg.norm(x[3:6])
        quat = np.array([np.cos(norm), *(np.sin(norm) * turn / norm)])
        return np.concatenate([x[:3] + np.array([7.0 * t, -3.0, 5.0]), quat, x[6:]])

    def velocity(t: float) -> np.ndarray:
        out, h = np.zeros(model.nv), 1e-5
        mujoco.mj_differentiatePos(model, out, 2 * h, at(t - h), at(t + h))
        return out

    rows: dict[str, list] = {}
    body = data.body(imu_body)
    for t in time:
        data.qpos[:], data.qvel[:] = at(t), velocity(t)
        data.qacc[:] = (velocity(t + 1e-4) - velocity(t - 1e-4)) / 2e-4
        mujoco.mj_inverse(model, data)
        spatial = np.zeros(6)
        mujoco.mj_objectAcceleration(
            model, data, mujoco.mjtObj.mjOBJ_XBODY, body.id, spatial, flg_local=1
        )
        for name, value in {
            "qpos": data.qpos[7:],
            "base_quat": data.qpos[3:7],
            "base_angvel": data.qvel[3:6],
            "tau": data.qfrc_inverse[6:],
            # MuJoCo's accelerations hold the reaction to gravity, as an accelerometer does.
            "base_linacc": spatial[3:],
            "force": data.qfrc_inverse,
        }.items():
            rows.setdefault(name, []).append(np.copy(value))
    out = {name: np.array(x) for name, x in rows.items()}
    force = out.pop("force")
    names = tuple(model.joint(j).name for j in range(1, model.njnt))
    return Log(time=time, joint_names=names, imu_body=imu_body, **out), force


@pytest.mark.slow
@pytest.mark.parametrize("imu_body", ["trunk", "FL_shank"])
def test_an_imu_stands_for_position_and_velocity_of_the_base(imu_body):
    """All rows of the inverse dynamics, though the robot flies past at 7 m/s."""
    log, force = flown(imu_body)
    robot = model_of(SMALL)
    bands = Bands(grid=500.0, before=100.0, cutoff=50.0, rows=100.0, margin=0.2)
    robot = dataclasses.replace(robot, frictionloss=0.0 * robot.frictionloss)
    found = in_double_precision(
        lambda: (o := observed(log, robot, bands), needed_torques(robot, o))
    )()
    time = np.asarray(found[0].motion.time)
    wanted = np.stack([np.interp(time, log.time, x) for x in force.T], axis=1)
    inner = (time > 0.3) & (time < 1.7)
    error = np.abs(found[1] - wanted)[inner].max(axis=0)
    size = np.abs(wanted)[inner].max(axis=0)
    assert np.all(error < 2e-3 * np.maximum(size, 0.05 * size.max()))


@pytest.mark.parametrize("left_out", [("base_linacc",), ()])
@pytest.mark.parametrize("told", [(), FEET])
def test_the_base_moves_as_it_did(left_out, told):
    arrays = stood()
    bands = DIAGNOSIS_IN_CONTACT.at(500.0)
    log = log_of(arrays, *left_out, *told)
    source = low_pass(resample(mask(log), bands.grid), bands.before)
    found = in_double_precision(with_base)(source, model_of(SMALL)).log
    true = np.stack(
        [np.interp(found.time, arrays["time"], x) for x in arrays["true_linvel"].T], axis=1
    )
    inner = slice(25, -25)
    error = (found.base_linvel - true)[inner]
    # The accelerometer is off by 0.1 m/s² on each axis: alone it would be off by 0.2 m/s in the end.
    limit = 0.15 if not left_out else 0.01
    assert np.sqrt(np.mean(error**2)) < 0.5 * limit
    slow = np.polyfit(found.time[inner], error, 1)[0]
    assert np.all(np.abs(slow) < 0.03)
    height = np.interp(found.time, arrays["time"], arrays["true_pos"][:, 2])
    assert np.abs(found.base_pos[:, 2] - height)[inner].max() < 0.01


def test_nothing_tells_how_a_base_moves_that_flies_without_accelerometer():
    log, _ = flown()
    log = dataclasses.replace(log, base_linacc=None, tau=0.0 * np.asarray(log.tau))
    bare = mujoco.MjModel.from_xml_string(SMALL.xml.replace('contype="1"', 'contype="0"'))
    bare.geom_contype[:], bare.geom_conaffinity[:] = 0, 0
    with pytest.raises(LogError, match="neither base_pos nor base_linacc"):
        in_double_precision(observed)(log, ji.load_model(bare), DIAGNOSIS_IN_CONTACT.at(500.0))


def test_errors_of_the_feet_are_in_the_noise():
    """Draws differ by what the feet contradict each other, and more where the model lets them pivot."""
    log, robot = log_of(stood(), "base_linacc", *FEET), model_of(SMALL)
    pivots = mujoco.MjModel.from_xml_string(
        SMALL.xml.replace('friction="0.8 0.02 0.001"', 'friction="0.8 0.02 0.01"').replace(
            'condim="3"', 'condim="6"'
        )
    )

    def spread(robot):
        own, drawn = (prepare(robot, log, rng=r) for r in (None, np.random.default_rng(0)))
        return np.std(drawn.missing - own.missing, axis=0), own.measured[:, :6].mean(axis=0)

    still, turning = (in_double_precision(spread)(r) for r in (robot, ji.load_model(pivots)))
    assert np.all(still[0][:3] > 0)
    assert np.all(still[0][:3] < 20.0)
    assert np.all(still[0][3:5] < 0.1)
    # 0.01 m times a weight of 127 N on four feet, by chance.
    assert np.all((turning[0][3:5] > 0.2) & (turning[0][3:5] < 1.0))
    # What turns a robot on the spot that can pivot on its feet is not known.
    np.testing.assert_array_equal(still[1] > 0, True)
    np.testing.assert_array_equal(turning[1] > 0, [True] * 5 + [False])


@pytest.mark.parametrize("kind", ["npz", "csv", "parquet"])
def test_files_hold_an_imu_and_feet(tmp_path, kind):
    if kind == "parquet":
        pytest.importorskip("pyarrow")
    log = log_of(stood(), imu_body="trunk")
    path = tmp_path / f"log.{kind}"
    ji.write_log(log, path)
    again = ji.read_log(path)
    assert again.imu_body == "trunk"
    assert again.contact_bodies == log.contact_bodies
    for name in ("base_linacc", "base_angvel", "imu_pos", "contact_force", "contact_flag"):
        np.testing.assert_array_equal(getattr(again, name), getattr(log, name))
    assert not again.notes


def test_a_csv_may_give_accelerations_in_g(tmp_path):
    log = log_of(stood(), *FEET).between(0.0, 0.1)
    path = tmp_path / "log.csv"
    ji.write_log(log, path)
    text = path.read_text()
    path.write_text(text.replace("base_linacc.x", "base_linacc.x [g]"))
    again = ji.read_log(path)
    np.testing.assert_allclose(again.base_linacc[:, 0], 9.80665 * log.base_linacc[:, 0])
    path.write_text(text.replace("base_linacc.x", "base_linacc.x [ft]"))
    with pytest.raises(LogError, match=r"base_linacc\.x is in 'ft'; a unit here is one of m/s²"):
        ji.read_log(path)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"contact_bodies": np.zeros(0)}, "contact_force comes without contact_bodies"),
        ({"base_linacc": np.zeros((1000, 4))}, r"base_linacc has shape \(1000, 4\)"),
        ({"imu_pos": np.zeros(2)}, r"imu_pos has shape \(2,\); expected \(3\) = \(3,\)"),
        ({"contact_flag": np.zeros((1000, 3))}, r"contact_flag has shape \(1000, 3\)"),
        ({"imu_body": np.array(["a", "b"])}, r"imu_body has shape \(2,\); expected one text"),
    ],
)
def test_shapes_that_do_not_fit_are_said(tmp_path, changes, said):
    path = tmp_path / "log.npz"
    ji.write_log(log_of(stood()), path)
    with np.load(path) as file:
        arrays = dict(file) | changes
    np.savez(path, **{k: x for k, x in arrays.items() if np.shape(x) != (0,)})
    with pytest.raises(LogError, match=said):
        ji.read_log(path)


def test_a_place_that_is_no_number_is_refused(tmp_path):
    path = tmp_path / "log.npz"
    ji.write_log(log_of(stood(), imu_pos=np.array([0.0, np.nan, 0.0])), path)
    with pytest.raises(LogError, match=r"imu_pos is \[ 0. nan 0.\]; expected where the IMU is"):
        ji.read_log(path)


def test_a_bag_s_imu(tmp_path):
    """At 100 Hz and 3 ms off, without an orientation, which a covariance of -1 says."""
    pytest.importorskip("rosbags")
    maker, messages = Maker(), joint_messages()
    make, vector = maker.types["sensor_msgs/msg/Imu"], maker.vector
    none, lacking = np.zeros(9), np.array([-1.0] + [0.0] * 8)
    turn = maker.types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    for k in range(64):
        stamp = START + round((k * 0.01 - 0.003) * 1e9)
        header = maker.header(stamp, "imu_link")
        for topic, said in (("/imu", none), ("/raw", lacking)):
            one = make(header, turn, said, vector((0, 0, k)), none, vector((k, 0, 9.81)), none)
            messages.append((topic, one, stamp))
    path = write_bag(tmp_path / "log", messages, "mcap")
    log = ji.read_log(path, options=Options(topic_imu="/imu"))
    k = np.asarray(log.time) / 0.01 + 0.3
    np.testing.assert_allclose(log.base_linacc[:, 0], k, atol=1e-6)
    np.testing.assert_allclose(log.base_angvel[:, 2], k, atol=1e-6)
    np.testing.assert_allclose(log.base_quat, np.tile([1.0, 0, 0, 0], (len(k), 1)))
    assert any("the IMU (imu_link) is taken to lie along the base's axes" in n for n in log.notes)
    assert ji.read_log(path, options=Options(topic_imu="/raw")).base_quat is None
    with pytest.raises(
        LogError, match=r"no sensor_msgs/msg/Imu on topic '/imuu'; did you mean '/imu'"
    ):
        ji.read_log(path, options=Options(topic_imu="/imuu"))


def told(log: Log, check: str) -> tuple[Severity, str]:
    (found,) = [f for f in preflight(log, model_of(SMALL)).findings if f.check == check]
    assert "\n" not in found.message
    return found.severity, found.message


def test_a_sound_log_of_an_imu_is_only_noted():
    for left_out in ((), ("base_linacc",)):
        found = preflight(log_of(stood(), *left_out), model_of(SMALL)).findings
        assert [f.check for f in found if f.severity is Severity.ERROR] == []
        assert told(log_of(stood(), *left_out), "base")[0] is Severity.NOTE


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda f, g: -f, "is minus the specific force"),
        (lambda f, g: f / 9.80665, "is in g"),
        (lambda f, g: f - g, "has gravity taken out"),
    ],
)
def test_what_an_accelerometer_may_mean_else(change, said):
    arrays = stood()
    log = log_of(arrays)
    own = np.asarray(log.base_linacc)
    changed = dataclasses.replace(log, base_linacc=change(own, np.array([0.0, 0.0, 9.81])))
    severity, message = told(changed, "accelerometer")
    assert severity is Severity.ERROR
    assert said in message


def test_what_is_missing_or_not_used_is_said():
    arrays = stood()
    log = log_of(arrays)
    severity, message = told(dataclasses.replace(log, base_quat=None), "base")
    assert severity is Severity.ERROR
    assert "lacks base_quat" in message
    assert "--fix-base" in message
    severity, message = told(dataclasses.replace(log, imu_body="trnuk"), "imu_body")
    assert severity is Severity.ERROR
    assert "did you mean 'trunk'?" in message
    placed = dataclasses.replace(log, base_pos=arrays["true_pos"])
    assert told(placed, "unused") == (
        Severity.NOTE,
        "read and not used, since the log holds better data: base_linacc, contact_force, contact_flag",
    )


def test_a_loop_s_torque_stands_for_one_that_is_not_logged():
    arrays = stood()
    log = log_of(arrays, "tau", *FEET, kp=np.full(12, SMALL.kp), kd=np.full(12, SMALL.kd))
    found = with_loop_torque(log, log.kp, log.kd)
    error = np.asarray(found.tau) - arrays["tau"]
    # Encoder steps of 0.2 mrad, differenced at 500 Hz, times kd.
    assert np.sqrt(np.mean(error**2)) < 0.25
    assert "with kp 70 N m/rad and kd 2 N m s/rad of the log" in found.notes[-1]
    limited = with_loop_torque(log, log.kp, log.kd, limit=3.0)
    assert np.abs(limited.tau).max() == 3.0
    with pytest.raises(LogError, match=r"without its gain \(kp\); log it, or give --kp"):
        with_loop_torque(log, None)
    with pytest.raises(LogError, match="without its position targets"):
        with_loop_torque(dataclasses.replace(found, qpos_target=None), log.kp)


def test_a_robot_that_hangs_needs_no_imu(tmp_path, capsys):
    """--fix-base: channels of a base that does not move are said to be of no use."""
    model, log = tmp_path / "robot.xml", tmp_path / "log.npz"
    model.write_text(SMALL.xml)
    ji.write_log(log_of(stood(), "tau", *FEET), log)
    out = ["--out", str(tmp_path / "out")]
    assert main(["replay", str(log), "--model", str(model), "--fix-base", *out]) == 0
    said = " ".join(capsys.readouterr().err.split())
    assert "base_quat, base_angvel, base_linacc but the model's base is fixed: not used" in said


# --- whole runs --------------------------------------------------------------------------------------------------


def added(robot: Quadruped, log: Log) -> float:
    """kg on the trunk beyond the model's."""
    found = ji.estimate(model_of(robot), log, ["trunk"])
    (index,) = resolve_bodies(found.robot, ["trunk"])
    return float(found.pi["trunk"][0] - model_of(robot).pi[index, 0])


@pytest.mark.slow
def test_estimate_weighs_a_trunk_by_its_imu():
    place = {"load": 1.0, "at": (0.1, 0.05, 0.06)}
    arrays = walked(SMALL, shifts, seed=5, **place) | {"imu_pos": np.array(SMALL.imu)}
    for left_out in ((), ("base_linacc",), FEET):
        assert added(SMALL, log_of(arrays, *left_out)) == pytest.approx(1.0, rel=0.05)
    gains = {"kp": np.full(12, SMALL.kp), "kd": np.full(12, SMALL.kd)}
    assert added(SMALL, log_of(arrays, "tau", **gains)) == pytest.approx(1.0, rel=0.05)
    with pytest.raises(LogError, match=r"the legs that stand give the forces .* FL_shank"):
        ji.estimate(model_of(SMALL), log_of(arrays), ["FL_shank"])


def payload(found, robot, load: float) -> None:
    """The only effect is this load on the trunk."""
    assert [(f.family, f.place.name) for f in found.odd] == [("payload", "trunk")]
    assert found.odd[0].parameters["mass"].value == pytest.approx(load, rel=0.06)


@pytest.mark.slow
@pytest.mark.skipif(not CASES.is_dir(), reason="cases (../shared/cases) are not here")
def test_the_load_of_a_quadruped_that_logs_attitude_and_gyro_alone():
    case = CASES / "trot_payload_c"
    robot = ji.load_model(case / "nominal.xml")
    payload(ji.diagnose(robot, ji.read_log(case / "log.npz", names=robot)), robot, 2.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("robot", "gait", "load", "at"),
    [
        (SMALL, shifts, 1.0, (0.1, 0.05, 0.06)),
        (
            LARGE,
            functools.partial(trot, period=0.7, lift=0.07, stride=0.1),
            1.0,
            (-0.12, 0.06, 0.07),
        ),
        (SMALL, shifts, 0.0, (0.0, 0.0, 0.0)),
    ],
    ids=["stands", "trots", "sound"],
)
def test_loads_by_an_imu(robot, gait, load, at):
    arrays = walked(robot, gait, load=load, at=at, seed=7) | {"imu_pos": np.array(robot.imu)}
    found = ji.diagnose(model_of(robot), log_of(arrays, *FEET, "qpos_target"))
    if load:
        assert found.verdict in (Verdict.EXPLAINED, Verdict.PARTLY)
        payload(found, robot, load)
    else:
        assert found.verdict is Verdict.NO_GAP


@pytest.mark.slow
def test_loads_by_an_imu_without_torque():
    arrays = walked(SMALL, shifts, load=1.0, at=(0.1, 0.05, 0.06), seed=7)
    arrays |= {"imu_pos": np.array(SMALL.imu)}
    gains = {"kp": np.full(12, SMALL.kp), "kd": np.full(12, SMALL.kd)}
    found = ji.diagnose(model_of(SMALL), log_of(arrays, "tau", **gains))
    payload(found, SMALL, 1.0)
    assert any("computed from the position loop" in note for note in found.notes)


def test_a_soft_foot_sinks_as_in_mujoco():
    """The depth of a ball of 2 kg that a changing force presses into a floor, by that force alone."""
    model = mujoco.MjModel.from_xml_string("""<mujoco><option timestep="0.0005"/><worldbody>
      <geom type="plane" size="1 1 1"/><body name="ball" pos="0 0 0.015"><freejoint/>
      <inertial pos="0 0 0" mass="2" diaginertia="0.01 0.01 0.01"/>
      <geom type="sphere" size="0.023" margin="0.001" priority="1" solimp="0.015 1 0.023"/></body>
      </worldbody></mujoco>""")
    data, forces, depths = mujoco.MjData(model), [], []
    for k in range(4000):
        t = k * model.opt.timestep
        data.xfrc_applied[1, 2] = -30.0 - 25.0 * np.sin(2 * np.pi * 3.0 * t)
        mujoco.mj_step(model, data)
        if k % 8 == 7:
            mujoco.mj_forward(model, data)
            wrench = np.zeros(6)
            mujoco.mj_contactForce(model, data, 0, wrench)
            forces.append([wrench[0]])
            depths.append(0.023 - data.qpos[2])
    soft = np.asarray(ji.load_model(model).surface.soft)
    depth, speed = in_double_precision(sunk)(soft, np.array(forces), 250.0)
    late = slice(100, None)
    assert np.ptp(depths[late]) > 2e-3
    assert np.abs(depth[late, 0] - depths[late]).max() < 2e-4
    rate = np.gradient(depths, 0.004)
    assert np.std(speed[late, 0] - rate[late]) < 0.15 * np.std(rate[late])
