"""Models as people have them: MJCF of several files, URDF with meshes elsewhere, names; and URDF written back."""

import contextlib
import sys
import warnings
from pathlib import Path

import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from bodies import random_bodies

import jax_inertia as ji
from jax_inertia.dynamics.rigid_body import inverse_dynamics
from jax_inertia.model.load import (
    ModelError,
    body_pi,
    compile_spec,
    is_urdf,
    load_spec,
    set_inertials,
    write_urdf,
)
from jax_inertia.model.urdf_write import Dynamics
from jax_inertia.model.write import (
    changed_inertials,
    loadable,
    write_urdf_as,
    write_with_inertials,
)

# --- MJCF as in a collection of models ----------------------------------------------------------------------------

SCENE = """<mujoco model="scene"><include file="arm.xml"/>
  <statistic center="0 0 0.5" extent="1"/>
  <asset><texture type="skybox" builtin="gradient" rgb1="0 0 0" rgb2="1 1 1" width="32" height="32"/></asset>
  <worldbody><light pos="0 0 1.5" dir="0 0 -1" directional="true"/><geom type="plane" size="0 0 0.05"/></worldbody>
</mujoco>"""
ARM = """<mujoco model="arm"><compiler angle="radian" meshdir="assets" autolimits="true"/>
  <include file="parts/defaults.xml"/>
  <asset><mesh class="arm" file="link0.stl"/><mesh class="arm" file="link1.obj"/><material name="white"/></asset>
  <worldbody><body name="base" childclass="arm"><geom class="visual" mesh="link0"/>
    <body name="link1" pos="0 0 0.3"><inertial pos="0.01 0 0.1" mass="2" fullinertia="0.02 0.03 0.01 0.001 0 0"/>
      <joint name="j1"/><geom class="visual" mesh="link1" material="white"/><geom class="collision" mesh="link1"/>
      <body name="link2" pos="0 0 0.4" quat="1 0 0 1"><inertial pos="0 0 0.2" mass="1" diaginertia="0.01 0.01 0.002"/>
        <joint name="j2" axis="0 1 0"/><site name="tool"/></body></body></body></worldbody>
  <actuator><general class="arm" name="a1" joint="j1"/><general class="arm" name="a2" joint="j2"/></actuator>
  <keyframe><key name="home" qpos="0.1 0.2"/></keyframe></mujoco>"""
DEFAULTS = """<mujocoinclude><default><default class="arm"><joint armature="0.1" damping="0.5" range="-2 2"/>
  <general gaintype="fixed" biastype="affine" gainprm="100" biasprm="0 -100 -10"/><mesh scale="0.001 0.001 0.001"/>
  <default class="visual"><geom type="mesh" contype="0" conaffinity="0" group="2"/></default>
  <default class="collision"><geom type="mesh" group="3"/></default></default></default></mujocoinclude>"""


@pytest.fixture
def arm(tmp_path):
    """scene.xml, which includes arm.xml, which includes parts/defaults.xml; meshes absent."""
    (tmp_path / "parts").mkdir()
    (tmp_path / "scene.xml").write_text(SCENE)
    (tmp_path / "arm.xml").write_text(ARM)
    (tmp_path / "parts" / "defaults.xml").write_text(DEFAULTS)
    return tmp_path


@pytest.mark.parametrize("name", ["scene.xml", "arm.xml"])
def test_includes_defaults_and_absent_meshes(arm, name):
    robot = ji.load_model(arm / name)
    assert robot.body_names == ("link1", "link2")
    np.testing.assert_allclose(robot.armature, [0.1, 0.1])
    np.testing.assert_allclose(robot.damping, [0.5, 0.5])
    np.testing.assert_allclose(robot.pi[:, 0], [2, 1])


def test_inertials_go_back_into_an_mjcf_of_several_files(arm):
    spec = load_spec(arm / "scene.xml")
    (wanted,) = random_bodies(1, seed=5)
    set_inertials(spec, {"link2": wanted})
    compile_spec(spec)
    again = mujoco.MjModel.from_xml_string(spec.to_xml())
    np.testing.assert_allclose(body_pi(again, again.body("link2").id), wanted, rtol=1e-4, atol=1e-7)
    assert again.key("home").qpos[1] == pytest.approx(0.2)


# --- URDF --------------------------------------------------------------------------------------------------------

URDF = """<?xml version="1.0" ?>\r
<!-- made by hand -- with care; <link name="lower"> in here is none -->\r
<robot name='leg' xmlns:xacro="http://ros.org/wiki/xacro">\r
  <material name="grey"><color rgba="0.5 0.5 0.5 1"/></material>\r
  <link name="base"/>\r
  <link name='upper'>\r
    <visual><geometry><mesh filename="package://legs/meshes/upper.dae" scale="1 1 1"/></geometry></visual>\r
    <inertial>\r
      <origin xyz="0.01 0.02 -0.1" rpy="0.3 -0.2 0.1"/>\r
      <mass value="1.5"/>\r
      <inertia ixx="0.01" ixy="0.001" ixz="0" iyy="0.02" iyz="0" izz="0.025"/>\r
    </inertial>\r
    <collision><geometry><cylinder radius="0.05" length="0.2"/></geometry></collision>\r
  </link>\r
  <link name="schloß"><inertial><mass value="0.2"/>\r
    <inertia ixx="1e-3" ixy="0" ixz="0" iyy="1e-3" iyz="0" izz="1e-3"/></inertial></link>\r
  <link name="lower" >\r
  </link>\r
  <link name="tool"/>\r
  <joint name="hip" type="revolute"><parent link="base"/><child link="upper"/>\r
    <origin xyz="0 0 1"/><axis xyz="0 1 0"/>\r
    <limit lower="-1" upper="1" effort="10" velocity="2"/><dynamics damping="0.3" friction="0.2"/></joint>\r
  <joint name="lock" type="fixed"><parent link="upper"/><child link="schloß"/>\r
    <origin rpy="0 0 0.5" xyz="0.1 0 0"/></joint>\r
  <joint name="knee" type="continuous"><parent link="schloß"/><child link="lower"/><axis xyz="1 0 0"/></joint>\r
  <joint name="wrist" type="prismatic"><parent link="lower"/><child link="tool"/><axis xyz="0 0 1"/>\r
    <limit lower="-1" upper="1" effort="10" velocity="2"/></joint>\r
  <transmission name="t"><type>transmission_interface/SimpleTransmission</type><joint name="hip"/></transmission>\r
  <gazebo reference="upper"><mu1>0.2</mu1></gazebo>\r
</robot>\r
"""
LINKS = ("upper", "schloß", "lower", "tool")


@pytest.fixture
def leg(tmp_path):
    path = tmp_path / "leg.urdf"
    path.write_bytes(URDF.encode())
    return path


@pytest.fixture
def written(leg, tmp_path):
    """π of every link, and the URDF they were written to."""
    wanted = dict(zip(LINKS, random_bodies(4, seed=3), strict=True))
    write_urdf(leg, tmp_path / "out.urdf", wanted)
    return wanted, tmp_path / "out.urdf"


def test_joint_friction_comes_back_in_mujoco_and_the_rest_stays_as_it_was(leg, tmp_path):
    out = tmp_path / "out.urdf"
    own = 'damping="0.3" friction="0.2"'
    leg.write_bytes(URDF.replace(own, own + ' spring_stiffness="7"').encode())
    wanted = {"hip": Dynamics(1.25, 0.5), "knee": Dynamics(0.0, 0.75)}
    write_urdf(leg, out, {}, wanted)
    model = compile_spec(load_spec(out))
    for name, (damping, friction) in wanted.items():
        row = model.joint(name).dofadr[0]
        assert (model.dof_damping[row], model.dof_frictionloss[row]) == (damping, friction)
    # The other joint, and what a simulator of its own reads there.
    assert model.dof_damping[model.joint("wrist").dofadr[0]] == 0.0
    text = out.read_text()
    assert 'spring_stiffness="7"' in text
    assert '<transmission name="t">' in text


@pytest.mark.parametrize(
    ("joint", "value", "message"),
    [
        ("hipp", Dynamics(1.0, 1.0), "did you mean 'hip'"),
        ("hip", Dynamics(-0.1, 1.0), "below zero"),
        ("hip", Dynamics(1.0, np.nan), "finite"),
    ],
)
def test_friction_that_no_joint_has_is_refused(leg, tmp_path, joint, value, message):
    with pytest.raises(ModelError, match=message):
        write_urdf(leg, tmp_path / "out.urdf", {}, {joint: value})
    assert not (tmp_path / "out.urdf").exists()


def test_a_corrected_urdf_has_what_it_can_hold_and_a_line_on_the_rest(leg, tmp_path):
    before = compile_spec(load_spec(leg))
    spec = load_spec(leg)
    hip = spec.joint("hip")
    hip.frictionloss, hip.armature = 0.9, 0.4
    line = write_urdf_as(leg, tmp_path / "out.urdf", before, compile_spec(spec))
    assert line == "a URDF has no place for armature of hip: corrected.xml has them"
    again = compile_spec(load_spec(tmp_path / "out.urdf"))
    row = again.joint("hip").dofadr[0]
    assert (again.dof_damping[row], again.dof_frictionloss[row]) == (0.3, 0.9)


def test_a_urdf_of_a_model_that_changed_in_nothing_is_not_written(leg, tmp_path):
    model = compile_spec(load_spec(leg))
    assert write_urdf_as(leg, tmp_path / "out.urdf", model, model) == ""
    assert not (tmp_path / "out.urdf").exists()


def test_written_inertials_come_back_in_mujoco(written):
    wanted, path = written
    robot = ji.load_model(path)
    assert set(robot.body_names) == set(LINKS)
    for name, pi in wanted.items():
        np.testing.assert_allclose(robot.pi[robot.body_index(name)], pi, rtol=1e-9, atol=1e-12)


def test_written_inertials_come_back_in_pinocchio(written):
    from pinocchio_oracle import pin

    wanted, path = written
    model = pin.buildModelFromUrdf(str(path))

    def about_frame(inertia):
        m, h, i = inertia.mass, inertia.mass * inertia.lever, inertia.inertia
        c = inertia.lever
        i = i + m * (c @ c * np.eye(3) - np.outer(c, c))
        return [m, *h, i[0, 0], i[0, 1], i[0, 2], i[1, 1], i[1, 2], i[2, 2]]

    for joint, link in (("knee", "lower"), ("wrist", "tool")):
        found = about_frame(model.inertias[model.getJointId(joint)])
        np.testing.assert_allclose(found, wanted[link], rtol=1e-9, atol=1e-12)
    # Pinocchio lumps what is bolted together.
    hip = model.inertias[model.getJointId("hip")].mass
    assert hip == pytest.approx(wanted["upper"][0] + wanted["schloß"][0])


def test_all_else_is_copied_byte_for_byte(leg, tmp_path):
    (pi,) = random_bodies(1, seed=1)
    out = tmp_path / "out.urdf"
    write_urdf(leg, out, {})
    assert out.read_bytes() == leg.read_bytes()
    write_urdf(leg, out, {"upper": pi})
    old, new = leg.read_bytes(), out.read_bytes()
    start, end = b"<inertial>", b"</inertial>\r\n    <collision>"
    assert new.split(start)[0] == old.split(start)[0]
    assert new.split(end)[1] == old.split(end)[1]
    assert b"\n" not in new.replace(b"\r\n", b"")
    write_urdf(leg, out, {"lower": pi, "tool": pi})
    rest = [line for line in out.read_bytes().splitlines() if line.strip() and line in old]
    kept = [line for line in old.splitlines() if line.strip() and b'name="tool"/>' not in line]
    assert [line for line in kept if line not in rest] == []


def test_urdf_written_twice_changes_nothing_more(written, tmp_path):
    wanted, path = written
    write_urdf(path, tmp_path / "again.urdf", wanted)
    assert (tmp_path / "again.urdf").read_bytes() == path.read_bytes()


def test_what_cannot_be_written_to_a_urdf(leg, arm, tmp_path):
    (pi,) = random_bodies(1)
    out = tmp_path / "out.urdf"
    with pytest.raises(ModelError, match="no body named 'shin'; the model has: base, upper"):
        write_urdf(leg, out, {"shin": pi})
    with pytest.raises(ModelError, match="not physical"):
        write_urdf(leg, out, {"upper": np.array([1.0, 0, 0, 0, 1, 0, 0, 1, 0, 5])})
    with pytest.raises(ModelError, match="not a URDF"):
        write_urdf(arm / "arm.xml", out, {})
    leg.write_bytes(URDF.encode("utf-16"))
    with pytest.raises(ModelError, match="UTF-16"):
        write_urdf(leg, out, {})
    assert not out.exists()
    assert not is_urdf(arm / "arm.xml")


def test_robots_that_come_with_pinocchio(tmp_path):
    """What its models have besides: a root that floats, mimic joints, meshes of a package, empty links."""
    text = URDF.replace(
        '<link name="base"/>',
        '<link name="world"/><link name="base"/>\r\n<joint name="root" type="floating">'
        '<parent link="world"/><child link="base"/></joint>',
    )
    slide = '<child link="tool"/><axis xyz="0 0 1"/>'
    text = text.replace(slide, slide + '<mimic joint="hip" multiplier="1"/>')
    path = tmp_path / "leg.urdf"
    path.write_bytes(text.encode())
    wanted = dict(zip(("base", *LINKS), random_bodies(5), strict=True))
    write_urdf(path, path, wanted)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ji.ModelWarning)
        robot = ji.load_model(path)
    assert robot.joint_type[0] == "free"
    np.testing.assert_allclose(robot.pi[0], wanted["base"], rtol=1e-9, atol=1e-12)


MENDED = """<robot name="r"><link name="base"/>
  <link name="yaw"/><link name="pitch"><inertial><mass value="0"/>
    <inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/></inertial></link>
  <link name="arm"><inertial><origin xyz="0 0 0.1" rpy="0.4 0.3 0.2"/><mass value="1"/>
    <inertia ixx="0.01" ixy="0.011" ixz="0" iyy="0.01" iyz="0" izz="0.02"/></inertial></link>
  <link name="point"><inertial><mass value="0.1"/>
    <inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/></inertial></link>
  <joint name="j1" type="continuous"><parent link="base"/><child link="yaw"/><axis xyz="0 0 1"/></joint>
  <joint name="j2" type="continuous"><parent link="yaw"/><child link="pitch"/><axis xyz="0 1 0"/></joint>
  <joint name="j3" type="continuous"><parent link="pitch"/><child link="arm"/><axis xyz="1 0 0"/></joint>
  <joint name="bolt" type="fixed"><parent link="arm"/><child link="point"/></joint></robot>"""


def test_a_urdf_with_links_that_mujoco_refuses_is_read_and_said(tmp_path):
    """As in the models that come with Pinocchio, of which 16 in 69 would not load."""
    (tmp_path / "r.urdf").write_text(MENDED)
    with pytest.warns(ji.ModelWarning) as caught:
        robot = ji.load_model(tmp_path / "r.urdf")
    said = "\n".join(str(warning.message) for warning in caught)
    assert "no body has were raised: arm" in said
    assert "no mass were given a nanogram: yaw, pitch" in said
    np.testing.assert_allclose(robot.pi[:, 0], [1e-9, 1e-9, 1, 0.1], rtol=1e-9)
    # Moments −0.001, 0.02 and 0.021, the first of which becomes 0.001: the least with which the others are a body's.
    xx, xy, xz, yy, yz, zz = np.asarray(robot.pi)[2, 4:]
    about = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) - np.diag([0.01, 0.01, 0])
    np.testing.assert_allclose(np.linalg.eigvalsh(about), [0.001, 0.02, 0.021], rtol=1e-6)


def test_an_inertia_that_is_no_bodys_without_being_negative_is_said(tmp_path):
    """Six equal numbers, as feet of some robots have: moments 0, 0 and 3, and none may exceed the sum of the others."""
    moments = MENDED[MENDED.index('<inertia ixx="0.01"') :].split("/>")[0]
    equal = "<inertia " + " ".join(f'i{x}="0.01"' for x in ("xx", "xy", "xz", "yy", "yz", "zz"))
    (tmp_path / "r.urdf").write_text(MENDED.replace(moments, equal))
    with pytest.warns(ji.ModelWarning) as caught:
        ji.load_model(tmp_path / "r.urdf")
    assert "no body has were raised: arm" in "\n".join(str(one.message) for one in caught)


@pytest.mark.parametrize(
    ("old", "new"),
    [('rpy="0.4 0.3 0.2"', 'rpy="1e999 0 0"'), ('ixy="0.011"', 'ixy="1e300"'), ('iyy="0.01"', 'iyy="-1e307"')],
    ids=["angle", "product", "moment"],
)  # fmt: skip
def test_numbers_beyond_any_robot_make_no_remarks_of_numpys(tmp_path, old, new):
    assert old in MENDED
    (tmp_path / "r.urdf").write_text(MENDED.replace(old, new, 1))
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        warnings.simplefilter("ignore", ji.ModelWarning)
        with contextlib.suppress(ji.ModelError):
            ji.load_model(tmp_path / "r.urdf")


BUMPER = """<robot name="r"><link name="base"/>
  <link name="arm"><inertial><origin xyz="0 0 0.1"/><mass value="1"/>
    <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.002"/></inertial></link>
  <link name="bumper"><collision><geometry><sphere radius="0.1"/></geometry></collision></link>
  <joint name="j1" type="continuous"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/></joint>
  <joint name="bolt" type="fixed"><parent link="arm"/><child link="bumper"/><origin xyz="0 0 0.3"/></joint></robot>"""


def test_a_urdf_s_link_without_an_inertial_has_no_mass(tmp_path):
    """MuJoCo would make the bumper a ball of water of 4 kg; a robot that came with Pinocchio weighed 132 kg for 36."""
    from pinocchio_oracle import pin

    (tmp_path / "r.urdf").write_text(BUMPER)
    robot = ji.load_model(tmp_path / "r.urdf")
    other = pin.buildModelFromXML(BUMPER)
    q, v, a = np.array([0.4]), np.array([0.7]), np.array([1.3])
    want = pin.rnea(other, other.createData(), np.array([np.cos(0.4), np.sin(0.4)]), v, a)
    np.testing.assert_allclose(
        inverse_dynamics(robot, *map(jnp.asarray, (q, v, a))), want, rtol=1e-9
    )


def test_a_model_goes_back_in_the_form_that_it_came_in(leg, arm, tmp_path):
    (pi,) = random_bodies(1, seed=8)
    out = tmp_path / "out"
    out.mkdir()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ji.ModelWarning)
        for source, body in ((leg, "upper"), (arm / "scene.xml", "link2")):
            (path,) = write_with_inertials(out, "estimated", source, {body: pi})
            assert path.name == f"estimated{source.suffix}"
            before, after = (compile_spec(load_spec(p)) for p in (source, path))
            changed = changed_inertials(before, after)
            # MuJoCo writes MJCF with fewer digits, so that others may change in the last of them.
            assert np.max(np.abs(changed[body] - pi)) < 1e-4
            assert all(np.max(np.abs(v - body_pi(before, before.body(k).id))) < 1e-4
                       for k, v in changed.items() if k != body)  # fmt: skip
    assert sorted(p.name for p in out.iterdir()) == ["estimated.urdf", "estimated.xml"]


# --- models by name ----------------------------------------------------------------------------------------------


FLAT = """<mujoco><compiler angle="radian"/><worldbody><body name="vane">
  <inertial pos="0.063989 0.022546 -0.014608" mass="2.083078"
    fullinertia="0.003060504572 0.008630326004 0.00934775753 0.002364723186 0.001495245689 0.0005225404235"/>
  <joint name="turn"/></body></worldbody></mujoco>"""


def test_a_flat_body_outlives_the_six_digits_that_mujoco_writes():
    """Its moments keep A + B = C to 2e-12, and break it once they are rounded."""
    spec = mujoco.MjSpec.from_string(FLAT)
    before = spec.compile()
    with pytest.raises(ValueError, match="A \\+ B >= C"):
        mujoco.MjModel.from_xml_string(spec.to_xml())
    after = mujoco.MjModel.from_xml_string(loadable(spec, Path("vane.xml"), Path()))
    assert after.body_inertia[1] == pytest.approx(before.body_inertia[1], rel=3e-5)
    assert body_pi(after, 1) == pytest.approx(body_pi(before, 1), rel=1e-4, abs=1e-7)


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """An empty cache of robot_descriptions, and no description imported before."""
    pytest.importorskip("robot_descriptions")
    monkeypatch.setenv("ROBOT_DESCRIPTIONS_CACHE", str(tmp_path))
    monkeypatch.delitem(sys.modules, "robot_descriptions.panda_mj_description", raising=False)
    monkeypatch.setattr("git.Repo.clone_from", lambda *_, **__: pytest.fail("a download"))
    monkeypatch.setattr("git.Repo.init", lambda *_, **__: pytest.fail("a download"))
    return tmp_path


def test_a_description_that_is_here_loads_by_name(cache, arm):
    folder = cache / "mujoco_menagerie" / "franka_emika_panda"
    (folder / "parts").mkdir(parents=True)
    (folder / "panda.xml").write_text(ARM)
    (folder / "parts" / "defaults.xml").write_text(DEFAULTS)
    robot = ji.load_model("robot_descriptions:panda_mj_description")
    assert robot.joint_names == ("j1", "j2")
    assert ji.load_model(Path("robot_descriptions:panda_mj_description")).nv == 2


def test_a_description_that_is_not_here_is_not_fetched(cache):
    with pytest.raises(
        ModelError, match=r"nothing is fetched unasked; fetch it with: .* pull panda_mj"
    ):
        ji.load_model("robot_descriptions:panda_mj_description")
    with pytest.raises(ModelError, match="no 'panda_mj'; did you mean panda_mj_description"):
        ji.load_model("robot_descriptions:panda_mj")
    assert list(cache.iterdir()) == []


def test_descriptions_without_their_package_are_one_line(monkeypatch):
    monkeypatch.setitem(sys.modules, "robot_descriptions", None)
    with pytest.raises(ModelError, match="pip install robot_descriptions"):
        ji.load_model("robot_descriptions:panda_mj_description")
