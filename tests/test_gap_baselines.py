"""Baselines of the gap diagnosis: their columns against MuJoCo, what they find in logs made by inverse dynamics."""

from __future__ import annotations

import ast
import json
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest

GAP = Path(__file__).parents[1] / "benchmarks" / "gap"
sys.path.insert(0, str(GAP))

import baseline_sysid  # noqa: E402
import baselines  # noqa: E402
import beside  # noqa: E402
import evaluate  # noqa: E402
from baseline_chain import Residual, body_pi  # noqa: E402
from baseline_guesses import guesses  # noqa: E402
from robots import ROBOTS  # noqa: E402

RATE, SECONDS = 500.0, 6.0


def record(true: mujoco.MjModel, seed: int = 0) -> dict[str, np.ndarray]:
    """A log of smooth random motion on a fixed base, its torque what `true` needs."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, SECONDS, 1.0 / RATE)[:, None, None]
    w = 2 * np.pi * rng.uniform(0.2, 1.0, (1, true.nv, 4))
    size, phase = rng.uniform(0.1, 0.3, w.shape), rng.uniform(0, 2 * np.pi, w.shape)
    q, v, a = (
        x.sum(axis=2)
        for x in (
            size * np.sin(w * t + phase),
            size * w * np.cos(w * t + phase),
            -size * w**2 * np.sin(w * t + phase),
        )
    )
    data, tau = mujoco.MjData(true), np.empty_like(v)
    for k in range(len(q)):
        data.qpos[:], data.qvel[:], data.qacc[:] = q[k], v[k], a[k]
        mujoco.mj_inverse(true, data)
        tau[k] = data.qfrc_inverse
    names = [true.joint(j).name for j in range(true.njnt)]
    return {"time": t[:, 0, 0], "qpos": q, "tau": tau, "joint_names": np.array(names)}


@pytest.fixture(scope="module")
def viscous() -> Residual:
    """A 2-link arm whose second joint has 0.3 N m s/rad more than its model."""
    true = ROBOTS["arm2"]().model()
    true.dof_damping[1] += 0.3
    return Residual(ROBOTS["arm2"]().model(), record(true))


def places(effects: list[dict]) -> list[tuple[str, str]]:
    return [(e["family"], e["location"]["name"]) for e in effects]


def test_body_columns_are_mujoco_s_inverse_dynamics():
    """Regressor times π, plus what belongs to the joints; forces at centres of mass do the work that they should."""
    nominal = ROBOTS["arm7"]().model()
    nominal.dof_frictionloss[:] = 0.0
    r = Residual(
        nominal, {k: x[:300] if x.ndim and len(x) > 9 else x for k, x in record(nominal).items()}
    )
    bodies = r.bodies()
    regressor, rows, speed = r.body_columns(list(bodies.values()))
    pi = np.stack([body_pi(nominal, b) for b in bodies.values()])
    needed = (
        np.einsum("tjbp,bp->tj", regressor, pi)
        + nominal.dof_damping * r.v
        + nominal.dof_armature * r.a
    )
    np.testing.assert_allclose(needed, r.inverse, rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(np.einsum("tjbc,tj->tbc", rows, r.v), speed, atol=1e-12)


def test_without_an_effect_little_is_missing():
    nominal = ROBOTS["arm2"]().model()
    r = Residual(nominal, record(nominal))
    assert np.sqrt(np.mean(r.y**2)) < 2e-3 * np.abs(r.tau).max()


def heavier_rotor(m: mujoco.MjModel) -> None:
    m.dof_armature[0] += 0.03


def wider_link(m: mujoco.MjModel) -> None:
    m.body_inertia[m.body("link2").id] *= 1.5


def shifted_link(m: mujoco.MjModel) -> None:
    m.body_ipos[m.body("link2").id, 2] += 0.03


def leaning(m: mujoco.MjModel) -> None:
    m.opt.gravity[0] = -9.81 * 0.02


@pytest.mark.parametrize(
    ("change", "family", "name", "parameter", "value"),
    [
        (heavier_rotor, "armature", "joint1", "armature", 0.03),
        (wider_link, "link_inertia", "link2", "inertia_scale", 1.5),
        (shifted_link, "com_shift", "link2", "com_shift_z", 0.03),
        (leaning, "gravity_tilt", "global", "tilt_y", 0.02),
    ],
)
def test_a_small_effect_lies_along_its_own_column(change, family, name, parameter, value):
    true = ROBOTS["arm2"]().model()
    change(true)
    r = Residual(ROBOTS["arm2"]().model(), record(true))
    (guess,) = [g for g in guesses(r) if (g.family, g.name) == (family, name)]
    columns = guess.columns.reshape(r.y.size, -1)
    theta = np.linalg.lstsq(columns, r.y.ravel(), rcond=1e-9)[0]
    left = r.y.ravel() - columns @ theta
    assert np.sum(left**2) < 0.02 * np.sum(r.y**2)
    assert guess.effect(theta)["parameters"][parameter]["value"] == pytest.approx(value, rel=0.1)


def test_each_finds_viscous_friction_as_far_as_it_can(viscous):
    greedy = baselines.greedy_bic(viscous)
    assert places(greedy)[0] == ("viscous_friction", "joint2")
    assert greedy[0]["parameters"]["damping"]["value"] == pytest.approx(0.3, rel=0.05)
    pace = baselines.pace_like(viscous)
    assert places(pace)[0] == ("viscous_friction", "joint2")
    assert pace[0]["parameters"]["damping"]["value"] == pytest.approx(0.3, rel=0.05)
    assert places(baselines.largest_residual(viscous)) == [("coulomb_friction", "joint2")]


def test_a_late_torque_is_the_delay_of_the_all_at_once_fit():
    true = ROBOTS["arm2"]().model()
    log = record(true)
    late = round(0.012 * RATE)
    log["tau"] = np.concatenate([log["tau"][late:], np.repeat(log["tau"][-1:], late, axis=0)])
    effect = baselines.pace_like(Residual(ROBOTS["arm2"]().model(), log))[0]
    assert effect["family"] == "time_delay"
    assert effect["parameters"]["delay"]["value"] == pytest.approx(0.012, abs=1.1e-3)


def test_they_are_scored_like_a_diagnosis(viscous, tmp_path):
    true = {
        "family": "viscous_friction",
        "location": {"kind": "joint", "name": "joint2"},
        "parameters": {"damping": {"value": 0.3, "unit": "N m s/rad"}},
    }
    truth = {
        "effects": [true],
        "robot": "arm2",
        "motion": {"log": "exciting"},
        "noise_factor": 1,
        "verdict": "explained",
    }
    row = evaluate.compare(truth, baselines.as_report(baselines.greedy_bic(viscous)[:1]))
    assert row["right"]
    assert row["parameters"][0]["error"] < 0.05
    row = evaluate.compare(truth, baselines.as_report(baselines.largest_residual(viscous)))
    assert row["place"]
    assert not row["right"]
    json.dumps(row)


def test_nothing_of_the_package_under_test_is_imported():
    for path in GAP.glob("baseline*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            modules = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom):
                modules = [node.module or ""]
            assert not any(m.split(".")[0] in ("jax", "jax_inertia") for m in modules), path.name


@pytest.mark.skipif(not baseline_sysid.AVAILABLE, reason="needs mujoco[sysid]")
@pytest.mark.parametrize(
    ("family", "name", "x", "reported"),
    [
        ("viscous_friction", "joint2", [0.4], {"damping": 0.29}),
        ("armature", "joint1", [0.3], {"armature": 0.225}),
        pytest.param(
            "joint_spring", "joint1", [3.0, 0.2], {"stiffness": 3.0}, marks=pytest.mark.slow
        ),
        ("torque_gain", "joint2", [0.9], {"gain": 0.9}),
        ("torque_bias", "joint1", [1.5], {"bias": 1.5}),
        pytest.param(
            "payload", "link2", [0.5, 0.0, 0.0, -0.3], {"mass": 0.5}, marks=pytest.mark.slow
        ),
        ("com_shift", "link2", [0.0, 0.0, 0.02], {"com_shift_z": 0.02}),
        ("link_inertia", "link2", [1.6], {"inertia_scale": 1.6}),
        ("gravity_tilt", "global", [0.0, 0.03], {"tilt_y": 0.03}),
    ],
)
def test_sysid_recovers_what_it_is_told_to_fit(tmp_path, family, name, x, reported):
    (tmp_path / "nominal.xml").write_text(ROBOTS["arm2"]().xml)
    spec = mujoco.MjSpec.from_string(ROBOTS["arm2"]().xml)
    wanted = baseline_sysid.knob(spec, spec.compile(), family, name)
    assert wanted is not None
    wanted.write(spec, np.array(x))
    true = spec.compile()
    log = record(true)
    if family in ("torque_gain", "torque_bias"):
        # What the drive was told: gain · told + bias acts.
        gain, bias = true.actuator_gainprm[:, 0], true.actuator_biasprm[:, 0]
        log["tau"] = (log["tau"] - bias) / gain
    np.savez(tmp_path / "log.npz", **log)
    result = baseline_sysid.fit(tmp_path, family, "joint", name)
    assert result is not None
    for parameter, value in reported.items():
        assert result[0]["parameters"][parameter]["value"] == pytest.approx(value, rel=0.05)


def test_vectors_are_scored_by_length_and_covered_whole():
    parameters = {"com_shift": {"value": [0.0, 0.03, -0.04], "unit": "m"}}
    place = {"kind": "body", "name": "link2"}
    truth = {"effects": [{"family": "com_shift", "location": place, "parameters": parameters}]}
    found = effect_of("com_shift", place, com_shift_x=0.0, com_shift_y=0.03, com_shift_z=-0.035)
    (score,) = evaluate._parameters(truth, {"effects": [found]})
    assert score["error"] == pytest.approx(0.1)
    assert not score["covers"]
    found["parameters"]["com_shift_z"]["ci95"] = [-0.05, -0.03]
    assert evaluate._parameters(truth, {"effects": [found]})[0]["covers"]


def effect_of(family: str, place: dict, **values: float) -> dict:
    """An effect of a report whose intervals are a millionth wide."""
    numbers = {n: {"value": x, "ci95": [x - 1e-6, x + 1e-6]} for n, x in values.items()}
    return {"family": family, "location": place, "parameters": numbers}


def test_the_table_holds_every_method_and_skips_logs_that_failed():
    row = {"stratum": "exciting", "seconds": 2.0, "found": [["a", "b"]], "verdict": "explained"}
    row |= {"family": True, "place": True, "right": False, "parameters": []}
    scores = dict.fromkeys(baselines.BASELINES, row)
    text = beside.table([{**row, "others": scores}, {"error": "x"}], evaluate.wilson)
    for name in (beside.OURS, *baselines.BASELINES):
        assert f"| exciting | {name} |" in text
    failed = {**row, "others": {"baselines": {"error": "no"}}}
    assert "| – |" in beside.table([failed], evaluate.wilson)
