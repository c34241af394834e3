"""The map from log odds to probabilities: fitted to what was so, and what is stored is what is written."""

import json

import numpy as np
import pytest

from benchmarks.exam import calibrate
from jax_inertia.diagnosis.certainty.probability import confidence, probability


@pytest.mark.parametrize("slope", [0.3, 1.0])
def test_a_slope_comes_back_from_what_was_so_with_its_probability(slope):
    rng = np.random.default_rng(1)
    odds = np.sinh(rng.uniform(-4.0, 6.0, 4000))
    so = rng.random(4000) < 1.0 / (1.0 + np.exp(-slope * np.arcsinh(odds)))
    rows = [{"odds": float(x), "so": bool(s)} for x, s in zip(odds, so, strict=True)]
    assert calibrate.fitted(rows) == pytest.approx((slope, 0.0), rel=0.1)
    assert calibrate.fitted(rows, offset=True) == pytest.approx((slope, 0.0), abs=0.2)


ROW = {
    "name": "1", "robot": "arm", "verdict": "explained", "log_odds": 3.0,
    "odd": ["payload", "hand", 9.0], "equiv": [{"family": "com_shift", "location": {"name": "hand"}}],
    "present": [{"family": "load_friction", "location": {"name": "hip"}}],
    "listed": [["com_shift", "hand", 0.9, [], 20.0], ["cogging", "hip", 0.6, [], 2.0]],
    "not_listed": [["load_friction", "hip", -3.0], ["joint_spring", "hip", -4.0]],
}  # fmt: skip


def test_an_effect_is_there_where_it_or_its_equal_is_hidden():
    rows = calibrate.effects_of(ROW)
    assert [(r["odds"], r["so"], r["listed"]) for r in rows] == [
        (20.0, True, True),
        (2.0, False, True),
        (-4.0, False, False),
    ]


def test_a_verdict_is_right_with_all_that_it_lists_and_nothing_missed():
    def right(**changes) -> bool | None:
        verdict = calibrate.verdict_of(ROW | changes)
        return None if verdict is None else verdict["so"]

    assert right() is False
    assert right(listed=ROW["listed"][:1]) is True
    assert right(listed=ROW["listed"][:1], verdict="partly") is False
    assert right(listed=[]) is False
    assert right(listed=[], odd=["payload", "hand", 2.0]) is None
    assert right(listed=[], odd=None) is True
    assert right(odd=["resonance", "hip", 9.0], verdict="unknown") is True


def test_what_is_written_is_what_is_stored():
    kept = json.loads(calibrate.STORED.read_text())
    assert json.loads(calibrate.MAP.read_text()) == calibrate.mapping(kept)
    assert calibrate.PAGE.read_text() == calibrate.page(kept)
    given = calibrate.mapping(kept)
    for row in kept["effects"][:5]:
        by_page = calibrate.stated((given["slope"], 0.0), [row])[0]
        assert probability(row["odds"]) == pytest.approx(by_page)
    for row in kept["verdicts"][:5]:
        ab = given["slope_of_verdicts"], given["offset_of_verdicts"]
        by_page = calibrate.stated(ab, [row])[0]
        assert confidence(row["odds"]) == pytest.approx(by_page)
