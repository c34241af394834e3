"""Reading MJCF and URDF: what loads, what is refused with one line, what is warned of by name."""

import itertools
import re
import struct
import xml.etree.ElementTree as ET
from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from models import MODELS

import jax_inertia as ji
from jax_inertia.model.load import ModelError, ModelWarning
from jax_inertia.robots.pendulum import double_pendulum

DATA = Path(__file__).parents[2] / "shared" / "data"
INERTIAL = '<inertial pos="0.01 0.02 0.1" mass="1.5" diaginertia="0.01 0.02 0.025"/>'
ARM = f'<body name="arm"><joint name="hinge" axis="0 1 0"/>{INERTIAL}</body>'


def mjcf(world: str, rest: str = "") -> str:
    return f"<mujoco>{rest}<worldbody>{world}</worldbody></mujoco>"


@pytest.fixture
def load(tmp_path):
    """Load a model from text, by way of a file."""

    def from_text(text: str | bytes, name: str = "robot.xml") -> ji.Robot:
        path = tmp_path / name
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return ji.load_model(path)

    return from_text


def urdf_link(name: str, mesh: str = "", mass: float = 1.5) -> str:
    shape = f'<geometry><mesh filename="{mesh}"/></geometry>'
    looks = f"<visual>{shape}</visual><collision>{shape}</collision>" if mesh else ""
    inertia = 'ixx="0.01" ixy="0.001" ixz="0" iyy="0.02" iyz="0" izz="0.025"'
    inertial = f'<origin xyz="0.01 0.02 0.1"/><mass value="{mass}"/><inertia {inertia}/>'
    return f'<link name="{name}"><inertial>{inertial}</inertial>{looks}</link>'


def urdf(mesh: str) -> str:
    limit = '<limit lower="-1" upper="1" effort="10" velocity="2"/>'
    return f"""<robot name="test"><link name="base"/>
      {urdf_link("upper", mesh)}{urdf_link("flange", mass=0.3)}{urdf_link("lower", mesh)}
      <joint name="j1" type="revolute"><parent link="base"/><child link="upper"/>
        <origin xyz="0 0 0.5"/><axis xyz="0 1 0"/>{limit}<dynamics damping="0.3" friction="0.2"/></joint>
      <joint name="bolt" type="fixed"><parent link="upper"/><child link="flange"/>
        <origin xyz="0.1 0 0.2" rpy="0.3 0 0"/></joint>
      <joint name="j2" type="revolute"><parent link="flange"/><child link="lower"/>
        <origin xyz="0 0 0.1"/><axis xyz="1 0 0"/>{limit}</joint></robot>"""


MESHES = [
    "package://maker/meshes/link.stl",
    "file:///nowhere/link.stl",
    "meshes/link.obj",
    "link.dae",
]


@pytest.mark.parametrize("mesh", MESHES)
def test_urdf_with_absent_meshes(load, mesh):
    robot = load(urdf(mesh), "robot.urdf")
    # The bolted link is a body of its own: its parameters may be what is asked for.
    assert robot.body_names == ("upper", "flange", "lower")
    np.testing.assert_allclose(robot.pi[:, 0], [1.5, 0.3, 1.5])
    np.testing.assert_allclose(robot.pi[0, 5], 0.001 - 1.5 * 0.01 * 0.02, rtol=1e-10)
    np.testing.assert_allclose(robot.damping, [0.3, 0.0])
    np.testing.assert_allclose(robot.frictionloss, [0.2, 0.0])


def real(*parts: str) -> Path:
    path = DATA.joinpath(*parts)
    if not path.is_file():
        pytest.skip(f"{path.name} is not here (shared data)")
    return path


def test_ur10e():
    robot = ji.load_model(real("ur10e_dynamic_calibration", "model_ur10e.urdf"))
    assert (robot.nv, robot.body_names[-1]) == (6, "tool0")
    assert {"wrist_3_link", "ee_link"} <= set(robot.body_names)


def test_identified_kuka_names_the_links_that_no_body_can_be():
    path = real("kuka_lwr4_flobaroid", "reference_kuka_lwr4_identified.urdf")
    broken = []
    for link in ET.parse(path).getroot().iter("link"):
        entry = link.find("inertial/inertia")
        if entry is None or link.get("name") == "lwr_base_link":
            continue
        xx, xy, xz, yy, yz, zz = (
            float(entry.get(k, "nan")) for k in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
        )
        moments = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        if moments[0] + moments[1] < moments[2]:
            broken.append(link.get("name"))
    assert broken
    with pytest.warns(ModelWarning, match=f"balanced by MuJoCo: {', '.join(broken)}$"):
        assert ji.load_model(path).nv == 7


def test_a_urdf_that_mujoco_does_not_read():
    path = real("dfki_double_pendulum", "model_designA_double_pendulum.urdf")
    with pytest.raises(ModelError, match=r"designA_double_pendulum\.urdf: .*line 10") as error:
        ji.load_model(path)
    assert "\n" not in str(error.value)


def tetrahedron() -> bytes:
    corners = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]])
    faces = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]
    body = b"".join(struct.pack("<12fH", 0, 0, 0, *corners[list(f)].ravel(), 0) for f in faces)
    return bytes(80) + struct.pack("<I", len(faces)) + body


def test_meshes_of_an_mjcf(load, tmp_path):
    asset = '<asset><mesh file="part.stl"/></asset>'
    part = '<geom type="mesh" mesh="part"/>'
    moving = mjcf(f'<body name="hand"><joint/>{part}</body>', asset)
    with pytest.raises(
        ModelError,
        match=r"mesh 'part' of body 'hand': its file is absent, and the body has no inertial",
    ):
        load(moving)
    # The same with an inertial, beside a body whose mass comes from a shape that is there.
    ball = '<body name="ball"><joint/><geom size="0.1" density="500"/></body>'
    robot = load(mjcf(f'<body name="hand"><joint/>{part}{INERTIAL}{ball}</body>', asset))
    np.testing.assert_allclose(robot.pi[:, 0], [1.5, 500 * 4 / 3 * np.pi * 1e-3], rtol=1e-6)
    # What is bolted to the world needs no inertia.
    assert load(mjcf(f'<body name="base">{part}{ARM}</body>', asset)).body_names == ("arm",)
    (tmp_path / "part.stl").write_bytes(tetrahedron())
    np.testing.assert_allclose(load(moving).pi[0, 0], 1000 * 1e-3 / 6, rtol=1e-4)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "empty"),
        ('{"qpos": [1, 2]}', "XML"),
        (bytes(range(256)), "XML"),
        ("<mujoco><worldbody>", "XML"),
        ("<svg/>", "svg"),
        ("<mujoco/>", "nothing in it moves"),
        ('<robot name="a"><link name="a"/></robot>', "nothing in it moves"),
        (mjcf('<body name="a"><joint/></body>'), "mass and inertia of moving bodies.*'a'"),
        (mjcf(ARM, '<asset><hfield name="h" size="1 1 1 1" file="no.png"/></asset>'), r"no\.png"),
    ],
)
def test_files_that_are_no_robots(load, tmp_path, text, says):
    with pytest.raises(ModelError, match=rf"robot\.xml: .*{says}") as error:
        load(text)
    assert "\n" not in str(error.value)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("model", "says"),
    [
        (None, "a model is a file or a compiled MjModel, not NoneType"),
        (b"robot.xml", "not bytes"),
        (mujoco.MjSpec(), r"not an MjSpec; give spec\.compile\(\)"),
        (mujoco.MjModel.from_xml_string("<mujoco/>"), "MjModel: nothing in it moves"),
        (f"{mjcf(ARM)}>", r"'<mujoco><worldbody>.{41}' is a model's text, not its file"),
    ],
)
def test_what_is_no_model(model, says):
    with pytest.raises(ModelError, match=says):
        ji.load_model(model)


def test_files_that_are_not_there(tmp_path):
    with pytest.raises(ModelError, match=r"none\.urdf: no such model file"):
        ji.load_model(tmp_path / "none.urdf")
    with pytest.raises(ModelError, match="a folder"):
        ji.load_model(str(tmp_path))


SITES = f"""<site name="s"/><body name="b"><joint name="k" stiffness="1 2" damping="1 0 3"/>
  {INERTIAL}<site name="t" pos="0 0 0.1"/></body>"""
TENDONS = """<tendon>
  <spatial name="cable" stiffness="3"><site site="s"/><site site="t"/></spatial>
  <spatial name="idle"><site site="s"/><site site="t"/></spatial></tendon>"""
EQUALITIES = """<equality><connect name="loop" body1="a" body2="b" anchor="0 0 0"/>
  <weld body1="a" body2="b"/><joint name="off" joint1="k" active="false"/></equality>"""
ACTUATORS = '<actuator><motor name="belt" tendon="idle" armature="0.1"/></actuator>'


def test_what_rigid_bodies_leave_out_is_named(load):
    body = f"""<body name="a"><joint name="ball" type="ball" stiffness="3"/>
      {INERTIAL}{SITES}</body>"""
    rest = f'<option density="1.2"/>{TENDONS}{EQUALITIES}{ACTUATORS}'
    with pytest.warns(ModelWarning) as caught:
        load(mjcf(body, rest))
    lines = sorted(str(w.message).split(":")[0] for w in caught)
    assert lines == [
        "actuator 'belt'",
        "connect equality 'loop'",
        "fluid forces (option density, viscosity) are left out",
        "joint 'ball'",
        "joint 'k'",
        "tendon 'cable'",
        "weld equality 1",
    ]


@pytest.mark.filterwarnings("ignore:flex")
def test_flex_is_refused(load):
    cloth = (
        '<flexcomp name="cloth" type="grid" count="3 3 1" spacing=".1 .1 .1" dim="2" radius=".01"/>'
    )
    with pytest.raises(ModelError, match=r"1 flex element.*deformable"):
        load(mjcf(ARM + cloth))


def test_unphysical_inertia_is_balanced_by_name(load):
    bad = '<inertial pos="0 0 0" mass="1" diaginertia="1 1 3"/>'
    nameless = f'<body name="rim"><joint/>{bad}</body><body><joint/>{bad}</body>'
    with pytest.warns(ModelWarning, match=r"robot\.xml.*balanced by MuJoCo: rim, body_3$"):
        robot = load(mjcf(ARM + nameless))
    assert ji.is_physical(robot.pi).all()


def test_disabled_forces_and_reflected_inertia(load):
    """What the model's flags switch off is off; a rotor behind a gear counts, gear² times."""
    rest = """<option><flag gravity="disable" spring="disable" damper="disable"/></option>
      <actuator><motor joint="hinge" gear="20" armature="1e-3" damping="0.01"/></actuator>"""
    springy = ARM.replace("axis", 'stiffness="3" damping="2" armature="0.2" axis')
    for option in (rest, rest.replace('"disable"', '"enable"')):
        robot = load(mjcf(springy, option))
        model = mujoco.MjModel.from_xml_string(mjcf(springy, option))
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:] = 0.4, 1.3
        mujoco.mj_forward(model, data)
        q, v = jnp.asarray(data.qpos), jnp.asarray(data.qvel)
        mass = np.zeros((1, 1))
        mujoco.mj_fullM(model, data, mass)
        bias = ji.inverse_dynamics(robot, q, v, jnp.zeros(1))
        np.testing.assert_allclose(ji.mass_matrix(robot, q), mass, rtol=1e-12)
        np.testing.assert_allclose(bias, data.qfrc_bias, atol=1e-12)
        np.testing.assert_allclose(ji.passive_torque(robot, q, v), data.qfrc_passive, rtol=1e-12)


@pytest.mark.parametrize(
    "name",
    [
        "three_joints",
        pytest.param("floating_tree", marks=pytest.mark.slow),
        pytest.param("two_trees", marks=pytest.mark.slow),
    ],
)
def test_gravity_compensation_is_mujoco_s(cases, name):
    case, share = cases(name), itertools.cycle((0.7, 1.0, 0.0, -0.2))
    text = re.sub("<body ", lambda m: f'<body gravcomp="{next(share)}" ', MODELS[name])
    model = mujoco.MjModel.from_xml_string(text)
    robot, data = ji.load_model(model), mujoco.MjData(model)
    for q, v, _ in zip(*case.states(3, seed=2), strict=True):
        data.qpos[:], data.qvel[:] = q, v
        mujoco.mj_forward(model, data)
        got = ji.passive_torque(robot, jnp.asarray(q), jnp.asarray(v))
        np.testing.assert_allclose(got, data.qfrc_passive, rtol=0, atol=1e-10)
        assert np.abs(data.qfrc_gravcomp).max() > 0.1


@pytest.mark.parametrize("name", ["three_joints", "floating_tree", "two_trees"])
def test_the_loaded_robot_moves_as_in_mujoco(cases, name):
    """300 steps of 1 ms from M, c and the passive torque against mj_step, both semi-implicit Euler."""
    case = cases(name)
    model, robot = case.model, case.robot
    q, v, _ = (x[0] for x in case.states(1, seed=9))
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = q, v

    @jax.jit
    def acceleration(q, v):
        force = ji.passive_torque(robot, q, v) - ji.inverse_dynamics(robot, q, v, jnp.zeros_like(v))
        return jnp.linalg.solve(ji.mass_matrix(robot, q), force)

    for _ in range(300):
        v = v + model.opt.timestep * np.asarray(acceleration(q, v))
        mujoco.mj_integratePos(model, q, v, model.opt.timestep)
        mujoco.mj_step(model, data)
    np.testing.assert_allclose(q, data.qpos, rtol=0, atol=1e-8)
    np.testing.assert_allclose(v, data.qvel, rtol=0, atol=1e-7)


# --- numbers that are none ---------------------------------------------------------------------------------------

BENT = """<mujoco>OPTION<worldbody><body name="b" BODY><joint name="j" JOINT/><inertial pos="0 0 0" mass="1"
  diaginertia="MOMENT 1 1"/><geom name="g" size="0.1" GEOM/></body></worldbody>
  <actuator><motor name="m" joint="j" MOTOR/></actuator></mujoco>"""


@pytest.mark.parametrize(
    ("where", "text", "words"),
    [
        ("JOINT", 'pos="nan 0 0"', "pos of joint 'j' is nan 0 0"),
        ("JOINT", 'axis="0 nan 1"', "axis of joint 'j'"),
        ("JOINT", 'armature="inf"', "armature of joint 'j' is inf"),
        ("JOINT", 'damping="nan"', "damping of joint 'j'"),
        ("JOINT", 'frictionloss="inf"', "frictionloss of joint 'j'"),
        ("JOINT", 'stiffness="nan"', "stiffness of joint 'j'"),
        ("JOINT", 'ref="nan"', "ref of joint 'j'"),
        ("JOINT", 'springref="-inf"', "springref of joint 'j' is -inf"),
        ("BODY", 'pos="0 nan 0"', "pos of body 'b'"),
        ("BODY", 'quat="nan 0 0 0"', "quat of body 'b'"),
        ("BODY", 'gravcomp="nan"', "gravcomp of body 'b'"),
        ("GEOM", 'pos="inf 0 0"', "pos of geom 'g'"),
        ("MOTOR", 'gear="nan"', "gear of actuator 'm'"),
        ("MOTOR", 'armature="inf"', "armature of actuator 'm'"),
        ("OPTION", '<option gravity="0 0 nan"/>', "gravity of option"),
        ("MOMENT", "inf", "(principal moments of body 'b'|inertia)"),
    ],
)
def test_numbers_that_are_none_are_refused_by_element(
    tmp_path, monkeypatch, capfd, where, text, words
):
    monkeypatch.chdir(tmp_path)
    model = BENT.replace(where, text).replace("MOMENT", "1")
    for other in ("JOINT", "BODY", "GEOM", "MOTOR", "OPTION"):
        model = model.replace(f" {other}", "").replace(other, "")
    (tmp_path / "robot.xml").write_text(model)
    with pytest.raises(ModelError, match=rf"robot\.xml: .*{words}") as caught:
        ji.load_model(tmp_path / "robot.xml")
    assert "\n" not in str(caught.value)
    # Neither on the terminal nor in MuJoCo's own log.
    assert capfd.readouterr() == ("", "")
    assert [p.name for p in tmp_path.iterdir()] == ["robot.xml"]


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("jnt_axis", np.nan, "axis of joint 'elbow'"),
        ("body_quat", 0.0, "orientation of body 'lower'"),
        ("body_mass", 1e200, "inertial parameters of body 'lower'|principal"),
        ("dof_armature", np.inf, "armature of joint 'elbow'"),
    ],
)
def test_a_compiled_model_is_looked_at_too(name, value, words):
    model = double_pendulum()
    getattr(model, name)[-1] = value
    model.body_ipos[-1] *= 1e160 if name == "body_mass" else 1.0
    with pytest.raises(ModelError, match=f"MjModel: {words}"):
        ji.load_model(model)


def test_single_precision_ends_earlier():
    with jax.enable_x64(False):
        model = double_pendulum()
        model.dof_armature[0] = 1e39
        with pytest.raises(
            ModelError, match="armature of joint 'shoulder' cannot be held in float32"
        ):
            ji.load_model(model)
