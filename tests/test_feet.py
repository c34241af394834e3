"""What a robot on its feet is judged with where no contact wrench is measured: its accelerometer, its friction."""

from __future__ import annotations

import functools
import re

import mujoco
import numpy as np
import pytest
from scipy import signal
from walking_log import Quadruped, shifts, walked

import jax_inertia as ji
from jax_inertia.diagnosis.calibration_state import stated_by_model
from jax_inertia.diagnosis.effects.base import Columns, Place
from jax_inertia.diagnosis.effects.external_force import Push
from jax_inertia.diagnosis.effects.ground import APART, MISSES, SampledAcceleration
from jax_inertia.diagnosis.effects.inertial import Payload
from jax_inertia.diagnosis.effects.joint import TorqueBias
from jax_inertia.diagnosis.residual import Residual
from jax_inertia.diagnosis.result import Diagnosis
from jax_inertia.diagnosis.search.candidates import make, pushes
from jax_inertia.diagnosis.search.evidence import Evidence
from jax_inertia.diagnosis.settings import CalibrationState, Settings
from jax_inertia.logs.log import Log
from jax_inertia.logs.schema import SHAPES
from jax_inertia.maths.precision import in_double_precision

DOG = Quadruped()
BARE = re.sub(r' (armature|damping|frictionloss)="[^"]*"', "", DOG.xml)


def log_of(arrays: dict, *left_out: str, **more) -> Log:
    """A log without any word of the feet."""
    lacks = ("contact_flag", "contact_force", "contact_bodies", *left_out)
    fields = {k: x for k, x in arrays.items() if k in SHAPES and k not in lacks}
    fields |= {"joint_names": tuple(arrays["joint_names"]), "imu_pos": np.array(DOG.imu)}
    return Log(**(fields | more))


@functools.cache
def stood() -> Residual:
    """Rows of a quadruped that sways, by a model without friction."""
    log = log_of(walked(DOG, shifts, seconds=2.0, seed=3), tau_kind="current")
    robot = ji.load_model(mujoco.MjModel.from_xml_string(BARE)).astype("float64")
    return in_double_precision(Residual)(robot, log, Settings())


STEP = 5e-4


@functools.cache
def felt() -> np.ndarray:
    """Acceleration at each step of a mass that is told where to be 50 times a second, by MuJoCo C."""
    model = mujoco.MjModel.from_xml_string(f"""<mujoco><option timestep="{STEP}" gravity="0 0 0"/><worldbody>
      <body><joint name="z" type="slide" axis="0 0 1"/><geom size="0.05" mass="5"/></body></worldbody>
      <actuator><position joint="z" kp="8000" kv="240"/></actuator></mujoco>""")
    data, out = mujoco.MjData(model), []
    for k in range(8000):
        t = k * STEP
        if k % 40 == 0:
            data.ctrl[0] = 0.02 * np.sin(2 * np.pi * 2.0 * t) + 0.01 * np.sin(2 * np.pi * 5.0 * t)
        mujoco.mj_step(model, data)
        out.append(data.qacc[0])
    return np.array(out)


def slow(x: np.ndarray, rate: float) -> np.ndarray:
    return signal.sosfiltfilt(signal.butter(3, 20.0, fs=rate, output="sos"), x)


def sampled(period: float, shift: float) -> tuple[float, float]:
    """Gain and delay [s] below 20 Hz of samples that come a `shift` after each target [s]."""
    at = np.arange(round(shift / STEP), len(felt()), round(period / STEP))
    true, seen = slow(felt(), 1.0 / STEP)[at], slow(felt()[at], 1.0 / period)
    inner = slice(50, -50)
    slope = np.gradient(true, period)
    gain, late = np.linalg.lstsq(np.stack([true, -slope], 1)[inner], seen[inner], rcond=None)[0]
    return float(gain), float(late)


def test_samples_that_fall_on_new_targets_show_another_acceleration():
    """By as much as is allowed for at each rate of a log."""
    (on, early), (between, _) = sampled(0.005, 0.0), sampled(0.005, 0.0025)
    assert abs(on - 1.0) > 2 * abs(between - 1.0)
    assert 0.05 < abs(on - 1.0) < 2 * MISSES * 0.005
    assert 5e-4 < abs(early) < 2 * APART * 0.005
    gain, late = sampled(0.002, 0.0)
    assert 0.02 < abs(gain - 1.0) < 2 * MISSES * 0.002
    assert abs(late) < 2 * APART * 0.002


def test_an_accelerometer_errs_by_the_whole_robot():
    residual = stood()
    context, effect = residual.context, SampledAcceleration()
    (place,) = effect.places(context)
    columns = in_double_precision(effect.columns)(context, place, (0.002,)).values
    mass = float(mujoco.MjModel.from_xml_string(BARE).body_mass.sum())
    jerk = np.gradient(context.a[:, :3], context.time, axis=0)
    for axis in range(3):
        own = columns[:, axis, axis]
        np.testing.assert_allclose(own, MISSES * 0.002 * mass * context.a[:, axis], atol=1e-9)
        late = slow(columns[:, axis, 6 + axis] / (APART * 0.002 * mass), 250.0)[60:-60]
        wanted = slow(jerk[:, axis], 250.0)[60:-60]
        np.testing.assert_allclose(late, wanted, atol=0.1 * np.abs(wanted).max())


def test_a_model_without_friction_is_as_it_is_bought():
    given = ji.load_model(mujoco.MjModel.from_xml_string(DOG.xml))
    assert stated_by_model(given) is CalibrationState.CALIBRATED
    assert stated_by_model(stood().robot) is CalibrationState.AS_BOUGHT


def test_only_a_load_of_the_base_is_as_likely_as_in_the_air():
    residual, settings = stood(), Settings()
    robot, load = residual.robot, Payload()

    def odds(body: str) -> float:
        place = Place("body", body, robot.body_index(body))
        shape = next(iter(load.shapes(residual.context, place)))
        return in_double_precision(make)(residual, load, place, shape, settings).odds

    assert odds("trunk") == settings.odd_odds
    assert odds("FL_shank") == settings.unmeasured_odds


def test_a_constant_torque_of_a_standing_leg_is_not_assumed():
    """It passes for weight."""
    residual = stood()
    place = next(p for p in TorqueBias().places(residual.context) if p.name == "FL_knee")
    made = in_double_precision(make)(residual, TorqueBias(), place, (), Settings())
    assert not made.ordinary
    assert made.odds == Settings().unmeasured_odds


def test_nothing_pushes_a_leg_that_stands():
    """What gives or slips under it does; on the trunk a force for a short time is found, whatever legs bear."""
    residual, settings, push = stood(), Settings(), Push()
    robot = residual.robot
    evidence = Evidence(residual.y.copy(), residual.weight, 0.05 + 0.0 * residual.sensors)
    start, end = residual.time[0] + 0.4, residual.time[0] + 0.9
    inside = (residual.time > start) & (residual.time < end)
    force = residual.rows_of(Columns(residual.context.force_rows[:, robot.body_index("trunk")]))[0]
    evidence.y[:] = inside[:, None] * force[..., 2] * -60.0
    found = in_double_precision(
        lambda: list(pushes(residual, evidence, evidence.nothing(), push, settings))
    )()
    assert {h.place.name for h in found} == {"trunk"}
    assert min(h.odds for h in found) > settings.unmeasured_odds


@pytest.mark.slow
@pytest.mark.parametrize("load", [0.0, 1.0])
def test_a_quadruped_as_bought_is_weighed_as_it_sways(load):
    """Without torque: the friction of its legs is found by what it does to the base, and its load."""
    arrays = walked(DOG, shifts, load=load, at=(0.1, 0.05, 0.06), seed=5)
    log = log_of(arrays, "tau", kp=np.full(12, DOG.kp), kd=np.full(12, DOG.kd))
    found = ji.diagnose(ji.load_model(mujoco.MjModel.from_xml_string(BARE)), log)
    assert isinstance(found, Diagnosis)
    assert [(f.family, f.place.name) for f in found.odd] == [("payload", "trunk")] * bool(load)
    if load:
        assert found.odd[0].parameters["mass"].value == pytest.approx(load, rel=0.06)
