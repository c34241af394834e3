"""What `benchmarks/real_logs/added.py` adds to a log, against closed forms, and how it counts what is said of it."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks" / "real_logs"))

import added_effects as effects
import added_report as page

PENDULUM = """<mujoco><worldbody><body name="first"><joint name="still" axis="0 0 1"/>
<inertial mass="1" pos="0 0 0" diaginertia="0.1 0.1 0.1"/>
<body name="rod"><joint name="hinge" axis="0 1 0"/>
<inertial mass="2" pos="0 0 -0.3" diaginertia="0.02 0.02 0.001"/></body></body></worldbody></mujoco>"""
HINGE = 1


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    model = tmp_path_factory.mktemp("added") / "model.xml"
    model.write_text(PENDULUM)
    time = np.arange(0.0, 6.0, 0.004)
    qpos = np.stack([0.0 * time, 0.8 * np.sin(3.0 * time) + 0.3 * np.sin(5.0 * time)], axis=1)
    tau = np.stack([9.0 * np.cos(time), 3.0 * np.sin(2.0 * time)], axis=1)
    return effects.Recording(model, time, qpos, tau)


def on_hinge(family, seed=0):
    rng = np.random.default_rng(seed)
    return effects.of_joint(family, "hinge", HINGE, rng)


def test_a_load_asks_for_its_weight_and_its_inertia(recording):
    rng = np.random.default_rng(3)
    load = effects.of_body("payload", "rod", 2, rng)
    com = np.array([0.0, 0.0, -0.3]) + np.random.default_rng(3).normal(0.0, 0.04, 3)
    q, a = recording.q[:, HINGE], recording.a[:, HINGE]
    x = com[0] * np.cos(q) + com[2] * np.sin(q)
    moment = com[0] ** 2 + com[2] ** 2 + 2e-3
    expected = 0.4 * (moment * a + 9.81 * -x)
    np.testing.assert_allclose(load.torque(recording, 0.4)[:, HINGE], expected, atol=1e-9)


def test_a_force_is_balanced_and_a_friction_resists(recording):
    direction = np.random.default_rng(5).normal(size=3)
    direction /= np.linalg.norm(direction)
    pull = effects.of_body("constant_force", "rod", 2, np.random.default_rng(5))
    q, (x, _, z) = recording.q[:, HINGE], 7.0 * direction
    expected = 0.3 * (np.cos(q) * x - np.sin(q) * z)
    np.testing.assert_allclose(pull.torque(recording, 7.0)[:, HINGE], expected, atol=1e-9)
    rubbed = on_hinge("coulomb_friction").torque(recording, 2.0)[:, HINGE]
    fast = (np.abs(recording.v[:, HINGE]) > 0.5) & (recording.time > 0.1)
    np.testing.assert_allclose(rubbed[fast], 2.0 * np.sign(recording.v[fast, HINGE]), atol=1e-3)


def test_drives_give_what_they_gave(recording):
    """A gain, a bias and a delay of the drive leave the torque that acts as it was."""
    tau, time = recording.tau[:, HINGE], recording.time
    for family, acts in (
        ("torque_gain", lambda e, logged: e.value(0.1) * logged),
        ("torque_bias", lambda e, logged: logged + e.value(0.1)),
        ("time_delay", lambda e, logged: np.interp(time - 0.1, time, logged)),
    ):
        effect = on_hinge(family)
        logged = tau + effect.torque(recording, 0.1)[:, HINGE]
        inner = (time > 0.2) & (time < 5.8)
        np.testing.assert_allclose(acts(effect, logged)[inner], tau[inner], atol=1e-4)


@pytest.mark.parametrize("family", [*effects.JOINT, *effects.BODY])
def test_a_size_is_as_loud_as_asked(recording, family):
    if family in effects.JOINT:
        effect = on_hinge(family)
    else:
        effect = effects.of_body(family, "rod", 2, np.random.default_rng(1))
    size = effects.sized(effect, recording, 0.05)
    loud = recording.below(effect.torque(recording, size))[:, HINGE]
    gap = recording.missing[:, HINGE]
    assert np.sqrt(np.mean(loud**2) / np.mean(gap**2)) == pytest.approx(0.05, rel=0.02)


def report(*effects_, verdict="partly"):
    return {
        "verdict": verdict,
        "effects": [
            {
                "family": family,
                "location": {"kind": "joint", "name": place},
                "parameters": {name: {"value": value, "ci95": None, "unit": "1"}},
                "equivalent": [
                    {"family": f, "location": {"kind": "joint", "name": p}} for f, p in twins
                ],
            }
            for family, place, name, value, *twins in effects_
        ],
    }


def row(tmp_path, said):
    answer = {
        "family": "torque_gain",
        "place": "elbow",
        "number": "gain",
        "value": 1.2,
        "ratio": 1.0,
    }
    (tmp_path / "answer.json").write_text(json.dumps(answer))
    (tmp_path / "seconds.json").write_text("3.0")
    own = report(("coulomb_friction", "wrist", "coulomb", 0.5))
    return page.Row.of("arm", tmp_path, said, own)


def test_only_what_is_new_counts_as_first(tmp_path):
    friction = ("coulomb_friction", "wrist", "coulomb", 0.6)
    found = row(tmp_path, report(friction, ("torque_gain", "elbow", "gain", 1.1)))
    assert found.listed
    assert found.first
    assert found.size == pytest.approx(0.5)
    other = row(tmp_path, report(("load_friction", "elbow", "x", 1.0, ("torque_gain", "elbow"))))
    assert (other.listed, other.first, other.in_set, other.place) == (False, False, True, True)
    nothing = row(tmp_path, report(friction))
    assert (nothing.listed, nothing.in_set, nothing.place, nothing.new) == (False, False, False, ())


def test_the_page_counts_every_log(tmp_path):
    rows = [
        row(tmp_path, report(("torque_gain", "elbow", "gain", 1.19))),
        row(tmp_path, report()),
    ]
    page.write(tmp_path, rows, 1, "a machine")
    text = (tmp_path / page.PAGE).read_text()
    assert "| all | 2 | 1 | 1 | 1 | 1 | 1 of 1 | 0 | 3 |" in text
    assert (tmp_path / page.FIGURE).stat().st_size > 1000
