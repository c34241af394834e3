"""What stands out of noise in the motion's own band: numbers drawn as whitened noise has them, and logs by MuJoCo C."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
from arm_log import ARM, simulate

from jax_inertia import load_model, read_log
from jax_inertia.diagnosis.entry import diagnose
from jax_inertia.diagnosis.result import Verdict

ROWS, MODES = 20, 60


def noise(seed: int, draws: int) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal((draws, MODES, ROWS))


@pytest.fixture(scope="module")
def replicas():
    return noise(0, 6)


def spring(t, q, v, u):
    return np.array([0.0, -0.02 * q[1]])


class Hose:
    """A spring on the elbow, and one more whose other end follows within a second, as a hose that gives way."""

    STIFFNESS, FOLLOWS = 0.01, 1.0

    def __init__(self):
        self.end, self.time = None, 0.0

    def __call__(self, t, q, v, u):
        self.end = q[1] if self.end is None else self.end
        self.end += (t - self.time) * (q[1] - self.end) / self.FOLLOWS
        self.time = t
        return np.array([0.0, -self.STIFFNESS * (0.5 * q[1] + (q[1] - self.end))])


@pytest.mark.parametrize(
    ("cause", "known"), [(spring, True), pytest.param(Hose(), False, marks=pytest.mark.slow)]
)
def test_a_spring_is_no_cause_of_what_creeps_though_all_it_leaves_is_within_noise(cause, known):
    log = simulate(cause, noise=3.0)
    found = diagnose(load_model(mujoco.MjModel.from_xml_string(ARM)), log)
    assert [(f.family, f.place.name) for f in found.odd] == [("joint_spring", "elbow")]
    assert found.verdict is (Verdict.EXPLAINED if known else Verdict.UNKNOWN)


class Rubbing:
    """Dry friction at the shoulder that is larger one way than the other, a bristle (Dahl 1968)."""

    FORWARD, BACK, PRESLIDING = 0.6, 1.0, 8e-4

    def __init__(self):
        self.z, self.time = 0.0, 0.0

    def __call__(self, t, q, v, u):
        side = np.sign(v[0])
        self.z = side + (self.z - side) * np.exp(-abs(v[0]) * (t - self.time) / self.PRESLIDING)
        self.time = t
        return np.array([-self.z * (self.FORWARD if self.z > 0 else self.BACK), 0.0])


def tilted(model):
    model.opt.gravity[:] = 9.81 * np.array([-np.sin(0.012), 0.0, -np.cos(0.012)])


@pytest.mark.slow
def test_what_a_loud_friction_hides_is_not_explained_by_it():
    """A tilt of 0.7 degrees: nothing beside what the friction's own equation leaves, and well above the sensors."""
    found = diagnose(
        load_model(mujoco.MjModel.from_xml_string(ARM)), simulate(Rubbing(), tilted, noise=0.3)
    )
    families = {f.family for f in found.odd}
    assert families & {"asymmetric_coulomb", "coulomb_friction"}
    if found.verdict is Verdict.EXPLAINED:
        assert "gravity_tilt" in families


OVERLAP = Path(__file__).parents[2] / "shared" / "cases" / "18-three-right-called-unknown"


@pytest.mark.slow
@pytest.mark.skipif(not OVERLAP.is_dir(), reason="cases (../shared/cases) are not here")
def test_effects_that_overlap_are_no_reason_to_doubt_them():
    """Each alone they explain 1.7 times what they do together, and each number is right."""
    found = diagnose(load_model(str(OVERLAP / "nominal.xml")), read_log(str(OVERLAP / "log.npz")))
    assert found.verdict is Verdict.EXPLAINED
    sizes = {f.family: f.parameters for f in found.odd}
    assert sizes["coulomb_friction"]["coulomb"].value == pytest.approx(4.0, rel=0.02)
    assert sizes["viscous_friction"]["damping"].value == pytest.approx(2.0, rel=0.02)
    assert sizes["payload"]["mass"].value == pytest.approx(0.5, rel=0.02)
