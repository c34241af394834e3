"""The kinds: what is wrong, the public thread that it was found in, and what an answer must say."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.reported.builders import (
    MASSLESS,
    MIMIC,
    NAMES,
    SOUND,
    aloha,
    bag,
    check,
    csv,
    cut_off,
    degrees,
    echo_csv,
    go2,
    lerobot,
    matlab,
    npz,
    per_joint,
    percent_gripper,
    pointer,
    renamed,
    replayed,
    rostopic,
    states,
    two_publishers,
    urdf,
    weight,
    with_gripper,
)


class Kind(NamedTuple):
    """One kind of trouble."""

    what: str
    thread: str
    build: Callable[[Path], list[str]]
    """Makes the files in a folder; the command's words."""
    right: str
    """Pattern of a right answer."""
    outcome: str = "refused"
    """`read`, or `refused` with a line."""
    needs: str = ""
    """A package of an extra."""


class Tried(NamedTuple):
    """What came of a kind."""

    right: bool
    status: int
    said: str


KINDS = (
    Kind(
        "joint states whose effort is .nan throughout",
        "moveit/moveit2_tutorials#767",
        lambda f: check(bag(f, states(lambda k: np.full(3, np.nan)))),
        "effort|no torque|targets",
    ),
    Kind(
        "velocities 0 in every message",
        "moveit/moveit2_tutorials#333",
        lambda f: check(bag(f, states(velocities=lambda k: np.zeros(3)))),
        "qvel|velocit",
        "read",
    ),
    Kind(
        "two publishers on one topic, one of zeros",
        "automaticaddison/yahboom_rosmaster#4",
        lambda f: check(bag(f, two_publishers)),
        "2000 joint states .* left out: no effort",
        "read",
    ),
    Kind(
        "effort 0 throughout",
        "PilzDE/pilz_robots#180",
        lambda f: check(bag(f, states(lambda k: np.zeros(3)))),
        "0 throughout",
    ),
    Kind(
        "effort holds motor currents",
        "UniversalRobots/Universal_Robots_ROS_Driver#286",
        lambda f: check(npz(f, tau=SOUND["tau"] * [0.08, 0.09, 0.12])),
        "--tau-unit A",
    ),
    Kind(
        "effort with gravity taken out",
        "UniversalRobots/Universal_Robots_ROS2_Driver#1551",
        lambda f: check(npz(f, tau=SOUND["tau"] - weight())),
        "--gravity-compensated",
    ),
    Kind(
        "effort in per mille of the rated torque",
        "ipa320/schunk_robots#68",
        lambda f: check(npz(f, tau=SOUND["tau"] * [12.0, 14.0, 40.0])),
        "times what the model needs",
    ),
    Kind(
        "effort is the position error of the loop",
        "ros-naoqi/naoqi_bridge#37",
        lambda f: check(npz(f, tau=SOUND["tau"] / [800.0, 900.0, 700.0])),
        "times what the model needs",
    ),
    Kind(
        "UR's RTDE recorder: blanks between columns",
        "UTNuclearRoboticsPublic/jog_arm#100",
        lambda f: check(
            csv(
                f,
                per_joint(
                    time="timestamp",
                    qpos="actual_q_{}",
                    qvel="actual_qd_{}",
                    tau="actual_current_{}",
                ),
                delimiter=" ",
            )
        ),
        r"--column 'qpos.\*=actual_q_\*' --column 'tau.\*=actual_current_\*'",
    ),
    Kind(
        "PlotJuggler's CSV of a bag",
        "",
        lambda f: check(
            csv(
                f,
                per_joint(
                    time="__time", qpos="/joint_states/j{}/position", tau="/joint_states/j{}/effort"
                ),
            )
        ),
        r"/joint_states/\*/position",
    ),
    Kind(
        "`rostopic echo -p` of joint states",
        "MichaelGrupp/evo#725",
        rostopic,
        r"--column 'qpos.\*=field.position\*'",
    ),
    Kind("`ros2 topic echo --csv`: no headings", "MichaelGrupp/evo#725", echo_csv, "line of names"),
    Kind(
        "positions in turns",
        "odriverobotics/ros_odrive#17",
        lambda f: check(npz(f, qpos=SOUND["qpos"] / 2 / np.pi, qvel=SOUND["qvel"] / 2 / np.pi)),
        "turns",
    ),
    Kind(
        "a joint's positions are .nan",
        "odriverobotics/ros_odrive#20",
        lambda f: check(npz(f, qpos=np.where([0, 1, 0], np.nan, SOUND["qpos"]))),
        "j2",
    ),
    Kind(
        "counts of 8192 a turn",
        "XRobots/ReallyUsefulRobot#19",
        lambda f: check(
            npz(
                f,
                qpos=np.round(SOUND["qpos"] * 8192 / 2 / np.pi),
                qvel=SOUND["qvel"] * 8192 / 2 / np.pi,
            )
        ),
        "8192",
    ),
    Kind(
        "degrees from 0 to 360, wrapped",
        "Kinovarobotics/Kinova-kortex2_Gen3_G3L#225",
        degrees,
        "degrees",
    ),
    Kind(
        "a gripper in per cent among joint states",
        "Kinovarobotics/ros_kortex#332",
        lambda f: check(with_gripper(f, bag(f, percent_gripper))),
        "gripper",
    ),
    Kind(
        "LeRobot: degrees, and a gripper from 0 to 100",
        "johnsutor/so101-nexus#102",
        lambda f: lerobot(f, np.full(3, 57.29578), 100.0),
        "--degrees",
    ),
    Kind(
        "LeRobot: degrees, read so, the gripper with them",
        "johnsutor/so101-nexus#102",
        lambda f: [*lerobot(f, np.full(3, 57.29578), 100.0), "--degrees"],
        "gripper",
    ),
    Kind(
        "Go2's motors in another order than its URDF's",
        "google-deepmind/mujoco_menagerie#148",
        go2,
        "12: F",
        "read",
    ),
    Kind(
        "raw actions of a policy as targets",
        "isaac-sim/IsaacLab#1077",
        lambda f: replayed(f, lambda x: (x - [0.1, 0.4, -0.3]) / 0.25),
        "policy's raw actions",
    ),
    Kind(
        "a policy's order of joints",
        "InternRobotics/OpenHomie#1",
        lambda f: replayed(f, lambda x: x[:, [0, 2, 1]]),
        "follows the targets of",
    ),
    Kind(
        "velocity servos in the model",
        "Kinovarobotics/ros_kortex#77",
        lambda f: replayed(f, lambda x: x, 'velocity kv="20"'),
        "kp of j1, j2, j3 is not known",
    ),
    Kind(
        "an integrated-velocity servo in the model",
        "Kinovarobotics/ros_kortex#77",
        lambda f: replayed(f, lambda x: x, 'intvelocity kp="200" actrange="-3 3"'),
        "kp of j1, j2, j3 is not known",
    ),
    Kind(
        "a URDF's inertial turned by rpy",
        "google-deepmind/mujoco#3559",
        urdf('<origin xyz="0 0.1 0.1" rpy="0.3 0.2 1.57"/>'),
        "joints",
        "read",
    ),
    Kind(
        "an inertia that breaks the triangle inequality",
        "google-deepmind/mujoco#375",
        urdf(inertia='ixx="0.5" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.02"'),
        "triangle|raised",
        "read",
    ),
    Kind(
        "negative moments of inertia",
        "AlphaDogDeveloper/dev_robot_control_sdk#30",
        urdf(inertia='ixx="-0.01" ixy="0" ixz="0" iyy="-0.01" iyz="0" izz="0.02"'),
        "raised",
        "read",
    ),
    Kind(
        "products of inertia beyond the moments",
        "gazebosim/ros_gz#155",
        urdf(inertia='ixx="0.0004" ixy="-0.0007" ixz="0" iyy="0.001" iyz="0" izz="0.005"'),
        "raised",
        "read",
    ),
    Kind(
        "a link without inertial",
        "elephantrobotics/mycobot_ros2#59",
        urdf(more=MASSLESS, names=("j1", "j2")),
        "b",
        "read",
    ),
    Kind(
        "a mimic joint that the log lacks",
        "google-deepmind/mujoco#3527",
        urdf(more=MIMIC),
        "j2",
    ),
    Kind("a Git LFS pointer for a log", "ACRoboT-buaa/RobotDiffuse#1", pointer("log.npz"), "LFS"),
    Kind("a Git LFS pointer for a model", "ACRoboT-buaa/RobotDiffuse#1", pointer("arm.xml"), "LFS"),
    Kind("a bag that was cut off", "fishros/ros2bag_convert#9", cut_off, "truncated|ends within"),
    Kind("a pickle", "", renamed, "pickle"),
    Kind(
        "ALOHA's HDF5 episode, without stamps",
        "MarkFzp/mobile-aloha#10",
        aloha,
        "--rate HZ",
        needs="h5py",
    ),
    Kind("MATLAB's .mat", "", matlab, r"--column 'qpos=q'"),
    Kind(
        "another arm's prefix",
        "",
        lambda f: check(npz(f, names=[f"fr3_{x}" for x in NAMES])),
        "joint|names",
        "read",
    ),
)
