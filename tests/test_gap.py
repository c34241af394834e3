"""The diagnosis on small logs made by MuJoCo C, effects in forms of its own; nothing of the generator's code."""

import mujoco
import numpy as np
import pytest

from jax_inertia import load_model
from jax_inertia.gap import Verdict, diagnose
from jax_inertia.gap.families import LIBRARY, NAMES
from jax_inertia.gap.report import to_report
from jax_inertia.log import Log, TorqueKind

ARM = """
<mujoco><option gravity="0 0 -9.81" timestep="0.0005" integrator="RK4"/>
<worldbody><body name="upper"><joint name="shoulder" axis="0 1 0" damping="0.3" armature="0.05"/>
<inertial mass="2.0" pos="0 0 -0.2" fullinertia="0.02 0.02 0.004 0 0.001 0"/>
<body name="lower" pos="0 0 -0.4"><joint name="elbow" axis="0 1 0.3" damping="0.2" armature="0.03"/>
<inertial mass="1.2" pos="0.02 0 -0.15" fullinertia="0.01 0.01 0.002 0 0 0.0005"/></body></body></worldbody></mujoco>
"""


def wave(t, seed):
    """A smooth wide motion (position, velocity) of both joints."""
    rng = np.random.default_rng(seed)
    frequency, phase = rng.uniform(0.15, 0.9, (4, 2)), rng.uniform(0, 6.28, (4, 2))
    size = np.array([0.6, 0.9]) * 2 / (1 + 2 * frequency)
    angle = 2 * np.pi * frequency * t + phase
    q = np.sum(size * np.sin(angle), axis=0)
    return q, np.sum(size * 2 * np.pi * frequency * np.cos(angle), axis=0)


def simulate(torque, edit=lambda model: None, seed=0, seconds=8.0, noise=1.0):
    """A log of the arm under PD control, with `torque(t, q, v, u)` acting beside the logged u."""
    model = mujoco.MjModel.from_xml_string(ARM)
    edit(model)
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = wave(0.0, seed)
    rng = np.random.default_rng(seed + 100)
    rows = {"time": [], "qpos": [], "tau": []}
    for _ in range(round(seconds * 500)):
        target, speed = wave(data.time, seed)
        u = np.array([60.0, 40.0]) * (target - data.qpos) + np.array([6.0, 3.0]) * (
            speed - data.qvel
        )
        rows["time"].append(data.time)
        rows["qpos"].append(data.qpos + noise * 2e-5 * rng.standard_normal(2))
        rows["tau"].append(u + noise * np.array([0.03, 0.01]) * rng.standard_normal(2))
        for _ in range(4):
            data.qfrc_applied[:] = u + torque(data.time, data.qpos, data.qvel, u)
            mujoco.mj_step(model, data)
    return Log(
        time=np.array(rows["time"]),
        joint_names=("shoulder", "elbow"),
        qpos=np.array(rows["qpos"]),
        tau=np.array(rows["tau"]),
        tau_kind=TorqueKind.COMMANDED,
        sigma_qpos=np.full(2, noise * 2e-5),
        sigma_tau=noise * np.array([0.03, 0.01]),
    )


def nothing(t, q, v, u):
    return np.zeros(2)


@pytest.fixture(scope="module")
def robot():
    return load_model(mujoco.MjModel.from_xml_string(ARM))


def test_a_true_model_has_no_gap(robot):
    found = diagnose(robot, simulate(nothing))
    assert found.verdict is Verdict.NO_GAP
    assert found.findings == ()


def test_viscous_friction_is_named_placed_and_sized(robot):
    log = simulate(lambda t, q, v, u: np.array([0.0, -0.15 * v[1]]))
    other = simulate(lambda t, q, v, u: np.array([0.0, -0.15 * v[1]]), seed=5, seconds=6.0)
    found = diagnose(robot, log, test_log=other)
    assert found.verdict is Verdict.EXPLAINED
    (effect,) = found.findings
    assert (effect.family, effect.place.name) == ("viscous_friction", "elbow")
    assert effect.parameters["damping"].value == pytest.approx(0.15, rel=0.05)
    assert found.heldout.share > 0.8
    assert found.test is not None
    assert found.test.share > 0.8


def test_dry_friction_with_another_law(robot):
    # A bristle of its own: deflection saturating over 0.5 mrad, not the library's sign.
    state = np.zeros(1)

    def torque(t, q, v, u):
        state[0] = np.clip(state[0] + v[0] * 0.0005 / 5e-4, -1, 1)
        return np.array([-0.6 * state[0], 0.0])

    found = diagnose(robot, simulate(torque))
    assert found.findings[0].family in ("coulomb_friction", "stribeck_friction")
    assert found.findings[0].place.name == "shoulder"


def test_payload_is_found_on_its_body(robot):
    def edit(model):
        # 0.4 kg at (0, 0, -0.3) of the lower arm.
        m, c = model.body_mass[2], model.body_ipos[2].copy()
        extra, at = 0.4, np.array([0.0, 0.0, -0.3])
        new = (m * c + extra * at) / (m + extra)
        rotation = np.zeros(9)
        mujoco.mju_quat2Mat(rotation, model.body_iquat[2])
        r = rotation.reshape(3, 3)
        inertia = r @ np.diag(model.body_inertia[2]) @ r.T
        for mass, point in ((m, c), (extra, at)):
            d = point - new
            inertia += mass * (d @ d * np.eye(3) - np.outer(d, d))
        values, axes = np.linalg.eigh(inertia)
        axes[:, 2] *= np.sign(np.linalg.det(axes))
        quat = np.zeros(4)
        mujoco.mju_mat2Quat(quat, axes.ravel())
        model.body_mass[2], model.body_ipos[2] = m + extra, new
        model.body_inertia[2], model.body_iquat[2] = values, quat

    found = diagnose(robot, simulate(nothing, edit))
    effect = found.findings[0]
    names = {
        (effect.family, effect.place.name),
        *((t.family, t.place.name) for t in effect.equivalent),
    }
    assert ("payload", "lower") in names
    if effect.family == "payload":
        assert effect.parameters["mass"].value == pytest.approx(0.4, rel=0.1)


def test_excluded_families_are_not_found(robot):
    log = simulate(lambda t, q, v, u: np.array([0.0, -0.15 * v[1]]))
    found = diagnose(robot, log, exclude=["viscous_friction"])
    assert all(f.family != "viscous_friction" for f in found.findings)
    with pytest.raises(ValueError, match="valid: actuator_lag"):
        diagnose(robot, log, exclude=["viscosity"])


def test_report_is_plain_json(robot):
    import json

    report = to_report(diagnose(robot, simulate(lambda t, q, v, u: np.array([0.5, 0.0]))))
    text = json.dumps(report, allow_nan=False)
    assert json.loads(text)["schema"] == 1
    assert report["effects"][0]["location"] == {"kind": "joint", "name": "shoulder"}


def test_every_family_has_an_equation_and_a_name():
    assert len(set(NAMES)) == len(LIBRARY) == 26
    assert all(f.equation for f in LIBRARY)


def test_too_short_a_log_is_refused(robot):
    log = simulate(nothing, seconds=1.0)
    with pytest.raises(ValueError, match="at least 100 are needed"):
        diagnose(robot, log)
