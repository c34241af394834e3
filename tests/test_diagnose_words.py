"""What the demonstration says of its own diagnosis."""

import dataclasses

from diagnosis_made_up import diagnosis

from jax_inertia.cli.demo.command import judged
from jax_inertia.cli.demo.hidden import Secret
from jax_inertia.diagnosis.effects.base import Interval, Place
from jax_inertia.diagnosis.report.wording import headline
from jax_inertia.diagnosis.result import Found, Tie, Verdict

KNEE, HIP = Place("joint", "knee", 0), Place("joint", "hip", 1)


def effect(family: str, place: Place = KNEE, *ties: Tie) -> Found:
    numbers = {"size": Interval(0.5, 0.4, 0.6, "N m")}
    return Found(family, place, numbers, 0.9, 20.0, 20.0, 0.8, ties, False, "b = const")


def test_the_demo_judges_itself_hard():
    secret = Secret("torque_bias", "knee", 0.45, "N m")
    explained, right = Verdict.EXPLAINED, effect("torque_bias")
    assert "right; its number is off by 11.1 %" in judged(secret, diagnosis(explained, right))
    assert "trusts none" in judged(secret, diagnosis(Verdict.UNKNOWN, right))
    large = dataclasses.replace(secret, size=-0.5)
    assert "a wrong number (0.5)" in judged(large, diagnosis(explained, right))
    tied = effect("joint_spring", KNEE, Tie("torque_bias", KNEE, "motion_limited"))
    assert "cannot tell apart" in judged(secret, diagnosis(explained, tied))
    assert "right about the place" in judged(secret, diagnosis(explained, effect("armature")))
    wrong = judged(secret, diagnosis(explained, effect("armature", HIP)))
    assert wrong == "The diagnosis was wrong."


def test_a_baseline_that_errs_less_comes_first():
    """0.1 N m are left by the files: of 1 N m as given, and of what least squares leave."""
    found = diagnosis(Verdict.PARTLY, effect("torque_bias"))

    def said(**errors: float) -> str:
        held = dataclasses.replace(found.heldout, **errors)
        return headline(dataclasses.replace(found, heldout=held), "")

    assert said(least_squares=0.2).startswith("With torque bias")
    least = "Plain least squares of four terms a joint errs less on held-out rows: 0.05 N m for"
    assert said(least_squares=0.05).startswith(least)
    assert said(before=0.08).startswith("The model as given errs less on held-out rows")
