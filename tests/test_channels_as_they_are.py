"""Channels as drives and loggers spoil them, and targets in other words than positions."""

import dataclasses
import re

import jax.numpy as jnp
import numpy as np
import pytest

import jax_inertia as ji
from jax_inertia.logs.log import LogError, TorqueUnit
from jax_inertia.logs.log_files import read_log, write_log
from jax_inertia.logs.readers import Options
from jax_inertia.preflight.position_targets import position_targets
from jax_inertia.preflight.preflight import preflight
from jax_inertia.robots.pendulum import double_pendulum, swing


def saved(path, **changes):
    """The arrays of a swing, some changed, as a logger writes them."""
    write_log(swing(), path)
    with np.load(path) as file:
        arrays = {**file} | changes
    np.savez(path, **arrays)
    return path


def test_a_register_without_its_sign_is_read_as_signed(tmp_path):
    counts = np.round(np.asarray(swing().tau) * 20)
    path = saved(
        tmp_path / "log.npz", tau=np.where(counts < 0, counts + 65536, counts), tau_unit="counts"
    )
    log = read_log(path)
    np.testing.assert_array_equal(log.tau, counts)
    assert any("tau jumps by 65536 about 0" in note for note in log.notes)
    # Large numbers that do not jump are numbers.
    steady = 60000 + counts - counts.min()
    np.testing.assert_array_equal(read_log(saved(path, tau=steady, tau_unit="counts")).tau, steady)


@pytest.mark.parametrize("period", [0.004, 0.0071])
def test_rounded_stamps_are_spread(tmp_path, period):
    count = len(swing().time)
    true = 1.7e9 + period * np.arange(count)
    log = read_log(saved(tmp_path / "log.npz", time=np.round(true, 2)))
    np.testing.assert_allclose(log.time - true[0], true - true[0], atol=0.005)
    np.testing.assert_allclose(np.diff(log.time), period, rtol=0.01)
    assert any("were spread evenly" in note for note in log.notes)
    # A clock that stops is no rounding.
    stopped = np.where(np.arange(count) > count // 2, true[count // 2], true)
    with pytest.raises(LogError, match="stamps must strictly increase"):
        read_log(saved(tmp_path / "log.npz", time=stopped))


def test_seconds_since_1970_in_single_precision_are_named(tmp_path):
    stamps = (1.7e9 + np.asarray(swing().time)).astype(np.float32)
    with pytest.raises(LogError, match="stamps are float32: steps of 128 s"):
        read_log(saved(tmp_path / "log.npz", time=stamps))


def following(change=lambda q, target: target):
    """A loop that follows its targets 40 ms behind, and its targets in other words."""
    time = 0.01 * np.arange(1500)
    rng = np.random.default_rng(3)
    waves = sum(a * np.sin(w * time[:, None] + p) for a, w, p in rng.uniform(0.2, 1.5, (5, 3, 3)))
    target, q = waves[4:], waves[:-4] + 0.02
    log = dataclasses.replace(
        swing(),
        time=jnp.asarray(time[4:]),
        qpos=jnp.asarray(q),
        qvel=None,
        tau=None,
        joint_names=("a", "b", "c"),
        qpos_target=jnp.asarray(change(q, target)),
    )
    return log, [f.message for f in position_targets(log)]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda q, target: target, None),
        (lambda q, target: (target - 0.3) / 0.25, r"a follows 0\.2\d+ qpos_target"),
        (
            lambda q, target: np.degrees(target),
            "0.01745 times its targets: qpos_target is in degrees",
        ),
        (lambda q, target: target - q, "targets are differences from the position"),
        (
            lambda q, target: target[:, [1, 0, 2]],
            "a follows the targets of b; b follows the targets of a",
        ),
    ],
)
def test_targets_in_other_words(change, said):
    _, messages = following(change)
    if said is None:
        assert messages == []
    else:
        (message,) = messages

        assert re.search(said, message)


def test_counts_of_an_encoder_are_refused_and_the_printed_options_read_them(tmp_path):
    log = swing()
    counts = np.round(np.asarray(log.qpos) / (2 * np.pi) * 4096 + 2048)
    path = saved(tmp_path / "log.npz", qpos=counts)
    found = preflight(read_log(path), ji.load_model(double_pendulum()))
    (message,) = [f.message for f in found.findings if f.check == "counts"]
    assert "--position-scale" in message
    assert "--position-zero" in message
    options = Options(position_scale={"": 2 * np.pi / 4096}, position_zero={"": 2048})
    np.testing.assert_allclose(read_log(path, options=options).qpos, log.qpos, atol=1e-3)
    with pytest.raises(LogError, match="no joint 'wrist' to scale"):
        read_log(path, options=Options(position_scale={"wrist": 1.0}))


@pytest.mark.slow
def test_torques_with_turned_signs_are_weighed_by_negative_gains():
    """The remedy that a refusal prints for turned signs."""
    log = swing()
    turned = dataclasses.replace(
        log, tau=-log.tau, tau_unit=TorqueUnit.UNKNOWN, tau_unit_text="turned"
    )
    robot = ji.load_model(double_pendulum())
    found = ji.estimate(robot, turned, ["lower"], gains=-1.0)
    right = ji.estimate(robot, log, ["lower"])
    np.testing.assert_allclose(found.fit.robot.pi, right.fit.robot.pi, rtol=1e-4)
    assert np.all(found.noise > 0)
