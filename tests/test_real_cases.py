"""Real robots as they are diagnosed: models and logs as prepared, and the published fits."""

import mujoco
import numpy as np
import pytest

import jax_inertia as ji
from benchmarks.exam.torque_error import read, torque_error
from benchmarks.real_logs import cases, logs, other_run

pytestmark = pytest.mark.skipif(
    not logs.SHARED.is_dir(),
    reason=f"recorded logs are not at {logs.SHARED}; JAX_INERTIA_DATA may name their folder",
)
CASES = {case.name: case for case in cases.CASES}


def test_panda_s_published_friction_leaves_what_its_page_says(tmp_path):
    """Mean squares of the data's page, whole run and another filter: 0.127 ... 0.078 without friction."""
    files = CASES["panda"].prepare(tmp_path)
    model = mujoco.MjModel.from_xml_path(str(files.model))
    predict = other_run.published("panda")
    assert predict is not None
    left = [torque_error(model, predict, read(p), held=False) for p in (files.log, files.test)]
    each, rows = (np.array([list(x[of].values()) for x in left]) for of in ("per_joint", "rows"))
    mean_square = (each**2 * rows).sum(axis=0) / rows.sum(axis=0)
    published = np.array([0.066, 0.332, 0.056, 0.086, 0.022, 0.0093, 0.0044])
    np.testing.assert_allclose(np.sqrt(mean_square), np.sqrt(published), rtol=0.25)


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
