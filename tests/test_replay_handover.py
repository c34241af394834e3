"""What is handed over, against the plant that was fitted: the same motion from the written file in MuJoCo's own
steps."""

import mujoco
import numpy as np
import pytest
from test_replay import ARM, NAMES

from benchmarks.exam import replayed as examiner
from jax_inertia.logs.log import Log
from jax_inertia.replay import handover
from jax_inertia.replay.inputs import tolerances
from jax_inertia.replay.loop import ALL, Parameter, position_loop
from jax_inertia.replay.record import record_of
from jax_inertia.replay.result import Correction
from jax_inertia.replay.simulation.plant import Plant
from jax_inertia.replay.simulation.simulate import replay


def told(seconds=3.0, period=0.02) -> Log:
    """Targets that jump every 20 ms, and positions that do not matter but at the start."""
    time = np.arange(0, seconds, period)
    target = 0.5 * np.sin(np.outer(time, [3.0, 5.0])) + 0.2 * np.sin(np.outer(time, [9.0, 11.0]))
    return Log(time=time, joint_names=NAMES, qpos=np.zeros_like(target), qpos_target=target)


def both(numbers, h=0.002, integrator="implicitfast"):
    """(positions by the plant, by the file) of numbers by family and joint."""
    option = f'<option timestep="{h}" integrator="{integrator}"/>'
    text = ARM.replace("<mujoco>", f"<mujoco>{option}")
    loop = position_loop(told(), mujoco.MjModel.from_xml_string(text))
    plant = Plant(mujoco.MjSpec.from_string(text), NAMES, loop)
    own = {(p.family, p.body): p for p in tolerances(plant)}
    table, theta = [], []
    for (family, where), x in numbers.items():
        joint, body = (where, "") if isinstance(where, int) else (-2, where)
        nominal = {"armature": 0.0, "viscous_friction": 1.0}.get(family, 0.0)
        table.append(own.get((family, body)) or Parameter(family, joint, nominal, 1.0, -9, 9, body))
        theta.append(x)
    record = record_of(told(), loop)
    planned = replay(plant, table, np.array(theta)[None], record)[0]
    found = plant.numbers(table, np.array(theta), None)
    made = Correction(NAMES, loop, found, found.at_joint.lumped, plant.nominal, found.dry, False)
    file = handover.written(made, mujoco.MjSpec.from_string(text), handover.in_memory)
    return planned, handover.replayed(file.model, NAMES, loop, record), file


def apart(planned, done) -> float:
    """Rms where the start is forgotten [rad]."""
    return float(np.sqrt(np.mean((planned - done)[25:] ** 2)))


NUMBERS = {
    "kp": {("kp_scale", 1): -0.3, ("armature", 0): 0.03, ("viscous_friction", 0): 1.8},
    "late": {("target_delay", ALL): 0.0131},
    "a little late": {("target_delay", ALL): 0.0007},
    "clock": {("loop_hold", ALL): 0.0006, ("target_delay", ALL): 0.0012},
    "continuous": {("own_steps", ALL): 0.001, ("target_delay", ALL): 0.001},
    "older velocities": {("own_steps", ALL): 0.0015},
    "fresher": {("loop_hold", ALL): -0.0006},
    "lag": {("target_lag", ALL): 0.03, ("target_delay", ALL): 0.0031},
    "own": {("target_delay", 1): 0.011, ("torque_bias", 0): 0.6, ("encoder_offset", 1): 0.03},
    "friction": {("coulomb_friction", 0): 0.5, ("quadratic_viscous", 1): 0.05},
    "low pass": {("target_low_pass", ALL): 0.039},
    "rubs": {("load_friction", 0): 0.2, ("coulomb_friction", 0): 0.1},
    "integral": {
        ("drive_integral", ALL): 30.0,
        ("integral_windup", 0): 1.25,
        ("integral_windup", 1): 1.0,
    },
    "late integral": {
        ("drive_integral", 1): 20.0,
        ("integral_windup", 1): 1.0,
        ("target_delay", ALL): 0.013,
    },
    "lagging integral": {
        ("drive_integral", 1): 20.0,
        ("integral_windup", 1): 1.0,
        ("target_lag", ALL): 0.03,
    },
    "weak": {("torque_saturation", 0): np.log(2.5)},
    "masses": {("payload", "lower"): 0.2, ("mass_share", "upper"): 0.03},
}


@pytest.mark.parametrize("what", NUMBERS)
def test_the_file_moves_as_the_fit_did(what):
    planned, done, _ = both(NUMBERS[what])
    sound, _, _ = both({})
    assert apart(planned, sound) > 5e-5
    assert apart(planned, done) < 0.02 * apart(planned, sound) + 2e-6


@pytest.mark.parametrize("what", ["low pass", "lag", "rubs", "integral"])
def test_a_program_that_shares_no_code_moves_the_file_so(what):
    _, done, file = both(NUMBERS[what])
    log = told()
    path = examiner.replayed(file.text, NAMES, log.time, log.qpos, log.qpos_target)
    assert apart(done, path) < 1e-6


@pytest.mark.parametrize("h", [0.001, 0.002, 0.005])
@pytest.mark.parametrize("integrator", ["Euler", "implicitfast"])
def test_the_file_moves_so_in_the_models_own_steps(h, integrator):
    planned, done, _ = both(NUMBERS["kp"] | NUMBERS["a little late"], h, integrator)
    assert apart(planned, done) < 5e-6


@pytest.mark.parametrize("share", 1.0 + 0.0137 * np.arange(12))
def test_a_flat_body_outlives_the_rounding_of_its_file(share):
    spec = mujoco.MjSpec.from_string(
        '<mujoco><worldbody><body name="plate"><joint name="j"/><inertial pos="0 0 0" mass="1" '
        'diaginertia="0.007 0.006 0.001"/></body></worldbody></mujoco>'
    )
    spec.body("plate").inertia = share * np.array([0.007, 0.006, 0.001])
    _, model = handover.in_memory(spec)
    np.testing.assert_allclose(model.body("plate").inertia[0], 0.007 * share, rtol=1e-4)
