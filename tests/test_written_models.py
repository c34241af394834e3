"""Models that are written: where they find their meshes, corrected once more, with all that was calibrated."""

import json
import shutil
from pathlib import Path

import mujoco
import numpy as np
import pytest
from excitation import compiled, loaded, motion_of, torques
from models import MODELS

import jax_inertia as ji
from jax_inertia.cli.main import main
from jax_inertia.diagnosis.effects.identified import Identified
from jax_inertia.diagnosis.simulate.corrected import corrected
from jax_inertia.logs.log import Log
from jax_inertia.model.write import JointNumbers, loadable, write_with_inertials

CUBE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"
MESHED = """<mujoco><compiler meshdir="assets"/><asset><mesh name="cube" file="cube.obj"/></asset><worldbody>
<body name="arm"><joint name="turn"/><inertial pos="0 0 0" mass="1" diaginertia=".1 .1 .1"/>
<geom type="mesh" mesh="cube"/></body></worldbody></mujoco>"""


@pytest.fixture
def meshed(tmp_path) -> Path:
    (tmp_path / "robot" / "assets").mkdir(parents=True)
    (tmp_path / "robot" / "assets" / "cube.obj").write_text(CUBE)
    (tmp_path / "robot" / "arm.xml").write_text(MESHED)
    return tmp_path / "robot" / "arm.xml"


def test_meshes_are_found_from_where_the_model_lies_and_after_both_were_moved(meshed, tmp_path):
    home = tmp_path / "results" / "log"
    home.mkdir(parents=True)
    text = loadable(mujoco.MjSpec.from_file(str(meshed)), meshed, home)
    assert 'meshdir="../../robot/assets' in text
    (home / "corrected.xml").write_text(text)
    assert mujoco.MjModel.from_xml_path(str(home / "corrected.xml")).nmesh == 1
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    for folder in ("robot", "results"):
        shutil.move(tmp_path / folder, elsewhere / folder)
    moved = elsewhere / "results" / "log" / "corrected.xml"
    assert mujoco.MjModel.from_xml_path(str(moved)).nmesh == 1


def test_a_model_that_shares_only_the_root_keeps_its_absolute_folder(meshed):
    text = loadable(mujoco.MjSpec.from_file(str(meshed)), meshed, Path("/somewhere/else"))
    assert f'meshdir="{meshed.parent.resolve()}/assets' in text


@pytest.mark.parametrize("data", ["it's", 'a "b" & <c>', "two\nlines"])
def test_texts_are_attributes_which_older_ones_read(data, tmp_path):
    """MuJoCo 3.17 writes a text with quotes as character data, which 3.6 refuses."""
    spec = mujoco.MjSpec.from_string(MODELS["universal"])
    spec.add_text(name="said", data=data)
    text = loadable(spec, tmp_path / "arm.xml", tmp_path)
    assert "CDATA" not in text
    assert mujoco.MjSpec.from_string(text).text("said").data == data


def test_a_corrected_model_is_corrected_once_more():
    spec = mujoco.MjSpec.from_string(MODELS["universal"])
    drag = Identified("viscous_friction", "joint", "first", {"damping": 0.5})
    once = mujoco.MjSpec.from_string(corrected(spec, [drag]).spec.to_xml())
    before = float(once.joint("first").damping[0])
    twice = corrected(once, [drag, drag]).spec
    assert float(twice.joint("first").damping[0]) == pytest.approx(before + 1.0)
    assert [text.name for text in twice.texts] == [f"gap_effect_{k}" for k in range(3)]


URDF = """<robot name="r"><link name="base"/><link name="arm"><inertial><origin xyz="0 0 0.1"/><mass value="1"/>
<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial></link>
<joint name="j" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>
<limit lower="-2" upper="2" effort="9" velocity="9"/></joint></robot>"""


def test_of_a_urdf_joints_go_into_an_mjcf_file_beside_it(tmp_path):
    (tmp_path / "r.urdf").write_text(URDF)
    pi = np.asarray(ji.load_model(tmp_path / "r.urdf").pi)[0] * 1.5
    numbers = JointNumbers(damping=0.3, frictionloss=0.2, armature=0.1, offset=-0.4, gain=9.0)
    urdf, mjcf = write_with_inertials(
        tmp_path, "estimated", tmp_path / "r.urdf", {"arm": pi}, joints={"j": numbers}
    )
    assert (urdf.suffix, mjcf.suffix) == (".urdf", ".xml")
    for path in (urdf, mjcf):
        np.testing.assert_allclose(np.asarray(ji.load_model(path).pi)[0], pi, rtol=1e-5)
        model = mujoco.MjModel.from_xml_path(str(path))
        assert (model.dof_damping[0], model.dof_frictionloss[0]) == (0.3, 0.2)
    assert model.dof_armature[0] == 0.1
    assert model.numeric("torque_offset_j").data[0] == -0.4
    assert model.numeric("torque_gain_j").data[0] == 9.0


# --- estimate ------------------------------------------------------------------------------------------------------

RATE, SAMPLES, GAIN = 250.0, 1500, 8.0
DRAG, ROTOR = np.array([0.8, 0.6, 0.4]), np.array([0.3, 0.2, 0.1])


def amperes(model, seed: int, offset: float) -> Log:
    """Of the three-joint arm with viscous friction and rotor inertia that its model lacks."""
    time, q, v, a = motion_of(model, SAMPLES, seed, RATE)
    tau = torques(model, q, v, a) + DRAG * v + ROTOR * a + offset
    tau += 0.02 * np.random.default_rng(seed).normal(size=v.shape)
    names = ("first", "second", "third")
    return Log(time=time, joint_names=names, qpos=q, qvel=v, tau=tau / GAIN, tau_unit="A")


@pytest.mark.slow
def test_all_that_was_calibrated_is_written_and_told(tmp_path):
    bare = compiled("universal")
    (tmp_path / "arm.xml").write_text(MODELS["universal"])
    for seed in (1, 2):
        ji.write_log(amperes(bare, seed, 0.5), tmp_path / f"free_{seed}.npz")
    ji.write_log(amperes(loaded(bare, "tip"), 3, 0.5), tmp_path / "loaded.npz")
    free = [str(tmp_path / f"free_{seed}.npz") for seed in (1, 2)]
    options = ["--bodies", "tip", "--calibrate", *free, "--gains", "10", "--trust", "0.01", "0.001"]
    command = ["estimate", str(tmp_path / "loaded.npz"), "--model", str(tmp_path / "arm.xml")]
    out = tmp_path / "out"
    assert main([*command, *options, "--write-model", "--out", str(out)]) == 0
    own = mujoco.MjModel.from_xml_string(MODELS["universal"])
    found = mujoco.MjModel.from_xml_path(str(out / "estimated.xml"))
    np.testing.assert_allclose(found.dof_damping - own.dof_damping, DRAG, rtol=0.1)
    np.testing.assert_allclose(found.dof_armature - own.dof_armature, ROTOR, rtol=0.1)
    for name in ("first", "second", "third"):
        assert found.numeric(f"torque_gain_{name}").data[0] == pytest.approx(GAIN, rel=0.05)
        assert found.numeric(f"torque_offset_{name}").data[0] == pytest.approx(0.5, abs=0.1)
    assert found.body("tip").mass[0] == pytest.approx(3.2, abs=0.2)
    told = json.loads((out / "report.json").read_text())["calibration"]["bodies"]
    others = [name for name in told if name != "tip"]
    assert others
    for name in others:
        assert found.body(name).mass[0] == pytest.approx(told[name]["mass_kg"], rel=1e-4)


def test_bodies_that_no_joint_parts_are_named():
    spec = mujoco.MjSpec.from_string(MODELS["universal"])
    spec.body("tip").add_body(
        name="tool", ipos=[0, 0, 0], mass=0.1, inertia=[1e-4] * 3, explicitinertial=True
    )
    robot = ji.load_model(spec.compile())
    assert robot.rigid_with("tip") == ("tool",)
    assert robot.rigid_with("tool") == ("tip",)
    other = next(name for name in robot.body_names if name not in ("tip", "tool"))
    assert robot.rigid_with(other) == ()
