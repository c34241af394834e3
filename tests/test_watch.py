"""`watch`: a log while it is written."""

import threading
import time

import mujoco
import numpy as np
import pytest
from schemas import validated

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
        list(read_chunks(tmp_path / "log.parquet", more=lambda file: None))


def follow(path, *steps):
    """All samples of a file that the steps write, one after another while it is followed."""

    def write():
        for step in steps:
            time.sleep(0.2)
            step()

    writer = threading.Thread(target=write)
    writer.start()
    chunks = list(read_chunks(path, rows=16, more=followed(path, idle=1.0, pause=0.01)))
    writer.join()
    return np.concatenate([c.time for c in chunks]), np.concatenate([c.tau for c in chunks])


@pytest.fixture
def lines(tmp_path):
    """(the log, heading and rows of its .csv)."""
    log = swing(load=0.5, seconds=2.0, rate=200.0)
    write_log(log, tmp_path / "all.csv")
    heading, *rows = (tmp_path / "all.csv").read_text().splitlines(keepends=True)
    return log, heading, rows


def test_a_log_that_is_rotated_is_followed(lines, tmp_path):
    """Renamed with another begun in its place; and copied and cut to nothing. Each begins with the heading again."""
    log, heading, rows = lines
    for kind in ("renamed", "truncated"):
        path = tmp_path / f"{kind}.csv"
        path.write_text("".join([heading, *rows[:150]]))

        def rotate(path=path, kind=kind):
            if kind == "renamed":
                path.rename(path.with_suffix(".1"))
            else:
                path.write_text("")

        def begin(path=path):
            with open(path, "a") as file:
                file.write("".join([heading, *rows[150:]]))

        stamps, tau = follow(path, rotate, begin)
        np.testing.assert_allclose(stamps, log.time, atol=1e-9)
        np.testing.assert_allclose(tau, log.tau, atol=1e-9)


def test_a_heading_that_comes_again_and_half_a_last_line_are_no_samples(lines, tmp_path):
    log, heading, rows = lines
    path = tmp_path / "again.csv"
    path.write_text("".join([heading, *rows[:100]]))

    def again():
        with open(path, "a") as file:
            # A number that is cut off is a number, and a wrong one.
            file.write("".join([heading, *rows[100:300], rows[300][:-9]]))

    stamps, tau = follow(path, again)
    np.testing.assert_allclose(stamps, log.time[:300], atol=1e-9)
    np.testing.assert_allclose(tau, log.tau[:300], atol=1e-9)


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
    last = [validated("watch", line) for line in said.splitlines()][-1]
    assert last["time_s"] > 6.5
    assert last["bodies"]["lower"]["mass_kg"] == pytest.approx(1.5, abs=0.05)
    assert 0 < last["nis"] < last["gate"]


def test_watch_of_a_body_that_is_not_there_is_one_line(grown, tmp_path, capsys):
    (tmp_path / "arm.xml").write_text("<mujoco/>")
    assert (
        main(["watch", str(grown[0]), "--model", str(tmp_path / "arm.xml"), "--bodies", "x"]) == 2
    )
    assert capsys.readouterr().err.count("\n") == 1
