"""A file read chunk by chunk is the file read whole, with the same checks, and through the filter the same bits."""

import itertools
import tracemalloc

import jax
import numpy as np
import pytest
from log_files import JOINTS, arrays, columns, write_csv, write_parquet

import jax_inertia as ji
from jax_inertia.estimation.inertial_filter import make_estimator
from jax_inertia.estimation.priors import Load
from jax_inertia.estimation.stream import Stream
from jax_inertia.logs.chunks import read_chunks
from jax_inertia.logs.log import CHANNELS, Log, LogError, TorqueKind, TorqueUnit
from jax_inertia.logs.log_files import read_log, write_log
from jax_inertia.logs.readers import Options
from jax_inertia.robots.pendulum import double_pendulum, swing

KINDS = pytest.mark.parametrize("kind", ["csv", "parquet"])
WRITERS = {"csv": write_csv, "parquet": write_parquet}


def written(tmp_path, kind: str, table: dict):
    if kind == "parquet":
        pytest.importorskip("pyarrow")
    return WRITERS[kind](tmp_path / f"log.{kind}", table)


def joined(chunks: list[Log]) -> dict[str, np.ndarray]:
    """Everything over time in one piece; what else a chunk says is the same in all."""
    for one, other in itertools.pairwise(chunks):
        assert (one.joint_names, one.tau_unit, one.tau_kind) == (
            other.joint_names,
            other.tau_unit,
            other.tau_kind,
        )
    names = [name for name in ("time", *CHANNELS) if getattr(chunks[0], name) is not None]
    return {name: np.concatenate([getattr(chunk, name) for chunk in chunks]) for name in names}


def assert_same(chunks: list[Log], whole: Log) -> None:
    for name, value in joined(chunks).items():
        np.testing.assert_array_equal(value, getattr(whole, name), err_msg=name)
    assert chunks[0].notes == whole.notes
    for name in ("joint_names", "tau_unit_text", "tau_kind", "contact_bodies"):
        assert getattr(chunks[-1], name) == getattr(whole, name)


@KINDS
@pytest.mark.parametrize("rows", [2, 7, 29, 59, 60, 1000])
def test_chunks_are_the_whole(tmp_path, kind, rows):
    """60 samples: a rest, none, and a single sample that must not stand alone."""
    path = written(tmp_path, kind, columns())
    chunks = list(read_chunks(path, rows=rows))
    assert_same(chunks, read_log(path))
    sizes = [len(chunk.time) for chunk in chunks]
    assert set(sizes[:-1]) <= {rows}
    assert 2 <= sizes[-1] <= rows + 1


@KINDS
def test_everything_a_log_can_hold(tmp_path, kind):
    if kind == "parquet":
        pytest.importorskip("pyarrow")
    rng, samples = np.random.default_rng(0), 50
    data = arrays(samples)
    data["qpos"][3] = np.nan
    log = Log(
        **data,
        joint_names=JOINTS,
        tau_kind=TorqueKind.CURRENT,
        tau_unit=TorqueUnit.AMPERE,
        tau_unit_text="A",
        sigma_tau=np.array([0.1, 0.2]),
        base_pos=rng.normal(size=(samples, 3)),
        base_quat=rng.normal(size=(samples, 4)),
        contact_wrench=rng.normal(size=(samples, 1, 6)),
        contact_bodies=("foot",),
    )
    path = tmp_path / f"log.{kind}"
    write_log(log, path)
    chunks = list(read_chunks(path, rows=20))
    assert len(chunks) == 3
    assert_same(chunks, read_log(path))
    for chunk in chunks:
        np.testing.assert_array_equal(chunk.sigma_tau, log.sigma_tau)


def test_blocks_and_row_groups_may_be_smaller_or_larger_than_chunks(tmp_path, monkeypatch):
    parquet = pytest.importorskip("pyarrow.parquet")
    import pyarrow

    table = columns(500)
    whole = read_log(write_csv(tmp_path / "log.csv", table))
    monkeypatch.setattr("jax_inertia.logs.readers.delimited._BLOCK", 1000)
    assert_same(list(read_chunks(tmp_path / "log.csv", rows=64)), whole)
    for group in (10, 300):
        parquet.write_table(
            pyarrow.table(table).replace_schema_metadata({"tau_unit": "N m"}),
            tmp_path / "log.parquet",
            row_group_size=group,
        )
        chunks = list(read_chunks(tmp_path / "log.parquet", rows=64))
        assert_same(chunks, read_log(tmp_path / "log.parquet"))


@KINDS
def test_names_units_and_options_are_seen_to(tmp_path, kind):
    table = columns()
    table = {name.replace("qpos.", "angle_"): value for name, value in table.items()}
    table["angle_knee [deg]"] = np.rad2deg(table.pop("angle_knee"))
    table["humidity"] = table["time"]
    path = written(tmp_path, kind, table)
    options = Options(columns={"qpos.*": "angle_*"}, rename={"hip": "h"}, tau_unit="N m")
    chunks = list(read_chunks(path, rows=25, options=options))
    assert_same(chunks, read_log(path, options=options))
    assert chunks[0].joint_names == ("h", "knee")
    assert "humidity" in " ".join(chunks[0].notes)
    assert not chunks[1].notes


def refusal(path, **rest) -> tuple[int, str]:
    """How many chunks were sound, and the one line."""
    chunks, sound = read_chunks(path, **rest), []
    with pytest.raises(LogError) as caught:
        sound.extend(chunks)
    message = str(caught.value)
    assert message.isprintable()
    assert path.name in message
    return len(sound), message


@KINDS
def test_what_is_wrong_is_one_line_where_it_is_reached(tmp_path, kind):
    table = columns()
    table["time"][40] = table["time"][39]  # inside a chunk of 25, and between chunks of 20
    path = written(tmp_path, kind, table)
    for rows, sound in ((25, 1), (20, 2)):
        assert refusal(path, rows=rows)[0] == sound
        assert "come after" in refusal(path, rows=rows)[1]
    table = columns()
    table |= {f"sigma_tau.{joint}": np.repeat([0.1, 0.2], 30) for joint in JOINTS}
    path = written(tmp_path, kind, table)
    assert refusal(path, rows=30) == (1, refusal(path, rows=30)[1])
    assert "sigma_tau changes over time" in refusal(path, rows=30)[1]
    assert "sigma_tau changes over time" in refusal(path, rows=25)[1]
    del table["tau.knee"]
    path = written(tmp_path, kind, {k: v for k, v in table.items() if "tau" not in k})
    assert "no column tau" in refusal(path)[1]
    path = written(tmp_path, kind, {name: value[:1] for name, value in columns().items()})
    assert "two samples" in refusal(path)[1]
    path = written(tmp_path, kind, {name: value[:0] for name, value in columns().items()})
    refusal(path)


def test_other_kinds_are_refused(tmp_path):
    write_log(swing(seconds=0.5), tmp_path / "log.npz")
    assert ".parquet" in refusal(tmp_path / "log.npz")[1]
    assert "no such file" in refusal(tmp_path / "none.csv")[1]
    with pytest.raises(ValueError, match="two samples at least"):
        next(read_chunks(tmp_path / "log.npz", rows=1))
    pytest.importorskip("pyarrow")
    lists = write_parquet(tmp_path / "lists.parquet", arrays())
    assert "columns of numbers" in refusal(lists)[1]
    lists.write_bytes(lists.read_bytes()[:-200])
    assert refusal(lists)[0] == 0


@pytest.mark.slow
def test_a_stream_from_a_file_is_the_stream_from_memory(tmp_path):
    pytest.importorskip("pyarrow")
    log = swing(seconds=6.0)
    write_log(log, tmp_path / "log.parquet")
    robot = ji.load_model(double_pendulum())
    ekf = make_estimator(robot, ["lower"], sigma_tau=0.1, prior=Load(1.0))
    stream = Stream(ekf, window=8, block=16)
    one, other = (
        jax.tree.map(lambda *x: np.concatenate(x), *stream.run(chunks))
        for chunks in ([log], read_chunks(tmp_path / "log.parquet", rows=111, names=robot))
    )
    for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        np.testing.assert_array_equal(a, b)


@KINDS
def test_memory_is_a_chunk_s_whatever_the_file_s(tmp_path, kind, monkeypatch):
    """Of a file much longer than a chunk; Arrow's own buffers are its affair, and measured elsewhere."""
    monkeypatch.setattr("jax_inertia.logs.readers.delimited._BLOCK", 1 << 16)
    samples, rows = 160_000 if kind == "parquet" else 40_000, 1000
    path = written(tmp_path, kind, columns(samples))
    for _ in itertools.islice(read_chunks(path, rows=rows), 3):  # what is imported late
        pass
    tracemalloc.start()
    try:
        count = sum(len(chunk.time) for chunk in read_chunks(path, rows=rows))
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert count == samples
    assert peak < 0.5 * samples * 7 * 8


@pytest.mark.parametrize("read", [read_log, lambda path: next(read_chunks(path))])
@pytest.mark.parametrize("heading", ["time,qpos.a,tau.a", "time,qpos.a,tau.a,tau_unit"])
def test_headings_without_rows_are_refused_in_one_line(tmp_path, read, heading):
    path = tmp_path / "empty.csv"
    path.write_text(heading + "\n")
    with pytest.raises(LogError, match=r"no rows; expected at least two"):
        read(path)


def test_row_groups_that_were_read_are_let_go(tmp_path):
    arrow, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    path, size = tmp_path / "long.parquet", 20_000
    noise = np.random.default_rng(0).normal(size=(20, 2, size))
    rows = [
        arrow.table({"time": k * size + np.arange(size) * 1.0, "qpos.a": q, "tau.a": tau})
        for k, (q, tau) in enumerate(noise)
    ]
    with parquet.ParquetWriter(path, rows[0].schema) as file:
        for table in rows:
            file.write_table(table)
    del rows, table
    before, held = arrow.total_allocated_bytes(), []
    for chunk in read_chunks(path, rows=size):
        held.append(arrow.total_allocated_bytes() - before)
        assert len(chunk.time) == size
    assert max(held) < 0.3 * path.stat().st_size
