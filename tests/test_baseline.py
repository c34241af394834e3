"""Plain least squares of four terms a joint, against what a log was made with."""

import numpy as np
import pytest
from diagnosis_robot import NOMINAL, log_of, motion, needed, ordinary

from jax_inertia.diagnosis.checks import HeldOut, OtherRun
from jax_inertia.diagnosis.corrected import baseline
from jax_inertia.diagnosis.residual import Residual
from jax_inertia.diagnosis.search.evidence import Evidence
from jax_inertia.diagnosis.search.selection import Selection
from jax_inertia.diagnosis.settings import Settings
from jax_inertia.model.load import load_model


def made(seed: int, level: float = 1.0) -> Residual:
    """Closed form by MuJoCo C; `level`: of friction, rotor and offset."""
    import mujoco

    model = mujoco.MjModel.from_xml_string(NOMINAL)
    t, q, v, a = motion(seed)
    log = log_of(t, q, needed(model, q, v, a) + ordinary(v, a, level), seed)
    return Residual(load_model(model), log, Settings())


def error(left: np.ndarray, residual: Residual) -> float:
    return float(np.sqrt((residual.moving * left**2).sum() / residual.moving.sum()))


def test_it_leaves_little_of_a_robot_that_is_its_four_terms():
    own, other = made(0), made(1)
    evidence = Evidence(own.y, own.weight, own.sensors)
    run = OtherRun(other, evidence)
    left = baseline.left_by_least_squares(own, run)
    assert error(left, other) < 0.03 * error(other.y, other)
    held = HeldOut(Selection(own, evidence, evidence.nothing(), (), ()), Settings())
    folds = baseline.left_by_least_squares(own, held)
    assert error(folds, own) < 0.03 * error(own.y, own)
    # A part is predicted by the others: what is in no other part is not fitted.
    spoilt = own.y.copy()
    part = held.fold[:, 0] == 1
    own.y[part, 0] += 5.0
    after = baseline.left_by_least_squares(own, held)
    np.testing.assert_allclose(after[part, 0] - folds[part, 0], 5.0, atol=0.2)
    own.y[:] = spoilt


def test_a_run_of_a_robot_with_other_friction_is_predicted_by_the_first_one_s():
    own, other = made(0), made(1, level=1.5)
    left = baseline.left_by_least_squares(
        own, OtherRun(other, Evidence(own.y, own.weight, own.sensors))
    )
    assert error(left, other) == pytest.approx(error(other.y, other) / 3.0, rel=0.05)
