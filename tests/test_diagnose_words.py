"""What a diagnosis says in words: which motion would split a tie, and the headline of every verdict."""

import dataclasses

import numpy as np
import pytest

from jax_inertia.cli.demo.command import judged
from jax_inertia.cli.demo.hidden import Secret
from jax_inertia.diagnosis.effects.base import Interval, Place
from jax_inertia.gap.energies import Counted, Shrink
from jax_inertia.gap.finding import Diagnosis, Finding, Tie
from jax_inertia.gap.report import to_report
from jax_inertia.gap.suggest import suggestions
from jax_inertia.gap.trace import Trace, regions
from jax_inertia.gap.verdict import Verdict

KNEE, HIP = Place("joint", "knee", 0), Place("joint", "hip", 1)
LEG = Place("body", "leg", 0)


def trace(samples: int = 500) -> Trace:
    """Friction at the knee over noise, and its removal."""
    rng = np.random.default_rng(0)
    time = np.arange(samples) * 0.02
    v = np.stack([np.sin(3 * time), np.cos(2 * time)], axis=1)
    noise = 0.01 * rng.normal(size=(samples, 2))
    effect = np.stack([-0.5 * v[:, 0], np.zeros(samples)], axis=1)
    return Trace(
        time=time,
        rows=("knee", "hip"),
        units=("N m", "N"),
        q=np.cumsum(v, axis=0) * 0.02,
        v=v,
        tau=rng.normal(size=(samples, 2)),
        rest=np.zeros((samples, 2), bool),
        missing=effect + noise,
        effects=(effect,),
        left=(noise,),
        noise=np.full(2, 0.01),
        torque_noise=None,
        turning=np.zeros(2),
        excused=np.zeros((samples, 2)),
        erring=np.zeros((samples, 2)),
        energy=((effect + noise) / 0.01) ** 2,
        forces=(),
        gap=(0,),
        counted=Counted(np.ones((samples, 1), bool)),
    )


def found(verdict: Verdict, *findings: Finding) -> Diagnosis:
    return Diagnosis(
        verdict=verdict,
        confidence=0.9,
        chi2=30.0,
        noise_floor=1.0,
        per_joint_rms={"knee": 0.35, "hip": 0.01},
        share={"knee": 0.9, "hip": 0.1},
        findings=findings,
        heldout=Shrink(0.35, 0.01, 0.01, 0.0),
        test=None,
        when=(),
        undetectable_below=(),
        notes=(),
        doubts=(),
        trace=trace(),
    )


def finding(family: str, place: Place = KNEE, *ties: Tie) -> Finding:
    numbers = {"size": Interval(0.5, 0.4, 0.6, "N m")}
    return Finding(family, place, numbers, 0.9, 0.8, ties, "b = const & <odd>")


@pytest.mark.parametrize(
    ("family", "other", "place", "kind"),
    [
        ("coulomb_friction", "stribeck_friction", KNEE, "slow reversals"),
        ("time_delay", "actuator_lag", KNEE, "fast sweep"),
        ("payload", "constant_force", LEG, "brisk, in many postures"),
        ("torque_gain", "torque_saturation", KNEE, "small and large torques"),
        ("backlash", "encoder_offset", KNEE, "torque reversals"),
        ("torque_bias", "joint_spring", KNEE, "wide and at many speeds"),
    ],
)
def test_each_tie_gets_the_motion_that_would_split_it(family, other, place, kind):
    tie = Tie(other, place, "motion_limited")
    (one,) = suggestions(found(Verdict.EXPLAINED, finding(family, place, tie)))
    assert one.kind == kind
    assert one.between == (family, other)
    assert all(np.isfinite(x) for x in one.numbers.values())


def test_two_places_are_moved_one_at_a_time_and_exact_ties_not_at_all():
    elsewhere = Tie("torque_bias", HIP, "motion_limited")
    exact = Tie("joint_spring", KNEE, "exact")
    (one,) = suggestions(found(Verdict.EXPLAINED, finding("torque_bias", KNEE, elsewhere, exact)))
    assert one.kind == "one place at a time"
    assert "knee" in one.text
    assert "hip" in one.text
    assert suggestions(found(Verdict.EXPLAINED, finding("torque_bias", KNEE, exact))) == ()


def test_headlines():
    one = finding("torque_bias")
    assert "torque bias at knee (0.5 N m)" in found(Verdict.EXPLAINED, one).headline
    assert "something more" in found(Verdict.PARTLY, one).headline
    assert "not fit" in found(Verdict.UNKNOWN, one).headline
    assert "mostly at knee" in found(Verdict.UNKNOWN).headline
    assert found(Verdict.NO_GAP).headline.startswith("No gap")


def test_doubts_stand_beside_the_verdict():
    doubted = dataclasses.replace(found(Verdict.UNKNOWN), doubts=("clocks <b> run apart",))
    assert "clocks &lt;b&gt; run apart" in doubted._repr_html_()
    assert to_report(doubted)["doubts"] == ["clocks <b> run apart"]


def test_a_gap_that_was_at_its_floor_is_said_to_be():
    one = dataclasses.replace(
        found(Verdict.EXPLAINED, finding("torque_bias")), test=Shrink(0.011, 0.010, 0.010, 0.0)
    )
    assert "shrinks by 100 % on held-out data" in one.headline
    assert "and was at its floor before on another motion." in one.headline


def test_in_a_console_and_in_a_notebook():
    """The equation is the finding's own, so that a family of the user's has one too; names are text."""
    tie = Tie("joint_spring", Place("joint", "<script>", 1), "motion_limited")
    one = found(Verdict.EXPLAINED, finding("torque_bias", KNEE, tie))
    assert repr(one).splitlines() == [
        "explained (confidence 0.90)",
        "  torque_bias at knee: size 0.5 [0.4, 0.6] N m; or joint_spring at <script> (motion_limited)",
        "  held out: 0.35 → 0.01 N m (floor 0.01)",
    ]
    page = one._repr_html_()
    for said in (
        "explained (confidence 90 %)",
        one.headline,
        "b = const &amp; &lt;odd&gt;",
        "held out",
    ):
        assert said in page
    assert "<script" not in page
    assert "<table" not in found(Verdict.NO_GAP)._repr_html_()


def test_regions_show_what_the_gap_follows():
    v = {r.signal: r for r in regions(trace())}["v"]
    assert v.row == "knee"
    assert v.share.sum() == pytest.approx(1.0)
    assert v.share[0] + v.share[4] > 0.7 > v.share[2]


def test_the_demo_judges_itself_hard():
    secret = Secret("torque_bias", "knee", 0.45, "N m")
    explained, right = Verdict.EXPLAINED, finding("torque_bias")
    assert "right; its number is off by 11.1 %" in judged(secret, found(explained, right))
    assert "trusts none" in judged(secret, found(Verdict.UNKNOWN, right))
    large = dataclasses.replace(secret, size=-0.5)
    assert "a wrong number (0.5)" in judged(large, found(explained, right))
    tied = finding("joint_spring", KNEE, Tie("torque_bias", KNEE, "motion_limited"))
    assert "cannot tell apart" in judged(secret, found(explained, tied))
    assert "right about the place" in judged(secret, found(explained, finding("armature")))
    assert judged(secret, found(explained, finding("armature", HIP))) == "The diagnosis was wrong."


def test_confidence_in_one_of_several_that_tie_says_so():
    tie = Tie("joint_spring", HIP, "motion_limited")
    one = dataclasses.replace(
        found(Verdict.EXPLAINED, finding("torque_bias", KNEE, tie)), confidence=0.4
    )
    assert one.certainty.startswith("confidence 40 % that it is the first of those")
    alone = dataclasses.replace(one, findings=(finding("torque_bias"),))
    assert alone.certainty == "confidence 40 %"


def test_numbers_have_their_own_units():
    """A slide's gap is of newtons; a factor says that it multiplies, and has no unit."""
    gain = Finding(
        "torque_gain", KNEE, {"gain": Interval(0.9, 0.88, 0.92, "1", factor=True)}, 0.99, 0.99, ()
    )
    one = found(Verdict.EXPLAINED, gain)
    assert "torque gain at knee (× 0.9)" in one.headline
    assert gain.sizes == ("gain 0.9 [0.88, 0.92]",)
    assert one.unit == "N m"
    on_slide = dataclasses.replace(one, trace=dataclasses.replace(one.trace, gap=(1,)))
    assert on_slide.unit == "N"
    both = dataclasses.replace(one, trace=dataclasses.replace(one.trace, gap=(0, 1)))
    assert both.unit == "N m and N"


def test_an_effect_that_explains_next_to_nothing_is_not_near():
    little = dataclasses.replace(finding("torque_bias"), explained=0.01)
    assert "nearest" in found(Verdict.UNKNOWN, finding("torque_bias")).headline
    assert "nearest" not in found(Verdict.UNKNOWN, little).headline
