"""Logs as spreadsheets, loggers without ROS and datasets write them: read with a note, or refused in one line."""

import importlib
import json
from pathlib import Path

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
    write_parquet,
)

from jax_inertia.cli.main import main
from jax_inertia.logs.chunks import read_chunks
from jax_inertia.logs.log import Log, LogError, TorqueKind, TorqueUnit
from jax_inertia.logs.log_files import read_log, write_log
from jax_inertia.logs.readers import Options
from jax_inertia.logs.readers.stamps import guess
from jax_inertia.logs.unwrap import unwrapped

CASES = Path(__file__).parents[2] / "shared" / "cases"


def refusal(path, options: Options | None = None, **rest) -> str:
    with pytest.raises(LogError) as caught:
        read_log(path, options=options, **rest)
    assert str(caught.value).isprintable()
    return str(caught.value)


def said(log: Log) -> str:
    return " | ".join(log.notes)


class Robot:
    """A model's joints, as a reader asks for them."""

    def __init__(self, *names: str, kind: str = "hinge") -> None:
        self.joint_names = names
        self.joint_type = (kind,) * len(names)


def smooth(samples: int = 400, rate: float = 200.0) -> dict[str, np.ndarray]:
    """Angles, their rates and torques of a slow motion, with its stamps [s]."""
    time = np.arange(samples) / rate
    phase = np.array([1.0, 2.3]) * time[:, None]
    return {"time": time, "qpos": np.sin(phase), "qvel": np.array([1.0, 2.3]) * np.cos(phase)}


# --- tables ------------------------------------------------------------------------------------------------------


def german(path: Path, table: dict, delimiter: str = ";", encoding: str = "utf-8") -> Path:
    """A table as a spreadsheet with German settings writes it."""
    rows = [delimiter.join(table)]
    for row in zip(*(np.asarray(v).tolist() for v in table.values()), strict=True):
        rows.append(delimiter.join(repr(x).replace(".", ",") for x in row))
    path.write_bytes("\r\n".join(rows).encode(encoding))
    return path


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
@pytest.mark.parametrize("delimiter", [";", "\t"])
def test_decimal_commas(tmp_path, delimiter, encoding):
    log = read_log(german(tmp_path / "log.csv", columns(), delimiter, encoding))
    for name, value in arrays().items():
        np.testing.assert_array_equal(getattr(log, name), value)
    assert "decimal commas" in said(log)
    parts = list(read_chunks(tmp_path / "log.csv", rows=20))
    np.testing.assert_array_equal(np.concatenate([p.tau for p in parts]), arrays()["tau"])


def test_windows_1252_where_a_degree_is_one_byte(tmp_path):
    table = columns()
    table = {k + " [°]" * k.startswith("qpos."): v for k, v in table.items()}
    log = read_log(german(tmp_path / "log.csv", table, encoding="cp1252"))
    np.testing.assert_allclose(log.qpos, np.deg2rad(arrays()["qpos"]))
    assert "Windows-1252" in said(log)


def test_quoted_decimal_commas_between_commas(tmp_path):
    rows = ["time,qpos.a,tau.a"] + [f'"0,{k:02d}","{k},5",{k}' for k in range(20)]
    (tmp_path / "log.csv").write_text("\n".join(rows))
    log = read_log(tmp_path / "log.csv")
    np.testing.assert_allclose(log.qpos[:, 0], np.arange(20) + 0.5)


def test_thousands_separators_are_no_decimal_marks(tmp_path):
    rows = ["time;qpos.a;tau.a"] + [f"{k};1.5;1,234" for k in range(20)]
    (tmp_path / "log.csv").write_text("\n".join(rows))
    assert "line 2, column 'tau.a': '1,234', but numbers before it have a decimal point" in refusal(
        tmp_path / "log.csv"
    )
    (tmp_path / "log.csv").write_text("time;qpos.a;tau.a\n0;1.234,5;1\n1;2;3")
    assert "'1.234,5' is no number" in refusal(tmp_path / "log.csv")
    # Commas of a column that is not read are of no matter.
    rows = ["time;qpos.a;tau.a;remark"] + [f"{0.1 * k};1.5;2.5;so, la" for k in range(20)]
    (tmp_path / "log.csv").write_text("\n".join(rows))
    assert "decimal" not in said(read_log(tmp_path / "log.csv"))


@pytest.mark.parametrize(("unit", "factor"), [("ms", 1e3), ("us", 1e6), ("ns", 1e9)])
@pytest.mark.parametrize("start", [0.0, 1.7e9])
def test_units_of_stamps(tmp_path, unit, factor, start):
    data = smooth()
    table = {"time": np.round((start + data["time"]) * factor)}
    table |= {"qpos.a": data["qpos"][:, 0], "tau.a": data["qpos"][:, 0]}
    path = write_csv(tmp_path / "log.csv", table)
    log = read_log(path)
    np.testing.assert_allclose(np.diff(log.time), 0.005, rtol=0, atol=1e-6)
    assert f"stamps in {unit} were turned into seconds (a guess" in said(log)
    given = read_log(path, options=Options(time_unit=unit))
    np.testing.assert_array_equal(given.time, log.time)
    assert "guess" not in said(given)
    parts = list(read_chunks(path, rows=90))
    np.testing.assert_array_equal(np.concatenate([p.time for p in parts]), log.time)


def test_stamps_of_which_velocities_say_the_unit():
    data = smooth(rate=1000.0)
    milliseconds = data["time"] * 1e3
    # One sample a second, or a thousand: without velocities nobody can tell.
    assert guess(milliseconds, data["qpos"]) is None
    assert guess(milliseconds, data["qpos"], data["qvel"]) == "ms"
    assert guess(milliseconds, data["qpos"], 1e-3 * data["qvel"]) is None
    assert guess(data["time"], data["qpos"], data["qvel"]) is None
    # A log of one sample in three seconds that moves: in ms its joints would be impossibly fast.
    rng = np.random.default_rng(0)
    assert guess(3.0 * np.arange(50), rng.uniform(-3, 3, (50, 2))) is None


def test_a_log_of_one_sample_a_second_is_not_written(tmp_path, capsys):
    time = np.arange(12000.0)
    angle = np.random.default_rng(0).normal(size=12000)
    path = write_csv(tmp_path / "log.csv", {"time": time, "qpos.a": angle, "tau.a": angle})
    assert main(["convert", str(path), str(tmp_path / "out.npz")]) == 2
    assert "median period is 1 s" in (error := capsys.readouterr().err)
    assert "--time-unit" in error
    assert not (tmp_path / "out.npz").exists()
    assert main(["convert", str(path), str(tmp_path / "out.npz"), "--time-unit", "ms"]) == 0
    assert read_log(tmp_path / "out.npz").rate == pytest.approx(1000.0)


def test_npz_in_milliseconds_wants_the_option(tmp_path):
    data = smooth()
    stamps = 1.7e12 + 1e3 * data["time"]
    np.savez(
        tmp_path / "log.npz", time=stamps, qpos=data["qpos"], tau=data["qpos"], joint_names=JOINTS
    )
    assert "expected seconds" in refusal(tmp_path / "log.npz")
    log = read_log(tmp_path / "log.npz", options=Options(time_unit="ms"))
    assert log.rate == pytest.approx(200.0, rel=1e-3)


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_headings_twice_are_one_line(tmp_path, suffix):
    if suffix == ".csv":
        (tmp_path / "log.csv").write_text("time,qpos.a,qpos.a,tau.a\n0,1,2,3\n1,2,3,4\n")
    else:
        pa, pq = pytest.importorskip("pyarrow"), importlib.import_module("pyarrow.parquet")
        columns = [pa.array([0.0, 1.0])] * 4
        table = pa.Table.from_arrays(columns, names=["time", "qpos.a", "qpos.a", "tau.a"])
        pq.write_table(table, tmp_path / "log.parquet")
    assert "two columns are named 'qpos.a'; keep one" in refusal(tmp_path / f"log{suffix}")


# --- angles ------------------------------------------------------------------------------------------------------


def turning(samples: int = 600) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Stamps, angles over several turns and their rates."""
    time = np.arange(samples) * 0.01
    return time, 4.0 * time + np.sin(time), 4.0 + np.cos(time)


def wrap(x: np.ndarray) -> np.ndarray:
    return (x + np.pi) % (2 * np.pi) - np.pi


@pytest.mark.parametrize("velocities", [True, False])
def test_wrapped_angles_are_laid_end_to_end(velocities):
    time, angle, rate = turning()
    laid, jumps = unwrapped(time, wrap(angle), rate if velocities else None)
    np.testing.assert_allclose(laid, angle, atol=1e-9)
    assert jumps == np.sum(np.abs(np.diff(wrap(angle))) > 3)
    holes = wrap(angle)
    holes[::7] = np.nan
    np.testing.assert_allclose(unwrapped(time, holes, None)[0][1::7], angle[1::7], atol=1e-9)


def test_jumps_that_are_no_turns_stay():
    time, angle, rate = turning()
    for jump in (2 * np.pi + 0.3, np.pi, 5.0):
        broken = angle * 0.1 + jump * (time > 3)
        laid, jumps = unwrapped(time, broken, rate * 0.1)
        assert jumps == 0
        np.testing.assert_array_equal(laid, broken)


def test_a_model_s_hinges_are_unwrapped_and_its_slides_are_not(tmp_path):
    time, angle, rate = turning()
    log = Log(
        time=time,
        joint_names=("a",),
        qpos=wrap(angle)[:, None],
        qvel=rate[:, None],
        tau=np.cos(angle)[:, None],
        qpos_target=wrap(angle + 0.01)[:, None],
    )
    write_log(log, tmp_path / "log.csv")
    read = read_log(tmp_path / "log.csv", names=Robot("a"))
    np.testing.assert_allclose(read.qpos[:, 0], angle, atol=1e-9)
    np.testing.assert_allclose(read.qpos_target - read.qpos, 0.01, atol=1e-9)
    assert "wrapped at a whole turn were laid end to end: a (" in said(read)
    parts = list(read_chunks(tmp_path / "log.csv", rows=80, names=Robot("a")))
    np.testing.assert_allclose(np.concatenate([p.qpos[:, 0] for p in parts]), angle, atol=1e-9)
    slide = read_log(tmp_path / "log.csv", names=Robot("a", kind="slide"))
    np.testing.assert_array_equal(slide.qpos, log.qpos)


# --- MCAP without ROS --------------------------------------------------------------------------------------------


def write_mcap(path: Path, messages, encoding: str, schema: str, data: bytes = b"") -> Path:
    """Messages (topic, bytes, time) by mcap's own writer."""
    writer_of = pytest.importorskip("mcap.writer").Writer
    with open(path, "wb") as file:
        writer = writer_of(file)
        writer.start()
        kind = {"json": "jsonschema"}.get(encoding, encoding)
        number = writer.register_schema(schema, kind, data)
        channels = {
            t: writer.register_channel(t, encoding, number) for t in {m[0] for m in messages}
        }
        for topic, content, stamp in messages:
            writer.add_message(channels[topic], stamp, content, stamp)
        writer.finish()
    return path


def json_messages(form: str) -> list:
    data, out = arrays(), []
    for k, at in enumerate(data["time"]):
        stamp = START + round(at * 1e9)
        values = {
            "position": data["qpos"][k].tolist(),
            "velocity": data["qvel"][k].tolist(),
            "effort": data["tau"][k].tolist(),
        }
        if form == "ros":
            head = {"stamp": {"sec": stamp // 10**9, "nsec": stamp % 10**9}}
            message = {"header": head, "name": list(JOINTS), **values}
        elif form == "flat":
            message = {"timestamp": stamp, "names": list(JOINTS), **values}
        else:
            each = (
                {"name": n} | {f: v[i] for f, v in values.items()} for i, n in enumerate(JOINTS)
            )
            message = {"joints": list(each)}
        out.append(("/joints", json.dumps(message).encode(), stamp))
    return out


@pytest.mark.parametrize("schema", ["sensor_msgs/JointState", "JointState", "acme.JointStates"])
@pytest.mark.parametrize("form", ["ros", "flat", "objects"])
def test_mcap_with_json(tmp_path, schema, form):
    log = read_log(write_mcap(tmp_path / "log.mcap", json_messages(form), "json", schema))
    for name, value in arrays().items():
        np.testing.assert_allclose(getattr(log, name), value, atol=1e-9, err_msg=name)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"{", "cannot be decoded"),
        (b"[1]", "no object"),
        (b'{"name": 3}', "name that is no list"),
        (b'{"name": ["a"], "position": ["1"]}', "position that is no list"),
        (b'{"name": ["a"], "position": [1, 2]}', "1 names but 2 values of position"),
        (b"[" * 100_000, "cannot be decoded"),
        (b'{"name": ["a"], "position": [1' + b"0" * 400 + b"]}", "cannot be decoded"),
        (b"{}", "name no joints"),
    ],
)
def test_json_made_to_hurt(tmp_path, content, words):
    path = write_mcap(tmp_path / "log.mcap", [("/j", content, 1)] * 2, "json", "JointState")
    assert words in refusal(path)


def test_a_topic_of_another_name_is_taken_when_asked_for(tmp_path):
    path = write_mcap(tmp_path / "log.mcap", json_messages("ros"), "json", "Telemetry")
    assert "no sensor_msgs/msg/JointState; the bag has /joints (Telemetry)" in refusal(path)
    assert read_log(path, options=Options(topic_joints="/joints")).joint_names == JOINTS
    base = Options(topic_joints="/joints", topic_base="/base")
    pose = [("/base", b'{"header": {}}', START)]
    path = write_mcap(tmp_path / "base.mcap", [*json_messages("ros"), *pose], "json", "Telemetry")
    assert "a message on /base is not like nav_msgs/msg/Odometry" in refusal(path, base)


PROTO = """
syntax = "proto3"; package acme;
message Joint { string name = 1; double position = 2; float velocity = 3; double effort = 4; }
message Time { int64 seconds = 1; int32 nanos = 2; }
message JointStates { Time timestamp = 1; repeated Joint joints = 2; }
message JointState { Time stamp = 1; repeated string name = 2; repeated double position = 3;
  repeated float velocity = 4; repeated double effort = 5; sint32 offset = 6; }
"""


def proto_classes():
    """The messages of PROTO by protobuf's own library, and their descriptors as a file holds them."""
    descriptor = pytest.importorskip("google.protobuf.descriptor_pb2")
    pool = importlib.import_module("google.protobuf.descriptor_pool").DescriptorPool()
    factory = importlib.import_module("google.protobuf.message_factory")
    kinds = {"double": 1, "float": 2, "int64": 3, "int32": 5, "string": 9, "sint32": 17}
    file = descriptor.FileDescriptorProto(name="acme.proto", package="acme", syntax="proto3")
    for text in PROTO.split("message ")[1:]:
        name, body = text.split("{")
        message = file.message_type.add(name=name.strip())
        for field in filter(None, (f.split() for f in body.split("}")[0].split(";"))):
            label = 3 if field[0] == "repeated" else 1
            kind, word, _, number = field[-4:]
            made = message.field.add(name=word, number=int(number), label=label)
            made.type = kinds.get(kind, 11)
            if kind not in kinds:
                made.type_name = f".acme.{kind}"
    pool.Add(file)
    found = {
        name: factory.GetMessageClass(pool.FindMessageTypeByName(f"acme.{name}"))
        for name in ("JointState", "JointStates")
    }
    return found, descriptor.FileDescriptorSet(file=[file]).SerializeToString()


@pytest.mark.parametrize("name", ["JointState", "JointStates"])
def test_mcap_with_protobuf(tmp_path, name):
    classes, descriptors = proto_classes()
    data, messages = arrays(), []
    # A zero is left out of the message, and must come back.
    data["qpos"][3, 0] = 0.0
    for k, at in enumerate(data["time"]):
        stamp = START + round(at * 1e9)
        message = classes[name]()
        when = message.stamp if name == "JointState" else message.timestamp
        when.seconds, when.nanos = stamp // 10**9, stamp % 10**9
        values = [data[x][k] for x in ("qpos", "qvel", "tau")]
        if name == "JointState":
            message.name.extend(JOINTS)
            message.offset = -5
            for field, value in zip(("position", "velocity", "effort"), values, strict=True):
                getattr(message, field).extend(value)
        else:
            for i, joint in enumerate(JOINTS):
                p, v, e = (value[i] for value in values)
                message.joints.add(name=joint, position=p, velocity=v, effort=e)
        messages.append(("/joints", message.SerializeToString(), 1))
    path = write_mcap(tmp_path / "log.mcap", messages, "protobuf", f"acme.{name}", descriptors)
    log = read_log(path)
    for key, value in data.items():
        tolerance = 1e-6 if key == "qvel" else 1e-9
        np.testing.assert_allclose(getattr(log, key), value, atol=tolerance, err_msg=key)


def test_protobuf_made_to_hurt(tmp_path):
    rng = np.random.default_rng(0)
    path = tmp_path / "log.mcap"
    write_mcap(
        path, [("/j", b"\x0a\xff\xff\xff\xff\x0f", 1)], "protobuf", "a.JointState", b"\x0a\x02"
    )
    assert "cut off" in refusal(path)
    for _ in range(50):
        data, types = rng.bytes(40), rng.bytes(60)
        write_mcap(path, [("/j", data, 1)], "protobuf", "a.JointState", types)
        refusal(path)


# --- several topics ----------------------------------------------------------------------------------------------


def test_joint_states_of_several_topics_are_put_together(tmp_path):
    pytest.importorskip("rosbags")
    maker, data = Maker(), arrays()
    messages = []
    for k, at in enumerate(data["time"]):
        stamp = START + round(at * 1e9)
        for j, joint in enumerate(JOINTS):
            one = [data[x][k, j : j + 1] for x in ("qpos", "qvel", "tau")]
            messages.append((f"/arm{j}", maker.joints(stamp, (joint,), *one), stamp))
        command = maker.joints(stamp, JOINTS, data["qpos"][k] + 1)
        messages.append(("/command", command, stamp))
    log = read_log(write_bag(tmp_path / "log", messages, "mcap"))
    order = [log.joint_names.index(name) for name in JOINTS]
    np.testing.assert_allclose(log.tau[:, order], data["tau"])
    assert "joints of several topics were put together: /arm0, /arm1" in said(log)
    assert "targets are those of /command" in said(log)
    np.testing.assert_allclose(log.qpos_target[:, order], data["qpos"] + 1)
    one = read_log(tmp_path / "log", options=Options(topic_joints=("/arm1",)))
    assert one.joint_names == JOINTS[1:]

    twice = [*joint_messages(), *joint_messages(topic="/again"), *joint_messages(topic="/more")]
    path = write_bag(tmp_path / "twice", twice, "mcap")
    assert "several topics, /again, /joint_states, /more; choose with --topic-joints" in refusal(
        path
    )


# --- LeRobot -----------------------------------------------------------------------------------------------------


def dataset(folder: Path, table: dict, names: dict, version: str = "v3.0") -> Path:
    """A dataset of one episode."""
    (folder / "meta").mkdir(parents=True)
    features = {key: {"names": value} for key, value in names.items()}
    info = {"codebase_version": version, "features": features}
    (folder / "meta" / "info.json").write_text(json.dumps(info))
    rows = len(table["timestamp"])
    file = "file-000.parquet" if version == "v3.0" else "episode_000000.parquet"
    write_parquet(
        folder / "data" / "chunk-000" / file, {**table, "episode_index": np.zeros(rows, int)}
    )
    return folder


def two_arms(folder: Path, version: str) -> Path:
    data = arrays()
    state = np.hstack([data["qpos"], data["qpos"] + 1])
    table = {
        "timestamp": data["time"],
        "observation.state": state,
        "action": state[:, ::-1],
        # Columns of an arm each, the joints in another order than the state has them.
        "observation.torque.left": data["tau"][:, ::-1],
        "observation.torque.right": 2 * data["tau"],
    }
    both = [f"{side}_{joint}.pos" for side in ("left", "right") for joint in JOINTS]
    names = {
        "observation.state": both if version == "v3.0" else {"motors": both},
        "action": both[::-1],
        "observation.torque.left": ["left_knee.torque", "left_hip.torque"],
        "observation.torque.right": ["right_hip", "right_knee"],
    }
    return dataset(folder, table, names, version)


@pytest.mark.parametrize("version", ["v2.1", "v3.0"])
def test_torques_of_two_arms_go_by_name(tmp_path, version):
    pytest.importorskip("pyarrow")
    path, data = two_arms(tmp_path / "set", version), arrays()
    both = read_log(path)
    assert both.joint_names == ("left_hip", "left_knee", "right_hip", "right_knee")
    np.testing.assert_allclose(both.tau, np.hstack([data["tau"], 2 * data["tau"]]))
    np.testing.assert_allclose(both.qpos_target, both.qpos)
    assert "tau from observation.torque.left, observation.torque.right" in said(both)
    asked = Options(columns={"tau": ("observation.torque.right", "observation.torque.left")})
    np.testing.assert_array_equal(read_log(path, options=asked).tau, both.tau)
    left = Options(columns={"tau": "observation.torque.left"})
    one = read_log(path, options=left, names=Robot(*JOINTS))
    assert one.joint_names == JOINTS
    np.testing.assert_allclose(one.tau, data["tau"])
    assert "by other names: left_hip is hip, left_knee is knee" in said(one)
    # Both arms fit the model then, and nobody knows which it is of.
    assert read_log(path, names=Robot(*JOINTS)).joint_names == both.joint_names


def test_an_action_that_is_of_no_joint_is_left_out(tmp_path):
    pytest.importorskip("pyarrow")
    data = arrays()
    table = {
        "timestamp": data["time"],
        "observation.state": data["qpos"],
        "observation.effort": data["tau"],
        "action": np.zeros((len(data["time"]), 3)),
    }
    names = {"observation.state": list(JOINTS), "action": ["x", "y", "z"]}
    log = read_log(dataset(tmp_path / "set", table, names))
    assert log.qpos_target is None
    assert "left out, not of the joints: action" in said(log)


def test_currents_are_never_newton_metres(tmp_path):
    pytest.importorskip("pyarrow")
    data = arrays()
    table = {
        "timestamp": data["time"],
        "observation.state": data["qpos"],
        "observation.current": data["tau"],
    }
    path = dataset(tmp_path / "set", table, {"observation.state": list(JOINTS)})
    log = read_log(path)
    assert (log.tau_kind, log.tau_unit) == (TorqueKind.CURRENT, TorqueUnit.UNKNOWN)
    assert "'observation.current' holds currents" in said(log)
    assert read_log(path, options=Options(tau_unit="mA")).tau_unit is TorqueUnit.MILLIAMPERE
    renamed = {k.replace("tau", "current"): v for k, v in columns().items()}
    asked = Options(columns={"tau.*": "current.*"})
    csv = write_csv(tmp_path / "log.csv", renamed)
    assert read_log(csv, options=asked).tau_unit is TorqueUnit.UNKNOWN
    present = {k.replace("tau", "current_torque"): v for k, v in columns().items()}
    csv = write_csv(tmp_path / "log.csv", present)
    asked = Options(columns={"tau.*": "current_torque.*"})
    assert read_log(csv, options=asked).tau_unit is TorqueUnit.NEWTON_METRE


def normalised(folder: Path) -> tuple[Path, Path, np.ndarray]:
    """A dataset of two motors and a gripper, its calibration, and the angles it stands for."""
    time = np.arange(60) / 30
    q = np.stack([60 * np.sin(time), 90 * np.cos(time), 50 + 40 * np.sin(time)], axis=1)
    table = {"timestamp": time, "observation.state": q, "observation.effort": q}
    names = {"observation.state": ["pan.pos", "lift.pos", "gripper.pos"]}
    path = dataset(folder / "set", table, names)
    entry = {"id": 1, "homing_offset": 12}
    motors = {
        "pan": {**entry, "drive_mode": 0, "range_min": 1024, "range_max": 3072},
        "lift": {**entry, "drive_mode": 1, "range_min": 0, "range_max": 4096},
        "gripper": {**entry, "drive_mode": 0, "range_min": 2000, "range_max": 3024},
    }
    file = folder / "calibration.json"
    file.write_text(json.dumps(motors))
    # Half a turn for ± 100, a whole one the other way round, and a quarter for 0 to 100.
    return path, file, q / 100 * np.pi * np.array([0.5, -1.0, 0.5])


def test_normalised_positions_are_refused_or_scaled(tmp_path):
    pytest.importorskip("pyarrow")
    path, calibration, angles = normalised(tmp_path)
    message = refusal(path)
    assert "not rad (within ±100: perhaps normalised" in message
    assert "--degrees" in message
    assert "--calibration" in message
    log = read_log(path, options=Options(calibration=calibration))
    np.testing.assert_allclose(log.qpos, angles)
    assert "4096 counts a turn" in said(log)
    degrees = read_log(path, options=Options(degrees=True))
    np.testing.assert_allclose(degrees.qpos[0, 1], np.pi / 2)
    assert "degrees or normalised" in refusal(path, Options(degrees=True, calibration=calibration))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "calibration"),
        ("[]", "no JSON object"),
        ('{"pan": 3}', "expected an object for each motor"),
        ('{"pan": {"range_min": 5, "range_max": 5}}', "range of 'pan'"),
        ('{"pan": {"range_min": NaN, "range_max": 5}}', "range of 'pan'"),
        ('{"pan": {"range_min": 0, "range_max": 4000}}', "no motor 'lift'"),
        ("[" * 100_000, "calibration"),
    ],
)
def test_calibrations_made_to_hurt(tmp_path, text, words):
    pytest.importorskip("pyarrow")
    path, calibration, _ = normalised(tmp_path)
    calibration.write_text(text)
    assert words in refusal(path, Options(calibration=calibration))
    assert "calibration gone.json" in refusal(path, Options(calibration=tmp_path / "gone.json"))


# --- convert -----------------------------------------------------------------------------------------------------


def test_convert_says_what_it_did_in_a_table(tmp_path, capsys):
    table = {k + " [deg]" * k.startswith("qpos."): v for k, v in columns().items()}
    path = german(tmp_path / "log.csv", table)
    assert main(["convert", str(path), str(tmp_path / "out.npz"), "--tau-unit", "mA"]) == 0
    out = capsys.readouterr().out
    rows = [line for line in out.splitlines() if line.startswith("│")]
    for what, told in (
        ("time", "60 samples, 0.59 s at 100 Hz"),
        ("joints", "2: hip, knee"),
        ("qpos", "rad"),
        ("tau", "mA, unknown (not N m)"),
        ("note", "decimal commas"),
    ):
        assert any(row.split("│")[1].strip() == what and told in row for row in rows), what


# --- cases -------------------------------------------------------------------------------------------------------


def convert(case: str, name: str, *options: str, tmp: Path) -> Log:
    folder = next(iter(CASES.glob(f"{case}-*")), None)
    if folder is None:
        pytest.skip("no cases here")
    model = str(next(folder.glob("*.urdf")))
    out = tmp / "out.npz"
    assert main(["convert", str(folder / name), str(out), "--model", model, *options]) == 0
    return read_log(out)


def test_cases_are_read(tmp_path):
    joints = [
        "--column=qpos.*=/joint_states/*/position",
        "--column=qvel.*=/joint_states/*/velocity",
        "--column=tau.*=/joint_states/*/effort",
    ]
    wrapped = convert("07", "wrapped.npz", tmp=tmp_path)
    assert np.abs(np.diff(wrapped.qpos, axis=0)).max() < 0.1
    for log in (
        convert("08", "euro_ns.csv", tmp=tmp_path),
        convert("08", "euro.csv", "--column=time=__time", *joints, tmp=tmp_path),
    ):
        assert log.qpos.shape == (600, 6)
        assert log.rate == pytest.approx(250, rel=1e-3)
        assert log.qpos[0, 0] == pytest.approx(0.17472, abs=1e-5)
    pytest.importorskip("mcap")
    for name in ("json1.mcap", "json2.mcap"):
        log = convert("09", name, tmp=tmp_path)
        assert log.qpos.shape == (2000, 6)
    pytest.importorskip("pyarrow")
    left = "--column=tau=observation.torque.left"
    assert convert("10", "le_torque_arm", left, tmp=tmp_path).tau.shape == (375, 6)


def test_normalised_case_is_refused(tmp_path, capsys):
    pytest.importorskip("pyarrow")
    path = next(iter(CASES.glob("10-*/le_norm")), None)
    if path is None:
        pytest.skip("no cases here")
    assert main(["convert", str(path), str(tmp_path / "out.npz")]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1
