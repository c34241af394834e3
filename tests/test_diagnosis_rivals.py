"""What may be there in the place of an effect that was found: as probable as it, and more so than nothing."""

import copy

import mujoco
import numpy as np
import pytest
from diagnosis_robot import log_of, motion, needed
from test_diagnosis_calibrated import COULOMB, ELBOW, ROTOR, VISCOUS, with_joints

from jax_inertia import load_model
from jax_inertia.diagnosis.certainty.rivals import rivals
from jax_inertia.diagnosis.checks import rows
from jax_inertia.diagnosis.conclusion.stated_causes import without
from jax_inertia.diagnosis.effects.base import Place
from jax_inertia.diagnosis.effects.encoder import Backlash, JointElasticity
from jax_inertia.diagnosis.effects.joint import Armature, Cogging
from jax_inertia.diagnosis.hypothesis import hypothesis
from jax_inertia.diagnosis.residual import Residual
from jax_inertia.diagnosis.search.ordinary import ordinary_of, ordinary_physics
from jax_inertia.diagnosis.search.selection import Selection
from jax_inertia.diagnosis.settings import CalibrationState, Settings
from jax_inertia.maths.precision import in_double_precision

SETTINGS = Settings()


@pytest.fixture(scope="module")
@in_double_precision
def sound():
    """Residual, evidence and posterior of an arm as its model says."""
    t, q, v, a = motion(1)
    model = mujoco.MjModel.from_xml_string(with_joints())
    bare = mujoco.MjModel.from_xml_string(with_joints((0, 0, 0), (0, 0, 0), (0, 0, 0)))
    tau = needed(bare, q, v, a) + VISCOUS * v + COULOMB * np.tanh(v / 0.002) + ROTOR * a
    residual = Residual(load_model(model).astype("float64"), log_of(t, q, tau, 1), SETTINGS)
    evidence, now, _ = ordinary_physics(residual, (), SETTINGS, CalibrationState.CALIBRATED)
    return residual.calibrated(ordinary_of(residual, now)), evidence, now


@in_double_precision
def found(sound, h, size, others):
    """The search that ended with `h`, of which the log has `size` of its unit, among others."""
    residual, evidence, now = sound
    evidence = copy.copy(evidence)
    evidence.y = evidence.y + size * h.torque(np.eye(h.count)[0] / h.scale[0], evidence.y.shape)
    evidence._latest, evidence._base, evidence._seen = None, None, None
    now = evidence.posterior((*now.chosen, h))
    return Selection(residual, evidence, now, (h, *others), ())


def test_what_is_no_likelier_than_nothing_is_nothing(sound):
    """A faint wave at the elbow is not to be doubted for rotors of next to nothing at the other joints."""
    residual, *_ = sound
    h = hypothesis(residual, Cogging(), ELBOW, (8.0,), 8.0)
    others = [
        hypothesis(residual, Armature(), Place("joint", name, row), (), 2.0)
        for row, name in ((0, "shoulder"), (2, "wrist"))
    ]
    sizes = np.geomspace(0.005, 0.5, 40)
    worths = [
        selection.evidence.worths(selection.posterior)[-1]
        for selection in (found(sound, h, size, others) for size in sizes)
    ]
    faint = sizes[int(np.argmax(np.array(worths) > h.odds + 3.0))]
    selection = found(sound, h, faint, others)
    assert selection.evidence.worths(selection.posterior)[-1] - h.odds < 10.0
    assert rivals(selection, h, SETTINGS) == ()


def test_laws_of_one_place_compete_at_their_best(sound):
    """Play that is next to none is a spring, and the grid from which it is searched has wide play alone."""
    residual, *_ = sound
    context = residual.context_of(JointElasticity())
    plays = [shape for shape in Backlash().coarse(context, ELBOW) if shape[3:5] == (0.0, 0.0)]
    stiffness = min(shape[1] for shape in plays)
    plays = [shape for shape in plays if shape[1] == stiffness and 0.005 < shape[0] < 0.02]
    spring = next(iter(JointElasticity().shapes(context, ELBOW)))
    h = hypothesis(residual, JointElasticity(), ELBOW, (stiffness, 0.15, *spring[2:]), 8.0)
    others = [hypothesis(residual, Backlash(), ELBOW, shape, 8.0) for shape in plays]
    selection = found(sound, h, 1.0, others)
    own = float(selection.evidence.gains(selection.posterior.without(h), (h,))[0])
    on_grid = selection.evidence.gains(selection.posterior.without(h), others).max()
    assert own - on_grid > 2 * SETTINGS.reach(own)
    (rival,) = rivals(selection, h, SETTINGS)
    assert rival.hypothesis.family == "backlash"
    assert rival.behind < SETTINGS.reach(own)


def test_what_has_no_name_is_noise_where_numbers_are_stated(sound):
    """By the noise that a wave leaves once it is taken from them, rows with it would seem exact."""
    residual, *_ = sound
    h = hypothesis(residual, Cogging(), ELBOW, (8.0,), 8.0)
    selection = found(sound, h, 0.5, ())
    stated = without(selection, [h])
    assert h not in stated.posterior.chosen
    left = selection.evidence.y - stated.posterior.fitted
    noise = np.sqrt(np.mean(stated.evidence.noise.variance, axis=0))
    assert noise[1] == pytest.approx(rows(left, residual.weight)[1], rel=0.1)
    assert noise[1] > 3 * np.sqrt(np.mean(selection.evidence.noise.variance, axis=0))[1]
    assert without(selection, []) is selection
