"""Built-in data: an arm in MuJoCo C picks up a load that its controller knows nothing of, and puts it down again.

The equations that make the data are MuJoCo's, not this package's. The controller computes its torques from the
bare arm's model; the sensors are noisy. The arm's own model is exact: only the load is unknown.
"""

import dataclasses

import mujoco
import numpy as np
from jaxtyping import Float

from jax_inertia.logs.log import Log, TorqueKind
from jax_inertia.model.load import body_pi, set_inertials
from jax_inertia.robots.arm import HAND, arm_mjcf

_CONTROL_PERIOD = 1e-3
_LOG_EVERY = 2  # control periods: 500 Hz
_PAUSE = 0.4  # to rest before an event, and from rest after it [s]
SIGMA_Q, _SIGMA_V = 2e-5, 2e-3  # encoder of 18 bits, and the drive's velocity from it [rad, rad/s]
_SIGMA_TAU = np.array([0.5, 0.5, 0.5, 0.5, 0.2, 0.2, 0.2])  # joint torque sensors [N m]
_STIFFNESS, _DAMPING = 400.0, 40.0  # of the error dynamics: 1/s², 1/s
_HOME = np.array([0.0, 0.7, 0.0, 1.2, 0.0, 0.8, 0.0])
_SWING = np.array([0.7, 0.4, 0.6, 0.5, 0.8, 0.6, 1.0])


@dataclasses.dataclass(frozen=True)
class Load:
    """A box held by the hand: mass [kg], centre [m] in the hand's frame, edges [m]."""

    mass: float = 1.9
    centre: tuple[float, float, float] = (0.05, -0.03, 0.14)
    edges: tuple[float, float, float] = (0.16, 0.1, 0.12)


@dataclasses.dataclass(frozen=True)
class Scenario:
    """When what happens [s]."""

    duration: float = 14.0
    pick_up: float = 4.0
    put_down: float = 10.0
    load: Load = dataclasses.field(default_factory=Load)
    seed: int = 0


@dataclasses.dataclass(frozen=True)
class Recording:
    """What the robot logged, and what only the simulator knows."""

    log: Log
    model_xml: str
    """The model that the robot believes in: without the load."""
    true_pi: Float[np.ndarray, "T 10"]
    """π of the hand with what it holds, at the log's stamps."""


def simulate(scenario: Scenario | None = None) -> Recording:
    """Run the scenario in MuJoCo C and record it at 500 Hz; the same scenario gives the same data."""
    scenario = Scenario() if scenario is None else scenario
    xml = arm_mjcf()
    bare = mujoco.MjModel.from_xml_string(xml)
    holding = with_load(xml, scenario.load)
    controller, plant = mujoco.MjData(bare), mujoco.MjData(bare)
    wanted = path(scenario, bare.nv)
    plant.qpos, plant.qvel = wanted(0.0)[:2]
    rng = np.random.default_rng([scenario.seed, 1])
    limit = bare.actuator_ctrlrange[:, 1]
    half = round(_CONTROL_PERIOD / bare.opt.timestep) // 2
    rows, held = [], []
    for step in range(round(scenario.duration / _CONTROL_PERIOD)):
        start = step * _CONTROL_PERIOD
        carries = scenario.pick_up <= start < scenario.put_down
        model = holding if carries else bare
        q = plant.qpos + SIGMA_Q * rng.normal(size=bare.nq)
        v = plant.qvel + _SIGMA_V * rng.normal(size=bare.nv)
        plant.ctrl = np.clip(computed_torque(bare, controller, q, v, *wanted(start)), -limit, limit)
        # The drives sample in the middle of a period, while the torque is held.
        mujoco.mj_step(model, plant, nstep=half)
        if step % _LOG_EVERY == 0:
            sensors = plant.time, plant.qpos.copy(), plant.qvel.copy(), plant.ctrl.copy()
            rows.append(sensors)
            held.append(carries)
        mujoco.mj_step(model, plant, nstep=half)
    time, qpos, qvel, tau = (np.array(x) for x in zip(*rows, strict=True))
    log = Log(
        time=time,
        joint_names=tuple(bare.joint(j).name for j in range(bare.njnt)),
        qpos=qpos + SIGMA_Q * rng.normal(size=qpos.shape),
        qvel=qvel + _SIGMA_V * rng.normal(size=qvel.shape),
        tau=tau + _SIGMA_TAU * rng.normal(size=tau.shape),
        tau_kind=TorqueKind.SENSOR,
    )
    hand = bare.body(HAND).id
    pi = np.where(np.array(held)[:, None], body_pi(holding, hand), body_pi(bare, hand))
    return Recording(log, xml, pi)


def with_load(xml: str, load: Load) -> mujoco.MjModel:
    """The same arm with the box as part of its hand: no body more, so that one state fits both models."""
    bare = mujoco.MjModel.from_xml_string(xml)
    spec = mujoco.MjSpec.from_string(xml)
    centre, edges = np.array(load.centre), np.array(load.edges)
    squares = np.diag(load.mass / 12 * (edges @ edges - edges**2))
    moments = squares + load.mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    box = np.array([load.mass, *(load.mass * centre), *moments[np.triu_indices(3)]])
    set_inertials(spec, {HAND: body_pi(bare, bare.body(HAND).id) + box})
    return spec.compile()


def computed_torque(model, data, q, v, wanted_q, wanted_v, wanted_a) -> np.ndarray:
    """Inverse dynamics of the bare arm with feedback: errors decay as e'' + 40 e' + 400 e = 0."""
    data.qpos, data.qvel = q, v
    data.qacc = wanted_a + _DAMPING * (wanted_v - v) + _STIFFNESS * (wanted_q - q)
    mujoco.mj_inverse(model, data)
    return data.qfrc_inverse.copy()


def path(scenario: Scenario, joints: int):
    """(q, v, a) wanted at a time: three sines a joint, run slower to a stop around each event."""
    rng = np.random.default_rng([scenario.seed, 0])
    rate = 2 * np.pi * rng.uniform(0.15, 0.75, size=(3, joints))
    phase = rng.uniform(0, 2 * np.pi, size=(3, joints))
    size = _SWING * rng.dirichlet(np.ones(3) * 4, size=joints).T
    grid = np.arange(0.0, scenario.duration + _CONTROL_PERIOD, _CONTROL_PERIOD)
    pace = np.ones_like(grid)
    for event in (0.0, scenario.pick_up, scenario.put_down):
        away = np.clip(np.abs(grid - event) / _PAUSE - 0.25, 0.0, 1.0)
        pace *= away**3 * (10 - 15 * away + 6 * away**2)
    progress = np.concatenate([[0.0], np.cumsum(0.5 * (pace[1:] + pace[:-1])) * _CONTROL_PERIOD])
    rise = np.gradient(pace, _CONTROL_PERIOD)

    def at(time: float):
        k = min(round(time / _CONTROL_PERIOD), len(grid) - 1)
        angle = rate * progress[k] + phase
        q = _HOME + np.sum(size * np.sin(angle), 0)
        slope = np.sum(size * rate * np.cos(angle), 0)
        bend = -np.sum(size * rate**2 * np.sin(angle), 0)
        return q, slope * pace[k], bend * pace[k] ** 2 + slope * rise[k]

    return at
