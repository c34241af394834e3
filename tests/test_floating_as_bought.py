"""A quadruped as it is bought: legs without friction and rotors in the model, wrenches at the feet measured."""

import re

import numpy as np
import pytest

import jax_inertia as ji
from benchmarks.worlds.feet.balance import drawing_errors, walk
from benchmarks.worlds.feet.quadruped import quadruped
from jax_inertia.diagnosis.result import Diagnosis, Verdict


@pytest.mark.slow
def test_every_joint_of_a_quadruped_as_bought(tmp_path):
    """By a world that shares no code with the package; what joints have is in the file that is stripped."""
    whole, nominal = quadruped(), tmp_path / "nominal.xml"
    nominal.write_text(whole.xml)
    bare = tmp_path / "bare.xml"
    bare.write_text(re.sub(r' (armature|damping|frictionloss)="[^"]*"', "", whole.xml))
    robot, true = ji.load_model(bare), ji.load_model(nominal)
    for name, kind, seconds in (("log", "squat", 8.0), ("test", "sway", 7.0)):
        real = drawing_errors(whole.model(), np.random.default_rng(347))
        np.savez(tmp_path / f"{name}.npz", **walk(kind, [347], seconds, model=real))
    log, other = (ji.read_log(tmp_path / f"{name}.npz") for name in ("log", "test"))
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
            # The real robot is up to 10 % off its own model.
            slack = 0.1 * float(values[row])
            within.append(p.low - slack <= float(values[row]) <= p.high + slack)
    assert np.mean(within) > 0.8
    assert found.test is not None
    # The base's rows are its wrenches' noise; the legs' are friction and rotors.
    assert found.test.after < 1.1 * found.test.noise
    legs = [
        after / before for j, (before, after) in found.test.per_joint.items() if j in found.joints
    ]
    assert np.median(legs) < 0.5
