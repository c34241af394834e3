"""A URDF's root link moves freely where its caller, or its log, says so."""

import argparse
import dataclasses
from pathlib import Path

import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import jax_inertia as ji
from jax_inertia.cli import estimate
from jax_inertia.cli.diagnose_run import read
from jax_inertia.dynamics.rigid_body import inverse_dynamics
from jax_inertia.logs.log import Log
from jax_inertia.logs.log_files import write_log
from jax_inertia.model.load import compile_spec, load_spec
from jax_inertia.model.log_match import afloat

LEG = """<robot name="leg">
  <link name="{root}"><inertial><origin xyz="0.02 0 0.1"/><mass value="4"/>
    <inertia ixx="0.05" ixy="0.001" ixz="0" iyy="0.04" iyz="0" izz="0.03"/></inertial>{shape}</link>
  <link name="shank"><inertial><origin xyz="0 0.01 -0.1"/><mass value="1"/>
    <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.002"/></inertial></link>
  <link name="foot"><inertial><mass value="0.1"/>
    <inertia ixx="1e-4" ixy="0" ixz="0" iyy="1e-4" iyz="0" izz="1e-4"/></inertial></link>
  <joint name="knee" type="continuous"><parent link="{root}"/><child link="shank"/><axis xyz="0 1 0"/></joint>
  <joint name="ankle" type="fixed"><parent link="shank"/><child link="foot"/><origin xyz="0 0 -0.2"/></joint>
</robot>"""
SHAPE = '<collision><geometry><mesh filename="trunk.obj"/></geometry></collision>'
TETRAHEDRON = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


def leg(folder: Path, root: str = "trunk", shape: str = "") -> Path:
    path = folder / "leg.urdf"
    path.write_text(LEG.format(root=root, shape=shape))
    return path


def standing(**changes) -> Log:
    """A trunk that sways by 2 cm over its foot."""
    time = np.arange(400) / 100.0
    sway = 0.02 * np.sin(2 * np.pi * time)[:, None]
    fields = {
        "time": time,
        "joint_names": ("knee",),
        "qpos": 20 * sway,
        "tau": 100 * sway,
        "base_pos": np.concatenate([sway, 0 * sway, 0.4 + 0 * sway], axis=1),
        "base_quat": np.tile([1.0, 0, 0, 0], (len(time), 1)),
    }
    return Log(**(fields | changes))


def test_a_urdf_afloat_is_pinocchio_s_free_flyer(tmp_path):
    from pinocchio_oracle import pin

    robot = ji.load_model(leg(tmp_path), floating_base=True)
    assert robot.has_free_base
    assert robot.body_names == ("trunk", "shank", "foot")
    other = pin.buildModelFromXML(LEG.format(root="trunk", shape=""), pin.JointModelFreeFlyer())
    # With the base level and at rest both programs mean the same by every row.
    want = pin.rnea(
        other,
        other.createData(),
        np.array([0.1, 0.2, 0.3, 0, 0, 0, 1, np.cos(0.6), np.sin(0.6)]),
        np.zeros(7),
        np.array([0.3, -0.2, 0.5, 0.7, -0.4, 0.6, 2.0]),
    )
    got = inverse_dynamics(
        robot,
        jnp.array([0.1, 0.2, 0.3, 1, 0, 0, 0, 0.6]),
        jnp.zeros(7),
        jnp.array([0.3, -0.2, 0.5, 0.7, -0.4, 0.6, 2.0]),
    )
    np.testing.assert_allclose(got, want, rtol=1e-9)


def test_meshes_are_found_beside_it(tmp_path):
    (tmp_path / "trunk.obj").write_text(TETRAHEDRON)
    spec = load_spec(leg(tmp_path, shape=SHAPE), floating_base=True)
    assert len(spec.meshes) == 1
    assert compile_spec(spec).nv == 7


def test_what_does_not_float(tmp_path):
    path = leg(tmp_path, root="world")
    assert not ji.load_model(path, floating_base=True).has_free_base
    path.write_text(
        LEG.format(root="trunk", shape="").replace("</robot>", '<link name="odd"/></robot>')
    )
    with pytest.raises(ji.ModelError, match=r"one root link; .* trunk, odd"):
        ji.load_model(path, floating_base=True)
    long = f'<link name="{"odd" * 200}"/></robot>'
    path.write_text(LEG.format(root="trunk", shape="").replace("</robot>", long))
    with pytest.raises(ji.ModelError, match=r"trunk, oddodd") as told:
        ji.load_model(path, floating_base=True)
    assert len(str(told.value).replace(str(path), "")) < 200
    mjcf = tmp_path / "leg.xml"
    mjcf.write_text("<mujoco/>")
    for model in (mjcf, mujoco.MjModel.from_xml_path(str(mjcf))):
        with pytest.raises(ji.ModelError, match="freejoint"):
            ji.load_model(model, floating_base=True)


def test_a_name_adds_nothing_to_the_file(tmp_path):
    robot = ji.load_model(leg(tmp_path, root="a&quot;/&gt;&lt;b c=&quot;"), floating_base=True)
    assert robot.body_names[0] == 'a"/><b c="'
    path = leg(tmp_path)
    path.write_text(path.read_text().replace("</robot>", ""))
    with pytest.raises(ji.ModelError, match="</robot>"):
        ji.load_model(path, floating_base=True)


def test_a_log_says_that_its_base_floats(tmp_path):
    path = leg(tmp_path)
    fixed, log = ji.load_model(path), standing()
    robot, [told] = afloat(fixed, path, log)
    assert robot.has_free_base
    assert "'trunk', the URDF's root link, floats" in told.message
    # The pose of a base that is fixed may be logged too.
    still = dataclasses.replace(log, base_pos=0.0 * np.asarray(log.base_pos))
    assert afloat(fixed, path, still) == (fixed, ())
    assert afloat(fixed, path, dataclasses.replace(log, base_pos=None)) == (fixed, ())
    wrench = np.zeros((len(log.time), 1, 6))
    touching = dataclasses.replace(still, contact_wrench=wrench, contact_bodies=("foot",))
    assert afloat(fixed, path, touching)[0].has_free_base
    write_log(log, tmp_path / "log.npz")
    inputs = read(path, tmp_path / "log.npz", None, ())
    assert inputs.robot.has_free_base
    assert "base" in [finding.check for finding in inputs.quality]


def test_who_weighs_a_robot_that_floats_is_told_to_log_what_carries_it(tmp_path, capsys):
    path, log = leg(tmp_path), standing()
    wrench = np.zeros((len(log.time), 1, 6))
    for name, one in {
        "without": log,
        "with": dataclasses.replace(log, contact_wrench=wrench, contact_bodies=("foot",)),
    }.items():
        write_log(one, tmp_path / f"{name}.npz")
        parser = argparse.ArgumentParser()
        estimate.add_parser(parser.add_subparsers())
        files = [str(tmp_path / f"{name}.npz"), "--model", str(path)]
        inputs = estimate.read(parser.parse_args(["estimate", *files, "--bodies", "trunk"]))
        told = [finding.check for finding in inputs.findings]
        assert ("contact_wrench" in told) == (name == "without")
        assert ("no contact_wrench: forces at its feet" in capsys.readouterr().err) == (
            name == "without"
        )
