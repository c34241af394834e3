"""The page of real robots is what is stored, and says where the tool is behind a baseline."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path

ROOT = Path(__file__).parents[1]
spec = importlib.util.spec_from_file_location(
    "real_page", ROOT / "benchmarks" / "real_logs" / "page.py"
)
assert spec is not None
assert spec.loader is not None
page = importlib.util.module_from_spec(spec)
spec.loader.exec_module(page)

ROW = {
    "name": "a", "title": "robot a, one → two", "unit": "N m",
    "nominal": {"rms": 2.0, "per_joint": {}}, "least_squares": {"rms": 0.5, "per_joint": {}}, "published": None,
    "tool": {"stated": {"after": 0.4, "per_joint": {}}, "handed_over": {"rms": 0.7, "per_joint": {}, "rows": {}},
             "verdict": "partly", "effects": ["payload at hand"], "seconds": 9.0},
}  # fmt: skip
AMPERES = ROW | {"name": "a_raw", "unit": "A", "nominal": None}
LOOP = {
    "cpu": 9.0, "pace_cpu": 4.0, "verdict": "explained", "joints": ["x", "y"],
    "effects": [{"family": "dead_band", "location": {"name": "x"}}],
    "motions": {"steps": {"nominal": [0.03, 0.02], "pace": [0.004, 0.01], "ours": [0.006, 0.01]}},
}  # fmt: skip


def stored(*rows, robots=None):
    """What is stored of some rows by torque, and of robots by replays."""
    positions = robots and {"commit": "def", "robots": robots, "notes": []}
    made = {"commit": "abc", "date": "2026-11-30"}
    torque = {"rows": [page.slim(r) | made for r in rows]}
    return {"torque": torque, "positions": positions}


def test_where_the_tool_is_behind_is_said():
    text = page.page(stored(ROW, robots={"go2": LOOP}))
    assert (
        "| robot a, one → two | 2 | **0.5** | – | 0.4 | 0.7 | partly | payload at hand | 9 |"
        in text
    )
    assert "- robot a, one → two (0.7): least squares (0.5)" in text
    assert "| Go2 in the air | steps | 25.50 | 7.62 | 8.25 | 1.08 | 1 of 2 |" in text
    assert "- Go2 in the air, steps: behind the PACE-like fit at x (6.0 for 4.0)" in text
    assert "worse than the model as given" not in text


def test_each_unit_has_a_table_of_its_own():
    text = page.page(stored(ROW, AMPERES))
    newton, raw = text.split("## The same in the unit of the log")
    assert "| robot a, one → two | A | **0.5** | – | 0.7 | partly |" in raw
    assert " | A | " not in newton


def test_what_is_not_measured_is_said_to_be():
    assert "Not measured at this commit." in page.page(stored(ROW))


def test_new_results_take_the_place_of_old_ones(tmp_path):
    kept = stored(ROW, ROW | {"name": "c"})
    file = tmp_path / "new.json"
    file.write_text(json.dumps(ROW | {"title": "robot b"}))
    page.take(kept, file, "fed")
    assert [r["title"] for r in kept["torque"]["rows"]] == ["robot b", "robot a, one → two"]
    assert [r["commit"] for r in kept["torque"]["rows"]] == ["fed", "abc"]
    assert "commit `fed`" in page.page(kept) or "of `fed`: robot b" in page.page(kept)
    file.write_text(json.dumps({"go2": LOOP | {"notes": "long"}}))
    page.take(kept, file, "bad")
    assert set(kept["positions"]["robots"]["go2"]) == set(LOOP)
    assert kept["positions"]["commit"] == "bad"


def test_the_page_is_what_is_stored():
    stored = json.loads(page.STORED.read_text())
    assert page.PAGE.read_text() == page.page(stored)
