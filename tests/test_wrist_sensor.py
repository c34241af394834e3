"""A wrist's force/torque sensor as MuJoCo C has it, with offset, drift and noise: what it carries is what was hung."""

import dataclasses
import json

import mujoco
import numpy as np
import pytest
from schemas import validated
from test_against_model import motion

import jax_inertia as ji
from jax_inertia.cli.main import main
from jax_inertia.estimation.wrist_sensor import sensed_load
from jax_inertia.logs.log_files import write_log

ARM = """<mujoco><compiler angle="radian"/><worldbody>
 <body name="base" pos="0 0 0.3"><joint name="turn" axis="0 0 1"/>
  <inertial mass="3" pos="0 0 0.1" diaginertia="0.02 0.02 0.02"/>
  <body name="upper" pos="0 0 0.1"><joint name="lift" axis="0 1 0"/>
   <inertial mass="2" pos="0.2 0 0" diaginertia="0.01 0.02 0.02"/>
   <body name="fore" pos="0.4 0 0" euler="0.2 0 0.4"><joint name="bend" axis="0 1 0"/>
    <inertial mass="1" pos="0.1 0 0" diaginertia="0.003 0.004 0.004"/>
    <body name="hand" pos="0.3 0 0"><joint name="roll" axis="1 0 0"/>
     <inertial mass="0.5" pos="0.02 0 0" diaginertia="0.001 0.001 0.001"/>
     <body name="tool" pos="0.05 0.01 0.02" euler="0.5 -0.3 0.8">{tool}</body>
    </body></body></body></body></worldbody>{sensors}</mujoco>"""
SENSORS = '<sensor><force site="s"/><torque site="s"/></sensor>'
OFFSET = np.array([4.0, -7.0, 12.0, 0.3, -0.2, 0.1])
DRIFT = np.array([0.02, -0.01, 0.03, 0.0005, 0.001, -0.0005])
SIGMA = np.array([0.1, 0.1, 0.2, 0.004, 0.004, 0.004])
LOADS = {
    "two kilograms": (2.0, (0.02, -0.03, 0.11), (0.004, 0.005, 0.003)),
    "seventy grams": (0.07, (0.0, 0.01, 0.03), (2e-5, 2e-5, 1e-5)),
}


def inertial(load) -> str:
    mass, centre, moments = load
    return (
        f'<inertial mass="{mass}" pos="{" ".join(map(str, centre))}" '
        f'diaginertia="{" ".join(map(str, moments))}"/>'
    )


def bare() -> ji.Robot:
    return ji.load_model(mujoco.MjModel.from_xml_string(nominal()))


def nominal() -> str:
    return ARM.format(tool=inertial((0.2, (0, 0, 0.02), (1e-4, 1e-4, 1e-4))), sensors="")


def sensed(load, seconds: float = 20.0, moves=None) -> ji.Log:
    """Joint positions and the wrench on the robot in world axes, of a smooth motion; no torques."""
    tool = inertial(load) + '<site name="s"/>'
    model = mujoco.MjModel.from_xml_string(ARM.format(tool=tool, sensors=SENSORS))
    data, rate = mujoco.MjData(model), 200.0
    time = np.arange(int(seconds * rate)) / rate
    path = (lambda t: 2.5 * motion(4, t, 7)) if moves is None else moves
    q, before, after = (path(time + d) for d in (0.0, -1e-4, 1e-4))
    rows, site = [], model.site("s").id
    for k in range(len(time)):
        data.qpos[:], data.qvel[:] = q[k], (after[k] - before[k]) / 2e-4
        data.qacc[:] = (after[k] - 2 * q[k] + before[k]) / 1e-8
        mujoco.mj_inverse(model, data)
        turn = data.site_xmat[site].reshape(3, 3)
        rows.append(np.concatenate([turn @ data.sensordata[:3], turn @ data.sensordata[3:]]))
    world = np.array(rows)
    # MuJoCo's is the parent's on the child: at rest it holds a hanging load up. The contract's is the opposite.
    assert np.mean(world[:, 2]) > 0.9 * load[0] * 9.81 * np.sign(load[0])
    rng = np.random.default_rng(3)
    turns = np.stack([turn_of(model, data, x, site) for x in q])
    own = -np.einsum("tji,thj->thi", turns, world.reshape(-1, 2, 3)).reshape(-1, 6)
    own = own + OFFSET + DRIFT * (time - time.mean())[:, None] + SIGMA * rng.normal(size=own.shape)
    back = np.einsum("tij,thj->thi", turns, own.reshape(-1, 2, 3)).reshape(-1, 1, 6)
    names = tuple(model.joint(j).name for j in range(4))
    return ji.Log(
        time=time,
        joint_names=names,
        qpos=q + 1e-5 * rng.normal(size=q.shape),
        contact_wrench=back,
        contact_bodies=("tool",),
    )


def turn_of(model, data, q, site) -> np.ndarray:
    data.qpos[:] = q
    mujoco.mj_kinematics(model, data)
    return data.site_xmat[site].reshape(3, 3).copy()


def in_body_axes(log: ji.Log) -> ji.Log:
    model = mujoco.MjModel.from_xml_string(nominal())
    data, k = mujoco.MjData(model), model.body("tool").id
    own = np.array(log.contact_wrench)
    for q, w in zip(np.asarray(log.qpos), own[:, 0], strict=True):
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        w[:] = (w.reshape(2, 3) @ data.xmat[k].reshape(3, 3)).ravel()
    return dataclasses.replace(log, contact_wrench=own)


@pytest.mark.parametrize("load", LOADS.values(), ids=list(LOADS))
def test_mass_centre_offset_and_drift_are_what_was_put_in(load):
    found = sensed_load(bare(), sensed(load), "tool")
    assert found.notes == ()
    assert abs(found.pi[0] - load[0]) < 3 * found.sigma_pi[0] < 0.06 * load[0]
    assert np.all(np.abs(found.com - load[1]) < 3.5 * found.sigma_com)
    assert np.all(found.sigma_com < 0.01)
    for value, sigma, true in (
        (found.offset, found.sigma_offset, OFFSET),
        (found.drift, found.sigma_drift, DRIFT),
    ):
        assert np.all(np.abs(value - true) < 3.5 * sigma)
    assert found.modelled == pytest.approx(0.2)
    # Moments of inertia about the centre, where the motion shows them: 2 kg at 11 cm.
    if load[0] > 1:
        sigma = found.sigma_pi[4:]
        m, c = load[0], np.array(load[1])
        about = np.diag(load[2]) + m * (c @ c * np.eye(3) - np.outer(c, c))
        assert np.all(np.abs(found.pi[4:] - about[np.triu_indices(3)]) < 4 * sigma)


def test_intervals_cover():
    """Of twelve logs, nearly all intervals of mass and centre hold what was put in."""
    robot, hits = bare(), []
    log = sensed(LOADS["two kilograms"], 8.0)
    rng = np.random.default_rng(11)
    for _ in range(12):
        noise = rng.normal(size=log.contact_wrench.shape) * SIGMA
        found = sensed_load(
            robot, dataclasses.replace(log, contact_wrench=log.contact_wrench + noise), "tool"
        )
        off = np.array([found.pi[0] - 2.0, *(found.com - LOADS["two kilograms"][1])])
        hits.append(np.abs(off) < 1.96 * np.array([found.sigma_pi[0], *found.sigma_com]))
    assert 0.8 < np.mean(hits) <= 1.0


def test_a_sensor_that_hardly_moves_tells_no_load_from_offset():
    log = sensed(
        LOADS["two kilograms"], moves=lambda t: 1e-4 * motion(4, t, 7) + [0, 0.3, 0.4, 0.1]
    )
    found = sensed_load(bare(), log, "tool")
    assert "turned and moved too little" in found.notes[0]


def test_poses_held_tell_mass_and_centre():
    """Eight poses, as load wizards go: no velocity worth a word, the load by gravity alone."""
    rng = np.random.default_rng(5)
    poses = rng.uniform(-1.2, 1.2, size=(9, 4))

    def moves(t):
        k = np.clip((t / 2.2).astype(int), 0, 7)
        s = np.clip((t / 2.2 - k) * 2.2 / 0.8, 0, 1)[:, None]
        return poses[k] + (poses[k + 1] - poses[k]) * (s**3 * (10 - 15 * s + 6 * s**2))

    load = LOADS["two kilograms"]
    found = sensed_load(bare(), sensed(load, 17.0, moves), "tool")
    assert abs(found.pi[0] - 2.0) < 3 * found.sigma_pi[0] < 0.05
    assert np.all(np.abs(found.com - load[1]) < 3.5 * found.sigma_com)


def test_other_axes_and_signs_are_told():
    robot, log = bare(), sensed(LOADS["two kilograms"], 8.0)
    with pytest.raises(ji.LogError, match=r"^.*own axes.*--wrench-axes body$"):
        sensed_load(robot, in_body_axes(log), "tool")
    turned = dataclasses.replace(log, contact_wrench=-log.contact_wrench)
    with pytest.raises(ji.LogError, match=r"^.*--flip-wrenches$"):
        sensed_load(robot, turned, "tool")
    touched = np.array(log.contact_wrench)
    touched[600:1000, 0, 2] += 25.0
    (note,) = sensed_load(robot, dataclasses.replace(log, contact_wrench=touched), "tool").notes
    assert "larger than noise" in note
    for bad, body, word in (
        (log, "hand", "contact_wrench of 'hand'"),
        (log.between(0.0, 0.2), "tool", "too short"),
    ):
        with pytest.raises(ji.LogError, match=word):
            sensed_load(robot, bad, body)


def test_the_command(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "arm.xml").write_text(nominal())
    log = sensed(LOADS["two kilograms"], 8.0)
    write_log(log, tmp_path / "world.csv")
    write_log(dataclasses.replace(in_body_axes(log)), tmp_path / "own.npz")
    flipped = dataclasses.replace(log, contact_wrench=-log.contact_wrench)
    write_log(flipped, tmp_path / "flipped.npz")
    command = ["--model", "arm.xml", "--wrench", "tool", "--out", "made"]
    for name, *options in (
        ("world.csv",),
        ("own.npz", "--wrench-axes", "body"),
        ("flipped.npz", "--flip-wrenches"),
    ):
        assert main(["estimate", name, *command, *options]) == 0, capsys.readouterr().err
        report = json.loads((tmp_path / "made" / "wrench.json").read_text())
        low, high = report["carried"]["mass_kg"]["ci95"]
        assert low < 2.0 < high
        assert high - low < 0.1
        shown = capsys.readouterr().out
        assert "mass [kg]" in shown
        assert "offset of fz" in shown
        assert "+1.8" in shown or "+1.7" in shown
    for bad, word in (
        (["own.npz"], "--wrench-axes body"),
        (["flipped.npz"], "--flip-wrenches"),
        (["world.csv", "--bodies", "tool"], "--bodies"),
        (["world.csv", "--chart", "linear"], "--chart"),
    ):
        assert main(["estimate", *bad, *command]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert word in line


def test_a_topic_beside_joint_states_without_effort(tmp_path, capsys):
    pytest.importorskip("rosbags")
    pytest.importorskip("mcap")
    from log_files import Maker, write_bag

    maker, messages, start = Maker(), [], 1_700_000_000_000_000_000
    log = in_body_axes(sensed(LOADS["two kilograms"], 8.0))
    for t, q, w in zip(log.time, log.qpos, log.contact_wrench, strict=True):
        stamp = start + int(1e9 * t)
        messages.append(("/joint_states", maker.joints(stamp, log.joint_names, q), stamp))
        messages.append(("/ft", maker.wrench(stamp, w[0, :3], w[0, 3:], "ft_frame"), stamp))
    bag, model = write_bag(tmp_path / "bag", messages, "mcap"), tmp_path / "arm.xml"
    model.write_text(nominal())
    command = [str(x) for x in ("estimate", bag, "--model", model, "--out", tmp_path / "made")]
    assert main([*command, "--wrench", "tool=/ft", "--json"]) == 0
    carried = validated("wrench", capsys.readouterr().out)["carried"]
    assert carried["mass_kg"]["value"] == pytest.approx(2.0, abs=0.01)
    assert main([*command, "--bodies", "tool"]) == 2
    assert "hold no effort" in capsys.readouterr().err
    assert main([*command, "--wrench", "tool=/nowhere"]) == 2
    assert "'/nowhere'" in capsys.readouterr().err
