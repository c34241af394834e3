"""Every effect of the registry: its columns are what its simulation does, and what is identified is what was put in.

The simulation is MuJoCo C on the model that the effect edits, with its step law before each step; columns are the
package's own, along a motion in closed form.
"""

import dataclasses

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from diagnosis_robot import NOMINAL, log_of, motion

from jax_inertia.diagnosis.effects.base import Effect, Moment, Parameter, Place, of_row
from jax_inertia.diagnosis.effects.identified import Identified
from jax_inertia.diagnosis.effects.registry import EFFECTS, NAMES, known
from jax_inertia.diagnosis.residual import Residual
from jax_inertia.diagnosis.settings import Settings
from jax_inertia.diagnosis.simulate.corrected import corrected
from jax_inertia.diagnosis.simulate.step_law import Callback, callback, law
from jax_inertia.model.load import load_model

RATE = 250.0
TIME, Q, V, A = motion(3, seconds=5.0, rate=RATE)
NAMES_OF_JOINTS = ("shoulder", "elbow", "wrist")
ELBOW, WRIST = Place("joint", "elbow", 1), Place("joint", "wrist", 2)
ALL, HAND, LOWER = (
    Place("global", "global", -1),
    Place("body", "hand", 2),
    Place("body", "lower", 1),
)
PULL, POINT = (5.0, -3.0, 8.0), (0.02, -0.03, 0.05)
CARRIED = (0.6, 0.6 * 0.03, 0.6 * -0.02, 0.6 * -0.1, 0.6 * 0.05**2)
"""m, m c and m k² of a load."""
# Effect: place, nonlinear numbers, θ, and how far simulation and columns may be apart, as a share of the effect.
CASES = {
    "viscous_friction": (ELBOW, (), [0.4], 0.01),
    "coulomb_friction": (ELBOW, (0.0, 0.0), [0.6], 0.02),
    "armature": (ELBOW, (), [0.1], 0.01),
    "torque_bias": (ELBOW, (), [0.5], 0.01),
    "asymmetric_coulomb": (ELBOW, (0.0, 0.0), [0.3], 0.02),
    "stribeck_friction": (ELBOW, (0.0, 0.0, 0.3, 2.0), [0.5], 0.04),
    "load_friction": (ELBOW, (0.0, 0.0, 0.0, 0.0, 0.1), [0.1], 0.02),
    "asymmetric_viscous": (ELBOW, (), [0.4], 0.01),
    "quadratic_viscous": (ELBOW, (), [0.3], 0.01),
    "friction_drift": (ELBOW, (3.0,), [0.5], 0.01),
    "joint_spring": (ELBOW, (), [0.8, 2.0], 0.01),
    "cogging": (ELBOW, (8.0,), [0.2, 0.3, 0.05, -0.02], 0.01),
    "torque_gain": (ALL, (), [-0.15], 0.01),
    "torque_saturation": (ELBOW, (0.6,), [1.0], 0.01),
    "torque_speed": (ELBOW, (1.0, 2.5), [1.0], 0.01),
    "time_delay": (ALL, (0.006,), [0.006], 0.01),
    # The step law holds a torque over its step, the columns draw it straight.
    "actuator_lag": (ELBOW, (0.04,), [0.04], 0.06),
    "encoder_offset": (ELBOW, (0.04,), [0.04], 0.01),
    "encoder_scale": (ELBOW, (), [0.02], 0.02),
    "joint_coupling": (Place("joint", "wrist", 2, "elbow"), (0.3, 0.0), [0.3, 0.0], 0.01),
    "gravity_tilt": (ALL, (0.9, -1.4), [0.9, -1.4], 0.01),
    "payload": (HAND, CARRIED, [*CARRIED], 0.01),
    "com_shift": (HAND, (0.01, 0.005, -0.02), [0.01, 0.005, -0.02], 0.01),
    "link_inertia": (LOWER, (), [0.7], 0.01),
    "constant_force": (HAND, (*PULL, *POINT), [*PULL, *POINT], 0.01),
    "drag": (HAND, (), [4.0], 0.01),
    "push": (HAND, (2.0, 3.0, 0.3, 0.2), [20.0, 0.0, -10.0], 0.01),
}
ELSEWHERE = {
    "joint_elasticity": "a second hinge: test_diagnosis_two_mass.py, test_diagnose_model.py",
    "backlash": "a second hinge: test_diagnosis_two_mass.py, test_diagnose_model.py",
    "contact_force_scale": "what a sensor reads: test_diagnosis_support.py",
}
ROBOT = load_model(mujoco.MjModel.from_xml_string(NOMINAL)).astype("float64")


@pytest.fixture(scope="module", autouse=True)
def double_precision():
    with jax.enable_x64(True):
        yield


def test_every_effect_that_is_named_is_tried_here_or_said_where():
    assert sorted({*CASES, *ELSEWHERE}) == list(NAMES)


def needed(model: mujoco.MjModel, q=Q, v=V, a=A) -> np.ndarray:
    """Torque that the motion needs (T, n), dry friction of a level that turns at once."""
    level = model.dof_frictionloss.copy()
    model.dof_frictionloss[:] = 0.0
    data, out = mujoco.MjData(model), np.zeros_like(v)
    for k in range(len(q)):
        data.qpos[:], data.qvel[:], data.qacc[:] = q[k], v[k], a[k]
        mujoco.mj_inverse(model, data)
        out[k] = data.qfrc_inverse
    model.dof_frictionloss[:] = level
    return out + level * np.sign(v)


def by_steps(model: mujoco.MjModel, act: Callback, u: np.ndarray) -> np.ndarray:
    """What the step law adds along the motion to the torques asked for (T, n)."""
    data, out, jacobian = mujoco.MjData(model), np.zeros_like(u), np.zeros((6, model.nv))
    level = model.dof_frictionloss.copy()
    for k in range(len(u)):
        # An effect's time counts from the first sample that has an acceleration.
        data.time, data.qpos[:], data.qvel[:] = TIME[k] - TIME[1], Q[k], V[k]
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        data.qfrc_applied[:], data.xfrc_applied[:] = u[k], 0.0
        act(model, data)
        out[k] = data.qfrc_applied - u[k] - (model.dof_frictionloss - level) * np.sign(V[k])
        for body in range(1, model.nbody):
            mujoco.mj_jacBodyCom(model, data, jacobian[:3], jacobian[3:], body)
            out[k] += jacobian.T @ data.xfrc_applied[body]
        model.dof_frictionloss[:] = level
    return out


def identified(effect: Effect, place: Place, numbers: dict[str, Parameter]) -> Identified:
    values = {name: p.value for name, p in numbers.items()}
    return Identified(effect.name, place.kind, place.name, values, place.other)


def simulated(found: Identified) -> tuple[np.ndarray, np.ndarray]:
    """(torque that the effect adds along the motion, torque asked for) (T, n) each."""
    bare = mujoco.MjModel.from_xml_string(NOMINAL)
    model = corrected(mujoco.MjSpec.from_string(NOMINAL), [found]).spec.compile()
    model.opt.timestep = 1.0 / RATE
    asked = needed(bare)
    if found.family == "encoder_scale":
        true = 1.0 / (1.0 + found.values["scale"])
        share = np.where(np.array(NAMES_OF_JOINTS) == found.name, true, 1.0)
        return asked - needed(bare, Q * share, V * share, A * share), asked
    attributes, bound = asked - needed(model), law(model, [found])
    u, late = asked, any(at is not None for at in bound.memory(np, asked[0]))
    for _ in range(1 if late or not bound.parts else 4):
        added = attributes + by_steps(model, Callback(bound), u)
        # What has to be asked for so that the motion is this one; of what comes late, any torque serves.
        u = u if late else u + (asked - added - u)
    return attributes + by_steps(model, Callback(bound), u), u


def residual_of(u: np.ndarray) -> Residual:
    log = log_of(TIME, Q, u, noise=0.0)
    return Residual(ROBOT, dataclasses.replace(log, qpos=Q), Settings())


def test_load_is_of_the_motor_or_of_the_link():
    """The motor's torque has the joint's own friction in it, the link's has not."""
    rubbing = NOMINAL.replace('name="elbow"', 'name="elbow" damping="0.8" armature="0.1"')
    robot = load_model(mujoco.MjModel.from_xml_string(rubbing)).astype("float64")
    motor = needed(mujoco.MjModel.from_xml_string(rubbing))
    link = needed(mujoco.MjModel.from_xml_string(NOMINAL))
    log = log_of(TIME, Q, motor, noise=0.0)
    residual = Residual(robot, dataclasses.replace(log, qpos=Q), Settings())
    for side, torque in ((1.0, motor), (0.0, link)):
        columns = columns_of(residual, known("load_friction"), ELBOW, (0.0, 0.0, side, 0.0, 0.0))
        wanted = on_rows(residual, -np.abs(torque) * np.sign(V))[:, 1]
        off = (columns[:, 1, 0] - wanted)[5:-5]
        assert np.sqrt(np.mean(off**2)) < 0.02 * np.sqrt(np.mean(wanted**2)), side


def on_rows(residual: Residual, torque: np.ndarray) -> np.ndarray:
    """A torque along the log on the residual's rows (R, n)."""
    grid = residual.prepared.time
    fast = np.stack([np.interp(grid, TIME, x) for x in torque.T], axis=1)
    return residual.prepared.finish_torque(fast)


def columns_of(residual: Residual, effect: Effect, place: Place, shape) -> np.ndarray:
    """(R, n, k)."""
    values, row = residual.rows_of(effect.columns(residual.context, place, shape))
    if row is None:
        return values
    out = np.zeros((*residual.y.shape, values.shape[1]))
    out[:, row] = values
    return out


@pytest.mark.parametrize("name", CASES)
def test_columns_are_what_the_simulation_does_and_give_its_numbers_back(name):
    place, shape, theta, tolerance = CASES[name]
    effect, theta = known(name), np.asarray(theta, float)
    context = residual_of(needed(mujoco.MjModel.from_xml_string(NOMINAL))).context
    put_in = effect.numbers(context, place, shape, theta)
    added, asked = simulated(identified(effect, place, put_in))
    residual = residual_of(asked)
    wanted = on_rows(residual, added)
    columns = columns_of(residual, effect, place, shape)
    inside = slice(5, -5)
    wanted, columns = wanted[inside], columns[inside]
    size = np.sqrt(np.mean(wanted**2))
    assert size > 1e-3
    assert np.sqrt(np.mean((columns @ theta - wanted) ** 2)) < tolerance * size
    # Numbers by least squares on these columns alone.
    fitted = np.linalg.lstsq(columns.reshape(-1, columns.shape[-1]), wanted.ravel(), rcond=None)[0]
    back = effect.numbers(residual.context, place, shape, fitted)
    assert {k: p.unit for k, p in back.items()} == dict(effect.units)
    for key, p in put_in.items():
        scale = max(abs(x.value) for x in put_in.values() if x.unit == p.unit)
        assert back[key].value == pytest.approx(p.value, abs=2 * tolerance * scale + 1e-9), key


WHOLE = [
    name
    for name in CASES
    if known(name).mjcf and "step law" not in known(name).mjcf and "none" not in known(name).mjcf
]


@pytest.mark.parametrize("name", WHOLE)
def test_what_is_identified_from_an_edited_model_edits_alike(name):
    """Edit, identify, edit: the same model twice."""
    place, shape, theta, tolerance = CASES[name]
    effect = known(name)
    bare = mujoco.MjModel.from_xml_string(NOMINAL)
    context = residual_of(needed(bare)).context
    put_in = identified(effect, place, effect.numbers(context, place, shape, np.array(theta)))
    first = corrected(mujoco.MjSpec.from_string(NOMINAL), [put_in])
    assert first.in_model == (put_in,)
    residual = residual_of(needed(first.spec.compile()))
    columns = columns_of(residual, effect, place, shape)
    # What the chain of filters itself leaves of a sound robot is not the effect's.
    y = residual.y - residual_of(needed(bare)).y
    fitted = np.linalg.lstsq(columns.reshape(y.size, -1), y.ravel())[0]
    back = identified(effect, place, effect.numbers(residual.context, place, shape, fitted))
    again = corrected(mujoco.MjSpec.from_string(NOMINAL), [back]).spec.compile()
    wanted = needed(first.spec.compile()) - needed(bare)
    np.testing.assert_allclose(
        needed(again) - needed(bare), wanted, atol=2 * tolerance * np.abs(wanted).max()
    )


STEPPED = [e.name for e in EFFECTS if e.by_step]


@pytest.mark.parametrize("name", STEPPED)
def test_the_step_law_is_one_law_in_numpy_and_in_jax(name):
    """Pure: of any moment, jitted; whole steps of both simulators are in test_diagnose_model.py."""
    place, shape, theta, _ = CASES[name]
    effect = known(name)
    model = mujoco.MjModel.from_xml_string(NOMINAL)
    context = residual_of(needed(model)).context
    found = identified(effect, place, effect.numbers(context, place, shape, np.array(theta)))
    bound = law(model, [found], mjx=True)
    assert bound.parts
    rng, n = np.random.default_rng(0), model.nv
    # Not jitted as one: a moment's numbers are arrays of either kind.
    memories = [bound.memory(xp, rng.normal(size=n) * 0 + 1.0) for xp in (np, jnp)]
    late = jax.jit(lambda memory, u: bound.late(jnp, memory, u))
    act = jax.jit(lambda now: bound(jnp, now))
    changed = False
    for k in range(4):
        asked = 4.0 * rng.normal(size=n)
        memories[0], u = bound.late(np, memories[0], asked)
        memories[1], v = late(memories[1], jnp.asarray(asked))
        turn = np.stack([np.linalg.qr(rng.normal(size=(3, 3)))[0] for _ in range(model.nbody)])
        q, speed = rng.normal(size=(2, n))
        moment = Moment(q, speed, u, 2.2 + 0.2 * k, turn, rng.normal(size=(model.nbody, 3)))
        here, there = bound(np, moment), act(Moment(*(jnp.asarray(x) for x in moment)))
        np.testing.assert_allclose(v, u, rtol=1e-6, atol=1e-6)
        for a, b in zip(here, there, strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-6, atol=1e-6)
        changed |= not (
            np.allclose(here.torque, asked)
            and np.allclose(here.friction, model.dof_frictionloss)
            and not here.wrench.any()
        )
    assert changed


class Hose(Effect):
    """A user's own: a hose that goes taut."""

    name, equation = "hose", "−k max(q − q₀, 0)"

    def shapes(self, context, place):
        return [(0.1,)]

    def columns(self, context, place, shape):
        return of_row(-np.maximum(context.joint_position[:, place.index] - shape[0], 0.0), place)

    def scale(self, context, place, shape):
        return np.array([10.0])

    def numbers(self, context, place, shape, theta):
        return {
            "stiffness": Parameter(float(theta[0]), "N m/rad"),
            "taut_at": Parameter(shape[0], "rad"),
        }

    def torque(self, xp, now, at):
        return -at.values["stiffness"] * xp.maximum(now.q - at.values["taut_at"], 0.0)


def test_an_effect_of_ones_own_is_simulated_and_only_then_said_to_be():
    found = Identified("hose", "joint", "elbow", {"stiffness": 20.0, "taut_at": 0.1})
    own, stranger = (
        corrected(mujoco.MjSpec.from_string(NOMINAL), [found], extra) for extra in ([Hose()], [])
    )
    assert own.by_callback == (found,)
    assert stranger.outside == (found,)
    assert "step_law" in own.spec.to_xml()
    assert "step_law" not in stranger.spec.to_xml()
    model = own.spec.compile()
    data = mujoco.MjData(model)
    data.qpos[1] = 0.3
    mujoco.mj_forward(model, data)
    callback(model, [found], [Hose()])(model, data)
    np.testing.assert_allclose(data.qfrc_applied, [0.0, -4.0, 0.0])
    # Its columns are its law.
    bare = mujoco.MjModel.from_xml_string(NOMINAL)
    residual = residual_of(needed(bare))
    added = by_steps(bare, Callback(law(bare, [found], [Hose()])), needed(bare))
    columns = columns_of(residual, Hose(), ELBOW, (0.1,))
    np.testing.assert_allclose(columns @ [20.0], on_rows(residual, added), atol=0.02)


def test_what_the_documentation_says_of_an_effect_is_there():
    for effect in EFFECTS:
        if effect.named:
            for text in (effect.equation, effect.source, effect.prior, effect.mjcf):
                assert text, effect.name
            assert effect.units, effect.name


def test_a_motor_that_carries_its_own_friction_gives_more_and_less():
    """τ = τ₀ + (F₀ + μ |τ|) s in closed form; the law's columns at μ, of the level and of the load."""
    level, mu, effect = 0.4, 0.3, known("load_friction")
    bare = needed(mujoco.MjModel.from_xml_string(NOMINAL))[:, 1]
    both = bare + level * np.sign(V[:, 1])
    motor = both / (1.0 - mu * np.sign(V[:, 1] * both))
    tau = needed(mujoco.MjModel.from_xml_string(NOMINAL))
    tau[:, 1] = motor
    residual, shape = residual_of(tau), (0.0, 0.0, 1.0, 0.0, mu)
    of_load = columns_of(residual, effect, ELBOW, shape)[:, 1, 0]
    values, _ = residual.rows_of(
        effect.of_level(known("coulomb_friction"), residual.context, ELBOW, shape)
    )
    said = level * values[:, 0] + mu * of_load
    np.testing.assert_allclose(
        said[5:-5], residual.y[5:-5, 1], atol=0.03 * np.ptp(residual.y[:, 1])
    )
