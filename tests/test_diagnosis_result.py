"""What a diagnosis says of itself."""

import dataclasses

import numpy as np
import pytest
from diagnosis_made_up import diagnosis

from jax_inertia.diagnosis.effects.base import Interval, Place
from jax_inertia.diagnosis.report.gap_stretches import gap_stretches
from jax_inertia.diagnosis.report.wording import named
from jax_inertia.diagnosis.result import Found, Tie, Verdict

KNEE, HIP = Place("joint", "knee", 0), Place("joint", "hip", 1)


def effect(family: str, place: Place = KNEE, *ties: Tie) -> Found:
    size = {"bias": Interval(0.5, 0.4, 0.6, "N m")}
    return Found(family, place, size, 0.9, 20.0, 20.0, 0.95, ties, False, "τ + <b>")


def test_in_a_console_and_in_a_notebook():
    tied = effect("torque_bias", KNEE, Tie("joint_spring", HIP, "motion_limited"))
    found = dataclasses.replace(diagnosis(Verdict.EXPLAINED, tied), notes=("a <note>",))
    assert "torque_bias at knee: bias 0.5 [0.4, 0.6] N m; or joint_spring at hip" in repr(found)
    page = found._repr_html_()
    for said in ("torque bias", "τ + &lt;b&gt;", "95 %", "joint_spring at hip", "a &lt;note&gt;"):
        assert said in page
    assert "<b>" in page
    assert "<table" not in diagnosis(Verdict.NO_GAP)._repr_html_()


@pytest.mark.parametrize(
    ("axes", "said"),
    [({"x": 0.0, "y": 0.3}, "0.3 rad"), ({"x": 2.0, "y": -1.0, "z": 2.0}, "3 rad")],
)
def test_a_vector_is_told_by_its_length(axes, said):
    numbers = {f"tilt_{k}": Interval(v, v - 1, v + 1, "rad") for k, v in axes.items()}
    found = effect("gravity_tilt", Place("global", "global", -1))
    tilt = dataclasses.replace(found, parameters=numbers)
    assert f"gravity tilt ({said})" in named(tilt)


@pytest.mark.parametrize(
    ("loud", "expected"),
    [
        # 25 rows a second; means over 0.2 s are of five rows, so stretches begin and end one row outside.
        ([(50, 75)], [(49, 76)]),
        ([(50, 75), (80, 100)], [(49, 101)]),
        ([(50, 75), (150, 175)], [(49, 76), (149, 176)]),
        ([], []),
    ],
)
def test_stretches_that_stand_out(loud, expected):
    y = np.zeros((250, 1))
    for start, stop in loud:
        y[start:stop] = 8.0
    time = np.arange(250) / 25.0
    found = gap_stretches(time, y)
    wanted = [(time[a], time[b]) for a, b in expected]
    np.testing.assert_allclose(np.array(found).reshape(-1, 2), np.array(wanted).reshape(-1, 2))
