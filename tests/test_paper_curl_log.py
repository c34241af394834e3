"""The curls' log keeps to the contract, and says what the sensors said."""

from pathlib import Path

import numpy as np

from benchmarks.paper.curl_log import contract, sensed
from benchmarks.paper.plant import Fleet, Sensors, model
from jax_inertia import load_model
from jax_inertia.logs.log_files import read_log
from jax_inertia.preflight.preflight import preflight


def test_log_of_standing_robot_is_sound_and_its_feet_carry_it(tmp_path: Path):
    plant = model()
    fleet = Fleet(plant, np.array([3]), Sensors())
    rows = []
    for _ in range(20):
        fleet.step(np.zeros((1, plant.nu)))
        rows.append({name: x[0].copy() for name, x in sensed(fleet).items()})
    series = {name: np.stack([row[name] for row in rows]) for name in rows[0]}
    robot = load_model(plant)
    arrays = contract(robot, 0.003 * np.arange(20), series)
    np.savez(tmp_path / "curl.npz", **arrays)  # pyright: ignore[reportArgumentType]
    log = read_log(tmp_path / "curl.npz", names=robot)
    preflight(log, robot).raise_for_errors()
    np.testing.assert_array_equal(log.qpos, series["q"][:, 7:])
    np.testing.assert_array_equal(log.base_angvel, series["v"][:, 3:6])
    wrench = np.asarray(log.contact_wrench)
    vertical = series["force"].reshape(20, 2, 4, 3)[..., 2].sum(axis=2)
    np.testing.assert_allclose(wrench[:, :, 2], vertical, rtol=1e-6, atol=1e-3)
    # The front of the sole is the longer lever: a foot under load has a moment about its own frame.
    assert np.abs(wrench[:, :, 3:5]).max() > 1.0
