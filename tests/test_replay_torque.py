"""Torque of a position loop as a second output of its replays."""

import dataclasses
import functools

import mujoco
import numpy as np
import pytest
from link_log import COUNT, KD, KP, LOOP, MODEL, logged, targets

import jax_inertia as ji
from jax_inertia.diagnosis.result import Verdict
from jax_inertia.logs.log import Log, TorqueKind
from jax_inertia.replay import checks
from jax_inertia.replay.command import of_the_loop, with_damping
from jax_inertia.replay.entry import left_to_torque, replayable
from jax_inertia.replay.fitting.errors import Weights
from jax_inertia.replay.fitting.fit import Fit
from jax_inertia.replay.loop import ALL, Parameter
from jax_inertia.replay.pipeline import diagnose
from jax_inertia.replay.record import record_of
from jax_inertia.replay.search import by_law
from jax_inertia.replay.search.held_out import carries_over, shown_in
from jax_inertia.replay.simulation.plant import Plant
from jax_inertia.replay.simulation.simulate import misses


def law(*, kp=KP, kd=KD, delay=0.0, limit=np.inf, bias=0.0, dead=0.0, seconds=6.0) -> Log:
    """A 1 kHz loop on a joint that moves as it likes, targets of 50 Hz: what the law says, and no dynamics."""
    time = np.arange(0, seconds, 1e-3)
    at = np.floor((time - delay + 1e-9) / 0.02) * 0.02

    def aim(t):
        return 0.4 * np.sin(2 * np.pi * 0.7 * t) + 0.2 * np.sign(np.sin(2 * np.pi * 0.45 * t + 1))

    q = 0.35 * np.sin(2 * np.pi * 0.7 * time - 0.5) + 0.1 * np.sin(2 * np.pi * 2.1 * time)
    v = (
        2
        * np.pi
        * (0.245 * np.cos(2 * np.pi * 0.7 * time - 0.5) + 0.21 * np.cos(2 * np.pi * 2.1 * time))
    )
    seen = np.round(q / COUNT) * COUNT
    miss = aim(np.maximum(at, 0.0)) - seen
    miss = miss - np.clip(miss, -dead, dead)
    tau = np.clip(kp * miss - kd * v + bias, -limit, limit)
    told = aim(np.floor((time + 1e-9) / 0.02) * 0.02)
    return logged(time, seen, told, tau)


def missed(log: Log, **numbers: float) -> float:
    """Error of the torque over what encoders and clocks leave, with numbers of the loop by family."""
    plant = Plant(mujoco.MjSpec.from_string(MODEL), log.joint_names, LOOP)
    record = record_of(log, LOOP, torque=True)
    table = tuple(Parameter(f, 0, np.nan, 1.0, -np.inf, np.inf) for f in numbers)
    error = misses(plant, table, np.array([list(numbers.values())]), record)[0][record.settled]
    return float(np.sqrt(np.mean(error**2)) / checks.torque_floor((record,), LOOP)[0])


@pytest.mark.parametrize(
    ("hidden", "numbers"),
    [
        ({}, {}),
        ({"kp": 24.0}, {"kp_scale": np.log(0.8)}),
        ({"kd": 1.2}, {"kd_scale": np.log(1.5)}),
        ({"delay": 0.013}, {"target_delay": 0.013}),
        ({"limit": 6.0}, {"torque_saturation": np.log(6.0)}),
        ({"bias": 0.5}, {"torque_bias": 0.5}),
        ({"dead": 0.03}, {"dead_band": 0.03}),
    ],
)
def test_the_torque_of_a_loop_is_that_of_its_numbers(hidden, numbers):
    log = law(**hidden)
    assert missed(log, **numbers) < 1.0
    if hidden:
        assert missed(log) > 4.0


def test_what_a_robot_does_to_positions_is_not_in_the_torques_error():
    """Numbers of the motion, and of motors that are weaker than the loop is told, leave it as it is."""
    log = law()
    sizes = {"armature": 0.05, "coulomb_friction": 0.5, "torque_gain": -0.3, "encoder_offset": 0.1}
    for family, size in sizes.items():
        assert missed(log, **{family: size}) == missed(log)


def test_which_torques_are_the_loops(tmp_path):
    log = law(kp=20.0, delay=0.02, limit=4.0)
    assert of_the_loop(log, LOOP)
    other = dataclasses.replace(log, tau=np.sin(9.0 * log.time)[:, None])
    assert not of_the_loop(other, LOOP)
    model = tmp_path / "link.xml"
    model.write_text(MODEL)
    assert replayable(model, [log])
    assert not replayable(model, [other])
    behind = dataclasses.replace(log, tau_kind=TorqueKind.SENSOR)
    assert not replayable(model, [behind])
    silent = dataclasses.replace(log, kp=None, kd=None)
    assert not replayable(model, [silent])
    assert replayable(model, [silent], kp=[KP])


def test_a_kd_that_nobody_says_is_the_torques():
    loop = LOOP._replace(kd=np.zeros(1))
    assert with_damping(loop, law(kd=1.1)).kd == pytest.approx([1.1], rel=0.05)
    assert with_damping(LOOP, law(kd=1.1)) is LOOP


def test_one_output_that_gains_may_not_cost_the_other():
    old = np.array([1.0, 1.0])
    assert carries_over(np.array([0.8, 1.0]), old, 0.98)
    assert carries_over(np.array([1.0, 0.8]), old, 0.98)
    assert not carries_over(np.array([0.5, 1.2]), old, 0.98)
    assert not carries_over(np.array([1.0, 1.0]), old, 0.98)


def run(*, gain=1.0, mass=0.0, lag=0.0, dry=0.0, seconds=8.0) -> Log:
    """The link by MuJoCo C at 0.5 ms, its motor `gain` times as strong as the loop believes, targets behind a lag."""
    m = mujoco.MjModel.from_xml_string(MODEL)
    m.opt.timestep = 5e-4
    m.body_mass[1] += mass
    m.body_inertia[1] *= 1.0 + mass
    m.dof_frictionloss[:] = dry
    d, told = mujoco.MjData(m), targets(seconds)
    d.qpos[:] = told[0]
    rows, tau, arrived = [], 0.0, told[0]
    keep = np.exp(-1e-3 / lag) if lag > 0 else 0.0
    for k in range(int(seconds / m.opt.timestep) - 40):
        t = k * m.opt.timestep
        if k % 2 == 0:
            seen = np.round(d.qpos[0] / COUNT) * COUNT
            arrived = keep * arrived + (1.0 - keep) * told[int((t + 1e-9) / 0.02)]
            tau = KP * (arrived - seen) - KD * d.qvel[0]
            rows.append((t, seen, told[int((t + 1e-9) / 0.02)], tau))
        d.qfrc_applied[:] = gain * tau - 0.1 * d.qvel
        mujoco.mj_step(m, d)
    return logged(*np.array(rows).T)


@pytest.mark.slow
def test_torque_tells_a_load_from_a_soft_loop():
    """A lone joint's load passes for a kp that is less, to positions; its torque says that kp is as said."""
    log = run(mass=0.4)
    found = diagnose([log], functools.partial(mujoco.MjSpec.from_string, MODEL))
    assert found.verdict is Verdict.EXPLAINED
    odd = [e for e in found.effects if not e.ordinary]
    assert [(e.family, e.name) for e in odd] == [("payload", "link")]
    assert odd[0].size.value == pytest.approx(0.4, rel=0.1)
    assert "kp_scale" not in {e.family for e in found.effects}
    report = ji.to_report(found)
    assert report["shrink"]["heldout"]["after"] < 0.2 * report["shrink"]["heldout"]["before"]
    assert not left_to_torque(found, [log])


@pytest.mark.slow
def test_a_lag_of_a_lone_joint_is_no_delay():
    """With the delay of all targets as it fits best, a lag of 36 ms had been 24 ms of that and other gains."""
    found = diagnose([run(lag=0.036, dry=0.2)], functools.partial(mujoco.MjSpec.from_string, MODEL))
    sizes = {e.family: e.size.value for e in found.effects}
    assert sizes["target_lag"] == pytest.approx(0.036, rel=0.05)
    assert not {"target_delay", "kp_scale", "kd_scale"} & set(sizes)


def test_other_joints_say_what_a_delay_is():
    """Of one of two joints, by the torque of the other; of a lone one, by the prior."""
    delay = Parameter("target_delay", ALL, 0.0, 0.02, -0.01, 0.3)
    error, columns = np.full((50, 4), 0.4), np.zeros((1, 50, 4))
    columns[0, :, 2], columns[0, :, 3] = 900.0, 100.0
    one = np.array([[1e-6]])
    weights = Weights(np.ones(4), np.ones(4))
    found = Fit((delay,), np.array([0.024]), one, one, 50.0, error, columns, weights)
    row, value, sd = by_law.delay_of_others(found, 0, 2)
    assert row == 0
    assert value == pytest.approx(0.024 - (50 * 40.0 + 0.024 / 4e-4) / (50 * 1e4 + 1 / 4e-4))
    assert sd == pytest.approx((50 * 1e4 + 1 / 4e-4) ** -0.5)
    lone = found._replace(error=error[:, :2], columns=columns[:, :, :2])
    assert by_law.delay_of_others(lone, 0, 1)[1:] == pytest.approx((0.0, 0.02))


def test_what_a_fitted_log_shows_is_there_whatever_another_one_does():
    log = law(bias=0.5, seconds=3.0)
    plant = Plant(mujoco.MjSpec.from_string(MODEL), log.joint_names, LOOP)
    record = record_of(log, LOOP, torque=True)
    table = tuple(Parameter("torque_bias", j, 0.0, 1.0, -9.0, 9.0) for j in (0, 0))
    for size, shown in ((0.5, [(0,)]), (1e-4, [])):
        none = np.zeros((2, 2))
        found = Fit(table, np.array([size, 0.0]), none, none, 1.0, none, none, None)
        assert shown_in(plant, found, [(0,)], [record], np.zeros(2)) == shown
