"""A linear axis is a joint like any other: what slows it is told at its own speeds, a tenth of a hinge's in metres.

Its ways and seals rub at speeds that no drive's gear turns them into, and its pulleys are of any size.
"""

import mujoco
import numpy as np
import pytest

import jax_inertia as ji
from jax_inertia.diagnosis.effects.base import Place
from jax_inertia.diagnosis.effects.dry_friction import StribeckFriction
from jax_inertia.diagnosis.effects.generic_forms import LoadRipple
from jax_inertia.diagnosis.effects.joint import Cogging
from jax_inertia.diagnosis.effects.registry import effects_of
from jax_inertia.diagnosis.residual import Residual
from jax_inertia.diagnosis.search.bank import Bank
from jax_inertia.diagnosis.search.best_numbers import at_best
from jax_inertia.diagnosis.search.candidates import make
from jax_inertia.diagnosis.search.ordinary import learned, ordinary_of, ordinary_physics
from jax_inertia.diagnosis.search.stepwise import _exchanged
from jax_inertia.diagnosis.settings import CalibrationState, Settings
from jax_inertia.logs.log import Log
from jax_inertia.maths.precision import in_double_precision

AXIS = """<mujoco><worldbody><body><joint name="rail" type="slide" axis="1 0 0"/>
<inertial mass="6" pos="0 0 0" diaginertia="0.02 0.02 0.02"/>
<body pos="0 0 0.1"><joint name="lift" type="slide" axis="0 0 1"/>
<inertial mass="2" pos="0.05 0 0" diaginertia="0.01 0.01 0.01"/></body></body></worldbody></mujoco>"""
MASS, DRIVE = np.array([8.0, 2.0]), np.array([3.0, 0.8])
"""What each axis moves [kg], and its drive's inertia [kg]."""
LEVEL, DAMPING = np.array([4.0, 2.0]), np.array([6.0, 3.0])


def log_of(seed: int, extra, seconds: float = 20.0, axis: int = 0) -> Log:
    """In closed form: m q̈ + weight + friction, up to 0.25 m/s; `extra` acts on one axis by its position and speed."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, 0.004)
    q, v, a = np.zeros((3, len(t), 2))
    for f in (0.13, 0.31, 0.57, 0.83):
        size, phase, w = 0.03 * rng.uniform(0.5, 1.0, 2), rng.uniform(0, 6.28, 2), 2 * np.pi * f
        q += size * np.sin(w * t[:, None] + phase)
        v += size * w * np.cos(w * t[:, None] + phase)
        a -= size * w * w * np.sin(w * t[:, None] + phase)
    tau = (MASS + DRIVE) * a + [0.0, 2.0 * 9.81] + LEVEL * np.tanh(v / 1e-3) + DAMPING * v
    tau[:, axis] += extra(q[:, axis], v[:, axis])
    return Log(
        time=t,
        qpos=q + 5e-6 * rng.normal(size=q.shape),
        qvel=None,
        tau=tau + 0.05 * rng.normal(size=q.shape),
        joint_names=("rail", "lift"),
        tau_kind="sensor",
    )


@pytest.mark.parametrize(
    ("family", "extra"),
    [
        ("quadratic_viscous", lambda q, v: 90.0 * v * np.abs(v)),
        ("stribeck_friction", lambda q, v: 3.0 * np.exp(-((v / 0.01) ** 2)) * np.tanh(v / 1e-3)),
        ("stribeck_friction", lambda q, v: 4.0 * np.exp(-((v / 0.1) ** 2)) * np.tanh(v / 1e-3)),
        ("cogging", lambda q, v: -1.5 * np.sin(26.0 * q + 0.7)),
    ],
)
@pytest.mark.slow
def test_what_slows_a_linear_axis_is_told(family, extra):
    robot = ji.load_model(mujoco.MjModel.from_xml_string(AXIS))
    found = ji.diagnose(robot, log_of(0, extra), test_log=log_of(1, extra, 12.0))
    report = ji.to_report(found)
    odd = [(e["family"], e["location"]["name"]) for e in report["effects"] if not e["ordinary"]]
    assert odd == [(family, "rail")]
    assert report["verdict"] == "explained"
    rotor = report["joints"]["rail"]["armature"]["value"]
    assert rotor == pytest.approx(DRIVE[0], abs=0.3)


@pytest.fixture(scope="module")
@in_double_precision
def lifted():
    """Residual of a log whose lift has a wave of teeth, under a weight that hardly changes."""
    robot = ji.load_model(mujoco.MjModel.from_xml_string(AXIS)).astype("float64")
    log = log_of(0, lambda q, v: -0.8 * np.sin(WAVE * q + 0.3), axis=1)
    return Residual(robot, log, Settings())


WAVE, LIFT = 83.0, Place("joint", "lift", 1)


def test_waves_are_looked_for_from_half_of_one_along_the_path(lifted):
    context, teeth = lifted.context, Cogging()
    fewest = np.pi / np.ptp(context.joint_position[:, 1])
    assert teeth.shapes(context, LIFT)[0][0] == pytest.approx(fewest)
    assert teeth.within(context, LIFT, (1.01 * fewest,))
    assert not teeth.within(context, LIFT, (0.99 * fewest,))


def test_friction_is_looked_for_at_speeds_of_drives_and_of_ways(lifted):
    speeds = {shape[2] for shape in StribeckFriction().shapes(lifted.context, LIFT)}
    assert min(speeds) == pytest.approx(0.002)
    assert max(speeds) == pytest.approx(0.3)


@in_double_precision
def test_what_was_searched_gives_way_to_what_does_better_between_the_grid_s_points(lifted):
    """A ripple of the load at its best wave is ahead of teeth on their grid, and behind them at theirs."""
    settings, library = Settings(), effects_of(lifted.log)
    evidence, now, _ = ordinary_physics(lifted, library, settings, CalibrationState.AS_BOUGHT)
    calibrated = lifted.calibrated(ordinary_of(lifted, now))
    grid = [
        make(calibrated, effect, LIFT, (WAVE + off,), settings)
        for effect in (Cogging(), LoadRipple())
        for off in (-4.0, 4.0)
    ]
    ripple = at_best(calibrated, evidence, now, grid[2], grid)
    chosen = learned(evidence, (*now.chosen, ripple), 3)
    behind = max(evidence.gains(chosen.without(ripple), grid[:2])) - grid[0].odds
    assert behind < evidence.worths(chosen)[-1] - ripple.odds
    after = _exchanged(calibrated, evidence, chosen, Bank(grid), set(), set(), set())
    assert after is not None
    (found,) = (h for h in after.chosen if h.is_odd)
    assert found.family == "cogging"
    assert found.shape[0] == pytest.approx(WAVE, abs=0.5)
