"""Effects that are within the noise, and effects that overlap; logs by MuJoCo C."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
from arm_log import ARM, simulate

from jax_inertia import load_model, read_log
from jax_inertia.diagnosis.entry import diagnose
from jax_inertia.diagnosis.result import Verdict


def spring(t, q, v, u):
    return np.array([0.0, -0.02 * q[1]])


def test_a_spring_is_named_where_it_is_within_noise():
    log = simulate(spring, noise=3.0)
    found = diagnose(load_model(mujoco.MjModel.from_xml_string(ARM)), log)
    assert [(f.family, f.place.name) for f in found.odd] == [("joint_spring", "elbow")]
    assert found.verdict is Verdict.EXPLAINED


CASES = Path(__file__).parents[2] / "shared" / "cases"
OVERLAP = CASES / "18-three-right-called-unknown"
BARE = CASES / "06-urdf-without-friction-or-armature"
COULOMB = 6.0, 7.0, 4.5, 1.2, 1.1, 0.9
VISCOUS = 5.0, 6.0, 4.0, 0.8, 0.8, 0.7
ROTORS = 1.2, 1.4, 0.9, 0.25, 0.25, 0.2


@pytest.mark.skipif(not BARE.is_dir(), reason="cases (../shared/cases) are not here")
@pytest.mark.slow
def test_eighteen_numbers_of_a_robot_as_bought_whose_torques_are_of_the_moment():
    """The numbers that the case's own page states; nobody says what kind its torques are."""
    log, other = (read_log(str(BARE / f"bare{k}.npz")) for k in (1, 2))
    found = diagnose(load_model(str(BARE / "arm.urdf")), log, test_log=other)
    assert found.verdict is Verdict.EXPLAINED
    assert not found.odd
    for family, right in (
        ("coulomb_friction", COULOMB),
        ("viscous_friction", VISCOUS),
        ("armature", ROTORS),
    ):
        values = [numbers[family].value for numbers in found.joints.values()]
        assert values == pytest.approx(right, rel=0.1)


@pytest.mark.slow
@pytest.mark.skipif(not OVERLAP.is_dir(), reason="cases (../shared/cases) are not here")
def test_effects_that_overlap_are_no_reason_to_doubt_them():
    """Each alone they explain 1.7 times what they do together, and each number is right."""
    found = diagnose(load_model(str(OVERLAP / "nominal.xml")), read_log(str(OVERLAP / "log.npz")))
    assert found.verdict is Verdict.EXPLAINED
    sizes = {f.family: f.parameters for f in found.odd}
    assert sizes["coulomb_friction"]["coulomb"].value == pytest.approx(4.0, rel=0.06)
    assert sizes["viscous_friction"]["damping"].value == pytest.approx(2.0, rel=0.2)
    assert sizes["payload"]["mass"].value == pytest.approx(0.5, rel=0.02)
