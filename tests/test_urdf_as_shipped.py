"""URDFs as robots' makers ship them: what dynamics do not need never decides whether they load."""

import warnings

import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from pinocchio_oracle import pin

import jax_inertia as ji
from jax_inertia.dynamics.rigid_body import inverse_dynamics, mass_matrix
from jax_inertia.model.load import ModelError, ModelWarning, compile_spec, load_spec

BOX = '<geometry><box size="0.1 0.2 0.1"/></geometry>'
STL = b"""solid a
facet normal 0 0 1
outer loop
vertex 0 0 0
vertex 1 0 0
vertex 0 1 0
endloop
endfacet
endsolid a
"""
POINTER = b"version https://git-lfs.github.com/spec/v1\noid sha256:0123456789abcdef\nsize 123456\n"


def inertial(mass: float = 1.0, more: str = "") -> str:
    return (
        f'<inertial><origin xyz="0.02 0 -0.1" rpy="0.2 0 0"/>{more}<mass value="{mass}"/>'
        f'<inertia ixx="0.02" ixy="0.001" ixz="0" iyy="0.03" iyz="0" izz="0.025"/></inertial>'
    )


def urdf(arm: str = "", joint: str = "", rest: str = "", base: str = "") -> str:
    """Two hinges; `arm` stands in the second link, `joint` in its joint, `rest` in the robot, `base` in the root."""
    return f"""<robot name="r">
 <link name="base">{base}</link>
 <link name="upper">{inertial(2.0)}</link>
 <link name="arm">{inertial()}{arm}</link>
 <joint name="hip" type="revolute"><parent link="base"/><child link="upper"/><origin xyz="0 0 1"/>
  <axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="9" velocity="9"/></joint>
 <joint name="knee" type="continuous"><parent link="upper"/><child link="arm"/>
  <origin xyz="0 0.1 -0.3" rpy="0.3 0 0"/>{joint}<axis xyz="1 0 0"/></joint>
 {rest}</robot>"""


def mesh(name: str) -> str:
    return f'<collision><geometry><mesh filename="{name}"/></geometry></collision>'


UNSEEN = {
    "no size": urdf('<collision><geometry><sphere radius="0"/></geometry></collision>'),
    "no height": urdf('<collision><geometry><box size="0.1 0 0.1"/></geometry></collision>'),
    "an ASCII STL": urdf(mesh("text.stl")),
    "a pointer to an STL": urdf(mesh("pointer.stl")),
    "a .dae": urdf(mesh("shape.dae")),
    "an absent mesh": urdf(mesh("absent.stl")),
    "an absent mesh without inertial": urdf(
        rest=f'<link name="logo">{mesh("absent.stl")}</link><joint name="l" type="fixed"><parent link="arm"/>'
        '<child link="logo"/></joint>'
    ),
    "two materials": urdf(f'<visual>{BOX}<material name="a"/><material name="b"/></visual>'),
    "a colour of five numbers": urdf(
        rest='<material name="a"><color rgba="1 1 1 1 1"/></material>'
    ),
    "a picture": urdf(
        rest='<material name="a"><texture filename="absent.png"/></material>',
        arm=f"<visual>{BOX}</visual>",
    ),
    "two shapes": urdf(
        '<collision><geometry><box size="1 1 1"/><sphere radius="1"/></geometry></collision>'
    ),
    "two shapes of one name": urdf(f'<collision name="a">{BOX}</collision>' * 2),
    "two places of a shape": urdf(
        f'<collision><origin xyz="0 0 1"/><origin xyz="0 0 2"/>{BOX}</collision>'
    ),
    "two places of a joint": urdf(joint='<origin xyz="9 9 9"/>'),
    "two inertials": urdf(inertial(7.0)),
    "two places of an inertial": urdf().replace(
        '<mass value="1.0"/>', '<origin xyz="1 1 1"/><mass value="1.0"/>'
    ),
}


def loaded(tmp_path, text: str) -> tuple[ji.Robot, list[str]]:
    path = tmp_path / "robot.urdf"
    path.write_text(text)
    (tmp_path / "text.stl").write_bytes(STL)
    (tmp_path / "pointer.stl").write_bytes(POINTER)
    (tmp_path / "shape.dae").write_text("<COLLADA/>")
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        robot = ji.load_model(path)
    assert all(w.category is ModelWarning for w in told)
    return robot, [str(w.message) for w in told]


@pytest.mark.parametrize("what", UNSEEN)
def test_dynamics_are_pinocchios_whatever_is_seen(tmp_path, what, capfd):
    robot, _ = loaded(tmp_path, UNSEEN[what])
    model = pin.buildModelFromXML(UNSEEN[what])
    data, q, v, a = model.createData(), *np.random.default_rng(1).normal(size=(3, 2))
    # urdfdom tells on the standard error of what it does not like; MuJoCo must not on the standard output.
    assert capfd.readouterr().out == ""
    q_pin = np.array([q[0], np.cos(q[1]), np.sin(q[1])])
    ours = inverse_dynamics(robot, *map(jnp.asarray, (q, v, a)))
    np.testing.assert_allclose(ours, pin.rnea(model, data, q_pin, v, a), rtol=1e-9)
    upper = np.triu(pin.crba(model, data, q_pin))
    np.testing.assert_allclose(
        mass_matrix(robot, jnp.asarray(q)), upper + np.triu(upper, 1).T, rtol=1e-9, atol=1e-12
    )


@pytest.mark.parametrize(
    ("what", "said"),
    [
        ("no size", "a shape of arm (size 0 must be positive in geom)"),
        ("an ASCII STL", "mesh 'text' of arm (stl_decoder"),
        (
            "a pointer to an STL",
            "mesh 'pointer' of arm (stl_decoder: invalid header in STL file 'pointer.stl')",
        ),
        ("a .dae", "mesh 'shape' of arm (no decoder found"),
        ("two places of a joint", "the first is read: origin of joint 'knee'"),
        ("two inertials", "the first is read: inertial of link 'arm'"),
    ],
)
def test_what_was_left_out_is_told_by_the_links_name(tmp_path, what, said):
    _, (told,) = loaded(tmp_path, UNSEEN[what])
    assert said in told
    assert told.startswith(f"{tmp_path / 'robot.urdf'}: ")


def test_what_is_refused_is_refused_by_the_links_name(tmp_path):
    """A mass that only a shape could tell; a number that is none."""
    bare = urdf(mesh("shape.dae")).replace(inertial(), "").replace(inertial(2.0), "")
    with pytest.raises(
        ModelError, match=r"mesh 'shape' of body 'arm': no decoder found .* no inertial"
    ):
        loaded(tmp_path, bare)
    for broken, part in (('rpy="0.3, 0 0"', "joint 'knee'"), ('rpy="0.3 0"', "joint 'knee'")):
        with pytest.raises(ModelError, match=f"rpy.*{part}"):
            loaded(tmp_path, urdf().replace('rpy="0.3 0 0"', broken))


def test_a_link_with_a_mass_and_no_inertia_is_a_point(tmp_path):
    tip = '<link name="tip"><inertial><mass value="0.5"/></inertial></link>'
    hung = '<joint name="f" type="fixed"><parent link="arm"/><child link="tip"/><origin xyz="0 0 -0.4"/></joint>'
    robot, (told,) = loaded(tmp_path, urdf(rest=tip + hung))
    assert "point mass: link 'tip'" in told
    np.testing.assert_allclose(robot.pi[robot.body_index("tip")], [0.5] + [0] * 9, atol=1e-9)


FLOATS = """<robot name="r"><link name="base"><inertial><mass value="5"/>
 <inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>
 <link name="mast"/><link name="trunk">{trunk}</link><link name="leg">{leg}</link>
 <joint name="up" type="fixed"><parent link="base"/><child link="mast"/><origin xyz="0 0 1" rpy="0.4 -0.3 0.9"/></joint>
 <joint name="free" type="floating"><parent link="mast"/><child link="trunk"/><origin xyz="0.1 0.2 0.3" rpy="1 0.2 -2"/>
 </joint>
 <joint name="knee" type="revolute"><parent link="trunk"/><child link="leg"/><origin xyz="0 0 -0.2"/>
 <axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="9" velocity="9"/></joint></robot>"""


def test_a_joint_that_floats_below_a_base_floats(tmp_path):
    """At the place where the links that are fixed hold it; what is fixed does not count."""
    text = FLOATS.format(trunk=inertial(9.0), leg=inertial(1.0))
    robot, told = loaded(tmp_path, text)
    assert (robot.nv, robot.has_free_base, told) == (7, True, [])
    assert robot.body_names == ("trunk", "leg")
    model = pin.buildModelFromXML(text)
    data = model.createData()
    pin.framesForwardKinematics(model, data, pin.neutral(model))
    place = data.oMf[model.getFrameId("trunk")]
    start = compile_spec(load_spec(tmp_path / "robot.urdf")).qpos0
    np.testing.assert_allclose(start[:3], place.translation, atol=1e-9)
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, start[3:7])
    np.testing.assert_allclose(turn.reshape(3, 3), place.rotation, atol=1e-9)
    # Along the world's axes both engines have the same coordinates.
    q = np.array([0, 0, 0, 1.0, 0, 0, 0, 0.6])
    q_pin = pin.neutral(model)
    q_pin[:7] = pin.SE3ToXYZQUAT((model.jointPlacements[1]).inverse())
    q_pin[7] = 0.6
    upper = np.triu(pin.crba(model, data, q_pin))
    np.testing.assert_allclose(
        mass_matrix(robot, jnp.asarray(q)), upper + np.triu(upper, 1).T, rtol=1e-9, atol=1e-12
    )


def test_what_floats_below_a_link_that_moves_is_refused_by_name(tmp_path):
    text = FLOATS.format(trunk=inertial(9.0), leg=inertial(1.0)).replace(
        'type="fixed"', 'type="continuous"'
    )
    text = text.replace('<link name="mast"/>', f'<link name="mast">{inertial()}</link>')
    with pytest.raises(ModelError, match=r"free joint can only be used on top level.*'trunk'"):
        loaded(tmp_path, text)
