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


OVERLAP = Path(__file__).parents[2] / "shared" / "cases" / "18-three-right-called-unknown"


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
