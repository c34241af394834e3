"""The humanoid's model against its figures, in MuJoCo C and MJX; the test robots themselves."""

import json
from dataclasses import replace
from pathlib import Path

import jax
import mujoco
import numpy as np
import pytest
from conftest import FAST
from models import MODELS
from mujoco import mjx

from jax_inertia.robots import (
    CORNERS,
    Armature,
    HumanoidOptions,
    Terrain,
    home_pose,
    humanoid_mjcf,
)
from jax_inertia.robots.nadia_figures import (
    DAMPING,
    DEVIATIONS,
    JOINTS,
    LINKS,
    SOLE_HALF_WIDTH,
    SOLE_X,
    Link,
    effort_limit,
    links,
    mirrored,
)

SOURCE = Path(__file__).parents[2] / "shared" / "robots" / "nadia.json"
# Pairs that the source gives as mirror images of one another, and the one that the model mends.
SYMMETRIC = ("hip_yaw_link", "hip_roll_link", "thigh_link", "ankle_link", "shoulder_roll_link")
TOTAL_MASS = 90.89764  # kg, the sum of the published masses
TERRAINS = pytest.mark.parametrize("terrain", list(Terrain), ids=lambda t: t.name)


def model_of(options: HumanoidOptions) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(humanoid_mjcf(options))


def at_home(model: mujoco.MjModel) -> mujoco.MjData:
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("home").id)
    mujoco.mj_forward(model, data)
    return data


def hold_and_step(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """One step under a PD law of every joint towards the home pose."""
    stiffness = 8 * model.actuator_ctrlrange[:, 1]  # N m/rad
    error = model.key("home").qpos[7:] - data.qpos[7:] - 0.02 * data.qvel[6:]
    data.ctrl = stiffness * error
    mujoco.mj_step(model, data)


def matrix(inertia) -> np.ndarray:
    ixx, ixy, ixz, iyy, iyz, izz = inertia
    return np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]])


def is_physical(mass: float, about_com: np.ndarray) -> bool:
    """Whether the pseudo-inertia is positive definite.

    About the centre of mass it is diag(Σ, m) with Σ = tr(I)/2 1 − I, and moving the origin is a
    congruence, which keeps the signs of the eigenvalues.
    """
    second_moment = 0.5 * np.trace(about_com) * np.eye(3) - about_com
    return mass > 0 and bool(np.linalg.eigvalsh(second_moment).min() > 0)


def compiled_inertia(model: mujoco.MjModel, body: int) -> np.ndarray:
    """Inertia about the centre of mass in the body's axes, from MuJoCo's principal form."""
    rotation = np.empty(9)
    mujoco.mju_quat2Mat(rotation, model.body_iquat[body])
    rotation = rotation.reshape(3, 3)
    return rotation @ np.diag(model.body_inertia[body]) @ rotation.T


def test_the_tables_carry_the_source_as_published():
    if not SOURCE.exists():
        pytest.skip(f"the published figures are not beside this checkout ({SOURCE.name})")
    source = json.loads(SOURCE.read_text())
    assert set(source["links"]) == set(LINKS)
    assert set(source["joints"]) == set(JOINTS)
    for name, link in source["links"].items():
        published = Link(
            link["mass"], tuple(link["com"]), tuple(link["inertia_about_com"].values())
        )
        assert list(link["inertia_about_com"]) == ["ixx", "ixy", "ixz", "iyy", "iyz", "izz"]
        assert LINKS[name] == published
        assert link["com_rpy"] == [0, 0, 0]
    for name, joint in source["joints"].items():
        ours = JOINTS[name]
        assert (ours.parent, ours.child) == (joint["parent"], joint["child"])
        assert [*ours.pos, *ours.rpy, *ours.axis, *ours.range, ours.effort] == [
            *joint["xyz"],
            *joint["rpy"],
            *joint["axis"],
            *joint["range"],
            joint["effort_limit"],
        ]
        assert joint["damping"] == DAMPING
    sole = source["foot_sole"]
    assert (sole["x_min"], sole["x_max"]) == SOLE_X
    assert sole["width"] == 2 * SOLE_HALF_WIDTH


def test_deviations_name_every_difference_from_the_source():
    used = links()
    changed = {name for name in LINKS if used[name] != LINKS[name]}
    changed |= {name for name in JOINTS if effort_limit(name) != JOINTS[name].effort}
    assert {deviation.item for deviation in DEVIATIONS} == changed
    assert all(effort_limit(name) < 400 for name in JOINTS)  # N m: no placeholder is left


def test_only_the_mended_link_was_not_physical():
    bad = {name for name, link in LINKS.items() if not is_physical(link.mass, matrix(link.inertia))}
    assert bad == {"right_shoulder_roll_link"}


@TERRAINS
def test_compiles_in_both_simulators(terrain):
    model = model_of(HumanoidOptions(terrain=terrain, load_cells=True, corner_forces=True))
    assert (model.nq, model.nv, model.nu) == (30, 29, 23)
    assert model.body_mass.sum() == pytest.approx(TOTAL_MASS, abs=1e-9)
    assert model.joint(0).name == "floating_base"
    assert {model.joint(i).name for i in range(1, model.njnt)} == set(JOINTS)
    assert model.nmocap == (len(CORNERS) if terrain is Terrain.CORNER_PLANES else 0)
    for mocap, corner in enumerate(CORNERS):
        if terrain is Terrain.CORNER_PLANES:
            assert model.body(f"terrain_{corner.name}").mocapid == mocap
    for name in JOINTS:
        motor = model.actuator(name)
        assert model.joint(motor.trnid[0]).name == name
        assert motor.ctrlrange[1] == effort_limit(name) == -motor.ctrlrange[0]
    on_device = mjx.put_model(model)
    assert (on_device.nq, on_device.nv) == (30, 29)
    # MJX keeps a place for every possible contact: the eight corners and no others.
    assert mjx.make_data(on_device)._impl.contact.dist.shape == (len(CORNERS),)


@pytest.mark.parametrize("visual", [True, False])
def test_bodies_have_the_figures_inertia(visual):
    model = model_of(HumanoidOptions(visual=visual))
    for name, link in links().items():
        body = model.body(name)
        assert body.mass[0] == link.mass
        np.testing.assert_allclose(body.ipos, link.com, atol=1e-15)
        inertia = compiled_inertia(model, body.id)
        np.testing.assert_allclose(inertia, matrix(link.inertia), atol=1e-12)
        assert is_physical(body.mass[0], inertia)


def test_right_side_mirrors_the_left_where_the_source_does():
    used = links()
    for name in SYMMETRIC:
        assert used[f"right_{name}"] == mirrored(used[f"left_{name}"])
    left, right = mirrored(used["left_shin_link"]), used["right_shin_link"]
    np.testing.assert_allclose(right.com, left.com, atol=1e-3)
    np.testing.assert_allclose(right.inertia, left.inertia, atol=1e-4)
    for name, joint in JOINTS.items():
        if name.startswith("left_"):
            twin = JOINTS[name.replace("left_", "right_")]
            np.testing.assert_array_equal(twin.pos, np.array(joint.pos) * (1, -1, 1))
            np.testing.assert_array_equal(twin.rpy, np.array(joint.rpy) * (-1, 1, -1))
            assert twin.axis == joint.axis


def test_home_stands_on_the_ground_between_the_limits():
    model = model_of(HumanoidOptions())
    data = at_home(model)
    for corner in CORNERS:
        lowest = data.geom(corner.name).xpos[2] - model.geom(corner.name).size[0]
        assert lowest == pytest.approx(0, abs=1e-12)
        foot = data.body(corner.link)
        point = foot.xpos + foot.xmat.reshape(3, 3) @ corner.pos
        np.testing.assert_allclose(point[:2], data.geom(corner.name).xpos[:2], atol=1e-12)
    for name, angle in home_pose().items():
        assert data.joint(name).qpos[0] == angle
        assert JOINTS[name].range[0] < angle < JOINTS[name].range[1] or angle == 0
    centre = np.mean([data.site(f"{side}_sole").xpos for side in ("left", "right")], axis=0)
    com = data.subtree_com[model.body("pelvis_link").id]
    np.testing.assert_allclose(com[:2], centre[:2], atol=0.01)


@TERRAINS
def test_stands_for_a_second_and_the_ground_carries_its_weight(terrain):
    model = model_of(HumanoidOptions(terrain=terrain, load_cells=True, corner_forces=True))
    data = at_home(model)
    ground = 0.0
    if terrain is Terrain.CORNER_PLANES:
        ground = -0.01  # m: the ground goes away from under the soles, and they must follow
        data.mocap_pos[:, 2] = ground
    height = data.qpos[2]
    while data.time < 1.0:
        hold_and_step(model, data)
    mujoco.mj_forward(model, data)
    assert data.qpos[2] == pytest.approx(height + ground, abs=0.01)  # m
    assert data.body("torso_link").xmat[8] > 0.99  # upright
    for corner in CORNERS:
        lowest = data.geom(corner.name).xpos[2] - model.geom(corner.name).size[0]
        assert lowest == pytest.approx(ground, abs=1e-3)

    weight = -model.opt.gravity[2] * model.body_mass.sum()
    force = np.zeros(6)
    total = 0.0
    assert data.ncon == len(CORNERS)
    for contact in range(data.ncon):
        mujoco.mj_contactForce(model, data, contact, force)
        total += force[0]
    assert total == pytest.approx(weight, rel=0.01)
    corners = sum(data.sensor(f"{corner.name}_force").data[0] for corner in CORNERS)
    assert corners == pytest.approx(total, rel=1e-9)
    cells = sum(data.sensor(f"{side}_foot_force").data[2] for side in ("left", "right"))
    feet = -model.opt.gravity[2] * sum(LINKS[f"{s}_foot_link"].mass for s in ("left", "right"))
    assert cells == pytest.approx(-(total - feet), rel=0.01)


@pytest.mark.slow
def test_mjx_finds_the_same_accelerations_and_contact_forces():
    """With the solver run to its end on uneven ground: what is left is the model, and it is one."""
    model = model_of(
        HumanoidOptions(
            terrain=Terrain.CORNER_PLANES,
            solver_iterations=100,
            line_search_iterations=50,
            corner_forces=True,
            visual=False,
        )
    )
    model.opt.tolerance = 0
    data = at_home(model)
    data.mocap_pos[:, 2] = np.array([1, 3, 2, 1, -1, 2, 1, 3]) * 1e-3  # m
    on_device = mjx.put_model(model)
    forward = jax.jit(mjx.forward, compiler_options=FAST)
    for _ in range(4):
        for _ in range(5):
            hold_and_step(model, data)
        theirs = forward(on_device, mjx.put_data(model, data))
        mujoco.mj_forward(model, data)
        assert data.ncon > 0
        np.testing.assert_allclose(theirs.qacc, data.qacc, atol=1e-6)  # of some 100 rad/s²
        np.testing.assert_allclose(theirs.sensordata, data.sensordata, atol=1e-6)  # N


def test_each_corner_plane_moves_its_own_corner():
    model = model_of(HumanoidOptions(terrain=Terrain.CORNER_PLANES, visual=False))
    data = at_home(model)
    for mocap, corner in enumerate(CORNERS):
        data.mocap_pos[:, 2] = -0.05
        data.mocap_pos[mocap, 2] = 0.002
        mujoco.mj_forward(model, data)
        assert data.ncon == 1
        assert model.geom(data.contact[0].geom[1]).name == corner.name
        assert data.contact[0].dist == pytest.approx(-0.002, abs=1e-9)


@pytest.mark.parametrize(
    ("change", "name"),
    [
        ({"timestep": 0.0}, "timestep"),
        ({"timestep": 0.004}, "solref"),
        ({"friction": -0.1}, "friction"),
        ({"corner_radius": 0.2}, "corner_radius"),
        ({"solver_iterations": 0}, "solver_iterations"),
        ({"line_search_iterations": 0}, "line_search_iterations"),
        ({"armature": Armature(arm=-0.01)}, "armature"),
    ],
)
def test_options_out_of_range_are_refused(change, name):
    with pytest.raises(ValueError, match=f"HumanoidOptions: {name} is"):
        replace(HumanoidOptions(), **change)


def test_options_reach_the_model():
    armature = Armature(leg=0.11, spine=0.07, arm=0.013)
    model = model_of(HumanoidOptions(timestep=0.002, friction=0.5, armature=armature))
    assert model.opt.timestep == 0.002
    np.testing.assert_array_equal(model.pair_friction[:, :2], 0.5)
    expected = {"left_knee_y": 0.11, "spine_x": 0.07, "right_elbow_y": 0.013}
    for name, value in expected.items():
        assert model.dof_armature[model.joint(name).dofadr[0]] == value


@pytest.mark.parametrize("name", MODELS)
def test_hard_models_are_sound(name):
    model = mujoco.MjModel.from_xml_string(MODELS[name])
    assert model.ngeom == 0
    for body in range(1, model.nbody):
        assert is_physical(model.body_mass[body], compiled_inertia(model, body))
    assert mjx.put_model(model).nv == model.nv
