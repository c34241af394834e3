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
    "name": "a", "title": "robot a", "unit": "N m", "nominal": {"rms": 2.0}, "least_squares": {"rms": 0.5},
    "published": None,
    "tool": {"stated": {"after": 0.4}, "measured": {"rms": 0.7}, "verdict": "partly",
             "effects": ["armature at x", "payload at hand"], "seconds": 9.0},
}  # fmt: skip
LOOP = {
    "cpu": 9.0, "pace_cpu": 4.0, "verdict": "explained", "joints": ["x", "y"],
    "effects": [{"family": "dead_band", "location": {"name": "x"}}],
    "motions": {"steps": {"nominal": [0.03, 0.02], "pace": [0.004, 0.01], "ours": [0.006, 0.01]}},
}  # fmt: skip


def test_where_the_tool_is_behind_is_said():
    text = page.page({"commit": "abc", "torque": [ROW], "positions": {"go2": LOOP}})
    assert "| robot a | 2 | 0.5 | – | 0.4 | 0.7 | partly | payload at hand | 9 |" in text
    assert "- robot a: as handed over (0.7) behind least squares" in text
    assert "as it states" not in text.split("**Behind a baseline**")[1].split("##")[0]
    assert "| Go2 in the air | steps | 25.50 | 7.62 | 8.25 | 1.08 | 1 of 2 |" in text
    assert "- Go2 in the air, steps: behind the PACE-like fit at x (6.0 for 4.0)" in text
    assert "worse than the model as given" not in text


def test_new_results_take_the_place_of_old_ones(tmp_path):
    stored = {"torque": [ROW], "positions": {}}
    file = tmp_path / "new.json"
    file.write_text(json.dumps([ROW | {"title": "robot b"}, ROW | {"name": "c"}]))
    page.take(stored, file)
    assert [r["title"] for r in stored["torque"]] == ["robot b", "robot a"]
    file.write_text(json.dumps({"go2": LOOP | {"notes": "long"}}))
    page.take(stored, file)
    assert set(stored["positions"]["go2"]) == set(LOOP)


def test_the_page_is_what_is_stored():
    stored = json.loads(page.STORED.read_text())
    assert page.PAGE.read_text() == page.page(stored)
