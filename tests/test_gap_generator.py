"""The development generator of the diagnosis: its plant, its effects, its files."""

from __future__ import annotations

import ast
import dataclasses
import json
import subprocess
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest

GAP = Path(__file__).parents[1] / "benchmarks" / "gap"
sys.path.insert(0, str(GAP))

import effects as fx  # noqa: E402
import friction as fr  # noqa: E402
import generate  # noqa: E402
import spec as sp  # noqa: E402
import twomass as tm  # noqa: E402
import unknowns as un  # noqa: E402
from check import residual  # noqa: E402
from plant import Noise, Plant  # noqa: E402
from robots import ROBOTS  # noqa: E402
from strata import ARM, LEGGED, STRATA, UNKNOWN  # noqa: E402

CONTRACT = {
    *("time", "joint_names", "qpos", "qvel", "tau", "tau_kind", "tau_command", "qpos_target"),
    *("sigma_qpos", "sigma_tau", "base_pos", "base_quat", "base_linvel", "base_angvel"),
    *("contact_wrench", "contact_bodies"),
}


def short(robot: str, index: int = 0, **changes) -> sp.Spec:
    """A log of about a second, without noise and with an exact model."""
    stratum = STRATA["legged" if robot == "quadruped" else "exciting"]
    while (spec := sp.draw_spec(stratum, 5, index)).robot.name != robot:
        index += 1
    # A leg's motion fades in over the last second before the log; an arm's is there from the start.
    preroll = spec.preroll if spec.robot.floating else 0.4
    changes = {"wrong": False, "rate": 500, "duration": 0.8, "preroll": preroll} | changes
    return dataclasses.replace(spec, **changes)


def gap(spec: sp.Spec, effects: list[fx.Effect]) -> np.ndarray:
    """Root mean square (nv) of the low-passed residual of the nominal model, where in motion."""
    log = sp.simulate(spec, effects, 0, spec.duration)
    r, moving = residual(spec.robot, spec.robot.model(), log)
    return np.sqrt((np.where(moving, r, 0.0) ** 2).mean(0))


@pytest.fixture(scope="module")
def arm() -> sp.Spec:
    return short("arm7")


@pytest.fixture(scope="module")
def floor(arm) -> np.ndarray:
    return gap(arm, [])


@pytest.mark.parametrize("name", ROBOTS)
def test_without_effects_the_nominal_model_explains_the_log(name):
    spec = short(name, rate=1000)
    log = sp.simulate(spec, [], 0, spec.duration)
    r, moving = residual(spec.robot, spec.robot.model(), log)
    r = np.where(moving, r, 0.0)
    assert moving.sum() > 0.2 * moving.size
    scale = np.abs(log["tau"]).max()
    assert np.abs(r).max() < (2e-3 if spec.robot.floating else 5e-4) * scale


def test_known_friction_as_bristles_is_no_gap(arm):
    seen = gap(dataclasses.replace(arm, presliding=2e-4), [])
    assert np.all(seen < 5e-4 * 30.0)


def test_forward_and_inverse_dynamics_agree_at_a_dense_state(arm):
    rng = np.random.default_rng(0)
    plant = Plant(arm.robot, arm.robot.model(), [])
    bare = arm.robot.model()
    plant.model.dof_frictionloss[:] = bare.dof_frictionloss[:] = 0.0
    data = mujoco.MjData(bare)
    tau = rng.normal(size=7)
    plant.data.qpos[:], plant.data.qvel[:] = rng.normal(size=(2, 7))
    plant._accelerate(0.0, tau)
    data.qpos[:], data.qvel[:], data.qacc[:] = plant.q, plant.v, plant.a
    mujoco.mj_inverse(bare, data)
    np.testing.assert_allclose(data.qfrc_inverse, tau, atol=1e-9)


def test_the_integrator_is_of_second_order():
    spec = short("arm2", index=3)
    ends = []
    for dt in (2e-3, 1e-3, 0.5e-3, 0.0625e-3):
        model = spec.robot.model()
        model.dof_frictionloss[:] = 0.0
        plant = Plant(spec.robot, model, [])
        plant.data.qpos[:] = 0.7, -0.4
        for k in range(round(0.2 / dt)):
            plant._step(k * dt, dt, np.array([1.0, 0.3]))
        ends.append(plant.q.copy())
    errors = [np.abs(e - ends[-1]).max() for e in ends[:3]]
    assert 3.5 < errors[0] / errors[1] < 4.5
    assert 3.5 < errors[1] / errors[2] < 4.5


JOINT = {
    "viscous_friction": lambda j: fr.ViscousFriction("joint", j, {"damping": 1.0}),
    "coulomb_friction": lambda j: fr.CoulombFriction(
        "joint", j, {"coulomb": 1.0, "presliding": 3e-4}
    ),
    "asymmetric_coulomb": lambda j: fr.AsymmetricCoulomb(
        "joint", j, {"positive": 1.0, "negative": 0.4, "presliding": 3e-4}
    ),
    "stribeck_friction": lambda j: fr.StribeckFriction(
        "joint",
        j,
        {"coulomb": 0.5, "stiction": 1.0, "stribeck_velocity": 0.1, "presliding": 3e-4},
    ),
    "load_friction": lambda j: fr.LoadFriction(
        "joint", j, {"coulomb": 0.3, "load_coefficient": 0.1, "presliding": 3e-4}
    ),
    "friction_drift": lambda j: fr.FrictionDrift(
        "joint", j, {"damping": 1.5, "damping_end": 0.0, "time_constant": 3.0}
    ),
    "armature": lambda j: fx.Armature("joint", j, {"armature": 0.4}),
    "joint_spring": lambda j: fr.JointSpring("joint", j, {"stiffness": 3.0, "rest_angle": 0.0}),
    "cogging": lambda j: fr.Cogging(
        "joint", j, {"amplitude": 0.8, "frequency": 10.0, "phase": 0.2}
    ),
    "torque_gain": lambda j: fx.TorqueGain("joint", j, {"gain": 0.9}),
    "torque_bias": lambda j: fx.TorqueBias("joint", j, {"bias": 1.0}),
    "torque_saturation": lambda j: fx.TorqueSaturation("joint", j, {"limit": 14.0}),
    "time_delay": lambda j: fx.TimeDelay("joint", j, {"delay": 0.0123}),
    "actuator_lag": lambda j: fx.ActuatorLag("joint", j, {"time_constant": 0.015}),
    "quadratic_friction": lambda j: un.QuadraticFriction("joint", j, {"coefficient": 1.5}),
    "joint_coupling": lambda j: un.JointCoupling("joint", j, {"coefficient": 1.0}),
    "load_ripple": lambda j: un.LoadRipple(
        "joint", j, {"coefficient": 0.1, "frequency": 4.0, "phase": 0.1}
    ),
    "stop_cushion": lambda j: un.StopCushion(
        "joint", j, {"stiffness": 5.0, "onset": -2.5, "side": 1.0}
    ),
}


@pytest.mark.parametrize("family", JOINT)
def test_an_effect_of_a_joint_shows_there_and_nowhere_else(family, arm, floor):
    seen = gap(arm, [JOINT[family]("joint4")])
    others = np.delete(seen - floor, 3)
    assert seen[3] > 0.05 + floor[3]
    assert np.all(others < 0.02 + 0.02 * seen[3])


BODY = {
    "payload": lambda b: fx.Payload("body", b, {"mass": 1.0, "com": [0.05, 0, 0.1], "size": 0.05}),
    "com_shift": lambda b: fx.ComShift("body", b, {"com_shift": [0.03, 0.02, 0.02]}),
    "link_inertia": lambda b: fx.LinkInertia("body", b, {"inertia_scale": 4.0}),
    "constant_force": lambda b: fx.ConstantForce("body", b, {"force": [8.0, 5.0, -9.0]}),
    "push": lambda b: fx.Push("body", b, {"force": [8.0, 9.0, 9.0], "start": 0.3, "end": 0.7}),
    "drag": lambda b: fx.Drag("body", b, {"coefficient": 40.0}),
    "length_error": lambda b: un.LengthError("body", b, {"extension": 0.04}),
}


@pytest.mark.parametrize("family", BODY)
def test_an_effect_of_a_body_shows_at_its_joint_or_before_never_beyond(family, arm, floor):
    seen = gap(arm, [BODY[family]("link4")])
    assert seen[:4].max() > 0.03 + floor[:4].max()
    assert np.all(seen[4:] < floor[4:] + 0.01)


@pytest.mark.parametrize(
    "effect",
    [
        fx.EncoderOffset("joint", "joint4", {"offset": 0.05}),
        fx.EncoderScale("joint", "joint4", {"scale": 0.02}),
        tm.JointElasticity("joint", "joint4", {"stiffness": 600.0}),
        tm.Backlash("joint", "joint4", {"dead_zone": 0.03, "stiffness": 4000.0}),
    ],
    ids=lambda e: e.family,
)
def test_what_hides_a_link_from_its_encoder_shows_from_there_inwards(effect, arm, floor):
    seen = gap(arm, [effect])
    assert seen[1] + seen[3] > 0.05 + floor[1] + floor[3]


def test_global_effects_show(arm, floor):
    tilt = fx.GravityTilt("global", "global", {"tilt": [0.03, 0.03]})
    skew = un.ClockSkew("global", "global", {"rate": -2e-2})
    assert gap(arm, [tilt]).max() > 0.3
    assert gap(arm, [skew]).max() > 2.0 * floor.max()


def test_every_family_of_the_strata_is_tested_here():
    here = {*JOINT, *BODY, "encoder_offset", "encoder_scale", "joint_elasticity", "backlash"}
    here |= {"gravity_tilt", "clock_skew", "contact_force_scale"}
    assert {*ARM, *LEGGED, *UNKNOWN} == here


def test_contact_force_scale_shows_in_the_base_rows():
    spec = short("quadruped")
    effect = fx.ContactForceScale("contact", "FL_foot", {"scale": 1.1})
    assert gap(spec, [effect])[2] > 2.0 > 10.0 * gap(spec, [])[2]


def test_a_delay_is_fractional_and_a_lag_is_first_order():
    delay = fx.TimeDelay("global", "global", {"delay": 0.00237})
    lag = fx.ActuatorLag("global", "global", {"time_constant": 0.02})
    dt, model = 2.5e-4, ROBOTS["arm2"]().model()
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


@pytest.mark.parametrize("xml", [ROBOTS["arm7"]().xml, OWN_AXES], ids=["arm7", "own_axes"])
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


@pytest.fixture
def quick(monkeypatch):
    """Short logs, so that whole files can be written in a test."""

    def draw(stratum, seed, index):
        spec = sp.draw_spec(stratum, seed, index)
        preroll = spec.preroll if spec.robot.floating else 0.4
        times = {"duration": 1.0, "test_duration": 0.5, "preroll": preroll}
        return dataclasses.replace(spec, rate=500, **times)

    monkeypatch.setattr(generate, "draw_spec", draw)


def prepare(out: Path) -> Path:
    for folder in ("logs", "truth"):
        (out / folder).mkdir(parents=True)
    return out


@pytest.mark.parametrize(("stratum", "index"), [("ordinary", 2), ("legged", 1), ("none", 0)])
def test_files_obey_the_contract_and_hold_no_truth(quick, tmp_path, stratum, index):
    out = prepare(tmp_path / "out")
    generate.write(out, stratum, 3, index)
    assert generate.write(out, stratum, 3, index) == "there already"
    folder = out / "logs" / f"{index:05d}"
    assert sorted(f.name for f in folder.iterdir()) == ["log.npz", "nominal.xml", "test.npz"]
    truth = json.loads((out / "truth" / f"{index:05d}.json").read_text())
    robot = ROBOTS[truth["robot"]]()
    assert (folder / "nominal.xml").read_text() == robot.xml
    assert truth["verdict"] == ("no_gap" if stratum == "none" else "explained")
    n = len(robot.joints)
    for name, seconds in (("log", 1.0), ("test", 0.5)):
        log = np.load(folder / f"{name}.npz", allow_pickle=False)
        rows = round(seconds * truth["rate_hz"])
        assert set(log.files) <= CONTRACT
        assert sorted(log["joint_names"]) == sorted(robot.joints)
        assert log["qpos"].shape == log["tau"].shape == (rows, n)
        assert np.all(np.diff(log["time"]) > 0)
        assert str(log["tau_kind"]) in ("commanded", "current", "sensor")
        assert all(np.all(np.isfinite(log[k])) for k in log.files if log[k].dtype.kind == "f")
        if robot.floating:
            assert log["contact_wrench"].shape == (rows, 4, 6)
            np.testing.assert_allclose(np.linalg.norm(log["base_quat"], axis=1), 1.0, atol=1e-9)


def test_a_log_depends_on_its_seed_and_index_alone(quick, tmp_path):
    outs = [prepare(tmp_path / name) for name in ("a", "b", "c")]
    generate.write(outs[0], "exciting", 3, 1)
    generate.write(outs[1], "exciting", 3, 1)
    generate.write(outs[2], "exciting", 4, 1)
    logs = [np.load(out / "logs" / "00001" / "log.npz") for out in outs]
    assert all(np.array_equal(logs[0][k], logs[1][k]) for k in logs[0].files)
    truths = [(out / "truth" / "00001.json").read_text() for out in outs]
    assert truths[0] == truths[1] != truths[2]
    assert logs[0]["tau"].shape != logs[2]["tau"].shape or not np.array_equal(
        logs[0]["tau"], logs[2]["tau"]
    )


def test_noise_has_the_size_that_the_log_states():
    spec = short("arm7", rate=1000, loud=True)
    spec.options |= {"shuffle": False, "sigma": True, "tau_kind": "current"}
    spec.noise = sp.draw_noise(spec, np.full(7, 20.0))
    log = sp.simulate(spec, [], 0, 1.0)
    out = sp.to_contract(spec, log, 1.0)
    for name in ("qpos", "tau"):
        error = (out[name] - log[name][:1000]).std(0)
        np.testing.assert_allclose(error, out[f"sigma_{name}"], rtol=0.1)
    assert not np.any(Noise.none(7).tau)


def imported(file: Path) -> set[str]:
    """First names of everything that a file imports, anywhere in it."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names.add(node.module.split(".")[0])
    return names


def test_the_generator_shares_no_code_with_the_package():
    # Scorers may live beside the generator; what generate.py reaches must stay apart.
    todo, seen = {"generate"}, set()
    while todo:
        name = todo.pop()
        seen.add(name)
        found = imported(GAP / f"{name}.py")
        assert not found & {"jax_inertia", "jax"}, name
        todo |= {n for n in found if (GAP / f"{n}.py").exists()} - seen
    assert {"plant", "effects", "friction", "twomass", "unknowns"} <= seen
    code = "import sys, generate; sys.exit('jax_inertia' in sys.modules or 'jax' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], cwd=GAP, check=False).returncode == 0
