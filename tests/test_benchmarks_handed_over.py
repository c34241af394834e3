"""The page of what is handed over is that of its stored rows, and its figures are counted as it says."""

import json
import subprocess
import sys
from pathlib import Path

from benchmarks.exam import handed_over

ROOT = Path(__file__).parents[1]


def row(name: str, handed: float, odd=None, listed=(), verdict="explained") -> dict:
    numbers = {"stated": 0.01, "own": 0.01, "handed": handed, "ls": 0.05, "left_out": []}
    rest = {"odd": odd, "equiv": [], "present": [], "listed": list(listed), "verdict": verdict}
    return {"name": name} | numbers | rest


def test_the_page_is_that_of_its_rows():
    command = [sys.executable, "-m", "benchmarks.exam.handed_over", "page", "--check"]
    assert subprocess.run(command, cwd=ROOT, check=False).returncode == 0
    text = handed_over.page(json.loads(handed_over.STORED.read_text()))
    assert text == handed_over.PAGE.read_text()


def test_what_is_counted():
    spring = ["joint_spring", "elbow", 9.0]
    rows = [
        row("0", 0.01),
        row("1", 0.10, listed=[["push", "hand", 0.9, []]]),
        row("2", 0.02, spring, [["joint_spring", "elbow", 0.9, []]]),
        row("3", 0.02, spring, [["push", "hand", 0.9, [["joint_spring", "elbow"]]]]),
        row("4", 0.02, spring, verdict="partly"),
        row("5", 0.02, ["resonance", "elbow", 9.0], verdict="partly"),
        {"name": "6", "failed": "why"},
    ]
    s = handed_over.summary(rows)
    assert s["odd_found"] == [2, 3]
    assert s["inventions"] == [1, 2]
    assert s["outside_flagged"] == [1, 1]
    assert s["no_worse_than_least_squares"] == [5, 6]
    assert s["failed"] == ["6"]
    assert [x[0] for x in s["missed"]] == ["4"]
