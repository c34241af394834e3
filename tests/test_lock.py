"""Held joints against MuJoCo C with the same joints still there, at rest where they are held."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import jax_inertia as ji
from jax_inertia.model.lock import locked

ARM = """
<mujoco><compiler angle="radian"/><worldbody>
 <body name="a" pos="0 0 0.3"><joint name="turn" axis="0 0 1"/>
  <inertial mass="3" pos="0.02 0 0.1" diaginertia="0.02 0.03 0.02"/>
  <body name="b" pos="0 0 0.2" euler="0.2 0 0">
   <joint name="lift" axis="0 1 0" pos="0.03 0 0" ref="0.1" damping="0.4" armature="0.05"/>
   <joint name="reach" type="slide" axis="1 0 0.2" stiffness="3" springref="0.1"/>
   <inertial mass="2" pos="0.2 0 0" diaginertia="0.01 0.02 0.02"/>
   <body name="c" pos="0.4 0 0" euler="0 0.5 0"><joint name="bend" axis="0 1 0.3" armature="0.02"/>
    <inertial mass="1" pos="0.1 0 0" diaginertia="0.003 0.004 0.004"/></body></body></body>
</worldbody></mujoco>"""


@pytest.mark.parametrize(
    "held",
    [{"lift": 0.7}, {"reach": -0.2, "bend": 0.4}, {"turn": 1.0}, {"lift": -0.3, "turn": 2.0}],
)
def test_held_joints_against_mujoco(held):
    model = mujoco.MjModel.from_xml_string(ARM)
    robot, data, rng = (
        locked(ji.load_model(model), held),
        mujoco.MjData(model),
        np.random.default_rng(0),
    )
    free = [j for j in range(model.njnt) if model.joint(j).name not in held]
    assert robot.joint_names == tuple(model.joint(j).name for j in free)
    for _ in range(3):
        q, v, a = jnp.asarray(rng.normal(size=(3, len(free))))
        for j in range(model.njnt):
            data.qpos[j] = held.get(model.joint(j).name, 0.0)
        data.qvel[:], data.qacc[:] = 0.0, 0.0
        data.qpos[free], data.qvel[free], data.qacc[free] = q, v, a
        mujoco.mj_inverse(model, data)
        ours = ji.inverse_dynamics(robot, q, v, a) - ji.passive_torque(robot, q, v)
        np.testing.assert_allclose(ours, data.qfrc_inverse[free], rtol=1e-9, atol=1e-9)
        bodies = jax.jit(ji.body_poses)(robot, q)
        np.testing.assert_allclose(bodies[1], data.xpos[1:], atol=1e-12)


def test_what_cannot_be_held():
    robot = ji.load_model(mujoco.MjModel.from_xml_string(ARM))
    for held, word in (
        ({"lfit": 0.0}, "lift"),
        ({"lift": np.nan}, "finite"),
        (dict.fromkeys(robot.joint_names, 0.0), "every joint"),
    ):
        with pytest.raises(ValueError, match=f"^.*{word}.*$"):
            locked(robot, held)


def test_loops_and_driven_joints_are_known():
    more = """<equality><joint name="follows" joint1="lift" joint2="turn" polycoef="0.5 -2 0 0 0"/>
      <connect name="bar" body1="b" body2="c" anchor="0 0 0.1"/></equality></mujoco>"""
    text = ARM.replace("</mujoco>", more)
    with pytest.warns(ji.ModelWarning):
        robot = ji.load_model(mujoco.MjModel.from_xml_string(text))
    assert robot.loops == ("connect 'bar'",)
    (driven,) = robot.driven
    assert driven == ("lift", "turn", -2.0, 0.6)
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    data.qpos[:2] = 0.3, driven.factor * 0.3 + driven.offset
    mujoco.mj_forward(model, data)
    (row,) = np.flatnonzero(data.efc_type[: data.nefc] == mujoco.mjtConstraint.mjCNSTR_EQUALITY)[:1]
    assert abs(data.efc_pos[row]) < 1e-12
    assert locked(robot, {"turn": 0.0}).driven == ()
