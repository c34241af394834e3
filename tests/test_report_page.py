"""The report's page: torques measured and predicted, what to do next, axes of logs with stamps of an epoch."""

import dataclasses

import numpy as np
import pytest
from diagnosis_made_up import diagnosis

from jax_inertia.diagnosis.report import figures
from jax_inertia.diagnosis.report.next_motion import next_step, to_record
from jax_inertia.diagnosis.result import Trace, Verdict
from jax_inertia.text.report_page import rendered
from jax_inertia.text.words import from_start

EPOCH = 1.7e9


@pytest.fixture
def found():
    """A joint whose model errs by 3 N m in one second of twenty, and then by a tenth of that."""
    time = EPOCH + np.arange(500) / 25.0
    tau = np.sin(time - EPOCH)[:, None]
    before = np.where((time > EPOCH + 12) & (time < EPOCH + 13), 3.0, 0.1)[:, None]
    state = {"q": tau, "v": tau, "tau": tau}
    trace = Trace(time, before, 0.1 * before, np.ones_like(tau), ("knee",), state)
    one = diagnosis(Verdict.PARTLY)
    return dataclasses.replace(
        one, trace=trace, units={"knee": "N m"}, joints={"knee": {}}, speed={"knee": 1.0}
    )


def test_each_joint_s_torque_is_drawn_measured_nominal_and_corrected(found, monkeypatch):
    drawn = []
    monkeypatch.setattr(figures, "embedded", lambda figure: drawn.append(figure) or "svg")
    assert figures.torques(found) == [("knee", "svg")]
    (axes,) = drawn[0].axes
    measured, nominal, corrected = (line.get_ydata() for line in axes.lines)
    seconds = axes.lines[0].get_xdata()
    # The part that is shown holds the second in which the model errs; its stamps count from its own start.
    assert seconds[0] == 0.0
    assert seconds[-1] == pytest.approx(figures.SHOWN_SECONDS, abs=0.1)
    assert np.sum(np.isclose(nominal - measured, 3.0)) == 24
    np.testing.assert_allclose(corrected - measured, 0.1 * (nominal - measured), atol=1e-12)
    assert axes.get_ylabel() == "torque [N m]"


def test_stamps_of_an_epoch_count_from_the_first():
    time = EPOCH + np.array([0.0, 0.5])
    shown, label = from_start(time)
    np.testing.assert_allclose(shown, [0.0, 0.5])
    assert label == "time [s] after 1700000000.000 s"
    shown, label = from_start(np.array([12.0, 12.5]))
    assert (shown[0], label) == (12.0, "time [s]")


def test_what_to_do_next_is_one_sentence_that_fits_the_verdict(found):
    told = {
        verdict: next_step(
            one := dataclasses.replace(found, verdict=verdict, joints={}), to_record(one)
        )
        for verdict in Verdict
    }
    assert all(text.endswith(".") and text.count(". ") == 0 for text in told.values())
    assert told[Verdict.NO_GAP].startswith("Keep the model")
    assert "corrected.xml" in told[Verdict.EXPLAINED]
    assert "corrected.xml" not in told[Verdict.NO_GAP]
    top = max(found.remainder.where, key=lambda n: found.remainder.where[n])
    assert top in told[Verdict.PARTLY]
    # A correction that is worse than the model is not advised.
    checked = dataclasses.replace(found.heldout, after=2 * found.heldout.before)
    worse = dataclasses.replace(found, heldout=checked, test=None)
    assert next_step(worse, ()).startswith("Keep the model")


def test_every_table_scrolls_in_a_box_of_its_own():
    text = rendered(
        "jax_inertia.text",
        {"plain": str},
        template="detectable_sizes.html",
        undetectable=[{"family": "play", "low": "1", "high": "2", "worst": "hip"}],
    )
    assert '<div class="scroll" tabindex="0"><table>' in text
    assert text.count("</table></div>") == 1
