"""Replays' numbers for the closed-loop likelihood (`jax_inertia.likelihood`), which finds what is there by linear
response, and its results as numbers of replays.
"""

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Bool, Float

from jax_inertia.likelihood import fit as likelihood
from jax_inertia.likelihood.closed_loop import ClosedLoop
from jax_inertia.likelihood.linearised import Joints, joints_of
from jax_inertia.likelihood.motion import Run
from jax_inertia.maths.precision import in_double_precision
from jax_inertia.model.load import load_model
from jax_inertia.model.robot import Robot
from jax_inertia.replay.fitting.fit import Fit
from jax_inertia.replay.loop import LOGARITHMIC, Parameter
from jax_inertia.replay.record import Record
from jax_inertia.replay.search.candidates import Candidate
from jax_inertia.replay.search.entries import Names, named
from jax_inertia.replay.search.tries import fitted_from
from jax_inertia.replay.simulation.plant import Plant
from jax_inertia.replay.simulation.simulate import replay


@dataclasses.dataclass(frozen=True)
class Result:
    """What the likelihood found, as numbers of replays."""

    found: likelihood.Found
    names: Names
    pool: tuple[Candidate, ...]
    theta: Float[np.ndarray, " P"]

    @property
    def table(self) -> tuple[Parameter, ...]:
        """All numbers that were asked about."""
        return self.names.table

    @property
    def error(self) -> float:
        """Of its replays, rms over joints [rad]."""
        return self.found.rounds[-1]

    @property
    def there(self) -> Bool[np.ndarray, " P"]:
        """Which numbers are there."""
        out = np.zeros(len(self.table), bool)
        for e, here in zip(self.names.entries, self.found.there, strict=True):
            out[list(e.rows)] |= here
        return out

    @property
    def places(self) -> list[tuple[Candidate, tuple[int, ...]]]:
        """All odd candidates, each with its rows of the table."""
        out, first = [], len(self.table) - sum(len(c.parameters) for c in self.pool)
        for c in self.pool:
            out.append((c, tuple(range(first, first + len(c.parameters)))))
            first += len(c.parameters)
        return out

    @property
    def odd(self) -> list[tuple[Candidate, tuple[int, ...]]]:
        """Odd effects that are there, with their rows of the table."""
        there = self.there
        return [(c, rows) for c, rows in self.places if there[list(rows)].any()]


def fits(
    plant: Plant,
    found: Fit,
    result: Result,
    pool: Sequence[Candidate],
    records: Sequence[Record],
    floor: Float[np.ndarray, " m"],
) -> list[tuple[Candidate, Fit]]:
    """Fits of replays with each odd effect of a result that is in the pool, from the result's numbers."""
    count = len(result.table) - sum(len(c.parameters) for c in result.pool)
    out = []
    for c, rows in result.odd:
        if c in pool:
            theta = np.concatenate(
                [result.theta[:count], found.theta[count:], result.theta[list(rows)]]
            )
            out.append((c, fitted_from(plant, found, c, theta, records, floor)))
    return out


def find(
    plant: Plant,
    table: Sequence[Parameter],
    odd: Sequence[Candidate],
    records: Sequence[Record],
    floor: Float[np.ndarray, " m"],
    *,
    start: Float[np.ndarray, " P"] | None = None,
    rounds: int = likelihood.ROUNDS,
    progress: Callable[[str], None] = lambda text: None,
) -> Result | None:
    """The numbers that are there, of ordinary ones and odd candidates; `start`: of the table's numbers.

    None where the linear response does not hold: it does on a fixed base of hinges and slides without chains that
    close, of logs without torque. `floor`: of each joint's error, what encoders leave, rms [rad].
    """
    return in_double_precision(_find)(plant, table, odd, records, floor, start, rounds, progress)


def _find(plant: Plant, table, odd, records, floor, start, rounds: int, progress) -> Result | None:
    robot = load_model(plant.model)
    joints = joints_of(robot, plant.names)
    if joints is None or records[0].torque is not None:
        return None
    names = named(plant, table, odd)
    loop = _likelihood(plant, names, robot, joints, records, floor)
    begins = None if start is None else _from(names, start)
    found = likelihood.fitted(loop, rounds=rounds, start=begins, progress=progress)
    return Result(found, names, tuple(odd), names.theta(found.theta))


def _likelihood(
    plant: Plant, names: Names, robot: Robot, joints: Joints, records: Sequence[Record], floor
) -> ClosedLoop:
    runs = [_run(plant, r) for r in records]

    def simulated(thetas: np.ndarray, k: int, times: np.ndarray) -> np.ndarray:
        fine = np.repeat(records[k].q[:1], len(times), axis=0)
        record = records[k]._replace(time=times, q=fine)
        return replay(plant, names.table, np.array([names.theta(x) for x in thetas]), record)

    return ClosedLoop(robot, joints, runs, names.numbers, simulated, floor)


def _from(names: Names, start: Float[np.ndarray, " P"]) -> np.ndarray:
    """Ordinary numbers of replays as the likelihood has them."""
    out = np.zeros(len(names.entries))
    for i, e in enumerate(names.entries):
        k, p = e.rows[0], names.table[e.rows[0]]
        if k < len(start) and start[k] != p.nominal:
            off = start[k] - p.nominal
            out[i] = np.expm1(off) if p.family in LOGARITHMIC else off
    return out


def _run(plant: Plant, r: Record) -> Run:
    loop = plant.loop if r.loop is None else r.loop
    commanded, fed = r.commanded, None
    if commanded.velocity is not None or commanded.torque is not None:
        fed = np.zeros_like(commanded.position)
        fed += 0.0 if commanded.velocity is None else loop.kd * commanded.velocity
        fed += 0.0 if commanded.torque is None else commanded.torque
    counts = np.repeat(r.settled[:, None].astype(float), r.q.shape[1], axis=1)
    return Run(
        r.time,
        r.q,
        commanded.time,
        commanded.position,
        loop.kp,
        loop.kd,
        loop.limit,
        counts,
        fed,
        -1.0 if plant.own.of_kd < 0 else 1.0,
    )
