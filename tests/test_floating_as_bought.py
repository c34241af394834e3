"""A quadruped as it is bought: legs without friction and rotors in the model, wrenches at the feet measured."""

import re
import sys
from pathlib import Path

import numpy as np
import pytest

import jax_inertia as ji
from jax_inertia.diagnosis.result import Diagnosis, Verdict

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks" / "gap"))

import generate


@pytest.mark.slow
def test_every_joint_of_a_quadruped_as_bought(tmp_path):
    """By the generator that shares no code with the package; what joints have is in the file that is stripped."""
    (tmp_path / "truth").mkdir()
    generate.write(tmp_path, "legged_none", 347, 1)
    folder = tmp_path / "logs" / "00001"
    whole = (folder / "nominal.xml").read_text()
    bare = folder / "bare.xml"
    bare.write_text(re.sub(r' (armature|damping|frictionloss)="[^"]*"', "", whole))
    robot, true = ji.load_model(bare), ji.load_model(folder / "nominal.xml")
    log, other = (ji.read_log(folder / name) for name in ("log.npz", "test.npz"))
    found = ji.diagnose(robot, log, test_log=other)
    assert isinstance(found, Diagnosis)
    assert found.verdict is Verdict.EXPLAINED
    assert not found.odd
    own = {"viscous_friction": true.damping, "armature": true.armature}
    within = []
    for joint, numbers in found.joints.items():
        row = true.joint_dofadr[true.joint_index(joint)]
        for family, values in own.items():
            p = numbers[family]
            # The generator's robot is up to 5 % off its own model.
            slack = 0.05 * float(values[row])
            within.append(p.low - slack <= float(values[row]) <= p.high + slack)
    assert np.mean(within) > 0.8
    assert found.test is not None
    # The base's rows are its wrenches' noise; the legs' are friction and rotors.
    assert found.test.after < 1.1 * found.test.noise
    legs = [
        after / before for j, (before, after) in found.test.per_joint.items() if j in found.joints
    ]
    assert np.median(legs) < 0.5
