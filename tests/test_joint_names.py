"""Joints of a file by other names than the model's: what is unmistakable is read, the rest is refused by name."""

import numpy as np
import pytest
from robots_in_motion import log_of, robot_of

from jax_inertia.logs.joint_names import fitted, proposal
from jax_inertia.logs.log import LogError
from jax_inertia.logs.log_files import read_log
from jax_inertia.logs.readers import Options
from jax_inertia.preflight.preflight import preflight

ARM = ("turn", "raise", "fold", "tilt")
PANDA = tuple(f"panda_joint{k}" for k in range(1, 8))
FINGERS = ("panda_finger_joint1", "panda_finger_joint2")
GO2 = tuple(f"{leg}_{part}_joint" for leg in ("FL", "FR") for part in ("hip", "thigh", "calf"))

FITTED = {
    "a prefix of the file's": (tuple(f"left_{x}" for x in ARM), ARM),
    "an ending of the file's": (tuple(f"{x}_joint" for x in ARM), ARM),
    "a namespace": (tuple(f"/robot1/{x}" for x in ARM), ARM),
    "an ending of the model's": (ARM, tuple(f"{x}_joint" for x in ARM)),
    "a prefix of the model's": (ARM, tuple(f"left_{x}" for x in ARM)),
    "one at either end": (tuple(f"arm/{x}" for x in ARM), tuple(f"{x}_joint" for x in ARM)),
    "capitals": (tuple(x.upper() for x in ARM), ARM),
    "dots for dashes": (tuple(x.replace("_", ".") for x in GO2), GO2),
    "another order": (tuple(x.removesuffix("_joint") for x in GO2[::-1]), GO2[::-1]),
    "fingers that the file lacks": (PANDA, PANDA),
    "numbers": (tuple(str(k) for k in range(1, 8)), PANDA),
}


@pytest.mark.parametrize("what", FITTED)
def test_affixes_of_either_side_are_seen(what):
    theirs, ours = FITTED[what]
    if theirs == ours:
        theirs = tuple(x.removeprefix("panda_") for x in theirs)
    extra = FINGERS if ours == PANDA else ()
    expected = dict(zip(theirs, ours, strict=True))
    assert fitted(theirs, (*ours, *extra)) == expected
    # In whatever order both are.
    assert fitted(theirs[::-1], (*extra, *ours)) == expected


LEFT_OPEN = {
    "two arms and one of their names": (
        ARM,
        tuple(f"{s}_{x}" for s in ("left", "right") for x in ARM),
    ),
    "a name that fits as it stands": (("turn", "raise_joint", "fold_joint", "tilt_joint"), ARM),
    "the other arm": (tuple(f"left_{x}" for x in ARM), tuple(f"right_{x}" for x in ARM)),
    "numbers from zero": (tuple(str(k) for k in range(7)), PANDA),
    "nothing in common": (("m1", "m2"), ("hip", "knee")),
    "no joints": ((), ARM),
}


@pytest.mark.parametrize("what", LEFT_OPEN)
def test_what_may_be_meant_otherwise_is_left_open(what):
    theirs, ours = LEFT_OPEN[what]
    assert fitted(theirs, ours) == {}


def written(path, names):
    log = log_of("leg")
    np.savez(path, time=log.time, qpos=log.qpos, tau=log.tau, joint_names=np.array(names))
    return path


def test_a_log_is_read_by_the_models_names_and_says_so(tmp_path):
    robot = robot_of("leg")
    path = written(tmp_path / "log.npz", [f"/go/{x}_joint" for x in robot.joint_names])
    log = read_log(path, names=robot)
    assert log.joint_names == robot.joint_names
    assert any("by other names: /go/abduct_joint is abduct" in note for note in log.notes)


def test_another_robots_names_are_refused_with_the_option_that_names_them(tmp_path):
    robot = robot_of("leg")
    path = written(tmp_path / "log.npz", [f"fr3_{x}" for x in robot.joint_names])
    theirs = Names(tuple(f"panda_{x}" for x in robot.joint_names), robot.joint_type)
    log = read_log(path, names=theirs)
    assert log.joint_names[0] == "fr3_abduct"
    (error,) = [x for x in preflight(log, theirs).findings if x.check == "joint_name"]
    assert error.message.endswith("convert IN OUT --rename 'fr3*=panda*'")
    again = read_log(path, options=Options(rename={"fr3*": "panda*"}), names=theirs)
    assert again.joint_names == theirs.joint_names


def test_a_star_on_one_side_is_refused(tmp_path):
    path = written(tmp_path / "log.npz", ["a", "b", "c"])
    with pytest.raises(LogError, match="both sides have one"):
        read_log(path, options=Options(rename={"a*": "b"}))
    with pytest.raises(LogError, match="no joint 'x"):
        read_log(path, options=Options(rename={"x*": "y*"}))


def test_no_proposal_where_names_share_nothing():
    assert proposal(("m1", "m2"), ("hip", "knee")) == ""


class Names:
    """What a robot calls its joints and bodies."""

    body_names = ("base",)

    def __init__(self, joint_names, joint_type):
        self.joint_names, self.joint_type = joint_names, joint_type
