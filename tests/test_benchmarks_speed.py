"""The clocks of the benchmarks, and the figures that are looked up by name."""

import json
import time
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[1]

from benchmarks.harness.clock import race, times_faster  # noqa: E402
from benchmarks.harness.gate_page import touchdowns  # noqa: E402


def test_race_finds_the_faster_one():
    found = race({"fast": lambda: time.sleep(0.002), "slow": lambda: time.sleep(0.02)}, rounds=5)
    assert 2.0 < times_faster(found, "fast", "slow") < 12.0
    assert times_faster(found, "fast", "fast", "slow") > times_faster(found, "fast", "slow")


def test_touchdown_is_where_a_foot_takes_load():
    force = np.zeros((1, 6, 8, 3))
    force[0, :, :4, 2] = np.array([0, 5, 100, 100, 0, 0])[:, None]
    force[0, :, 4:, 2] = np.array([90, 90, 90, 0, 0, 90])[:, None]
    np.testing.assert_array_equal(touchdowns(force)[0], [False, False, True, False, False, True])


def test_named_figures_are_there():
    path = ROOT / "benchmarks" / "results" / "speed.json"
    if not path.exists():
        pytest.skip("no results of benchmarks/speed.py here")
    found = json.loads(path.read_text())
    for name in ("regressor2_vs_pinocchio", "regressor_full_vs_pinocchio"):
        assert found[name] > 0
    for name in ("filter_steps_per_s", "closed_loop_ticks_per_s", "roofline_share"):
        assert found[f"gpu_{name}"] is None or found[f"gpu_{name}"] > 0
