"""Logs in other units than rad, m, N m, named on every road to a number: five robots by MuJoCo C; sound ones pass."""

import dataclasses
import functools
import re
from collections.abc import Callable

import mujoco
import numpy as np
import pytest
import robots_in_motion as robots

import jax_inertia as ji
from jax_inertia.diagnosis import entry as diagnosis
from jax_inertia.estimation.estimate_inputs import Settings, checked
from jax_inertia.estimation.stream import looked_at
from jax_inertia.logs.findings import Severity
from jax_inertia.logs.log import LogError
from jax_inertia.model.load import ModelWarning
from jax_inertia.preflight.preflight import preflight
from jax_inertia.preflight.units import POSITIONS, RATES, SI, of_ratio
from jax_inertia.replay import entry as replays

# The others, and every road for each, are for before a release.
NAMES = [
    name if name in ("rig", "leg") else pytest.param(name, marks=pytest.mark.slow)
    for name in robots.ROBOTS
]
JOINTS = ("qpos", "qvel", "qpos_target")


@functools.cache
def robot(name: str) -> ji.Robot:
    return robots.robot_of(name)


@functools.cache
def by_torque(name: str) -> ji.Log:
    log = robots.log_of(name)
    velocity = np.gradient(np.asarray(log.qpos), np.asarray(log.time), axis=0)
    return dataclasses.replace(log, qvel=velocity)


@functools.cache
def by_targets(name: str) -> ji.Log:
    return robots.log_of(name, by_targets=True)


def hinges(name: str) -> np.ndarray:
    return np.array([kind == "hinge" for kind in robot(name).joint_type])


def scaled(log: ji.Log, factor: np.ndarray, channels: tuple[str, ...] = JOINTS) -> ji.Log:
    given = {name: x for name in channels if (x := getattr(log, name)) is not None}
    return dataclasses.replace(log, **{name: np.asarray(x) * factor for name, x in given.items()})


@pytest.fixture(params=[False, pytest.param(True, marks=pytest.mark.slow)], ids=["one", "every"])
def every(request) -> bool:
    """Whether a robot of several joints goes every road, or the first alone."""
    return request.param


def roads(name: str, log: ji.Log, every: bool) -> dict[str, Callable[[], object]]:
    """What looks at a log before each command computes anything."""
    own = robot(name)
    if log.tau is None:
        return {"replay": lambda: replays.usable(log, own)}
    ways = {
        "estimate": lambda: checked(own, log, [own.body_names[-1]], [], Settings()),
        "diagnose": lambda: diagnosis.usable(log, own, None, "log"),
        "watch": lambda: looked_at(log, own),
        "convert": lambda: preflight(log, own).raise_for_errors(),
    }
    return ways if every or own.nv == 1 else {"estimate": ways["estimate"]}


def refusals(name: str, log: ji.Log, every: bool) -> dict[str, str]:
    said = {}
    for road, look in roads(name, log, every).items():
        with pytest.raises(LogError) as caught:
            look()
        said[road] = str(caught.value)
    return said


SOURCES = {"torque": by_torque, "targets": by_targets}


@pytest.mark.parametrize("source", SOURCES)
@pytest.mark.parametrize("name", NAMES)
def test_sound_logs_pass(name, source, every):
    looks = roads(name, SOURCES[source](name), every)
    for look in looks.values():
        look()
    assert looks


@pytest.mark.parametrize("source", SOURCES)
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(
    ("unit", "size"), [("degrees", np.pi / 180), ("turns", 2 * np.pi), ("mrad", 1e-3)]
)
def test_positions_of_hinges(name, source, unit, size, every):
    """Velocities go with positions; the printed factor reads them right."""
    factor = np.where(hinges(name), 1 / size, 1.0)
    log = scaled(SOURCES[source](name), factor)
    for road, message in refusals(name, log, every).items():
        assert unit in message, road
        assert "convert --" in message, road


@pytest.mark.parametrize("source", SOURCES)
def test_positions_of_one_hinge(source, every):
    factor = np.array([1.0, 1 / (2 * np.pi), 1.0])
    for message in refusals("leg", scaled(SOURCES[source]("leg"), factor), every).values():
        assert "--position-scale swing=6.2831853" in message


@pytest.mark.parametrize("name", ["gantry", pytest.param("crane", marks=pytest.mark.slow)])
def test_slides_in_millimetres(name, every):
    log = scaled(by_torque(name), np.where(hinges(name), 1.0, 1000.0))
    for road, message in refusals(name, log, every).items():
        assert "in mm" in message, road
        assert "=0.001" in message, road


COLUMN = """<mujoco><option timestep="0.001"/><worldbody><body name="column" pos="0 0 0.3">
  <joint name="yaw" axis="0 0 1"/><inertial pos="0.02 0 0" mass="1.5" diaginertia="0.01 0.01 0.008"/>
  <body name="tube" pos="0.1 0 0.05"><joint name="reach" type="slide" axis="1 0 0"/>
    <inertial pos="0.05 0 0" mass="0.8" diaginertia="0.001 0.005 0.005"/>
    <body name="hand" pos="0.1 0 0"><joint name="pitch" axis="0 1 0"/>
      <inertial pos="0.08 0 0" mass="0.4" diaginertia="0.0003 0.0015 0.0015"/>
    </body></body></body></worldbody></mujoco>"""
"""A slide between hinges: its loop's forces [N] are many times their torques [N m]."""


@functools.cache
def column() -> tuple[ji.Robot, ji.Log]:
    """Its model, and a log by MuJoCo C of one with friction, rotors and half its hand's mass more; gains in the log."""
    kp, kd = np.array([40.0, 900.0, 15.0]), np.array([1.5, 30.0, 0.4])
    nominal = mujoco.MjModel.from_xml_string(COLUMN)
    model = mujoco.MjModel.from_xml_string(COLUMN)
    model.dof_armature[:], model.dof_damping[:] = (0.03, 0.6, 0.003), 0.2 * kd
    model.dof_frictionloss[:] = 0.15, 1.4, 0.02
    model.body_mass[-1] *= 1.5
    model.body_inertia[-1] *= 1.5
    data, rows = mujoco.MjData(model), []
    for k in range(10000):
        t = 0.02 * (k // 20)
        waves = [np.sin(2.0 * np.pi * f * t + p) for f, p in ((0.45, 0.0), (0.6, 1.0), (0.8, 2.0))]
        target = (0.0, 0.1, 0.3) + np.array([0.6, 0.1, 0.6]) * waves
        if k == 0:
            data.qpos[:] = target
        if k % 5 == 0:
            rows.append((data.time, data.qpos.copy(), target))
        data.qfrc_applied[:] = kp * (target - data.qpos) - kd * data.qvel
        mujoco.mj_step(model, data)
    time, q, target = (np.array(x) for x in zip(*rows, strict=True))
    names = ("yaw", "reach", "pitch")
    log = ji.Log(time=time, joint_names=names, qpos=q, qpos_target=target, kp=kp, kd=kd)
    return ji.load_model(nominal), log


def test_forces_of_a_slide_are_no_measure_of_torques_of_hinges():
    """Read in mrad, hinges' torques were a trifle of the slide's force, and missed nothing."""
    own, log = column()
    replays.usable(log, own)
    for size, unit in ((np.pi / 180.0, "degrees"), (1e-3, "mrad")):
        with pytest.raises(LogError, match=unit):
            replays.usable(scaled(log, np.array([1.0 / size, 1.0, 1.0 / size])), own)


@pytest.mark.parametrize(
    "name", ["rig", *(pytest.param(x, marks=pytest.mark.slow) for x in ("leg", "sprung"))]
)
@pytest.mark.parametrize(("count", "zero"), [(4096, 2048), (1 << 16, 0)])
def test_counts_of_encoders_by_torque(name, count, zero, every):
    log = by_torque(name)
    counts = np.round(np.asarray(log.qpos) * count / (2 * np.pi) + zero)
    log = dataclasses.replace(log, qpos=counts, qvel=np.asarray(log.qvel) * count / (2 * np.pi))
    for message in refusals(name, log, every).values():
        assert f"counts of {count} a turn about {zero}" in message


@pytest.mark.parametrize("hinge", [True, False])
def test_a_ratio_names_both_units(hinge):
    """Of every pair of units: or of one with the same ratio, positions in SI first."""
    for position in (SI, *POSITIONS[hinge]):
        for rate in (SI, *RATES[hinge]):
            ratio = position.size / rate.size
            found = of_ratio(ratio, hinge) or (SI, SI)
            assert found[0].size / found[1].size == pytest.approx(ratio, rel=1e-6)
    assert of_ratio(50.0, True) is None
    assert of_ratio(0.95, True) is None


@pytest.mark.parametrize("unit", RATES[True], ids=lambda unit: unit.name)
def test_velocities_in_another_unit_are_left_out(unit):
    """By whoever can do without; a stream refuses."""
    log = scaled(by_torque("leg"), np.full(3, 1 / unit.size), ("qvel",))
    read, _, findings = diagnosis.usable(log, robot("leg"), None, "log")
    assert read.qvel is None
    (said,) = [f.message for f in findings if f.check == "qvel"]
    assert unit.name in said
    inputs = checked(robot("leg"), log, ["shank"], [], Settings())
    assert inputs.log.qvel is None
    with pytest.raises(LogError, match=re.escape(unit.name)):
        looked_at(log, robot("leg"))


@pytest.mark.parametrize("name", NAMES)
def test_torques_that_were_never_logged(name, every):
    log = by_torque(name)
    for message in refusals(
        name, dataclasses.replace(log, tau=np.zeros_like(np.asarray(log.tau))), every
    ).values():
        assert "tau of every joint is 0 throughout" in message


@pytest.mark.parametrize(
    "name", ["leg", *(pytest.param(x, marks=pytest.mark.slow) for x in ("crane", "gantry"))]
)
def test_counts_of_drives(name, every):
    log = by_torque(name)
    tau = np.asarray(log.tau)
    counts = np.round(tau / np.abs(tau).max(axis=0) * 1000)
    for message in refusals(name, dataclasses.replace(log, tau=counts), every).values():
        assert "not N m of the joint" in message


def test_positions_of_two_joints_in_each_other_s_column(every):
    log = by_torque("leg")
    order = [0, 2, 1]
    swapped = dataclasses.replace(
        log, qpos=np.asarray(log.qpos)[:, order], qvel=np.asarray(log.qvel)[:, order]
    )
    for message in refusals("leg", swapped, every).values():
        assert "is how 'knee' moves" in message


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda q, t: (t - 0.2) / 0.25, "a policy's raw actions"),
        (lambda q, t: (t - 0.2) / [0.25, 0.5, 0.4], "a policy's raw actions"),
        (lambda q, t: t - q, "--relative-targets"),
        (lambda q, t: np.degrees(t), "--target-scale 0.017453293"),
        (lambda q, t: np.radians(t), "--target-scale 57.29578"),
        (lambda q, t: t / (2 * np.pi), "--target-scale 6.2831853"),
        (lambda q, t: t * [1, 1, -1], "--target-scale knee=-1"),
        (lambda q, t: t[:, [0, 2, 1]], "swing follows the targets of knee"),
        (lambda q, t: np.roll(t, 75, axis=0), "ahead of qpos_target"),
        (lambda q, t: 0 * t + 0.3, "never changes"),
    ],
)
def test_targets_in_other_words(change, said, every):
    log = by_targets("leg")
    q, t = np.asarray(log.qpos), np.asarray(log.qpos_target)
    (message,) = refusals("leg", dataclasses.replace(log, qpos_target=change(q, t)), every).values()
    assert said in message


def test_targets_from_another_zero_are_warned_of():
    log = by_targets("leg")
    _, findings = replays.usable(
        dataclasses.replace(log, qpos_target=np.asarray(log.qpos_target) - 0.5), robot("leg")
    )
    assert [f.severity for f in findings if f.check == "targets"] == [Severity.WARNING]


def test_what_precedes_the_first_target_is_left_out():
    """Something else held the robot."""
    log = by_targets("leg")
    target = np.array(log.qpos_target)
    target[:200, 1] = np.nan
    one, findings = replays.usable(dataclasses.replace(log, qpos_target=target), robot("leg"))
    assert one.time[0] == log.time[200]
    assert np.isfinite(np.asarray(one.qpos_target)).all()
    assert "targets are there from 0.8" in findings[0].message


@pytest.mark.parametrize("first", [True, False])
def test_a_loose_object_is_not_the_robot(tmp_path, first):
    """Before or behind the robot in the file, with what else refers to it."""
    xml = robots.model_of("leg")
    cube = '<body name="cube" pos="1 0 0"><freejoint/><geom name="c" size="0.1"/></body>'
    inside = "<worldbody>\n" if first else "</worldbody>"
    xml = xml.replace(inside, f"<worldbody>{cube}" if first else f"{cube}</worldbody>")
    rest = (
        '<contact><exclude body1="cube" body2="hip"/></contact><keyframe><key name="k"/></keyframe>'
    )
    (tmp_path / "scene.xml").write_text(xml.replace("</mujoco>", f"{rest}</mujoco>"))
    with pytest.warns(ModelWarning, match="cube"):
        loaded = ji.load_model(tmp_path / "scene.xml")
    assert loaded.joint_names == robot("leg").joint_names
    np.testing.assert_array_equal(loaded.pi, robot("leg").pi)
