"""The numbers of a replay that fits: Gauss–Newton over MuJoCo replays.

Replays of a position-controlled robot do not drift apart: the whole log is one shot, and no velocities have to be
guessed between. The cost is `problem.py`'s.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from jax_inertia.replay.fitting import columns as derivatives
from jax_inertia.replay.fitting.errors import Weights, replay_errors, weights
from jax_inertia.replay.fitting.problem import ENOUGH, Problem, normal
from jax_inertia.replay.loop import Parameter
from jax_inertia.replay.record import Record
from jax_inertia.replay.simulation.plant import Plant

ROUNDS = 12
# Between Jacobians: steps with a mended one, while each takes so much of the cost.
_MENDED, _WORTHWHILE = 2, 0.03
_ALONG_VALLEYS = 6
"""Steps with exact derivatives at most."""


class Fit(NamedTuple):
    """Numbers that fit, and how well they are known."""

    table: tuple[Parameter, ...]
    theta: Float[np.ndarray, " P"]
    covariance: Float[np.ndarray, "P P"]
    hessian: Float[np.ndarray, "P P"]
    """Half the second derivative of the cost, prior included."""
    samples: float
    """How many independent samples the errors are worth."""
    error: Float[np.ndarray, "N m"]
    """Of the joints' positions [rad], and then of their torques [N m] where those are logged."""
    columns: Float[np.ndarray, "P N m"]
    """Derivatives of the error, there or a last small step before."""
    weights: Weights
    elsewhere: Float[np.ndarray, " P"] | float = 0.0
    """What effects that may be there, and are not in the fit, add to each number's variance."""

    @property
    def sigma(self) -> Float[np.ndarray, " P"]:
        """Standard deviations."""
        return np.sqrt(np.diagonal(self.covariance))

    @property
    def free(self) -> Bool[np.ndarray, " P"]:
        """Which numbers were fitted."""
        return np.diagonal(self.covariance) > 0

    @property
    def moved(self) -> Bool[np.ndarray, " P"]:
        """Which numbers were fitted and differ from the nominal model's."""
        return self.free & (self.theta != np.array([p.nominal for p in self.table]))


Progress = Callable[[str], None]


def fit(
    plant: Plant,
    table: Sequence[Parameter],
    records: Sequence[Record],
    theta: Float[np.ndarray, " P"],
    *,
    free: Bool[np.ndarray, " P"] | None = None,
    floor: float | Float[np.ndarray, " m"] = 1e-4,
    rounds: int = ROUNDS,
    known: tuple[np.ndarray, np.ndarray] | None = None,
    mended_only: bool = False,
    exact: bool = False,
    progress: Progress = lambda text: None,
) -> Fit:
    """Gauss–Newton from `theta`; numbers that are not free stay where they are.

    Between Jacobians, up to two steps with one that is mended by Broyden's formula: a replay for each try, where a
    Jacobian takes one for each number. `known`: error and derivatives near the start, from another fit;
    `mended_only`: with no other Jacobian than that. `exact`: gone on with, by derivatives that tell what numbers do
    together, along valleys that bend; how well numbers are known is right then.
    """
    problem = Problem(plant, tuple(table), records, floor, np.ones(len(table), bool))
    if free is not None:
        problem = problem._replace(free=free)
    theta = np.clip(theta, *problem.bounds)
    error, columns = known or evaluated(plant, table, records, theta, problem.free)
    if mended_only:
        at = _mended(problem, theta, error, columns, rounds)
    else:
        at = _nearby(problem, theta, error, columns, rounds, known is not None, exact, progress)
    if exact:
        at = _along_valleys(problem, *at, progress)
    return _told(problem, *at)


_At = tuple[np.ndarray, np.ndarray, np.ndarray]


def _mended(problem: Problem, theta, error, columns, rounds: int) -> _At:
    for _ in range(rounds):
        step = problem.step(theta, error, columns)
        if step.gain > ENOUGH:
            columns = _taught(problem, columns, theta, error, step)
        if step.gain > 0:
            theta, error = step.theta, step.error
        if step.gain <= ENOUGH:
            break
    return theta, error, columns


def _nearby(
    problem: Problem,
    theta,
    error,
    columns,
    rounds: int,
    known: bool,
    exact: bool,
    progress: Progress,
) -> _At:
    """By wide differences; where `exact` ones follow, no more of them than lead on."""
    mended = int(known)
    # What is off by little is nearly linear: its columns are computed first, and anew once all others stay.
    most = problem.free & np.array([not p.is_tolerance for p in problem.table], bool)
    asked, outdated = most, False
    for k in range(rounds):
        progress(f"fitting replays, round {k + 1}")
        step = problem.step(theta, error, columns)
        if step.gain > ENOUGH:
            if mended < _MENDED and step.gain > _WORTHWHILE:
                columns = _taught(problem, columns, theta, error, step)
                theta, error, mended = step.theta, step.error, mended + 1
                continue
            theta, error = step.theta, step.error
        elif exact or not (mended or outdated):
            if step.gain > 0:
                theta, error = step.theta, step.error
            break
        else:
            asked = problem.free
        columns = _again(problem, theta, asked, columns)
        mended, outdated = 0, not np.array_equal(asked, problem.free)
    if (mended or outdated) and not exact:
        columns = _again(problem, theta, problem.free, columns)
    return theta, error, columns


def _along_valleys(problem: Problem, theta, error, columns, progress: Progress) -> _At:
    for k in range(_ALONG_VALLEYS):
        progress(f"fitting replays, closer, round {k + 1}")
        bend = np.diagonal(problem.quadratic(theta, error, columns).hessian)
        columns = derivatives.narrow(
            problem.plant, problem.table, problem.records, theta, problem.free, bend
        )
        step = problem.bent_step(theta, error, columns)
        theta, error = step.theta, step.error
        if step.gain <= ENOUGH:
            break
    return theta, error, columns


def _taught(problem: Problem, columns, theta, error, step) -> np.ndarray:
    """Derivatives that say what a step did."""
    done = step.theta - theta, step.error - error
    return derivatives.mend(problem.plant, problem.table, columns, *done)


def _again(problem: Problem, theta, asked, columns) -> np.ndarray:
    """Derivatives, those by numbers that are not asked about as they were."""
    new = derivatives.wide(problem.plant, problem.table, problem.records, theta, asked)
    return np.where(asked[:, None, None], new, columns)


def evaluated(plant, table, records, theta, free) -> tuple[np.ndarray, np.ndarray]:
    """Error (N, m) and its derivatives (P, N, m)."""
    error = replay_errors(plant, table, theta[None], records)[0]
    return error, derivatives.wide(plant, table, records, theta, free)


def _told(problem: Problem, theta, error, columns) -> Fit:
    """How well the numbers are known: the wider, number by number, of two ways to allow for errors that last.

    One counts samples by their autocorrelation; the other is the sandwich H⁻¹ Σ_b g_b g_bᵀ H⁻¹ over blocks b of the
    log, which is a jackknife over them to first order.
    """
    table, free = problem.table, problem.free
    w = weights(error, problem.floor)
    hessian, _ = normal(error, columns, w, theta, *problem.prior)
    go = np.flatnonzero(free)
    inverse = np.linalg.inv(hessian[np.ix_(go, go)])
    length = int(max(2.0 * np.max(w.correlated), 1.0 / problem.records[0].period))
    blocks = max(len(error) // length, 1)
    white, rest, scores = columns * w.root, error * w.root, []
    for rows in np.array_split(np.arange(len(error)), blocks):
        scores.append(np.einsum("ptj,tj->p", white[go][:, rows], rest[rows]))
    meat = np.array(scores).T @ np.array(scores)
    sandwich = inverse @ meat @ inverse
    wider = np.sqrt(np.maximum(np.diagonal(sandwich) / np.diagonal(inverse), 1.0))
    covariance = np.zeros((len(table),) * 2)
    covariance[np.ix_(go, go)] = np.minimum(np.outer(wider, wider), 1e6) * inverse
    samples = float(np.sum(len(error) / w.correlated))
    return Fit(table, theta, covariance, hessian, samples, error, columns, w)
