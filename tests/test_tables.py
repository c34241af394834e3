"""Tables as NumPy, pandas and recorders of robots write them."""

import numpy as np
import pandas as pd
import pytest

from jax_inertia.logs.log import LogError
from jax_inertia.logs.log_files import read_log
from jax_inertia.logs.readers import Options

NAMES = ("time", "qpos.hip", "qpos.knee", "tau.hip", "tau.knee")
TABLE = np.column_stack([0.01 * np.arange(40), *np.random.default_rng(0).normal(size=(4, 40))])


def read(path, **options):
    log = read_log(path, options=Options(**options))
    return np.column_stack([log.time, log.qpos, log.tau])


@pytest.mark.parametrize("comments", ["# ", ""])
def test_columns_parted_by_blanks(tmp_path, comments):
    path = tmp_path / "log.csv"
    np.savetxt(path, TABLE, header=" ".join(NAMES), comments=comments)
    np.testing.assert_array_equal(read(path), TABLE)
    # Aligned by hand, and with decimal commas.
    rows = ["   ".join(f"{x:12.5f}" for x in row).replace(".", ",") for row in TABLE]
    path.write_text("\n".join(["  ".join(NAMES), *rows]))
    np.testing.assert_allclose(read(path), TABLE, atol=1e-5)
    path.write_text("\n".join(["  ".join(NAMES), *rows[:3], "1 2 3"]))
    with pytest.raises(LogError, match="line 5 has 3 fields, the heading 5"):
        read(path)


@pytest.mark.parametrize("delimiter", [",", ";", "\t", " "])
def test_a_row_of_units(tmp_path, delimiter):
    units = ("ms", "deg", "rev", "Nm", "Nm")
    scale = np.array([1e-3, np.pi / 180, 2 * np.pi, 1, 1])
    rows = [NAMES, units, *TABLE]
    (tmp_path / "log.csv").write_text("\n".join(delimiter.join(map(str, row)) for row in rows))
    np.testing.assert_allclose(read(tmp_path / "log.csv"), TABLE * scale, rtol=1e-12)


def test_a_row_of_units_that_are_none_is_named(tmp_path):
    rows = [NAMES, ("s", "furlong", "rad", "Nm", "Nm"), *TABLE]
    (tmp_path / "log.csv").write_text("\n".join(",".join(map(str, row)) for row in rows))
    with pytest.raises(LogError, match="furlong"):
        read(tmp_path / "log.csv")
    # Words that are no units are no numbers either.
    (tmp_path / "log.csv").write_text(
        "\n".join(",".join(map(str, row)) for row in [NAMES, *[["x"] * 5], *TABLE])
    )
    with pytest.raises(LogError, match="line 2, column 'time': 'x' is no number"):
        read(tmp_path / "log.csv")


@pytest.mark.parametrize("zone", [None, "UTC", "Asia/Tokyo"])
def test_stamps_as_dates(tmp_path, zone):
    frame = pd.DataFrame(TABLE, columns=NAMES)
    start = pd.Timestamp("2026-03-01 23:59:59.9", tz=zone)
    frame["time"] = start + pd.to_timedelta(TABLE[:, 0], unit="s")
    frame.to_csv(tmp_path / "log.csv", index=False)
    log = read_log(tmp_path / "log.csv")
    np.testing.assert_allclose(log.time, TABLE[:, 0], atol=1e-9)
    assert any(
        "stamps are dates; time counts from 2026-03-01 23:59:59.9" in note for note in log.notes
    )


def test_one_command_names_all_columns(tmp_path):
    """And it works as it is printed."""
    headings = ("__time", "actual_q_0", "actual_q_1", "target_moment_0", "target_moment_1")
    (tmp_path / "log.csv").write_text(
        "\n".join([",".join(headings), *(",".join(map(str, r)) for r in TABLE)])
    )
    with pytest.raises(LogError) as caught:
        read(tmp_path / "log.csv")
    said = str(caught.value)
    words = said[said.index("(jax-inertia convert ") : said.index(");")].split("'")[1::2]
    assert words == ["time=__time", "qpos.*=actual_q_*", "tau.*=target_moment_*"]
    columns = dict(word.split("=") for word in words)
    np.testing.assert_array_equal(read(tmp_path / "log.csv", columns=columns), TABLE)


def test_a_file_of_one_row_that_grows(tmp_path):
    (tmp_path / "log.csv").write_text(",".join(NAMES) + "\n" + ",".join(map(str, TABLE[0])) + "\n")
    with pytest.raises(LogError, match=r"1 sample|samples"):
        read(tmp_path / "log.csv")
