"""The Monte Carlo's coverage: what is chosen never sees what it is scored on, and a filter too sure is found out."""

from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[1]

from benchmarks import coverage  # noqa: E402


def trials(drift: float, seed: int, count: int) -> dict[str, np.ndarray]:
    """Errors of 0.1 kg; a filter that is told of drift d claims d · 0.1 kg."""
    rng = np.random.default_rng([seed, int(8 * drift)])
    return {
        "error": 0.1 * rng.normal(size=count),
        "sigma": np.full(count, 0.1 * drift),
        "physical": np.ones(count),
    }


def test_honest_drift_is_chosen_and_scored_on_other_trials():
    asked = []

    def run(drift: float, seed: int, count: int) -> dict[str, np.ndarray]:
        asked.append((drift, seed, count))
        return trials(drift, seed, count)

    found = coverage.measure(200, 400, run)
    assert found["drift"] == 1.0
    assert asked[:-1] == [(d, coverage.CHOOSING, 200) for d in coverage.DRIFTS]
    assert asked[-1] == (1.0, coverage.SCORING, 400)
    share = found["score"]["within_2_sigma"]
    assert share["low"] < coverage.WITHIN[2] < share["high"]


@pytest.mark.parametrize(("drift", "low", "high"), [(0.25, 0.25, 0.55), (4.0, 0.99, 1.0)])
def test_filter_that_is_too_sure_or_too_timid_is_found_out(drift: float, low: float, high: float):
    share = coverage.scored(trials(drift, 3, 400))["within_2_sigma"]
    assert low <= share["share"] <= high
    assert not share["low"] < coverage.WITHIN[2] < share["high"]
