"""Preflight: a sound log gives no finding, and each fault its own."""

import dataclasses
from pathlib import Path
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import jax_inertia as ji
from jax_inertia.logs.log import Log, LogError, TorqueUnit
from jax_inertia.logs.log_files import read_log
from jax_inertia.preflight.preflight import Severity, preflight
from jax_inertia.signals.filtering import mask

SHARED = Path(__file__).parents[2] / "shared" / "data"
ERROR, WARNING, NOTE = Severity
RATE = 200.0
ARM = SimpleNamespace(
    joint_names=("shoulder", "elbow", "wrist"),
    joint_type=("hinge", "hinge", "hinge"),
    body_names=("upper", "lower", "hand"),
)
WALKER = SimpleNamespace(
    joint_names=("root", *ARM.joint_names),
    joint_type=("free", *ARM.joint_type),
    body_names=("trunk", *ARM.body_names),
)


def arm_log(samples=2000, **changes) -> Log:
    """A noisy, coarse but sound arm: three joints of incommensurate motions, torques with noise."""
    rng = np.random.default_rng(0)
    time = np.arange(samples) / RATE
    rates = 2 * np.pi * np.array([0.31, 0.53, 0.87])
    phase = time[:, None] * rates + np.arange(3)
    qpos = np.sin(phase)
    tau = 5 * np.cos(phase) - 3 * np.sin(2.3 * phase)
    fields = {
        "time": time,
        "joint_names": ARM.joint_names,
        "qpos": np.round(qpos / 1e-4) * 1e-4,
        "qvel": rates * np.cos(phase) + 0.02 * rng.normal(size=qpos.shape),
        "tau": np.round((tau + 0.1 * rng.normal(size=tau.shape)) / 0.01) * 0.01,
    }
    return Log(**(fields | changes))


def changed(array: str, rows, column, value, log: Log | None = None) -> Log:
    log = arm_log() if log is None else log
    x = np.array(getattr(log, array))
    x[rows, column] = value
    return dataclasses.replace(log, **{array: x})


def rotation(time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A base that yaws, pitches and rolls: quaternions wxyz, body rates, rotation matrices."""
    yaw, pitch, roll = 0.8 * np.sin(time), 0.4 * np.sin(2.1 * time), 0.3 * np.cos(1.7 * time)

    def about(axis, angle):
        return np.hstack([np.cos(angle / 2)[:, None], np.sin(angle / 2)[:, None] * np.eye(3)[axis]])

    def times(p, r):
        w = p[:, :1] * r[:, :1] - np.sum(p[:, 1:] * r[:, 1:], axis=1, keepdims=True)
        return np.hstack(
            [w, p[:, :1] * r[:, 1:] + r[:, :1] * p[:, 1:] + np.cross(p[:, 1:], r[:, 1:])]
        )

    quat = times(times(about(2, yaw), about(1, pitch)), about(0, roll))
    conjugate = quat * np.array([1, -1, -1, -1])
    rates = 2 * times(conjugate, np.gradient(quat, time, axis=0, edge_order=2))[:, 1:]
    w, u = quat[:, :1], quat[:, 1:]
    turn = np.stack([e + 2 * np.cross(u, np.cross(u, e) + w * e) for e in np.eye(3)], axis=-1)
    return quat, rates, turn


def walker_log(**changes) -> tuple[Log, np.ndarray]:
    log = arm_log()
    quat, rates, turn = rotation(log.time)
    pos = np.stack([0.5 * np.sin(log.time), 0.3 * np.cos(1.3 * log.time), 0 * log.time], axis=1)
    fields = {
        "base_pos": pos,
        "base_quat": quat,
        "base_linvel": np.gradient(pos, log.time, axis=0),
        "base_angvel": rates,
        "contact_wrench": np.random.default_rng(1).normal(size=(len(log.time), 1, 6)),
        "contact_bodies": ("hand",),
    }
    return dataclasses.replace(log, **(fields | changes)), turn


def found(log: Log, robot=ARM, fixed=()) -> list[tuple[Severity, str]]:
    return [(f.severity, f.check) for f in preflight(log, robot, fixed).findings]


def message(log: Log, check: str, robot=ARM) -> str:
    (finding,) = [f for f in preflight(log, robot).findings if f.check == check]
    assert "\n" not in finding.message
    return finding.message


def test_a_sound_log_gives_no_finding():
    assert found(arm_log()) == []
    assert found(arm_log(qvel=None)) == []
    assert str(preflight(arm_log(), ARM)) == "nothing found"
    log, _ = walker_log()
    assert found(log, WALKER) == []


def test_findings_come_gravest_first_and_errors_can_be_raised():
    log = changed("qpos", slice(5, 7), 0, np.nan)
    log = dataclasses.replace(log, qvel=-np.asarray(log.qvel), notes=("a note",))
    flight = preflight(log, ARM)
    severities = [f.severity for f in flight.findings]
    assert severities == [ERROR, ERROR, ERROR, WARNING, NOTE]
    assert not flight.ok
    assert [f.check for f in flight.of(NOTE)] == ["reader"]
    with pytest.raises(LogError, match=r"minus dqpos/dt.*\(and 2 more errors\)"):
        flight.raise_for_errors()
    assert preflight(arm_log(), ARM).ok
    preflight(arm_log(), ARM).raise_for_errors()


# Names and units


def test_wrong_names_come_with_the_near_miss():
    log = arm_log(joint_names=("shoulder", "elbwo", "wrist"))
    assert found(log) == [(ERROR, "joint_name"), (ERROR, "joint_missing")]
    assert "no hinge or slide 'elbwo'; did you mean 'elbow'?" in message(log, "joint_name")
    assert "lacks joints of the model: elbow" in message(log, "joint_missing")


def test_missing_joints_are_fine_where_they_were_fixed():
    log = arm_log().select(["shoulder", "wrist"])
    assert found(log) == [(ERROR, "joint_missing")]
    assert found(log, fixed=["elbow"]) == []


def test_the_base_must_be_there_where_the_model_floats():
    log, _ = walker_log()
    assert found(arm_log(), WALKER) == [(ERROR, "base")]
    assert found(arm_log(), WALKER, fixed=["root"]) == []
    assert found(log, ARM) == [(WARNING, "base")]


def test_contact_bodies_must_be_bodies():
    log, _ = walker_log(contact_bodies=("hnad",))
    assert found(log, WALKER) == [(ERROR, "contact_body")]
    assert "did you mean 'hand'?" in message(log, "contact_body", WALKER)


def test_torque_in_another_unit_asks_for_gains():
    log = arm_log(tau_unit=TorqueUnit.AMPERE, tau_unit_text="A (measured)")
    assert found(log) == [(WARNING, "torque_unit")]
    assert "'A (measured)', not N m; give one gain per joint" in message(log, "torque_unit")


# Stamps


def test_stamps_that_stop_or_return():
    time = arm_log().time.copy()
    time[700] = time[698]
    log = arm_log(time=time)
    assert found(log) == [(ERROR, "stamps")]
    assert "sample 700 (3.49 s after 3.495 s), 1 times" in message(log, "stamps")


def test_gaps_are_counted_and_placed():
    log = arm_log()
    keep = np.r_[0:1000, 1016:2000]
    log = log.map_channels(lambda x: x[keep], time=log.time[keep])
    assert found(log) == [(WARNING, "gap")]
    assert "1 gap above three periods, the longest 85 ms at 4.995 s" in message(log, "gap")
    fast = arm_log(time=0.2 * arm_log().time, qvel=None)
    keep = np.r_[0:1000, 1007:2000]
    fast = fast.map_channels(lambda x: x[keep], time=fast.time[keep])
    assert found(fast) == [(NOTE, "gap")]
    assert "8 ms at 0.999 s (period 1 ms); short enough to be bridged" in message(fast, "gap")


@pytest.mark.parametrize(("amount", "expected"), [(0.01, []), (0.15, [NOTE]), (0.6, [WARNING])])
def test_jitter_by_degree(amount, expected):
    log = arm_log(qvel=None)
    time = log.time + amount / RATE * np.random.default_rng(0).uniform(-0.5, 0.5, log.time.size)
    assert [f.severity for f in preflight(dataclasses.replace(log, time=time)).findings] == expected


def test_stamps_in_another_unit():
    log = arm_log(qvel=None)
    assert (ERROR, "rate") in found(dataclasses.replace(log, time=1e3 * log.time))
    assert (WARNING, "rate") in found(dataclasses.replace(log, time=40.0 * log.time))


def test_a_joint_that_no_log_holds_is_called_that():
    shoulder = SimpleNamespace(**(vars(ARM) | {"joint_type": ("ball", "hinge", "hinge")}))
    assert "'shoulder' of the model is a ball" in message(arm_log(), "joint_kind", shoulder)
    assert "joint 'root'" in message(arm_log(), "base", WALKER)


def test_angles_wrapped_at_half_a_turn():
    qpos = np.array(arm_log(qvel=None).qpos)
    qpos[:, 1] *= 4.0
    turned = arm_log(qvel=None, qpos=qpos)
    assert found(turned) == []
    wrapped = arm_log(qvel=None, qpos=(qpos + np.pi) % (2 * np.pi) - np.pi)
    assert (ERROR, "wrapped") in found(wrapped)
    assert "qpos of 'elbow' jumps by" in message(wrapped, "wrapped")
    rail = SimpleNamespace(**(vars(ARM) | {"joint_type": ("slide",) * 3}))
    assert (ERROR, "wrapped") not in found(wrapped, rail)


def test_short_logs():
    log = arm_log(qvel=None)
    few = log.map_channels(lambda x: x[:8], time=log.time[:8])
    assert found(few) == [(ERROR, "short")]
    brief = log.map_channels(lambda x: x[:150], time=log.time[:150])
    assert (WARNING, "short") in found(brief)


# One channel


def test_dropouts_name_the_channel_and_the_interval():
    log = changed("tau", slice(200, 240), 1, np.nan)
    assert found(log) == [(WARNING, "nan")]
    assert "tau of 'elbow' is NaN or Inf in 40 of 2000 samples (1-1.195 s)" in message(log, "nan")
    log = changed("tau", slice(0, 2000, 2), 1, np.inf)
    assert (ERROR, "nan") in found(log)
    log, _ = walker_log()
    log = changed("base_quat", 3, 2, np.nan, log)
    assert "base_quat[2] is NaN" in message(log, "nan", WALKER)


def test_a_frozen_encoder_is_betrayed_by_the_velocity():
    log = changed("qpos", slice(800, 1100), 1, arm_log().qpos[800, 1])
    frozen = [f.message for f in preflight(log).findings if f.check == "frozen"]
    assert len(frozen) == 1
    assert "qpos of 'elbow' stays at exactly" in frozen[0]
    assert "from 4 to 5.495 s but qvel says" in frozen[0]


def test_a_frozen_encoder_is_betrayed_by_its_torque():
    """Where no velocity is logged; a coarse encoder, and a joint whose torque rests too, may stand."""
    log = dataclasses.replace(arm_log(), qvel=None)
    stuck = changed("qpos", slice(700, 1100), 1, log.qpos[700, 1], log)
    assert "its torque goes on as before; a frozen encoder" in message(stuck, "frozen")
    coarse = dataclasses.replace(stuck, qpos=np.round(stuck.qpos, 2))
    resting = changed("tau", slice(700, 1100), 1, log.tau[700, 1] + 1e-3 * np.arange(400), stuck)
    for one in (coarse, resting):
        assert not any("encoder" in f.message for f in preflight(one).findings)


def test_a_frozen_velocity_is_betrayed_by_the_position():
    log = changed("qvel", slice(800, 1100), 2, arm_log().qvel[800, 2])
    assert "qvel of 'wrist' stays at exactly" in message(log, "frozen")


def test_a_joint_at_rest_is_not_frozen():
    log = arm_log()
    rest = slice(600, 1200)
    log = changed("qpos", rest, 1, log.qpos[600, 1], log)
    log = changed("qvel", rest, 1, 0.0, log)
    assert "frozen" not in [check for _, check in found(log)]


def test_torque_that_never_changes_or_stops_while_the_robot_moves():
    assert "tau of 'elbow' is 1.5 throughout" in message(
        changed("tau", slice(None), 1, 1.5), "frozen"
    )
    log = changed("tau", slice(400, 700), 1, 0.0)
    assert found(log) == [(WARNING, "frozen")]
    assert "tau of 'elbow' stays at exactly 0 from 2 to 3.495 s" in message(log, "frozen")


def test_rows_that_repeat():
    log = arm_log()
    old = np.arange(2000) - (np.arange(2000) % 10 == 3)
    assert found(log.map_channels(lambda x: x[old])) == [(WARNING, "repeated")]
    # One coarse channel repeats by itself; the rows do not.
    coarse = dataclasses.replace(log, qpos=np.round(log.qpos / 0.02) * 0.02, qvel=None)
    assert "repeated" not in [check for _, check in found(coarse)]


def test_clipped_torque_and_smooth_coarse_peaks():
    log = arm_log()
    clipped = dataclasses.replace(log, tau=np.clip(log.tau, -100, 5))
    maxima = [f.message for f in preflight(clipped).findings]
    assert len(maxima) == 3
    assert all("sits at its maximum 5 in" in text for text in maxima)
    sine = np.sin(2 * np.pi * 0.4 * log.time)[:, None] * [3.0, 2.0, 1.0]
    for step in (0.2, 0.05, 0.01):
        coarse = dataclasses.replace(log, tau=np.round(sine / step) * step)
        assert "saturated" not in [check for _, check in found(coarse)]


def test_spikes_are_told_from_steps_and_noise():
    log = changed("qpos", 500, 0, 3.0)
    assert "qpos of 'shoulder' has 1 single samples far off" in message(log, "spike")
    assert "3 at 2.5 s" in message(log, "spike")
    # Beside samples that were lost, too.
    qpos = np.array(log.qpos)
    qpos[200:203] = np.nan
    assert "3 at 2.5 s" in message(dataclasses.replace(log, qpos=qpos), "spike")
    steps = np.sign(np.sin(2 * np.pi * log.time))[:, None] * [1.0, 2.0, 3.0]
    square = dataclasses.replace(arm_log(), tau=steps + 1e-3 * arm_log().tau)
    assert "spike" not in [check for _, check in found(square)]


def test_degrees_and_joints_that_do_not_move():
    log = arm_log()
    log = dataclasses.replace(log, qpos=np.degrees(log.qpos), qvel=np.degrees(log.qvel))
    assert found(log) == [(WARNING, "degrees")]
    assert "'shoulder' (-57.3 to 57.3)" in message(log, "degrees")
    rail = SimpleNamespace(**(vars(ARM) | {"joint_type": ("slide",) * 3}))
    assert found(log, rail) == []


def test_no_motion():
    log = arm_log(qvel=None)
    still = dataclasses.replace(log, qpos=1e-4 * log.qpos)
    assert found(still) == [(WARNING, "no_motion")]
    one = dataclasses.replace(log, qpos=log.qpos * [1.0, 1e-4, 1.0])
    assert found(one) == [(NOTE, "no_motion")]
    assert "joints that do not move: elbow" in message(one, "no_motion")


# Channels against each other


def test_velocity_of_the_wrong_sign_scale_column_or_time():
    log = arm_log()
    qvel = np.asarray(log.qvel)

    def checks(value):
        return {check for _, check in found(dataclasses.replace(log, qvel=value))}

    assert checks(qvel * [1, -1, 1]) == {"sign"}
    assert "qvel of 'elbow' is minus" in message(
        dataclasses.replace(log, qvel=qvel * [1, -1, 1]), "sign"
    )
    assert checks(qvel[:, [1, 0, 2]]) == {"swapped"}
    assert checks(qvel * [1, 1.3, 1]) == {"scale"}
    assert checks(qvel * [1, 1.05, 1]) == set()
    degrees = dataclasses.replace(log, qvel=np.degrees(qvel))
    assert set(found(degrees)) == {(ERROR, "scale")}
    assert checks(np.random.default_rng(0).normal(size=qvel.shape)) == {"velocity"}


def test_velocities_of_a_joint_that_each_target_jolts_are_no_mean_ones():
    """At 50 Hz, a loop that settles in 20 ms, as of first order: right at the stamps, and 0.58 of the mean there."""
    time, settles = np.arange(0, 10, 0.02), 0.02
    target = 0.5 * np.sin(2 * np.pi * 0.3 * time)
    left = np.exp(-0.02 / settles)
    qpos, qvel = np.zeros((2, len(time)))
    for k in range(1, len(time)):
        miss = target[k - 1] - qpos[k - 1]
        qpos[k] = target[k - 1] - left * miss
        qvel[k] = left * miss / settles
    fields = {"time": time, "joint_names": ("hinge",), "qpos": qpos[:, None], "qvel": qvel[:, None]}
    robot = ji.load_model(mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body><joint name="hinge" axis="0 1 0"/><geom size="0.1"/></body></worldbody></mujoco>'
    ))  # fmt: skip
    assert "scale" in {c for _, c in found(Log(**fields), robot)}
    assert "scale" not in {c for _, c in found(Log(**fields, qpos_target=target[:, None]), robot)}
    far = Log(**{**fields, "qvel": 5.0 * qvel[:, None]}, qpos_target=target[:, None])
    assert "scale" in {c for _, c in found(far, robot)}


def test_a_joint_that_another_shakes_is_not_that_other():
    log = arm_log()
    noise = 5e-4 * np.random.default_rng(3).normal(size=log.time.size)
    qpos, qvel = np.array(log.qpos), np.array(log.qvel)
    qpos[:, 0], qvel[:, 0] = 0.006 * qpos[:, 1] + noise, 0.006 * qvel[:, 1]
    assert found(dataclasses.replace(log, qpos=qpos, qvel=qvel)) == []


@pytest.mark.parametrize("samples", [4, 10])
def test_a_late_velocity_is_measured(samples):
    log = arm_log()
    late = dataclasses.replace(log, qvel=np.roll(log.qvel, samples, axis=0)).between(0.2, 9.5)
    texts = [f.message for f in preflight(late, ARM).findings if f.check == "delay"]
    assert len(texts) == 3
    for text in texts:
        assert "behind dqpos/dt" in text
        delay = float(text.split(" runs ")[1].split(" ms")[0])
        assert delay == pytest.approx(1e3 * samples / RATE, abs=1.0)


def test_quaternions_off_unit_length_or_in_the_other_order():
    log, _ = walker_log()
    assert found(dataclasses.replace(log, base_quat=1.01 * log.base_quat), WALKER) == [
        (WARNING, "quaternion")
    ]
    assert (ERROR, "quaternion") in found(
        dataclasses.replace(log, base_quat=1.3 * log.base_quat), WALKER
    )
    rolled = dataclasses.replace(log, base_quat=np.roll(log.base_quat, -1, axis=1))
    assert "fits base_quat only if that is xyzw" in message(rolled, "frame", WALKER)
    silent = dataclasses.replace(rolled, base_angvel=None)
    assert found(silent, WALKER) == [(WARNING, "quaternion")]
    assert "looks like xyzw" in message(silent, "quaternion", WALKER)


def test_base_velocities_in_the_other_frame():
    log, turn = walker_log()
    world = dataclasses.replace(log, base_angvel=np.einsum("tij,tj->ti", turn, log.base_angvel))
    assert found(world, WALKER) == [(ERROR, "frame")]
    assert "base_angvel is in the world frame" in message(world, "frame", WALKER)
    body = dataclasses.replace(log, base_linvel=np.einsum("tji,tj->ti", turn, log.base_linvel))
    assert found(body, WALKER) == [(ERROR, "frame")]
    assert "base_linvel is in the body frame" in message(body, "frame", WALKER)
    noise = np.random.default_rng(3).normal(size=log.base_linvel.shape)
    other = dataclasses.replace(log, base_linvel=np.cumsum(noise, axis=0))
    assert found(other, WALKER) == [(WARNING, "frame")]
    spun = dataclasses.replace(log, base_angvel=np.degrees(log.base_angvel))
    assert "is in degrees per second" in message(spun, "frame", WALKER)


@settings(max_examples=80, deadline=None)
@given(data=st.data())
def test_any_log_gets_one_line_findings(data):
    """Whatever the samples hold, preflight and masks come through."""
    samples = data.draw(st.integers(2, 60))
    rng = np.random.default_rng(data.draw(st.integers(0, 99)))
    time = np.cumsum(rng.choice([1e-4, 0.01, 0.011, 0.5], samples, p=[0.1, 0.5, 0.3, 0.1]))
    odd = st.sampled_from([0.0, 1.0, -1.0, np.nan, np.inf, -np.inf, 1e150, 1e-150, 57.3])

    def channel(*shape):
        x = rng.normal(size=(samples, *shape)) * data.draw(st.sampled_from([0.0, 1e-5, 1.0, 1e4]))
        for value in data.draw(st.lists(odd, max_size=4)):
            x.reshape(-1)[rng.integers(x.size)] = value
        return x

    log = Log(
        time=time,
        joint_names=ARM.joint_names,
        qpos=channel(3),
        qvel=channel(3),
        tau=channel(3),
        base_pos=channel(3),
        base_quat=channel(4),
        base_linvel=channel(3),
        base_angvel=channel(3),
    )
    for finding in preflight(log, WALKER).findings:
        assert "\n" not in finding.message
    with np.errstate(all="ignore"):
        masked = mask(log)
    assert np.isfinite(masked.log.qpos).all()
    bad = ~np.isfinite(log.tau)
    assert not masked.rows[bad].any()


@pytest.mark.skipif(not SHARED.is_dir(), reason="real logs (../shared/data) are not here")
@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("ur10e_dynamic_calibration/dev_free_1", {"torque_unit", "jitter"}),
        ("panda_gaz2019/test", {"gap", "jitter", "repeated"}),
        ("kuka_lwr4_flobaroid/train_1", {"targets"}),
        ("dfki_double_pendulum/A0_test_07", set()),
        ("bam_xl330/train_12_sin_sin_kp800", {"torque_unit", "saturated", "delay", "jitter"}),
        ("bam_xl330/test_09_lift_and_drop_kp400",
         {"torque_unit", "jitter", "frozen", "saturated", "delay"}),
    ],
)  # fmt: skip
def test_real_logs_show_what_is_known_of_them(name, expected):
    """The Panda's jitter is in its README; the XL330's full duty is 885 counts; the LWR's targets are rad · π / 180."""
    findings = preflight(read_log(SHARED / f"{name}.npz")).findings
    checks = {f.check for f in findings if f.check != "reader"}
    assert checks == expected
    assert not [f for f in findings if f.severity is ERROR]
