"""What is stated is what is handed over: files read back, and computed again by a program that shares no code."""

import dataclasses
import json
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple

import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from diagnosis_made_up import diagnosis
from diagnosis_robot import NOMINAL, log_of, motion, needed, ordinary

from benchmarks.exam.report_torque import of_folder
from benchmarks.exam.torque_error import needed as as_given
from benchmarks.exam.torque_error import read, torque_error
from jax_inertia.cli.main import main
from jax_inertia.diagnosis import pipeline
from jax_inertia.diagnosis.checks import HeldOut
from jax_inertia.diagnosis.corrected.handed_over import HandedOver
from jax_inertia.diagnosis.effects.base import Place
from jax_inertia.diagnosis.effects.identified import Identified, effects_in
from jax_inertia.diagnosis.effects.joint import JointSpring
from jax_inertia.diagnosis.friction_curve import (
    EQUATION,
    NUMBERS_OF,
    UNITS,
    FrictionCurve,
    LinkApart,
    Moving,
)
from jax_inertia.diagnosis.hypothesis import Hypothesis
from jax_inertia.diagnosis.pipeline import diagnose
from jax_inertia.diagnosis.report.json_report import to_report
from jax_inertia.diagnosis.residual import Residual
from jax_inertia.diagnosis.result import Found, Verdict
from jax_inertia.diagnosis.search.evidence import Evidence
from jax_inertia.diagnosis.search.selection import Selection
from jax_inertia.diagnosis.settings import Settings
from jax_inertia.diagnosis.simulate.corrected import corrected
from jax_inertia.diagnosis.simulate.whole_robot import correction
from jax_inertia.maths.inertial_parameters import is_physical
from jax_inertia.model.load import load_model
from jax_inertia.model.robot_spec import spec_of

MODEL = mujoco.MjModel.from_xml_string(NOMINAL)
LOADED = NOMINAL.replace(
    'mass="0.6" diaginertia="0.002 0.002 0.001"', 'mass="1.5" diaginertia="0.007 0.007 0.003"'
)


def made(seed: int, *, model: str = NOMINAL, uneven: float = 0.0, curved: float = 0.0):
    """A log of a robot whose friction depends on the direction and bends with speed; by MuJoCo C alone."""
    t, q, v, a = motion(seed)
    tau = needed(mujoco.MjModel.from_xml_string(model), q, v, a) + ordinary(v, a)
    tau += np.array([0.5 * uneven, 0.0, 0.0]) * np.abs(v) + curved * np.abs(v) * v
    return log_of(t, q, tau, seed)


def save(log, path: Path) -> Path:
    np.savez(
        path,
        time=log.time,
        joint_names=np.array(log.joint_names),
        qpos=log.qpos,
        tau=log.tau,
        tau_kind=np.array("sensor"),
        tau_unit=np.array("N m"),
    )
    return path


@pytest.fixture(scope="module")
def robot():
    return load_model(MODEL)


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """A diagnosis by the command of a loaded hand and a friction of other forms, with a test log."""
    folder = tmp_path_factory.mktemp("written")
    (folder / "nominal.xml").write_text(NOMINAL)
    more = {"model": LOADED, "uneven": 0.15, "curved": 0.05}
    log, test = (save(made(seed, **more), folder / f"{seed}.npz") for seed in (0, 1))
    command = [
        "diagnose",
        str(log),
        "--model",
        str(folder / "nominal.xml"),
        "--test-log",
        str(test),
    ]
    assert main([*command, "--out", str(folder / "out")]) == 0
    return folder


def again(folder: Path, name: str) -> float:
    """Torque error of a run by benchmarks/exam/report_torque.py over that of the nominal model."""
    log = read(folder / name)
    told = of_folder(folder / "out", folder)
    after = told.error(log, held=False)
    assert not told.left_out
    model = mujoco.MjModel.from_xml_path(str(folder / "nominal.xml"))
    return after["rms"] / torque_error(model, as_given, log, held=False)["rms"]


def test_stated_is_what_another_program_computes_of_the_files(written):
    report = json.loads((written / "out" / "report.json").read_text())
    stated = report["shrink"]["test_log"]
    assert stated["after"] / stated["before"] == pytest.approx(again(written, "1.npz"), rel=0.1)
    assert stated["after"] < 0.03 * stated["before"]


def test_files_read_back_are_what_the_command_states(written):
    report = json.loads((written / "out" / "report.json").read_text())
    nominal = mujoco.MjModel.from_xml_path(str(written / "nominal.xml"))
    handed = HandedOver.read(written / "out", nominal)
    residual = Residual(
        load_model(nominal), made(1, model=LOADED, uneven=0.15, curved=0.05), Settings()
    )
    left = handed.on_another_run().residual(residual)
    moving, context = residual.moving, residual.context
    # When within its period a torque acted is of the log: what is stated has it taken out.
    slope = residual.prepared.finish(np.gradient(context.tau, context.time, axis=0))
    late = float((moving * slope * left).sum() / (moving * slope**2).sum())
    left = left - late * slope
    after = float(np.sqrt((moving * left**2).sum() / moving.sum()))
    assert after == pytest.approx(report["shrink"]["test_log"]["after"], rel=0.1)


def no_friction(robot) -> dict:
    """Friction laws of joints that have none."""
    none = {"form": "bristle", "displacement": 0.0, "straight": 0.0, "value": 0.0}
    return {name: {"terms": [none | {"ci95": [0, 0], "unit": "N m"}]} for name in robot.joint_names}


def test_what_a_soft_joint_needs_is_predicted_from_the_motion_alone(robot):
    """Whatever the log says that its motor gave: a row's own torque would tell what it is to be compared with."""
    log = made(0)
    other = dataclasses.replace(
        log, tau=log.tau + 3.0 * np.sin(2 * np.pi * 3.0 * log.time)[:, None]
    )
    soft = Identified("joint_elasticity", "joint", "shoulder", {"stiffness": 900.0})
    stiffness = {"value": 900.0, "ci95": [800.0, 1000.0], "unit": "N m/rad"}
    listed = {"family": soft.family, "location": {"kind": "joint", "name": soft.name}}
    listed |= {"handed_over": True, "parameters": {"stiffness": stiffness}}
    report = {"friction": no_friction(robot), "effects": [listed]}
    handed = HandedOver(report, corrected(spec_of(robot), (soft,)).spec.compile(), MODEL)
    needed_torque = []
    for one in (log, other):
        residual = Residual(robot, one, Settings())
        reached = residual.prepared.finish_torque(residual.context.tau)
        needed_torque.append(handed.residual(residual) + reached)
    np.testing.assert_allclose(*needed_torque, atol=1e-9)


class Known(NamedTuple):
    """Causes that are named."""

    now: None = None
    named: frozenset = frozenset()

    def naming(self, keys) -> "Known":
        return self._replace(named=frozenset(keys))


def one_row(error: float) -> np.ndarray:
    return np.full((1, 1), error)


class OneRow(HeldOut):
    """A row whose error by the fit is 1 N m."""

    def __init__(self):
        self.residual = SimpleNamespace(moving=one_row(1.0))

    def left(self, now):
        return one_row(1.0)


@pytest.mark.parametrize(
    ("whole", "without", "handed_over"), [(1.09, 0.5, True), (1.2, 1.1, True), (1.2, 1.0, False)]
)
def test_an_effect_without_which_the_files_predict_better_is_named_and_withheld(
    whole, without, handed_over
):
    """A tenth is what the files have to lose of the fit, and what they have to gain without it."""
    place = Place("joint", "shoulder", 0)
    columns = np.random.default_rng(0).normal(size=(40, 1, 1))
    h = Hypothesis(JointSpring(), place, (), columns, None, np.ones(1), np.zeros(1), 8.0)
    evidence = Evidence(np.zeros((40, 1)), np.ones((40, 1)), np.ones(1))
    selection = Selection(object.__new__(Residual), evidence, evidence.posterior((h,)), (), ())
    found = Found("joint_spring", place, {}, 0.5, 20.0, 20.0, 0.9, (), False, "")

    def files(now: Selection) -> pipeline.Made:
        there = h in now.posterior.chosen
        draft = diagnosis(Verdict.PARTLY, *((found,) if there else ()))
        left = one_row(whole if there else without)
        own = object.__new__(HandedOver)
        return pipeline.Made(Known(), draft, own, OneRow(), left)  # pyright: ignore

    out = pipeline._borne_out_by_files(selection, 0.1, files)
    assert [f.handed_over for f in out.draft.found] == [handed_over]
    # What is named and withheld is no doubt about the verdict.
    assert out.causes.named == (set() if handed_over else {("joint_spring", place)})  # pyright: ignore


def test_nothing_handed_over_is_the_nominal_model(robot):
    log = made(0)
    found = diagnose(robot, log, exclude=())
    nothing = dataclasses.replace(found, found=(), friction={}, gains={})
    report = to_report(nothing) | {"friction": no_friction(robot), "effects": [], "joints": {}}
    residual = Residual(robot, log, Settings())
    handed = HandedOver(report, spec_of(robot).compile(), MODEL)
    np.testing.assert_allclose(handed.residual(residual), residual.y, atol=1e-9)


def test_a_test_log_decides_nothing(robot):
    log = made(0, uneven=0.2)
    without = diagnose(robot, log)
    # A run of a robot that carries more: whatever it says, no number and no choice may follow it.
    other = diagnose(robot, log, test_log=made(1, model=LOADED, uneven=0.2))
    assert without.test is None
    assert other.test is not None
    assert other.found == without.found or [f.family for f in other.found] == [
        f.family for f in without.found
    ]
    assert other.joints == without.joints
    assert other.friction == without.friction
    assert other.heldout == without.heldout
    assert other.test.after > 3 * other.heldout.after


def test_a_friction_that_differs_by_direction_is_handed_over_named_or_not(robot):
    found = diagnose(robot, made(0, uneven=0.3))
    curve = found.friction["shoulder"]
    slope = sum(p.value for term, p in curve.terms.items() if term.form == "slope_by_direction")
    assert slope == pytest.approx(0.3, rel=0.15)


def test_a_law_reads_back_what_was_written(robot):
    found = diagnose(robot, made(0))
    report = json.loads(json.dumps(to_report(found), allow_nan=False))
    for name, curve in found.friction.items():
        own = FrictionCurve.read(report["friction"][name])
        assert own.main == curve.main
        assert {t: p.value for t, p in own.terms.items()} == {
            t: p.value for t, p in curve.terms.items()
        }
        assert report["friction"][name]["equation"] == EQUATION
    with pytest.raises(ValueError, match=r"no term 'magic'; terms: bristle"):
        FrictionCurve.read({"terms": [{"form": "magic"}]})
    assert set(UNITS) == set(NUMBERS_OF)


def test_friction_of_a_link_is_of_its_own_motion(robot):
    """While its motor crosses the play a link stands still, and its friction holds it with any part of its level."""
    context = Residual(robot, made(0), Settings()).context
    row = 0
    term = {"form": "bristle", "displacement": 2e-4, "straight": 0.0, "value": 0.4}
    slope = {"form": "viscous", "value": 0.3}
    ends = ({"ci95": [0, 1], "unit": unit} for unit in ("N m", "N m s/rad"))
    law = {"terms": [x | more for x, more in zip((term, slope), ends, strict=True)]}
    held = np.linspace(-1.0, 1.0, len(context.v))
    stands = LinkApart(-context.v[:, row], held)
    moving = dataclasses.replace(Moving.along(context, row), link_apart=stands)
    np.testing.assert_allclose(FrictionCurve.read(law).torque(moving), 0.4 * held, atol=1e-12)


def test_what_is_named_and_not_handed_over_is_in_no_model(robot):
    found = diagnose(robot, made(0, model=LOADED))
    (load,) = found.odd
    nominal = spec_of(robot)
    kept = correction(nominal.copy(), robot, found).spec.compile().body("hand").mass[0]
    withheld = tuple(dataclasses.replace(f, handed_over=f is not load) for f in found.found)
    less = dataclasses.replace(found, found=withheld)
    gone = correction(nominal.copy(), robot, less).spec.compile().body("hand").mass[0]
    assert kept - gone == pytest.approx(load.parameters["mass"].value, rel=1e-6)
    report = json.loads(json.dumps(to_report(less), allow_nan=False))
    assert [e["handed_over"] for e in report["effects"] if e["family"] == "payload"] == [False]
    assert "payload" not in {e.family for e in effects_in(report)}


def test_bodies_that_are_handed_over_can_exist(robot):
    found = diagnose(robot, made(0, model=LOADED))
    assert all(bool(is_physical(jnp.array(pi))) for pi in found.inertials.values())
    for own in found.joints.values():
        for family in ("viscous_friction", "coulomb_friction", "armature"):
            assert own[family].low >= 0.0
            assert own[family].low <= own[family].value <= own[family].high


@pytest.mark.parametrize("xml", [NOMINAL, LOADED])
def test_a_robot_s_own_spec_has_its_dynamics(xml):
    model = mujoco.MjModel.from_xml_string(xml)
    own = spec_of(load_model(model)).compile()
    rng, data = np.random.default_rng(0), [mujoco.MjData(m) for m in (model, own)]
    for _ in range(4):
        state = rng.normal(size=(3, model.nv))
        for m, d in zip((model, own), data, strict=True):
            d.qpos[:], d.qvel[:], d.qacc[:] = state
            mujoco.mj_inverse(m, d)
        np.testing.assert_allclose(data[1].qfrc_inverse, data[0].qfrc_inverse, atol=1e-12)
