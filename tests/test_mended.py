"""What nobody measured is left out by name, and velocities that contradict positions: arms by MuJoCo C, brakes on."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

import jax_inertia as ji
from benchmarks.harness import pickup_log
from benchmarks.harness.pickup_log import WRIST
from jax_inertia.estimation.inertial_filter import make_estimator
from jax_inertia.estimation.stream import Stream
from jax_inertia.logs.log import LogError
from jax_inertia.preflight.mended import mended

KIND, LOAD = "planar", 1.5
CASES = Path(__file__).parents[2] / "shared/cases"


def log(**kind) -> ji.Log:
    return pickup_log.picked_up(KIND, LOAD, seconds=6.0, seed=5, **kind)


def robot() -> ji.Robot:
    return ji.load_model(pickup_log.arm(KIND))


def braked(seconds: float = 1.0) -> ji.Log:
    """Standing still, drives off, before and after the motion."""
    whole = log()
    count, period = round(seconds / 0.005), 0.005
    first, last = (np.repeat(np.asarray(whole.qpos)[k][None], count, 0) for k in (0, -1))
    zero = np.zeros_like(first)
    return dataclasses.replace(
        whole,
        time=period * np.arange(len(whole.time) + 2 * count),
        qpos=np.concatenate([first, whole.qpos, last]),
        qvel=np.concatenate([zero, whole.qvel, zero]),
        tau=np.concatenate([zero, whole.tau, zero]),
    )


def test_brakes_are_named_and_left_out():
    one, found = mended(braked())
    assert [x.check for x in found] == ["brakes"]
    assert "drives are off" in found[0].message
    assert np.isfinite(one.tau).all()
    np.testing.assert_allclose(one.time[[0, -1]], [1.0, 6.995])
    np.testing.assert_array_equal(one.tau, log().tau)


def test_a_joint_that_turns_freely_is_no_brake():
    """A pendulum without drives: its torque is zero, and says so."""
    free = dataclasses.replace(log(), tau=np.zeros_like(log().tau))
    assert mended(free)[1] == ()
    moving = np.array(log().tau)
    moving[300:400] = 0.0
    assert mended(dataclasses.replace(log(), tau=moving))[1] == ()


@pytest.mark.parametrize("value", [1e224, -3e12, 5e-310])
def test_values_that_nobody_measured_are_masked(value):
    tau = np.array(log().tau)
    tau[77, 1] = value
    one, found = mended(dataclasses.replace(log(), tau=tau))
    assert [x.check for x in found] == ["absurd"]
    assert "'j1'" in found[0].message
    assert np.isnan(one.tau[77, 1])
    assert np.isnan(one.tau).sum() == 1


def low_passed(x: np.ndarray) -> np.ndarray:
    out = np.array(x)
    for k in range(1, len(out)):
        out[k] = out[k - 1] + 0.02 * (x[k] - out[k - 1])
    return out


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (lambda v: 0.0 * v, "zero"),
        (lambda v: v * 30 / np.pi, "rpm"),
        (lambda v: np.degrees(v), "degrees per second"),
        (low_passed, "dqpos/dt"),
    ],
)
@pytest.mark.slow
def test_velocities_that_contradict_positions_are_left_out(change, word):
    wrong = dataclasses.replace(log(), qvel=change(np.asarray(log().qvel)))
    one, found = mended(wrong)
    assert one.qvel is None
    assert word in found[0].message
    stream = Stream(make_estimator(robot(), [WRIST], sigma_tau=0.02), look=2.0)
    with pytest.raises(LogError, match="needs velocities"):
        list(stream.run([wrong]))


def test_right_velocities_stay_and_may_be_ignored():
    assert mended(log())[0].qvel is not None
    one, found = mended(log(), ["qvel"])
    assert one.qvel is None
    assert "ignored" in found[0].message
    with pytest.raises(LogError, match="only qvel can"):
        mended(log(), ["qpos"])


@pytest.mark.slow
def test_an_estimate_of_a_braked_log_with_velocities_in_rpm():
    """Both at once: what is left over weighs the load."""
    wrong = dataclasses.replace(braked(), qvel=np.asarray(braked().qvel) * 30 / np.pi)
    found = ji.estimate(robot(), wrong, [WRIST])
    checks = [x.check for x in found.findings]
    assert "brakes" in checks
    assert "qvel" in checks
    mass = float(found.pi[WRIST][0])
    assert abs(mass - pickup_log.own_mass(KIND) - LOAD) < 0.02
    assert not found.changed
    assert found.held_p[0] < 1e-6


@pytest.mark.parametrize("scale", [1e3, -1.0])
def test_a_stream_of_torques_in_another_unit_is_refused_on_its_first_seconds(scale):
    right = pickup_log.picked_up(KIND, 0.0, seconds=4.0, seed=5)
    wrong = dataclasses.replace(right, tau=scale * np.asarray(right.tau))
    chunks = [wrong.between(a, a + 0.9949) for a in (0.0, 1.0, 2.0, 3.0)]
    stream = Stream(make_estimator(robot(), [WRIST], sigma_tau=0.02), look=2.0)
    state = stream.start()
    for chunk in chunks[:2]:
        state, _ = stream.feed(state, chunk)
    with pytest.raises(LogError, match="tau"):
        stream.feed(state, chunks[2])


@pytest.mark.parametrize("name", ["degrees", "sign", "Nmm"])
def test_watch_refuses_what_estimate_refuses(name, capsys):
    from jax_inertia.cli.main import main

    file = CASES / f"watch/watch_{name}.csv"
    if not file.exists():
        pytest.skip(f"{file} is absent")
    model = str(CASES / "watch/exact.xml")
    argv = ["watch", str(file), "--model", model, "--bodies", "lower", "--idle", "0.05"]
    assert main(argv) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.count("\n") == 1
