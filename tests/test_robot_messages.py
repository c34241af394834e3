"""Unitree's and Franka's own messages in bags, written by rosbags from whole definitions."""

import numpy as np
import pytest
from log_files import START, Maker, store, write_bag

from jax_inertia.logs.log import LogError
from jax_inertia.logs.log_files import read_log
from jax_inertia.logs.readers import Options
from jax_inertia.logs.readers.messages.robots import GO2

pytest.importorskip("rosbags")
IMU = "float32[4] quaternion\nfloat32[3] gyroscope\nfloat32[3] accelerometer\nfloat32[3] rpy\n"
HEAD = "uint8[2] head\nuint8 level_flag\nuint8 frame_reserve\nuint32[2] sn\nuint32[2] version\nuint16 bandwidth\n"
COMMAND = "uint8 mode\nfloat32 q\nfloat32 dq\nfloat32 tau\nfloat32 kp\nfloat32 kd\n"
DEFINITIONS = {
    "unitree_go/msg/IMUState": IMU + "int8 temperature\n",
    "unitree_go/msg/MotorState": "uint8 mode\nfloat32 q\nfloat32 dq\nfloat32 ddq\nfloat32 tau_est\nfloat32 q_raw\n"
    "float32 dq_raw\nfloat32 ddq_raw\nint8 temperature\nuint32 lost\nuint32[2] reserve\n",
    "unitree_go/msg/LowState": HEAD
    + "unitree_go/IMUState imu_state\nunitree_go/MotorState[20] motor_state\nint16[4] foot_force\nuint32 tick\n",
    "unitree_go/msg/MotorCmd": COMMAND + "uint32[3] reserve\n",
    "unitree_go/msg/LowCmd": HEAD + "unitree_go/MotorCmd[20] motor_cmd\nuint8[40] remote\nuint32 crc\n",
    "unitree_hg/msg/IMUState": IMU + "int16 temperature\n",
    "unitree_hg/msg/MotorState": "uint8 mode\nfloat32 q\nfloat32 dq\nfloat32 ddq\nfloat32 tau_est\n"
    "int16[2] temperature\nfloat32 vol\nuint32[2] sensor\nuint32 motorstate\nuint32[4] reserve\n",
    "unitree_hg/msg/LowState": "uint32[2] version\nuint8 mode_pr\nuint8 mode_machine\nuint32 tick\n"
    "unitree_hg/IMUState imu_state\nunitree_hg/MotorState[35] motor_state\nuint8[40] wireless_remote\n"
    "uint32[4] reserve\nuint32 crc\n",
    "unitree_hg/msg/MotorCmd": COMMAND + "uint32 reserve\n",
    "unitree_hg/msg/LowCmd": "uint8 mode_pr\nuint8 mode_machine\nunitree_hg/MotorCmd[35] motor_cmd\nuint32[4] reserve\n"
    "uint32 crc\n",
    "franka_msgs/msg/CollisionIndicators": "".join(
        f"geometry_msgs/Vector3 is_cartesian_{x}\n"
        for x in ("linear_collision", "angular_collision", "linear_contact", "angular_contact")
    )
    + "float64[7] is_joint_collision\nfloat64[7] is_joint_contact\n",
    "franka_msgs/msg/FrankaRobotState": "std_msgs/Header header\nfranka_msgs/CollisionIndicators collision_indicators\n"
    "sensor_msgs/JointState measured_joint_state\nsensor_msgs/JointState desired_joint_state\nfloat64[7] ddq_d\n",
    "franka_msgs/msg/FrankaState": "std_msgs/Header header\nfloat64[6] cartesian_collision\n"
    + "float64[6] cartesian_contact\n"
    + "".join(f"float64[7] {x}\n" for x in ("q", "q_d", "dq", "dq_d", "theta", "dtheta", "tau_J", "dtau_J"))
    + "float64[6] K_F_ext_hat_K\n",
}  # fmt: skip
ROWS = 40


def types(ros1: bool = False):
    from rosbags.typesys import get_types_from_msg

    own = store(ros1)
    for name, text in DEFINITIONS.items():
        own.register(get_types_from_msg(text, name))
    return own


def filled(own, kind: str, rng, **given):
    """A message of random numbers, but for what is given."""
    made = {}
    for name, (node, what) in own.fielddefs[kind][1]:
        if name in given:
            made[name] = given[name]
        elif int(node) == 2:
            made[name] = filled(own, what, rng)
        elif int(node) == 3:
            (_, (base, _)), count = what
            made[name] = rng.integers(0, 50, count).astype(np.dtype(base))
        else:
            base = what[0]
            made[name] = float(rng.normal()) if "float" in base else int(rng.integers(0, 50))
    return own.types[kind](**made)


def unitree(own, package: str, count: int) -> tuple[list, dict[str, np.ndarray]]:
    """States, and at every other one a command; and what is in them."""
    rng = np.random.default_rng(3)
    q, dq, tau, target = rng.normal(size=(4, ROWS, count)).astype(np.float32)
    imu = rng.normal(size=(ROWS, 10)).astype(np.float32)
    imu[:, :4] = [1.0, 0.0, 0.0, 0.0]
    sent = []
    for k in range(ROWS):
        stamp = START + k * 2_000_000
        fields = [
            zip(("q", "dq", "tau_est"), map(float, x), strict=True)
            for x in np.stack([q[k], dq[k], tau[k]], 1)
        ]
        motors = [filled(own, f"{package}/msg/MotorState", rng, **dict(one)) for one in fields]
        parts = {"quaternion": imu[k, :4], "gyroscope": imu[k, 4:7], "accelerometer": imu[k, 7:]}
        felt = filled(own, f"{package}/msg/IMUState", rng, **parts)
        one = filled(own, f"{package}/msg/LowState", rng, imu_state=felt, motor_state=motors)
        sent.append(("/lowstate", one, stamp))
        if k % 2 == 0:
            wanted = [
                filled(own, f"{package}/msg/MotorCmd", rng, q=float(target[k, j]))
                for j in range(count)
            ]
            sent.append(
                ("/lowcmd", filled(own, f"{package}/msg/LowCmd", rng, motor_cmd=wanted), stamp - 1)
            )
    held = target[np.arange(ROWS) - np.arange(ROWS) % 2]
    return sent, {"qpos": q, "qvel": dq, "tau": tau, "qpos_target": held, "imu": imu}


@pytest.mark.parametrize("storage", ["db3", "mcap"])
def test_a_four_legged_robots_motors_have_the_names_of_their_order(tmp_path, storage):
    own = types()
    sent, right = unitree(own, "unitree_go", 20)
    log = read_log(write_bag(tmp_path / "bag", sent, storage, "", own))
    assert log.joint_names == GO2
    assert GO2[:4] == ("FR_hip_joint", "FR_thigh_joint", "FR_calf_joint", "FL_hip_joint")
    for array in ("qpos", "qvel", "tau", "qpos_target"):
        np.testing.assert_array_equal(getattr(log, array), right[array][:, :12], err_msg=array)
    np.testing.assert_array_equal(log.base_angvel, right["imu"][:, 4:7])
    np.testing.assert_array_equal(log.base_linacc, right["imu"][:, 7:])
    np.testing.assert_allclose(np.diff(log.time), 0.002)


def test_a_humanoids_motors_are_named_by_the_user(tmp_path):
    own = types()
    sent, right = unitree(own, "unitree_hg", 35)
    path = write_bag(tmp_path / "bag", sent, "db3", "", own)
    with pytest.raises(LogError, match=r"its 35 motors have no names.*--joints"):
        read_log(path)
    names = tuple(f"motor{k}" for k in range(29))
    log = read_log(path, options=Options(joints=names))
    assert log.joint_names == names
    for array in ("qpos", "qvel", "tau", "qpos_target"):
        np.testing.assert_array_equal(getattr(log, array), right[array][:, :29], err_msg=array)
    with pytest.raises(LogError, match="names 36 joints of 35 motors"):
        read_log(path, options=Options(joints=tuple(map(str, range(36)))))


def franka(own, ros1: bool) -> tuple[list, dict[str, np.ndarray]]:
    rng, maker = np.random.default_rng(4), Maker(ros1)
    q, dq, tau, wanted = rng.normal(size=(4, ROWS, 7))
    names, sent = [f"fr3_joint{k}" for k in range(1, 8)], []
    for k in range(ROWS):
        stamp = START + k * 1_000_000
        header = maker.header(stamp, "base")
        if ros1:
            own_fields = {"q": q[k], "dq": dq[k], "tau_J": tau[k], "q_d": wanted[k]}
            one = filled(own, "franka_msgs/msg/FrankaState", rng, header=header, **own_fields)
        else:
            measured = maker.joints(stamp, names, q[k], dq[k], tau[k])
            desired = maker.joints(stamp, names, wanted[k], dq[k], tau[k])
            parts = {"measured_joint_state": measured, "desired_joint_state": desired}
            one = filled(own, "franka_msgs/msg/FrankaRobotState", rng, header=header, **parts)
        sent.append(("/franka_states", one, stamp + 300))
    return sent, {"qpos": q, "qvel": dq, "tau": tau, "qpos_target": wanted}


@pytest.mark.parametrize("ros1", [False, True], ids=["FrankaRobotState", "FrankaState"])
def test_an_arms_state_is_read_with_its_targets(tmp_path, ros1):
    own = types(ros1)
    sent, right = franka(own, ros1)
    path = tmp_path / ("log.bag" if ros1 else "bag")
    log = read_log(write_bag(path, sent, "bag" if ros1 else "mcap", "", own))
    assert log.joint_names[0] == ("panda_joint1" if ros1 else "fr3_joint1")
    for array, values in right.items():
        np.testing.assert_array_equal(getattr(log, array), values, err_msg=array)


@pytest.mark.parametrize("kind", ["LowState", "LowCmd"])
def test_what_is_cut_off_is_refused_by_its_topic(kind):
    from jax_inertia.logs.readers.messages.robots import decoded

    for size in (3, 40, 700):
        with pytest.raises(LogError, match=r"cut off|not plain CDR"):
            decoded(f"unitree_hg/msg/{kind}", "cdr", b"\0\1\0\0"[:size] + bytes(size), GO2)
    with pytest.raises(LogError, match="cut off"):
        decoded("franka_msgs/msg/FrankaState", "ros1", bytes(100), ())
    with pytest.raises(LogError, match="cut off"):
        decoded("franka_msgs/msg/FrankaRobotState", "cdr", b"\0\1\0\0" + bytes(60), ())
