"""A load as drivers take it: against MuJoCo's own inertia of a box, and the angles that KUKA states."""

import re

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jax_inertia.control.payload import Frame, Payload, frame_of

MODEL = """
<mujoco><worldbody><body name="wrist" pos="0.3 0.1 0.5" euler="10 20 30"><joint name="j" axis="0 0 1"/>
<inertial mass="1e-9" pos="0 0 0" diaginertia="1e-12 1e-12 1e-12"/>
<body name="hand" pos="0.05 0 0.1" euler="0 0 45"><site name="flange" pos="0.01 0.02 0.03" euler="90 0 15"/>
<body name="box" pos="0.02 -0.04 0.06" euler="25 -35 50">
<geom type="box" size="0.05 0.03 0.02" mass="2"/></body>
<body name="finger"><joint name="f" axis="1 0 0"/><geom size="0.01" mass="0.01"/></body>
</body></body></worldbody></mujoco>
"""


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    out = tmp_path_factory.mktemp("payload") / "model.xml"
    out.write_text(MODEL)
    return out


def of_box(model: mujoco.MjModel, frame: str) -> tuple[np.ndarray, np.ndarray]:
    """Centre of the box in a site's frame, and its inertia along the site's axes, by MuJoCo."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    box, site = model.body("box").id, model.site(frame).id
    turn = data.site_xmat[site].reshape(3, 3)
    axes = turn.T @ data.ximat[box].reshape(3, 3)
    inertia = axes @ np.diag(model.body_inertia[box]) @ axes.T
    return turn.T @ (data.xipos[box] - data.site_xpos[site]), inertia


def in_wrist(model: mujoco.MjModel) -> np.ndarray:
    """π of the box about the wrist's frame."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    box, wrist = model.body("box").id, model.body("wrist").id
    turn = data.xmat[wrist].reshape(3, 3).T @ data.xmat[box].reshape(3, 3)
    mass = model.body_mass[box]
    centre = data.xmat[wrist].reshape(3, 3).T @ (data.xipos[box] - data.xpos[wrist])
    about = (
        turn
        @ np.diag(2.0 / 3.0 * np.array([0.03**2 + 0.02**2, 0.05**2 + 0.02**2, 0.05**2 + 0.03**2]))
        @ turn.T
    )
    whole = about + mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    return np.array([mass, *(mass * centre), *whole[np.triu_indices(3)]])


def test_a_box_at_a_flange_is_as_mujoco_has_it(file):
    model = mujoco.MjModel.from_xml_string(MODEL)
    load = Payload.of(in_wrist(model), frame_of(file, "flange", "wrist"))
    centre, inertia = of_box(model, "flange")
    assert load.mass == pytest.approx(2.0)
    np.testing.assert_allclose(load.centre, centre, atol=1e-12)
    np.testing.assert_allclose(load.inertia, inertia, atol=1e-12)
    assert load.physical
    numbers = [float(x) for x in re.findall(r"-?\d[\d.]*(?:e-?\d+)?", load.line("ur"))]
    six = [inertia[k] for k in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
    np.testing.assert_allclose(numbers, [2.0, *centre, *six], rtol=1e-3)
    numbers = [float(x) for x in re.findall(r"-?\d[\d.]*(?:e-?\d+)?", load.line("franka"))]
    np.testing.assert_allclose(numbers, [2.0, *centre, *inertia.ravel()], rtol=1e-3)


def test_kuka_s_angles_turn_to_the_principal_axes(file):
    """A about z, B about y of what that gives, C about x of that (KUKA, technical data of payloads)."""
    model = mujoco.MjModel.from_xml_string(MODEL)
    load = Payload.of(in_wrist(model), frame_of(file, "flange", "wrist"))
    assert load.physical
    n = {
        k: float(x)
        for k, x in re.findall(
            r"([MXYZABC]) (-?\d[\d.]*(?:e-?\d+)?)", load.line("kuka").split("J ")[0]
        )
    }
    moments = [
        float(x)
        for x in re.findall(r"[XYZ] (-?\d[\d.]*(?:e-?\d+)?)", load.line("kuka").split("J ")[1])
    ]
    about = lambda axis, angle: Rotation.from_euler(axis, angle, degrees=True).as_matrix()  # noqa: E731
    turn = about("z", n["A"]) @ about("y", n["B"]) @ about("x", n["C"])
    np.testing.assert_allclose(turn @ np.diag(moments) @ turn.T, load.inertia, atol=1e-6)
    np.testing.assert_allclose([n["X"], n["Y"], n["Z"]], 1e3 * load.centre, rtol=1e-3)


def test_a_load_that_is_no_body_has_mass_and_centre_alone():
    load = Payload.of(np.array([1.0, 0.1, 0.0, 0.0, -0.01, 0.0, 0.0, 0.01, 0.0, 0.01]))
    assert not load.physical
    assert load.line("ur") == "set_target_payload(1, [0.1, 0, 0], [0, 0, 0, 0, 0, 0])"
    assert (
        load.line("kuka")
        == "LOAD_DATA[1] = {M 1, CM {X 100, Y 0, Z 0, A 0, B 0, C 0}, J {X 0, Y 0, Z 0}}"
    )
    with pytest.raises(ValueError, match="none"):
        Payload.of(np.array([-0.1, *np.zeros(9)]))
    with pytest.raises(ValueError, match="abb"):
        load.line("abb")


def test_a_frame_has_to_be_fixed_to_the_body(file):
    own = frame_of(file, "wrist", "wrist")
    np.testing.assert_allclose(own.rotation, np.eye(3), atol=1e-12)
    assert isinstance(own, Frame)
    with pytest.raises(ValueError, match="a joint lies between"):
        frame_of(file, "finger", "wrist")
    with pytest.raises(ValueError, match="flange"):
        frame_of(file, "flang", "wrist")
