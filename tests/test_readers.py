"""Logs in the formats that people have them in, written here by other libraries than the ones that read them."""

import importlib
import json
import re

import numpy as np
import pytest
from log_files import (
    JOINTS,
    START,
    Maker,
    arrays,
    columns,
    joint_messages,
    write_bag,
    write_csv,
    write_dataset,
    write_parquet,
    write_plain_mcap,
)

from jax_inertia.logs.log import Log, LogError, TorqueKind, TorqueUnit
from jax_inertia.logs.log_files import read_log
from jax_inertia.logs.readers import Options, WrenchAxes, bag_collect


def assert_is(log: Log, data: dict, **close) -> None:
    assert log.joint_names == JOINTS
    for name, value in data.items():
        np.testing.assert_allclose(
            getattr(log, name), value, err_msg=name, **{"atol": 1e-12, **close}
        )


def refusal(path, options: Options | None = None, **rest) -> str:
    with pytest.raises(LogError) as caught:
        read_log(path, options=options, **rest)
    message = str(caught.value)
    assert message.isprintable()
    assert len(message) < 1500
    return message


def said(log: Log) -> str:
    return " | ".join(log.notes)


# --- CSV ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
def test_csv_reads_as_written(tmp_path, delimiter):
    log = read_log(write_csv(tmp_path / "log.csv", columns(), delimiter))
    assert_is(log, arrays(), rtol=0, atol=0)
    assert log.tau_unit is TorqueUnit.NEWTON_METRE
    assert "tau_unit is missing" in said(log)


def test_csv_written_by_pandas_with_an_index_and_holes(tmp_path):
    pandas = pytest.importorskip("pandas")
    frame = pandas.DataFrame(columns())
    frame.loc[5:8, "tau.knee"] = np.nan
    frame.to_csv(tmp_path / "log.csv")
    log = read_log(tmp_path / "log.csv")
    wanted = arrays()
    wanted["tau"][5:9, 1] = np.nan
    assert_is(log, wanted)


def test_csv_written_by_numpy(tmp_path):
    table = columns()
    heading = ",".join(table)
    np.savetxt(
        tmp_path / "log.csv", np.column_stack(list(table.values())), delimiter=",", header=heading
    )
    assert_is(read_log(tmp_path / "log.csv"), arrays())


def test_csv_with_everything_a_log_can_hold(tmp_path):
    table, rows = columns(), 60
    for name in ("base_pos", "base_linvel", "base_angvel"):
        table |= {f"{name}.{k}": np.full(rows, 1.0 + i) for i, k in enumerate("xyz")}
    table |= {f"base_quat.{k}": np.full(rows, v) for k, v in zip("wxyz", (1, 0, 0, 0), strict=True)}
    for k, part in enumerate(("fx", "fy", "fz", "mx", "my", "mz")):
        table |= {f"contact_wrench.l.foot.{part}": np.full(rows, 10.0 * k)}
    table |= {"sigma_tau.hip": np.full(rows, 0.1), "sigma_tau.knee": np.full(rows, 0.2)}
    table |= {
        "tau_unit": ["A (measured)"] * rows,
        "tau_kind": ["current"] * rows,
        "mode": ["run"] * rows,
    }
    log = read_log(write_csv(tmp_path / "log.csv", table))
    assert log.contact_bodies == ("l.foot",)
    np.testing.assert_array_equal(log.contact_wrench[3, 0], [0, 10, 20, 30, 40, 50])
    np.testing.assert_array_equal(log.base_linvel[3], [1, 2, 3])
    np.testing.assert_array_equal(log.sigma_tau, [0.1, 0.2])
    assert (log.tau_unit, log.tau_kind) == (TorqueUnit.AMPERE, TorqueKind.CURRENT)
    assert "'mode'" in said(log)


def test_csv_headings_with_units_are_converted(tmp_path):
    table = columns()
    table = {
        "time [ms]": 1e3 * table["time"],
        **{f"qpos.{j} [deg]": np.rad2deg(table[f"qpos.{j}"]) for j in JOINTS},
        **{f"qvel.{j} (deg/s)": np.rad2deg(table[f"qvel.{j}"]) for j in JOINTS},
        **{f"tau.{j} [mA]": table[f"tau.{j}"] for j in JOINTS},
    }
    log = read_log(write_csv(tmp_path / "log.csv", table))
    assert_is(log, arrays())
    assert log.tau_unit is TorqueUnit.MILLIAMPERE
    bad = {("qpos.hip [furlong]" if k == "qpos.hip [deg]" else k): v for k, v in table.items()}
    assert "qpos.hip is in 'furlong'; a unit here is one of rad, deg" in refusal(
        write_csv(tmp_path / "bad.csv", bad)
    )


def test_csv_with_names_of_its_own(tmp_path):
    table = {
        k.replace("qpos.", "q_").replace("tau.", "I_").replace("time", "t"): v
        for k, v in columns().items()
    }
    path = write_csv(tmp_path / "log.csv", table)
    assert "jax-inertia convert IN OUT --column 'time=t'" in refusal(path)
    given = {"time": "t"}
    assert "--column 'qpos.*=q_*'" in refusal(path, Options(columns=given))
    given |= {"qpos.*": "q_*", "tau.*": "I_*"}
    options = Options(columns=given, rename={"hip": "left_hip"}, tau_unit="A", tau_kind="current")
    log = read_log(path, options=options)
    assert log.joint_names == ("left_hip", "knee")
    assert log.tau_unit is TorqueUnit.AMPERE
    np.testing.assert_array_equal(log.qpos, arrays()["qpos"])
    for column, message in (
        ({"time": "tt"}, "did you mean 't'?"),
        ({"qpos.*": "q_hip"}, "both sides have one *"),
        ({"qpos.*": "Q_*"}, "the file has none such"),
        ({"torque.*": "I_*"}, "'torque.hip' is no column of a log"),
    ):
        assert message in refusal(path, Options(columns={**given, **column}))
    assert "no joint 'hipp' to rename" in refusal(
        path, Options(columns=given, rename={"hipp": "x"})
    )


def test_csv_names_what_is_wrong_with_its_columns(tmp_path):
    def without(*names, **more):
        return write_csv(
            tmp_path / "log.csv", {k: v for k, v in (columns() | more).items() if k not in names}
        )

    assert "no column time" in refusal(without("time"))
    assert "no column tau.<joint>" in refusal(without("tau.hip", "tau.knee"))
    assert "tau.kne has no qpos.kne with it; did you mean 'knee'?" in refusal(
        without("tau.knee", **{"tau.kne": np.zeros(60)})
    )
    assert "base_pos.z is missing" in refusal(
        without(**{"base_pos.x": np.zeros(60), "base_pos.y": np.zeros(60)})
    )
    assert "sigma_tau changes over time" in refusal(
        without(**{"sigma_tau.hip": np.arange(60), "sigma_tau.knee": np.arange(60)})
    )
    log = read_log(without("tau.knee", "qvel.knee"))
    assert log.joint_names == ("hip",)
    assert "without torque: knee" in said(log)
    assert "topic_joints does not apply to a CSV file" in refusal(
        without(), Options(topic_joints="/x")
    )


def test_a_csv_longer_than_a_block_reads_whole(tmp_path, monkeypatch):
    monkeypatch.setattr(
        importlib.import_module("jax_inertia.logs.readers.delimited"), "_BLOCK", 1000
    )
    table = columns(500)
    table["tau.hip"] = [("" if k % 97 == 3 else float(v)) for k, v in enumerate(table["tau.hip"])]
    log = read_log(write_csv(tmp_path / "log.csv", table))
    wanted = arrays(500)
    wanted["tau"][3::97, 0] = np.nan
    assert_is(log, wanted)


# --- a robot's joints --------------------------------------------------------------------------------------------


class Robot:
    joint_names = ("base", "hip", "knee")
    joint_type = ("free", "hinge", "hinge")


def test_joints_that_the_model_lacks_are_left_out_only_where_its_own_are_all_there(tmp_path):
    table = columns() | {"qpos.gripper": np.zeros(60), "tau.gripper": np.zeros(60)}
    table = {k: v for k, v in table.items() if not k.startswith("qvel")}
    log = read_log(write_csv(tmp_path / "log.csv", table), names=Robot())
    assert log.joint_names == JOINTS
    assert "not in the model: gripper" in said(log)
    table = {k.replace("knee", "kneee"): v for k, v in table.items()}
    log = read_log(write_csv(tmp_path / "log.csv", table), names=Robot())
    assert log.joint_names == ("hip", "kneee", "gripper")


# --- Parquet -----------------------------------------------------------------------------------------------------


@pytest.fixture
def arrow():
    return pytest.importorskip("pyarrow")


def test_parquet_reads_as_written(tmp_path, arrow):
    path = write_parquet(
        tmp_path / "log.parquet", columns(), {"tau_unit": "A", "tau_kind": "current"}
    )
    log = read_log(path)
    assert_is(log, arrays(), rtol=0, atol=0)
    assert (log.tau_unit, log.tau_kind) == (TorqueUnit.AMPERE, TorqueKind.CURRENT)


def test_parquet_written_by_pandas(tmp_path, arrow):
    pandas = pytest.importorskip("pandas")
    frame = pandas.DataFrame(columns()).astype({"tau.hip": "float32"})
    frame["time"] = pandas.to_datetime(START + np.round(1e9 * frame["time"]).astype("int64"))
    frame["tau_unit"], frame["tau_kind"] = "N m", "sensor"
    frame.to_parquet(tmp_path / "log.parquet")
    log = read_log(tmp_path / "log.parquet")
    np.testing.assert_allclose(log.time - log.time[0], arrays()["time"], atol=1e-6)
    np.testing.assert_allclose(log.tau, arrays()["tau"], atol=1e-6)
    assert log.tau_kind is TorqueKind.SENSOR


def test_parquet_of_lists_wants_names(tmp_path, arrow):
    path = write_parquet(tmp_path / "log.parquet", arrays())
    assert "lists of 2; name their joints with --joints" in refusal(path)
    assert_is(read_log(path, options=Options(joints=JOINTS)), arrays())
    assert "2 values in a row for 3 joints" in refusal(path, Options(joints=("a", "b", "c")))
    assert "holds text" in refusal(
        write_parquet(tmp_path / "text.parquet", columns() | {"tau.hip": np.array(["x"] * 60)})
    )


def test_a_lerobot_dataset_with_all_episodes_in_one_file(tmp_path, arrow):
    folder = write_dataset(tmp_path / "set")
    assert "holds several episodes (0, 1 ...); choose one with --episode" in refusal(folder)
    assert "no rows of episode 7" in refusal(folder, Options(episode=7))
    log = read_log(folder, options=Options(episode=1))
    data = arrays()
    moved = {"qpos": data["qpos"] + 1, "tau": data["tau"], "time": data["time"]}
    assert_is(log, moved, atol=1e-5)
    np.testing.assert_allclose(log.qpos_target, data["qpos"] + 0.5, atol=1e-5)


def test_a_lerobot_dataset_with_a_file_for_each_episode(tmp_path, arrow):
    folder, data = write_dataset(tmp_path / "set", one_file=False), arrays()
    assert_is(read_log(folder, options=Options(episode=1)), {"qpos": data["qpos"] + 1}, atol=1e-5)
    file = min(folder.rglob("*.parquet"))
    log = read_log(file, options=Options(degrees=True))
    np.testing.assert_allclose(log.qpos, np.deg2rad(data["qpos"]), atol=1e-5)


def test_lerobot_without_torque_says_what_there_is(tmp_path, arrow):
    data = arrays()
    table = {"observation.state": data["qpos"], "timestamp": data["time"]}
    message = refusal(write_parquet(tmp_path / "log.parquet", table))
    assert "no torque (observation.effort) and no targets (action)" in message
    assert "--column tau=NAME or qpos_target=NAME; it has observation.state" in message
    path = write_parquet(tmp_path / "told.parquet", table | {"action": data["qpos"]})
    log = read_log(path, options=Options(joints=JOINTS))
    assert log.tau is None
    np.testing.assert_array_equal(log.qpos_target, data["qpos"])
    options = Options(columns={"tau": "action"}, joints=JOINTS)
    assert read_log(path, options=options).tau.shape == (60, 2)


def test_lerobot_names_of_other_shapes(tmp_path, arrow):
    folder = write_dataset(tmp_path / "set", episodes=1)
    info = folder / "meta" / "info.json"
    for names in (list(JOINTS), {"hip": 0, "knee": 1}):
        info.write_text(json.dumps({"features": {"observation.state": {"names": names}}}))
        assert read_log(folder).joint_names == JOINTS
    for text in ('{"features": [1]}', '{"features": {"observation.state": {"names": [1, 2]}}}'):
        info.write_text(text)
        assert "name their joints" in refusal(folder)
    info.write_text("[" * 100_000)
    assert "info.json cannot be read" in refusal(folder)


# --- ROS ---------------------------------------------------------------------------------------------------------


@pytest.fixture
def ros():
    pytest.importorskip("mcap")
    return pytest.importorskip("rosbags")


KINDS = [
    ("log.bag", "bag", ""),
    ("log.bag", "bag", "LZ4"),
    ("log.bag", "bag", "BZ2"),
    ("log", "db3", ""),
    ("log", "mcap", ""),
    ("log", "mcap", "STORAGE"),
]


@pytest.mark.parametrize(("name", "kind", "compression"), KINDS)
def test_joint_states_of_every_kind_of_bag(tmp_path, ros, name, kind, compression):
    path = write_bag(tmp_path / name, joint_messages(kind == "bag"), kind, compression)
    log = read_log(path)
    assert_is(log, arrays(), atol=1e-9)
    assert "time counts from 1700000000.123456789 s" in said(log)
    if path.is_dir():
        (inner,) = [p for p in path.iterdir() if p.suffix != ".yaml"]
        assert_is(read_log(inner), arrays(), atol=1e-9)


@pytest.mark.parametrize("compression", ["none", "lz4", "zstd"])
def test_mcap_by_its_own_library(tmp_path, ros, compression):
    path = write_plain_mcap(tmp_path / "log.mcap", joint_messages(), compression)
    assert_is(read_log(path), arrays(), atol=1e-9)


def test_names_in_another_order_and_stamps_that_jump(tmp_path, ros):
    messages = joint_messages()
    for k in range(1, 60, 2):
        _, state, _ = messages[k]
        state.name.reverse()
        for field in ("position", "velocity", "effort"):
            setattr(state, field, getattr(state, field)[::-1].copy())
    messages[10], messages[11] = messages[11], messages[10]
    messages.append(messages[-1])
    log = read_log(write_bag(tmp_path / "log", messages, "mcap"))
    assert_is(log, arrays(), atol=1e-9)
    assert "were sorted" in said(log)
    assert "1 joint states on /joint_states repeat a stamp" in said(log)


def test_several_publishers_come_onto_the_stamps_of_the_largest(tmp_path, ros):
    maker, messages = Maker(), joint_messages()
    for k in range(25):
        stamp = START + k * 20_000_000 + 5_000_000
        at = (k * 0.02 + 0.005,)
        messages.append(
            ("/joint_states", maker.joints(stamp, ("grip",), at, (1.0,), (2.0 * at[0],)), stamp)
        )
    log = read_log(write_bag(tmp_path / "log", messages, "db3"))
    assert log.joint_names == ("hip", "knee", "grip")
    inside = (log.time >= 0.005) & (log.time <= 0.485)
    np.testing.assert_allclose(log.qpos[inside, 2], log.time[inside], atol=1e-9)
    np.testing.assert_allclose(log.tau[inside, 2], 2 * log.time[inside], atol=1e-9)
    assert np.isnan(log.qpos[~inside, 2]).all()
    assert "interpolated linearly onto the stamps of the joint states; 12 of 60 rows" in said(log)


@pytest.mark.parametrize("kind", ["bag", "mcap"])
def test_odometry_and_wrenches_have_stamps_of_their_own(tmp_path, ros, kind):
    """At 40 Hz, 7 ms off; a base that turns about z at 1 rad/s and moves along its own x, which the world sees turn."""
    ros1 = kind == "bag"
    maker, messages = Maker(ros1), joint_messages(ros1)
    for k in range(26):
        at = k * 0.025 - 0.007
        stamp = START + round(at * 1e9)
        # The same attitude with either sign.
        quat = np.array([np.cos(at / 2), 0, 0, np.sin(at / 2)]) * (-1) ** k
        messages.append(
            ("/odom", maker.odometry(stamp, (at, 0, 1), quat, (0.5, 0, 0), (0, 0, 1)), stamp)
        )
        messages.append(("/ft", maker.wrench(stamp, (at, 2, 3), (4, 5, 6)), stamp))
    path = write_bag(tmp_path / ("log.bag" if ros1 else "log"), messages, kind)
    plain = read_log(path)
    assert plain.base_pos is None
    assert "/odom (nav_msgs/msg/Odometry)" in said(plain)
    options = Options(topic_base="/odom", topic_wrenches={"foot": "/ft"})
    log = read_log(path, options=options)
    t = log.time
    np.testing.assert_allclose(log.base_pos[:, 0], t, atol=1e-8)
    wanted = np.stack([np.cos(t / 2), 0 * t, 0 * t, np.sin(t / 2)], axis=-1)
    np.testing.assert_allclose(log.base_quat * np.sign(log.base_quat[:, :1]), wanted, atol=1e-4)
    np.testing.assert_allclose(np.linalg.norm(log.base_quat, axis=1), 1, atol=1e-12)
    turned = 0.5 * np.stack([np.cos(t), np.sin(t), 0 * t], axis=-1)
    np.testing.assert_allclose(log.base_linvel, turned, atol=2e-4)
    np.testing.assert_allclose(log.base_angvel, np.tile([0, 0, 1], (60, 1)), atol=1e-12)
    assert log.contact_bodies == ("foot",)
    np.testing.assert_allclose(log.contact_wrench[:, 0, 0], t, atol=1e-8)
    np.testing.assert_allclose(log.contact_wrench[:, 0, 1:], np.tile([2, 3, 4, 5, 6], (60, 1)))
    flipped = read_log(path, options=Options(topic_wrenches={"foot": "/ft"}, flip_wrenches=True))
    np.testing.assert_allclose(flipped.contact_wrench, -log.contact_wrench)


def test_bags_say_what_is_missing(tmp_path, ros):
    maker = Maker()
    states = joint_messages()
    wrench = ("/ft", maker.wrench(START, (0, 0, 0), (0, 0, 0), "ft_link"), START)
    path = write_bag(tmp_path / "log", [*states, wrench], "mcap")
    assert "on topic '/joint_state'; did you mean '/joint_states'?" in refusal(
        path, Options(topic_joints="/joint_state")
    )
    assert "no nav_msgs/msg/Odometry on topic '/odom'; the bag has none" in refusal(
        path, Options(topic_base="/odom")
    )
    assert "axes of 'ft_link', not of the world; give --wrench-axes body" in refusal(
        path, Options(topic_wrenches={"foot": "/ft"})
    )
    body = Options(topic_wrenches={"foot": "/ft"}, wrench_axes=WrenchAxes.BODY)
    assert "axes of their bodies" in said(read_log(path, options=body))
    assert "episode does not apply to a bag" in refusal(path, Options(episode=1))

    both = write_bag(tmp_path / "both", [*states, *joint_messages(topic="/other")], "mcap")
    assert "on several topics, /joint_states, /other; choose with --topic-joints" in refusal(both)
    assert read_log(both, options=Options(topic_joints="/other")).joint_names == JOINTS

    assert "no sensor_msgs/msg/JointState; the bag has /ft" in refusal(
        write_bag(tmp_path / "none", [wrench], "db3")
    )
    for _, state, _ in states:
        state.effort = np.zeros(0)
    assert "hip, knee hold no effort" in refusal(write_bag(tmp_path / "dumb", states, "mcap"))
    for _, state, _ in states:
        state.effort, state.velocity = np.zeros(2), np.zeros(0)
    assert "qvel is left out" in said(read_log(write_bag(tmp_path / "still", states, "mcap")))


def test_messages_without_stamps_have_the_time_of_recording(tmp_path, ros):
    messages = joint_messages()
    for _, state, _ in messages:
        state.header.stamp.sec = state.header.stamp.nanosec = 0
    log = read_log(write_bag(tmp_path / "log", messages, "mcap"))
    np.testing.assert_allclose(log.time, arrays()["time"], atol=1e-9)
    assert "60 messages without a stamp" in said(log)


def test_a_gap_in_the_odometry_is_not_bridged(tmp_path, ros):
    maker, messages = Maker(), joint_messages()
    for k in range(60):
        if 20 < k < 40:
            continue
        stamp = START + k * 10_000_000
        messages.append(
            ("/odom", maker.odometry(stamp, (0, 0, 1), (1, 0, 0, 0), (0, 0, 0), (0, 0, 0)), stamp)
        )
    log = read_log(
        write_bag(tmp_path / "log", messages, "mcap"), options=Options(topic_base="/odom")
    )
    bare = np.flatnonzero(np.isnan(log.base_pos[:, 0]))
    np.testing.assert_array_equal(bare, np.arange(21, 40))


# --- what is not there -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["log.parquet", "log.bag", "log.mcap", "log.db3"])
def test_a_missing_extra_is_one_line_with_the_command(tmp_path, monkeypatch, name):
    def absent(module):
        raise ImportError(module)

    (tmp_path / name).write_bytes(b"x")
    bag_collect._typestores.cache_clear()
    monkeypatch.setattr("jax_inertia.logs.readers.options.importlib.import_module", absent)
    assert re.search(r"pip install \w+, .* pip install '\.\[readers\]'", refusal(tmp_path / name))
