"""`watch`: a log while it is written."""

import json
import threading
import time

import mujoco
import pytest

from jax_inertia.cli.main import main
from jax_inertia.logs.chunks import followed, read_chunks
from jax_inertia.logs.log import LogError
from jax_inertia.logs.log_files import write_log
from jax_inertia.robots.pendulum import double_pendulum, swing


@pytest.fixture
def grown(tmp_path):
    """(a whole .csv, one of which half is there, what writes the rest after a while)."""
    write_log(swing(load=0.5, seconds=8.0, rate=200.0), tmp_path / "whole.csv")
    text = (tmp_path / "whole.csv").read_text()
    cut = len(text) // 2 + 7  # within a line
    growing = tmp_path / "grows.csv"
    growing.write_text(text[:cut])

    def write_the_rest():
        time.sleep(0.5)
        with open(growing, "a") as file:
            file.write(text[cut:])

    return tmp_path / "whole.csv", growing, threading.Thread(target=write_the_rest)


def test_a_file_that_grows_is_read_to_its_end(grown):
    whole, growing, writer = grown
    writer.start()
    chunks = list(read_chunks(growing, rows=64, more=followed(growing, idle=2.0)))
    writer.join()
    assert [len(c.time) for c in chunks] == [len(c.time) for c in read_chunks(whole, rows=64)]
    assert chunks[-1].time[-1] == pytest.approx(7.995)


def test_a_parquet_file_has_no_rows_before_its_end(tmp_path):
    pytest.importorskip("pyarrow")
    write_log(swing(seconds=1.0), tmp_path / "log.parquet")
    with pytest.raises(LogError, match=r"write a \.csv"):
        list(read_chunks(tmp_path / "log.parquet", more=lambda: False))


@pytest.mark.slow
def test_watch_prints_the_same_of_a_growing_file(grown, tmp_path, capsys):
    whole, growing, writer = grown
    # The last model compiled from XML is the one that is saved.
    mujoco.mj_saveLastXML(str(tmp_path / "arm.xml"), double_pendulum())
    options = ["--model", str(tmp_path / "arm.xml"), "--bodies", "lower", "--json", "--idle"]
    writer.start()
    assert main(["watch", str(growing), *options, "3"]) == 0
    writer.join()
    said = capsys.readouterr().out
    assert main(["watch", str(whole), *options, "0.01"]) == 0
    assert capsys.readouterr().out == said
    last = json.loads(said.splitlines()[-1])
    assert last["time_s"] > 6.5
    assert last["bodies"]["lower"]["mass_kg"] == pytest.approx(1.5, abs=0.05)
    assert 0 < last["nis"] < last["gate"]


def test_watch_of_a_body_that_is_not_there_is_one_line(grown, tmp_path, capsys):
    (tmp_path / "arm.xml").write_text("<mujoco/>")
    assert (
        main(["watch", str(grown[0]), "--model", str(tmp_path / "arm.xml"), "--bodies", "x"]) == 2
    )
    assert capsys.readouterr().err.count("\n") == 1
