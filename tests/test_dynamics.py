"""Dynamics against MuJoCo C and Pinocchio on random states of every test robot, and the identities they obey."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from conftest import FAST
from pinocchio_oracle import PinocchioRobot

import jax_inertia as ji

STATES = 5
TOLERANCE = {np.float64: 1e-10, np.float32: 1e-4}
dtypes = pytest.mark.parametrize("dtype", [np.float64, np.float32], ids=["f64", "f32"])


def relative(value, reference) -> float:
    """Largest error over the largest entry, sample by sample; for the worst sample."""
    value, reference = np.asarray(value, float), np.asarray(reference, float)
    assert value.shape == reference.shape
    axes = tuple(range(1, reference.ndim))
    scale = np.max(np.abs(reference), axis=axes)
    assert np.all(scale > 0)
    return float(np.max(np.max(np.abs(value - reference), axis=axes) / scale))


def wrenches_for(case, count: int = STATES) -> np.ndarray:
    return 30.0 * np.random.default_rng(7).normal(size=(count, len(case.chosen), 6))


def mujoco_reference(case, q, v, a, wrenches) -> dict[str, np.ndarray]:
    """What MuJoCo C computes for the same states."""
    model, data = case.model, mujoco.MjData(case.model)
    ids = [model.body(name).id for name in case.robot.body_names]
    chosen = [model.body(name).id for name in case.chosen]
    keys = ("torque", "mass_matrix", "rotation", "position", "jacobian", "contact")
    out: dict[str, list] = {key: [] for key in keys}
    for i in range(len(q)):
        data.qpos[:], data.qvel[:] = q[i], v[i]
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        mass = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, mass)
        jacobians = []
        for b in chosen:
            linear, angular = np.zeros((2, 3, model.nv))
            mujoco.mj_jacBody(model, data, linear, angular, b)
            jacobians.append(np.concatenate([linear, angular]))
        out["torque"].append(mass @ a[i] + data.qfrc_bias)
        out["mass_matrix"].append(mass)
        out["rotation"].append(data.xmat[ids].reshape(-1, 3, 3).copy())
        out["position"].append(data.xpos[ids].copy())
        out["jacobian"].append(jacobians[0])
        out["contact"].append(np.einsum("bw,bwv->v", wrenches[i], np.stack(jacobians)))
    return {key: np.stack(value) for key, value in out.items()}


@dtypes
def test_agrees_with_mujoco(case, dtype):
    q, v, a = (x.astype(dtype) for x in case.states(STATES))
    wrenches = wrenches_for(case)
    got = case.core(case.robot.astype(dtype), q, v, a)
    assert {x.dtype for x in got.values()} == {np.dtype(dtype)}
    if dtype is np.float64:
        got = {**case.chosen_bodies(case.robot, q, v, a, wrenches), **got}
    reference = mujoco_reference(case, *(x.astype(float) for x in (q, v, a)), wrenches)
    errors = {key: relative(got[key], reference[key]) for key in reference.keys() & got.keys()}
    assert {"torque", "mass_matrix", "rotation", "position"} <= errors.keys()
    assert max(errors.values()) <= TOLERANCE[dtype], errors


@dtypes
def test_agrees_with_pinocchio(case, dtype):
    q, v, a = (x.astype(dtype) for x in case.states(STATES, seed=1))
    got = case.core(case.robot.astype(dtype), q, v, a)
    oracle = PinocchioRobot(case.model)
    states = [(q[i].astype(float), v[i].astype(float), a[i].astype(float)) for i in range(STATES)]
    reference = {
        "torque": np.stack([oracle.torque(*s) for s in states]),
        "regressor": np.stack([oracle.regressor(*s) for s in states]),
        "mass_matrix": np.stack([oracle.mass_matrix(s[0]) for s in states]),
    }
    errors = {key: relative(got[key], value) for key, value in reference.items()}
    assert max(errors.values()) <= TOLERANCE[dtype], errors


def test_regressor_identities(case):
    """Y π + armature · a = τ, for all bodies, for chosen ones, and in the paper's condensed form."""
    robot = case.robot
    q, v, a = case.states(STATES, seed=2)
    core = case.core(robot, q, v, a)
    some = case.chosen_bodies(robot, q, v, a, wrenches_for(case))
    chosen = np.array([robot.body_index(name) for name in case.chosen])
    torque = np.asarray(core["torque"])
    whole = np.einsum("svbk,bk->sv", core["regressor"], robot.pi) + a * robot.armature
    condensed = np.einsum("svbk,bk->sv", some["condensed"], robot.pi[chosen]) + some["nominal"]
    assert relative(whole, torque) <= 1e-12
    assert relative(condensed, torque) <= 1e-12
    for key in ("regressor", "condensed"):
        assert relative(some[key], core["regressor"][:, :, chosen]) <= 1e-12


def test_nominal_torque_does_not_know_the_chosen_bodies(cases):
    case = cases("floating_tree")
    chosen = tuple(case.robot.body_index(name) for name in case.chosen)
    wild = case.robot.with_pi(chosen, 9.0 * jnp.ones((len(chosen), 10)))
    states = (*case.states(STATES), wrenches_for(case))
    before, after = case.chosen_bodies(case.robot, *states), case.chosen_bodies(wild, *states)
    np.testing.assert_array_equal(before["nominal"], after["nominal"])
    core = case.core(case.robot, *states[:3])["torque"], case.core(wild, *states[:3])["torque"]
    assert relative(*core) > 0.1


@dtypes
@pytest.mark.parametrize("name", ["free_body", "floating_tree", "two_trees", "humanoid"])
def test_accurate_a_hundred_metres_from_home(cases, name, dtype):
    case = cases(name)
    q, v, a = (x.astype(dtype) for x in case.states(STATES, seed=3))
    q[:, :3] += np.array([80.0, -60.0, 3.0], dtype)
    got = case.core(case.robot.astype(dtype), q, v, a)
    reference = mujoco_reference(case, *(x.astype(float) for x in (q, v, a)), wrenches_for(case))
    # MuJoCo itself computes about the world's subtree centres, which costs it a digit here.
    tolerance = 10 * TOLERANCE[np.float64] if dtype is np.float64 else TOLERANCE[dtype]
    errors = {key: relative(got[key], reference[key]) for key in reference.keys() & got.keys()}
    assert len(errors) == 4
    assert max(errors.values()) <= tolerance, errors


def test_gradients_are_finite_differences(cases):
    """Along random directions of q (raw: quaternions are normalised inside), v, a, π and the kinematics."""
    case = cases("floating_tree")
    rng = np.random.default_rng(11)
    q, v, a = (x[0] for x in case.states(1, seed=4))

    def arrays(robot):
        return robot.pi, robot.placement_position, robot.joint_position, robot.armature

    def torque(point):
        q, v, a, leaves = point
        return ji.inverse_dynamics(eqx.tree_at(arrays, case.robot, leaves), q, v, a)

    point = (q, v, a, arrays(case.robot))
    value = jax.jit(torque, compiler_options=FAST)
    derivative = jax.jit(
        lambda point, along: jax.jvp(torque, (point,), (along,))[1], compiler_options=FAST
    )
    gradient = jax.jit(
        jax.grad(lambda point, weight: weight @ torque(point)), compiler_options=FAST
    )
    zero = jax.tree.map(lambda x: np.zeros(np.shape(x)), point)
    leaves, structure = jax.tree.flatten(zero)
    for k in range(len(leaves)):
        along_k = list(leaves)
        along_k[k] = rng.normal(size=leaves[k].shape) / np.sqrt(leaves[k].size)
        along = jax.tree.unflatten(structure, along_k)

        def moved(step, along=along):
            return value(jax.tree.map(lambda at, d: at + step * d, point, along))

        # Fourth-order central differences: truncation and rounding both far below the tolerance.
        h = 1e-3
        numeric = (8 * (moved(h) - moved(-h)) - (moved(2 * h) - moved(-2 * h))) / (12 * h)
        exact = derivative(point, along)
        scale = float(jnp.max(jnp.abs(numeric))) + 1e-6
        np.testing.assert_allclose(exact, numeric, rtol=0, atol=1e-7 * scale)
        weight = rng.normal(size=case.robot.nv)
        reverse = gradient(point, weight)
        dot = sum(
            np.sum(x * y) for x, y in zip(*map(jax.tree.leaves, (reverse, along)), strict=True)
        )
        assert abs(dot - weight @ exact) <= 1e-9 * (1 + abs(weight @ exact))


def test_batch_is_loop_and_the_mass_matrix_a_derivative(cases):
    case = cases("two_trees")
    states = case.states(STATES, seed=5)
    batch = case.core(case.robot, *states)

    @functools.partial(jax.jit, compiler_options=FAST)
    def one(q, v, a):
        torque = functools.partial(ji.inverse_dynamics, case.robot, q, v)
        return torque(a), jax.jacfwd(torque)(a)

    loop = [one(*state) for state in zip(*states, strict=True)]
    mass = batch["mass_matrix"]
    assert relative([x for x, _ in loop], batch["torque"]) <= 1e-13
    assert relative([x for _, x in loop], mass) <= 1e-12
    np.testing.assert_array_equal(mass, np.swapaxes(mass, 1, 2))
    assert np.all(np.linalg.eigvalsh(mass) > 0)


@pytest.mark.slow
def test_vmap_over_any_argument_is_a_loop(cases):
    """Over each array of the robot alone, and of q, v and a: batch axes meet arrays that have none."""
    case = cases("two_trees")
    state = [jnp.asarray(x[0]) for x in case.states(1, seed=8)]
    leaves, structure = jax.tree.flatten((case.robot, *state))
    scales = np.array([1.0, 0.9])

    def core(*leaves):
        robot, q, v, a = jax.tree.unflatten(structure, leaves)
        return *ji.condensed_dynamics(robot, q, v, a, (1, 0)), ji.mass_matrix(robot, q)

    def along(k, scale):
        return core(*(x * scale if i == k else x for i, x in enumerate(leaves)))

    every = range(len(leaves))
    many = jax.jit(
        lambda: [jax.vmap(functools.partial(along, k))(scales) for k in every],
        compiler_options=FAST,
    )()
    one = jax.jit(core, compiler_options=FAST)
    for k in every:
        for i, scale in enumerate(scales):
            alone = one(*(x * scale if j == k else x for j, x in enumerate(leaves)))
            for batched, single in zip(many[k], alone, strict=True):
                assert relative(batched[i][None], single[None]) <= 1e-12


def test_nested_vmap_and_chunks(cases, monkeypatch):
    """A vmap of a vmap, and a batch that is cut into chunks with a rest, hold the same numbers."""
    case = cases("planar_2r")
    q, v, a = case.states(20, seed=9)

    def two(q, v, a):
        return ji.condensed_dynamics(case.robot, q, v, a, (1,))

    whole = jax.jit(jax.vmap(two), compiler_options=FAST)(q, v, a)
    nested = jax.jit(jax.vmap(jax.vmap(two)), compiler_options=FAST)(
        *(x.reshape(4, 5, -1) for x in (q, v, a))
    )
    monkeypatch.setattr("jax_inertia.maths.batch_last._CACHE_BYTES", 1)
    chunked = jax.jit(lambda *x: jax.vmap(two)(*x), compiler_options=FAST)
    assert "while" in chunked.lower(q, v, a).as_text()
    for x, y, z in zip(whole, nested, chunked(q, v, a), strict=True):
        np.testing.assert_allclose(y.reshape(x.shape), x, rtol=0, atol=1e-12)
        np.testing.assert_allclose(z, x, rtol=0, atol=1e-12)


def test_long_chain_in_blocks(monkeypatch):
    """More nodes than one product takes, with branches across the blocks: as in one product."""
    limbs = "".join(
        f'<body pos="0 0 -0.1"><inertial pos="0.01 0.02 -0.05" mass="0.5" diaginertia="0.002 0.002 0.001"/>'
        f'<joint axis="{i % 2} {(i + 1) % 2} 0.2"/>'
        + ('<body pos="0.1 0 0"><geom size="0.1"/><joint/></body>' if i % 3 == 0 else "")
        for i in range(9)
    )
    model = mujoco.MjModel.from_xml_string(
        f"<mujoco><worldbody>{limbs}{'</body>' * 9}</worldbody></mujoco>"
    )
    q, v, a = np.random.default_rng(0).normal(size=(3, model.nv))

    def torque():
        return jax.jit(
            functools.partial(ji.inverse_dynamics, ji.load_model(model)), compiler_options=FAST
        )(q, v, a)

    whole = torque()
    monkeypatch.setattr("jax_inertia.model.robot.BLOCK", 4)
    assert relative(torque()[None], whole[None]) <= 1e-13


def test_passive_torque_is_mujoco_s(cases):
    """Damping and springs; dry friction away from rest is F sign(v), as MuJoCo's constraint tends to."""
    for name in ("floating_tree", "arm7"):
        case = cases(name)
        q, v, _ = case.states(1, seed=6)
        data = mujoco.MjData(case.model)
        data.qpos[:], data.qvel[:] = q[0], v[0]
        mujoco.mj_forward(case.model, data)
        friction = case.model.dof_frictionloss * np.sign(v[0])
        got = ji.passive_torque(case.robot, jnp.asarray(q[0]), jnp.asarray(v[0]))
        np.testing.assert_allclose(got, data.qfrc_passive - friction, rtol=0, atol=1e-10)


def test_unknown_bodies_are_named(cases):
    robot = cases("planar_2r").robot
    q = jnp.zeros(2)
    with pytest.raises(ValueError, match=r"no moving body named 'hand'.*upper, lower"):
        ji.torque_regressor(robot, q, q, q, ["hand"])
    with pytest.raises(ValueError, match=r"index 2 is out of range.*2 bodies"):
        ji.body_jacobian(robot, q, 2)
    with pytest.raises(ValueError, match="twice"):
        ji.condensed_dynamics(robot, q, q, q, ["upper", 0])
    with pytest.raises(ValueError, match=r"no joint named 'wrist'.*shoulder, elbow"):
        robot.joint_index("wrist")


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    "call",
    [
        lambda r, q, v: ji.inverse_dynamics(r, q, v, v),
        lambda r, q, v: ji.torque_regressor(r, q, v, v),
        lambda r, q, v: ji.condensed_dynamics(r, q, v, v, [0]),
        lambda r, q, v: ji.passive_torque(r, q, v),
        lambda r, q, v: ji.mass_matrix(r, q),
        lambda r, q, v: ji.body_poses(r, q),
        lambda r, q, v: ji.body_jacobian(r, q, 0),
        lambda r, q, v: ji.contact_torque(r, q, jnp.zeros((1, 6)), [0]),
    ],
)
def test_samples_of_another_length_are_refused(cases, call):
    robot = cases("planar_2r").robot
    q, v = [0.1, 0.2], np.zeros(2)
    call(robot, q, v)
    for short in (q[1:], [*q, 0.0], [q, q]):
        with pytest.raises(ValueError, match=r"q has shape .* of this robot it has \(2,\), its nq"):
            call(robot, short, v)
    with pytest.raises(ValueError, match=r"v has shape \(1,\)"):
        ji.inverse_dynamics(robot, jnp.zeros(2), v[1:], v)


@pytest.mark.usefixtures("unchecked")
def test_two_wrenches_on_one_body_add_up(cases):
    robot, q = cases("planar_2r").robot, jnp.array([0.3, -0.5])
    heel, toe = np.arange(6.0), np.arange(6.0)[::-1]
    both = ji.contact_torque(robot, q, jnp.stack([heel, toe]), ["lower", "lower"])
    one = ji.contact_torque(robot, q, (heel + toe)[None], ["lower"])
    np.testing.assert_allclose(both, one, atol=1e-13)
    with pytest.raises(ValueError, match=r"wrenches has shape \(2, 6\)"):
        ji.contact_torque(robot, q, jnp.stack([heel, toe]), ["lower"])
    for bad in (2.7, True, None):
        with pytest.raises(ValueError, match="neither a name nor an index"):
            ji.body_jacobian(robot, q, bad)
