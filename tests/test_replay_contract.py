"""What a diagnosis by replays states, against its files and the logs that it may and may not read."""

import dataclasses
import json
import re
from pathlib import Path

import mujoco
import numpy as np
import pytest
from test_replay import ARM, arm, run, without_torque

import jax_inertia as ji
from benchmarks.exam import replayed as examiner
from jax_inertia.cli.main import main
from jax_inertia.diagnosis.certainty.probability import calibration, probability
from jax_inertia.diagnosis.result import Verdict
from jax_inertia.diagnosis.verdict import Left
from jax_inertia.logs.log import Log
from jax_inertia.preflight.joint_ranges import joint_ranges
from jax_inertia.replay import checks, handover, proof
from jax_inertia.replay.fitting.errors import Weights
from jax_inertia.replay.fitting.fit import Fit
from jax_inertia.replay.inputs import loops_of, split_records
from jax_inertia.replay.loop import Parameter, position_loop
from jax_inertia.replay.pipeline import diagnose
from jax_inertia.replay.record import Commanded, Record, low_passed, record_of
from jax_inertia.replay.remainder import resemblances
from jax_inertia.replay.result import Replayed
from jax_inertia.replay.search.held_out import Unseen
from jax_inertia.replay.search.instead import Instead
from jax_inertia.replay.search.possible import pressed
from jax_inertia.replay.search.probability import Sure, odds_of_effects
from jax_inertia.replay.simulation.plant import Plant
from jax_inertia.replay.simulation.spec_edits import PLAY, add_play


@pytest.fixture(scope="module")
def soft(tmp_path_factory) -> Path:
    """A folder with logs of an arm whose elbow has 0.7 of its kp, and its diagnosis in `out`."""
    folder = tmp_path_factory.mktemp("soft")
    for k in range(2):
        ji.write_log(without_torque(run(kp=(1.0, 0.7), seed=k, seconds=6.0)), folder / f"{k}.npz")
    (folder / "arm.xml").write_text(ARM)
    out = folder / "out"
    out.mkdir()
    for stale in ("corrected.urdf", "report.html"):
        (out / stale).write_text("of an earlier robot")
    asked = ["diagnose", str(folder / "0.npz"), "--model", str(folder / "arm.xml")]
    assert main([*asked, "--test-log", str(folder / "1.npz"), "--out", str(out)]) == 0
    return folder


def test_a_verdict_is_as_sure_as_one_by_torque_of_the_same_odds(soft):
    """σ(a asinh L + b) of one file."""
    report = json.loads((soft / "out" / "report.json").read_text())
    fitted = calibration()
    a, b = fitted["slope_of_verdicts"], fitted["offset_of_verdicts"]
    stated = 1.0 / (1.0 + np.exp(-a * np.arcsinh(report["log_odds"]) - b))
    assert report["confidence"] == pytest.approx(stated, abs=1e-12)


def test_gains_that_no_log_says_are_known_no_better_than_the_masses(soft):
    """Gains, frictions and masses by one factor are the same motion, and a model's masses are off by 2 %."""
    effects = json.loads((soft / "out" / "report.json").read_text())["effects"]
    (scale,) = (e["parameters"]["scale"]["ci95"] for e in effects if e["family"] == "kp_scale")
    assert scale[0] < 0.7 < scale[1]
    assert 0.01 < (scale[1] - scale[0]) / 0.7 < 0.12


def test_the_file_replays_as_the_report_says(soft, capsys):
    report = json.loads((soft / "out" / "report.json").read_text())
    stated = report["shrink"]["replay"]
    assert report["verdict"] == "explained"
    log, model = str(soft / "1.npz"), str(soft / "out" / "corrected.xml")
    assert main(["replay", log, "--model", model, "--out", str(soft / "again"), "--json"]) == 0
    done = json.loads(capsys.readouterr().out)["error"]
    assert done["rms"] == pytest.approx(stated["after"], rel=0.03)
    assert stated["after"] < 1.3 * stated["floor"]
    assert stated["before"] > 100 * stated["floor"]


def test_a_program_that_shares_no_code_finds_the_same(soft):
    source = Path(str(examiner.__file__)).read_text()
    assert "import jax_inertia" not in source
    assert "from jax_inertia" not in source
    log = ji.read_log(soft / "1.npz")
    file = soft / "out" / "corrected.xml"
    path = examiner.replayed(file, log.joint_names, log.time, log.qpos, log.qpos_target)
    settled = log.time > 0.6
    error = np.sqrt(np.mean((path - log.qpos)[settled] ** 2))
    stated = json.loads((soft / "out" / "report.json").read_text())["shrink"]["replay"]
    assert error == pytest.approx(stated["after"], rel=0.1)


def test_every_number_that_the_file_changes_is_in_the_report(soft):
    report = json.loads((soft / "out" / "report.json").read_text())
    told = {(x["name"], x["field"]): x["corrected"] for x in report["changes"]}
    given, made = (
        mujoco.MjModel.from_xml_path(str(soft / x)) for x in ("arm.xml", "out/corrected.xml")
    )
    for field, named in (
        ("actuator_gainprm", "kp"), ("dof_armature", "armature"), ("dof_damping", "damping"),
        ("dof_frictionloss", "frictionloss"),
    ):  # fmt: skip
        before, after = (getattr(m, field).reshape(2, -1)[:, 0] for m in (given, made))
        for name, x, y in zip(("shoulder", "elbow"), before, after, strict=True):
            assert ((name, named) in told) == (x != y)
            assert x == y or told[name, named] == pytest.approx(y)
    assert told["elbow", "kp"] == pytest.approx(0.7 * 25.0, rel=0.01)
    assert min(made.dof_armature.min(), made.dof_damping.min()) >= 0.0


def test_a_folder_holds_files_of_one_diagnosis(soft):
    names = {p.name for p in (soft / "out").iterdir()}
    assert names == {"report.json", "report.html", "corrected.xml", "policy.json", "draws.npz"}
    assert "elbow" in (soft / "out" / "report.html").read_text()


def test_files_load_where_older_ones_do(soft):
    text = (soft / "out" / "corrected.xml").read_text()
    assert "input=" not in text
    assert 'biastype="affine"' in text


@pytest.mark.slow
def test_nothing_that_is_handed_over_depends_on_the_test():
    log, other = (without_torque(run(kp=(1.0, 0.7), seed=k, seconds=5.0)) for k in (0, 1))
    found = [diagnose([log], arm, test_log=x, exclude=("odd",)) for x in (other, log)]
    # A test of another robot, that contradicts all of it.
    wrong = dataclasses.replace(other, qpos=other.qpos + 0.2)
    found.append(diagnose([log], arm, test_log=wrong, exclude=("odd",)))
    assert found[0].text == found[1].text == found[2].text
    sizes = [[(e.family, e.name, e.size, e.probability) for e in f.effects] for f in found]
    assert sizes[0] == sizes[1] == sizes[2]
    assert found[0].verdict is Verdict.EXPLAINED
    assert found[2].verdict is not Verdict.EXPLAINED
    assert found[2].left


def test_of_several_logs_whole_ones_are_held_out():
    logs = [without_torque(run(seconds=2.0, seed=k)) for k in range(5)]
    bare = Plant(arm(), logs[0].joint_names, position_loop(logs[0], arm().compile()))
    loops = loops_of(logs, None, None, lambda: arm().compile(), None, None)
    parts = split_records(bare, logs, loops, None, None)
    starts = [tuple(log.qpos[0]) for log in logs]
    used = [
        [starts.index(tuple(r.q[0])) for r in rows]
        for rows in (parts.fit, parts.validation, parts.test)
    ]
    assert sorted(k for rows in used for k in rows) == [0, 1, 2, 3, 4]
    assert [len(x) for x in used] == [3, 1, 1]
    assert [len(r.time) for r in parts.whole] == [len(log.time) for log in logs[:4]]
    assert [tuple(r.q[0]) for r in parts.whole[:3]] == [tuple(r.q[0]) for r in parts.fit]
    assert parts.of == "1 of the 5 logs"
    one = split_records(bare, logs[:1], loops._replace(fit=loops.fit[:1]), None, None)
    assert one.of == "the last part of the log"
    assert len(one.fit[0].time) + len(one.validation[0].time) + len(one.test[0].time) < len(
        logs[0].time
    )


def test_a_joint_that_is_in_its_range_only_with_its_sign_turned():
    model = mujoco.MjModel.from_xml_string(
        ARM.replace('name="elbow"', 'name="elbow" range="-150 -50"').replace(
            "<mujoco>", '<mujoco><compiler autolimits="true"/>'
        )
    )
    q = np.column_stack([np.zeros(50), np.linspace(1.0, 2.5, 50)])
    log = Log(time=0.02 * np.arange(50), joint_names=("shoulder", "elbow"), qpos=q, qpos_target=q)
    robot = ji.load_model(model)

    def said(q: np.ndarray) -> str:
        return " ".join(x.message for x in joint_ranges(dataclasses.replace(log, qpos=q), robot))

    assert re.search("'elbow'.*with its sign turned", said(q))
    assert re.search("'elbow'.*read as degrees", said(-np.rad2deg(q)))
    assert said(-q) == ""


def test_a_file_with_play_is_replayed(tmp_path, capsys):
    spec = arm()
    add_play(spec, "elbow", 0.02)
    (tmp_path / "play.xml").write_text(spec.compile() and spec.to_xml())
    ji.write_log(without_torque(run(seconds=3.0)), tmp_path / "log.npz")
    asked = ["replay", str(tmp_path / "log.npz"), "--model", str(tmp_path / "play.xml"), "--json"]
    assert main([*asked, "--out", str(tmp_path / "out")]) == 0
    done = json.loads(capsys.readouterr().out)["error"]["per_joint"]
    assert f"elbow{PLAY}" not in done
    assert done["elbow"]["rms"] < 0.02


def test_a_low_pass_is_its_recursion():
    time, x = 0.02 * np.arange(200), np.random.default_rng(0).normal(size=(200, 2))
    y, alpha = x[0].copy(), 1 - np.exp(-0.02 / 0.04)
    out = low_passed(time, x, 0.02, np.array([0.04, 0.0]))
    for k in range(200):
        y = y + alpha * (x[k] - y)
        assert out[k, 0] == pytest.approx(y[0])
    np.testing.assert_array_equal(out[:, 1], x[:, 1])


def straight(theta, low, wants) -> Fit:
    """A fit of one number to twenty samples of its own, which want `wants`."""
    p = Parameter("target_delay", -1, 0.0, 1.0, low, 9.0)
    columns = np.ones((1, 20, 1))
    one = np.array([[0.05 * 0.01]])
    error = np.full((20, 1), theta - wants)
    weights = Weights(np.array([0.1]), np.ones(1))
    return Fit((p,), np.array([theta]), one, 1.0 / one, 20.0, error, columns, weights)


def test_what_is_asked_beyond_a_bound_is_not_possible():
    told = pressed(straight(0.0, 0.0, -0.5), ("hip",))
    assert len(told) == 1
    assert "-0.5" in told[0]
    assert pressed(straight(0.0, 0.0, -0.01), ("hip",)) == ()
    assert pressed(straight(0.3, 0.0, 0.3), ("hip",)) == ()


def test_a_probability_falls_with_its_evidence_and_with_what_else_would_do():
    class Rows(Unseen):
        """Validation rows that lose `cost` by every effect."""

        cost = 0.0

        def __init__(self):
            pass

        def taken_back(self, found, units):
            return np.zeros((len(units) + 1, 1, 1))

        def likelier(self, new, old, weights):
            return -self.cost

        def errors(self, found):
            return np.zeros((1, 1))

        def unnamed(self, with_it, without, numbers):
            return self.shapes

    def both(theta, instead=(), cost=0.0, odd=(), shapes=1e3):
        Rows.cost, Rows.shapes = cost, shapes
        found = straight(theta, 0.0, theta)
        rows = Rows()
        given = {(0,): instead}
        L = odds_of_effects(found, [(0,)], odd, given, rows, rows, lambda _: found)[0,]
        return Sure(probability(L.own), probability(L.or_another))

    def sure(*args, **more):
        return both(*args, **more).own

    p = Parameter("kp_scale", 0, 0.0, 1.0, -9.0, 9.0)
    alone = sure(0.2)
    assert alone > 0.8
    assert sure(0.05) < alone
    assert sure(0.1, odd=[(0,)]) < sure(0.1)
    assert sure(0.2, (Instead(p, 0.1, cost=0.0),)) == pytest.approx(0.5, abs=0.01)
    # What has a name and would do as well takes from the effect; that one of them is there is as sure as before.
    assert both(0.2, (Instead(p, 0.1, cost=0.0),)).or_another == alone
    assert sure(0.2, (Instead(p, 0.1, "by the equation"),)) == alone
    assert sure(0.2, cost=100.0) < 0.2
    assert 0.5 < sure(0.2, shapes=0.0) < alone


def test_a_limit_is_judged_by_all_rows_as_another_motion_may_hardly_ask_for_it():
    """No parabola reaches a model without a limit either."""

    class Rows(Unseen):
        """Rows that gain by an effect, in whose place shapes cost so much."""

        def __init__(self, gain, shapes):
            self.gain, self.shapes = gain, shapes

        def taken_back(self, found, units):
            return np.zeros((len(units) + 1, 1, 1))

        def errors(self, found):
            return np.zeros((1, 1))

        def unnamed(self, with_it, without, numbers):
            return self.shapes

        def likelier(self, new, old, weights):
            return self.gain

    def sure(found, gain, shapes=1e3, odd=((0,),)):
        rows = Rows(0.0, 0.0), Rows(gain, shapes)
        L = odds_of_effects(found, [(0,)], odd, {}, *rows, lambda rows: found)[0,]
        return probability(L.own)

    number = straight(0.8, 0.0, 0.8)
    limit = number._replace(table=(number.table[0]._replace(nominal=np.inf),))
    assert sure(limit, 100.0) > 0.9
    assert sure(limit, 0.0) < 0.5
    assert sure(limit, 100.0, shapes=0.0) == pytest.approx(0.5, abs=0.01)
    # The evidence of a number is on the parabola; what has no name is of all rows for it too.
    for odd in ((), ((0,),)):
        assert sure(number, 0.0, odd=odd) > 0.9
        assert sure(number, 0.0, shapes=-9.0, odd=odd) == pytest.approx(0.5, abs=0.02)


def test_what_is_left_is_told_by_its_shape_and_frequency():
    time = 0.01 * np.arange(1500)
    q = np.column_stack([np.sin(2 * np.pi * 0.7 * time), np.sin(2 * np.pi * 0.4 * time)])
    record = Record(time, q, np.zeros(2), Commanded(time, q + 0.1))
    v = np.gradient(q[:, 0], time)
    path = q + np.column_stack([0.002 * np.sign(v), 0.003 * q[:, 0]])
    first, second = resemblances(("hip", "knee"), ["hip", "knee"], [path], [record])
    assert first.shape == "direction of motion"
    assert first.frequency == pytest.approx(0.7, abs=0.1)
    assert second.shape == "position of hip"
    assert second.share > 0.95
    told = proof.Told(Verdict.PARTLY, 0.9, (Left("knee", 0.003, 30.0, 0.5),), ())
    done = Replayed((record,), (path,), (path,), np.full(2, 1e-4), "the log")
    said = proof.headline(told, done, (first, second))
    assert "knee is left with 0.003 (30 floors), which goes with the position of hip" in said


def test_encoder_steps_are_the_least_where_motion_passes_over_most():
    count = 2 * np.pi / 2**14
    q = np.round(np.sin(2 * np.pi * 0.7 * 0.005 * np.arange(1200))[:, None] / count) * count
    assert checks.encoder_noise(q)[0] == pytest.approx(count / np.sqrt(12), rel=1e-3)


def test_noise_is_told_from_a_motion_that_is_logged_slowly():
    time = 0.02 * np.arange(1000)
    motion = 0.5 * np.sin(2 * np.pi * 1.5 * time) + 0.2 * np.sin(2 * np.pi * 2.6 * time)
    noise = 1e-4 * np.random.default_rng(0).normal(size=1000)
    seen = checks.encoder_noise(np.column_stack([motion, motion + noise]))
    assert seen[0] < 2e-5
    assert seen[1] == pytest.approx(1e-4, rel=0.15)


def test_a_record_of_other_gains_is_replayed_with_them():
    log = without_torque(run(seconds=3.0))
    model = arm().compile()
    loop = position_loop(log, model)
    softer = loop._replace(kp=0.5 * loop.kp, kd=0.5 * loop.kd)
    names = log.joint_names
    done = handover.replayed(model, names, loop, record_of(log, softer))
    other = arm().compile()
    other.actuator_gainprm[:, 0] *= 0.5
    other.actuator_biasprm[:, 1:3] *= 0.5
    wanted = handover.replayed(other, names, softer, record_of(log, softer))
    np.testing.assert_allclose(done, wanted, atol=1e-12)


URDF = """
<robot name="arm"><link name="base"/><link name="upper"><inertial><origin xyz="0 0 -0.12"/><mass value="1"/>
<inertia ixx="0.006" iyy="0.006" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="lower"><inertial><origin xyz="0 0 -0.1"/><mass value="0.5"/>
<inertia ixx="0.002" iyy="0.002" izz="0.0004" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" effort="30" velocity="20"/><dynamics damping="0.05" friction="0.1"/></joint>
<joint name="elbow" type="revolute"><parent link="upper"/><child link="lower"/><origin xyz="0 0 -0.25"/>
<axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="30" velocity="20"/><dynamics damping="0.05" friction="0.1"/>
</joint></robot>"""


def test_a_urdf_comes_back_as_one_with_what_it_can_hold(tmp_path):
    """Two thirds of the friction are missing in it, and the rotors; of the latter a URDF has no place."""
    ji.write_log(without_torque(run(dry=(0.3, 0.2), seconds=5.0)), tmp_path / "log.npz")
    (tmp_path / "arm.urdf").write_text(URDF)
    out = tmp_path / "out"
    asked = ["diagnose", str(tmp_path / "log.npz"), "--model", str(tmp_path / "arm.urdf")]
    assert main([*asked, "--kp", "40", "25", "--kd", "1.5", "0.8", "--out", str(out)]) == 0
    back = mujoco.MjModel.from_xml_path(str(out / "corrected.urdf"))
    np.testing.assert_allclose(back.dof_frictionloss, [0.4, 0.3], rtol=0.05)
    (lost,) = (x for x in json.loads((out / "report.json").read_text())["notes"] if "URDF" in x)
    assert "armature of shoulder, elbow" in lost
