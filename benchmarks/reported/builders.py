"""Small files of our own, each with one kind of trouble that people report."""

import json
import sys
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

import log_files  # noqa: E402

ARM = """<mujoco><compiler angle="radian"/><option timestep="0.001"/><worldbody>
<body name="turret" pos="0 0 0.3"><joint name="j1" axis="0 0 1" frictionloss="1" damping="1" armature="0.2"/>
<inertial pos="0.01 0 0.05" mass="4" diaginertia="0.03 0.03 0.02"/>
<body name="upper" pos="0 0 0.1"><joint name="j2" axis="0 1 0" frictionloss="1.2" damping="1" armature="0.25"/>
<inertial pos="0.01 0.02 0.15" mass="3" diaginertia="0.04 0.04 0.006"/>
<body name="lower" pos="0 0 0.35"><joint name="j3" axis="0 1 0" frictionloss="0.6" damping="0.5" armature="0.1"/>
<inertial pos="0 0.01 0.14" mass="2" diaginertia="0.015 0.015 0.003"/>
{hand}</body></body></body></worldbody>{more}</mujoco>"""
FINGER = """<body name="finger" pos="0 0 0.3"><joint name="gripper" type="slide" axis="1 0 0" range="0 0.04"/>
<inertial pos="0 0 0.02" mass="0.05" diaginertia="1e-5 1e-5 1e-5"/></body>"""
NAMES = ("j1", "j2", "j3")
RATE = 250.0


def model(hand: str = "", more: str = "") -> str:
    return ARM.format(hand=hand, more=more)


def motion(seconds: float = 8.0) -> dict[str, np.ndarray]:
    """A motion of the arm by sines, and its torques by MuJoCo's inverse dynamics, a load of 1 kg in the last link."""
    spec = mujoco.MjModel.from_xml_string(model())
    spec.body_mass[spec.body("lower").id] += 1.0
    data, rng = mujoco.MjData(spec), np.random.default_rng(2)
    t = np.arange(0.0, seconds, 1.0 / RATE)
    q, v, a = (np.zeros((t.size, 3)) for _ in range(3))
    for j in range(3):
        for w in 2 * np.pi * rng.uniform(0.15, 0.7, 3):
            size, phase = rng.uniform(0.15, 0.4), rng.uniform(0, 6)
            q[:, j] += size * np.sin(w * t + phase)
            v[:, j] += size * w * np.cos(w * t + phase)
            a[:, j] -= size * w**2 * np.sin(w * t + phase)
    tau = np.zeros_like(q)
    for k in range(t.size):
        data.qpos, data.qvel, data.qacc = q[k], v[k], a[k]
        mujoco.mj_inverse(spec, data)
        tau[k] = data.qfrc_inverse
    tau += 0.01 * np.abs(tau).mean(axis=0) * rng.normal(size=tau.shape)
    return {"time": t, "qpos": q, "qvel": v, "tau": tau}


SOUND = motion()


def npz(folder: Path, names=NAMES, **changed) -> Path:
    (folder / "arm.xml").write_text(model())
    np.savez(folder / "log.npz", **{**SOUND, **changed}, joint_names=np.array(names))
    return folder / "log.npz"


def check(path: Path, *words: str) -> list[str]:
    return [
        "convert",
        str(path),
        str(path.parent / "out.npz"),
        "--model",
        str(path.parent / "arm.xml"),
        *words,
    ]


def bag(
    folder: Path, send: Callable[[log_files.Maker, int, int], list], storage: str = "mcap"
) -> Path:
    (folder / "arm.xml").write_text(model())
    maker, sent = log_files.Maker(), []
    for k, time in enumerate(SOUND["time"]):
        stamp = log_files.START + round(time * 1e9)
        sent += [(topic, message, stamp) for topic, message in send(maker, k, stamp)]
    return log_files.write_bag(folder / "bag", sent, storage, "")


def states(
    efforts: Callable[[int], object] = lambda k: SOUND["tau"][k],
    velocities=lambda k: SOUND["qvel"][k],
):
    """Joint states of every row."""

    def send(maker, k, stamp):
        return [
            (
                "/joint_states",
                maker.joints(stamp, NAMES, SOUND["qpos"][k], velocities(k), efforts(k)),
            )
        ]

    return send


def csv(folder: Path, columns: dict[str, np.ndarray], text: str = "", delimiter: str = ",") -> Path:
    (folder / "arm.xml").write_text(model())
    path = folder / "log.csv"
    rows = "\n".join(delimiter.join(map(str, row)) for row in zip(*columns.values(), strict=True))
    path.write_text(text + delimiter.join(columns) + "\n" + rows + "\n")
    return path


def per_joint(**forms) -> dict[str, np.ndarray]:
    """Columns of the sound log: `qpos="q_{}"` and so on, numbered from 1."""
    out = {forms.pop("time", "time"): SOUND["time"]}
    for array, form in forms.items():
        out |= {form.format(k + 1): SOUND[array][:, k] for k in range(3)}
    return out


def two_publishers(maker, k, stamp):
    """A GUI and a broadcaster on one topic: zeros, and no velocity, in between."""
    real = maker.joints(stamp, NAMES, SOUND["qpos"][k], SOUND["qvel"][k], SOUND["tau"][k])
    idle = maker.joints(stamp + 1_000_000, NAMES[::-1], np.zeros(3), (), ())
    return [("/joint_states", real), ("/joint_states", idle)]


def degrees(folder: Path) -> list[str]:
    q = np.degrees(SOUND["qpos"]) % 360.0
    return check(npz(folder, qpos=q, qvel=np.degrees(SOUND["qvel"])))


def percent_gripper(maker, k, stamp):
    grip = 50 + 40 * np.sin(SOUND["time"][k])
    return [
        (
            "/joint_states",
            maker.joints(
                stamp, (*NAMES, "gripper"), [*SOUND["qpos"][k], grip], (), [*SOUND["tau"][k], 0.0]
            ),
        )
    ]


def with_gripper(folder: Path, path: Path) -> Path:
    (folder / "arm.xml").write_text(model(FINGER))
    return path


def rostopic(folder: Path) -> list[str]:
    """`rostopic echo -b log.bag -p /joint_states`."""
    stamps = (log_files.START + SOUND["time"] * 1e9).astype(np.int64)
    table = {
        "%time": stamps,
        "field.header.seq": np.arange(len(stamps)),
        "field.header.stamp": stamps,
    }
    table |= {"field.header.frame_id": np.full(len(stamps), "")}
    table |= {f"field.name{k}": np.full(len(stamps), NAMES[k]) for k in range(3)}
    for array, word in (("qpos", "position"), ("qvel", "velocity"), ("tau", "effort")):
        table |= {f"field.{word}{k}": SOUND[array][:, k] for k in range(3)}
    return check(csv(folder, table))


def echo_csv(folder: Path) -> list[str]:
    """`ros2 topic echo --csv /joint_states`: no headings."""
    path = csv(folder, {"a": SOUND["time"]})
    rows = [
        ["1700000000", str(int(t * 1e9)), "", *NAMES, *map(str, q), *map(str, v), *map(str, tau)]
        for t, q, v, tau in zip(
            SOUND["time"], SOUND["qpos"], SOUND["qvel"], SOUND["tau"], strict=True
        )
    ]
    path.write_text("\n".join(",".join(row) for row in rows) + "\n")
    return check(path)


def lerobot(folder: Path, units: np.ndarray, extra: float) -> list[str]:
    """A dataset of arm joints and a gripper from 0 to 100."""
    grip = extra * (0.5 + 0.4 * np.sin(SOUND["time"]))
    state = np.column_stack([SOUND["qpos"] * units, grip]).astype(np.float32)
    names = [f"{x}.pos" for x in (*NAMES, "gripper")]
    (folder / "set" / "meta").mkdir(parents=True)
    info = {"features": {x: {"names": {"motors": names}} for x in ("observation.state", "action")}}
    (folder / "set" / "meta" / "info.json").write_text(json.dumps(info))
    table = {
        "observation.state": state,
        "action": np.roll(state, -3, axis=0),
        "timestamp": SOUND["time"].astype(np.float32),
    }
    table |= {"episode_index": np.zeros(len(state), int)}
    log_files.write_parquet(folder / "set" / "data" / "chunk-000" / "file-000.parquet", table)
    (folder / "arm.xml").write_text(model(FINGER))
    path = folder / "set"
    return ["convert", str(path), str(folder / "out.npz"), "--model", str(folder / "arm.xml")]


HEAVY = '<inertial pos="0 0 -0.1" mass="1" diaginertia="0.01 0.01 0.001"/>'
MASSLESS = (
    '<link name="b"/><joint name="j2" type="revolute"><parent link="a"/><child link="b"/>'
    '<limit lower="-1" upper="1" effort="1" velocity="1"/><axis xyz="0 1 0"/></joint>'
)
URDF = """<robot name="r"><link name="base"/><link name="a">{inertial}</link>
<joint name="j1" type="continuous"><parent link="base"/><child link="a"/><axis xyz="1 0 0"/></joint>{more}</robot>"""
INERTIAL = '<inertial>{origin}<mass value="2"/><inertia {inertia}/></inertial>'
ROUND = 'ixx="0.02" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.02"'


def urdf(
    origin: str = '<origin xyz="0 0.1 0.1"/>', inertia: str = ROUND, more: str = "", names=("j1",)
):
    """A URDF of one link, and a log of its joint."""

    def build(folder: Path) -> list[str]:
        text = URDF.format(inertial=INERTIAL.format(origin=origin, inertia=inertia), more=more)
        (folder / "arm.xml").with_suffix(".urdf").write_text(text)
        one = {
            key: x if key == "time" else np.repeat(x[:, 1:2], len(names), axis=1)
            for key, x in SOUND.items()
        }
        np.savez(folder / "log.npz", **one, joint_names=np.array(names))
        return [
            "convert",
            str(folder / "log.npz"),
            str(folder / "out.npz"),
            "--model",
            str(folder / "arm.urdf"),
        ]

    return build


def replayed(
    folder: Path,
    change: Callable[[np.ndarray], np.ndarray],
    actuator: str = 'position kp="200" kv="20"',
    **more,
) -> list[str]:
    """Targets a little ahead of the positions, as the log has them once changed."""
    target = np.roll(SOUND["qpos"], -5, axis=0)
    kind, _, numbers = actuator.partition(" ")
    drives = "".join(f'<{kind} joint="{x}" {numbers}/>' for x in NAMES)
    path = npz(folder, qpos_target=change(target), **more)
    with np.load(path) as found:
        np.savez(path, **{key: found[key] for key in found.files if key != "tau"})
    (folder / "arm.xml").write_text(model(more=f"<actuator>{drives}</actuator>"))
    return ["replay", str(path), "--model", str(folder / "arm.xml"), "--out", str(folder / "out")]


def go2(folder: Path) -> list[str]:
    """A four-legged robot's LowState, whose motors go FR, FL, RR, RL, and a model whose legs go FL, FR, RL, RR."""
    import test_robot_messages as robots

    own = robots.types()
    sent, _ = robots.unitree(own, "unitree_go", 20)
    for k, (topic, one, _stamp) in enumerate(sent):
        if topic == "/lowstate":
            one.imu_state.accelerometer[:] = [0.0, 0.0, 9.81]
            for j, motor in enumerate(one.motor_state):
                motor.q, motor.dq = 0.3 * np.sin(0.05 * k + j), 0.0
                motor.tau_est = np.cos(0.05 * k + j)
    path = log_files.write_bag(folder / "bag", sent, "db3", "", own)
    legs = ""
    for leg in ("FL", "FR", "RL", "RR"):
        inner = ""
        for part, axis in (("calf", "0 1 0"), ("thigh", "0 1 0"), ("hip", "1 0 0")):
            name = f"{leg}_{part}"
            joint = f'<joint name="{name}_joint" axis="{axis}"/>'
            inner = f'<body name="{name}" pos="0 0 -0.2">{joint}{HEAVY}{inner}</body>'
        legs += inner
    (folder / "arm.xml").write_text(f"<mujoco><worldbody>{legs}</worldbody></mujoco>")
    return check(path)


def pointer(name: str):
    """A Git LFS pointer in place of a file."""

    def build(folder: Path) -> list[str]:
        path = npz(folder)
        text = "version https://git-lfs.github.com/spec/v1\noid sha256:2f3dd7\nsize 1411984514\n"
        (folder / name).write_text(text)
        return (
            ["convert", str(path), str(folder / "out.npz"), "--model", str(folder / "arm.xml")]
            if name != "log.npz"
            else check(path)
        )

    return build


def cut_off(folder: Path) -> list[str]:
    path = bag(folder, states())
    part = next(path.glob("*.mcap"))
    part.write_bytes(part.read_bytes()[: part.stat().st_size // 2])
    part.rename(folder / part.name)
    return check(folder / part.name)


def renamed(folder: Path) -> list[str]:
    (folder / "arm.xml").write_text(model())
    (folder / "run.pkl").write_bytes(b"\x80\x04}")
    return ["convert", str(folder / "run.pkl"), str(folder / "out.npz")]


def aloha(folder: Path) -> list[str]:
    import h5py

    (folder / "arm.xml").write_text(model())
    with h5py.File(folder / "episode_0.hdf5", "w") as file:
        for name, array in (
            ("observations/qpos", "qpos"),
            ("observations/qvel", "qvel"),
            ("observations/effort", "tau"),
            ("action", "qpos"),
        ):
            file[name] = SOUND[array].astype(np.float32)
    path = folder / "episode_0.hdf5"
    return ["convert", str(path), str(folder / "out.npz"), "--model", str(folder / "arm.xml")]


def matlab(folder: Path) -> list[str]:
    import scipy.io

    (folder / "arm.xml").write_text(model())
    scipy.io.savemat(
        folder / "run.mat",
        {"t": SOUND["time"], "q": SOUND["qpos"], "dq": SOUND["qvel"], "tau": SOUND["tau"]},
    )
    return [
        "convert",
        str(folder / "run.mat"),
        str(folder / "out.npz"),
        "--model",
        str(folder / "arm.xml"),
    ]


def weight() -> np.ndarray:
    """Torque that gravity asks for along the motion, of the robot without load."""
    spec = mujoco.MjModel.from_xml_string(model())
    data, out = mujoco.MjData(spec), np.zeros_like(SOUND["tau"])
    for k, q in enumerate(SOUND["qpos"]):
        data.qpos[:] = q
        mujoco.mj_forward(spec, data)
        out[k] = data.qfrc_bias
    return out


MIMIC = (
    '<link name="b"><inertial><mass value="9"/><inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/>'
    '</inertial></link><joint name="j2" type="continuous"><parent link="a"/><child link="b"/><axis xyz="0 1 0"/>'
    '<mimic joint="j1" multiplier="-1"/></joint>'
)
