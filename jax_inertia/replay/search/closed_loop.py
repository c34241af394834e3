"""Replays' numbers for the closed-loop likelihood (`jax_inertia.likelihood`), which finds what is there by linear
response, and its results as numbers of replays.
"""

import dataclasses
import itertools
from collections.abc import Sequence

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
from jax_inertia.replay.loop import Parameter
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
    def there(self) -> Bool[np.ndarray, " P"]:
        """Which numbers are there."""
        out = np.zeros(len(self.table), bool)
        for e, here in zip(self.names.entries, self.found.there, strict=True):
            out[list(e.rows)] |= here
        return out

    @property
    def ordinaries(self) -> int:
        """How many numbers are ordinary, the first of the table."""
        return len(self.table) - sum(len(c.parameters) for c in self.pool)

    @property
    def odd(self) -> list[tuple[Candidate, list[int]]]:
        """Odd effects that are there, with their rows of the table."""
        there = self.there
        return [(c, rows) for c, rows in self._rows if there[rows].any()]

    @property
    def rivals(self) -> list[tuple[Candidate, list[int], Candidate, Float[np.ndarray, " P"]]]:
        """What was fitted in an odd effect's place: it, its rows, that effect, and all numbers."""
        groups = self.found.groups
        of = {k: (c, rows) for c, rows in self._rows for k in rows}

        def candidate(effect: int) -> tuple[Candidate, list[int]]:
            return of[self.names.entries[groups.rows[effect][0]].rows[0]]

        return [
            (*candidate(r.effect), candidate(r.instead_of)[0], self.names.theta(r.theta))
            for r in self.found.rivals
        ]

    @property
    def _rows(self) -> list[tuple[Candidate, list[int]]]:
        """All odd effects, with their rows of the table."""
        ends = np.cumsum([self.ordinaries, *(len(c.parameters) for c in self.pool)]).tolist()
        return [
            (c, list(range(*e))) for c, e in zip(self.pool, itertools.pairwise(ends), strict=True)
        ]


def fits(
    plant: Plant,
    found: Fit,
    result: Result,
    pool: Sequence[Candidate],
    records: Sequence[Record],
    floor: Float[np.ndarray, " m"],
) -> list[tuple[Candidate, Fit]]:
    """Fits of replays with each odd effect of a result that is in the pool, from the result's numbers.

    Along the linear response a lag of targets with less damping is a motor's lag; replays tell them apart, each from
    the numbers that the likelihood has with it. So what was fitted in an effect's place starts a fit too.
    """
    count, out = result.ordinaries, []
    starts = [(c, rows, result.theta) for c, rows in result.odd]
    starts += [(c, rows, x) for c, rows, other, x in result.rivals if other in pool]
    for c, rows, x in starts:
        if c in pool:
            theta = np.concatenate([x[:count], found.theta[count:], x[rows]])
            out.append((c, fitted_from(plant, found, c, theta, records, floor)))
    return out


def find(
    plant: Plant,
    table: Sequence[Parameter],
    odd: Sequence[Candidate],
    records: Sequence[Record],
    floor: Float[np.ndarray, " m"],
) -> Result | None:
    """The numbers that are there, of ordinary ones and odd candidates.

    None where the linear response does not hold: it does on a fixed base of hinges and slides without chains that
    close, of logs without torque. `floor`: of each joint's error, what encoders leave, rms [rad].
    """
    return in_double_precision(_find)(plant, table, odd, records, floor)


def _find(plant: Plant, table, odd, records, floor) -> Result | None:
    if records[0].torque is not None:
        return None
    robot = load_model(plant.model)
    joints = joints_of(robot, plant.names)
    if joints is None:
        return None
    names = named(plant, table, odd)
    loop = _likelihood(plant, names, robot, joints, records, floor)
    found = likelihood.fitted(loop)
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
