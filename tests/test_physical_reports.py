"""Whatever a model states wrongly: reports hold numbers that a robot can have, and all that the files change."""

import json
import math
import tempfile
from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from test_replay import ARM, NAMES, run

import jax_inertia as ji
from jax_inertia.cli.main import main
from jax_inertia.logs.log import Log

NEVER_NEGATIVE = ("viscous_friction", "coulomb_friction", "armature", "torque_gain", "damping",
                  "frictionloss", "kp", "kd", "delay", "limit", "mass", "time_constant")  # fmt: skip
FIELDS = {
    "joint": (
        "dof_armature",
        "dof_damping",
        "dof_frictionloss",
        "jnt_stiffness",
        "jnt_actfrcrange",
    ),
    "actuator": ("actuator_gainprm", "actuator_biasprm", "actuator_forcerange", "actuator_delay"),
    "body": ("body_mass", "body_ipos"),
}


@st.composite
def robots(draw) -> tuple[str, dict]:
    """A model that is off in any of its numbers, and what the robot has beyond the arm's own."""
    spec = mujoco.MjSpec.from_string(ARM)
    for joint in spec.joints:
        joint.armature *= draw(st.sampled_from([0.0, 0.5, 1.0, 6.0]))
        joint.damping = joint.damping * draw(st.sampled_from([0.0, 1.0, 8.0]))
        joint.frictionloss *= draw(st.sampled_from([0.0, 1.0, 8.0]))
    for body in spec.bodies[1:]:
        body.mass *= draw(st.sampled_from([0.6, 1.0, 1.5]))
    robot = {
        "delay": draw(st.sampled_from([0.0, 0.004, 0.02])),
        "kp": (1.0, draw(st.sampled_from([0.6, 1.0, 1.4]))),
        "dry": (draw(st.sampled_from([-0.1, 0.0, 0.5])), 0.0),
        "damping": draw(st.sampled_from([-0.05, 0.0, 0.2])),
        "seed": draw(st.integers(0, 99)),
    }
    return spec.to_xml(), robot


def diagnosed(xml: str, log: Log) -> tuple[dict, mujoco.MjModel, mujoco.MjModel]:
    """report.json, the model as given and corrected.xml."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "arm.xml").write_text(xml)
        ji.write_log(log, folder / "log.npz")
        out = ["--out", str(folder / "out")]
        assert (
            main(["diagnose", str(folder / "log.npz"), "--model", str(folder / "arm.xml"), *out])
            == 0
        )
        report = json.loads((folder / "out" / "report.json").read_text())
        models = (
            mujoco.MjModel.from_xml_path(str(folder / x)) for x in ("arm.xml", "out/corrected.xml")
        )
        return report, *models


def numbers(report: dict):
    """(name, number) of every whole number with an interval: those of ordinary effects are changes of the model's."""
    for effect in report["effects"]:
        if not effect["ordinary"]:
            for name, x in effect["parameters"].items():
                model = x.get("added_to", 0.0)
                low, high = x["ci95"]
                yield name, {"value": x["value"] + model, "ci95": [low + model, high + model]}
    for own in report["joints"].values():
        yield from own.items()


def check(report: dict, given_: mujoco.MjModel, made: mujoco.MjModel) -> None:
    for name, x in numbers(report):
        low, high = x.get("ci95") or (x["value"], x["value"])
        low, high = (x["value"] if end is None else end for end in (low, high))
        assert all(map(math.isfinite, (low, x["value"], high))), (name, x)
        assert low <= x["value"] + 1e-12, (name, x)
        assert x["value"] <= high + 1e-12, (name, x)
        if any(name == n or name.startswith(f"{n}_") for n in NEVER_NEGATIVE):
            assert low >= 0.0, (name, x)
    for field in ("dof_armature", "dof_damping", "dof_frictionloss", "body_mass", "body_inertia"):
        assert np.all(getattr(made, field) >= 0.0), field
    told = {(c["element"], c["name"]) for c in report["changes"]}
    names = {"joint": NAMES, "actuator": NAMES, "body": ("world", "upper", "lower")}
    for element, fields in FIELDS.items():
        for field in fields:
            before, after = (
                np.reshape(getattr(m, field), (len(getattr(m, field)), -1)) for m in (given_, made)
            )
            for name, x, y in zip(names[element], before, after, strict=False):
                if np.max(np.abs(x - y)) > 1e-4 * max(np.max(np.abs(x)), np.max(np.abs(y)), 1e-6):
                    assert (element, name) in told, (field, name, x, y)
    if report["verdict"] == "explained":
        for own in report["joints"].values():
            assert not own or own["armature"]["value"] < 20.0


PROPERTY = settings(
    max_examples=6, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow]
)


@pytest.mark.slow
@pytest.mark.timeout(3600)
@PROPERTY
@given(robots())
def test_by_torque_every_number_is_one_that_a_robot_can_have(drawn):
    xml, robot = drawn
    log = run(**robot, seconds=8.0)
    check(*diagnosed(xml, Log(time=log.time, joint_names=NAMES, qpos=log.qpos, tau=log.tau)))


@pytest.mark.slow
@pytest.mark.timeout(3600)
@PROPERTY
@given(robots())
def test_by_targets_every_number_is_one_that_a_robot_can_have(drawn):
    xml, robot = drawn
    log = run(**robot, seconds=6.0)
    log = Log(time=log.time, joint_names=NAMES, qpos=log.qpos, qpos_target=log.qpos_target)
    check(*diagnosed(xml, log))
