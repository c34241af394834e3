"""Effects put into a model: attributes against the effects' own equations, callbacks against theirs, C against MJX."""

import dataclasses

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from mujoco import mjx

import jax_inertia as ji
from jax_inertia.diagnosis.effects.couplings import DEFLECTION
from jax_inertia.diagnosis.effects.identified import Identified, effects_in
from jax_inertia.diagnosis.simulate.corrected import corrected
from jax_inertia.diagnosis.simulate.step_law import Callback, callback, law, mjx_callback

ARM = """
<mujoco><compiler angle="degree"/><option gravity="0 0 -9.81" timestep="0.001"><flag contact="disable"/></option>
<worldbody><body name="upper"><joint name="shoulder" axis="0 1 0" damping="0.3" armature="0.05" ref="10"
 stiffness="1.5" springref="20" range="-170 170"/>
<inertial mass="2" pos="0 0 -0.2" fullinertia="0.02 0.02 0.004 0 0.001 0"/>
<body name="lower" pos="0 0 -0.4"><joint name="elbow" axis="0 1 0.3" damping="0.2" armature="0.03" frictionloss="0.1"/>
<inertial mass="1.2" pos="0.02 0 -0.15" fullinertia="0.01 0.01 0.002 0 0 0.0005"/></body></body></worldbody>
<actuator><motor name="m" joint="elbow" gear="2" ctrlrange="-9 9"/></actuator>
<keyframe><key qpos="0.1 0.2"/></keyframe></mujoco>
"""
Q, V, A = np.array([0.4, -0.9]), np.array([0.7, -1.3]), np.array([2.0, -5.0])


def joint(family: str, **values: float) -> Identified:
    return Identified(family, "joint", "elbow", values)


def body(family: str, **values: float) -> Identified:
    return Identified(family, "body", "lower", values)


def added(*effects: Identified):
    return corrected(mujoco.MjSpec.from_string(ARM), effects)


def torque_of(spec, q=Q, v=V, a=A) -> np.ndarray:
    """What the motion needs, friction and springs included."""
    robot = ji.load_model(spec.compile())
    q, v, a = map(jnp.asarray, (q, v, a))
    needed = ji.inverse_dynamics(robot, q, v, a) - ji.passive_torque(robot, q, v)
    return np.asarray(needed)


# The torque that the effect adds at the elbow in the state above.
ATTRIBUTES = [
    (joint("viscous_friction", damping=0.4), -0.4 * V[1]),
    (joint("coulomb_friction", coulomb=0.6), -0.6 * np.sign(V[1])),
    (joint("asymmetric_coulomb", positive=0.6, negative=0.2), +0.2),
    (joint("armature", armature=0.07), -0.07 * A[1]),
    (joint("joint_spring", stiffness=3.0, rest_angle=0.5), -3.0 * (Q[1] - 0.5)),
    (joint("torque_bias", bias=-0.8), -0.8),
]


@pytest.mark.parametrize(("effect", "torque"), ATTRIBUTES, ids=lambda x: getattr(x, "family", ""))
def test_joint_attributes_are_the_equation(effect, torque):
    correction = added(effect)
    assert correction.in_model == (effect,)
    missing = torque_of(mujoco.MjSpec.from_string(ARM)) - torque_of(correction.spec)
    # A constant torque is a soft spring's, which changes by a thousandth over a radian.
    np.testing.assert_allclose(missing, [0.0, torque], rtol=1e-3, atol=2e-5)


def test_a_spring_joins_the_one_that_is_there():
    effect = Identified("joint_spring", "joint", "shoulder", {"stiffness": 3.0, "rest_angle": 0.5})
    missing = torque_of(mujoco.MjSpec.from_string(ARM)) - torque_of(added(effect).spec)
    np.testing.assert_allclose(missing, [-3.0 * (Q[0] - 0.5), 0.0], atol=1e-9)


@pytest.mark.parametrize("name", ["shoulder", "elbow"])
def test_an_encoder_that_shows_more_than_there_is(name):
    effect = Identified("encoder_offset", "joint", name, {"offset": 0.05})
    shown = Q + 0.05 * (np.array(["shoulder", "elbow"]) == name)
    np.testing.assert_allclose(
        torque_of(added(effect).spec, q=shown), torque_of(mujoco.MjSpec.from_string(ARM)), atol=1e-9
    )


def test_gravity_turns_about_world_axes():
    effect = Identified("gravity_tilt", "global", "global", {"tilt_x": 0.03, "tilt_y": -0.02})
    gravity = added(effect).spec.compile().opt.gravity
    linear = np.array([0, 0, -9.81]) + np.cross([0.03, -0.02, 0.0], [0, 0, -9.81])
    np.testing.assert_allclose(gravity, linear, atol=0.01)
    assert np.linalg.norm(gravity) == pytest.approx(9.81)


def test_payload_is_a_point_on_its_body():
    effect = body("payload", mass=0.4, com_x=0.1, com_y=-0.05, com_z=-0.3)
    by_hand = mujoco.MjSpec.from_string(ARM)
    extra = by_hand.body("lower").add_body(name="load", pos=[0.1, -0.05, -0.3])
    extra.explicitinertial, extra.ipos = True, np.zeros(3)
    extra.mass, extra.inertia = 0.4, np.full(3, 1e-9)
    for key in list(by_hand.keys):
        by_hand.delete(key)
    np.testing.assert_allclose(torque_of(added(effect).spec), torque_of(by_hand), atol=1e-6)


def test_a_payload_of_some_size_brings_a_ball_s_inertia():
    before = mujoco.MjModel.from_xml_string(ARM)
    at = dict(zip(("com_x", "com_y", "com_z"), before.body_ipos[2], strict=True))
    ball = body("payload", mass=2.0, gyration_radius=0.1, **at)
    after = added(ball).spec.compile()
    np.testing.assert_allclose(after.body_mass[2] - before.body_mass[2], 2.0)
    np.testing.assert_allclose(
        np.sort(after.body_inertia[2]), np.sort(before.body_inertia[2]) + 0.02, rtol=1e-9
    )


def test_mass_and_inertia_about_the_centre_stay_where_only_the_centre_moves():
    before = mujoco.MjModel.from_xml_string(ARM)
    shifted = added(body("com_shift", com_shift_x=0.01, com_shift_y=0.0, com_shift_z=-0.02))
    after = shifted.spec.compile()
    np.testing.assert_allclose(after.body_ipos[2] - before.body_ipos[2], [0.01, 0, -0.02])
    np.testing.assert_allclose(np.sort(after.body_inertia[2]), np.sort(before.body_inertia[2]))
    scaled = added(body("link_inertia", inertia_scale=1.7)).spec.compile()
    np.testing.assert_allclose(scaled.body_ipos[2], before.body_ipos[2])
    np.testing.assert_allclose(
        np.sort(scaled.body_inertia[2]), 1.7 * np.sort(before.body_inertia[2]), rtol=1e-9
    )


@pytest.mark.parametrize("play", [0.0, 0.04])
def test_a_held_motor_gives_way_by_the_coupling(play):
    """τ/K, and half the dead zone more."""
    values = {"stiffness": 300.0} | ({"dead_zone": play} if play else {})
    effect = joint("backlash" if play else "joint_elasticity", **values)
    spec = mujoco.MjSpec.from_string(ARM)
    spec.option.gravity = np.zeros(3)
    for name in ("shoulder", "elbow"):
        spec.joint(name).armature, spec.joint(name).stiffness = 1e7, np.zeros(3)
    correction = corrected(spec, [effect])
    model = correction.spec.compile()
    data, row = mujoco.MjData(model), model.joint("elbow" + DEFLECTION).dofadr[0]
    model.dof_damping[row] += 0.3
    data.qfrc_applied[row] = 6.0
    mujoco.mj_step(model, data, nstep=4000)
    assert data.qpos[row] == pytest.approx(6.0 / 300.0 + 0.5 * play, rel=0.01)
    assert any("motor" in note for note in correction.notes)


def test_actuators_are_limited_scaled_and_late():
    effects = (joint("torque_gain", gain=0.9), joint("torque_saturation", limit=5.0))
    model = added(
        *effects, Identified("time_delay", "global", "global", {"delay": 0.004})
    ).spec.compile()
    assert model.actuator_gainprm[0, 0] == pytest.approx(0.9)
    np.testing.assert_allclose(model.jnt_actfrcrange[1], [-5, 5])
    assert model.actuator_delay[0] == pytest.approx(0.004)


def test_what_was_done_is_written_into_the_model():
    correction = added(joint("cogging", amplitude=0.3, frequency=8.0, phase=0.2))
    assert "step_law" in correction.spec.to_xml()
    assert correction.by_callback[0].family == "cogging"
    again = mujoco.MjModel.from_xml_string(correction.spec.to_xml())
    assert again.ntext == 1


def test_names_that_the_model_does_not_have():
    with pytest.raises(ValueError, match="it has: shoulder, elbow"):
        added(Identified("armature", "joint", "knee", {"armature": 0.1}))
    with pytest.raises(ValueError, match="upper, lower"):
        added(Identified("payload", "body", "foot", {"mass": 1.0}))
    with pytest.raises(ValueError, match="no joint 'knee'"):
        law(mujoco.MjModel.from_xml_string(ARM), [Identified("cogging", "joint", "knee", {})])
    with pytest.raises(ValueError, match="no report"):
        effects_in({"verdict": "explained"})


# --- callbacks ---------------------------------------------------------------------------------------------------


def applied(effect: Identified, u=(1.0, 4.0), q=Q, v=V, time=2.0):
    """(torque on the rows, forces on the lower arm, friction) after the callback, from a state."""
    model = mujoco.MjModel.from_xml_string(ARM)
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:], data.time = q, v, time
    mujoco.mj_forward(model, data)
    data.qfrc_applied[:] = u
    callback(model, [effect])(model, data)
    return data.qfrc_applied.copy(), data.xfrc_applied[2].copy(), model.dof_frictionloss.copy()


CALLED = [
    (joint("torque_gain", gain=0.8), 3.2),
    (joint("torque_saturation", limit=2.5), 2.5),
    (joint("cogging", amplitude=0.3, frequency=8.0, phase=0.2), 4 + 0.3 * np.sin(8 * Q[1] + 0.2)),
    (
        joint("friction_drift", damping=0.5, damping_final=0.2, time_constant=4.0),
        4 - 0.3 * np.exp(-0.5) * V[1],
    ),
]


@pytest.mark.parametrize(("effect", "torque"), CALLED, ids=lambda x: getattr(x, "family", ""))
def test_torques_of_the_callback_are_the_equation(effect, torque):
    np.testing.assert_allclose(applied(effect)[0], [1.0, torque], rtol=1e-12)


def test_dry_friction_follows_speed_and_load():
    slow = joint(
        "stribeck_friction", coulomb=0.5, stiction=0.9, stribeck_velocity=0.1, exponent=2.0
    )
    assert applied(slow, v=np.zeros(2))[2][1] == pytest.approx(0.1 + 0.4)
    assert applied(slow, v=np.array([0.0, 0.1]))[2][1] == pytest.approx(0.1 + 0.4 * np.exp(-1))
    load = joint("load_friction", coulomb=0.0, load_coefficient=0.1, of_motor=1.0)
    assert applied(load)[2][1] == pytest.approx(0.1 + 0.1 * 4.0)


@pytest.mark.parametrize("v", [-0.5, 0.5])
def test_what_loads_a_link_is_what_friction_leaves_of_its_motors_torque(v):
    load = joint("load_friction", coulomb=0.0, load_coefficient=0.1, of_motor=0.0)
    friction = applied(load, v=np.array([0.0, v]))[2][1]
    assert friction == pytest.approx(0.1 + 0.1 * abs(4.0 - friction * np.sign(v)))


def test_forces_on_a_body():
    hoist = body("constant_force", force_x=3.0, force_y=0.0, force_z=-2.0)
    np.testing.assert_allclose(applied(hoist)[1], [3, 0, -2, 0, 0, 0])
    push = body(
        "push", force_x=3.0, force_y=0.0, force_z=-2.0, start=1.5, end=2.5, flank=0.5, skew=0.0
    )
    np.testing.assert_allclose(applied(push)[1][:3], [3, 0, -2])
    np.testing.assert_allclose(applied(push, time=3.0)[1], np.zeros(6), atol=1e-12)
    drag = applied(body("drag", coefficient=2.0))[1][:3]
    model = mujoco.MjModel.from_xml_string(ARM)
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = Q, V
    mujoco.mj_forward(model, data)
    jacobian = np.zeros((3, 2))
    mujoco.mj_jacBodyCom(model, data, jacobian, None, 2)
    velocity = jacobian @ V
    np.testing.assert_allclose(drag, -2.0 * np.linalg.norm(velocity) * velocity, rtol=1e-6)


def test_a_force_at_a_point_turns_about_the_centre_of_mass():
    point = np.array([0.05, 0.02, -0.3])
    values = {f"force_{k}": x for k, x in zip("xyz", (3.0, 1.0, -2.0), strict=True)}
    values |= {f"point_{k}": float(x) for k, x in zip("xyz", point, strict=True)}
    wrench = applied(body("constant_force", **values))[1]
    model = mujoco.MjModel.from_xml_string(ARM)
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = Q, V
    mujoco.mj_forward(model, data)
    by_wrench, by_point = np.zeros(2), np.zeros(2)
    mujoco.mj_applyFT(model, data, wrench[:3], wrench[3:], data.xipos[2], 2, by_wrench)
    world = data.xpos[2] + data.xmat[2].reshape(3, 3) @ point
    mujoco.mj_applyFT(model, data, np.array([3.0, 1.0, -2.0]), np.zeros(3), world, 2, by_point)
    np.testing.assert_allclose(by_wrench, by_point, rtol=1e-9)


def test_delay_and_lag_by_their_step_response():
    model = mujoco.MjModel.from_xml_string(ARM)
    late = Callback(law(model, [joint("time_delay", delay=0.0035)]))
    lag = Callback(law(model, [joint("actuator_lag", time_constant=0.01)]))
    for c in (late, lag):
        c.arrives(np.zeros(2))
    steps = np.array([late.arrives(np.ones(2))[1] for _ in range(6)])
    np.testing.assert_allclose(steps, [0, 0, 0, 0.5, 1, 1], atol=1e-9)
    rise = np.array([lag.arrives(np.ones(2))[1] for _ in range(20)])
    np.testing.assert_allclose(rise, 1 - np.exp(-np.arange(1, 21) / 10), rtol=1e-9)
    assert late.arrives(np.ones(2))[0] == 1.0


@pytest.mark.slow
def test_mjx_does_what_c_does():
    effects = [
        joint("torque_gain", gain=0.8),
        joint("torque_saturation", limit=2.5),
        joint("time_delay", delay=0.0035),
        joint("cogging", amplitude=0.3, frequency=8.0, phase=0.2),
        joint("stribeck_friction", coulomb=0.2, stiction=0.5, stribeck_velocity=0.5, exponent=1.0),
        body("drag", coefficient=2.0),
        body(
            "push", force_x=3.0, force_y=0.0, force_z=-2.0, start=0.0, end=0.05, flank=0.5, skew=0.0
        ),
        body(
            "constant_force",
            force_x=1.0,
            force_y=0.0,
            force_z=2.0,
            point_x=0.1,
            point_y=0.0,
            point_z=-0.3,
        ),
        Identified("actuator_lag", "global", "global", {"time_constant": 0.01}),
        Identified("torque_gain", "global", "global", {"gain": 1.1}),
        joint("torque_speed", limit=6.0, no_load_speed=20.0),
        joint("asymmetric_viscous", difference=0.1),
        # Of the attribute in MuJoCo C; MJX does not read it, and there it is the step law's.
        joint("quadratic_viscous", coefficient=0.2),
        Identified(
            "joint_coupling",
            "joint",
            "elbow",
            {"coefficient": 0.2, "friction_of_other_speed": 0.05},
            "shoulder",
        ),
    ]
    model = added(*effects).spec.compile()
    # The model's own actuator has no part in this.
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ACTUATION)
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = Q, V
    mujoco.mj_forward(model, data)
    bare = mujoco.MjModel.from_xml_string(ARM)
    bare.dof_frictionloss[1] += 0.2
    bare.dof_dampingpoly[1, 0] = 0.2
    bare.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ACTUATION)
    start, step = mjx_callback(bare, effects)
    mx, dx = mjx.put_model(bare), mjx.put_data(bare, data)
    torque = lambda k: np.array([2.0, 5.0]) * np.cos(0.05 * k)  # noqa: E731
    dx = dx.replace(qfrc_applied=jnp.asarray(torque(0)))
    memory = start(dx)

    @jax.jit
    def one(dx, memory, u):
        mx_now, now, memory = step(mx, dx.replace(qfrc_applied=u), memory)
        return mjx.step(mx_now, now), memory

    act = callback(bare, effects)
    state = mujoco.MjData(bare)
    state.qpos[:], state.qvel[:] = Q, V
    mujoco.mj_forward(bare, state)
    for k in range(60):
        state.qfrc_applied[:] = torque(k)
        act(bare, state)
        speed = state.qvel[1]
        mujoco.mj_step(bare, state)
        dx, memory = one(dx, memory, jnp.asarray(torque(k)))
    assert np.linalg.norm(state.qpos - Q) > 0.02
    # An attribute's damping is integrated implicitly, a step law's is not.
    np.testing.assert_allclose(np.asarray(dx.qpos), state.qpos, atol=5e-4)
    damped = state.qfrc_applied - [0.0, 0.2 * abs(speed) * speed]
    np.testing.assert_allclose(np.asarray(dx.qfrc_applied), damped, atol=5e-3)


def test_a_report_gives_its_effects_back():
    effect = joint("viscous_friction", damping=0.4)
    entry = {
        "family": effect.family,
        "location": {"kind": "joint", "name": "elbow"},
        "parameters": {"damping": {"value": 0.4, "ci95": [0.3, 0.5], "unit": "N m s/rad"}},
    }
    (back,) = effects_in({"effects": [entry]})
    assert dataclasses.asdict(back) == dataclasses.asdict(effect)
