"""Marks, rates and tables of the sealed check on answers written by hand, and one round trip in earnest."""

import copy
import dataclasses
import sys
from pathlib import Path

import pytest

pytest.importorskip("pinocchio_oracle")
pytest.importorskip("cryptography", reason="the seal")
sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks" / "blind"))

import left_out
import score
import seal
import solve
import vault
from exam.marks import fine, mark
from exam.rates import QUESTIONS, Share, count, summary
from world.plan import Setting

SETTING = Setting(
    (1,), "single", ("payload",), "two", "pinocchio", ("exciting", "ordinary"), 250, False, 1.0, 4.0, 2.5
)  # fmt: skip


def effect(family, name, distinct=1e4, kind="joint", **numbers):
    return {
        "family": family,
        "mechanism": family,
        "location": {"kind": kind, "name": name},
        "parameters": {k: {"value": v, "unit": "1"} for k, v in numbers.items()},
        "lasting": True,
        "details": {},
        "visibility": {"chi2": 2 * distinct, "distinct": distinct},
    }


def answer(stratum, *effects, equivalents=None):
    setting = dataclasses.asdict(dataclasses.replace(SETTING, stratum=stratum))
    return {
        "sha256": "",
        "truth": {
            "setting": setting,
            "effects": list(effects),
            "equivalents": equivalents or [[] for _ in effects],
            "sensors": {"law": "normal", "drops": 0.0, "coarse": 0.0},
        },
    }


def said(verdict, *found, before=1.0, after=0.1):
    """A report; `found` are (family, name, numbers, equivalents)."""
    effects = [
        {
            "family": f,
            "location": {"kind": "joint", "name": n},
            "parameters": {k: {"value": v, "ci95": [lo, hi]} for k, (v, lo, hi) in numbers.items()},
            "probability": 0.9,
            "equivalent": [
                {"family": g, "location": {"kind": "joint", "name": m}, "kind": "exact"}
                for g, m in ties
            ],
        }
        for f, n, numbers, ties in found
    ]
    return {
        "verdict": verdict,
        "confidence": 0.9,
        "gap": {"share": {"a": 0.8, "b": 0.2}},
        "effects": effects,
        "shrink": {
            "heldout": {"before": before, "after": after, "noise": 0.0},
            "rollout": {"before": 1.0, "after": 0.11, "floor": 0.1},
        },
    }


def test_a_right_single_effect():
    numbers = {"damping": (0.21, 0.2, 0.22)}
    row = mark(
        answer("single", effect("viscous_friction", "a", damping=0.2)),
        said("explained", ("viscous_friction", "a", numbers, [])),
        {"before": 2.0, "after": 0.3},
    )
    assert all(row[q] for q in ("family", "place", "in_set", "exact"))
    assert row["false_unknown"] is False
    assert row["unknown"] is None
    assert row["parameters"][0]["error"] == pytest.approx(0.05)
    assert row["parameters"][0]["covers"]
    assert row["shrink_within_10"]
    assert row["rollout_at_floor"]
    assert fine(row)


def test_a_tie_is_in_the_set_and_a_twin_is_right():
    true = answer("single", effect("viscous_friction", "a"))
    row = mark(true, said("explained", ("armature", "a", {}, [("viscous_friction", "a")])))
    assert (row["family"], row["place"], row["in_set"], row["exact"]) == (False, True, True, False)
    twin = answer("single", effect("armature", "a"), equivalents=[[["link_inertia", "b"]]])
    row = mark(twin, said("explained", ("link_inertia", "b", {}, [])))
    assert all(row[q] for q in ("family", "place", "in_set", "exact"))


def test_silence_is_right_where_an_effect_is_faint_and_a_miss_where_it_is_clear():
    faint = mark(answer("single", effect("cogging", "a", 10.0)), said("no_gap"))
    assert faint["misled"] is False
    assert faint["family"] is None
    assert fine(faint)
    clear = mark(answer("single", effect("cogging", "a", 1e3)), said("no_gap"))
    assert clear["missed"]
    assert clear["family"] is False
    assert not fine(clear)
    wrong = mark(
        answer("single", effect("cogging", "a", 10.0)), said("explained", ("payload", "b", {}, []))
    )
    assert wrong["misled"]


def test_false_alarms_and_unknown_effects():
    assert mark(answer("none"), said("no_gap"))["false_alarm"] is False
    assert mark(answer("none"), said("unknown"))["false_alarm"] is True
    hidden = answer("unknown", effect("unknown", "a"))
    assert mark(hidden, said("unknown"))["unknown"] is True
    assert mark(hidden, said("unknown"))["unknown_place"] is True
    assert mark(hidden, said("explained", ("cogging", "a", {}, [])))["unknown"] is False
    same = answer("unknown", effect("unknown", "a"), equivalents=[[["drag", "link"]]])
    assert mark(same, said("explained", ("drag", "link", {}, [])))["unknown"] is True


def test_a_pair_counts_each_half_and_each_claim():
    true = answer("pair", effect("cogging", "a"), effect("payload", "b", 20.0))
    row = mark(
        true,
        said(
            "explained", ("cogging", "a", {}, []), ("drag", "b", {}, []), ("payload", "b", {}, [])
        ),
    )
    assert row["pair_recall"] == [True]
    assert row["pair_precision"] == [True, False, True]
    assert row["pair_both"] is None
    both = answer("pair", effect("cogging", "a"), effect("payload", "b"))
    assert mark(both, said("explained", ("cogging", "a", {}, [])))["pair_both"] is False
    tied = said("explained", ("cogging", "a", {}, []), ("drag", "b", {}, [("payload", "b")]))
    assert mark(both, tied)["pair_both"] is False
    assert mark(both, tied)["pair_in_set"] is True


def test_a_failed_command_is_wrong_wherever_it_was_asked():
    row = mark(answer("single", effect("cogging", "a")), None)
    assert row["failed"]
    assert row["family"] is False
    assert not fine(row)
    assert mark(answer("none"), None)["false_alarm"] is True


def test_a_vector_is_measured_by_its_length():
    true = effect("com_shift", "a", com_shift_x=0.03, com_shift_y=0.0, com_shift_z=0.04)
    numbers = {"com_shift_y": (0.005, -0.01, 0.01)}
    row = mark(answer("single", true), said("explained", ("com_shift", "a", numbers, [])))
    assert row["parameters"][0]["error"] == pytest.approx(0.1)


def test_wilson_bounds():
    # Wilson 1927, by the closed form for k = n: lower bound n / (n + z²).
    low, high = Share(20, 20).bounds
    assert low == pytest.approx(20 / (20 + 1.959964**2))
    assert high == 1.0
    assert Share(0, 0).rate is None
    assert count([True, None, False, True]) == Share(2, 3)


def test_honest_answers_without_the_true_family():
    true = answer("single", effect("coulomb_friction", "a"))["truth"]
    whole = said("explained", ("coulomb_friction", "a", {}, [("torque_bias", "a")]))
    assert left_out.honest(true, said("unknown"), whole)
    assert not left_out.honest(true, said("no_gap"), whole)
    assert left_out.honest(true, said("explained", ("stribeck_friction", "a", {}, [])), whole)
    assert not left_out.honest(true, said("explained", ("stribeck_friction", "b", {}, [])), whole)
    assert left_out.honest(true, said("explained", ("torque_bias", "a", {}, [])), whole)
    assert not left_out.honest(true, said("explained", ("payload", "a", {}, [])), whole)


def test_honest_answers_on_a_robot_as_it_is_bought():
    """A remainder that is flagged is honest; ordinary physics is no other cause."""
    odd = effect("joint_spring", "a") | {"visibility": {"sigmas": 9.0}, "equivalent": []}
    true = {"stratum": "bare_odd", "odd": odd}
    assert left_out.hidden(true) is odd
    assert left_out.hidden(true | {"stratum": "outside"}) is None
    assert left_out.hidden(true | {"odd": odd | {"visibility": {"sigmas": 2.0}}}) is None
    assert left_out.holders({"logs": {"x": {"truth": true}}}) == {"joint_spring": ["x"]}
    rubs = ("coulomb_friction", "a", {}, [])
    assert left_out.honest(true, said("partly", rubs), None)
    assert not left_out.honest(true, said("explained", rubs), None)
    tied = ("encoder_offset", "a", {}, [("joint_spring", "a")])
    whole = said("explained", rubs, ("joint_spring", "a", {}, [("encoder_offset", "a")]))
    assert left_out.honest(true, said("explained", rubs, tied), whole)
    assert not left_out.honest(true, said("explained", rubs, ("payload", "a", {}, [])), whole)


def test_the_summary_has_every_rate_with_bounds():
    rows = [{"log": "x"} | mark(answer("none"), said("no_gap"))]
    got = summary(rows)
    assert got["logs"] == 1
    assert got["false_alarm"] == 0.0
    for name in QUESTIONS:
        assert got[f"{name}_low"] <= got[f"{name}_high"]


def test_what_was_not_reached_is_left_out_and_what_failed_is_not(tmp_path):
    for name in ("done", "failed"):
        (tmp_path / "results" / name).mkdir(parents=True)
    kept = score.reached({"seed": 1, "logs": dict.fromkeys(("done", "failed", "waits"))}, tmp_path)
    assert (list(kept["logs"]), kept["sealed"], kept["seed"]) == (["done", "failed"], 3, 1)


@pytest.mark.parametrize("draw", [2, 5])  # One at each joint, both strong.
def test_the_rivals_know_friction_where_it_is(draw, tmp_path):
    """Strong Coulomb friction on an arm: both blame that joint, from the files alone."""
    import rivals
    from world.make import make

    setting = dataclasses.replace(SETTING, key=(5, draw), families=("coulomb_friction",))
    log, test, model, truth = make(setting)
    assert truth["effects"][0]["visibility"]["distinct"] > 1e4
    folder = tmp_path / "one"
    folder.mkdir()
    (folder / "log.npz").write_bytes(seal.npz_bytes(log))
    (folder / "test.npz").write_bytes(seal.npz_bytes(test))
    (folder / "nominal.xml").write_text(model)
    place = truth["effects"][0]["location"]["name"]
    for method in rivals.METHODS:
        found = rivals.diagnose(folder, method)["effects"][0]
        assert (found["family"], found["location"]["name"]) == ("coulomb_friction", place)


def nearly_two(words, count, robots):
    """A payload, and nothing."""
    base = dataclasses.replace(SETTING, duration=5.0, test_duration=3.0)
    return [
        dataclasses.replace(base, key=(*words, k), stratum=s, families=f)
        for k, (s, f) in enumerate([("single", ("viscous_friction",)), ("none", ())][:count])
    ]


@pytest.mark.timeout(1200)
@pytest.mark.slow
def test_round_trip_with_the_public_command(tmp_path):
    logs, hidden, out = tmp_path / "logs", tmp_path / "sealed", tmp_path / "found"
    seed = tmp_path / "seed"
    seed.write_bytes(b"round trip")
    promise = seal.seal_set(logs, hidden, 1, seed, settings=nearly_two)
    solve.solve([solve.Task(log, out) for log in logs.iterdir()], out / "work")
    answers = vault.unseal(hidden, promise, logs)
    rows = score.score(answers, promise, logs, out, tmp_path / "scored", {})
    (row,) = rows
    assert not row["failed"], (out / "work" / "00.log").read_text()[-2000:]
    assert row["verdict"] in ("explained", "partly", "unknown", "no_gap")
    text = (tmp_path / "scored" / "RESULTS.md").read_text()
    assert promise in text
    assert "Wrong rows" in text
    for picture in ("confusion", "calibration", "shrink"):
        assert (tmp_path / "scored" / "figures" / f"{picture}.png").exists()
    assert copy.deepcopy(answers) == vault.unseal(hidden, promise, logs)
