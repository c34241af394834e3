"""The worlds that robots are drawn in: the plant, its effects, and that no code is the package's."""

from __future__ import annotations

import ast
from pathlib import Path

import mujoco
import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt

from benchmarks.worlds import effects as fx
from benchmarks.worlds import friction as fr
from benchmarks.worlds import odd
from benchmarks.worlds import outside as un
from benchmarks.worlds import two_mass as tm
from benchmarks.worlds.dynamics import inverse_dynamics
from benchmarks.worlds.feet.balance import walk
from benchmarks.worlds.feet.quadruped import quadruped
from benchmarks.worlds.motions import make_motion
from benchmarks.worlds.plant import Noise, Plant
from benchmarks.worlds.robots import CAD_ROBOTS

ROOT = Path(__file__).parents[1]
ROBOT = CAD_ROBOTS["arm7"]()
QUIET = Noise.none(7)


def feed_forward(model: mujoco.MjModel, omega: float = 12.0):
    """τ = ID(q, q̇, q̈_ref + 2ζω ė + ω² e) with the nominal model."""
    data = mujoco.MjData(model)

    def loop(k, t, q, v, base, target):
        q_ref, v_ref, a_ref = target
        data.qpos[:], data.qvel[:] = q, v
        data.qacc[:] = a_ref + 2.0 * omega * (v_ref - v) + omega**2 * (q_ref - q)
        mujoco.mj_inverse(model, data)
        return data.qfrc_inverse.copy(), q_ref

    return loop


def missing(effects: list[fx.Effect], rate: int = 500) -> np.ndarray:
    """Root mean square (n) of the torque that the nominal model does not explain, below 10 Hz, where in motion."""
    model, nominal, motion = ROBOT.model(), ROBOT.model(), make_motion(ROBOT, "exciting", [5])
    for each in (model, nominal):
        each.dof_armature[:] = [0.5, 0.5, 0.4, 0.4, 0.15, 0.13, 0.1]
    plant = Plant(ROBOT, model, effects)
    rng, start = np.random.default_rng(0), motion(-0.4)[:2]
    log = plant.run(feed_forward(nominal), motion, start, rate, 0.8, QUIET, rng, 0.4)
    held = log["tau"].copy()
    held[1:] = 0.5 * (held[1:] + held[:-1])
    acceleration = np.gradient(log["qvel"], 1.0 / rate, axis=0)
    raw = inverse_dynamics(nominal, log["qpos"], log["qvel"], acceleration) - held
    r = sosfiltfilt(butter(2, 10.0, fs=rate, output="sos"), raw, axis=0)
    moving = np.abs(log["qvel"]) > 0.012
    moving[: rate // 5] = moving[-rate // 5 :] = False
    return np.sqrt((np.where(moving, r, 0.0) ** 2).mean(0))


@pytest.fixture(scope="module")
def floor() -> np.ndarray:
    return missing([])


def test_without_effects_the_nominal_model_explains_the_log(floor):
    assert np.all(floor < 5e-4 * ROBOT.peak.max())


def test_a_walk_without_effects_is_explained_by_its_model():
    """Base rows, legs and measured wrenches: a hundredth of the weight and of the largest torque."""
    log = walk("sway", [3], 1.0)
    robot = quadruped()
    model = robot.model()
    assert log["contact_wrench"].shape == (500, 4, 6)
    weight = 9.81 * model.body_mass.sum()
    assert log["contact_wrench"][:, :, 2].sum(1).mean() == pytest.approx(weight, rel=0.02)
    np.testing.assert_allclose(np.linalg.norm(log["base_quat"], axis=1), 1.0, atol=1e-9)
    doubled = fx.Payload("body", "trunk", {"mass": 4.0, "com": [0.0, 0.0, 0.05], "size": 0.1})
    heavier = walk("sway", [3], 1.0, effects=(doubled,))["contact_wrench"][:, :, 2].sum(1).mean()
    assert heavier - weight == pytest.approx(4.0 * 9.81, rel=0.1)


def test_forward_and_inverse_dynamics_agree_at_a_dense_state():
    rng = np.random.default_rng(0)
    plant = Plant(ROBOT, ROBOT.model(), [])
    bare = ROBOT.model()
    plant.model.dof_frictionloss[:] = bare.dof_frictionloss[:] = 0.0
    data = mujoco.MjData(bare)
    tau = rng.normal(size=7)
    plant.data.qpos[:], plant.data.qvel[:] = rng.normal(size=(2, 7))
    plant._accelerate(0.0, tau)
    data.qpos[:], data.qvel[:], data.qacc[:] = plant.q, plant.v, plant.a
    mujoco.mj_inverse(bare, data)
    np.testing.assert_allclose(data.qfrc_inverse, tau, atol=1e-9)


def test_the_integrator_is_of_second_order():
    robot = CAD_ROBOTS["arm2"]()
    ends = []
    for dt in (2e-3, 1e-3, 0.5e-3, 0.0625e-3):
        model = robot.model()
        model.dof_frictionloss[:] = 0.0
        plant = Plant(robot, model, [])
        plant.data.qpos[:] = 0.7, -0.4
        for k in range(round(0.2 / dt)):
            plant._step(k * dt, dt, np.array([1.0, 0.3]))
        ends.append(plant.q.copy())
    errors = [np.abs(e - ends[-1]).max() for e in ends[:3]]
    assert 3.5 < errors[0] / errors[1] < 4.5
    assert 3.5 < errors[1] / errors[2] < 4.5


JOINT = {
    "joint_spring": lambda j: fr.JointSpring("joint", j, {"stiffness": 3.0, "rest_angle": 0.0}),
    "cogging": lambda j: fr.Cogging(
        "joint", j, {"amplitude": 0.8, "frequency": 10.0, "phase": 0.2}
    ),
    "torque_gain": lambda j: fx.TorqueGain("joint", j, {"gain": 0.9}),
    "torque_saturation": lambda j: fx.TorqueSaturation("joint", j, {"limit": 22.0}),
    "time_delay": lambda j: fx.TimeDelay("joint", j, {"delay": 0.0123}),
    "actuator_lag": lambda j: fx.ActuatorLag("joint", j, {"time_constant": 0.015}),
    "torque_dead_band": lambda j: un.TorqueDeadBand("joint", j, {"half_width": 1.0}),
    "cubic_spring": lambda j: un.CubicSpring("joint", j, {"stiffness": 3.0, "rest_angle": 0.0}),
    "load_ripple": lambda j: un.LoadRipple(
        "joint", j, {"coefficient": 0.1, "frequency": 4.0, "phase": 0.1}
    ),
    "stop_cushion": lambda j: un.StopCushion(
        "joint", j, {"stiffness": 5.0, "onset": -2.5, "side": 1.0}
    ),
    "hysteretic_hose": lambda j: un.HystereticHose(
        "joint", j, {"stiffness": 3.0, "rest_angle": 0.0, "travel": 0.2, "elastic": 0.1}
    ),
}


@pytest.mark.parametrize("family", JOINT)
def test_an_effect_of_a_joint_shows_there_and_nowhere_else(family, floor):
    seen = missing([JOINT[family]("joint4")])
    others = np.delete(seen - floor, 3)
    assert seen[3] > 0.05 + floor[3]
    assert np.all(others < 0.02 + 0.02 * seen[3])


BODY = {
    "payload": lambda b: fx.Payload("body", b, {"mass": 1.0, "com": [0.05, 0, 0.1], "size": 0.05}),
    "com_shift": lambda b: fx.ComShift("body", b, {"com_shift": [0.03, 0.02, 0.02]}),
    "constant_force": lambda b: fx.ConstantForce("body", b, {"force": [8.0, 5.0, -9.0]}),
    "push": lambda b: fx.Push("body", b, {"force": [8.0, 9.0, 9.0], "start": 0.3, "end": 0.7}),
}


@pytest.mark.parametrize("family", BODY)
def test_an_effect_of_a_body_shows_at_its_joint_or_before_never_beyond(family, floor):
    seen = missing([BODY[family]("link4")])
    assert seen[:4].max() > 0.03 + floor[:4].max()
    assert np.all(seen[4:] < floor[4:] + 0.01)


@pytest.mark.parametrize(
    "effect",
    [
        fx.EncoderOffset("joint", "joint4", {"offset": 0.05}),
        tm.JointElasticity("joint", "joint4", {"stiffness": 600.0}),
        tm.Backlash("joint", "joint4", {"dead_zone": 0.03, "stiffness": 4000.0}),
    ],
    ids=lambda e: e.family,
)
def test_what_hides_a_link_from_its_encoder_shows_from_there_inwards(effect, floor):
    seen = missing([effect])
    assert seen[1] + seen[3] > 0.05 + floor[1] + floor[3]


def test_effects_of_the_whole_robot_show(floor):
    tilt = fx.GravityTilt("global", "global", {"tilt": [0.03, 0.03]})
    longer = un.LengthError("body", "link4", {"extension": 0.04})
    skew = un.ClockSkew("global", "global", {"rate": -2e-2})
    assert missing([tilt]).max() > 0.3
    assert missing([longer])[:4].max() > 0.03 + floor[:4].max()
    assert missing([skew]).max() > 2.0 * floor.max()


def test_every_family_that_is_drawn_is_tested():
    elsewhere = {"joint_coupling", "stribeck_friction", "load_friction"}  # test_worlds_as_bought.py
    elsewhere |= {"position_dependent_friction", "resonance"}
    here = {*JOINT, *BODY, "encoder_offset", "joint_elasticity", "backlash", "gravity_tilt"}
    here |= {"length_error", "clock_skew"}
    assert {*odd.ODD, *odd.OUTSIDE, *odd.FURTHER} - elsewhere == here


def test_a_delay_is_fractional_and_a_lag_is_first_order():
    delay = fx.TimeDelay("global", "global", {"delay": 0.00237})
    lag = fx.ActuatorLag("global", "global", {"time_constant": 0.02})
    dt, model = 2.5e-4, CAD_ROBOTS["arm2"]().model()
    for effect in (delay, lag):
        effect.bind(model, ("joint1", "joint2"))
        effect.reset(np.zeros(2), np.zeros(2))
    late, slow = [], []
    for k in range(400):
        ramp, step = np.full(2, k * dt), np.full(2, 1.0 if k else 0.0)
        delay.actuate(k * dt, dt, ramp)
        lag.actuate(k * dt, dt, step)
        late.append(ramp[0])
        slow.append(step[0])
    assert late[300] == pytest.approx(300 * dt - 0.00237, abs=1e-12)
    # The mean of 1 − exp(−t/T) over a cell, the step being at the start of cell 1.
    middle = (np.array([50, 200]) - 0.5) * dt
    np.testing.assert_allclose(np.array(slow)[[50, 200]], 1 - np.exp(-middle / 0.02), rtol=1e-4)


def test_a_bristle_slides_at_its_level_and_springs_back_before():
    bristle = fr.Bristle(level=2.0, presliding=1e-3, inertia=0.5)
    for _ in range(2000):
        bristle.torque(0.5, 2.0)
        bristle.evolve(1e-4)
        bristle.commit()
    assert bristle.torque(0.5, 2.0) == pytest.approx(2.0, rel=1e-6)
    spring = fr.Bristle(level=2.0, presliding=1e-3, inertia=0.5)
    spring.torque(1e-3, 2.0)
    spring.evolve(0.01)
    assert spring.sigma0 * spring.z == pytest.approx(2.0 * 0.01, rel=0.01)


OWN_AXES = """<mujoco><worldbody><body name="link1"><joint name="a" axis="0 0 1"/>
<inertial pos="0.06 0.03 0.1" mass="3" diaginertia="0.04 0.05 0.03"/><body name="link4" pos="0.2 0 0">
<joint name="b" axis="0 1 0"/><inertial pos="0 0 0" mass="2" diaginertia="0.01 0.03 0.02"/></body></body></worldbody>
</mujoco>"""
"""Of the last body the frame of inertia is the body's own, of the first its axes are."""


@pytest.mark.parametrize("xml", [CAD_ROBOTS["arm7"]().xml, OWN_AXES], ids=["arm7", "own_axes"])
def test_a_welded_mass_has_the_inertia_of_the_parallel_axis_theorem(xml):
    model = mujoco.MjModel.from_xml_string(xml)
    body = model.body("link4").id
    before, moved = mujoco.MjData(model), fx.editable(mujoco.MjModel.from_xml_string(xml))
    fx.add_mass(moved, body, 2.0, [0.1, -0.05, 0.2], 0.01 * np.eye(3))
    after = mujoco.MjData(moved)
    mass = []
    for m, d in ((model, before), (moved, after)):
        mujoco.mj_setConst(m, d)
        mujoco.mj_forward(m, d)
        full = np.zeros((m.nv, m.nv))
        mujoco.mj_fullM(m, d, full)
        mass.append(full)
    jacp, jacr = np.zeros((2, 3, model.nv))
    point = before.xpos[body] + before.xmat[body].reshape(3, 3) @ [0.1, -0.05, 0.2]
    mujoco.mj_jac(model, before, jacp, jacr, point, body)
    expected = 2.0 * jacp.T @ jacp + 0.01 * jacr.T @ jacr
    np.testing.assert_allclose(mass[1] - mass[0], expected, atol=1e-10)


def imported(file: Path) -> set[str]:
    """Every module that a file imports, anywhere in it, by its whole name."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return names


@pytest.mark.parametrize("folder", ["worlds", "exam"])
def test_worlds_and_their_examiner_share_no_code_with_the_package(folder):
    """Nor do they import what does: they use each other, and no other folder of the benchmarks."""
    for file in (ROOT / "benchmarks" / folder).rglob("*.py"):
        for name in imported(file):
            first, *more = name.split(".")
            assert first not in ("jax", "jaxlib", "jax_inertia"), file
            assert first != "benchmarks" or more[:1] in ([], ["worlds"], ["exam"]), file
