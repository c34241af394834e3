"""What stands out of noise in the motion's own band: numbers drawn as whitened noise has them, and logs by MuJoCo C."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
from arm_log import ARM, simulate

from jax_inertia import load_model, read_log
from jax_inertia.gap import Verdict, diagnose
from jax_inertia.gap.evidence import Evidence
from jax_inertia.gap.slow import Slow
from jax_inertia.gap.strain import Strangeness, strangeness

ROWS, MODES = 20, 60


class Drawn(Evidence):
    """A log that is nothing but its slow numbers."""

    slow_modes, slow_band = MODES, 3.0

    def __init__(self, numbers: np.ndarray):
        self.y = numbers.ravel()
        self.used = np.ones((MODES, ROWS), bool)

    def slow(self, x):
        return x

    def charged(self, y):
        return y.ravel()


def noise(seed: int, draws: int) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal((draws, MODES, ROWS))


def judged(numbers: np.ndarray, replicas: np.ndarray, known: bool = True) -> Strangeness:
    slow = Slow.of(Drawn(numbers), replicas, known)
    return strangeness(slow, float(numbers.size), [])


@pytest.fixture(scope="module")
def replicas():
    return noise(0, 6)


def test_noise_alone_does_not_stand_out(replicas):
    assert max(judged(x, replicas).most for x in noise(1, 1000)) < 1.0


def test_one_joint_of_many_stands_out_of_its_own_noise(replicas):
    for x in noise(2, 100):
        x[:, 7] *= 2.0
        found = judged(x, replicas)
        # Beside the noise of all joints it is nothing.
        assert found.misfit < 1.0 < found.slow


def test_where_the_noise_is_not_known_it_may_be_the_noise(replicas):
    (x,) = noise(3, 1)
    x[:, 7] *= 1.7
    assert judged(x, replicas, known=False).most < 1.0


def test_a_row_that_counts_nowhere_says_nothing(replicas):
    (x,) = noise(4, 1)
    still = replicas.copy()
    still[:, :, 3] = x[:, 3] = 0.0
    assert judged(x, still).most < 1.0


@pytest.mark.parametrize(
    ("drawn", "form_error", "share"),
    [(1.0, 0.0, None), (0.5, 0.0, 0.25), (0.5, 1.01, None), (0.0, 0.0, 1.0)],
)
def test_what_effects_leave_of_what_was_there(replicas, drawn, form_error, share):
    (x,) = noise(5, 1)
    cause = np.zeros_like(x)
    cause[:, 7] = 8.0 * np.sin(np.arange(MODES))
    slow = Slow.of(Drawn(x + cause), replicas, True)
    left = (x + cause).ravel() - drawn * cause.ravel()
    missed = slow.missed(left, [form_error * drawn * cause.ravel()])
    if share is None:
        assert missed is None
        return
    assert missed is not None
    assert missed.row == 7
    assert missed.share == pytest.approx(share, rel=0.15)


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
    assert [(f.family, f.place.name) for f in found.findings] == [("joint_spring", "elbow")]
    assert found.verdict is (Verdict.EXPLAINED if known else Verdict.UNKNOWN)
    assert any("most of it at elbow" in doubt for doubt in found.doubts) is not known


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
    families = {f.family for f in found.findings}
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
    sizes = {f.family: f.parameters for f in found.findings}
    assert sizes["coulomb_friction"]["coulomb"].value == pytest.approx(4.0, rel=0.02)
    assert sizes["viscous_friction"]["damping"].value == pytest.approx(2.0, rel=0.02)
    assert sizes["payload"]["mass"].value == pytest.approx(0.5, rel=0.02)
