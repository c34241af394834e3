"""Files made to hurt: a log or a model from anywhere gives its content or one line, soon, and nothing else."""

import argparse
import ast
import bz2
import contextlib
import functools
import io
import json
import os
import resource
import shlex
import signal
import sqlite3
import struct
import subprocess
import sys
import tempfile
import time
import warnings
from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from log_files import (
    JOINTS,
    START,
    Maker,
    columns,
    joint_messages,
    write_bag,
    write_csv,
    write_dataset,
    write_parquet,
    write_plain_mcap,
)
from test_model_files import ARM, DEFAULTS, URDF

import jax_inertia as ji
from benchmarks import mutations
from jax_inertia.cli import console
from jax_inertia.cli.main import _COMMANDS, main
from jax_inertia.logs.atomic_files import held
from jax_inertia.logs.log import LogError
from jax_inertia.logs.log_files import read_log
from jax_inertia.logs.readers import Options
from jax_inertia.model.load import ModelError, write_urdf

SLOW = 10.0
ROS = Options(topic_base="/odom", topic_wrenches={"foot": "/ft"})


def refusal(path, options: Options | None = None, **rest) -> str:
    start = time.monotonic()
    with pytest.raises(LogError) as caught:
        read_log(path, options=options, **rest)
    assert time.monotonic() - start < SLOW
    assert str(caught.value).isprintable()
    return str(caught.value)


@pytest.fixture
def ros():
    pytest.importorskip("mcap")
    return pytest.importorskip("rosbags")


@pytest.fixture
def arrow():
    return pytest.importorskip("pyarrow")


# --- logs: every kind of file, hit at random ----------------------------------------------------------------------


def messages(ros1: bool = False) -> list:
    maker, out = Maker(ros1), joint_messages(ros1)[:12]
    for k in range(6):
        at = START + k * 20_000_000
        out.append(("/odom", maker.odometry(at, (0, 0, 1), (1, 0, 0, 0), (1, 0, 0), (0, 0, 1)), at))
        out.append(("/ft", maker.wrench(at, (0, 0, 1), (1, 0, 0)), at))
    return out


@functools.cache
def valid(kind: str) -> bytes:
    """A sound file of one kind."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if kind == "csv":
            path = write_csv(folder / "log.csv", columns(12))
        elif kind == "parquet":
            path = write_parquet(folder / "log.parquet", columns(12))
        elif kind == "bag":
            path = write_bag(folder / "log.bag", messages(True), "bag", "LZ4")
        elif kind == "db3":
            path = next(write_bag(folder / "log", messages(), "db3").glob("*.db3"))
        else:
            path = write_plain_mcap(folder / "log.mcap", messages(), "zstd")
        return path.read_bytes()


@st.composite
def damaged(draw, content: bytes) -> bytes:
    """Bytes set to what hurts most, runs of them made huge numbers, parts cut out, doubled, or the end cut off."""
    at = st.integers(0, len(content) - 1)
    data = bytearray(content)
    for _ in range(draw(st.integers(1, 4))):
        how = draw(st.sampled_from(["byte", "byte", "number", "cut", "double", "end"]))
        i, j = sorted((draw(at), draw(at)))
        if how == "byte":
            data[i : i + 1] = bytes([draw(st.sampled_from([0, 1, 127, 128, 255, 0x2C, 0x0A]))])
        elif how == "number":
            width = draw(st.sampled_from([4, 8]))
            value = draw(st.sampled_from([10**9, 2**31 - 1, 2**32 - 1, 0]))
            data[i : i + width] = value.to_bytes(width, "little")
        elif how == "cut":
            del data[i:j]
        elif how == "double":
            data[i:i] = data[i:j]
        else:
            del data[j:]
    return bytes(data)


def outcome(path: Path, options: Options) -> None:
    """Either a log that keeps its promises, or one line; and soon."""
    start, message = time.monotonic(), ""
    try:
        log = read_log(path, options=options, max_bytes=1 << 24)
    except LogError as error:
        message = str(error)
    else:
        assert log.qpos.shape == log.tau.shape == (len(log.time), len(log.joint_names))
        assert np.all(np.diff(log.time) > 0)
    assert message.isprintable()
    assert time.monotonic() - start < SLOW


@pytest.mark.parametrize("kind", ["csv", "parquet", "bag", "db3", "mcap"])
def test_damaged_files_give_a_log_or_one_line(kind):
    for library in {"parquet": ["pyarrow"], "csv": []}.get(kind, ["rosbags", "mcap"]):
        pytest.importorskip(library)
    options = ROS if kind in ("bag", "db3", "mcap") else Options()

    @settings(max_examples=40, deadline=None, suppress_health_check=list(HealthCheck))
    @given(damaged(valid(kind)))
    def check(content: bytes) -> None:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / f"log.{kind}"
            path.write_bytes(content)
            outcome(path, options)
            # SQLite leaves no journal beside it, and nothing else is left either.
            assert os.listdir(folder) == [path.name]

    check()


@settings(max_examples=40, deadline=None)
@given(
    st.lists(
        st.text(st.sampled_from("qpostauvel.[]()°*,;\t\"' \x1b\n#e0é-"), max_size=12), max_size=8
    ),
    st.text(st.sampled_from("0123456789.,;-+einfa\"'\n\x00\x1b "), max_size=200),
)
def test_arbitrary_tables_give_a_log_or_one_line(headings, body):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.csv"
        path.write_text(",".join(["time", "qpos.a", "tau.a", *headings]) + "\n" + body)
        outcome(path, Options())


# --- logs: made by hand ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "empty"),
        (b"\n\n\n", "empty"),
        (b"\x00" * 5000, "no heading"),
        (bytes(range(256)) * 40, "UTF-8"),
        (b"time" * 400_000, "no heading"),
        (b"time,qpos.a,tau.a\n" + b"1" * (3 << 20), "longer than"),
        (b"time,qpos.a,tau.a\n0,1,2\n0.1,1\n", "line 3 has 2 fields, the heading 3"),
        (b"time,qpos.a,tau.a\n0,1,2\n0,1,1,5,2\n", "line 3 has 5 fields"),
        (b"time,qpos.a,tau.a\n0,1,2\n0.1,x\x1b[2J,2\n", "line 3, column 'qpos.a': 'x"),
        (b'time,qpos.a,tau.a\n0,"1,2\n', "fields"),
        (b'time,qpos.a,tau.a\n0,"1\n",2\n1,2,3\n', "runs over its line"),
        (b"time,qpos.a,tau.a\n0,1,2\nnan,1,2\n", "time[1] is nan"),
        (b"time,qpos.a,tau.a\n0,1,2\ninf,1,2\n", "time[1] is inf"),
        (b"time,qpos.a,tau.a\n1,1,2\n0,1,2\n", "does not come after"),
        (b"time,qpos.a,tau.a\n", "headings and no rows"),
        (b"time,time,qpos.a\n0,1,2\n", "two columns are named 'time'"),
        (b"time,qpos.a,tau.a,qpos.a [deg]\n0,1,2,3\n1,1,2,3\n", "both are qpos.a"),
        (b"time,qpos.a,tau.a," + b",".join(b"x%d" % k for k in range(20_000)), "20003 columns"),
        (b"time,qpos.\x1b[31m,tau.\x1b[31m\n0,1,2\n1,1,2\n", "printable name"),
    ],
)
def test_tables_made_to_hurt(tmp_path, content, said):
    path = tmp_path / "log.csv"
    path.write_bytes(content)
    assert said in refusal(path)


def test_values_may_be_anything_and_stamps_may_not(tmp_path):
    path = tmp_path / "log.csv"
    path.write_bytes(b"time,qpos.a,tau.a\n0,nan,inf\n0.1,-inf,1e300\n0.2,,NA\n")
    log = read_log(path)
    assert np.isnan(log.qpos[[0, 2], 0]).all()
    assert np.isinf(log.tau[0, 0])


def test_a_table_of_10_to_the_9_rows_is_refused_from_its_start(tmp_path):
    path = tmp_path / "log.csv"
    with open(path, "wb") as file:
        file.write(b"time,qpos.a,tau.a\n" + b"".join(b"%d,1,2\n" % k for k in range(700_000)))
        # A hole: the file claims 20 GB and takes up next to nothing.
        file.truncate(20 << 30)
    assert "rows of 3 columns need more than the limit" in refusal(path)


def test_no_log_is_read_from_what_is_no_file(tmp_path):
    os.mkfifo(tmp_path / "log.csv")
    (tmp_path / "loop.npz").symlink_to(tmp_path / "loop.npz")
    (tmp_path / "zero.csv").symlink_to("/dev/zero")
    (tmp_path / "empty").mkdir()
    for name in ("log.csv", "loop.npz", "zero.csv", "empty", "x" * 300 + ".csv", "a\x1bb.csv"):
        assert "no such file" in refusal(tmp_path / name) or "too long" in refusal(tmp_path / name)


def test_a_kilobyte_of_parquet_that_unfolds_to_millions_of_numbers(tmp_path, arrow):
    import pyarrow.parquet as pq

    count = 5_000_000
    lists = arrow.ListArray.from_arrays([0, count], arrow.array(np.zeros(count, np.float32)))
    flat = arrow.array([0.0])
    table = arrow.table({"time": flat, "qpos": lists, "tau": lists})
    pq.write_table(table, tmp_path / "log.parquet", compression="zstd", data_page_size=1 << 30)
    assert (tmp_path / "log.parquet").stat().st_size < 4000
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    message = refusal(tmp_path / "log.parquet", Options(joints=JOINTS), max_bytes=1 << 20)
    assert "lists of 5000000 numbers" in message or "unfolds to more" in message
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 200_000


MEASURED = """
import resource, subprocess, sys
subprocess.run([sys.executable, "-c", sys.argv[1]])
print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)
"""
LONG_LISTS = """
import sys
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
width, rows = 5_000_000, 20
lists = pa.ListArray.from_arrays(
    pa.array(np.arange(rows + 1, dtype=np.int32) * width), pa.array(np.zeros(width * rows, np.float32))
)
table = pa.table({"time": 0.01 * np.arange(rows), "qpos": lists, "tau": lists})
pq.write_table(table, sys.argv[1], compression="zstd", data_page_size=1 << 30)
"""


@pytest.mark.slow
def test_parquet_of_lists_as_long_as_memory(tmp_path, arrow):
    """A kilobyte whose lists were 3 GB by the usual limit: the child that reads it stays below two."""
    path = tmp_path / "log.parquet"
    # A process counts the memory of the one that started it as its own: it is not made here.
    subprocess.run([sys.executable, "-c", LONG_LISTS, str(path)], check=True)
    assert path.stat().st_size < 4000
    script = f"import sys; from jax_inertia import read_log; read_log({str(path)!r})"
    done = subprocess.run(
        [sys.executable, "-c", MEASURED, script], capture_output=True, text=True, check=False
    )
    assert "lists of 5000000 numbers" in done.stderr or "unfolds to more" in done.stderr
    assert int(done.stdout) < 1_000_000


def test_parquet_with_more_rows_than_there_is_room_for(tmp_path, arrow):
    zeros = {name: np.zeros(3_000_000) for name in ("time", "qpos.a", "tau.a")}
    path = write_parquet(tmp_path / "log.parquet", zeros)
    assert path.stat().st_size < 100_000
    assert "declares 3000000 rows" in refusal(path, max_bytes=1 << 20)


def test_parquet_with_a_text_without_end(tmp_path, arrow):
    table = columns(12) | {"tau_unit": np.array(["A" * 5000] * 12)}
    path = write_parquet(tmp_path / "log.parquet", table)
    assert "texts of more than 1000 characters" in refusal(path)


def test_a_dataset_that_leads_elsewhere(tmp_path, arrow):
    """What info.json says of paths is not followed, and a name in it is only a name."""
    folder = write_dataset(tmp_path / "set", episodes=1)
    info = folder / "meta" / "info.json"
    info.write_text('{"data_path": "../../{0.__class__}/etc/passwd", "features": {"observation.state":'
                    ' {"names": ["../../x", "<script>"]}}}')  # fmt: skip
    assert read_log(folder).joint_names == ("../../x", "<script>")
    info.write_bytes(b"\xff" * 1000)
    assert "info.json cannot be read" in refusal(folder)
    info.unlink()
    os.mkfifo(info)
    assert "without a ROS 2 bag or a LeRobot dataset" in refusal(folder)


def record(header: dict[str, bytes], data: bytes, size: int | None = None) -> bytes:
    fields = b"".join(
        struct.pack("<I", len(k) + 1 + len(v)) + k.encode() + b"=" + v for k, v in header.items()
    )
    return struct.pack("<I", len(fields)) + fields + struct.pack("<I", size or len(data)) + data


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "not a ROS 1 bag"),
        (b"#ROSBAG V1.2\n", "not a ROS 1 bag"),
        (b"#ROSBAG V2.0\n", "no messages"),
        (b"#ROSBAG V2.0\n\xff\xff\xff\xff", "declares 4294967295 bytes"),
        (b"#ROSBAG V2.0\n" + record({"op": b"\x02"}, b"", 1 << 31), "declares 2147483648 bytes"),
        (
            b"#ROSBAG V2.0\n" + struct.pack("<II", 8, 4) + b"abcd" + bytes(4),
            "field without a value",
        ),
        (
            b"#ROSBAG V2.0\n" + record({"op": b"\x02", "conn": bytes(4), "time": bytes(8)}, b""),
            "not a sound",
        ),
        (
            b"#ROSBAG V2.0\n"
            + record(
                {"op": b"\x05", "compression": b"bz2", "size": b"\xff" * 4},
                bz2.compress(bytes(9**7)),
            ),
            "unfolds to 4294967295",
        ),
        (
            b"#ROSBAG V2.0\n"
            + record(
                {"op": b"\x05", "compression": b"bz2", "size": bytes(4)}, bz2.compress(bytes(9**7))
            ),
            "does not unfold to the size",
        ),
        (
            b"#ROSBAG V2.0\n"
            + record({"op": b"\x05", "compression": b"rar", "size": bytes(4)}, b"x"),
            "'rar'",
        ),
    ],
)
def test_ros_1_bags_made_to_hurt(tmp_path, ros, content, said):
    path = tmp_path / "log.bag"
    path.write_bytes(content)
    assert said in refusal(path)


def test_mcap_whose_chunks_unfold_without_end(tmp_path, ros):
    import zstandard

    data = zstandard.compress(bytes(1 << 24))
    for size, said in ((1 << 40, "unfolds to 1099511627776"), (64, "does not unfold to the size")):
        chunk = struct.pack("<QQQI", 0, 1, size, 0) + struct.pack("<I", 4) + b"zstd"
        chunk += struct.pack("<Q", len(data)) + data
        header = struct.pack("<I", 4) + b"ros2" + struct.pack("<I", 0)
        magic = b"\x89MCAP0\r\n"
        content = magic + b"\x01" + struct.pack("<Q", len(header)) + header
        content += b"\x06" + struct.pack("<Q", len(chunk)) + chunk + magic
        (tmp_path / "log.mcap").write_bytes(content)
        assert said in refusal(tmp_path / "log.mcap")
    (tmp_path / "log.mcap").write_bytes(magic + b"\x01" + b"\xff" * 8)
    assert "exceeds limit" in refusal(tmp_path / "log.mcap")


ENDLESS = "WITH RECURSIVE n(id) AS (SELECT 1 UNION ALL SELECT id + 1 FROM n) SELECT id FROM n"
TOPICS = "CREATE TABLE topics(id INTEGER, name TEXT, type TEXT, serialization_format TEXT);"

MESSAGES = "CREATE TABLE messages(topic_id, timestamp, data);"


@pytest.mark.parametrize(
    ("script", "said"),
    [
        ("", "without the plain tables"),
        (f"{TOPICS} CREATE VIEW messages AS {ENDLESS};", "plain tables"),
        (
            f"{TOPICS} CREATE TABLE messages(topic_id INTEGER, timestamp INTEGER,"
            " data BLOB GENERATED ALWAYS AS (zeroblob(1000000000)));",
            "plain tables",
        ),
        (f"{TOPICS} {MESSAGES} INSERT INTO messages VALUES (1, 2, 3);", "damaged"),
        (f"{TOPICS} CREATE TABLE messages(x);", "not a sound .db3"),
        (
            f"{TOPICS} INSERT INTO topics VALUES (1, '/j', 'sensor_msgs/msg/JointState', 'cdr');"
            f" {MESSAGES}"
            " INSERT INTO messages VALUES (1, 2, x'28b52ffd00');",
            "compressed one by one",
        ),
        (
            f"{TOPICS} INSERT INTO topics VALUES (1, '/j', 'sensor_msgs/msg/JointState', 'cdr');"
            f" {MESSAGES}"
            " INSERT INTO messages VALUES (1, 2, x'000100000000000000000000ffffffff');",
            "cannot be decoded",
        ),
        (
            f"{TOPICS} INSERT INTO topics VALUES (1, '/j', 'sensor_msgs/msg/JointState', 'protobuf');"
            f" {MESSAGES} INSERT INTO messages VALUES (1, 2, x'00');",
            "encoded as 'protobuf'",
        ),
    ],
)  # fmt: skip
def test_databases_made_to_hurt(tmp_path, ros, script, said):
    path = tmp_path / "a?mode=rwc#%2e.db3"
    database = sqlite3.connect(path)
    database.executescript(f"CREATE TABLE other(x); {script}")
    database.close()
    assert said in refusal(path)
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


def test_joint_states_made_to_hurt(tmp_path, ros):
    maker = Maker()

    def said(name, *states):
        sent = [("/j", state, START + k) for k, state in enumerate(states)]
        return refusal(write_bag(tmp_path / name, sent, "mcap"))

    many = [maker.joints(START + k, (f"j{k}",), (0,), (0,), (0,)) for k in range(102)]
    assert "again and again" in said("many", *many)
    wide = maker.joints(START, [f"j{k}" for k in range(2000)])
    assert "2000 joints, too many" in said("wide", wide)
    assert "too many or one twice" in said("twice", maker.joints(START, ("a", "a")))
    assert "2 names but 1 values of effort" in said("short", maker.joints(START, effort=(1,)))
    assert "name no joints" in said("none", maker.joints(START, ()))
    script = ("\x1b[31mred", "../../x")
    states = [maker.joints(START + k * 10**7, script, (0, 0), (0, 0), (0, 0)) for k in range(3)]
    assert "printable name" in said("script", *states)
    one = [maker.joints(START, JOINTS, (0, 0), (0, 0), (0, 0))]
    assert "at least two samples" in said("one", *one)
    nan = [maker.joints(START + k * 10**7, JOINTS, [np.nan] * 2, (0, 0), (0, 0)) for k in range(3)]
    assert "hold no position" in said("nan", *nan)


def test_a_long_heading_is_read_at_once_and_quoted_in_part(tmp_path, arrow):
    table = columns(12)
    table["qpos.hip" + " " * 40_000 + "x ["] = table.pop("qpos.hip")
    start = time.process_time()
    said = refusal(write_parquet(tmp_path / "log.parquet", table))
    assert time.process_time() - start < 2.0
    assert len(said) < 1500


def test_a_list_in_the_place_of_a_number(tmp_path, arrow):
    table = columns(12)
    table["tau.knee"] = np.stack([table["tau.knee"]] * 2, axis=1)
    path = write_parquet(tmp_path / "log.parquet", table)
    assert "column 'tau.knee' holds lists; expected one number" in refusal(path)


def test_what_headers_contradict_is_known_before_anything_is_unfolded(tmp_path):
    """Half a megabyte that would unfold to half a gigabyte."""
    names, few = np.array(["a", "b"]), np.zeros((50, 2))
    many = np.zeros((30_000_000, 2), "u1")
    path, before = tmp_path / "log.npz", resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for arrays, said in (
        ({"time": np.arange(50.0), "qpos": many, "tau": few}, "qpos has shape (30000000, 2)"),
        ({"time": np.arange(50.0), "qpos": many}, "'tau' is missing"),
        ({"time": np.repeat([0.0, 1.0], 25), "qpos": few, "tau": few}, "does not come after"),
        ({"time": np.array(["0.0"] * 50), "qpos": few, "tau": few}, "time holds text"),
    ):
        np.savez_compressed(path, joint_names=names, **arrays)
        assert said in refusal(path)
    # In KB; the array itself is of 60 MB here, and was before.
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 200_000


# --- models ------------------------------------------------------------------------------------------------------

BODY = '<body name="b"><joint/><geom size="0.1"/></body>'


def mjcf(rest: str, world: str = BODY) -> str:
    return f"<mujoco>{rest}<worldbody>{world}</worldbody></mujoco>"


def model_refusal(path) -> str:
    start = time.monotonic()
    with pytest.raises(ModelError) as caught:
        ji.load_model(path)
    assert time.monotonic() - start < SLOW
    assert "\n" not in str(caught.value)
    return str(caught.value)


CHAIN = "".join(
    f'<link name="l{k}"/><joint name="j{k}" type="fixed"><parent link="a"/><child link="l{k}"/></joint>'
    for k in range(1001)
)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('<!DOCTYPE m [<!ENTITY x SYSTEM "file:///etc/passwd">]>' + mjcf(""), "document type"),
        ('<!doctype m [<!ENTITY a "aa"><!ENTITY b "&a;&a;">]>' + mjcf(""), "document type"),
        (mjcf('<include file="/etc/passwd"/>'), "outside the model's folder"),
        (mjcf('<include file="../secret.xml"/>'), "outside the model's folder"),
        (mjcf('<include file="link.xml"/>'), "outside the model's folder"),
        (mjcf('<asset><model name="m" file="../../x.xml"/></asset>'), "outside the model's folder"),
        (mjcf('<include file="robot.xml"/>'), "already included"),
        (mjcf('<include file="absent.xml"/>'), "absent.xml"),
        (mjcf("", "<body>" * 3001 + "</body>" * 3001), "3001 bodies"),
        (mjcf("", "<body>" * 2000 + "</body>" * 2000), "too deep"),
        (mjcf("", f'<replicate count="100000000">{BODY}</replicate>'), "copies; at most"),
        (mjcf("", f'<replicate count="50"><replicate count="50">{BODY}</replicate></replicate>'), "2500 copies"),
        (mjcf("", '<flexcomp name="f" type="grid" count="900 900 900" spacing="1 1 1" dim="3"/>'), "count = 729000000"),
        (mjcf("", '<composite prefix="c" type="cable" count="1000000 1 1" size="1"/>'), "count = 1000000"),
        (mjcf('<size nuser_body="1000000000"/>'), "nuser_body"),
        (mjcf('<size nkey="2000000000"/>'), "nkey"),
        (mjcf('<size nkey="900000"/>'), "nkey='900000'"),
        (mjcf("<keyframe>" + "<key/>" * 30_000 + "</keyframe>"), "30000 <key>"),
        ("<mujoco " + "a" * 400_000 + "/>", "robot.xml"),
        ("<mujoco " + "a " * 200_000 + "/>", "robot.xml"),
        ("<mujoco " + "a=" * 200_000 + "/>", "robot.xml"),
        ('<a "\'' * 50_000, "robot.xml"),
        ("<mujoco a" + " " * 400_000 + "/>", "robot.xml"),
        (mjcf('<asset><texture name="t" type="2d" builtin="flat" width="99999" height="99999"/></asset>'), "texture"),
        (mjcf('<asset><hfield name="h" nrow="99999" ncol="99999" size="1 1 1 1"/></asset>'), "hfield"),
        (mjcf('<custom><numeric name="n" size="2000000000" data="1"/></custom>'), "between 1 and 500"),
        (mjcf('<size memory="100000G"/>'), "memory"),
        (mjcf('<asset><mesh name="m" file="/dev/zero"/></asset>'), "device or a pipe"),
        (mjcf('<asset><texture name="t" type="2d" file="pipe.png"/></asset>'), "device or a pipe"),
        (mjcf('<compiler texturedir="sub"/><asset><texture name="t" type="2d" file="pipe.png"/></asset>'), "pipe"),
        ('<robot name="r"><link name="a"><visual><geometry><mesh filename="file:///dev/zero"/>'
         "</geometry></visual></link></robot>", "device or a pipe"),
        (f'<robot name="r"><link name="a"/>{CHAIN}</robot>', "1002 links"),
        (mjcf("", '<body><joint/><inertial pos="0 0 0" mass="nan" diaginertia="1 1 1"/></body>'), "mass"),
        (mjcf("", '<body><joint/><inertial pos="0 0 0" mass="1e999" diaginertia="1 1 1"/></body>'), "too large"),
        (mjcf("", '<body><joint/><inertial pos="0 0 0" mass="-1" diaginertia="1 1 1"/></body>'), "mass"),
        ("<sdf><world/></sdf>", "an SDF world"),
        ("<boost_serialization/>", "archive of Pinocchio's"),
        ("<a>" * 1_100_000, "more than"),
        ("\x00" * 100, "robot.xml"),
        ("<" * 50_000 + '"' * 50_000, "robot.xml"),
        ("<a b='" * 50_000, "robot.xml"),
        ("<!--" * 50_000, "robot.xml"),
    ],
)  # fmt: skip
def test_models_made_to_hurt(tmp_path, text, said):
    folder = tmp_path / "model"
    (folder / "sub").mkdir(parents=True)
    (tmp_path / "secret.xml").write_text(mjcf(""))
    (folder / "link.xml").symlink_to(tmp_path / "secret.xml")
    os.mkfifo(folder / "pipe.png")
    os.mkfifo(folder / "sub" / "pipe.png")
    (folder / "robot.xml").write_text(text)
    assert said in model_refusal(folder / "robot.xml")


def test_names_are_utf_8_and_comments_may_be_anything(tmp_path):
    """Found by fuzzing: MuJoCo reads a name in Latin-1, and Python cannot take it from there."""
    path = tmp_path / "arm.urdf"
    comment = URDF.replace("made by hand", "für Jörg").replace("schloß", "lock")
    path.write_bytes(comment.encode("latin-1"))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ji.ModelWarning)
        assert "lock" in ji.load_model(path).body_names
    path.write_bytes(URDF.encode("latin-1"))
    assert "of <link> is not in UTF-8" in model_refusal(path)
    path.write_bytes(URDF.replace("<robot", "<?xml \x1b[2J\x07 <robot").encode())
    assert model_refusal(path).isprintable()


@pytest.mark.parametrize(
    "reference", ["&#99999999999;", "&#" + "9" * 5000 + ";", "&#xD800;", "&#0;", "&#x110000;"]
)
def test_a_reference_to_no_character_is_one_line_with_the_file(tmp_path, reference):
    path = tmp_path / "arm.urdf"
    path.write_text(URDF.replace('name="', f'name="{reference}', 2))
    for read in (ji.load_model, lambda p: write_urdf(p, tmp_path / "out.urdf", {})):
        with pytest.raises(ModelError, match=r"arm\.urdf: .*refers to no character") as caught:
            read(path)
        assert len(str(caught.value)) < 500


def test_a_reference_to_a_character_is_that_character(tmp_path):
    """A URDF whose link is called by a reference takes inertials under the name that it stands for."""
    path = tmp_path / "arm.urdf"
    path.write_bytes(
        b'<robot name="r"><link name="&#945;&amp;\xc3\xa4"/><link name="b&#x3B2;"/><!-- \xe4 --></robot>'
    )
    pi = np.array([1.0, 0, 0, 0, 0.1, 0, 0, 0.1, 0, 0.1])
    write_urdf(path, tmp_path / "out.urdf", {"α&ä": pi, "bβ": pi})
    out = (tmp_path / "out.urdf").read_bytes()
    assert out.count(b'<mass value="1.0"/>') == 2
    assert b"<!-- \xe4 -->" in out


@pytest.mark.parametrize("afloat", [False, True])
def test_a_joint_twice_is_one_line_with_the_file(tmp_path, afloat):
    joint = '<joint name="j" type="continuous"><parent link="a"/><child link="{}"/></joint>'
    inertia = '<mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>'
    link = f'<link name="{{}}"><inertial>{inertia}</inertial></link>'
    for children in ("bb", "bc"):
        text = "".join(link.format(x) for x in "abc") + "".join(joint.format(x) for x in children)
        (tmp_path / "arm.urdf").write_text(f'<robot name="r">{text}</robot>')
        with pytest.raises(ModelError, match=r"arm\.urdf: ") as caught:
            ji.load_model(tmp_path / "arm.urdf", floating_base=afloat)
        assert "\n" not in str(caught.value)


def test_what_mujoco_says_of_a_model_is_the_package_s_own_warning(tmp_path):
    """Found by mutation: compiling two hinges on one line warns in Python, not in MuJoCo's own way."""
    joints = '<joint axis="1 0 0"/><joint axis="1 0 0"/>'
    (tmp_path / "robot.xml").write_text(mjcf("", f'<body>{joints}<geom size="0.1"/></body>'))
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        ji.load_model(tmp_path / "robot.xml")
    assert {w.category for w in told} == {ji.ModelWarning}
    assert "robot.xml: Inertia matrix is too close to singular" in str(told[0].message)


def test_copies_multiply_across_includes(tmp_path):
    (tmp_path / "part.xml").write_text(
        f'<mujocoinclude><replicate count="60">{BODY}</replicate></mujocoinclude>'
    )
    (tmp_path / "robot.xml").write_text(
        mjcf("", '<replicate count="60"><include file="part.xml"/></replicate>')
    )
    assert "3600 copies" in model_refusal(tmp_path / "robot.xml")


def test_no_model_is_read_from_what_is_no_file(tmp_path):
    os.mkfifo(tmp_path / "robot.xml")
    (tmp_path / "zero.xml").symlink_to("/dev/zero")
    for name in ("robot.xml", "zero.xml", "absent.xml", "a\x1bb.xml"):
        assert "no such model file" in model_refusal(tmp_path / name)
    with open(tmp_path / "large.xml", "wb") as file:
        file.truncate(1 << 40)
    assert "larger than" in model_refusal(tmp_path / "large.xml")


@settings(max_examples=40, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_damaged_models_give_a_robot_or_one_line(data):
    whole = data.draw(st.sampled_from([ARM, URDF]))
    content = data.draw(damaged(whole.encode()))
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "parts").mkdir()
        (Path(folder) / "parts" / "defaults.xml").write_text(DEFAULTS)
        path = Path(folder) / "robot.xml"
        path.write_bytes(content)
        start, message, out = time.monotonic(), "", Path(folder) / "out.urdf"
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ji.ModelWarning)
            try:
                assert ji.load_model(path).nv > 0
            except ModelError as error:
                message = str(error)
        assert "\n" not in message
        with contextlib.suppress(ModelError):
            write_urdf(path, out, {})
        assert not out.exists() or out.read_bytes() == content
        assert time.monotonic() - start < SLOW


@pytest.mark.parametrize(
    "command", ["convert", "estimate", "diagnose", "replay", "watch", "suggest-motion", "fleet"]
)
def test_includes_go_where_the_printed_option_says(tmp_path, capsys, command):
    """The remedy that a refusal prints works on that very command; above the named folder is refused as before."""
    (tmp_path / "robots" / "arm").mkdir(parents=True)
    (tmp_path / "robots" / "shared parts").mkdir()
    (tmp_path / "robots" / "shared parts" / "defaults.xml").write_text(
        "<mujocoinclude><size nkey='0'/></mujocoinclude>"
    )
    model = tmp_path / "robots" / "arm" / "arm.xml"
    model.write_text('<mujoco><include file="../shared parts/defaults.xml"/></mujoco>')
    words = {
        "suggest-motion": [command, str(model)],
        "convert": [command, "a.csv", str(tmp_path / "b.npz")],
    }
    start = words.get(command, [command, "a.csv"])
    start += [] if command == "suggest-motion" else ["--model", str(model)]
    start += ["--bodies", "x"] * (command in ("estimate", "watch", "suggest-motion")) + [
        "--out",
        str(tmp_path / "out"),
    ] * (command == "fleet")
    assert main(start) == 2
    said = capsys.readouterr().err
    if command == "fleet":
        # Its diagnoses are what reads the model.
        assert "no such file" in said or "outside the model" in said
        return
    option = shlex.split(said.partition("if you trust it, ")[2])
    assert option == ["--include-root", str(tmp_path / "robots")]
    assert main([*start, *option]) == 2
    assert "nothing in it moves" in capsys.readouterr().err
    assert main([*start, "--include-root", str(model.parent)]) == 2
    assert "outside the model's folder" in capsys.readouterr().err
    assert main([*start, "--include-root", str(tmp_path / "none")]) == 2
    assert "no such folder" in capsys.readouterr().err


def path_arguments() -> list[tuple[str, argparse.ArgumentParser, argparse.Action]]:
    """Every argument of every command that is a path."""
    subparsers = argparse.ArgumentParser().add_subparsers()
    for command in _COMMANDS:
        command.add_parser(subparsers)
    return [
        (name, parser, action)
        for name, parser in subparsers.choices.items()
        for action in parser._actions
        if action.type is Path
    ]


@pytest.mark.parametrize(
    ("command", "parser", "action"),
    path_arguments(),
    ids=lambda x: x if isinstance(x, str) else getattr(x, "dest", ""),
)
def test_a_pipe_is_refused_wherever_a_path_is_asked_for(
    tmp_path, monkeypatch, capsys, command, parser, action
):
    """Nobody writes to it: who opened it would wait for ever."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "robot.xml").write_text(
        mjcf("", '<body><joint name="a"/><geom size="0.1"/></body>')
    )
    write_csv(tmp_path / "log.csv", columns(200))
    for kind in (".csv", ".xml", ""):
        os.mkfifo(tmp_path / f"pipe{kind}")
    words, pipe = [command], {"model": "pipe.xml"}.get(action.dest, "pipe.csv")
    for one in parser._actions:
        own = {"model": "robot.xml", "out": "out.csv", "reports": "a b"}.get(one.dest, "log.csv")
        value = pipe if one is action else own
        if not one.option_strings:
            words += value.split()
        elif one is action or one.required:
            words += [one.option_strings[0], value if one.type is Path else "body_1"]

    def late(*_):
        raise TimeoutError("the pipe was opened")

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(60)
    try:
        assert main(words) == 2
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
    said = capsys.readouterr().err.strip().splitlines()
    assert said[-1].startswith("jax-inertia: error:"), said
    assert "pipe was opened" not in said[-1]


def test_text_is_utf_8_whatever_the_locale(tmp_path):
    """A Greek name in a model, on the page and in JSON, where Python would write ASCII."""
    text = ARM.replace("link2", "γόνατο")
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "defaults.xml").write_text(DEFAULTS)
    (tmp_path / "arm.xml").write_text(text, encoding="utf-8")
    environment = os.environ | {
        **{"LC_ALL": "C", "LANG": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
        "PYTHONPATH": str(Path(__file__).parents[1]),
    }
    command = [
        sys.executable,
        "-m",
        "jax_inertia",
        "estimate",
        "a.csv",
        "--model",
        "arm.xml",
        "--bodies",
        "κάτι",
    ]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, check=False)
    assert done.returncode == 2
    assert "Traceback" not in done.stderr.decode("utf-8")


def test_every_text_file_is_opened_with_its_encoding():
    """What is left to the locale is another file on another machine."""
    bad = []
    for path in (Path(__file__).parents[1] / "jax_inertia").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.Call):
                continue
            name = (
                node.func.attr
                if isinstance(node.func, ast.Attribute)
                else getattr(node.func, "id", "")
            )
            words = {k.arg for k in node.keywords}
            modes = [a.value for a in node.args[1:2] if isinstance(a, ast.Constant)]
            binary = any("b" in str(m) for m in modes)
            method = isinstance(node.func, ast.Attribute)
            if name in ("write_text", "read_text") and "encoding" not in words:
                bad.append(f"{path.name}:{node.lineno}")
            if name == "open" and not method and not binary and "encoding" not in words:
                bad.append(f"{path.name}:{node.lineno}")
    assert not bad


# --- commands ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("command", ["convert", "estimate", "diagnose"])
def test_commands_leave_one_line_and_nothing_else(tmp_path, capsys, monkeypatch, command):
    """For every kind of damaged log, and for a damaged model."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "model.xml").write_text(mjcf(""))
    (tmp_path / "bad.xml").write_text("<mujoco><worldbody><body>")
    write_csv(tmp_path / "good.csv", columns(12))
    logs = []
    for suffix in ("csv", "npz", "parquet", "bag", "mcap", "db3"):
        (tmp_path / f"cut.{suffix}").write_bytes(b"PK\x03\x04 not what it says \x1b[2J\n" * 3)
        logs.append((f"cut.{suffix}", "model.xml"))
    before = sorted(p.name for p in tmp_path.iterdir())
    for log, model in [*logs, ("good.csv", "bad.xml")]:
        rest = {"convert": ["out.npz"], "estimate": ["--bodies", "b"], "diagnose": []}[command]
        arguments = [log, *rest, "--model", model]
        assert main([command, *arguments]) == 2
        out, err = capsys.readouterr()
        assert out == ""
        assert err.startswith("jax-inertia: error: ")
        assert err.count("\n") == 1
        assert err.rstrip("\n").isprintable()
    assert sorted(p.name for p in tmp_path.iterdir()) == before


def test_what_a_killed_run_left_is_removed_by_the_next(tmp_path):
    """Folders and files of writers that are gone, and nobody else's."""
    out, kept = tmp_path / "out", []
    with contextlib.suppress(KeyboardInterrupt), console.output_folder(out):
        kept += [p for p in out.iterdir() if p.is_dir()]
        raise KeyboardInterrupt
    assert not out.exists()
    for name in (kept[0].name, ".part-of-another-program"):
        (out / name).mkdir(parents=True)
    with console.output_folder(out) as folder:
        (folder / "report.json").write_text("{}")
        assert not kept[0].exists() or kept[0] == folder
    assert {p.name for p in out.iterdir()} == {"report.json", ".part-of-another-program"}
    left = tmp_path / ".log.csv.0123abcd.part"
    left.write_text("half")
    os.utime(left, (0, 0))
    young, other = tmp_path / ".log.csv.0123abce.part", tmp_path / ".log.csv.old.part"
    young.write_text("half")
    other.write_text("mine")
    with open(tmp_path / ".log.csv.0123abcf.part", "wb") as busy:
        held(busy)
        os.utime(busy.name, (0, 0))
        ji.write_log(read_log(write_csv(tmp_path / "a.csv", columns(12))), tmp_path / "log.csv")
        assert sorted(p.name for p in tmp_path.glob(".log*")) == [
            young.name,
            Path(busy.name).name,
            other.name,
        ]


KILLED = """
import json, os, pathlib, sys
from jax_inertia.cli import console
NAMES = "corrected.xml", "policy.json", "report.html", "report.json"

def write(out, text, names, deaths):
    def ends(call):
        def one(*given, **more):
            nonlocal deaths
            deaths -= 1
            if deaths == 0:
                os._exit(9)
            return call(*given, **more)
        return one
    os.replace, os.unlink = ends(os.replace), ends(os.unlink)
    with console.output_folder(out, products=NAMES) as part:
        for name in names:
            (part / name).write_text(text)

def run(*given):
    if not (child := os.fork()):
        write(*given)
        os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])

for names in (NAMES, NAMES[:1] + NAMES[2:]):
    for deaths in range(1, 16):
        out = pathlib.Path(sys.argv[1]) / f"{len(names)} {deaths}"
        run(out, "old", NAMES, 0)
        status = run(out, "new", names, deaths)
        left = {f.name: f.read_text() for f in out.iterdir() if f.is_file() and f.name[0] != "."}
        run(out, "again", names, 0)
        after = sorted(f.name for f in out.iterdir())
        print(json.dumps([status, left, after == sorted(names)]))
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="ends a copy of itself")
def test_a_run_that_is_killed_while_it_writes_leaves_no_report_of_two_runs(tmp_path):
    """At each step of its end; and the next run finds nothing that disturbs it."""
    words = [sys.executable, "-W", "ignore", "-c", KILLED, str(tmp_path)]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    rows = [json.loads(line) for line in done.stdout.splitlines()]
    assert len(rows) == 30
    assert sum(status == 9 for status, *_ in rows) > 8
    for status, left, cleared in rows:
        assert cleared
        if status == 0:
            assert set(left.values()) == {"new"}
        if "report.json" in left:
            assert len(set(left.values())) == 1
    # Not for that nothing is ever left.
    assert any("report.json" in left for status, left, _ in rows if status == 9)


def test_the_second_writer_to_a_folder_is_told(tmp_path):
    """Another process, as it is in earnest: locks are of processes."""
    program = (
        "import sys, pathlib; from jax_inertia.cli import console\n"
        "with console.output_folder(pathlib.Path(sys.argv[1])) as part:\n"
        "    (part / 'report.json').write_text('first'); print('in', flush=True); sys.stdin.readline()\n"
    )
    out = tmp_path / "out"
    with subprocess.Popen(
        [sys.executable, "-c", program, out], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as first:  # fmt: skip
        assert first.stdout is not None
        assert first.stdin is not None
        assert first.stdout.readline() == "in\n"
        with (
            pytest.raises(ValueError, match="another run is writing there; wait for it"),
            console.output_folder(out),
        ):
            pass
        with console.output_folder(out, "motion.csv"):
            pass
        first.stdin.write("\n")
    assert [p.name for p in out.iterdir()] == ["report.json"]
    with console.output_folder(out) as folder:
        (folder / "report.json").write_text("second")
    assert (out / "report.json").read_text() == "second"


def test_a_folder_may_be_named_from_here(tmp_path, monkeypatch):
    """A temporary folder is absolute from Python 3.12 on, and is not what a killed run left."""
    monkeypatch.chdir(tmp_path)
    for text in ("first", "second"):
        with console.output_folder(Path("out/here")) as folder:
            (folder / "report.json").write_text(text)
        assert (tmp_path / "out/here/report.json").read_text() == text


def test_commands_say_warnings_in_one_line_or_not_at_all(capfd, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with console.warnings_as_lines():
        warnings.warn("invalid value\n  in code", RuntimeWarning, stacklevel=1)
        warnings.warn("a spring is\nleft out", ji.ModelWarning, stacklevel=1)
        model = mujoco.MjModel.from_xml_string(mjcf(""))
        data = mujoco.MjData(model)
        data.qvel[:] = np.nan
        mujoco.mj_step(model, data)
    out, err = capfd.readouterr()
    lines = err.splitlines()
    assert out == ""
    assert lines[0] == "jax-inertia: warning: a spring is left out"
    assert len(lines) == 2
    assert lines[1].startswith("jax-inertia: warning: Nan, Inf")
    assert list(tmp_path.iterdir()) == []


# --- the harness of benchmarks/fuzz.py ---------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["csv", "npz", "parquet", "MJCF", "URDF"])
def test_mutations_are_seeded_and_differ(kind):
    mutate = {
        "npz": mutations.npz,
        "parquet": mutations.parquet,
        "MJCF": mutations.text(mutations.MJCF),
        "URDF": mutations.text(mutations.URDF),
        "csv": mutations.text([]),
    }[kind]
    content = ARM.encode()
    if kind == "parquet":
        pytest.importorskip("pyarrow")
    if kind in ("parquet", "csv"):
        content = valid(kind)
    elif kind == "npz":
        buffer = io.BytesIO()
        np.savez(buffer, time=np.arange(9.0), tau=np.ones((9, 2)))
        content = buffer.getvalue()
    one, again = ([mutate(np.random.default_rng(k), content) for k in range(30)] for _ in range(2))
    assert one == again or kind == "npz"  # a zip has the time of its making
    assert len(set(one)) > 20
