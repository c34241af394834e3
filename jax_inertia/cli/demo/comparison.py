"""The demo's filters, side by side on the same log, and how they did."""

import dataclasses

import mujoco
import numpy as np
from jaxtyping import Bool, Float

from jax_inertia.cli.demo.simulation import Recording, Scenario
from jax_inertia.estimation import batch_fit, log_filter
from jax_inertia.estimation.inertial_filter import Trace
from jax_inertia.estimation.priors import Load
from jax_inertia.maths import charts
from jax_inertia.maths.inertial_parameters import is_physical, pseudo_inertia
from jax_inertia.model.load import load_model
from jax_inertia.robots.arm import HAND

WITHIN = 0.05
"""A load counts as found while its mass is right to this share."""


# A linear update is done after one iteration; more would compute the same.
FILTERS = (
    ("KF, linear", charts.Linear(), 1),
    ("EKF, paper's UᵀU", charts.LogCholesky(), 5),
    ("EKF, U Uᵀ", charts.LogCholeskyUUt(), 5),
)


@dataclasses.dataclass(frozen=True)
class Run:
    """One filter's run."""

    name: str
    trace: Trace
    load: Float[np.ndarray, " T"]
    """Estimated mass of the hand beyond the model's [kg]."""
    sigma: Float[np.ndarray, " T"]
    physical: Bool[np.ndarray, " T"]
    smallest: Float[np.ndarray, " T"]
    """Smallest eigenvalue of the pseudo-inertia [kg m²]: negative where no body has such parameters."""
    score: "Score"


@dataclasses.dataclass(frozen=True)
class Score:
    """How one run compares with the truth."""

    found_after: float | None
    """From the pick-up until the load's mass is right to 5 % and stays so while it is carried [s]."""
    let_go_after: float | None
    """From the put-down until no more than 5 % of the load is still believed [s]."""
    rms: float
    """Root mean square error of the load's mass over the second half of the carrying [kg]."""
    unphysical: int


@dataclasses.dataclass(frozen=True)
class Comparison:
    """All runs, on one time axis."""

    scenario: Scenario
    time: Float[np.ndarray, " T"]
    truth: Float[np.ndarray, " T"]
    runs: tuple[Run, ...]


def compare(recording: Recording, scenario: Scenario) -> Comparison:
    """The paper's Kalman filter, its extended filter, and the same in the chart U Uᵀ, all else equal.

    Noise is taken from the log, prior and drift from the robot's mass: nothing is set by the load or the seed.
    """
    robot = load_model(mujoco.MjModel.from_xml_string(recording.model_xml))
    prior = Load(0.1 * float(robot.pi[:, 0].sum()))
    observation = log_filter.observe(recording.log, robot)
    fit = batch_fit.fit(robot, [observation], [HAND], prior=prior)
    noise, _ = log_filter.residual_noise(robot, observation, [HAND], prior=prior, whole=fit)
    noise = noise / np.sqrt(log_filter.stride(observation))
    thin = log_filter.thinned(observation)
    time = np.asarray(thin.motion.time)
    bare = float(robot.pi[robot.body_index(HAND), 0])
    carried = (time >= scenario.pick_up) & (time < scenario.put_down)
    truth = np.where(carried, scenario.load.mass, 0.0)
    runs = []
    for name, chart, iterations in FILTERS:
        estimator = log_filter.online(
            robot, [HAND], noise, prior=prior, chart=chart, iterations=iterations
        )
        _, trace = log_filter.run(estimator, estimator.initial(), thin)
        pi = np.asarray(trace.estimate.pi)[:, 0]
        load = pi[:, 0] - bare
        physical = np.asarray(is_physical(trace.estimate.pi[:, 0]))
        runs.append(
            Run(
                name=name,
                trace=trace,
                load=load,
                sigma=np.asarray(trace.estimate.sigma_pi)[:, 0, 0],
                physical=physical,
                smallest=np.linalg.eigvalsh(np.asarray(pseudo_inertia(trace.estimate.pi[:, 0])))[
                    :, 0
                ],
                score=_score(time, load, physical, scenario),
            )
        )
    return Comparison(scenario, time, truth, tuple(runs))


def _score(time: np.ndarray, load: np.ndarray, physical: np.ndarray, scenario: Scenario) -> Score:
    tolerance = WITHIN * scenario.load.mass
    begin, end = scenario.pick_up, scenario.put_down
    # The low-pass looks a tenth of a second ahead: what it shows just before an event is the event.
    held = (time >= begin) & (time < end - 0.1)
    after = time >= end
    late = held & (time >= 0.5 * (begin + end))
    return Score(
        found_after=_settled(
            time[held] - begin, np.abs(load[held] - scenario.load.mass), tolerance
        ),
        let_go_after=_settled(time[after] - end, np.abs(load[after]), tolerance),
        rms=float(np.sqrt(np.mean((load[late] - scenario.load.mass) ** 2))),
        unphysical=int(np.sum(~physical)),
    )


def _settled(time: np.ndarray, error: np.ndarray, tolerance: float) -> float | None:
    """When the error goes below the tolerance for good, None where it does not."""
    outside = np.flatnonzero(~(error <= tolerance))
    first = 0 if len(outside) == 0 else int(outside[-1]) + 1
    return float(time[first]) if first < len(time) else None
