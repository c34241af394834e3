"""The whole-body controller: what it returns obeys the equation of motion, limits and friction, and is optimal."""

import equinox as eqx
import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from conftest import FAST, case_of

from jax_inertia.control.terms import terms
from jax_inertia.control.whole_body import Reference, make_whole_body
from jax_inertia.dynamics.rigid_body import body_jacobian, inverse_dynamics
from jax_inertia.robots import CORNERS

NAMES = {
    "pelvis": "pelvis_link",
    "torso": "torso_link",
    "feet": ("left_foot_link", "right_foot_link"),
}
POINTS = np.array([c.pos for c in CORNERS]).reshape(2, 4, 3)


@pytest.fixture(scope="module")
def humanoid():
    return case_of("humanoid")


@pytest.fixture(scope="module")
def controller(humanoid):
    arm = [j for j in humanoid.robot.joint_names if "shoulder" in j or "elbow" in j]
    return make_whole_body(
        humanoid.robot,
        **NAMES,
        points=POINTS,
        friction=0.6,
        torque_limit=humanoid.model.actuator_ctrlrange[:, 1],
        arm_joints=arm,
        iterations=15,
    )


def states(humanoid, count: int = 4) -> tuple[np.ndarray, np.ndarray]:
    """Near the home pose, moving a little."""
    rng = np.random.default_rng(3)
    q = np.tile(humanoid.model.key_qpos[0], (count, 1))
    q[:, 7:] += 0.05 * rng.normal(size=(count, 23))
    return q, 0.1 * rng.normal(size=(count, 29))


def reference(q: np.ndarray, push: float, contact: np.ndarray) -> Reference:
    return Reference(
        com_acceleration=jnp.array([push, 0.3]),
        height=jnp.array([q[2] + 0.01, 0.0, 0.2]),
        heading=jnp.array(0.05),
        foot=jnp.zeros((2, 3, 3)),
        foot_heading=jnp.zeros(2),
        contact=jnp.asarray(contact),
        stance=jnp.ones(2),
        posture=jnp.stack([jnp.asarray(q[7:]), jnp.zeros(23), jnp.zeros(23)]),
    )


@pytest.fixture(scope="module")
def tick(humanoid, controller):
    def one(robot, q, v, want):
        now = controller.terms(robot, q, v)
        command = controller.command(now, q, v, want)
        expected = inverse_dynamics(robot, q, v, command.acceleration) + robot.damping * v
        return command, now, expected

    return jax.jit(one, compiler_options=FAST)


def contact_torque(now, force: np.ndarray) -> np.ndarray:
    total = np.zeros(29)
    for side, body in enumerate((2, 3)):
        for point, f in zip(POINTS[side], force.reshape(2, 4, 3)[side], strict=True):
            arm = np.asarray(now.rotation[body]) @ point
            total += np.asarray(now.jacobian[body]).T @ np.concatenate([f, np.cross(arm, f)])
    return total


@pytest.mark.parametrize("push", [0.0, 2.0])
@pytest.mark.slow
def test_obeys_the_equation_of_motion_and_friction(humanoid, tick, push):
    for q, v in zip(*states(humanoid), strict=True):
        command, now, expected = tick(humanoid.robot, q, v, reference(q, push, np.ones(8)))
        assert bool(command.converged)
        force = np.asarray(command.force)
        torque = np.concatenate([np.zeros(6), command.torque])
        np.testing.assert_allclose(expected, torque + contact_torque(now, force), atol=1e-6)
        assert np.all(force[:, 2] >= 0)
        tangential = np.abs(force[:, 0]) + np.abs(force[:, 1])
        assert np.all(tangential <= 0.6 * force[:, 2] + 1e-6)


def test_a_foot_without_contact_carries_nothing(humanoid, tick):
    q, v = (x[0] for x in states(humanoid))
    want = reference(q, 0.0, np.repeat([0.0, 1.0], 4))
    command, _, _ = tick(humanoid.robot, q, v, want)
    np.testing.assert_allclose(command.force[:4], 0.0, atol=1e-9)
    assert np.asarray(command.force)[4:, 2].sum() > 300.0


def test_is_the_optimum_of_the_whole_problem(humanoid, controller, tick):
    """The same problem over accelerations and forces together, by another solver."""
    proxsuite = pytest.importorskip("proxsuite")
    q, v = (x[1] for x in states(humanoid))
    want = reference(q, 1.0, np.ones(8))
    command, now, _ = tick(humanoid.robot, q, v, want)
    q, v = jnp.asarray(q), jnp.asarray(v)
    rows, wanted, weight = (np.asarray(x) for x in controller._tasks(now, q, v, want))
    posture, posture_weight = (np.asarray(x) for x in controller._posture(q, v, want))
    h = (rows.T * weight) @ rows + np.diag(np.concatenate([np.full(6, 1e-4), posture_weight]))
    g = (rows.T * weight) @ wanted
    g[6:] += posture_weight * posture
    generalised, _ = (np.asarray(x) for x in controller._contact(now, want))
    unit = float(now.weight) * 9.81 / 8
    generalised = generalised * unit
    n = generalised.shape[1]
    cost = np.zeros((29 + n, 29 + n))
    cost[:29, :29], cost[29:, 29:] = h, controller.gains.force_weight * np.eye(n)
    mass, bias = np.asarray(now.mass), np.asarray(now.bias)
    bounds = np.hstack([np.zeros((n, 29)), np.eye(n)])
    result = proxsuite.proxqp.dense.solve(
        cost,
        np.concatenate([-g, np.zeros(n)]),
        np.hstack([mass[:6], -generalised[:6]]),
        -bias[:6],
        bounds,
        np.zeros(n),
        np.full(n, 1e20),
        eps_abs=1e-9,
        max_iter=20_000,
    )
    np.testing.assert_allclose(command.acceleration, result.x[:29], atol=2e-3)


def test_torques_stay_within_limits_where_the_wish_is_too_much(humanoid, tick):
    q, v = (x[2] for x in states(humanoid))
    want = eqx.tree_at(
        lambda r: r.posture, reference(q, 0.0, np.ones(8)), replace_fn=lambda p: p.at[2].set(5e3)
    )
    command, _, _ = tick(humanoid.robot, q, v, want)
    limit = humanoid.model.actuator_ctrlrange[:, 1]
    assert np.all(np.abs(command.torque) <= limit + 1e-9)
    assert np.max(np.abs(command.torque) / limit) > 0.99


def test_parameters_told_are_the_parameters_used(humanoid, tick):
    q = humanoid.model.key_qpos[0]
    robot = humanoid.robot
    forearm = robot.body_index("left_elbow_pitch_link")
    heavy = robot.with_pi((forearm,), 5.0 * robot.pi[forearm][None])
    want = reference(q, 0.0, np.ones(8))
    light, _, _ = tick(robot, q, np.zeros(29), want)
    loaded, _, _ = tick(heavy, q, np.zeros(29), want)
    added = 4.0 * float(robot.pi[forearm, 0]) * 9.81
    more = np.asarray(loaded.force - light.force)[:, 2].sum()
    # Heavier by that much; the wanted acceleration of the pelvis adds a little.
    assert added < more < 1.3 * added


def test_task_kinematics_agree_with_differences(humanoid):
    """ẋ and ẍ of every task, against finite differences along a motion."""
    robot, (qs, vs) = humanoid.robot, states(humanoid, 1)
    q, v = qs[0], vs[0]
    bodies = tuple(robot.body_index(n) for n in ("pelvis_link", "torso_link", *NAMES["feet"]))
    get = jax.jit(lambda q, v: terms(robot, q, v, bodies), compiler_options=FAST)
    step = 1e-5
    ahead, behind = q.copy(), q.copy()
    mujoco.mj_integratePos(humanoid.model, ahead, v, step)
    mujoco.mj_integratePos(humanoid.model, behind, v, -step)
    now, after, before = get(q, v), get(ahead, v), get(behind, v)
    np.testing.assert_allclose((after.com - before.com) / (2 * step), now.com_velocity, atol=1e-6)
    np.testing.assert_allclose(
        (after.com_velocity - before.com_velocity) / (2 * step), now.com_bias, atol=1e-5
    )
    np.testing.assert_allclose(
        (after.momentum - before.momentum) / (2 * step), now.momentum_bias, atol=1e-4
    )
    np.testing.assert_allclose(
        (after.position - before.position) / (2 * step), now.velocity[:, :3], atol=1e-6
    )
    np.testing.assert_allclose(
        (after.velocity - before.velocity) / (2 * step), now.jacobian_bias, atol=1e-5
    )
    foot = jax.jit(lambda q: body_jacobian(robot, q, bodies[2]), compiler_options=FAST)(q)
    np.testing.assert_allclose(now.jacobian[2], foot, atol=1e-12)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"torque_limit": np.ones(3)}, "expected one for each of 23 joints"),
        ({"pelvis": "torso_link"}, "is not the base; that is 'pelvis_link'"),
        ({"arm_joints": ["tail"]}, "no joint named 'tail'"),
    ],
)
def test_refuses_what_it_cannot_control(humanoid, change, message):
    usual = {"points": POINTS, "friction": 0.6, "torque_limit": np.ones(23), "arm_joints": []}
    with pytest.raises(ValueError, match=message):
        make_whole_body(humanoid.robot, **(NAMES | usual | change))
