"""What DIAGNOSES.md stands on: models and logs as prepared, the published fits, the comparison; and one diagnosis."""

import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks" / "real_logs"))

import diagnosis_cases as cases
import diagnosis_report as report
import diagnosis_summary as summary
import logs

import jax_inertia as ji
from jax_inertia.cli import diagnose_run as pipeline
from jax_inertia.gap import Verdict

pytestmark = pytest.mark.skipif(
    not logs.SHARED.is_dir(),
    reason=f"recorded logs are not at {logs.SHARED}; JAX_INERTIA_DATA may name their folder",
)
CASES = {case.name: case for case in cases.CASES}


def effect(family: str, place: str, **values: float) -> dict:
    return {
        "family": family,
        "location": {"kind": "joint", "name": place},
        "parameters": {n: {"value": x, "ci95": [x, x], "unit": ""} for n, x in values.items()},
    }


def test_panda_s_published_friction_leaves_what_its_page_says(tmp_path):
    """Mean squares of the data's page, whole run and another filter: 0.127 ... 0.078 without friction."""
    case = CASES["panda"]
    files = case.prepare(tmp_path)
    pieces = summary.published_left(case, files, ji.load_model(files.model))
    assert len(pieces) == 2
    left = np.concatenate([x for x, _ in pieces])
    published = np.array([0.066, 0.332, 0.056, 0.086, 0.022, 0.0093, 0.0044])
    np.testing.assert_allclose(np.sqrt(np.mean(left**2, axis=0)), np.sqrt(published), rtol=0.25)


def test_double_pendulum_has_the_published_mass_matrix(tmp_path):
    """Equations of the data's own repository, rotor apart: I₁ + I₂ + m₂l₁² + 2 m₂l₁r₂ cos q₂ and so on."""
    model = mujoco.MjModel.from_xml_path(str(CASES["double_pendulum"].prepare(tmp_path).model))
    data = mujoco.MjData(model)
    data.qpos[:] = 0.3, 1.1
    mujoco.mj_forward(model, data)
    full = np.zeros((2, 2))
    mujoco.mj_fullM(model, data, full)
    across = 0.6256 * 0.2 * 0.2557 * np.cos(1.1)
    expected = [
        [0.0319 + 0.0509 + 0.6256 * 0.2**2 + 2 * across, 0.0509 + across],
        [0.0509 + across, 0.0509],
    ]
    np.testing.assert_allclose(full, expected, rtol=1e-6)
    gravity = 0.6256 * 9.81 * 0.2557 * np.sin(1.4)
    np.testing.assert_allclose(data.qfrc_bias[1], gravity, rtol=1e-6)


def test_lwr_s_model_has_no_friction_of_its_own(tmp_path):
    robot = ji.load_model(CASES["lwr4"].prepare(tmp_path).model)
    assert robot.nv == 7
    for own in (robot.damping, robot.frictionloss, robot.armature):
        np.testing.assert_array_equal(own, 0.0)


def test_terms_add_up_as_the_sensor_reads_them():
    found = [
        effect("asymmetric_coulomb", "a", positive=0.5, negative=0.3),
        effect("viscous_friction", "a", damping=0.2),
        effect("torque_bias", "a", bias=0.05),
        effect("load_friction", "b", coulomb=0.1, load_coefficient=0.05),
    ]
    terms = summary._terms(found, "a", load=2.0)
    assert terms == pytest.approx({"coulomb": 0.4, "offset": 0.05, "viscous": 0.2})
    assert report.friction(terms, 0.5) == pytest.approx(0.5)
    assert summary._terms(found, "b", load=2.0) == pytest.approx({"coulomb": 0.2})


@pytest.mark.parametrize(
    ("found", "physical"),
    [
        (effect("torque_saturation", "j", limit=0.5), False),
        (effect("joint_elasticity", "j", stiffness=4000.0), True),
        (effect("joint_elasticity", "j", stiffness=20.0), False),
        (effect("armature", "j", armature=0.5), True),
        (effect("armature", "j", armature=50.0), False),
    ],
)
def test_what_no_robot_has_is_called_so(found, physical):
    """On the UR10e, whose currents are measured; on the Panda a sensor behind the gear sees no rotor at all."""
    doubt = summary._doubt(CASES["ur10e"], found, peak={"j": 1.0}, inertia={"j": 1.0})
    assert (doubt == "") == physical
    if found["family"] == "armature":
        assert summary._doubt(CASES["panda"], found, peak={"j": 1.0}, inertia={"j": 1.0})


@pytest.mark.slow
def test_guesses_that_the_other_run_speaks_against_are_withdrawn(tmp_path):
    """A servo whose friction is no effect of the library: a force that adds to the gap of the other run is left out."""
    case = CASES["xl330"]
    files = case.prepare(tmp_path)
    inputs = pipeline.read(files.model, files.log, files.test, ())
    found = pipeline.single_effects(inputs, (), case.max_effects, lambda stage: None).found
    assert found.verdict is Verdict.UNKNOWN
    assert [f.family for f in found.findings] == ["viscous_friction"]
    assert found.test is not None
    assert found.test.after < 0.85 * found.test.before
