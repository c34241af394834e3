"""Inertial parameters written into a MuJoCo model are the ones that it then has."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from bodies import body, random_bodies, rotation, spread_body
from models import MODELS

import jax_inertia as ji
from jax_inertia.model.load import ModelError, body_pi, compile_spec, load_spec, set_inertials

TURN = rotation(np.random.default_rng(2))
AWKWARD = {
    "rod": spread_body(2.0, [0.1, -0.3, 0.2], [0.4, 1e-3, 1e-3], TURN),
    # Exactly flat: the largest moment is the sum of the others, but for rounding.
    "plate": spread_body(2.0, [0.1, -0.3, 0.2], [0.4, 0.2, 0.0], TURN),
    "sphere": spread_body(2.0, [0.0, 0.0, 0.0], [0.1, 0.1, 0.1]),
    "gram": spread_body(1e-3, [0.01, 0.0, 0.0], [1e-2, 2e-3, 5e-3], TURN),
    "tonne": spread_body(1e3, [1.0, 0.0, 2.0], [1.0, 2.0, 0.5], TURN),
}


def error(got, wanted) -> float:
    trace = 0.5 * (wanted[4] + wanted[7] + wanted[9])
    scale = np.array([wanted[0], *[np.sqrt(wanted[0] * trace)] * 3, *[trace] * 6])
    return float(np.max(np.abs(got - wanted) / scale))


@pytest.mark.parametrize("name", ["welded", "floating_tree", "arm7"])
def test_round_trip_for_every_body(name):
    spec = mujoco.MjSpec.from_string(MODELS[name])
    names = [b.name for b in spec.bodies if b.name != "world"]
    for seed in range(3):
        wanted = dict(zip(names, random_bodies(len(names), seed=seed, thinnest=0.005), strict=True))
        set_inertials(spec, wanted)
        model = compile_spec(spec)
        for key, pi in wanted.items():
            assert error(body_pi(model, model.body(key).id), pi) <= 1e-10


@pytest.mark.parametrize("pi", AWKWARD.values(), ids=list(AWKWARD))
def test_round_trip_of_awkward_bodies(pi):
    """And through XML text, which MuJoCo writes with fewer digits."""
    spec = mujoco.MjSpec.from_string(MODELS["universal"])
    set_inertials(spec, {"tip": jnp.asarray(pi)})
    model = compile_spec(spec)
    assert error(body_pi(model, model.body("tip").id), pi) <= 1e-10
    again = mujoco.MjModel.from_xml_string(spec.to_xml())
    assert error(body_pi(again, again.body("tip").id), pi) <= 1e-5


def test_the_changed_model_is_the_changed_robot():
    """The same torques from MuJoCo with the parameters set as from the robot with them."""
    spec = mujoco.MjSpec.from_string(MODELS["floating_tree"])
    robot = ji.load_model(compile_spec(spec))
    new = random_bodies(2, seed=7)
    set_inertials(spec, {"pack": new[0], "forearm": new[1]})
    model = compile_spec(spec)
    data = mujoco.MjData(model)
    rng = np.random.default_rng(3)
    data.qpos[:], data.qvel[:], a = rng.normal(size=model.nq), *rng.normal(size=(2, model.nv))
    mujoco.mj_normalizeQuat(model, data.qpos)
    mujoco.mj_forward(model, data)
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    robot = robot.with_pi(("pack", robot.body_index("forearm")), jnp.asarray(new))
    got = jax.jit(ji.inverse_dynamics)(robot, jnp.asarray(data.qpos), jnp.asarray(data.qvel), a)
    wanted = mass @ a + data.qfrc_bias
    np.testing.assert_allclose(got, wanted, rtol=0, atol=1e-10 * np.max(np.abs(wanted)))


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("bodies", "pi", "says"),
    [
        ((17,), np.ones((1, 10)), "body index 17 is out of range: the model has"),
        (("pakc",), np.ones((1, 10)), "no moving body named 'pakc'"),
        (("pack", "pack"), np.ones((2, 10)), "named twice"),
        (("pack",), 1.0, r"pi has shape \(\); expected \(1, 10\)"),
        (("pack",), -np.ones((1, 10)), "body 'pack': mass -1 kg; it cannot be negative"),
    ],
)
def test_a_robot_takes_no_parameters_that_do_not_fit(cases, bodies, pi, says):
    with pytest.raises(ValueError, match=says):
        cases("floating_tree").robot.with_pi(bodies, pi)


def test_mass_from_shapes_is_replaced(tmp_path):
    """Also where the model asks for mass from shapes alone: what is not set stays as it was."""
    inertial = '<inertial pos="0 0 0" mass="9" diaginertia="1 1 1"/>'
    for option in ("auto", "true"):
        path = tmp_path / f"{option}.xml"
        path.write_text(f"""<mujoco><compiler inertiafromgeom="{option}"/><worldbody>
          <body name="a"><joint/><geom size="0.1"/>
          <body name="b"><joint/><geom size="0.2"/>{inertial}</body></body></worldbody></mujoco>""")
        spec = load_spec(path)
        before = compile_spec(spec)
        pi = random_bodies(1)[0]
        set_inertials(spec, {"a": pi})
        after = compile_spec(spec)
        assert error(body_pi(after, 1), pi) <= 1e-10
        np.testing.assert_allclose(body_pi(after, 2), body_pi(before, 2), rtol=1e-12)


GOOD = random_bodies(1)[0]


@pytest.mark.parametrize(
    ("name", "pi", "says"),
    [
        ("hand", GOOD, r"no body named 'hand'; the model has: gimbal, tip"),
        ("world", GOOD, r"no body named 'world'"),
        ("tip", -GOOD, r"'tip': mass -"),
        ("tip", 0 * GOOD, r"'tip': mass 0"),
        ("tip", body(1.0, [0, 0, 0], np.diag([0.1, 0.1, 0.3])), r"'tip': principal moments"),
        ("tip", body(1.0, [0.5, 0, 0], np.diag([0.1, 0.1, -0.01])), r"'tip': principal moments"),
        ("tip", GOOD[:9], r"'tip': parameters have the shape \(9,\)"),
        ("tip", GOOD * np.nan, r"'tip': parameters are not finite"),
        ("tip", [*GOOD[:4], np.inf, *GOOD[5:]], r"'tip': parameters are not finite"),
    ],
)
def test_what_no_body_can_have_is_refused(name, pi, says):
    spec = mujoco.MjSpec.from_string(MODELS["universal"])
    before = body_pi(spec.compile(), 1)
    with pytest.raises(ModelError, match=says):
        set_inertials(spec, {"gimbal": GOOD, name: np.asarray(pi)})
    # All or nothing.
    np.testing.assert_array_equal(body_pi(spec.compile(), 1), before)


def test_a_compiler_that_rescales_is_refused():
    spec = mujoco.MjSpec.from_string(MODELS["universal"])
    spec.compiler.settotalmass = 5.0
    with pytest.raises(ModelError, match="settotalmass"):
        set_inertials(spec, {"tip": GOOD})
